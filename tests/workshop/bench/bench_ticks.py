"""The whole tick: AMPC compared with the same controller built with other tools."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ampc_ros.mpc.gain_table import Gains
from ampc_ros.paper.qp_assembly import StepInput
from tests.workshop.bench.bench_mpc import (
    PROXIMAL,
    QUIET,
    Answer,
    casadi_qp,
    do_mpc_controller,
    multiple_shooting,
    numpy_daqp,
)
from tests.workshop.bench.bench_ours import (
    GAINS,
    Task,
    full_steps,
    laguerre,
    qp_of,
    tick_inside,
    whole_tick,
)
from tests.workshop.bench.bench_problems import SCENARIOS, drive_scenario, perturbed, recorded_ticks
from tests.workshop.bench.bench_qp import WRONG, exact_move, installed, missing, with_daqp
from tests.workshop.bench.bench_report import Row, Section
from tests.workshop.bench.bench_timing import Entrant, Timing, interleaved, statistics, timing_cells

FREE = Gains(45, 45, 45, 0.0, GAINS.output_weight, GAINS.increment_weight)
"""One increment for each step: with pole 0 and N = N_c, L is the identity."""
FIRST = Gains(45, 15, 15, 0.0, GAINS.output_weight, GAINS.increment_weight)
"""One increment for each of the first 15 steps, zero afterwards."""
DAQP_ALONE, FULL, INSIDE = "DAQP alone", "ours, state to command", "ours, inside a fleet"
REPEATS = 50
"""Number of ticks of one call inside compiled code."""
BESIDES = {
    DAQP_ALONE: "for comparison: daqp.solve, no model",
    INSIDE: "the same, without the call from Python",
    FULL: "also position on the path, set-point, gain table, memory, diagnosis (recorded ticks)",
}
Maker = Callable[[], Answer]


class Tool(NamedTuple):
    """A controller of the table of whole ticks."""

    name: str
    package: str
    """Required package."""
    inside: str
    """Description of a tick."""
    make: Maker
    gains: Gains = GAINS
    """Gains of the problem that it solves."""
    slow: bool = False
    """True for fewer repetitions."""


def ours() -> Answer:
    """Return the tick of AMPC."""
    return whole_tick(GAINS)


TOOLS = (
    Tool("ours", "numba", "model, prediction, rows, active set: one compiled call", ours),
    Tool("NumPy + DAQP", "daqp", "expm, prediction and cost in NumPy; daqp.solve", numpy_daqp),
    Tool(
        "CasADi + DAQP, multiple shooting",
        "casadi",
        "as in its examples: qpsol built once, sparse, 45 states and 15 free increments; "
        "parameters v, x, u, r; eps_prox 1e-4",
        partial(multiple_shooting, "daqp", PROXIMAL),
        FIRST,
        slow=True,
    ),
    Tool(
        "CasADi + OSQP, multiple shooting",
        "casadi",
        "the same with OSQP, its default settings",
        partial(multiple_shooting, "osqp", QUIET),
        FIRST,
        slow=True,
    ),
    Tool(
        "CasADi + DAQP, condensed",
        "casadi",
        "qpsol built once, condensed in the Laguerre coefficients; parameters v, x, u, r",
        partial(casadi_qp, "daqp", {}),
    ),
    Tool(
        "CasADi + OSQP, condensed",
        "casadi",
        "the same with OSQP, its default settings",
        partial(casadi_qp, "osqp", QUIET),
    ),
    Tool(
        "do-mpc",
        "do_mpc",
        "expm; 45 free increments (no Laguerre functions), IPOPT, default settings",
        do_mpc_controller,
        FREE,
        slow=True,
    ),
)


def whole_ticks(count: int, rounds: int) -> Section:
    """Measure all controllers on the same ticks."""
    ticks, rng = recorded_ticks(), np.random.default_rng(2)
    chosen = np.linspace(0, len(ticks) - 1, count).astype(int)
    task = [ticks[i] for i in chosen]
    task += [perturbed(tick, rng) for tick in task]
    tools = {tool.name: tool for tool in TOOLS if installed(tool.package)}
    answers = {name: tool.make() for name, tool in tools.items()}
    right = {
        gains: [exact_first_move(gains, tick) for tick in task] for gains in (GAINS, FIRST, FREE)
    }
    shares = {name: share_wrong(answers[name], task, right[tools[name].gains]) for name in tools}
    few = max(1, rounds // 10)
    entrants = {
        name: Entrant([partial(answers[name], tick) for tick in task], few if tool.slow else rounds)
        for name, tool in tools.items()
    }
    entrants[DAQP_ALONE] = Entrant(
        [with_daqp(qp_of(Task(GAINS, math.inf, tick))) for tick in task], rounds
    )
    full = [call for name in SCENARIOS for call in full_steps(*drive_scenario(name))]
    entrants[FULL] = Entrant(2 * [full[i] for i in chosen], rounds)
    inside = [tick_inside(GAINS, tick, REPEATS) for tick in task]
    entrants[INSIDE] = Entrant(inside, rounds)
    durations = interleaved(entrants)
    durations[INSIDE] /= REPEATS
    times = {name: statistics(t) for name, t in durations.items()}
    return Section("tick", "Whole tick", note_on_ticks(len(task)), tick_rows(times, tools, shares))


def tick_rows(
    times: Mapping[str, Timing], tools: Mapping[str, Tool], shares: Mapping[str, float]
) -> list[Row]:
    """Return the rows of the table of whole ticks."""
    return [
        {
            "controller": name,
            "a tick contains": tools[name].inside if name in tools else BESIDES[name],
            **timing_cells(timing, times[DAQP_ALONE]),
            "times ours": timing.median / times["ours"].median,
            "times ours inside": timing.median / times[INSIDE].median,
            "wrong [%]": shares.get(name),
        }
        for name, timing in times.items()
    ]


def note_on_ticks(count: int) -> str:
    """Return the conditions of the measurement."""
    return (
        f"{count} ticks, half recorded, half perturbed: from speed, state, angle in force and set-"
        "point to the first move. All: the same model, horizon 45, weights and bounds, rebuilt in "
        "each tick because the speed changes; wrong: more than 1 mrad off the exact answer of the "
        "problem that the tool solves. " + missing({tool.package for tool in TOOLS})
    )


def exact_first_move(gains: Gains, tick: StepInput) -> float:
    """Return the exact first move [rad]."""
    return exact_move(qp_of(Task(gains, math.inf, tick)), laguerre(gains)[0])[0]


def share_wrong(answer: Answer, task: Sequence[StepInput], right: Sequence[float]) -> float:
    """Return the share of wrong or missing answers [%]."""
    moves = [answer(tick) for tick in task]
    wrong = [
        move is None or not abs(move - exact) < WRONG
        for move, exact in zip(moves, right, strict=True)
    ]
    return 100.0 * float(np.mean(wrong))
