"""Analytic paths of the scenarios: the paper's lane changes, ISO 3888, simple shapes."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import Checked, described, number


class Lane(NamedTuple):
    """Gate of cones of an ISO track, with the range of X and Y that it leaves free."""

    start: Annotated[float, number(-1.0e6, 1.0e6, "m", "X at which the gate begins.")]
    end: Annotated[float, number(-1.0e6, 1.0e6, "m", "X at which the gate ends.")]
    right: Annotated[float, number(-1.0e6, 1.0e6, "m", "Y of the right row of cones.")]
    left: Annotated[float, number(-1.0e6, 1.0e6, "m", "Y of the left row of cones.")]


Curve = Callable[[Array], Array]
"""Function from X or arc length (n,) [m] to points (n, 2) [m]."""
Track = tuple[Curve, tuple[Lane, ...]]
"""Curve, and the lanes of an ISO track."""


@compiled
def q(z: Any) -> Any:
    """Rise smoothly from 0 to 1 while z goes from 0 to 1: 10 z^3 - 15 z^4 + 6 z^5."""
    z = np.minimum(np.maximum(z, 0.0), 1.0)
    return z * z * z * (10.0 + z * (6.0 * z - 15.0))


class PathShape(msgspec.Struct, frozen=True, tag_field="kind", forbid_unknown_fields=True):
    """Analytic path of a scenario file; `kind` selects one of the subclasses."""


@dataclass(frozen=True, kw_only=True)
class Move(Checked):
    """One lateral move of a path."""

    start: Annotated[float, number(-1.0e5, 1.0e5, "m", "X at which the move begins.")]
    over: Annotated[float, number(0.1, 1.0e5, "m", "Length of the move along X.")]
    by: Annotated[float, number(-1.0e4, 1.0e4, "m", "Change of Y.")]


class Moves(PathShape, frozen=True, tag="moves"):
    """Sum of lateral moves with q(z) = 10 z^3 - 15 z^4 + 6 z^5."""

    moves: tuple[Move, ...]


class TanhLaneChange(PathShape, frozen=True, tag="tanh_lane_change"):
    """Smooth double lane change of the literature (Falcone)."""


class Straight(PathShape, frozen=True, tag="straight"):
    """Straight line along X."""


class Sine(PathShape, frozen=True, tag="sine"):
    """Sine whose amplitude rises with q over the first wavelength."""

    amplitude: Annotated[float, number(-1000.0, 1000.0, "m", "Amplitude.")]
    wavelength: Annotated[float, number(1.0, 1.0e5, "m", "Wavelength.")]


class Circle(PathShape, frozen=True, tag="circle"):
    """Circle through the origin, tangent to X."""

    radius: Annotated[
        float, number(-1.0e5, 1.0e5, "m", "Radius, at least 1; positive: to the left.")
    ]

    def __post_init__(self) -> None:
        """Check that the circle is no point."""
        if abs(self.radius) < 1.0:
            raise ValueError(f"radius = {self.radius:g} must be at least 1 m to either side")


class Iso3888(PathShape, frozen=True, tag="iso3888"):
    """Track of ISO 3888 for the width of the car."""

    part: Annotated[int, number(1, 2, "", "Part of the standard.")]


class StretchedPath(PathShape, frozen=True, tag="same_as"):
    """Path of another scenario, stretched along X."""

    scenario: Annotated[str, described("Shipped scenario, or YAML file.")]
    stretch: Annotated[float, number(0.01, 100.0, "", "Factor along X.")] = 1.0


AnyPath = Moves | TanhLaneChange | Straight | Sine | Circle | Iso3888 | StretchedPath


def build_curve(shape: AnyPath, size: SizeParameters) -> Track:
    """Return the curve of a path shape, and its lanes for a car of this size.

    Args:
        shape: Any shape but a `StretchedPath`, which refers to another scenario.
        size: Outline of the car.
    """
    match shape:
        case Moves(moves):
            return _graph(lambda x: sum((m.by * q((x - m.start) / m.over) for m in moves), 0.0 * x))
        case TanhLaneChange():
            return _graph(_tanh_lane_change)
        case Straight():
            return _graph(np.zeros_like)
        case Sine(amplitude, wavelength):
            wave = math.tau / wavelength
            return _graph(lambda x: amplitude * np.sin(wave * x) * q(x * wave / math.tau))
        case Circle(r):
            return (lambda s: r * np.column_stack((np.sin(s / r), 1 - np.cos(s / r)))), ()
        case Iso3888(part):
            return _iso3888(part, size.width)
    raise TypeError(f"{shape} has no curve of its own")


def stretched(track: Track, factor: float) -> Track:
    """Return a track with X multiplied by a factor."""
    curve, lanes = track
    longer = (lane._replace(start=lane.start * factor, end=lane.end * factor) for lane in lanes)
    return (lambda x: curve(x / factor) * np.array([factor, 1.0])), tuple(longer)


def _graph(function: Callable[[Array], Array]) -> Track:
    """Return the curve of Y(X), without lanes."""
    return (lambda x: np.column_stack((x, function(x)))), ()


def _tanh_lane_change(x: Array) -> Array:
    z1 = 2.4 / 25.0 * (x - 27.19) - 1.2
    z2 = 2.4 / 21.95 * (x - 56.46) - 1.2
    return np.asarray(4.05 / 2 * (1 + np.tanh(z1)) - 5.7 / 2 * (1 + np.tanh(z2)))


ISO_SECTIONS = {1: (15.0, 30.0, 25.0, 25.0, 30.0), 2: (12.0, 13.5, 11.0, 12.5, 12.0)}
"""Lengths of entry lane, change, side lane, change back, exit lane [m]."""
ISO_ENTRY = 40.0
"""Straight approach before the first cone [m]."""
ISO_ROOM = {1: (0.35, 0.3), 2: (0.35, 0.5)}
"""Share of an outer lane and of the side lane that a lane change uses at each of its ends."""


def _iso3888(part: int, width: float) -> Track:
    """Return the ISO 3888 track: a smooth path from the middle to the middle of its lanes.

    A lane change begins before the end of one lane and ends after the start of the next, as far as
    the lanes leave room beside the car; from cone to cone it would need 16 m/s^2. With `ISO_ROOM`
    the shipped ordinary car passes fastest (measured with `acceptance.py --only iso3888`).

    Note:
        Widths follow the vehicle's: 1.1 b + 0.25, then 1.2 b + 0.25 (part 1) or b + 1 (part 2),
        then 1.3 b + 0.25 m (at least 3 m in part 2). The 3.5 m offset of part 1 is read between
        the RIGHT edges of entry and side lane; the 1 m of part 2 from the left edge of the entry
        lane to the right edge of the side lane. The exit lane shares the entry lane's right edge.
    """
    entry, side, leave = 1.1 * width + 0.25, 1.2 * width + 0.25, 1.3 * width + 0.25
    right = 3.5 - entry / 2
    if part == 2:
        side, leave = width + 1.0, max(leave, 3.0)
        right = entry / 2 + 1.0
    edges = ISO_ENTRY + np.concatenate(([0.0], np.cumsum(ISO_SECTIONS[part])))
    lanes = (
        Lane(edges[0], edges[1], -entry / 2, entry / 2),
        Lane(edges[2], edges[3], right, right + side),
        Lane(edges[4], edges[5], -entry / 2, leave - entry / 2),
    )
    middle = [(lane.left + lane.right) / 2 for lane in lanes]
    out, back = middle[1] - middle[0], middle[2] - middle[1]

    lengths = np.diff(edges)
    outer, inner = ISO_ROOM[part]
    begin = edges[[1, 3]] - np.array([outer, inner]) * lengths[[0, 2]]
    end = edges[[2, 4]] + np.array([inner, outer]) * lengths[[2, 4]]

    def lateral(x: Array) -> Array:
        rise, fall = (q((x - a) / (b - a)) for a, b in zip(begin, end, strict=True))
        return np.asarray(middle[0] + out * rise + back * fall)

    return _graph(lateral)[0], lanes
