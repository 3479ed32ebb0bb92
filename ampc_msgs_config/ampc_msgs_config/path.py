"""A path as the controller needs it: arc length, heading, curvature, projection, sampling."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline, make_lsq_spline

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.types import VehicleState, wrap_angle

Array = NDArray[np.float64]

SPACING = 0.25
"""Distance of the samples that a path is stored in; more on paths beyond 250 km [m]."""
MAX_SAMPLES = 1_000_000
MIN_GAP = 1e-3
"""Points closer than this to their predecessor are dropped as duplicates [m]."""
ROUNDING = 1e-6
"""By which lengths may differ where a path is moved or turned without becoming another [m]."""
KNOT_GAP = 1.0
"""Smoothing: the spline has a knot every metre at most, so finer wiggles are averaged [m]."""
MAX_LENGTH = 2.0e6
"""Longest path; one stray point in another frame would fill the memory with samples [m]."""
CLOSING_GAP = 1.5
"""A path is closed where its ends are at most this many (median) spacings apart."""
OVERLAP = 12
"""Points of the other end that a closed path is continued with, so that it closes smoothly."""
FIRST_CATCH = 3.0
"""Where a path comes by twice, the first part counts that is nearest up to this [m]."""
BEHIND, AHEAD = 5.0, 20.0
"""Where the next projection is sought, from the last one [m]."""
LOST = 25.0
"""Farther than this from the path there, the whole path is searched again [m]."""


class Path(NamedTuple):
    """A smooth curve, sampled at equal steps of arc length; compiled code takes it as it is."""

    spacing: float
    """Arc length between samples [m]."""
    x: Array
    """(n,) positions [m]."""
    y: Array
    """(n,) positions [m]."""
    heading: Array
    """(n,) tangent direction, continuous (not wrapped) [rad]."""
    curvature: Array
    """(n,) curvature, positive to the left [1/m]."""
    closed: bool
    """Whether it goes on at its start; then the last sample is the first one again."""

    @property
    def length(self) -> float:
        """Arc length of the whole path [m]."""
        return self.spacing * (len(self.x) - 1)


class PathPoint(NamedTuple):
    """One point of a path."""

    x: float
    y: float
    heading: float
    curvature: float


def make_path(points: ArrayLike) -> Path:
    """Draw a smooth curve through points and sample it at equal arc length.

    A cubic spline by least squares with knots at the points, but none closer than 1 m: points
    a metre or more apart are met exactly, finer ones are averaged, corners become bends. A path
    whose ends meet in the same direction is closed: it goes on for any number of laps.

    Args:
        points: (n, 2) positions in driving order [m]; spacing may vary, duplicates are dropped.

    Returns:
        The path. Two points give a straight line.

    Raises:
        ValueError: Not (n, 2), not finite, too long, or fewer than two different points.
    """
    corners = _different_points(np.asarray(points, dtype=float))
    origin = corners[0].copy()  # far from the origin of the map a spline would lose digits
    corners = corners - origin
    closed = _is_closed(corners)
    if closed:
        corners = _overlapped(corners)
    chord = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    if chord[-1] > MAX_LENGTH:
        raise ValueError(f"path: length = {chord[-1]:g} must be at most {MAX_LENGTH:g} m")
    ends = (chord[OVERLAP], chord[-OVERLAP - 1]) if closed else (0.0, chord[-1])
    return _sampled(_spline(chord, corners), ends, origin, closed)


def _is_closed(corners: Array) -> bool:
    """Whether the last point leads on to the first one."""
    steps = np.diff(corners, axis=0)
    spacing = np.median(np.hypot(*steps.T))
    gap = corners[0] - corners[-1]
    if len(corners) <= OVERLAP or np.hypot(*gap) > CLOSING_GAP * spacing:
        return False
    return bool(steps[-1] @ steps[0] > 0 and gap @ steps[0] >= 0 and gap @ steps[-1] >= 0)


def _overlapped(corners: Array) -> Array:
    """Continue a closed path by points of its other end: from its first point to that again."""
    if np.hypot(*(corners[-1] - corners[0])) <= MIN_GAP:
        corners = corners[:-1]
    return np.concatenate((corners[-OVERLAP:], corners, corners[: OVERLAP + 1]))


def _spline(chord: Array, corners: Array) -> Any:
    """Cubic spline over the chord length: interpolating, or least squares where points are fine."""
    knots = [0]
    gap = KNOT_GAP - ROUNDING  # else equal spacings that divide 1 m give other knots elsewhere
    while (following := int(np.searchsorted(chord, chord[knots[-1]] + gap))) < len(chord):
        knots.append(following)
    if len(knots) < 6:
        degree = min(3, len(corners) - 1)
        return make_interp_spline(chord, corners, k=degree)
    inner = chord[knots[2:-2]]
    ends = np.repeat(chord[[0, -1]], 4)
    return make_lsq_spline(chord, corners, np.concatenate((ends[:4], inner, ends[4:])))


def _sampled(spline: Any, ends: tuple[float, float], origin: Array, closed: bool) -> Path:
    """Sample a spline between two parameters at equal arc length."""
    span = ends[1] - ends[0]
    spacing = max(SPACING, span / MAX_SAMPLES)
    fine = np.linspace(*ends, 4 * math.ceil(span / spacing) + 1, dtype=np.float64)
    length = _arc_length(spline, fine)
    count = math.ceil(length[-1] / spacing - ROUNDING) + 1
    parameter = np.interp(np.linspace(0.0, length[-1], count), length, fine)
    (x, y), (dx, dy), (ddx, ddy) = (spline(parameter, nu=order).T for order in (0, 1, 2))
    return Path(
        spacing=float(length[-1]) / (count - 1),
        x=x + origin[0],
        y=y + origin[1],
        heading=np.unwrap(np.arctan2(dy, dx)),
        curvature=(dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3,
        closed=closed,
    )


def _different_points(points: Array) -> Array:
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"path: shape {points.shape} must be (n, 2)")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points).all(axis=1))[0, 0])
        raise ValueError(f"path: point {row} = {points[row].tolist()} must be finite")
    gap = np.hypot(*np.diff(points, axis=0).T)
    kept = points[np.concatenate(([True], gap > MIN_GAP))[: len(points)]]
    if len(kept) < 2:
        raise ValueError(f"path: {len(kept)} different points, at least 2 are needed")
    return np.asarray(kept)


def _arc_length(spline: Any, parameter: Array) -> Array:
    """Integrate the speed of a curve over its parameter, by Simpson's rule on every interval."""
    middle = (parameter[:-1] + parameter[1:]) / 2
    speed = np.hypot(*spline(parameter, nu=1).T)
    speed_middle = np.hypot(*spline(middle, nu=1).T)
    steps = np.diff(parameter) / 6 * (speed[:-1] + 4 * speed_middle + speed[1:])
    return np.concatenate(([0.0], np.cumsum(steps)))


