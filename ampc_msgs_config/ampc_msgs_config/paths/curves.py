"""Analytic paths of the scenarios: the paper's lane changes, ISO 3888, simple shapes."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import config
from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.path import Array


class Lane(NamedTuple):
    """A gate of cones of an ISO track, from `start` to `end` along X [m]."""

    start: float
    end: float
    right: float
    left: float


@compiled
def q(z: Any) -> Any:
    """Rise smoothly from 0 to 1 while z goes from 0 to 1: 10 z^3 - 15 z^4 + 6 z^5."""
    z = np.minimum(np.maximum(z, 0.0), 1.0)
    return z * z * z * (10.0 + z * (6.0 * z - 15.0))


def check_known(content: Any, keys: Iterable[str], where: str) -> None:
    """Raise a ValueError unless `content` is a mapping with no other keys than these."""
    if not isinstance(content, Mapping):
        raise ValueError(f"{where} = {content!r} must be a mapping of keys")
    for key in content:
        if key not in keys:
            raise ValueError(f"{where}: unknown key {key!r}; known are {', '.join(sorted(keys))}")


def bounded(
    content: Mapping[str, Any], key: str, low: float, high: float, default: float | None = None
) -> float:
    """Give a number of a mapping, or raise a ValueError with key, value and bound."""
    value = content[key] if default is None else content.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ValueError(f"{key} = {value!r} must be a number in [{low:g}, {high:g}]")
    return float(value)


def read_same_as(name: str, key: str) -> Any:
    """Read the value of a key in the scenario that `same_as` names; it must be that one's own."""
    file = config.find("scenarios", name)
    value = config.read(file).get(key)
    if value is None:
        raise ValueError(f"{file}: missing key {key!r}")
    if isinstance(value, Mapping) and (value.get("kind") == "same_as" or "same_as" in value):
        raise ValueError(f"{file}: {key} is the same as another's: name that one")
    return value


Curve = Callable[[Array], Array]


def make_curve(content: Mapping[str, Any], size: SizeParameters) -> tuple[Curve, tuple[Lane, ...]]:
    """Give a function from arc length or X (n,) to points (n, 2), and the lanes of ISO tracks."""
    check_known(content, {"kind"}.union(*KEYS.values()), "path")
    kind = content["kind"]
    if kind not in KEYS:
        raise ValueError(f"path: kind = {kind!r} must be one of {', '.join(KEYS)}")
    check_known(content, {"kind", *KEYS[kind]}, f"path of kind {kind}")
    if kind == "same_as":
        return _same_as(content, size)
    if kind == "iso3888":
        return _iso3888(int(bounded(content, "part", 1, 2)), size.width)
    return CURVES[kind](content), ()


def _same_as(content: Mapping[str, Any], size: SizeParameters) -> tuple[Curve, tuple[Lane, ...]]:
    stretch = bounded(content, "stretch", 0.01, 100.0, 1.0)
    curve, lanes = make_curve(read_same_as(content["scenario"], "path"), size)
    longer = (lane._replace(start=lane.start * stretch, end=lane.end * stretch) for lane in lanes)
    return (lambda x: curve(x / stretch) * np.array([stretch, 1.0])), tuple(longer)


def _graph(function: Callable[[Array], Array]) -> Curve:
    return lambda x: np.column_stack((x, function(x)))


def _moves(content: Mapping[str, Any]) -> Curve:
    if not isinstance(content["moves"], list):
        raise ValueError(f"moves = {content['moves']!r} must be a list")
    rows = [_move(row) for row in content["moves"]]
    return _graph(lambda x: sum((by * q((x - at) / over) for at, over, by in rows), 0.0 * x))


def _move(row: Any) -> tuple[float, float, float]:
    check_known(row, ("start", "over", "by"), "moves")
    start, over = bounded(row, "start", -1.0e5, 1.0e5), bounded(row, "over", 0.1, 1.0e5)
    return start, over, bounded(row, "by", -1.0e4, 1.0e4)


def _tanh_lane_change(_: Mapping[str, Any]) -> Curve:
    def lateral(x: Array) -> Array:
        z1 = 2.4 / 25.0 * (x - 27.19) - 1.2
        z2 = 2.4 / 21.95 * (x - 56.46) - 1.2
        return np.asarray(4.05 / 2 * (1 + np.tanh(z1)) - 5.7 / 2 * (1 + np.tanh(z2)))

    return _graph(lateral)


def _straight(_: Mapping[str, Any]) -> Curve:
    return _graph(np.zeros_like)


def _sine(content: Mapping[str, Any]) -> Curve:
    amplitude = bounded(content, "amplitude", -1000.0, 1000.0)
    wave = math.tau / bounded(content, "wavelength", 1.0, 1.0e5)
    return _graph(lambda x: amplitude * np.sin(wave * x) * q(x * wave / math.tau))


def _circle(content: Mapping[str, Any]) -> Curve:
    radius = bounded(content, "radius", -1.0e5, 1.0e5)
    if abs(radius) < 1.0:
        raise ValueError(f"radius = {radius:g} must be at least 1 m to either side")
    return lambda s: radius * np.column_stack((np.sin(s / radius), 1 - np.cos(s / radius)))


CURVES: dict[str, Callable[[Mapping[str, Any]], Curve]] = {
    "moves": _moves,
    "tanh_lane_change": _tanh_lane_change,
    "straight": _straight,
    "sine": _sine,
    "circle": _circle,
}
KEYS: dict[str, tuple[str, ...]] = {
    "moves": ("moves",),
    "tanh_lane_change": (),
    "straight": (),
    "sine": ("amplitude", "wavelength"),
    "circle": ("radius",),
    "iso3888": ("part",),
    "same_as": ("scenario", "stretch"),
}
"""What a path of each kind is given by."""

ISO_SECTIONS = {1: (15.0, 30.0, 25.0, 25.0, 30.0), 2: (12.0, 13.5, 11.0, 12.5, 12.0)}
"""Lengths of entry lane, change, side lane, change back, exit lane [m]."""
ISO_ENTRY = 40.0
"""Straight approach before the first cone [m]."""
ISO_ROOM = {1: (0.35, 0.3), 2: (0.35, 0.5)}
"""Share of an outer lane and of the side lane that a change of lanes uses, at each end of it."""


def _iso3888(part: int, width: float) -> tuple[Curve, tuple[Lane, ...]]:
    """Give the ISO 3888 track: smooth path from the middle to the middle of its lanes.

    A change begins before the end of one lane and ends after the start of the next, as far as the
    lanes leave room beside the car; from cone to cone it would ask for 16 m/s^2. `ISO_ROOM` was
    measured: with it the shipped ordinary car passes fastest (`acceptance.py --only iso3888`).

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

    return _graph(lateral), lanes
