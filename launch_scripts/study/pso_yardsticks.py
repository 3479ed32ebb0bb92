"""Test functions, and what a particle swarm is measured against on them."""

import importlib.util
import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import at_once, minimize
from ampc_ros.pso.settings import Dimension, PsoSettings

PARTICLES, GENERATIONS, SCHEDULE = 20, 41, 100
"""Of the paper's comparison: 41 of 100 generations are shown."""
BUDGET = PARTICLES * (GENERATIONS + 1)
"""Evaluations of every method."""
BOUND = 10.0
"""All functions are searched within +-10 in every dimension."""
FIRST_STEP = BOUND / 2
"""Initial standard deviation of CMA-ES: a quarter of the range, as its author advises."""
Cost = Callable[[Array], Array]
"""Values (n,) at positions (n, d)."""
Generator = np.random.Generator
Method = Callable[[Cost, int, Generator], Any]
"""Searches in so many dimensions; evaluates the cost at least BUDGET times."""


def sphere(x: Array) -> Array:
    """Give the paper's function f_1, least at 0."""
    return np.asarray(np.square(x).sum(axis=1))


def shifted_sphere(x: Array) -> Array:
    """Give the sphere about (6, -6, 6, ...): nobody gains by sinking to the middle."""
    return sphere(x - 6.0 * (-1.0) ** np.arange(x.shape[1]))


def ackley(x: Array) -> Array:
    """Give a wide funnel covered with shallow local minima, least at 0."""
    root, waves = np.sqrt(np.square(x).mean(axis=1)), np.cos(2 * math.pi * x).mean(axis=1)
    return np.asarray(20 + math.e - 20 * np.exp(-0.2 * root) - np.exp(waves))


def rosenbrock(x: Array) -> Array:
    """Give a bent valley, least at (1, 1, ...)."""
    along, across = 1 - x[:, :-1], x[:, 1:] - np.square(x[:, :-1])
    return np.asarray((100 * np.square(across) + np.square(along)).sum(axis=1))


def rastrigin(x: Array) -> Array:
    """Give a bowl of deep local minima at all whole numbers, least at 0."""
    return np.asarray((10 + np.square(x) - 10 * np.cos(2 * math.pi * x)).sum(axis=1))


class Problem(NamedTuple):
    """A function in so many dimensions."""

    function: Cost
    dimensions: int

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.function.__name__.replace('_', ' ')}, n = {self.dimensions}"


PROBLEMS = (
    Problem(sphere, 5),
    Problem(sphere, 10),
    Problem(sphere, 30),
    Problem(shifted_sphere, 5),
    Problem(ackley, 5),
    Problem(ackley, 10),
    Problem(rosenbrock, 5),
    Problem(rastrigin, 5),
)


def swarm(settings: PsoSettings, cost: Cost, dimensions: int, rng: Generator) -> None:
    """Search with one of our swarms."""
    bounds = [Dimension(f"x{k}", -BOUND, BOUND) for k in range(dimensions)]
    minimize(cost, bounds, settings, rng, at_once)


def random_search(cost: Cost, dimensions: int, rng: Generator) -> None:
    """Draw every position uniformly."""
    cost(rng.uniform(-BOUND, BOUND, (BUDGET, dimensions)))


def cma_es(cost: Cost, dimensions: int, rng: Generator) -> None:
    """Search with N. Hansen's CMA-ES, from a random place, in generations as large as ours."""
    from cma import CMAEvolutionStrategy

    options = {
        "bounds": [-BOUND, BOUND],
        "popsize": PARTICLES,
        "seed": int(rng.integers(1, 2**31)),
        "verbose": -9,
    }
    strategy = CMAEvolutionStrategy(rng.uniform(-BOUND, BOUND, dimensions), FIRST_STEP, options)
    for _ in range(GENERATIONS + 1):
        positions = strategy.ask()
        strategy.tell(positions, cost(np.array(positions)).tolist())


def differential(cost: Cost, dimensions: int, rng: Generator) -> None:
    """Search with SciPy's differential evolution, in generations as large as ours."""
    limit = np.full(dimensions, BOUND)

    def transposed(x: Array, /) -> Any:
        return cost(x.T)

    differential_evolution(
        transposed,
        Bounds(-limit, limit),
        init=rng.uniform(-BOUND, BOUND, (PARTICLES, dimensions)),
        maxiter=GENERATIONS,
        tol=0,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=rng,
    )


def as_in_the_paper(variant: str, **chosen: Any) -> PsoSettings:
    """Give the settings with which the paper's comparison is reproduced: no velocity clamp."""
    paper = {
        "particles": PARTICLES,
        "generations": GENERATIONS,
        "schedule_length": SCHEDULE,
        "max_velocity": math.inf,
    }
    return PsoSettings(variant=variant, **{**paper, **chosen})


FITTED = {"schedule_length": GENERATIONS, "max_velocity": 0.2}
"""What a user would choose: the schedule ends with the run, speeds are clamped."""
METHODS: dict[str, Method] = {
    "proposed": partial(swarm, as_in_the_paper("proposed")),
    "linear": partial(swarm, as_in_the_paper("linear")),
    "damped": partial(swarm, as_in_the_paper("damped")),
    "classic": partial(swarm, as_in_the_paper("classic")),
    "fitted proposed": partial(swarm, as_in_the_paper("proposed", **FITTED)),
    "fitted linear": partial(swarm, as_in_the_paper("linear", **FITTED)),
    "Zhan's adaptive": partial(swarm, as_in_the_paper("adaptive", **FITTED)),
    "random": random_search,
    "CMA-ES": cma_es,
    "SciPy's DE": differential,
}
if importlib.util.find_spec("cma") is None:
    del METHODS["CMA-ES"]


def curve(method: Method, problem: Problem, seed: int) -> Array:
    """Best value so far after each generation's worth of evaluations (GENERATIONS + 1,)."""
    values: list[float] = []

    def recorded(x: Array) -> Array:
        answers = problem.function(x)
        values.extend(answers.tolist())
        return answers

    method(recorded, problem.dimensions, np.random.default_rng(seed))
    best = np.minimum.accumulate(values)
    return np.asarray(best[PARTICLES - 1 : BUDGET : PARTICLES])


def curves(method: Method, problem: Problem, seeds: Iterable[int]) -> Array:
    """Give a row for each seed."""
    return np.array([curve(method, problem, seed) for seed in seeds])


def readings() -> dict[str, dict[str, Any]]:
    """Ways to read the paper where it is silent or contradicts itself, on its sphere."""
    ways: dict[str, dict[str, Any]] = {"G = 100, no clamp, clipped at the bounds": {}}
    for G, origin in ((15, "Table 2"), (41, "the run itself"), (200, ""), (300, "")):
        ways[f"G = {G}" + f" ({origin})" * bool(origin)] = {"schedule_length": G}
    ways["velocity clamp 0.2 (authors' code)"] = {"max_velocity": 0.2}
    ways["velocity clamp 1"] = {"max_velocity": 1.0}
    ways["absorbed at the bounds"] = {"boundary": "absorb"}
    ways["reflected at the bounds"] = {"boundary": "reflect"}
    return ways


def finals(settings: Sequence[PsoSettings], problem: Problem, seeds: Iterable[int]) -> Array:
    """Final values of several swarms (len(settings), seeds)."""
    places = list(seeds)
    return np.array([curves(partial(swarm, one), problem, places)[:, -1] for one in settings])
