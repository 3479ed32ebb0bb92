"""Set-up of a particle swarm: where it may fly, and Table 2 of the paper."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import Checked, check_range, choice, number

VARIANTS = ("proposed", "linear", "damped", "classic", "authors_code", "adaptive")
GREATEST_BOUND = number(-1.0e100, 1.0e100)


class Dimension(NamedTuple):
    """One parameter that is searched for, and its bounds."""

    name: str
    low: float
    high: float
    integer: bool = False
    """The cost sees the nearest whole number, the swarm flies on between the whole numbers: two
    particles do not merge because they round to the same number. The two outermost numbers own
    half a unit each, the others a whole one."""


class Space(NamedTuple):
    """Bounds as arrays over the dimensions, (d,)."""

    low: Array
    high: Array
    integer: npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class PsoSettings(Checked):
    """Table 2 of the paper, and what the paper leaves open."""

    variant: Annotated[
        str,
        choice(
            VARIANTS,
            "proposed: Eqs. (33), (34). linear: Eq. (32). damped: omega(k+1) = omega(k) damping. "
            "classic: omega = max_inertia. authors_code: as proposed, with the authors' slip in "
            "the schedule of Eq. (34). adaptive: Zhan et al., 2009, see `adaptive_pso`.",
        ),
    ] = "proposed"
    particles: Annotated[int, number(2, 1_000_000, "", "Number of particles.")] = 20
    generations: Annotated[
        int, number(0, 1_000_000, "", "Moves of the swarm after the first, random one.")
    ] = 15
    schedule_length: Annotated[
        int, number(0, 1_000_000, "", "G of Eqs. (32)-(34); 0: the number of generations.")
    ] = 0
    max_inertia: Annotated[float, number(0.0, 2.0, "", "Largest inertia.")] = 0.99
    min_inertia: Annotated[float, number(0.0, 2.0, "", "Smallest inertia.")] = 0.1
    inertia_damping: Annotated[float, number(0.0, 1.0, "", "Damping of variant damped.")] = 0.99
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
    boundary: Annotated[
        str,
        choice(
            ("clip", "absorb", "reflect"),
            "A particle that leaves is put on the bound. clip keeps its velocity, absorb removes "
            "the outward component, reflect mirrors position and velocity.",
        ),
    ] = "clip"

    def __post_init__(self) -> None:
        """Check the fields, and the inertias against each other."""
        super().__post_init__()
        if self.min_inertia > self.max_inertia:
            raise ValueError(
                f"min_inertia = {self.min_inertia!r} must be at most max_inertia = "
                f"{self.max_inertia!r}"
            )

    @property
    def schedule(self) -> int:
        """G of Eqs. (32)-(34)."""
        return self.schedule_length or self.generations or 1


def space(bounds: Sequence[Dimension]) -> Space:
    """Give the bounds as arrays, or name what is wrong with them."""
    if not bounds:
        raise ValueError("bounds = [] must have at least one dimension")
    for item in bounds:
        _check(item, [other.name for other in bounds])
    low, high = (np.array([getattr(d, key) for d in bounds], float) for key in ("low", "high"))
    return Space(low, high, np.array([d.integer for d in bounds]))


def _check(item: Dimension, names: Sequence[str]) -> None:
    if names.count(item.name) > 1:
        raise ValueError(f"bounds: {item.name} is given {names.count(item.name)} times")
    for key in ("low", "high"):
        value = getattr(item, key)
        check_range(f"bounds: {item.name}.{key}", value, GREATEST_BOUND)
        if item.integer and value != int(value):
            raise ValueError(f"bounds: {item.name}.{key} = {value!r} must be a whole number")
    if item.low >= item.high:
        raise ValueError(
            f"bounds: {item.name}.low = {item.low!r} must be below {item.name}.high = {item.high!r}"
        )
