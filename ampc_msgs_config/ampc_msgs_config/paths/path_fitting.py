"""Fit a smooth spline to points, and sample it at equal arc length."""

import math
from bisect import bisect_left
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline, make_lsq_spline
from scipy.linalg import solveh_banded

from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.smoothing import smoothed
from ampc_msgs_config.types import Array

SPACING = 0.25
"""Distance of the samples of a path; greater on paths beyond 250 km [m]."""
MAX_SAMPLES = 1_000_000
MIN_GAP = 1e-3
"""Points closer than this to the last point before them are dropped as duplicates [m]."""
CLEAN = 5e-4
"""Root mean square of residuals up to which points have no noise [m]."""
STANDSTILL_POINTS = 10
"""Least number of points of a standstill."""
STANDSTILL_RADIUS = 0.1
"""Greatest distance of the points of a standstill from their mean [m]."""
STANDSTILL_WAY = 3.0
"""Least sum of the steps of a standstill [distance of its ends]."""
ROUNDING = 1e-6
"""Rounding of lengths that may not change the result when a path is moved or turned [m]."""
KNOT_GAP = 1.0
"""Smoothing: least distance of the knots of the spline, so that finer wiggles are averaged [m]."""
MOST_FOR_SCIPY = 2000
"""Points up to which SciPy fits a least-squares spline; its time is quadratic in them."""
MAX_LENGTH = 2.0e6
"""Longest path; an outlier in another frame would fill the memory with samples [m]."""
MAX_COORDINATE = 1.0e9
"""Largest coordinate; the lengths of larger ones overflow [m]."""
CLOSING_GAP = 1.5
"""Greatest distance of the ends of a closed path [median spacings]."""
MEETING = 1.0
"""Distance of the ends up to which they meet, whatever the spacing [m]."""
PASSING = 50.0
"""Distance along the path up to which the ends of an open path are described [m]."""
MAX_TURN = math.radians(60.0)
"""Greatest difference of the directions in which the ends of a closed path meet [rad]."""
FEWEST_OF_LAP = 8
"""Least number of points of a closed path."""
OVERLAP = 12
"""Points of the other end that continue a closed path before the fit, so that it is smooth."""


MAX_ARC = 1.0
"""Greatest turn of the arc that extends a path backwards [rad]."""
START = 5.0
"""Length at the start of a path whose mean curvature is that of the arc [m]."""


class Closure(NamedTuple):
    """Whether a path is closed."""

    closed: bool
    """Whether its end joins its start."""
    reason: str
    """Reason, the second half of the sentence "the path is open: ..."."""


def make_path(points: ArrayLike, path_noise: float | None = None) -> Path:
    """Fit a smooth curve to points, and sample it at equal arc length.

    Points without noise: the curve is a cubic least-squares spline with knots at the points, none
    closer than 1 m. Points 1 m or more apart are interpolated exactly, finer ones are averaged,
    corners become bends. Points with noise: a smoothing spline, see `smoothing`. A path whose ends
    meet in the same direction is closed and continues for any number of laps, see `closure`.

    Args:
        points: (n, 2) positions in driving order [m]; duplicates are dropped, and a standstill
            counts as one point.
        path_noise: Standard deviation of the points [m]; None: estimated from them; 0: the points
            have none.

    Returns:
        The path. Two points give a straight line.

    Raises:
        ValueError: Not (n, 2), not finite, too long, or fewer than two different points; or a
            negative noise.
    """
    if path_noise is not None and not 0.0 <= path_noise < math.inf:
        raise ValueError(f"path: path_noise = {path_noise:g} m must be finite and not negative")
    corners = without_standstills(_different_points(np.asarray(points, dtype=float)))
    origin = corners[0].copy()  # a spline far from the origin of the map would lose digits
    corners, closed = _lap(corners - origin)
    base = np.concatenate((corners, corners[:1])) if closed else corners
    length = float(np.hypot(*np.diff(base, axis=0).T).sum())
    if length > MAX_LENGTH:
        raise ValueError(f"path: length = {length:g} must be at most {MAX_LENGTH:g} m")
    found = None if path_noise == 0.0 else smoothed(base, path_noise, closed)
    if found is not None and (path_noise is not None or found.residual > CLEAN):
        return _sampled(found.curve, (0.0, found.length), origin, closed, found.noise)
    if closed:
        corners = _continued_lap(corners)
    chord = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    ends = (chord[OVERLAP], chord[-OVERLAP - 1]) if closed else (0.0, chord[-1])
    noise = 0.0 if found is None else found.residual
    return _sampled(_spline(chord, corners), ends, origin, closed, noise)


