"""Smoothing spline through noisy points: the noise is estimated from the points themselves.

The curve is a quintic spline f on a B-spline basis. It minimises

    sum |p_i - f(t_i)|^2 + lambda * integral |f'''(t)|^2 dt,

so that changes of curvature are penalised and a constant curvature costs (almost) nothing. lambda
maximises the restricted likelihood (REML) of the lateral residuals. All matrices are banded;
memory and time are proportional to the number of points.

Sources:
    G. Wahba, Spline Models for Observational Data, SIAM 1990 (smoothing spline as estimator).
    S. N. Wood, Fast stable restricted maximum likelihood and marginal likelihood estimation of
    semiparametric generalized linear models, J. R. Stat. Soc. B 73 (2011), 3-36 (REML).
    P. H. C. Eilers and B. D. Marx, Flexible smoothing with B-splines and penalties, Statistical
    Science 11 (1996), 89-121 (reduced basis).
    C. de Boor, A Practical Guide to Splines, Springer 2001, chapters IX and XIV.
"""

import math
from bisect import bisect_left
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array

from ampc_msgs_config.types import Array

DEGREE = 5
"""Degree of the spline; its curvature has two continuous derivatives."""
ORDER = DEGREE + 1
NULL_SPACE = 3
"""Dimension of the curves without penalty: the polynomials of degree 2."""
SMOOTHING_KNOT_GAP = 1.0
"""Least distance of the knots [m]."""
KNOT_ROUNDING = 1e-6
"""Rounding of lengths that may not change the knots when a path is moved or turned [m]."""
CHORD = 1.0
"""Least length of the chords along which points are ordered [m]."""
ROUGH = 10.0
"""Least length of the chords [noise of the points]."""
MIN_SMOOTHED_LENGTH, LONGEST = 2.0, 100.0
"""Range of the cut-off wavelength of the smoothing [m]."""
RESOLUTION = 1.1
"""Least cut-off wavelength [mean distance of the points]."""
WAVELENGTH_STEP = 1.6
"""Ratio of neighbouring cut-off wavelengths of the search."""
SIGNIFICANT = 3.0
"""Increase of -2 log REML up to which a smoother curve is as likely as the best one.

With few points far apart, REML cannot distinguish noise from short bends and may choose no
smoothing; the smoothest curve that is about as likely then wins.
"""
FEWEST = 20
"""Least number of points from which noise is estimated."""
MOST_ESTIMATED_NOISE = 0.4
"""Larger estimated noise [m] is a defect of the path: its points are then checked as they are."""
SHORT = 5.0
"""Length of a path below which it is not smoothed [m]."""
LAP_OVERLAP = 200.0
"""Length by which a lap is continued at both ends for the fit, so that it is smooth there [m]."""


class Smoothed(NamedTuple):
    """Smoothing spline of a list of points."""

    curve: Any
    """Spline (BSpline) from the parameter [m] to positions (n, 2) [m]."""
    noise: float
    """Estimated standard deviation of the points across the path [m]."""
    residual: float
    """Root mean square of the distances of the points from the curve [m]."""
    wavelength: float
    """Cut-off wavelength: undulations of this length keep half of their amplitude [m]."""
    length: float
    """Parameter of the last point of the path [m]."""


class Fit(NamedTuple):
    """Solution for one cut-off wavelength."""

    coefficients: Array
    """(count, 2) of the B-splines [m]."""
    across: Array
    """(n,) lateral residuals of the points, positive: left [m]."""
    squares: float
    """S: sum of squares of the lateral residuals, and half of the penalty [m^2]."""
    volume: float
    """log det(G + lambda W) - (count - 3) log(lambda)."""


def chord_parameter(points: Array, chord: float = CHORD, *, closed: bool = False) -> Array:
    """Return the place of each point along a chain of chords through some of them (n,) [m].

    The length of the chain through all points would grow with their noise. Points are projected
    onto the chords; with noise above their spacing, their places may decrease.

    Args:
        points: (n, 2) in driving order [m]; for a closed path the last one repeats the first.
        chord: Least length of the chords [m].
        closed: Whether the chain is that of a lap; otherwise the places lie between its ends.
    """
    ends = _chain(points, chord)
    corners = points[ends]
    steps = np.diff(corners, axis=0)
    lengths = np.hypot(*steps.T)
    start = np.concatenate(([0.0], np.cumsum(lengths)))
    of = np.repeat(np.arange(len(steps)), np.diff(ends))
    along = np.einsum("ij,ij->i", points[:-1] - corners[of], steps[of]) / lengths[of]
    place = np.append(start[of] + along, start[-1])
    return place if closed else np.clip(place, 0.0, start[-1])


