"""Test functions, search methods and readings of the paper for the benchmark of its swarm."""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import map_vectorized, minimize
from ampc_ros.pso.swarm import Dimension, PsoSettings
from launch_scripts.study.pso_variants import VariantSettings
from launch_scripts.tuning.methods import SearchRecord, has_cma, run_method

PARTICLES, GENERATIONS, SCHEDULE = 20, 41, 100
"""Sizes of the paper's comparison: 41 of 100 generations are shown."""
BUDGET = PARTICLES * (GENERATIONS + 1)
"""Number of evaluations of every method."""
BOUND = 10.0
"""Every dimension is searched within +-10."""
CLAIMED = ("proposed", "linear", "damped", "classic")
"""Variants of the paper's comparison, in the order that it claims."""
REPORTED = {"proposed": 1e-3, "linear": 2.1, "damped": 3.11, "classic": 5.59}
"""Fitness after 41 generations in the text of the paper, one run each."""
READING_VARIANTS = (*CLAIMED, "authors_code")
"""Variants that are measured in every reading of the paper."""
METHOD_STYLES: dict[str, tuple[str, str]] = {
    "proposed": ("#D55E00", "-"),
    "linear": ("#0072B2", "-"),
    "damped": ("#56B4E9", "--"),
    "classic": ("#777777", "-"),
    "Zhan's adaptive": ("#CC79A7", "-"),
    "random": ("#777777", ":"),
    "CMA-ES": ("#009E73", "-"),
    "SciPy's DE": ("#000000", "--"),
    "pso of the tuner": ("#E69F00", "-"),
}
"""Colour (Okabe and Ito) and line style of the methods in figures; tables have all methods."""
Cost = Callable[[Array], Array]
"""Values (n,) at positions (n, d)."""
Method = Callable[[Cost, int, np.random.Generator], Any]
"""Search in a number of dimensions with at least BUDGET evaluations of the cost."""


def sphere(x: Array) -> Array:
    """Compute the paper's function f_1, minimum 0."""
    return np.asarray(np.square(x).sum(axis=1))


def shifted_sphere(x: Array) -> Array:
    """Compute the sphere about (6, -6, 6, ...), where contraction to the centre does not help."""
    return sphere(x - 6.0 * (-1.0) ** np.arange(x.shape[1]))


def ackley(x: Array) -> Array:
    """Compute a wide funnel with shallow local minima, minimum 0."""
    root, waves = np.sqrt(np.square(x).mean(axis=1)), np.cos(2 * math.pi * x).mean(axis=1)
    return np.asarray(20 + math.e - 20 * np.exp(-0.2 * root) - np.exp(waves))


def rosenbrock(x: Array) -> Array:
    """Compute a curved valley, minimum 0 at (1, 1, ...)."""
    along, across = 1 - x[:, :-1], x[:, 1:] - np.square(x[:, :-1])
    return np.asarray((100 * np.square(across) + np.square(along)).sum(axis=1))


def rastrigin(x: Array) -> Array:
    """Compute a bowl with deep local minima at all integers, minimum 0."""
    return np.asarray((10 + np.square(x) - 10 * np.cos(2 * math.pi * x)).sum(axis=1))


class BenchmarkProblem(NamedTuple):
    """A test function in a number of dimensions."""

    function: Cost
    dimensions: int

    @property
    def name(self) -> str:
        """Name in tables."""
        return f"{self.function.__name__.replace('_', ' ')}, n = {self.dimensions}"


PROBLEMS = tuple(
    BenchmarkProblem(function, n)
    for function, dimensions in (
        (sphere, (5, 10, 30)),
        (shifted_sphere, (5,)),
        (ackley, (5, 10)),
        (rosenbrock, (5,)),
        (rastrigin, (5,)),
    )
    for n in dimensions
)


def swarm_search(
    settings: PsoSettings, cost: Cost, dimensions: int, rng: np.random.Generator
) -> None:
    """Search with a swarm of this project."""
    bounds = [Dimension(f"x{k}", -BOUND, BOUND) for k in range(dimensions)]
    minimize(cost, bounds, settings, rng, map_vectorized)


def tuner_search(name: str, cost: Cost, dimensions: int, rng: np.random.Generator) -> None:
    """Search with a method of `tune.py --method`, PARTICLES evaluations a generation."""
    bounds = [Dimension(f"x{k}", -BOUND, BOUND) for k in range(dimensions)]
    run_method(name, SearchRecord(cost, bounds, BUDGET, PARTICLES), rng)


