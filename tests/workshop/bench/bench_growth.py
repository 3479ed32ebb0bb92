"""Growth of tick and solver with horizon, Laguerre terms and rows."""

import math
from collections.abc import Iterable
from functools import partial

import numpy as np

from ampc_ros.mpc.gain_table import Gains
from ampc_ros.paper.qp_assembly import StepInput
from tests.workshop.bench.bench_ours import GAINS, Task, qp_alone, qp_of, whole_tick
from tests.workshop.bench.bench_problems import perturbed, recorded_ticks
from tests.workshop.bench.bench_qp import with_daqp
from tests.workshop.bench.bench_report import Row, Section
from tests.workshop.bench.bench_timing import Call, Entrant, interleaved

COUNT = 40
"""Number of ticks of each size."""
SERIES = ("our tick [us]", "our QP [us]", "daqp.solve [us]")
HORIZON, TERMS, ROWS = "horizon N_p", "Laguerre terms N", "rows (two-sided)"
AXES: dict[str, dict[int, Gains]] = {
    HORIZON: {
        n: GAINS._replace(prediction_horizon=n, control_horizon=min(n, 15))
        for n in (10, 15, 20, 30, 45, 60, 80, 100)
    },
    TERMS: {n: GAINS._replace(laguerre_terms=n, laguerre_pole=0.5) for n in (2, 3, 4, 5, 6, 8, 10)},
    ROWS: {
        2 * n: GAINS._replace(prediction_horizon=100, control_horizon=n)
        for n in (15, 20, 30, 50, 70, 100)
    },
}
"""Varied quantity and the gains of each size, all well-conditioned."""
HELD = {
    HORIZON: f"N_c = 15, at most N_p; N = {GAINS.laguerre_terms}",
    TERMS: "N_p = 45, N_c = 15, pole 0.5",
    ROWS: f"N_c = rows / 2, N_p = 100, N = {GAINS.laguerre_terms}",
}


def measure(*, quick: bool) -> list[Section]:
    """Return one table for each varied quantity."""
    rng = np.random.default_rng(3)
    recorded = recorded_ticks()
    count = 4 if quick else COUNT
    ticks = [perturbed(recorded[i], rng) for i in rng.integers(len(recorded), size=count)]
    return [grown(axis, ticks, 1 if quick else 30) for axis in AXES]


def grown(axis: str, ticks: list[StepInput], rounds: int) -> Section:
    """Measure all sizes of one quantity, interleaved."""
    entrants = {
        (size, series): Entrant(calls, rounds)
        for size, gains in AXES[axis].items()
        for series, calls in calls_of(gains, ticks).items()
    }
    named = {f"{size} {series}": entrant for (size, series), entrant in entrants.items()}
    times = interleaved(named)
    rows: list[Row] = []
    for size in AXES[axis]:
        medians = {name: float(np.median(times[f"{size} {name}"])) for name in SERIES}
        ratio = medians[SERIES[1]] / medians[SERIES[2]]
        rows.append({axis: str(size), **medians, "our QP / daqp.solve": ratio})
    powers = ", ".join(f"{name[:-5]} {power:.2f}" for name, power in exponents(axis, rows).items())
    note = f"Medians over {len(ticks)} perturbed ticks; {HELD[axis]}. Exponents: {powers}."
    return Section(f"growth_{axis.split()[0]}", f"Growth with {axis}", note, rows)


def calls_of(gains: Gains, ticks: Iterable[StepInput]) -> dict[str, list[Call]]:
    """Return the timed calls of one size."""
    tasks = [Task(gains, math.inf, tick) for tick in ticks]
    problems = [qp_of(task) for task in tasks]
    answer, (tick, qp, daqp) = whole_tick(gains), SERIES
    return {
        tick: [partial(answer, task.tick) for task in tasks],
        qp: [qp_alone(problem) for problem in problems],
        daqp: [with_daqp(problem) for problem in problems],
    }


def exponents(axis: str, rows: list[Row]) -> dict[str, float]:
    """Fit the exponent k of time ~ size^k to each series."""
    size = np.log([float(row[axis]) for row in rows])
    return {
        name: float(np.polyfit(size, np.log([row[name] for row in rows]), 1)[0]) for name in SERIES
    }
