"""Side wind of a drive."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.types import NANOSECONDS, Array
from ampc_msgs_config.validation import Checked, choice, number

BLOCK_EDGE = 0.5
"""Rise and fall of a block of wind [s]."""


@dataclass(frozen=True, kw_only=True)
class Wind(Checked):
    """One piece of wind along y of `map`."""

    kind: Annotated[str, choice(("gust", "block"), "Shape over time: gust is 1-cos.")]
    start: Annotated[float, number(0.0, 1.0e5, "s", "Time at which it begins.")]
    end: Annotated[float, number(0.0, 1.0e5, "s", "Time at which it ends, at least 1 s later.")]
    speed: Annotated[float, number(-80.0, 80.0, "m/s", "Largest velocity, positive along y.")]

    def __post_init__(self) -> None:
        """Check the fields and their order in time."""
        super().__post_init__()
        if self.end < self.start + 2 * BLOCK_EDGE:
            raise ValueError(f"end = {self.end:g} must be at least {self.start + 2 * BLOCK_EDGE:g}")


def wind_at(wind: tuple[Wind, ...], time: Array) -> Array:
    """Return the wind velocity in `map`, (..., 2) [m/s], at times (...) [s]."""
    velocity = np.zeros((*time.shape, 2))
    for piece in wind:
        if piece.kind == "gust":
            z = np.clip((time - piece.start) / (piece.end - piece.start), 0.0, 1.0)
            shape = (1 - np.cos(math.tau * z)) / 2
        else:
            shape = q((time - piece.start) / BLOCK_EDGE) * q((piece.end - time) / BLOCK_EDGE)
        velocity[..., 1] += piece.speed * shape
    return velocity


def wind_of_steps(wind: tuple[Wind, ...], begin_ns: int, step_ns: int, steps: int) -> Array:
    """Return the wind velocity in `map` at begin, middle and end of steps, (steps, 3, 2) [m/s].

    Args:
        wind: Wind of the drive.
        begin_ns: Time of the first step [ns].
        step_ns: Step of the integration [ns].
        steps: Number of steps.
    """
    half_steps = 2 * np.arange(steps)[:, np.newaxis] + np.arange(3)
    return wind_at(wind, (begin_ns + 0.5 * step_ns * half_steps) / NANOSECONDS)
