"""Search methods for an expensive fitness: the paper's swarm, its adaptation, and library methods.

A method asks a `SearchRecord` for the fitness of positions in the unit cube until its budget is
spent. All methods are therefore compared and resumed in the same way:

    record = run_method("pso", SearchRecord(cost, dimensions, 90), np.random.default_rng(1))
    position, fitness = record.best
"""

import contextlib
import importlib.util
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, differential_evolution
from scipy.optimize import minimize as minimize_locally
from scipy.stats import qmc

from ampc_msgs_config.types import Array
from ampc_ros.pso.minimize import map_vectorized, minimize
from ampc_ros.pso.swarm import Dimension, PsoSettings, Swarm, swarm_space

SOBOL_SHARE, SWARM_SHARE = 0.35, 0.25
"""Shares of the budget of `pso` for the first positions and for the moves of the swarm."""
DECAY = 3.0
"""lambda_1 of Eq. (33) in `pso`: the inertia falls from 1 to 0.13 during the moves of the swarm.
The paper's 30 lets it fall to 0.11 in the first of 8 generations."""
SIMPLEX_EDGE = 0.08
"""Edge of the first simplex of a polish."""
POLISH_TOLERANCE = 1e-4
"""Edge of the simplex, and relative difference of the fitness, at which a polish ends."""
MIN_DISTANCE = 0.15
"""Distance from all earlier polishes at which another one starts."""
NO_CMA = "--method cma needs the package cma: pip install cma==4.5.0"
CMA_STEP = 0.25
"""Initial standard deviation of CMA-ES: a quarter of the range, as its author recommends."""


class BudgetSpent(Exception):
    """Raised in a method that asks for more evaluations than its budget."""


class SearchRecord:
    """Cost function with its bounds, and all positions that a search has evaluated."""

    def __init__(
        self,
        cost: Callable[[Array], Iterable[Any]],
        dimensions: Sequence[Dimension],
        budget: int,
        generation: int = 10,
        known: tuple[Array, Array] | None = None,
        save: Callable[["SearchRecord"], None] = lambda record: None,
    ) -> None:
        """Start without an evaluation of a cost function.

        Args:
            cost: Fitness (n,) at positions (n, d), integer dimensions rounded.
            dimensions: Bounds.
            budget: Largest number of evaluations.
            generation: Number of positions that the populations of methods have.
            known: Positions (m, d) and fitness (m,) of an earlier, interrupted search, which are
                not evaluated again.
            save: Called after each evaluation of several positions.
        """
        self.cost, self.dimensions, self.budget = cost, list(dimensions), budget
        self.generation, self.save = generation, save
        self.space = swarm_space(dimensions)
        self.known = known or (np.empty((0, len(self.dimensions))), np.empty(0))
        self.positions: Array = np.empty((0, len(self.dimensions)))
        self.fitness: Array = np.empty(0)

    def __call__(self, unit: Array) -> Array:
        """Return the fitness (n,) at positions (n, d) in the unit cube; infinite if not finite.

        Raises:
            BudgetSpent: The budget does not hold all of them; those that it holds are recorded.
            ValueError: The cost returned another number of values.
        """
        before = len(self.fitness)
        unit = np.clip(unit[: self.budget - before], 0.0, 1.0)
        positions = self.space.low + unit * (self.space.high - self.space.low)
        positions = np.where(self.space.integer, np.rint(positions), positions)
        if len(positions):
            self._append(positions)
        if len(unit) < 1 or len(self.fitness) >= self.budget:
            raise BudgetSpent
        return self.fitness[before:]

    def _append(self, positions: Array) -> None:
        before, n = len(self.fitness), len(positions)
        old, values = self.known[0][before : before + n], self.known[1][before : before + n]
        if not np.array_equal(old, positions):
            values = np.array(list(self.cost(positions)), dtype=float)
        if values.shape != (n,):
            raise ValueError(
                f"cost: returned shape {values.shape}, must be one number per position, ({n},)"
            )
        self.positions = np.vstack((self.positions, positions))
        self.fitness = np.append(self.fitness, np.where(np.isfinite(values), values, np.inf))
        self.save(self)

    @property
    def unit(self) -> Array:
        """Evaluated positions (n, d) in the unit cube."""
        low, high = self.space.low, self.space.high
        return np.asarray((self.positions - low) / (high - low))

    @property
    def best(self) -> tuple[Array, float]:
        """Best position (d,) and its fitness."""
        i = int(np.argmin(self.fitness))
        return self.positions[i], float(self.fitness[i])


SearchMethod = Callable[[SearchRecord, np.random.Generator], None]


def run_method(name: str, record: SearchRecord, rng: np.random.Generator) -> SearchRecord:
    """Run a method of SEARCH_METHODS until it ends or its budget is used up; return its record.

    Raises:
        ValueError: The library of the method is not installed.
    """
    with contextlib.suppress(BudgetSpent):
        SEARCH_METHODS[name](record, rng)
    return record


def random_search(record: SearchRecord, rng: np.random.Generator) -> None:
    """Draw all positions uniformly."""
    while True:
        record(rng.random((record.generation, len(record.dimensions))))


def unit_swarm(record: SearchRecord, settings: PsoSettings, rng: np.random.Generator,
               start: Swarm | None = None) -> None:  # fmt: skip
    """Search with a swarm in the unit cube."""
    cube = [Dimension(f"x{i}", 0.0, 1.0) for i in range(len(record.dimensions))]
    minimize(record, cube, settings, rng, map_vectorized, start)


