"""How long the controller node takes from its start to `ready`, with and without compiled code."""

import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time

from launch_scripts.run.environment import ros_environment
from tests.workshop.bench.bench_report import Row, Section

NOTE = (
    "Wall time from the start of the process to its line `ready`; after that nothing is compiled. "
    "Cold: compiled code of no version at hand; warm: median of {runs} starts."
)
CONTROLLERS = ("preview", "paper")


def measure(*, quick: bool) -> list[Section]:
    """Give one table: a row for each formulation."""
    runs = 1 if quick else 7
    rows = [row_of(name, runs) for name in CONTROLLERS[: 1 if quick else None]]
    return [Section("start", "Start of the node", NOTE.format(runs=runs), rows)]


def row_of(controller: str, runs: int) -> Row:
    """Start the node once without compiled code, then some times with it [s]."""
    with tempfile.TemporaryDirectory() as cache:
        cold = seconds_to_ready(controller, cache)
        warm = [seconds_to_ready(controller, cache) for _ in range(runs)]
    return {
        "controller": controller,
        "cold [s]": cold,
        "warm [s]": statistics.median(warm),
        "warm, slowest [s]": max(warm),
    }


def seconds_to_ready(controller: str, cache: str) -> float:
    """Start the node with this cache of compiled code, and end it once it is ready.

    Raises:
        RuntimeError: It ended before; the message holds what it said.
    """
    environment = {**ros_environment(), "XDG_CACHE_HOME": cache}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-m", "ampc_ros.nodes.controller_node"]
    command += ["--ros-args", "-p", f"controller:={controller}"]
    begin, said = time.monotonic(), ""
    node = subprocess.Popen(
        command, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        for line in node.stdout or ():
            said += line
            if line.rstrip().endswith(": ready"):
                return time.monotonic() - begin
    finally:
        os.kill(node.pid, signal.SIGKILL)
        node.wait()
    raise RuntimeError(f"controller: ended before it was ready: {said.strip()[-500:]}")
