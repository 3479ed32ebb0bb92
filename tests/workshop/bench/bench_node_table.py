"""Part (e): the controller node, measured by `bench_node`, as a table of the report."""

import importlib
from typing import Any

from tests.workshop.bench.bench_report import Row, Section

SECONDS = {(rate, busy): 30.0 for rate in (10, 50, 100) for busy in (0, 1)} | {(100, 1): 60.0}
"""Wall time of each measurement, by rate [Hz] and busy cores."""
NOTE = (
    "The node as a process of its own, a second process as the car; 30 s each, 60 s at 100 Hz with "
    "a busy core. Timer lateness, and the way from state to command over ROS, in ms: median / p99 "
    "/ largest."
)


def measure(*, quick: bool) -> list[Section]:
    """Give one table: a row for each rate, idle and with one busy core."""
    node = importlib.import_module("tests.workshop.bench.bench_node")  # brings ROS along
    cases = {(10, 0): 2.0} if quick else SECONDS
    rows = [row_of(node.measure(rate, time, busy)) for (rate, busy), time in cases.items()]
    return [Section("node", "Controller node", NOTE, rows)]


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