def comparison_settings(variant: str, **changes: Any) -> VariantSettings:
    """Return the settings that reproduce the paper's comparison: no velocity clamp."""
    settings = {
        "particles": PARTICLES,
        "generations": GENERATIONS,
        "schedule_length": SCHEDULE,
        "max_velocity": math.inf,
    }
    return VariantSettings(variant=variant, **{**settings, **changes})


FITTED = {"schedule_length": GENERATIONS, "max_velocity": 0.2}
"""Recommended settings: the schedule ends with the run, velocities are clamped."""
METHODS: dict[str, Method] = {
    **{name: partial(swarm_search, comparison_settings(name)) for name in CLAIMED},
    "fitted proposed": partial(swarm_search, comparison_settings("proposed", **FITTED)),
    "fitted linear": partial(swarm_search, comparison_settings("linear", **FITTED)),
    "Zhan's adaptive": partial(swarm_search, comparison_settings("adaptive", **FITTED)),
    "random": partial(tuner_search, "random"),
    "CMA-ES": partial(tuner_search, "cma"),
    "SciPy's DE": partial(tuner_search, "de"),
    "pso of the tuner": partial(tuner_search, "pso"),
}
if not has_cma():
    del METHODS["CMA-ES"]


def search_curve(method: Method, problem: BenchmarkProblem, seed: int) -> Array:
    """Return the best value after each PARTICLES evaluations, (GENERATIONS + 1,)."""
    values: list[float] = []

    def recorded(x: Array) -> Array:
        answers = problem.function(x)
        values.extend(answers.tolist())
        return answers

    method(recorded, problem.dimensions, np.random.default_rng(seed))
    best = np.minimum.accumulate(values)
    best = np.append(best, np.full(max(0, BUDGET - len(best)), best[-1]))  # a search may end early
    return np.asarray(best[PARTICLES - 1 : BUDGET : PARTICLES])


def search_curves(method: Method, problem: BenchmarkProblem, seeds: Iterable[int]) -> Array:
    """Return the curves of several seeds, (seeds, GENERATIONS + 1)."""
    return np.array([search_curve(method, problem, seed) for seed in seeds])


READINGS: dict[str, dict[str, Any]] = {
    "G = 100, no clamp, clipped at the bounds": {},
    "G = 15 (Table 2)": {"schedule_length": 15},
    "G = 41 (the run itself)": {"schedule_length": 41},
    "G = 200": {"schedule_length": 200},
    "G = 300": {"schedule_length": 300},
    "velocity clamp 0.2 (authors' code)": {"max_velocity": 0.2},
    "velocity clamp 1": {"max_velocity": 1.0},
    "absorbed at the bounds": {"boundary": "absorb"},
    "reflected at the bounds": {"boundary": "reflect"},
}
"""Readings of the paper where it is silent or contradicts itself: changes of the settings."""


def final_quartiles(curves: Array) -> list[float]:
    """Return the quartiles over the seeds of the final values of curves (seeds, n)."""
    quartiles: list[float] = np.percentile(curves[:, -1], (25, 50, 75)).tolist()
    return quartiles


def reading_medians(name: str, seeds: Iterable[int]) -> dict[str, float]:
    """Return the median final value of each of READING_VARIANTS under one reading."""
    medians, seeds = {}, list(seeds)
    for variant in READING_VARIANTS:
        method = partial(swarm_search, comparison_settings(variant, **READINGS[name]))
        finals = search_curves(method, PROBLEMS[0], seeds)[:, -1]
        medians[variant] = float(np.median(finals))
    return medians


def ordering_bars(median: Mapping[str, float]) -> dict[str, bool]:
    """Check the medians of the CLAIMED variants on the sphere; return the result of each bar."""
    proposed, linear, damped, classic = (median[name] for name in CLAIMED)
    return {
        "proposed < 0.1": proposed < 0.1,
        "0.5 <= linear <= 5": 0.5 <= linear <= 5,
        "0.5 <= damped <= 5": 0.5 <= damped <= 5,
        "classic > 2": classic > 2,
        "proposed < linear < classic": proposed < linear < classic,
        "proposed < damped < classic": proposed < damped < classic,
    }