@compiled
def point_at(path: Path, s: float) -> PathPoint:
    """Give the point at arc length `s` [m]; beyond an end an open path goes on straight."""
    last = len(path.x) - 1
    turned = 0.0
    if path.closed:
        lap = math.floor(s / (last * path.spacing))
        s -= lap * last * path.spacing
        turned = lap * (path.heading[last] - path.heading[0])
    place = s / path.spacing
    i = min(max(int(place), 0), last - 1)
    t = min(max(place - i, 0.0), 1.0)
    heading = path.heading[i] + t * (path.heading[i + 1] - path.heading[i])
    beyond = s - min(max(s, 0.0), last * path.spacing)
    curvature = path.curvature[i] + t * (path.curvature[i + 1] - path.curvature[i])
    return PathPoint(
        path.x[i] + t * (path.x[i + 1] - path.x[i]) + beyond * math.cos(heading),
        path.y[i] + t * (path.y[i + 1] - path.y[i]) + beyond * math.sin(heading),
        heading + turned,
        curvature if beyond == 0.0 else 0.0,
    )


@compiled
def project(path: Path, x: float, y: float, start: int, stop: int) -> float:
    """Find the arc length of the point nearest to (x, y) among samples `start` .. `stop` - 1.

    On a closed path samples are counted on over the laps, backwards too.

    Returns:
        Arc length [m]; beyond an end of an open path it goes on along the end's tangent.
    """
    last = len(path.x) - 1
    nearest, best = start, math.inf
    for i in range(start, stop):
        k = i % last if path.closed else i
        distance = (path.x[k] - x) ** 2 + (path.y[k] - y) ** 2
        if distance < best:
            nearest, best = i, distance
    k = nearest % last if path.closed else nearest
    cos, sin = math.cos(path.heading[k]), math.sin(path.heading[k])
    along = (x - path.x[k]) * cos + (y - path.y[k]) * sin
    across = (y - path.y[k]) * cos - (x - path.x[k]) * sin
    bend = max(1.0 - across * path.curvature[k], 0.5)
    ended = not path.closed and ((k == 0 and along < 0) or (k == last and along > 0))
    if not ended:
        along = min(max(along / bend, -path.spacing), path.spacing)
    return float(nearest * path.spacing + along)