def extended_back(path: Path, length: float) -> Path:
    """Return an open path extended backwards along the arc of its first metres.

    A window that a planner sends may begin ahead of the car. On a circle of 40 m, the straight
    extension of 3 m is 0.11 m beside the road, and that of 10 m 1.25 m.

    Args:
        path: The path; a closed one is returned unchanged.
        length: Length of the extension [m], rounded up to whole samples. Beyond a turn of 1 rad it
            goes on straight.

    Note:
        Arc lengths along the path grow by the added samples.
    """
    if path.closed or length <= 0.0:
        return path
    first = min(max(math.ceil(START / path.spacing), 1), len(path.x) - 1)
    curvature = (path.heading[first] - path.heading[0]) / (first * path.spacing)
    s = path.spacing * np.arange(-math.ceil(length / path.spacing), 0)
    bent = np.maximum(s, -MAX_ARC / max(abs(curvature), 1e-9))
    half = curvature * bent / 2
    chord = bent * np.sinc(half / math.pi)
    heading = path.heading[0] + 2 * half
    direction = path.heading[0] + half
    x = path.x[0] + chord * np.cos(direction) + (s - bent) * np.cos(heading)
    y = path.y[0] + chord * np.sin(direction) + (s - bent) * np.sin(heading)
    return path._replace(
        x=np.concatenate((x, path.x)),
        y=np.concatenate((y, path.y)),
        heading=np.concatenate((heading, path.heading)),
        curvature=np.concatenate((np.where(s < bent, 0.0, curvature), path.curvature)),
    )


def cached_path(points: Array, path_noise: float | None = None) -> Path:
    """Return `make_path` of points (n, 2) [m]; equal points are fitted once."""
    return _path_of(np.ascontiguousarray(points, dtype=float).tobytes(), path_noise)


@lru_cache(maxsize=8)
def _path_of(points: bytes, path_noise: float | None) -> Path:
    return make_path(np.frombuffer(points).reshape(-1, 2), path_noise)


def closure(points: ArrayLike) -> Closure:
    """Return whether the path through points (n, 2) [m] is closed, and the reason."""
    corners = without_standstills(_different_points(np.asarray(points, dtype=float)))
    return _closure(corners)[0]


def _lap(corners: Array) -> tuple[Array, bool]:
    """Return the points of an open path, or those of one lap without the repeated start."""
    found, count = _closure(corners)
    return corners[:count], found.closed


def _closure(corners: Array) -> tuple[Closure, int]:
    """Return whether the last point leads to the first one, and the number of points of a lap."""
    count = len(corners)
    if count < FEWEST_OF_LAP:
        return Closure(False, f"it has {count} points, a lap has at least {FEWEST_OF_LAP}"), count
    gaps = np.hypot(*np.diff(corners, axis=0).T)
    near = max(CLOSING_GAP * float(np.median(gaps)), MEETING)
    apart = float(np.hypot(*(corners[0] - corners[-1])))
    begin, end = _direction(corners), -_direction(corners[::-1])
    along, across = (
        float((corners[-1] - corners[0]) @ begin),
        abs(_cross(begin, corners[-1] - corners[0])),
    )
    if apart > near:
        return Closure(False, _distance_of_ends(corners, gaps, apart, near)), count
    if begin @ end < math.cos(MAX_TURN):
        turn = math.degrees(math.acos(min(max(float(begin @ end), -1.0), 1.0)))
        return Closure(
            False, f"its ends meet, but their directions differ by {turn:.0f} degrees"
        ), count
    if across > max(MEETING / 2, abs(along)):
        return Closure(False, f"its end lies {across:.3g} m beside its start"), count
    # points that repeat the start or lie beyond it belong to the next lap
    while count > 2 and _repeats(corners[count - 1] - corners[0], begin, near):
        count -= 1
    return Closure(True, f"its ends meet within {apart:.3g} m"), count


def _distance_of_ends(corners: Array, gaps: Array, apart: float, near: float) -> str:
    """Return why ends that are too far apart do not close the path."""
    way = np.concatenate(([0.0], np.cumsum(gaps)))
    first = corners[way < min(PASSING, way[-1] / 2)]
    distance = np.hypot(*(first - corners[-1]).T)
    nearest = int(np.argmin(distance))
    if nearest and distance[nearest] <= near:
        return f"its end passes its start by {way[nearest]:.3g} m"
    return f"its ends are {apart:.3g} m apart, those of a lap at most {near:.3g} m"


def _repeats(offset: Array, begin: Array, near: float) -> bool:
    """Return whether a point, as offset from the start [m], repeats it or lies beyond it."""
    distance = float(np.hypot(*offset))
    return distance <= MIN_GAP or (distance <= near and float(offset @ begin) > 0.0)


def _cross(a: Array, b: Array) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def _direction(corners: Array) -> Array:
    """Return the unit vector from the first point to the first one at least 1 m away (2,)."""
    reach = np.hypot(*(corners - corners[0]).T)
    i = int(np.argmax(reach >= MEETING)) or int(np.argmax(reach))
    return np.asarray((corners[i] - corners[0]) / reach[i])


