"""Part (e): the controller node, measured by `bench_node`, as a table of the report."""

import importlib
from typing import Any

from launch_scripts.bench_report import Row, Section

NOTE = (
    "The node as a process of its own, a second process as the car; {seconds:g} s each. Timer "
    "lateness, and the way from state to command over ROS, in ms: median / p99 / largest."
)


def measure(*, quick: bool) -> list[Section]:
    """Give one table: a row for each rate, idle and with one busy core."""
    rates, seconds, busy = ((10,), 2.0, (0,)) if quick else ((10, 50, 100), 60.0, (0, 1))
    node = importlib.import_module("launch_scripts.bench_node")  # brings ROS along
    rows = [row_of(found) for found in node.measure_node(rates, seconds, busy)]
    return [Section("node", "Controller node", NOTE.format(seconds=seconds), rows)]


def row_of(found: Any) -> Row:
    """Give the cells of a `bench_node.NodeRow`."""
    spreads = {
        "timer lateness [ms]": found.lateness,
        "answer latency [ms]": found.latency,
        "tick [ms]": found.tick,
    }
    return {
        "rate [Hz]": str(found.rate),
        "busy cores": str(found.busy),
        **{name: " / ".join(f"{value:.2f}" for value in v) for name, v in spreads.items()},
        "tick p99 / period [%]": 100.0 * found.share,
        "missed ticks": str(found.missed),
        "unanswered": str(found.unanswered),
        "ticks": str(found.ticks),
    }
