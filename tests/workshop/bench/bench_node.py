"""Measure the controller node: start, timer lateness, answer latency and tick.

`python -m tests.workshop.bench.bench_node --seconds 60` prints a table at 10, 50 and 100 Hz and
writes `bench_node.json`. The controller runs as a process of its own, as on a car. A second process
is the car: it drives a circle in real time, publishes its state at the given rate, and measures
when the answers arrive.
"""

import argparse
import json
import os
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from ampc_ros.configuration import Choices
from launch_scripts.run.processes import Processes, ros_environment
from tests.workshop.bench.bench_report import Row, Section, show

CHOICES = {
    10: Choices(settings="table3", gain_table="preview"),
    50: Choices(settings="50hz", gain_table="preview_50hz"),
    100: Choices(settings="100hz", gain_table="preview_100hz"),
}
"""Settings and gains by rate [Hz]."""
START_TIMEOUT = 180.0
"""Wall time for start, compilation and discovery of the two processes [s]."""
SECONDS = (0.1, 3600.0)
"""Shortest and longest measurement [s]."""
DURATIONS = {(rate, busy): 30.0 for rate in (10, 50, 100) for busy in (0, 1)} | {(100, 1): 60.0}
"""Wall time of each measurement of `make bench`, by rate [Hz] and number of busy cores [s]."""
NODE_NOTE = (
    "The node as a process of its own, a second process as the car; 30 s each, 60 s at 100 Hz with "
    "a busy core. Timer lateness, answer latency over ROS, and tick in ms: median / p99 / largest."
)
START_NOTE = (
    "Wall time from the start of the process to its line `ready`; after that nothing is compiled. "
    "Cold: without compiled code; warm: median of {runs} starts."
)
CONTROLLERS = ("preview", "paper")
EMPTY = "an empty rclpy node"
EMPTY_NODE = """
import rclpy
rclpy.init()
rclpy.create_node("empty").get_logger().info("[empty]: ready")
"""
WIDTH = 160
"""Minimum width of the printed table [characters]."""
SPIN = "while True: pass"


class Spread(NamedTuple):
    """Median, 99th percentile and maximum of a series."""

    p50: float
    p99: float
    max: float

    def __str__(self) -> str:
        """Return the three numbers with two decimals."""
        return " / ".join(f"{value:.2f}" for value in self)


class NodeRow(NamedTuple):
    """Results at one rate."""

    rate: int
    """[Hz]"""
    busy: int
    """Number of busy cores."""
    ticks: int
    """Number of received commands."""
    lateness: Spread
    """Lateness of the controller's timer [ms]."""
    latency: Spread
    """Time from the publication of a state to the arrival of its command [ms]."""
    tick: Spread
    """Time from state to command inside the node, `controller/debug/solve_time` [ms]."""
    share: float
    """99th percentile of the tick, as a share of the period."""
    missed: int
    """Number of missed ticks in the diagnostics of the node."""
    unanswered: int
    """Number of states without a command."""
    load: float
    """Processor time of the node, as a share of one core."""


def measure(*, quick: bool) -> list[Section]:
    """Return one table: a row for each rate, idle and with one busy core."""
    cases = {(10, 0): 2.0} if quick else DURATIONS
    rows = [measure_rate(rate, time, busy) for (rate, busy), time in cases.items()]
    return [node_section(rows)]


def measure_start(*, quick: bool) -> list[Section]:
    """Return one table of the start time: a row for each formulation, and an empty node."""
    runs = 1 if quick else 7
    rows: list[Row] = []
    for controller in CONTROLLERS[: 1 if quick else None]:
        command = ["-m", "ampc_ros.nodes.controller_node", "--ros-args", "-p"]
        rows.append(start_row(controller, [*command, f"controller:={controller}"], runs))
    rows.append(start_row(EMPTY, ["-c", EMPTY_NODE], runs))
    return [Section("start", "Start of the node", START_NOTE.format(runs=runs), rows)]


def start_row(name: str, command: Sequence[str], runs: int) -> Row:
    """Return the start times of a node, without and with compiled code [s]."""
    with tempfile.TemporaryDirectory() as cache:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        cold = seconds_to_ready(command, cache)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        warm = [seconds_to_ready(command, cache) for _ in range(runs)]
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    row = {"controller": name, "cold [s]": cold, "cold, CPU [s]": cpu}
    return row | {"warm [s]": statistics.median(warm), "warm, slowest [s]": max(warm)}


def measure_rate(rate: int, seconds: float, busy: int) -> NodeRow:
    """Measure one rate [Hz] with some busy cores.

    Raises:
        RuntimeError: A process ended early; the message holds its last line.
    """
    with tempfile.TemporaryDirectory() as folder, busy_cores(busy):
        logs, result = Path(folder), Path(folder) / "row.json"
        with Processes(logs) as nodes:
            chosen = {key: getattr(CHOICES[rate], key) for key in ("settings", "gain_table")}
            nodes.start(
                "controller", "ampc_ros.nodes.controller_node", chosen | {"static_path": True}
            )
            controller = nodes.running["controller"].pid
            car = {"rate": rate, "seconds": seconds, "pid": controller, "result": str(result)}
            nodes.start("car", "tests.workshop.bench.bench_car_node", car)
            wait_for(nodes, seconds + START_TIMEOUT)
        measured = json.loads(result.read_text(encoding="utf-8"))
    measured |= {key: Spread(*measured[key]) for key in ("lateness", "latency", "tick")}
    share = measured["tick"].p99 * rate / 1000.0
    return NodeRow(rate=rate, busy=busy, share=share, **measured)


def wait_for(nodes: Processes, timeout: float) -> None:
    """Wait until the car has finished its measurement [s].

    Raises:
        RuntimeError: The timeout is over, or the controller has ended.
    """
    until = time.monotonic() + timeout
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


def seconds_to_ready(arguments: Sequence[str], cache: str) -> float:
    """Start a node with a cache of compiled code; return the time until it is ready [s].

    Raises:
        RuntimeError: The node ended before; the message holds its output.
    """
    environment = {**ros_environment(), "XDG_CACHE_HOME": cache}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, *arguments]
    begin, output = time.monotonic(), ""
    node = subprocess.Popen(
        command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        for line in node.stdout or ():
            output += line
            if line.rstrip().endswith(": ready"):
                return time.monotonic() - begin
    finally:
        os.kill(node.pid, signal.SIGKILL)
        node.wait()
    raise RuntimeError(f"{command}: ended before it was ready: {output.strip()[-500:]}")


def node_section(rows: Sequence[NodeRow]) -> Section:
    """Return the results as a table."""
    cells: list[Row] = [
        {
            "rate [Hz]": str(row.rate),
            "busy cores": str(row.busy),
            "timer lateness [ms]": str(row.lateness),
            "answer latency [ms]": str(row.latency),
            "tick [ms]": str(row.tick),
            "tick p99 / period [%]": 100.0 * row.share,
            "missed ticks": str(row.missed),
            "unanswered": str(row.unanswered),
            "ticks": str(row.ticks),
            "load [%]": 100.0 * row.load,
        }
        for row in rows
    ]
    return Section("node", "Controller node", NODE_NOTE, cells)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
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
    rows = [measure_rate(rate, chosen.seconds, n) for n in chosen.busy for rate in chosen.rates]
    show(node_section(rows), Console(width=WIDTH))
    content = [
        {k: v._asdict() if isinstance(v, Spread) else v for k, v in row._asdict().items()}
        for row in rows
    ]
    chosen.output.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
