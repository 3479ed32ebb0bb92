"""Thresholds of the benchmark: required and measured values, one row for each threshold."""

from collections.abc import Callable, Sequence

from tests.workshop.bench.bench_node import CONTROLLERS, EMPTY
from tests.workshop.bench.bench_processes import CPU_LIMITS, MEMORY_LIMITS
from tests.workshop.bench.bench_report import Row, Section, text
from tests.workshop.bench.bench_solvers import INSIDE as QP_INSIDE
from tests.workshop.bench.bench_solvers import OWN_CLOCK
from tests.workshop.bench.bench_ticks import DAQP_ALONE, FULL
from tests.workshop.bench.bench_ticks import INSIDE as TICK_INSIDE

PYTHON, COMPILED = "both called from Python", "ours inside compiled code"
MEDIAN, WRONG = "median [us]", "wrong [%]"
COMPETITORS = (
    ("CasADi + DAQP, multiple shooting", 20),
    ("CasADi + DAQP, condensed", 20),
    ("CasADi + OSQP, multiple shooting", 30),
    ("CasADi + OSQP, condensed", 30),
    ("do-mpc", 1000),
)
"""Required ratios of the duration of other controllers to that of the tick."""
NOTE = (
    "Ratios of medians of this run. CasADi appears twice: multiple shooting follows its MPC "
    "examples; condensed is the same problem with the states eliminated and with Laguerre "
    "functions, as in AMPC."
)


def threshold_table(sections: Sequence[Section]) -> list[Section]:
    """Return the table of thresholds; empty if no threshold applies."""
    evaluations: dict[str, Callable[[list[Row]], list[Row]]] = {
        "qp": of_qp,
        "tick": of_tick,
        "swarm_paper": lambda rows: of_swarm("paper", rows),
        "swarm_preview": lambda rows: of_swarm("preview", rows),
        "scaling": of_scaling,
        "node": of_node,
        "processes": of_processes,
        "start": of_start,
        "inputs": of_inputs,
    }
    rows = [row for s in sections if s.key in evaluations for row in evaluations[s.key](s.rows)]
    return [Section("thresholds", "Thresholds", NOTE, rows)] if rows else []


def compare(what: str, basis: str, value: float, threshold: str, detail: str = "") -> Row:
    """Return a row; a threshold is `<=` or `>=` and a number."""
    sign, number = threshold.split()[:2]
    limit = float(number.replace(",", ""))
    met = value <= limit if sign == "<=" else value >= limit
    measured = f"{text(value)} ({detail})" if detail else text(value)
    cells = {"what": what, "basis": basis, "measured": measured, "threshold": threshold}
    return cells | {"met": "yes" if met else "no"}


def named(rows: list[Row]) -> dict[str, Row]:
    """Return rows by their first cell."""
    return {next(iter(row.values())): row for row in rows}


def compare_medians(what: str, basis: str, threshold: str, of: Row, to: Row) -> Row:
    """Compare a ratio of medians with a threshold."""
    detail = f"{text(of[MEDIAN])} / {text(to[MEDIAN])} us"
    return compare(what, basis, of[MEDIAN] / to[MEDIAN], threshold, detail)


def of_qp(rows: list[Row]) -> list[Row]:
    """Compare the solver; a tick never calls it from Python."""
    by_name, what = named(rows), "exact QP / DAQP"
    daqp, clock, inside = by_name["DAQP"], by_name[OWN_CLOCK], by_name[QP_INSIDE]
    right = 100.0 - by_name["ours"]["wrong in all [%]"]
    return [
        compare("QP right, or detected as infeasible [%]", "all kinds", right, ">= 100"),
        compare_medians(what, PYTHON, "<= 0.7", by_name["ours"], daqp),
        compare_medians(what, f"{COMPILED}, `daqp.solve` from Python", "<= 0.7", inside, daqp),
        compare_medians(what, f"{COMPILED}, DAQP by its own clock", "<= 0.7", inside, clock),
    ]


