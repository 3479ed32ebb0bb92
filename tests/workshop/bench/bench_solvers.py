"""The exact solver alone and the whole tick, compared with other tools."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ampc_msgs_config.types import Array
from tests.workshop.bench.bench_ours import GAINS, qp_inside
from tests.workshop.bench.bench_problems import KINDS, Problem, problems
from tests.workshop.bench.bench_qp import (
    SOLVERS,
    WRONG,
    Solver,
    daqp_inside,
    installed,
    missing,
)
from tests.workshop.bench.bench_report import Row, Section
from tests.workshop.bench.bench_ticks import whole_ticks
from tests.workshop.bench.bench_timing import Entrant, Timing, interleaved, statistics, timing_cells

REPEATS = 50
"""Number of solutions of one call inside compiled code."""
INSIDE, OWN_CLOCK = "ours, inside the compiled tick", "DAQP, by its own clock"
SHARES = ("wrong in all [%]", "move off [%]", "no answer [%]", "infeasible undetected [%]")


def measure(*, quick: bool) -> list[Section]:
    """Return the tables of this part."""
    count, rounds = (4, 2) if quick else (100, 30)
    return [*qp_alone(problems(count), rounds), whole_ticks(count, rounds)]


def qp_alone(task: Sequence[Problem], rounds: int) -> list[Section]:
    """Measure all solvers on the same problems."""
    solvers = [solver for solver in SOLVERS if installed(solver.package)]
    calls = {solver.name: [solver.prepare(p.qp) for p in task] for solver in solvers}
    shares = {name: wrong_shares(task, [call() for call in calls[name]]) for name in calls}
    few = max(1, rounds // 10)
    entrants = {s.name: Entrant(calls[s.name], few if s.slow else rounds) for s in solvers}
    entrants[INSIDE] = Entrant([qp_inside(p.qp, REPEATS) for p in task], rounds)
    times = interleaved(entrants)
    times[INSIDE] /= REPEATS
    timings = {name: statistics(t) for name, t in times.items()}
    rows = [qp_row(s, timings[s.name], timings["DAQP"], shares[s.name]) for s in solvers]
    rows.append(inside_row(INSIDE, "active_set, no call from Python", timings))
    timings[OWN_CLOCK] = statistics(daqp_inside([p.qp for p in task], few))
    rows.append(inside_row(OWN_CLOCK, "its setup_time + solve_time, no call from Python", timings))
    return [
        Section("qp", "QP alone", note_on_problems(task), rows),
        Section("qp_kinds", "QP alone, medians by kind of problem", "", by_kind(task, times)),
    ]


def note_on_problems(task: Sequence[Problem]) -> str:
    """Return the conditions of the measurement."""
    return (
        f"{len(task) // len(KINDS)} quadratic programs of each kind ({', '.join(KINDS)}), all from "
        f"closed loops of {GAINS[:3]}. Timed is one call on matrices in the form that the "
        "solver needs. Wrong: first move off by more than 1 mrad, no answer, or an infeasible "
        f"problem not detected. References: error below {max(p.doubt for p in task):.0e} rad. "
    ) + missing({solver.package for solver in SOLVERS})


def by_kind(task: Sequence[Problem], times: dict[str, Array]) -> list[Row]:
    """Return the medians of each kind of problem [us]."""
    rows: list[Row] = []
    for kind in KINDS:
        of = [i for i, problem in enumerate(task) if problem.kind == kind]
        active = float(np.median([task[i].active for i in of]))
        medians = {f"{name} [us]": float(np.median(t[:, of])) for name, t in times.items()}
        rows.append({"kind": kind, "active rows": active, **medians})
    return rows


def wrong_shares(task: Sequence[Problem], answers: Sequence[Any]) -> Row:
    """Return the shares of wrong answers [%]."""
    wrong, silent, undetected = 0, 0, 0
    for problem, x in zip(task, answers, strict=True):
        if math.isnan(problem.move):
            undetected += x is not None
        elif x is None:
            silent += 1
        else:
            wrong += not abs(problem.L_0 @ x - problem.move) < WRONG
    share = 100.0 / len(task)
    counts = (wrong + silent + undetected, wrong, silent, undetected)
    return {name: share * n for name, n in zip(SHARES, counts, strict=True)}


def qp_row(solver: Solver, timing: Timing, daqp: Timing, shares: Row) -> Row:
    """Return one row of the first table."""
    return {"solver": solver.name, "timed": solver.call, **timing_cells(timing, daqp), **shares}


def inside_row(name: str, timed: str, timings: dict[str, Timing]) -> Row:
    """Return a row of durations without the call from Python and without answers of its own."""
    cells = timing_cells(timings[name], timings["DAQP"])
    return {"solver": name, "timed": timed, **cells, **dict.fromkeys(SHARES)}
