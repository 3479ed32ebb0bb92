"""Measure processor time and memory of all nodes of a drive in real time: part `processes`."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from launch_scripts.run.processes import ros_environment
from tests.workshop.bench.bench_report import Row, Section

ROOT = Path(__file__).resolve().parents[3]
OPTIONS = {
    10: ("--settings", "table3"),
    100: ("--settings", "100hz", "--gain-table", "preview_100hz"),
}
"""Options of `start.py` by rate [Hz]."""
NODES = ("controller", "planner", "simulator", "recorder", "markers", "gate")
CPU_LIMITS = {
    10: {"controller": 4.0, "planner": 1.5, "simulator": 7.0, "recorder": 4.0, "markers": 1.0},
    100: {"controller": 8.0, "planner": 3.0, "recorder": 6.0},
}
"""Required processor time, by rate [Hz] [% of a core]."""
MEMORY_LIMITS = dict(zip(NODES, (150.0, 100.0, 170.0, 100.0, 90.0, 80.0), strict=True))
"""Required resident memory [MB]."""
START, SECONDS = 5.0, 25.0
"""Wall time from the last node's start to the measurement, and of the measurement [s]."""
TIMEOUT = 180.0
"""Wall time in which all nodes must have started [s]."""
NOTE = (
    "`start.py --scenario sc3_varying --real-time`: processor time over 25 s of driving, resident "
    "memory at their end. An empty rclpy node takes about 62 MB."
)


class Usage(NamedTuple):
    """What a process has used."""

    cpu: float
    """[s]"""
    memory: float
    """Resident [MB]."""


def measure(*, quick: bool) -> list[Section]:
    """Return one table: a row for each node, at 10 and 100 Hz."""
    rates = (10,) if quick else tuple(OPTIONS)
    loads = {rate: measure_rate(rate, 2.0 if quick else SECONDS) for rate in rates}
    rows: list[Row] = []
    for name in NODES:
        row: Row = {"node": name}
        for rate in rates:
            row[f"CPU at {rate} Hz [%]"] = loads[rate][name].cpu
        rows.append(row | {"memory [MB]": max(loads[rate][name].memory for rate in rates)})
    return [Section("processes", "Nodes of a drive in real time", NOTE, rows)]


def measure_rate(rate: int, seconds: float) -> dict[str, Usage]:
    """Drive at a rate [Hz]; return processor time [% of a core] and memory of the nodes.

    Raises:
        RuntimeError: The nodes did not start.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(ROOT / "launch_scripts" / "start.py"), "--real-time"]
        command += ["--scenario", "sc3_varying", "--output", f"{folder}/run", *OPTIONS[rate]]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        drive = subprocess.Popen(command, env=ros_environment(), **quiet)  # type: ignore[call-overload]
        try:
            nodes = wait_for_nodes(drive)
            time.sleep(START)
            before, begin = {name: usage(pid) for name, pid in nodes.items()}, time.monotonic()
            time.sleep(seconds)
            after, took = {n: usage(pid) for n, pid in nodes.items()}, time.monotonic() - begin
        finally:
            drive.terminate()
            drive.wait()
    return {
        name: Usage(100.0 * (after[name].cpu - before[name].cpu) / took, after[name].memory)
        for name in nodes
    }


def wait_for_nodes(drive: "subprocess.Popen[bytes]") -> dict[str, int]:
    """Return the process of each node, when all have started.

    Raises:
        RuntimeError: They did not start in time.
    """
    until = time.monotonic() + TIMEOUT
    while time.monotonic() < until and drive.poll() is None:
        found = {name: pid for pid in children(drive.pid) if (name := node_name(pid)) in NODES}
        if len(found) == len(NODES):
            return found
        time.sleep(0.2)
    raise RuntimeError(f"not all of {', '.join(NODES)} have started")


def children(pid: int) -> list[int]:
    """Return the child processes of a process."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


def node_name(pid: int) -> str:
    """Return the name of the node that a process runs, from its module; '' for others."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
    except OSError:  # it has ended
        return ""
    modules = [word for word in words if word.endswith("_node") and ".nodes." in word]
    name = modules[0].rpartition(".")[2].removesuffix("_node") if modules else ""
    return "markers" if name == "marker" else name


def usage(pid: int) -> Usage:
    """Return what a process has used so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    memory = pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    return Usage(ticks / os.sysconf("SC_CLK_TCK"), memory)