def _chain(points: Array, chord: float) -> NDArray[np.int64]:
    """Return the indices of points at least `chord` apart, from the first to the last point."""
    x, y = points.T.tolist()
    # no point is further away than along the path, so that those in between need no look
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T)))).tolist()
    kept, a, b = [0], x[0], y[0]
    i = bisect_left(way, chord - KNOT_ROUNDING, 1)
    while i < len(x):
        if (x[i] - a) ** 2 + (y[i] - b) ** 2 >= chord**2:
            kept.append(i)
            a, b = x[i], y[i]
            i = bisect_left(way, way[i] + chord - KNOT_ROUNDING, i + 1)
        else:
            i += 1
    last = len(x) - 1
    if kept[-1] != last:
        if len(kept) > 2 and math.hypot(x[last] - a, y[last] - b) < chord / 2:
            kept[-1] = last
        else:
            kept.append(last)
    return np.array(kept)


def knots_of(places: Array) -> Array:
    """Return knots at the places, none closer than 1 m, with the end knots repeated (k,) [m]."""
    ordered = np.sort(places).tolist()
    breaks, last = [], 0
    while last < len(ordered):
        breaks.append(ordered[last])
        last = bisect_left(ordered, ordered[last] + SMOOTHING_KNOT_GAP - KNOT_ROUNDING, last + 1)
    end = ordered[-1]
    if end - breaks[-1] < SMOOTHING_KNOT_GAP / 2 and len(breaks) > 1:
        breaks[-1] = end
    elif end > breaks[-1]:
        breaks.append(end)
    return np.array([breaks[0]] * DEGREE + breaks + [end] * DEGREE)


class Basis:
    """B-splines that do not vanish at given places: ORDER of them at each place."""

    def __init__(self, knots: Array, places: Array) -> None:
        """Prepare the evaluation at places (n,) within the knots [m]."""
        self.count = len(knots) - ORDER
        self.places = places
        interval = np.searchsorted(knots, places, side="right") - 1
        self.first = np.clip(interval, DEGREE, self.count - 1) - DEGREE
        # every sixth basis function in one column: on each interval they do not overlap
        comb = np.zeros((self.count, ORDER))
        comb[np.arange(self.count), np.arange(self.count) % ORDER] = 1.0
        self.comb = BSpline(knots, comb, DEGREE)
        self.columns = (self.first[:, None] + np.arange(ORDER)) % ORDER

    def values(self, derivative: int = 0) -> Array:
        """Return the basis functions first ... first + DEGREE at each place (n, ORDER)."""
        return np.take_along_axis(self.comb(self.places, derivative), self.columns, axis=1)

    def gram(self, values: Array) -> Array:
        """Return B^T B as lower bands (ORDER, count)."""
        bands = np.zeros((ORDER, self.count))
        for row in range(ORDER):
            for column in range(row + 1):
                product = values[:, row] * values[:, column]
                bands[row - column] += np.bincount(self.first + column, product, self.count)
        return bands

    def matrix(self, values: Array) -> Any:
        """Return B as a sparse matrix (n, count)."""
        columns = (self.first[:, None] + np.arange(ORDER)).ravel()
        rows = ORDER * np.arange(len(self.first) + 1)
        return csr_array((values.ravel(), columns, rows), shape=(len(self.first), self.count))


def bends(knots: Array) -> tuple[Array, Any]:
    """Return the penalty matrix of the knots and its factor, exact by Gauss's rule.

    Returns:
        Lower bands (ORDER, count) of W, the integrals of products of third derivatives, and
        sparse J (k, count) with W = J^T J.
    """
    breaks = np.unique(knots)
    half, middle = np.diff(breaks) / 2, (breaks[1:] + breaks[:-1]) / 2
    node, weight = np.polynomial.legendre.leggauss(3)
    places = (middle[:, None] + half[:, None] * node).ravel()
    basis = Basis(knots, places)
    values = basis.values(3) * np.sqrt((half[:, None] * weight).ravel())[:, None]
    return basis.gram(values), basis.matrix(values)


class Smoother:
    """Smoothing problem of one list of points, solved for any strength of the smoothing."""

    def __init__(self, places: Array, points: Array) -> None:
        """Build the matrices of points (n, 2) at places (n,) [m]."""
        self.points, self.knots = points, knots_of(places)
        self.basis = Basis(self.knots, places)
        values = self.basis.values()
        self.values = self.basis.matrix(values)
        self.slopes = self.basis.matrix(self.basis.values(1))
        self.gram = self.basis.gram(values)
        self.moments = self.values.T @ points
        self.penalty, self.bends = bends(self.knots)
        self.density = len(places) / float(self.knots[-1] - self.knots[0])

    def fit(self, wavelength: float) -> Fit:
        """Solve for one cut-off wavelength [m].

        On points of density rho, undulations of angular frequency w keep the share
        1 / (1 + lambda w^6 / rho) of their amplitude, whence lambda = rho (wavelength / 2 pi)^6.
        """
        strength = self.density * (wavelength / math.tau) ** 6
        factor = cholesky_banded(
            self.gram + strength * self.penalty, lower=True, check_finite=False
        )
        found = cho_solve_banded((factor, True), self.moments, check_finite=False)
        rest = self.points - self.values @ found
        tangent = self.slopes @ found
        across = (rest[:, 1] * tangent[:, 0] - rest[:, 0] * tangent[:, 1]) / np.hypot(*tangent.T)
        rough = self.bends @ found
        squares = float(across @ across) + strength * float((rough * rough).sum()) / 2
        volume = 2 * float(np.log(factor[0]).sum())
        volume -= (self.basis.count - NULL_SPACE) * math.log(strength)
        return Fit(np.asarray(found, dtype=float), across, squares, volume)

    def criterion(self, wavelength: float, noise: float | None) -> float:
        """Return -2 log REML; noise: standard deviation of the points [m], None: estimated."""
        _, _, squares, volume = self.fit(wavelength)
        free = len(self.points) - NULL_SPACE
        if noise is not None:
            return squares / noise**2 + volume
        return free * math.log(max(squares, 1e-12 * free) / free) + volume


