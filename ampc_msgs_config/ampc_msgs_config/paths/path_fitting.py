"""Fit a smooth spline to points, and sample it at equal arc length."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline, make_lsq_spline

from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import Array

SPACING = 0.25
"""Distance of the samples of a path; greater on paths beyond 250 km [m]."""
MAX_SAMPLES = 1_000_000
MIN_GAP = 1e-3
"""Points closer than this to their predecessor are dropped as duplicates [m]."""
ROUNDING = 1e-6
"""Rounding of lengths that may not change the result when a path is moved or turned [m]."""
KNOT_GAP = 1.0
"""Smoothing: least distance of the knots of the spline, so that finer wiggles are averaged [m]."""
MAX_LENGTH = 2.0e6
"""Longest path; an outlier in another frame would fill the memory with samples [m]."""
CLOSING_GAP = 1.5
"""Greatest distance of the ends of a closed path [median spacings]."""
OVERLAP = 12
"""Points of the other end that continue a closed path before the fit, so that it is smooth."""


def make_path(points: ArrayLike) -> Path:
    """Fit a smooth curve to points, and sample it at equal arc length.

    The curve is a cubic least-squares spline with knots at the points, none closer than 1 m. Points
    1 m or more apart are interpolated exactly, finer ones are averaged, corners become bends. A
    path whose ends meet in the same direction is closed and continues for any number of laps.

    Args:
        points: (n, 2) positions in driving order [m]; duplicates are dropped.

    Returns:
        The path. Two points give a straight line.

    Raises:
        ValueError: Not (n, 2), not finite, too long, or fewer than two different points.
    """
    corners = _different_points(np.asarray(points, dtype=float))
    origin = corners[0].copy()  # a spline far from the origin of the map would lose digits
    corners = corners - origin
    closed = _is_closed(corners)
    if closed:
        corners = _overlapped(corners)
    chord = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    if chord[-1] > MAX_LENGTH:
        raise ValueError(f"path: length = {chord[-1]:g} must be at most {MAX_LENGTH:g} m")
    ends = (chord[OVERLAP], chord[-OVERLAP - 1]) if closed else (0.0, chord[-1])
    return _sampled(_spline(chord, corners), ends, origin, closed)


def cached_path(points: Array) -> Path:
    """Return `make_path` of points (n, 2) [m]; equal points are fitted once."""
    return _path_of(np.ascontiguousarray(points, dtype=float).tobytes())


@lru_cache(maxsize=8)
def _path_of(points: bytes) -> Path:
    return make_path(np.frombuffer(points).reshape(-1, 2))


def _is_closed(corners: Array) -> bool:
    """Return whether the last point leads to the first one."""
    steps = np.diff(corners, axis=0)
    spacing = np.median(np.hypot(*steps.T))
    gap = corners[0] - corners[-1]
    if len(corners) <= OVERLAP or np.hypot(*gap) > CLOSING_GAP * spacing:
        return False
    return bool(steps[-1] @ steps[0] > 0 and gap @ steps[0] >= 0 and gap @ steps[-1] >= 0)


def _overlapped(corners: Array) -> Array:
    """Return a closed path from its first point to that point again, continued at both ends."""
    if np.hypot(*(corners[-1] - corners[0])) <= MIN_GAP:
        corners = corners[:-1]
    return np.concatenate((corners[-OVERLAP:], corners, corners[: OVERLAP + 1]))


def _spline(chord: Array, corners: Array) -> Any:
    """Return a cubic spline over the chord length; least squares where points are fine."""
    knots = [0]
    gap = (
        KNOT_GAP - ROUNDING
    )  # without it, moving a path with spacings that divide 1 m would move knots
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
    different = points[np.concatenate(([True], gap > MIN_GAP))[: len(points)]]
    if len(different) < 2:
        raise ValueError(f"path: {len(different)} different points, at least 2 are needed")
    return np.asarray(different)


def _arc_length(spline: Any, parameter: Array) -> Array:
    """Integrate the speed of a curve over its parameter, by Simpson's rule on every interval."""
    middle = (parameter[:-1] + parameter[1:]) / 2
    speed = np.hypot(*spline(parameter, nu=1).T)
    speed_middle = np.hypot(*spline(middle, nu=1).T)
    steps = np.diff(parameter) / 6 * (speed[:-1] + 4 * speed_middle + speed[1:])
    return np.concatenate(([0.0], np.cumsum(steps)))