@compiled
def cross_track_error(point: PathPoint, x: float, y: float) -> float:
    """Give the signed distance of (x, y) from a path point's tangent, positive to its left [m]."""
    return (y - point.y) * math.cos(point.heading) - (x - point.x) * math.sin(point.heading)


@compiled
def curvature_between(path: Path, a: float, b: float) -> float:
    """Give the mean curvature from arc length a to b >= a [1/m]."""
    if b - a < path.spacing:
        return point_at(path, (a + b) / 2).curvature
    return (point_at(path, b).heading - point_at(path, a).heading) / (b - a)


def errors_at(path: Path, s: float, state: VehicleState) -> tuple[float, float]:
    """Give the cross-track error [m] and the heading error [rad] of a state at arc length s [m]."""
    point = point_at(path, s)
    error = cross_track_error(point, state.x, state.y)
    return error, wrap_angle(state.yaw - point.heading)


class Progress:
    """Remembers how far along a path the car is: where it crosses itself, progress decides.

    The whole path is searched once; after that each step looks at a window of constant size.
    """

    def __init__(self, path: Path) -> None:
        """Start on `path`, at the place where the car is seen first."""
        self.path = path
        self.index: int | None = None

    def advance(self, x: float, y: float, yaw: float | None = None) -> float:
        """Give the arc length of a car at (x, y) [m].

        Args:
            x: Position [m].
            y: Position [m].
            yaw: Heading; where it is given, the car is first caught by a part of the path that
                leads its way [rad].
        """
        if self.index is None:
            self.index = self._first_catch(x, y, yaw)
        s = self._project(self.index, x, y)
        point = point_at(self.path, s)
        if math.hypot(point.x - x, point.y - y) > LOST:
            self.index = self._first_catch(x, y, yaw)
            s = self._project(self.index, x, y)
        self.index = round(s / self.path.spacing)
        if not self.path.closed:
            self.index = min(max(self.index, 0), len(self.path.x) - 1)
        return s

    def errors(self, state: VehicleState) -> tuple[float, float]:
        """Give the cross-track error [m] and the heading error [rad] of a state, and move on."""
        return errors_at(self.path, self.advance(state.x, state.y, state.yaw), state)

    def _project(self, index: int, x: float, y: float) -> float:
        start = index - math.ceil(BEHIND / self.path.spacing)
        stop = index + math.ceil(AHEAD / self.path.spacing) + 1
        if not self.path.closed:
            start, stop = max(start, 0), min(stop, len(self.path.x))
        return project(self.path, x, y, start, stop)

    def _first_catch(self, x: float, y: float, yaw: float | None) -> int:
        distance = np.hypot(self.path.x - x, self.path.y - y)
        if yaw is not None:
            leads_away = np.cos(self.path.heading - yaw) < 0
            distance = distance + (0.0 if leads_away.all() else np.where(leads_away, np.inf, 0.0))
        near = np.append(distance <= distance.min() + FIRST_CATCH, False)
        first = int(np.argmax(near))
        return first + int(np.argmin(distance[first : first + int(np.argmin(near[first:]))]))
