"""Particle swarm optimisation, Eqs. (31)-(34): proposed, classic and adaptive swarms, one function.

    dimensions = [Dimension("Q", 0.1, 10.0), Dimension("N_p", 1, 55, integer=True)]
    best = minimize(cost, dimensions, PsoSettings(), np.random.default_rng(1))

`map` says how a cost meets a generation: `map(cost, positions)` gives a fitness for each row of
positions (n, d). The builtin, `executor.map` of threads or processes, or `at_once` for a cost that
takes all of them in one (compiled) call. Every random number is drawn here, before the generation
is evaluated, so that the result is the same, bit for bit, wherever the cost runs.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ampc_msgs_config.types import Array
from ampc_ros.pso.adaptive_pso import CONVERGENCE, FIRST, adapted, learned
from ampc_ros.pso.settings import Dimension, PsoSettings, Space, space
from ampc_ros.pso.swarm import Swarm, Task
from ampc_ros.pso.weights import scheduled

Map = Callable[[Callable[..., Any], Array], Iterable[Any]]


class Minimum(NamedTuple):
    """What a search found."""

    position: Array
    """The best (d,), integer dimensions rounded."""
    fitness: float
    """Of the best; infinite if no particle ever had a finite one."""
    history: Array
    """Best fitness after each generation, the first is the random one (generations + 1,)."""
    evaluations: npt.NDArray[np.int64]
    """Particles evaluated after each generation (generations + 1,)."""
    swarm: Swarm
    """The last generation."""


def minimize(
    cost: Callable[..., Any],
    bounds: Sequence[Dimension],
    settings: PsoSettings,
    rng: np.random.Generator,
    map: Map = map,
    resume: Swarm | None = None,
) -> Minimum:
    """Search for the position of least cost; arguments as of `search`."""
    for swarm in search(cost, bounds, settings, rng, map, resume):
        last = swarm
    position = _rounded(space(bounds), last.best_position[last.leader])
    fitness = float(last.best_fitness[last.leader])
    return Minimum(position, fitness, last.history, last.evaluations, last)


def search(
    cost: Callable[..., Any],
    bounds: Sequence[Dimension],
    settings: PsoSettings,
    rng: np.random.Generator,
    map: Map = map,
    resume: Swarm | None = None,
) -> Iterator[Swarm]:
    """Give the swarm after each generation; any of them continues the search, bit for bit.

    Args:
        cost: Fitness of a position (d,), or with `at_once` of positions (n, d); smaller is better.
            What is not finite counts as worse than everything.
        bounds: The dimensions.
        settings: Of the swarm.
        rng: Source of all random numbers; with `resume` only its kind matters.
        map: How the cost is called, see above.
        resume: A swarm of an earlier search with the same arguments; it is given first.

    Raises:
        ValueError: Bounds, or a resumed swarm that has another shape.
    """
    where, shape = space(bounds), (settings.particles, len(bounds))
    if resume is not None and resume.position.shape != shape:
        raise ValueError(
            f"resume: particles x dimensions = {resume.position.shape} must be {shape}"
        )

    def evaluate(position: Array) -> Array:
        return _fitness(list(map(cost, _rounded(where, position))), len(position))

    return _generations(resume, Task(evaluate, where, settings, rng))


def at_once(cost: Callable[[Array], Iterable[Any]], positions: Array) -> Iterable[Any]:
    """Call a cost once with a whole generation (n, d): a `map` for compiled swarms."""
    return cost(positions)


def _generations(swarm: Swarm | None, task: Task) -> Iterator[Swarm]:
    if swarm is None:
        swarm = _first(task)
    yield swarm
    while swarm.generation < task.settings.generations:
        task.rng.bit_generator.state = swarm.random
        swarm = _next(swarm, task)
        yield swarm


def _first(task: Task) -> Swarm:
    """Scatter the particles uniformly, at rest."""
    evaluate, where, settings, rng = task
    x = rng.uniform(where.low, where.high, (settings.particles, len(where.low)))
    random, fitness = rng.bit_generator.state, evaluate(x)
    weights = FIRST if settings.variant == "adaptive" else scheduled(settings, 0)
    history, evaluations = np.array([fitness.min()]), np.array([len(x)])
    rest = np.zeros_like(x)
    return Swarm(0, x, rest, fitness, x, fitness, weights, 0, history, evaluations, random)


def _next(swarm: Swarm, task: Task) -> Swarm:
    """Give the next generation; a swarm that knows no finite fitness is scattered anew."""
    if not np.isfinite(swarm.best_fitness).any():
        return _appended(swarm, _first(task))
    if task.settings.variant == "adaptive":
        swarm = learned(adapted(swarm, task), task)
    else:
        swarm = swarm._replace(weights=scheduled(task.settings, swarm.generation))
    x, v = _moved(swarm, task)
    random, fitness = task.rng.bit_generator.state, task.evaluate(x)
    better = fitness < swarm.best_fitness
    return _appended(
        swarm,
        swarm._replace(
            position=x,
            velocity=v,
            fitness=fitness,
            best_position=np.where(better[:, None], x, swarm.best_position),
            best_fitness=np.where(better, fitness, swarm.best_fitness),
            random=random,
        ),
    )


def _appended(before: Swarm, after: Swarm) -> Swarm:
    """Count a generation; the leader of a converged adaptive swarm was evaluated once more."""
    count = len(after.fitness) + int(after.state == CONVERGENCE)
    return after._replace(
        generation=before.generation + 1,
        history=np.append(before.history, after.best_fitness.min()),
        evaluations=np.append(before.evaluations, before.evaluations[-1] + count),
    )


def _moved(swarm: Swarm, task: Task) -> tuple[Array, Array]:
    """Move all particles by Eq. (31), with velocity clamp and boundary rule.

    Note:
        r_1 and r_2 are drawn for every particle and dimension. All particles follow the Gb of the
        generation before: the authors' code updates it from particle to particle, which cannot run
        in parallel.
    """
    omega, c_1, c_2 = swarm.weights
    x, Pb = swarm.position, swarm.best_position
    r_1, r_2 = task.rng.random((2, *x.shape))
    v = omega * swarm.velocity + c_1 * r_1 * (Pb - x) + c_2 * r_2 * (Pb[swarm.leader] - x)
    limit = task.settings.max_velocity * (task.space.high - task.space.low)
    return _bounded(x, np.clip(v, -limit, limit), task.space, task.settings.boundary)


def _bounded(x: Array, v: Array, where: Space, rule: str) -> tuple[Array, Array]:
    flown = x + v
    x = np.clip(flown, where.low, where.high)
    if rule == "clip":
        return x, v
    if rule == "absorb":
        return x, np.where(x == flown, v, 0.0)
    return np.clip(2 * x - flown, where.low, where.high), np.where(x == flown, v, -v)


def _rounded(where: Space, position: Array) -> Array:
    return np.where(where.integer, np.rint(position), position)


def _fitness(answers: Sequence[Any], particles: int) -> Array:
    """Give what the cost answered; what is not finite is the worst."""
    values = np.array(answers, float)
    if values.shape != (particles,):
        raise ValueError(
            f"cost: gave shape {values.shape}, needed one number for each particle, ({particles},)"
        )
    return np.where(np.isfinite(values), values, np.inf)
