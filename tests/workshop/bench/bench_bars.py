"""What was asked for beside what was measured: one row for each bar, and on which basis."""

from collections.abc import Callable, Sequence

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
"""How many times faster the tick should be."""
NOTE = (
    "Ratios of medians of this run. CasADi twice: multiple shooting is how its examples write an "
    "MPC; condensed is the same with the states eliminated by hand and with Laguerre functions, "
    "as ours has it."
)


def bars(sections: Sequence[Section]) -> list[Section]:
    """Judge what was measured; nothing where no bar belongs to it."""
    judges: dict[str, Callable[[list[Row]], list[Row]]] = {
        "qp": of_qp,
        "tick": of_tick,
        "swarm_paper": lambda rows: of_swarm("paper", rows),
        "swarm_preview": lambda rows: of_swarm("preview", rows),
        "scaling": of_scaling,
        "node": of_node,
    }
    rows = [row for s in sections if s.key in judges for row in judges[s.key](s.rows)]
    return [Section("bars", "Bars", NOTE, rows)] if rows else []


def judged(what: str, basis: str, value: float, bar: str, detail: str = "") -> Row:
    """Give a row; the bar is `<=` or `>=`, and a number."""
    sign, number = bar.split()[:2]
    limit = float(number.replace(",", ""))
    held = value <= limit if sign == "<=" else value >= limit
    measured = f"{text(value)} ({detail})" if detail else text(value)
    cells = {"what": what, "basis": basis, "measured": measured, "bar": bar}
    return cells | {"held": "yes" if held else "no"}


def named(rows: list[Row]) -> dict[str, Row]:
    """Rows by their first cell."""
    return {next(iter(row.values())): row for row in rows}


def ratio(what: str, basis: str, bar: str, of: Row, to: Row) -> Row:
    """Judge a ratio of medians."""
    detail = f"{text(of[MEDIAN])} / {text(to[MEDIAN])} us"
    return judged(what, basis, of[MEDIAN] / to[MEDIAN], bar, detail)


def of_qp(rows: list[Row]) -> list[Row]:
    """Judge the solver; a tick never calls it from Python."""
    found, what = named(rows), "exact QP / DAQP"
    daqp, clock, inside = found["DAQP"], found[OWN_CLOCK], found[QP_INSIDE]
    right = 100.0 - found["ours"]["wrong in all [%]"]
    return [
        judged("QP right, or detected as infeasible [%]", "all kinds", right, ">= 100"),
        ratio(what, PYTHON, "<= 0.7", found["ours"], daqp),
        ratio(what, f"{COMPILED}, `daqp.solve` from Python", "<= 0.7", inside, daqp),
        ratio(what, f"{COMPILED}, DAQP by its own clock", "<= 0.7", inside, clock),
    ]


def of_tick(rows: list[Row]) -> list[Row]:
    """Judge the tick, and what users would take instead."""
    found, what = named(rows), "whole tick / `daqp.solve` alone"
    ours, inside, daqp = found["ours"], found[TICK_INSIDE], found[DAQP_ALONE]
    closed_loop = found[FULL]
    judgements = [
        ratio(what, PYTHON, "<= 1.5", ours, daqp),
        ratio(what, f"{COMPILED}, `daqp.solve` from Python", "<= 1.5", inside, daqp),
    ]
    for name, bar in COMPETITORS:
        if name in found:
            judgements.append(faster(name, found[name], ours, bar))
    what = "p99 / median of the tick"
    problems = "p99 of problems / median"
    return [
        *judgements,
        judged(what, "ticks of closed loops, medians of each", closed_loop[problems], "<= 2"),
        judged(what, "half of them disturbed, medians of each", ours[problems], "<= 2"),
        judged(what, "the same, inside compiled code", inside[problems], "<= 2"),
        judged(what, "half of them disturbed, all calls", ours["p99 / median"], "<= 2"),
    ]


def faster(name: str, other: Row, ours: Row, bar: int) -> Row:
    """Judge how many times faster ours is."""
    detail = f"{text(other[MEDIAN])} us, wrong in {text(other[WRONG])} %"
    times = other[MEDIAN] / ours[MEDIAN]
    return judged(f"times faster than {name}", PYTHON, times, f">= {bar}", detail)


def of_swarm(formulation: str, rows: list[Row]) -> list[Row]:
    """Judge the closed loop of 20 cars."""
    what = f"closed loop, `{formulation}`, 20 cars, 5 ms: ticks per second and core"
    return [judged(what, "inside compiled code", named(rows)["20"]["5 ms"], ">= 60,000")]


def of_scaling(rows: list[Row]) -> list[Row]:
    """Judge the second thread."""
    value = named(rows)["2 threads"]["times one"]
    return [judged("two threads, times one", "two free cores", value, ">= 1.6")]


def of_node(rows: list[Row]) -> list[Row]:
    """Judge the node at 100 Hz beside a busy core."""
    basis = "over ROS, one core busy"
    return [
        judgement
        for row in rows
        if (row["rate [Hz]"], row["busy cores"]) == ("100", "1")
        for judgement in (
            judged("node at 100 Hz: missed ticks", basis, int(row["missed ticks"]), "<= 0"),
            judged("its tick's p99 / period [%]", basis, row["tick p99 / period [%]"], "<= 2"),
        )
    ]
