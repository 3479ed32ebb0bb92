"""A path as the controller needs it: arc length, heading, curvature, projection, sampling."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.types import VehicleState, wrap_angle

Array = NDArray[np.float64]

SPACING = 0.25
"""Distance of the samples that a path is stored in [m]."""
MIN_GAP = 1e-3
"""Points closer than this to their predecessor are dropped as duplicates [m]."""
MAX_LENGTH = 2.0e5
"""Longest path; one stray point in another frame would fill the memory with samples [m]."""
FIRST_CATCH = 3.0
"""Where a path comes by twice, the first part counts that is nearest up to this [m]."""


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
    """Draw a cubic spline through points and sample it at equal arc length.

    Args:
        points: (n, 2) positions in driving order [m]; spacing may vary, duplicates are dropped.

    Returns:
        The path. Two points give a straight line.

    Raises:
        ValueError: Not (n, 2), not finite, too long, or fewer than two different points.
    """
    corners = _different_points(np.asarray(points, dtype=float))
    chord = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    if chord[-1] > MAX_LENGTH:
        raise ValueError(f"path: length = {chord[-1]:g} must be at most {MAX_LENGTH:g} m")
    spline = make_interp_spline(chord, corners, k=min(3, len(corners) - 1))
    fine = np.linspace(0.0, chord[-1], 4 * math.ceil(chord[-1] / SPACING) + 1)
    length = _arc_length(spline, fine)
    count = math.ceil(length[-1] / SPACING) + 1
    parameter = np.interp(np.linspace(0.0, length[-1], count), length, fine)
    (x, y), (dx, dy), (ddx, ddy) = (spline(parameter, nu=order).T for order in (0, 1, 2))
    return Path(
        spacing=float(length[-1]) / (count - 1),
        x=np.ascontiguousarray(x),
        y=np.ascontiguousarray(y),
        heading=np.unwrap(np.arctan2(dy, dx)),
        curvature=(dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3,
    )


def _different_points(points: Array) -> Array:
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"path: shape {points.shape} must be (n, 2)")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points).all(axis=1))[0, 0])
        raise ValueError(f"path: point {row} = {points[row].tolist()} must be finite")
    gap = np.hypot(*np.diff(points, axis=0).T)
    kept = points[np.concatenate(([True], gap > MIN_GAP))]
    if len(kept) < 2:
        raise ValueError(f"path: {len(kept)} different points, at least 2 are needed")
    return np.asarray(kept)


def _arc_length(spline: object, parameter: Array) -> Array:
    """Integrate the speed of a curve over its parameter, by Simpson's rule on every interval."""
    middle = (parameter[:-1] + parameter[1:]) / 2
    speed = np.hypot(*spline(parameter, nu=1).T)  # type: ignore[operator]
    speed_middle = np.hypot(*spline(middle, nu=1).T)  # type: ignore[operator]
    steps = np.diff(parameter) / 6 * (speed[:-1] + 4 * speed_middle + speed[1:])
    return np.concatenate(([0.0], np.cumsum(steps)))


@compiled
def point_at(path: Path, s: float) -> PathPoint:
    """Give the point at arc length `s` [m]; beyond an end the path goes on straight."""
    last = len(path.x) - 1
    place = s / path.spacing
    i = min(max(int(place), 0), last - 1)
    t = min(max(place - i, 0.0), 1.0)
    heading = path.heading[i] + t * (path.heading[i + 1] - path.heading[i])
    beyond = s - min(max(s, 0.0), last * path.spacing)
    return PathPoint(
        path.x[i] + t * (path.x[i + 1] - path.x[i]) + beyond * math.cos(heading),
        path.y[i] + t * (path.y[i + 1] - path.y[i]) + beyond * math.sin(heading),
        heading,
        path.curvature[i] + t * (path.curvature[i + 1] - path.curvature[i]) if beyond == 0 else 0.0,
    )


@compiled
def project(path: Path, x: float, y: float, start: int, stop: int) -> float:
    """Find the arc length of the point nearest to (x, y) among samples `start` .. `stop` - 1.

    Returns:
        Arc length [m]; beyond an end of the whole path it goes on along the end's tangent.
    """
    last = len(path.x) - 1
    nearest, best = start, math.inf
    for i in range(start, stop):
        distance = (path.x[i] - x) ** 2 + (path.y[i] - y) ** 2
        if distance < best:
            nearest, best = i, distance
    along = (x - path.x[nearest]) * math.cos(path.heading[nearest])
    along += (y - path.y[nearest]) * math.sin(path.heading[nearest])
    across = (y - path.y[nearest]) * math.cos(path.heading[nearest])
    across -= (x - path.x[nearest]) * math.sin(path.heading[nearest])
    bend = max(1.0 - across * path.curvature[nearest], 0.5)
    if not ((nearest == 0 and along < 0) or (nearest == last and along > 0)):
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


class Progress:
    """Remembers how far along a path the car is; the whole path is searched only once."""

    def __init__(self, path: Path, window: float = 20.0) -> None:
        """Start on `path`, looking `window` [m] ahead and behind from the second call on."""
        self.path = path
        self.window = math.ceil(window / path.spacing)
        self.index: int | None = None

    def advance(self, x: float, y: float, yaw: float = 0.0) -> float:
        """Give the arc length of the car at (x, y) [m]."""
        count = len(self.path.x)
        if self.index is None:
            self.index = self._first_catch(x, y)
        start, stop = max(self.index - self.window, 0), min(self.index + self.window + 1, count)
        s = project(self.path, x, y, start, stop)
        self.index = min(max(round(s / self.path.spacing), 0), count - 1)
        return s

    def _first_catch(self, x: float, y: float) -> int:
        distance = np.hypot(self.path.x - x, self.path.y - y)
        near = np.append(distance <= distance.min() + FIRST_CATCH, False)
        first = int(np.argmax(near))
        return first + int(np.argmin(distance[first : first + int(np.argmin(near[first:]))]))

    def errors(self, state: VehicleState) -> tuple[float, float]:
        """Give the cross-track error [m] and the heading error [rad] of a state, and move on."""
        point = point_at(self.path, self.advance(state.x, state.y))
        error = cross_track_error(point, state.x, state.y)
        return error, wrap_angle(state.yaw - point.heading)
