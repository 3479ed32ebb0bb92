"""Part (a): the exact solver and the whole tick against what users would take instead."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ampc_ros.gain_table import Gains
from ampc_ros.lateral_mpc import Tick
from launch_scripts.bench_mpc import Answer, casadi_qp, do_mpc_controller, numpy_daqp
from launch_scripts.bench_ours import GAINS, Task, full_steps, laguerre, posed, whole_tick
from launch_scripts.bench_problems import (
    KINDS,
    SCENARIOS,
    Problem,
    drive_scenario,
    perturbed,
    problems,
    recorded_ticks,
)
from launch_scripts.bench_qp import SOLVERS, Solver, installed, with_daqp
from launch_scripts.bench_reference import exact_move
from launch_scripts.bench_report import Row, Section
from launch_scripts.bench_timing import Entrant, Timing, interleaved, statistics

WRONG = 1e-3
"""Error of the first move that counts as a wrong answer [rad]."""
FREE = Gains(45, 45, 45, 0.0, GAINS.output_weight, GAINS.increment_weight)
"""One increment for each step: pole 0 and as many terms as steps make L the identity."""
DAQP_ALONE, FULL = "DAQP alone", "ours, state to command"
BESIDES = {
    DAQP_ALONE: "for comparison: daqp.solve, no model",
    FULL: "besides: place on the path, set-point, gain table, memory, diagnosis (recorded ticks)",
}
Maker = Callable[[], Answer]


class Tool(NamedTuple):
    """One row of the table of whole ticks."""

    name: str
    package: str
    """That has to be installed."""
    inside: str
    """What a tick contains."""
    make: Maker
    gains: Gains = GAINS
    """Of the problem that it solves."""
    slow: bool = False
    """Goes through the problems once."""


def ours() -> Answer:
    """Our tick."""
    return whole_tick(GAINS)


TOOLS = (
    Tool("ours", "numba", "model, prediction, rows, active set: one compiled call", ours),
    Tool("NumPy + DAQP", "daqp", "expm, prediction and cost in NumPy; daqp.solve", numpy_daqp),
    Tool(
        "CasADi + DAQP",
        "casadi",
        "qpsol built once, condensed in the Laguerre coefficients; parameters v, x, u, r",
        partial(casadi_qp, "daqp", {}),
    ),
    Tool(
        "CasADi + OSQP",
        "casadi",
        "the same with OSQP, its default settings",
        partial(casadi_qp, "osqp", {"osqp": {"verbose": False}}),
    ),
    Tool(
        "do-mpc",
        "do_mpc",
        "expm; 45 free increments (it knows no Laguerre functions), IPOPT, default settings",
        do_mpc_controller,
        FREE,
        slow=True,
    ),
)


def measure(*, quick: bool) -> list[Section]:
    """Give the tables of this part."""
    count, rounds = (4, 2) if quick else (100, 30)
    return [*qp_alone(count, rounds), whole_ticks(count, rounds)]


def qp_alone(count: int, rounds: int) -> list[Section]:
    """Measure solvers on the same programmes."""
    task = problems(count)
    solvers = [solver for solver in SOLVERS if installed(solver.package)]
    calls = {solver.name: [solver.prepare(p.qp) for p in task] for solver in solvers}
    verdicts = {name: verdict(task, [call() for call in calls[name]]) for name in calls}
    slow = max(1, rounds // 10)
    rounds_of = {s.name: slow if s.name.startswith("OSQP") else rounds for s in solvers}
    times = interleaved({name: Entrant(calls[name], rounds_of[name]) for name in calls})
    rows = [
        qp_row(s, statistics(times[s.name]), statistics(times["DAQP"]), verdicts[s.name])
        for s in solvers
    ]
    note = (
        f"{count} programmes of each kind ({', '.join(KINDS)}), all from closed loops of "
        f"{GAINS[:3]}. Timed is one call on matrices that already have the form which the solver "
        "wants. Wrong: first move off by more than 1 mrad, no answer, or an infeasible programme "
        f"not detected. References: error below {max(p.doubt for p in task):.0e} rad. "
        + missing({s.package for s in SOLVERS})
    )
    active = [p.active for p in task]
    by_kind = [
        {"kind": kind, "active rows, median": float(np.median(of(kind, task, active)))}
        | {f"{name} [us]": statistics(of(kind, task, times[name].T).T).median for name in times}
        for kind in KINDS
    ]
    return [
        Section("qp", "QP alone", note, rows),
        Section("qp_kinds", "QP alone, medians by kind of programme", "", by_kind),
    ]


def of(kind: str, task: Sequence[Problem], values: Any) -> Any:
    """Those of the values that belong to programmes of a kind."""
    return np.array([value for p, value in zip(task, values, strict=True) if p.kind == kind])


def verdict(task: Sequence[Problem], answers: Sequence[Any]) -> Row:
    """Give the shares of wrong answers [%]."""
    wrong, silent, undetected = 0, 0, 0
    for problem, x in zip(task, answers, strict=True):
        if math.isnan(problem.move):
            undetected += x is not None
        elif x is None:
            silent += 1
        else:
            wrong += not abs(problem.L_0 @ x - problem.move) < WRONG
    share = 100.0 / len(task)
    return {
        "wrong in all [%]": share * (wrong + silent + undetected),
        "move off [%]": share * wrong,
        "no answer [%]": share * silent,
        "infeasible undetected [%]": share * undetected,
    }


def timing_cells(timing: Timing, unit: Timing) -> Row:
    """Give medians, tails and ratios."""
    return {
        "median [us]": timing.median,
        "p99 [us]": timing.p99,
        "median / DAQP": timing.median / unit.median,
        "p99 / median": timing.p99 / timing.median,
        "p99 of problems / median": timing.p99_of_problems / timing.median,
    }


def qp_row(solver: Solver, timing: Timing, daqp: Timing, shares: Row) -> Row:
    """Give one row of the first table."""
    return {"solver": solver.name, "timed": solver.call, **timing_cells(timing, daqp), **shares}


def whole_ticks(count: int, rounds: int) -> Section:
    """Measure controllers built with other tools on the same ticks."""
    ticks, rng = recorded_ticks(), np.random.default_rng(2)
    chosen = np.linspace(0, len(ticks) - 1, count).astype(int)
    task = [ticks[i] for i in chosen]
    task += [perturbed(tick, rng) for tick in task]
    tools = {tool.name: tool for tool in TOOLS if installed(tool.package)}
    answers = {name: tool.make() for name, tool in tools.items()}
    right = {gains: [move(gains, tick) for tick in task] for gains in (GAINS, FREE)}
    shares = {name: share_wrong(answers[name], task, right[tools[name].gains]) for name in tools}
    entrants = {
        name: Entrant([partial(answers[name], tick) for tick in task], 1 if tool.slow else rounds)
        for name, tool in tools.items()
    }
    entrants[DAQP_ALONE] = Entrant(
        [with_daqp(posed(Task(GAINS, math.inf, tick))) for tick in task], rounds
    )
    full = [call for name in SCENARIOS for call in full_steps(*drive_scenario(name))]
    entrants[FULL] = Entrant(2 * [full[i] for i in chosen], rounds)
    times = {name: statistics(t) for name, t in interleaved(entrants).items()}
    return Section("tick", "Whole tick", note_on_ticks(len(task)), tick_rows(times, tools, shares))


def tick_rows(
    times: Mapping[str, Timing], tools: Mapping[str, Tool], shares: Mapping[str, float]
) -> list[Row]:
    """Give the rows of the table of whole ticks."""
    return [
        {
            "controller": name,
            "a tick contains": tools[name].inside if name in tools else BESIDES[name],
            **timing_cells(timing, times[DAQP_ALONE]),
            "times ours": timing.median / times["ours"].median,
            "wrong [%]": shares.get(name),
        }
        for name, timing in times.items()
    ]


def note_on_ticks(count: int) -> str:
    """Say what all have to do."""
    return (
        f"{count} ticks, half recorded, half perturbed: from speed, state, angle in force and set-"
        "point to the first move. All: the same model, horizon 45, weights and bounds, anew in "
        "each tick as the speed changes; wrong: more than 1 mrad off the exact answer of the "
        "problem that the tool poses. " + missing({tool.package for tool in TOOLS})
    )


def missing(packages: set[str]) -> str:
    """Say who could not take part."""
    absent = sorted(package for package in packages if not installed(package))
    return f"Not installed, left out: {', '.join(absent)}." if absent else ""


def move(gains: Gains, tick: Tick) -> float:
    """Right first move [rad]."""
    return exact_move(posed(Task(gains, math.inf, tick)), laguerre(gains)[0])[0]


def share_wrong(answer: Answer, task: Sequence[Tick], right: Sequence[float]) -> float:
    """Share of wrong answers, or none given [%]."""
    given = [answer(tick) for tick in task]
    wrong = [
        move is None or not abs(move - exact) < WRONG
        for move, exact in zip(given, right, strict=True)
    ]
    return 100.0 * float(np.mean(wrong))