def of_tick(rows: list[Row]) -> list[Row]:
    """Compare the tick with the tools that users would take instead."""
    by_name, what = named(rows), "whole tick / `daqp.solve` alone"
    ours, inside, daqp = by_name["ours"], by_name[TICK_INSIDE], by_name[DAQP_ALONE]
    closed_loop = by_name[FULL]
    comparisons = [
        compare_medians(what, PYTHON, "<= 1.5", ours, daqp),
        compare_medians(what, f"{COMPILED}, `daqp.solve` from Python", "<= 1.5", inside, daqp),
    ]
    for name, threshold in COMPETITORS:
        if name in by_name:
            comparisons.append(ratio_to_tick(name, by_name[name], ours, threshold))
    what = "p99 / median of the tick"
    problems = "p99 of problems / median"
    return [
        *comparisons,
        compare(what, "ticks of closed loops, medians of each", closed_loop[problems], "<= 2"),
        compare(what, "half of them disturbed, medians of each", ours[problems], "<= 2"),
        compare(what, "the same, inside compiled code", inside[problems], "<= 2"),
        compare(what, "half of them disturbed, all calls", ours["p99 / median"], "<= 2"),
    ]


def ratio_to_tick(name: str, other: Row, ours: Row, threshold: int) -> Row:
    """Compare the ratio of another duration to that of the tick."""
    detail = f"{text(other[MEDIAN])} us, wrong in {text(other[WRONG])} %"
    times = other[MEDIAN] / ours[MEDIAN]
    return compare(f"times faster than {name}", PYTHON, times, f">= {threshold}", detail)


def of_swarm(formulation: str, rows: list[Row]) -> list[Row]:
    """Compare the closed loop of 20 cars."""
    what = f"closed loop, `{formulation}`, 20 cars, 5 ms: ticks per second and core"
    return [compare(what, "inside compiled code", named(rows)["20"]["5 ms"], ">= 60,000")]


def of_scaling(rows: list[Row]) -> list[Row]:
    """Compare the second thread."""
    value = named(rows)["2 threads"]["times one"]
    return [compare("two threads, times one", "two free cores", value, ">= 1.6")]


def of_node(rows: list[Row]) -> list[Row]:
    """Compare the node at 100 Hz with one busy core."""
    basis = "over ROS, one core busy"
    return [
        comparison
        for row in rows
        if (row["rate [Hz]"], row["busy cores"]) == ("100", "1")
        for comparison in (
            compare("node at 100 Hz: missed ticks", basis, int(row["missed ticks"]), "<= 0"),
            compare(
                "node at 100 Hz: p99 of the tick / period [%]",
                basis,
                row["tick p99 / period [%]"],
                "<= 2",
            ),
        )
    ]


def of_inputs(rows: list[Row]) -> list[Row]:
    """Compare the processor times of large inputs and help."""
    limits = [(row, row["threshold [s]"]) for row in rows if row["threshold [s]"] is not None]
    return [
        compare(row["what"], "processor time [s]", row["processor time [s]"], f"<= {limit:.3g}")
        for row, limit in limits
    ]


def of_processes(rows: list[Row]) -> list[Row]:
    """Compare processor time and memory of the nodes."""
    comparisons = []
    for row in rows:
        name = row["node"]
        for rate, limits in CPU_LIMITS.items():
            key = f"CPU at {rate} Hz [%]"
            if name in limits and key in row:
                what = f"{name} at {rate} Hz: processor time [%]"
                comparisons.append(
                    compare(what, "drive in real time", row[key], f"<= {limits[name]}")
                )
        limit = f"<= {MEMORY_LIMITS[name]}"
        memory = row["memory [MB]"]
        comparisons.append(compare(f"{name}: resident memory [MB]", "the same", memory, limit))
    return comparisons


def of_start(rows: list[Row]) -> list[Row]:
    """Compare the start of the default controller with that of an empty node."""
    by_name = named(rows)
    ours, empty = by_name[CONTROLLERS[0]], by_name[EMPTY]
    ratio = ours["warm [s]"] / empty["warm [s]"]
    return [
        compare("cold start of the node [s]", "wall time", ours["cold [s]"], "<= 12"),
        compare("cold start of the node [s]", "processor time", ours["cold, CPU [s]"], "<= 20"),
        compare("warm start / that of an empty rclpy node", "wall time", ratio, "<= 1.7"),
    ]
