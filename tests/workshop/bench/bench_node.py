"""Measure the real controller node: timer lateness, answer latency and tick at 10, 50 and 100 Hz.

`python tests/workshop/bench/bench_node.py --seconds 60` prints a table and writes
`bench_node.json`. The controller runs as it does on a car, as a process of its own; a second
process is the car: it drives a circle in real time, publishes its state at the rate, and notes
when the answers come.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from ampc_ros.configuration import Choices
from launch_scripts.run.environment import ros_environment
from launch_scripts.run.processes import Processes

CHOICES = {
    10: Choices(settings="table3", gain_table="preview"),
    50: Choices(settings="50hz", gain_table="preview_50hz"),
    100: Choices(settings="100hz", gain_table="preview_100hz"),
}
"""Settings and gains by rate [Hz]."""
START_TIME_OUT = 180.0
"""Wall time for the two processes to find each other, which includes compiling [s]."""
SECONDS = (0.1, 3600.0)
"""Shortest and longest measurement [s]."""
WIDTH = 130
"""Of the table, also where the terminal is narrower."""
SPIN = "while True: pass"


class Spread(NamedTuple):
    """Median, 99th percentile and largest of a series."""

    p50: float
    p99: float
    max: float


class NodeRow(NamedTuple):
    """What was measured at one rate."""

    rate: int
    """[Hz]"""
    busy: int
    """Processes that spin beside, one to a core."""
    ticks: int
    """Commands received."""
    lateness: Spread
    """Of the controller's timer [ms]."""
    latency: Spread
    """From publishing a state to receiving its command [ms]."""
    tick: Spread
    """State to command inside the node, `controller/debug/solve_time` [ms]."""
    share: float
    """99th percentile of the tick, as a share of the period."""
    missed: int
    """Missed ticks, as the node counts them in its diagnostics."""
    unanswered: int
    """States without a command."""
    load: float
    """Processor time of the node, as a share of one core."""


def measure_node(
    rates: Sequence[int] = (10, 50, 100), seconds: float = 10.0, busy: Sequence[int] = (0, 1)
) -> list[NodeRow]:
    """Measure the controller node at every rate, idle and with busy cores.

    Args:
        rates: Of states and commands, 10, 50 or 100 [Hz].
        seconds: Of each measurement [s].
        busy: Numbers of cores to keep busy.

    Raises:
        RuntimeError: A process ended early; the message holds its last words.
    """
    return [measure(rate, seconds, spinning) for spinning in busy for rate in rates]


def measure(rate: int, seconds: float, busy: int) -> NodeRow:
    """Measure one rate [Hz] with some cores busy."""
    with tempfile.TemporaryDirectory() as folder, busy_cores(busy):
        logs, result = Path(folder), Path(folder) / "row.json"
        with Processes(logs) as nodes:
            chosen = {key: getattr(CHOICES[rate], key) for key in ("settings", "gain_table")}
            given = {**chosen, "static_path": True}
            nodes.start("controller", "ampc_ros.nodes.controller_node", given)
            controller = nodes.running["controller"].pid
            asked = {"rate": rate, "seconds": seconds, "pid": controller, "result": str(result)}
            nodes.start("car", "tests.workshop.bench.bench_car_node", asked)
            wait_for(nodes, seconds + START_TIME_OUT)
        measured = json.loads(result.read_text(encoding="utf-8"))
    measured |= {key: Spread(*measured[key]) for key in ("lateness", "latency", "tick")}
    share = measured["tick"].p99 * rate / 1000.0
    return NodeRow(rate=rate, busy=busy, share=share, **measured)


def wait_for(nodes: Processes, patience: float) -> None:
    """Wait until the car has measured [s].

    Raises:
        RuntimeError: It did not, or the controller has ended.
    """
    until = time.monotonic() + patience
    while not (ended := nodes.ended()):
        if time.monotonic() > until:
            raise RuntimeError(f"no result: {nodes.last_line('car')}")
        time.sleep(0.2)
    for name, code in ended.items():
        if name != "car" or code != 0:
            raise RuntimeError(f"{name} ended with exit code {code}: {nodes.last_line(name)}")


@contextmanager
def busy_cores(count: int) -> Iterator[None]:
    """Keep some cores busy, each with a process that is bound to it."""
    cores = sorted(os.sched_getaffinity(0))[:count]
    spinning = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in cores]
    try:
        for process, core in zip(spinning, cores, strict=True):
            os.sched_setaffinity(process.pid, {core})
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def table(rows: Sequence[NodeRow]) -> Table:
    """Lay the rows out."""
    shown = Table(title="controller node; p50 / p99 / max [ms]")
    heads = ("rate [Hz]", "busy cores", "timer lateness", "answer latency", "tick")
    for head in (*heads, "tick p99 / period", "missed", "unanswered", "ticks", "load"):
        shown.add_column(head, justify="right")
    for row in rows:
        spreads = ["/".join(f"{v:.2f}" for v in s) for s in (row.lateness, row.latency, row.tick)]
        counts = [str(number) for number in (row.missed, row.unanswered, row.ticks)]
        share, load = f"{row.share:.1%}", f"{row.load:.0%}"
        shown.add_row(str(row.rate), str(row.busy), *spreads, share, *counts, load)
    return shown


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, show, write; gives the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    parser.add_argument("--rates", type=int, nargs="+", default=list(CHOICES), choices=CHOICES)
    parser.add_argument("--busy", type=int, nargs="+", default=[0, 1], help="busy cores")
    parser.add_argument("--output", type=Path, default=Path("bench_node.json"))
    chosen = parser.parse_args(arguments)
    low, high = SECONDS
    if not low <= chosen.seconds <= high:
        parser.error(f"--seconds {chosen.seconds:g}: must lie in [{low:g}, {high:g}]")
    os.environ.update(ros_environment())
    rows = measure_node(chosen.rates, chosen.seconds, chosen.busy)
    Console(width=WIDTH).print(table(rows))
    text = json.dumps([as_dictionary(row) for row in rows], indent=1)
    chosen.output.write_text(text + "\n", encoding="utf-8")
    return 0


def as_dictionary(row: NodeRow) -> dict[str, object]:
    """Give a row as JSON takes it, spreads by name too."""
    return {
        key: value._asdict() if isinstance(value, Spread) else value
        for key, value in row._asdict().items()
    }


if __name__ == "__main__":
    sys.exit(main())