def paper_swarm(record: SearchRecord, rng: np.random.Generator) -> None:
    """Search with the paper's swarm, Eqs. (31)-(34), whose schedule ends with the budget."""
    particles = record.generation
    generations = max(1, math.ceil(record.budget / particles) - 1)
    unit_swarm(record, PsoSettings(particles=particles, generations=generations), rng)


def adapted_swarm(record: SearchRecord, rng: np.random.Generator) -> None:
    """Search with the paper's swarm, adapted to tens of evaluations.

    The first positions are a Sobol sequence. The best of them are the swarm, and Eq. (33) decays
    over its few moves. The rest of the budget polishes the best position, and afterwards others
    that are far from it.
    """
    budget, d = record.budget, len(record.dimensions)
    first = 2 ** max(2, round(math.log2(max(1.0, SOBOL_SHARE * budget))))
    record(qmc.Sobol(d, rng=rng).random(first))
    best = np.argsort(record.fitness, kind="stable")[: min(record.generation, first // 2)]
    moves = round(SWARM_SHARE * budget / len(best))
    if moves and np.isfinite(record.fitness).any():
        settings = PsoSettings(particles=max(2, len(best)), generations=moves, inertia_decay=DECAY)
        unit_swarm(record, settings, rng, swarm_at(record, best, settings, rng))
    polished: list[Array] = []
    while True:
        order = np.argsort(record.fitness, kind="stable")
        start = next((record.unit[i] for i in order if is_far(record.unit[i], polished)), None)
        if start is None:
            return
        polished.append(start)
        polish(record, start)
        polished.append(record.unit[int(np.argmin(record.fitness))])


def is_far(unit: Array, places: Sequence[Array]) -> bool:
    """Return whether a position (d,) is further than MIN_DISTANCE from all places."""
    return all(float(np.abs(unit - place).max()) > MIN_DISTANCE for place in places)


def swarm_at(
    record: SearchRecord,
    chosen: npt.NDArray[np.intp],
    settings: PsoSettings,
    rng: np.random.Generator,
) -> Swarm:
    """Return a swarm at rest whose particles are evaluated positions."""
    x, fitness = record.unit[chosen], record.fitness[chosen]
    history, evaluations = np.array([fitness.min()]), np.array([len(x)])
    random, weights = rng.bit_generator.state, settings.weights(0)
    return Swarm(
        0, x, np.zeros_like(x), fitness, x, fitness, weights, 0, history, evaluations, random
    )


def polish(
    record: SearchRecord,
    start: Array,
    evaluations: int | None = None,
    adjusted: Callable[[Array, float], float] = lambda unit, value: value,
) -> None:
    """Search around a position with the Nelder-Mead method of SciPy.

    Args:
        record: Receives the evaluations.
        start: Position (d,) in the unit cube.
        evaluations: Largest number of evaluations; None: as many as the budget allows.
        adjusted: Cost of a position (d,) in the unit cube and its fitness, by default the fitness.
    """
    d = len(start)
    steps = np.where(start + SIMPLEX_EDGE > 1.0, -SIMPLEX_EDGE, SIMPLEX_EDGE)
    simplex = np.vstack((start, start + np.diag(steps)))
    limit = record.budget if evaluations is None else evaluations

    def cost(unit: Array) -> float:
        value = adjusted(unit, float(record(unit[None])[0]))
        return math.log(min(max(value, 1e-300), 1e300))

    options: Any = {"initial_simplex": simplex, "maxfev": limit}
    options |= {"xatol": POLISH_TOLERANCE, "fatol": POLISH_TOLERANCE}
    ends = Bounds(np.zeros(d), np.ones(d))
    minimize_locally(cost, start, method="Nelder-Mead", bounds=ends, options=options)


def cma_es(record: SearchRecord, rng: np.random.Generator) -> None:
    """Search with N. Hansen's CMA-ES from a random position.

    Raises:
        ValueError: The package `cma` is not installed.
    """
    if not has_cma():
        raise ValueError(NO_CMA)
    from cma import CMAEvolutionStrategy

    d = len(record.dimensions)
    options = {"bounds": [0.0, 1.0], "popsize": record.generation, "verbose": -9}
    options["seed"] = int(rng.integers(1, 2**31))
    strategy = CMAEvolutionStrategy(rng.random(d), CMA_STEP, options)
    while True:
        positions = strategy.ask()
        strategy.tell(positions, np.minimum(record(np.array(positions)), 1e300).tolist())


def has_cma() -> bool:
    """Return whether the package of CMA-ES is installed."""
    return importlib.util.find_spec("cma") is not None


def differential_search(record: SearchRecord, rng: np.random.Generator) -> None:
    """Search with SciPy's differential evolution."""
    d = len(record.dimensions)

    def transposed(x: Array, /) -> Any:
        return np.minimum(record(x.T), 1e300)

    differential_evolution(
        transposed,
        Bounds(np.zeros(d), np.ones(d)),
        init=rng.random((max(5, record.generation), d)),
        maxiter=record.budget,
        tol=0,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=rng,
    )


SEARCH_METHODS: dict[str, SearchMethod] = {
    "pso": adapted_swarm,
    "paper": paper_swarm,
    "de": differential_search,
    "cma": cma_es,
    "random": random_search,
}
"""Methods of `tune.py --method`."""
