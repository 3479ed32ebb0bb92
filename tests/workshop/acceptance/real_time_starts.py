"""Start drives in real time on a loaded machine: every one must cover its whole path.

`python -m tests.workshop.acceptance.real_time_starts --starts 20 --load 2` starts `start.py` on a
road with bends, 20 times at each speed, while two processes keep the cores busy. It writes a table.
Exit code 0: all drives were completed without a rejected state. A stop request that did not shorten
the drive, such as that after its end, does not count.
"""

import argparse
import csv
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from launch_scripts import start
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.reporting.pages import terminal_table

SPEEDS = (6.0, 9.0, 15.0, 22.0)
"""Speeds of the drives [m/s]."""
DRIVE_TIME = 5.0
"""Time of a drive at constant speed [s]."""
LATERAL_ACCELERATION = 1.5
"""In the bends [m/s^2]."""
BUSY = "while True: pass"


def main(arguments: Sequence[str] | None = None) -> int:
    """Start the drives, print a row for each, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=20, help="number of starts at each speed")
    parser.add_argument("--speeds", type=float, nargs="+", default=SPEEDS, help="speeds [m/s]")
    parser.add_argument("--load", type=int, default=os.cpu_count(), help="busy processes")
    options = parser.parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(options.load)]
    rows = []
    try:
        for speed in options.speeds:
            for number in range(options.starts):
                with tempfile.TemporaryDirectory() as folder:
                    rows.append(started(Path(folder), speed))
                console.print(f"{number + 1}: {', '.join(map(str, rows[-1]))}", markup=False)
    finally:
        for each in busy:
            each.kill()
            each.wait()
    heads = ("speed [m/s]", "result", "distance [m]", "largest error [m]", "rejected", "stop")
    console.print(terminal_table(heads, rows, "rlrrrl"))
    good = [row for row in rows if row[1] == "completed" and not row[4]]
    console.print(f"{len(good)} of {len(rows)} starts drove the whole path as planned")
    return 0 if len(good) == len(rows) else 1


def started(folder: Path, speed: float) -> tuple[Any, ...]:
    """Drive once, and return the row of the table."""
    road, run = folder / "road.csv", folder / "run"
    write_road(road, speed)
    words = [sys.executable, start.__file__, "--path", str(road), "--real-time"]
    done = subprocess.run([*words, "--output", str(run)], capture_output=True, text=True)
    try:
        result = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
        (drive,) = json.loads((run / "report.json").read_text(encoding="utf-8"))["drives"]
        rejected = int(read_columns(run / "bag").tick["rejected_inputs"][-1, 1])
    except (OSError, ValueError):
        return speed, f"exit code {done.returncode}: {done.stdout[-200:]}", 0, 0, 0, "none"
    summary = drive["summary"]
    ended = result["ended"] if result["ended"] != "completed" or not done.returncode else "code"
    error = f"{summary['max_cross_track_error']:.3f}"
    distance = f"{summary['distance']:.0f}"
    cause = re.search(r"a stop is requested, reason: (\w+)", done.stdout)
    return speed, ended, distance, error, rejected, cause[1] if cause else "none"


def write_road(file: Path, speed: float) -> None:
    """Write a road that bends to both sides after a straight."""
    length = speed * DRIVE_TIME
    wave = 2 * math.pi / (length / 1.5)
    height = LATERAL_ACCELERATION / (speed * wave) ** 2
    with file.open("w", newline="", encoding="utf-8") as lines:
        writer = csv.writer(lines)
        writer.writerow(("x_m", "y_m", "v_mps"))
        for i in range(int(length) + 20):
            x = float(i)
            writer.writerow((x, height * (1.0 - math.cos(wave * max(x - 10.0, 0.0))), speed))


if __name__ == "__main__":
    sys.exit(main())