def smoothed(points: Array, noise: float | None, closed: bool) -> Smoothed | None:
    """Smooth a path according to the noise of its points.

    Args:
        points: (n, 2) positions near the origin, in driving order [m]; for a closed path the last
            one repeats the first.
        noise: Standard deviation of the points [m]; None: estimated.
        closed: Whether the path is a lap.

    Returns:
        The smoothing spline from parameter 0 to the place of the last point; None if the points
        are too few or too close together, or their estimated noise exceeds MOST_ESTIMATED_NOISE.
    """
    if len(points) < (FEWEST if noise is None else NULL_SPACE + 1):
        return None
    result = None
    chord = CHORD if noise is None else max(CHORD, ROUGH * noise)
    for _ in range(2):
        if len(_chain(points, chord)) <= SHORT / CHORD:
            break
        places = chord_parameter(points, chord, closed=closed)
        length = float(places[-1])
        try:
            found = smooth(*(_overlapped(places, points) if closed else (places, points)), noise)
        except np.linalg.LinAlgError:  # nearly all points lie in the same places
            break
        result = found._replace(length=length)
        if ROUGH * found.noise <= chord:
            break
        chord = ROUGH * found.noise
    if noise is None and result is not None and result.noise > MOST_ESTIMATED_NOISE:
        return None
    return result


def _overlapped(places: Array, points: Array) -> tuple[Array, Array]:
    """Return places and points of a lap, continued at both ends."""
    lap = places[-1]
    reach = min(LAP_OVERLAP, lap)
    before, after = places[:-1] > lap - reach, places[:-1] < reach
    where = np.concatenate((places[:-1][before] - lap, places[:-1], places[:-1][after] + lap))
    base = points[:-1]
    return where, np.concatenate((base[before], base, base[after]))


def smooth(places: Array, points: Array, noise: float | None = None) -> Smoothed:
    """Smooth points according to their noise.

    Args:
        places: (n,) place of each point along the path [m].
        points: (n, 2) positions near the origin [m].
        noise: Standard deviation of the points [m]; None: estimated.
    """
    problem = Smoother(places, points)
    wavelength = _wavelength(problem, noise)
    found, across, squares, _ = problem.fit(wavelength)
    return Smoothed(
        curve=BSpline(problem.knots, found, DEGREE),
        noise=math.sqrt(squares / (len(points) - NULL_SPACE)) if noise is None else noise,
        residual=math.sqrt(float(across @ across) / len(across)),
        wavelength=wavelength,
        length=float(problem.knots[-1]),
    )


def _wavelength(problem: Smoother, noise: float | None) -> float:
    """Return the longest cut-off wavelength that is about as likely as the best one [m].

    The whole range is searched on a coarse grid, since the criterion may have a second minimum on
    points far apart; then parabolas in log(wavelength) refine the place.
    """
    shortest = max(MIN_SMOOTHED_LENGTH, RESOLUTION / problem.density)
    longest = min(LONGEST, float(problem.knots[-1] - problem.knots[0]))
    count = 2 + int(math.log(max(longest / shortest, 1.0), WAVELENGTH_STEP))
    grid = [shortest * WAVELENGTH_STEP**i for i in range(count)]
    values = [problem.criterion(each, noise) for each in grid]
    best = int(np.argmin(values))
    if not 0 < best < count - 1:
        least = values[best]
        place = float(best)
    else:
        below, least, above = values[best - 1 : best + 2]
        bend = below - 2 * least + above
        offset = (below - above) / (2 * bend)
        place, least = best + offset, least - bend * offset**2 / 2
    bound = least + SIGNIFICANT
    last = max((i for i in range(count) if values[i] <= bound), default=best)
    if best < last < count - 1:
        rise = values[last + 1] - values[last]
        place = last + (bound - values[last]) / rise
    return float(shortest * WAVELENGTH_STEP**place)