def _continued_lap(corners: Array) -> Array:
    """Return a lap from its first point to that point again, continued at both ends."""
    return np.asarray(corners[np.arange(-OVERLAP, len(corners) + OVERLAP + 1) % len(corners)])


def without_standstills(points: Array) -> Array:
    """Return points (n, 2) [m] with each recorded standstill replaced by its mean.

    A standstill is a run of at least 10 points within 0.1 m of their mean whose steps do not add up
    to a way: together they are three times longer than the distance from the first to the last one.
    """
    runs = STANDSTILL_POINTS - 1
    if len(points) <= runs:
        return points
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    apart = np.hypot(*(points[runs:] - points[:-runs]).T)
    still = (apart < 2 * STANDSTILL_RADIUS) & (way[runs:] - way[:-runs] > STANDSTILL_WAY * apart)
    if not still.any():
        return points
    result: list[Array] = []
    i = 0
    while i < len(points):
        stop = _end_of_standstill(points, i) if i < len(still) and still[i] else i + 1
        result.append(points[i:stop].mean(axis=0) if stop > i + 1 else points[i])
        i = stop
    return np.array(result)


def _end_of_standstill(points: Array, first: int) -> int:
    """Return the index behind the points from the first one on that stay near their mean."""
    centre, stop = points[first].copy(), first + 1
    while stop < len(points) and np.hypot(*(points[stop] - centre)) <= STANDSTILL_RADIUS:
        stop += 1
        centre += (points[stop - 1] - centre) / (stop - first)
    return stop if stop - first >= STANDSTILL_POINTS else first + 1


def _spline(chord: Array, corners: Array) -> Any:
    """Return a cubic spline over the chord length; least squares where points are fine."""
    knots, places = [0], chord.tolist()
    # without the rounding, moving a path with spacings that divide 1 m would move knots
    gap = KNOT_GAP - ROUNDING
    while (following := bisect_left(places, places[knots[-1]] + gap)) < len(places):
        knots.append(following)
    if len(knots) < 6:
        degree = min(3, len(corners) - 1)
        return make_interp_spline(chord, corners, k=degree)
    inner = chord[knots[2:-2]]
    ends = np.repeat(chord[[0, -1]], 4)
    fit = make_lsq_spline if len(chord) <= MOST_FOR_SCIPY else _least_squares_spline
    return fit(chord, corners, np.concatenate((ends[:4], inner, ends[4:])))


def _least_squares_spline(chord: Array, corners: Array, knots: Array) -> BSpline:
    """Return the cubic least-squares spline from its normal equations, in linear time."""
    basis = BSpline.design_matrix(chord, knots, 3)
    gram = (basis.T @ basis).todia()
    bands = np.array([np.append(gram.diagonal(-j), np.zeros(j)) for j in range(4)])
    moments: Any = basis.T @ corners
    coefficients = solveh_banded(bands, moments, lower=True)
    return BSpline(knots, coefficients, 3)


def _sampled(
    spline: Any, ends: tuple[float, float], origin: Array, closed: bool, noise: float
) -> Path:
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
        noise=noise,
    )


def _different_points(points: Array) -> Array:
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"path: shape {points.shape} must be (n, 2)")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points).all(axis=1))[0, 0])
        raise ValueError(f"path: point {row} = {points[row].tolist()} must be finite")
    if points.size and np.abs(points).max() > MAX_COORDINATE:
        row = int(np.argwhere((np.abs(points) > MAX_COORDINATE).any(axis=1))[0, 0])
        raise ValueError(
            f"path: point {row} = {points[row].tolist()} must lie in "
            f"[{-MAX_COORDINATE:g}, {MAX_COORDINATE:g}] m"
        )
    different = _distinct(points)
    if len(different) < 2:
        raise ValueError(f"path: {len(different)} different points, at least 2 are needed")
    return np.asarray(different)


def _distinct(points: Array) -> Array:
    """Return points without those within `MIN_GAP` of the last point kept before them."""
    gap = np.hypot(*np.diff(points, axis=0).T)
    if (gap > MIN_GAP).all():
        return points
    x, y = points.T.tolist()
    kept = [0]
    for i in range(1, len(x)):
        if math.hypot(x[i] - x[kept[-1]], y[i] - y[kept[-1]]) > MIN_GAP:
            kept.append(i)
    return np.asarray(points[kept])


def _arc_length(spline: Any, parameter: Array) -> Array:
    """Integrate the speed of a curve over its parameter, by Simpson's rule on every interval."""
    middle = (parameter[:-1] + parameter[1:]) / 2
    speed = np.hypot(*spline(parameter, nu=1).T)
    speed_middle = np.hypot(*spline(middle, nu=1).T)
    steps = np.diff(parameter) / 6 * (speed[:-1] + 4 * speed_middle + speed[1:])
    return np.concatenate(([0.0], np.cumsum(steps)))
