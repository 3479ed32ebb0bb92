"""Data of a particle swarm: search space, settings with Eqs. (33)-(34), state."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import Checked, check_range, number

BOUND_RANGE = number(-1.0e100, 1.0e100)
"""Range of the bounds of a dimension."""
INCREMENTS = ((0.2, 0.05), (0.35, 0.02), (0.75, -0.035), (math.inf, -0.0015))
"""alpha of Eq. (34) where g/G is below the first number."""


class Dimension(NamedTuple):
    """One parameter of the search and its bounds."""

    name: str
    low: float
    high: float
    integer: bool = False
    """Whether the cost receives the nearest integer. The swarm itself moves on real numbers, so
    that two particles do not merge where they round to the same integer. The lowest and highest
    integer cover half a unit each, the others one unit."""


class Space(NamedTuple):
    """Bounds as arrays over the dimensions, (d,)."""

    low: Array
    high: Array
    integer: npt.NDArray[np.bool_]


class Weights(NamedTuple):
    """Coefficients of Eq. (31)."""

    inertia: float
    cognitive: float
    social: float


class Swarm(NamedTuple):
    """State of a search between two generations: n particles, d dimensions.

    The state is complete: a search continues from it bit for bit. Fitness is minimised. It is
    infinite where the cost returned no finite number.
    """

    generation: int
    position: Array
    """(n, d), inside the bounds, integer dimensions not rounded."""
    velocity: Array
    """(n, d), last move."""
    fitness: Array
    """(n,)"""
    best_position: Array
    """Pb (n, d)."""
    best_fitness: Array
    """Fitness of Pb (n,)."""
    weights: Weights
    """Weights of the last move."""
    state: int
    """State of the rule that sets the weights; 0 where the rule has none, as Eqs. (33)-(34)."""
    history: Array
    """Best fitness so far, after each generation (generation + 1,)."""
    evaluations: npt.NDArray[np.int64]
    """Number of evaluations so far, after each generation (generation + 1,)."""
    random: Any
    """State of the random number generator before the next move."""

    @property
    def leader(self) -> int:
        """Index of the particle that holds Gb, the best of all best positions."""
        return int(np.argmin(self.best_fitness))


@dataclass(frozen=True, kw_only=True)
class PsoSettings(Checked):
    """Table 2 of the paper, and the choices that the paper leaves open.

    The methods are the rules of the swarm that the paper proposes.
    """

    particles: Annotated[int, number(2, 1_000_000, "", "Number of particles.")] = 20
    generations: Annotated[
        int, number(0, 1_000_000, "", "Moves of the swarm after the first, random one.")
    ] = 15
    max_inertia: Annotated[float, number(0.0, 2.0, "", "Largest inertia.")] = 0.99
    min_inertia: Annotated[float, number(0.0, 2.0, "", "Smallest inertia.")] = 0.1
    inertia_decay: Annotated[float, number(0.0, 1.0e6, "", "lambda_1 of Eq. (33).")] = 30.0
    inertia_divisor: Annotated[float, number(1.0e-6, 1.0e6, "", "lambda_2 of Eq. (33).")] = 3.0
    initial_cognitive: Annotated[float, number(-10.0, 10.0, "", "Initial cognitive weight.")] = 2.0
    initial_social: Annotated[float, number(-10.0, 10.0, "", "Initial social weight.")] = 2.0
    max_velocity: Annotated[
        float,
        number(
            1.0e-9, math.inf, "ranges per generation", "Limit of each velocity; infinite: none."
        ),
    ] = 0.2

    def __post_init__(self) -> None:
        """Check the fields, and the order of the inertia limits."""
        super().__post_init__()
        if self.min_inertia > self.max_inertia:
            raise ValueError(
                f"min_inertia = {self.min_inertia!r} must be at most max_inertia = "
                f"{self.max_inertia!r}"
            )

    @property
    def schedule(self) -> int:
        """G of Eqs. (33)-(34)."""
        return self.generations or 1

    def weights(self, g: int) -> Weights:
        """Return the weights of the move that follows generation g, Eqs. (33)-(34).

        Note:
            The increments of Eq. (34) are absolute: the final c_1 and c_2 depend on G. After
            generation G the inertia stays constant, c_1 and c_2 change further.
        """
        change = sum(acceleration_increment(time) for time in self.schedule_times(g))
        return Weights(
            self.inertia(g), self.initial_cognitive + change, self.initial_social - change
        )

    def inertia(self, g: int) -> float:
        """Return omega of Eq. (33)."""
        high, low, time = self.max_inertia, self.min_inertia, min(g / self.schedule, 1.0)
        return low + math.exp(high - self.inertia_decay * (high + low) * time) / (
            self.inertia_divisor
        )

    def schedule_times(self, g: int) -> list[float]:
        """Return k/G of Eq. (34) for the generations k before g."""
        return [k / self.schedule for k in range(g)]

    def adapt(self, swarm: Swarm, context: "SwarmContext") -> Swarm:
        """Set the weights of the next move."""
        return swarm._replace(weights=self.weights(swarm.generation))

    def keep_inside(self, position: Array, velocity: Array, space: Space) -> tuple[Array, Array]:
        """Move positions (n, d) by velocities; put a particle that leaves on the bound.

        Returns:
            New positions inside the bounds, and the velocities, unchanged.
        """
        return np.clip(position + velocity, space.low, space.high), velocity


class SwarmContext(NamedTuple):
    """Constants of a search."""

    evaluate: Callable[[Array], Array]
    """Fitness (n,) of positions (n, d); infinite for the worst."""
    space: Space
    settings: PsoSettings
    rng: np.random.Generator


def acceleration_increment(time: float) -> float:
    """Return alpha of Eq. (34) at time g/G; its overlapping branches are half-open intervals."""
    return next(alpha for end, alpha in INCREMENTS if time < end)


def swarm_space(dimensions: Sequence[Dimension]) -> Space:
    """Return the bounds as arrays.

    Raises:
        ValueError: Names the dimension, the value and the bound.
    """
    if not dimensions:
        raise ValueError("bounds = [] must have at least one dimension")
    names = [item.name for item in dimensions]
    for item in dimensions:
        if names.count(item.name) > 1:
            raise ValueError(f"bounds: {item.name} occurs {names.count(item.name)} times")
        for key, value in (("low", item.low), ("high", item.high)):
            check_range(f"bounds: {item.name}.{key}", value, BOUND_RANGE)
            if item.integer and value != int(value):
                raise ValueError(f"bounds: {item.name}.{key} = {value!r} must be a whole number")
        if item.low >= item.high:
            raise ValueError(
                f"bounds: {item.name}.low = {item.low!r} must be below {item.name}.high = "
                f"{item.high!r}"
            )
    low, high = (np.array([getattr(d, key) for d in dimensions], float) for key in ("low", "high"))
    return Space(low, high, np.array([d.integer for d in dimensions]))
