"""The whole state of a particle swarm between two generations, and how it is kept in a file."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ampc_msgs_config.types import Array
from ampc_ros.pso.settings import PsoSettings, Space


class Weights(NamedTuple):
    """The coefficients of Eq. (31)."""

    inertia: float
    cognitive: float
    social: float


class Swarm(NamedTuple):
    """A search between two generations: all that its future depends on; n particles, d dimensions.

    Fitness is to be minimised. It is infinite where the cost gave no finite number.
    """

    generation: int
    position: Array
    """(n, d), inside the bounds, integer dimensions not rounded."""
    velocity: Array
    """(n, d), by which the particles came here."""
    fitness: Array
    """(n,)"""
    best_position: Array
    """Pb (n, d)."""
    best_fitness: Array
    """Of Pb (n,)."""
    weights: Weights
    """By which the particles came here."""
    state: int
    """Evolutionary state 0..3 of the variant `adaptive`: exploration, exploitation, convergence,
    jumping out."""
    history: Array
    """Best fitness so far, after each generation (generation + 1,)."""
    evaluations: npt.NDArray[np.int64]
    """Particles evaluated so far, after each generation (generation + 1,)."""
    random: Any
    """State of the random numbers, of which the next move is made."""

    @property
    def leader(self) -> int:
        """Index of the particle whose best position is the best of all, Gb."""
        return int(np.argmin(self.best_fitness))


class Task(NamedTuple):
    """What stays the same from generation to generation."""

    evaluate: Callable[[Array], Array]
    """Fitness (n,) of positions (n, d), infinite for the worst."""
    space: Space
    settings: PsoSettings
    rng: np.random.Generator


def to_json(swarm: Swarm) -> dict[str, Any]:
    """Give a swarm as what JSON holds without loss; an infinite fitness is null.

    Note:
        For the bit generators whose state is plain numbers: PCG64, NumPy's default, is one.
    """
    return {
        name: _plain(value) if isinstance(value, np.ndarray) else value
        for name, value in swarm._asdict().items()
    }


def from_json(data: dict[str, Any]) -> Swarm:
    """Give the swarm that `to_json` wrote."""
    arrays = ("position", "velocity", "fitness", "best_position", "best_fitness", "history")
    read = {name: _finite_or_worst(np.array(data[name], float)) for name in arrays}
    read["evaluations"] = np.array(data["evaluations"], np.int64)
    return Swarm(**{**data, **read, "weights": Weights(*data["weights"])})


def _plain(values: npt.NDArray[Any]) -> Any:
    held = values.astype(object)
    held[~np.isfinite(values)] = None
    return held.tolist()


def _finite_or_worst(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.inf)
