"""Particle swarm optimisation, Eq. (31), with the rules of the settings, Eqs. (33)-(34).

    dimensions = [Dimension("Q", 0.1, 10.0), Dimension("N_p", 1, 55, integer=True)]
    best = minimize(cost, dimensions, PsoSettings(), np.random.default_rng(1))

Argument `map` evaluates a generation: `map(cost, positions)` returns a fitness for each row of
positions (n, d). Use the builtin, `executor.map` of threads or processes, or `map_vectorized` for a
cost that takes all rows in one (compiled) call. All random numbers are drawn here, before the
generation is evaluated. The result is therefore the same, bit for bit, wherever the cost runs.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ampc_msgs_config.types import Array
from ampc_ros.pso.swarm import (
    Dimension,
    PsoSettings,
    Space,
    Swarm,
    SwarmContext,
    swarm_space,
)

MapFunction = Callable[[Callable[..., Any], Array], Iterable[Any]]


class Minimum(NamedTuple):
    """Result of a search."""

    position: Array
    """Best position (d,), integer dimensions rounded."""
    fitness: float
    """Fitness of the best position; infinite if no evaluation was finite."""
    history: Array
    """Best fitness after each generation, from the random initial one on (generations + 1,)."""
    evaluations: npt.NDArray[np.int64]
    """Number of evaluations after each generation (generations + 1,)."""
    swarm: Swarm
    """Last generation."""


def minimize(
    cost: Callable[..., Any],
    bounds: Sequence[Dimension],
    settings: PsoSettings,
    rng: np.random.Generator,
    map: MapFunction = map,
    resume: Swarm | None = None,
) -> Minimum:
    """Search for the position of least cost; arguments as of `search`."""
    *_, last = search(cost, bounds, settings, rng, map, resume)
    position = _rounded(swarm_space(bounds), last.best_position[last.leader])
    fitness = float(last.best_fitness[last.leader])
    return Minimum(position, fitness, last.history, last.evaluations, last)


def search(
    cost: Callable[..., Any],
    bounds: Sequence[Dimension],
    settings: PsoSettings,
    rng: np.random.Generator,
    map: MapFunction = map,
    resume: Swarm | None = None,
) -> Iterator[Swarm]:
    """Yield the swarm after each generation; a search can resume from each of them, bit for bit.

    Args:
        cost: Fitness of a position (d,), or with `map_vectorized` of positions (n, d). Smaller is
            better. A value that is not finite is worse than all others.
        bounds: Dimensions.
        settings: Size and rules of the swarm.
        rng: Source of all random numbers; with `resume` only its kind matters.
        map: Evaluates a generation, see above.
        resume: Swarm of an earlier search with the same arguments; it is yielded first.

    Raises:
        ValueError: The bounds are wrong, or the swarm to resume has another shape.
    """
    space, shape = swarm_space(bounds), (settings.particles, len(bounds))
    if resume is not None and resume.position.shape != shape:
        raise ValueError(
            f"resume: particles x dimensions = {resume.position.shape} must be {shape}"
        )
    count = 0

    def evaluate(position: Array) -> Array:
        nonlocal count
        count += len(position)
        fitness = np.array(list(map(cost, _rounded(space, position))), float)
        if fitness.shape != (len(position),):
            raise ValueError(
                f"cost: returned shape {fitness.shape}, must be one number per particle, "
                f"({len(position)},)"
            )
        return np.where(np.isfinite(fitness), fitness, np.inf)

    def generations() -> Iterator[Swarm]:
        swarm = _initial(context) if resume is None else resume
        yield swarm
        while swarm.generation < settings.generations:
            rng.bit_generator.state = swarm.random
            before = count
            after = _next(swarm, context)
            swarm = after._replace(
                generation=swarm.generation + 1,
                history=np.append(swarm.history, after.best_fitness.min()),
                evaluations=np.append(swarm.evaluations, swarm.evaluations[-1] + count - before),
            )
            yield swarm

    context = SwarmContext(evaluate, space, settings, rng)
    return generations()


def map_vectorized(cost: Callable[[Array], Iterable[Any]], positions: Array) -> Iterable[Any]:
    """Call the cost once with a whole generation (n, d): the `map` of a compiled cost."""
    return cost(positions)


def _initial(context: SwarmContext) -> Swarm:
    """Return a generation 0 of uniformly distributed particles at rest."""
    evaluate, space, settings, rng = context
    x = rng.uniform(space.low, space.high, (settings.particles, len(space.low)))
    random, fitness = rng.bit_generator.state, evaluate(x)
    history, evaluations = np.array([fitness.min()]), np.array([len(x)])
    v, weights = np.zeros_like(x), settings.weights(0)
    return Swarm(0, x, v, fitness, x, fitness, weights, 0, history, evaluations, random)


def _next(swarm: Swarm, context: SwarmContext) -> Swarm:
    """Return the particles of the next generation; restart where no fitness so far is finite."""
    if not np.isfinite(swarm.best_fitness).any():
        return _initial(context)
    swarm = context.settings.adapt(swarm, context)
    x, v = _moved(swarm, context)
    random, fitness = context.rng.bit_generator.state, context.evaluate(x)
    better = fitness < swarm.best_fitness
    return swarm._replace(
        position=x,
        velocity=v,
        fitness=fitness,
        best_position=np.where(better[:, None], x, swarm.best_position),
        best_fitness=np.where(better, fitness, swarm.best_fitness),
        random=random,
    )


def _moved(swarm: Swarm, context: SwarmContext) -> tuple[Array, Array]:
    """Return position and velocity after Eq. (31), velocity clamp and boundary rule.

    Note:
        r_1 and r_2 are drawn for each particle and dimension. All particles use Gb of the previous
        generation. The authors' code updates Gb after each particle, which cannot run in parallel.
    """
    _, space, settings, rng = context
    omega, c_1, c_2 = swarm.weights
    x, Pb = swarm.position, swarm.best_position
    r_1, r_2 = rng.random((2, *x.shape))
    v = omega * swarm.velocity + c_1 * r_1 * (Pb - x) + c_2 * r_2 * (Pb[swarm.leader] - x)
    limit = settings.max_velocity * (space.high - space.low)
    return settings.keep_inside(x, np.clip(v, -limit, limit), space)


def _rounded(space: Space, position: Array) -> Array:
    return np.where(space.integer, np.rint(position), position)
