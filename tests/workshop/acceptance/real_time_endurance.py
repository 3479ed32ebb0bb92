"""Drive laps of a circle in real time, and watch missed ticks and the memory of every node.

`python -m tests.workshop.acceptance.real_time_endurance --minutes 10` drives at 100 Hz with
`start.py`, recorder and gate included, on a machine that should be idle. Exit code 0: no tick was
missed, and no node needed more than GROWTH beyond its memory after minute 2.
"""

import argparse
import csv
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from launch_scripts import start
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.reporting.pages import terminal_table

RADIUS, SPEED = 50.0, 9.0
"""Circle [m], speed [m/s]."""
SETTLED = 120.0
"""Wall time after which memory must be constant [s]."""
GROWTH = 1.0
"""Allowed growth after that [MB]."""
SAMPLE_PERIOD = 10.0
"""Wall time between two looks at the memory [s]."""
MEGABYTE = 1024 * 1024


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, print a row for each node, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the drive")
    parser.add_argument("--settings", default="100hz", help="limits; default: %(default)s")
    parser.add_argument("--gain-table", default="preview_100hz", help="default: %(default)s")
    chosen = parser.parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    with tempfile.TemporaryDirectory() as folder:
        road, run = Path(folder) / "circle.csv", Path(folder) / "run"
        write_circle(road)
        laps = math.ceil(chosen.minutes * 60.0 * SPEED / (2 * math.pi * RADIUS))
        words = [sys.executable, start.__file__, "--path", str(road), "--laps", str(laps)]
        words += ["--settings", chosen.settings, "--gain-table", chosen.gain_table]
        with subprocess.Popen([*words, "--real-time", "--output", str(run)]) as drive:
            samples = watch(drive)
        tick = read_columns(run / "bag").tick
        missed, commands = (int(tick[name][-1, 1]) for name in ("missed_ticks", "commands"))
    rows = [(name, *growth(each)) for name, each in samples.items()]
    heads = ("node", "memory after 2 min [MB]", "at the end [MB]", "growth [MB]")
    console.print(terminal_table(heads, rows, "lrrr"))
    console.print(f"{missed} of {commands} ticks missed, exit code {drive.returncode}")
    constant = all(float(row[-1]) <= GROWTH for row in rows)
    return int(not constant or missed > 0 or drive.returncode != 0)


def write_circle(file: Path) -> None:
    """Write a closed circle with its speed."""
    with file.open("w", newline="", encoding="utf-8") as lines:
        writer = csv.writer(lines)
        writer.writerow(("x_m", "y_m", "v_mps"))
        count = 300
        for i in range(count + 1):
            angle = 2 * math.pi * i / count
            x, y = RADIUS * math.sin(angle), RADIUS * (1.0 - math.cos(angle))
            writer.writerow((round(x, 6), round(y, 6), SPEED))


def watch(drive: "subprocess.Popen[bytes]") -> dict[str, list[tuple[float, float]]]:
    """Return wall time [s] and resident memory [MB] of every node until the drive has ended."""
    begin, samples = time.monotonic(), dict[str, list[tuple[float, float]]]()
    while drive.poll() is None:
        for name, number in nodes_of(drive.pid).items():
            if memory := resident(number):
                samples.setdefault(name, []).append((time.monotonic() - begin, memory))
        time.sleep(SAMPLE_PERIOD)
    return samples


def nodes_of(parent: int) -> dict[str, int]:
    """Return the process number of each node that a process has started."""
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            words = (folder / "cmdline").read_text("utf-8").split("\0")
            owner = int((folder / "stat").read_text("utf-8").rpartition(")")[2].split()[1])
        except OSError:
            continue
        if owner == parent and "-m" in words:
            found[words[words.index("-m") + 1].rpartition(".")[2]] = int(folder.name)
    return found


def resident(number: int) -> float:
    """Return the resident memory of a process [MB]; 0: it has ended."""
    try:
        pages = int(Path(f"/proc/{number}/statm").read_text("ascii").split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE


def growth(samples: Sequence[tuple[float, float]]) -> tuple[str, str, str]:
    """Return memory after SETTLED, largest memory after that, and their difference."""
    settled = [memory for at, memory in samples if at >= SETTLED] or [samples[-1][1]]
    return f"{settled[0]:.1f}", f"{max(settled):.1f}", f"{max(settled) - settled[0]:.1f}"


if __name__ == "__main__":
    sys.exit(main())
