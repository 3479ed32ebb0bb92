"""Side wind of a drive."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.paths.curves import bounded, check_known, q, read_same_as
from ampc_msgs_config.paths.path import Array
from ampc_msgs_config.types import NANOSECONDS

BLOCK_EDGE = 0.5
"""Rise and fall of a block of wind [s]."""


class Wind(NamedTuple):
    """One piece of wind along y of `map`."""

    kind: str
    """`gust`: 1-cos, or `block`."""
    start: float
    end: float
    speed: float


def wind_at(wind: tuple[Wind, ...], time: Array) -> Array:
    """Give the wind velocity in `map`, (n, 2) [m/s], at times (n,) [s]."""
    velocity = np.zeros((len(time), 2))
    for piece in wind:
        if piece.kind == "gust":
            z = np.clip((time - piece.start) / (piece.end - piece.start), 0.0, 1.0)
            shape = (1 - np.cos(math.tau * z)) / 2
        else:
            shape = q((time - piece.start) / BLOCK_EDGE) * q((piece.end - time) / BLOCK_EDGE)
        velocity[:, 1] += piece.speed * shape
    return velocity


def wind_of_steps(wind: tuple[Wind, ...], begin_ns: int, step_ns: int, steps: int) -> Array:
    """Give the wind velocity in `map` at steps of the integration, (steps, 2) [m/s].

    Args:
        wind: Of the drive.
        begin_ns: Time of the first step [ns].
        step_ns: Of the integration [ns].
        steps: How many.
    """
    return wind_at(wind, (begin_ns + step_ns * np.arange(steps)) / NANOSECONDS)


def read_wind(content: Any) -> tuple[Wind, ...]:
    """Read the wind of a scenario file; a ValueError names the key, the value and the bound."""
    if isinstance(content, Mapping):
        return read_wind(read_same_as(content["same_as"], "wind"))
    if not isinstance(content, list):
        raise ValueError(f"wind = {content!r} must be a list")
    return tuple(_wind_piece(item) for item in content)


def _wind_piece(item: Mapping[str, Any]) -> Wind:
    check_known(item, {"kind", "start", "end", "speed"}, "wind")
    if item["kind"] not in ("gust", "block"):
        raise ValueError(f"wind: kind = {item['kind']!r} must be gust or block")
    start = bounded(item, "start", 0.0, 1.0e5)
    end = bounded(item, "end", start + 2 * BLOCK_EDGE, 1.0e5)
    return Wind(item["kind"], start, end, bounded(item, "speed", -80.0, 80.0))
