"""Lines of the report: series of one quantity, thinned so that their peaks remain."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tsdownsample import MinMaxDownsampler, MinMaxLTTBDownsampler

from ampc_msgs_config.paths.path import Array

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito: distinct for colour-blind readers, without the yellow (invisible on white)."""
GREY = "#767676"
LONG_GAP = 5.0
"""A line is interrupted where data are missing for more than this many median steps."""
DIGITS = 4
"""Digits of the range of a line that remain after rounding; they decide the size of the page."""
FEW = 4
"""Smallest number of points of a thinned line."""
SHAPE, EXTREMES = MinMaxLTTBDownsampler(), MinMaxDownsampler()
Indices = NDArray[np.int64]


class Series(NamedTuple):
    """One line of a panel."""

    label: str
    """Displayed quantity; the same for all drives."""
    time: Array
    """(n,) since the first command [s]."""
    values: Array
    """(n,) in the unit of the axis."""
    kind: int = 0
    """Number of the line within its panel: decides its colour or dash."""
    step: bool = False
    """Whether a value holds until the next one."""
    bound: bool = False
    """Whether the line is a limit of the others."""


def color_of(series: Series, drive: int, drives: int) -> str:
    """Return the colour of a line: by drive, or by kind where there is only one drive."""
    if series.bound and drives == 1:
        return GREY
    return PALETTE[(drive if drives > 1 else series.kind) % len(PALETTE)]


def thinned(series: Series, points: int) -> tuple[list[Any], list[Any]]:
    """Return time and values of about `points` points, with all peaks; None marks a gap."""
    finite = np.isfinite(series.values)
    time, values = series.time[finite], series.values[finite]
    keep: Indices = np.arange(len(time))
    if series.step and len(time) > FEW:
        keep = changes(values)
    if len(keep) > points:
        keep = keep[peaks(time[keep], values[keep], points)]
    gaps = long_gaps(time)
    keep = np.union1d(keep, np.concatenate((gaps, gaps + 1))).astype(int)
    x, y = rounded(time[keep], 6), rounded(values[keep], DIGITS)
    for place in np.flatnonzero(np.isin(keep, gaps))[::-1]:
        x.insert(place + 1, x[place])
        y.insert(place + 1, None)
    return x, y


def peaks(time: Array, values: Array, points: int) -> Indices:
    """Choose indices by MinMaxLTTB, and the smallest and largest value of each bucket.

    Largest triangles alone preserve the shape but may omit the top of a peak.
    """
    x, y = np.ascontiguousarray(time), np.ascontiguousarray(values)
    shape = SHAPE.downsample(x, y, n_out=max(points, FEW))
    extremes = EXTREMES.downsample(y, n_out=max(points // 8 * 2, FEW))
    return np.asarray(np.union1d(shape, extremes), dtype=np.int64)


def changes(values: Array) -> Indices:
    """Return the indices at which a value changes, and both ends."""
    moved = np.flatnonzero(np.diff(values)) + 1
    return np.asarray(np.unique(np.concatenate(([0], moved, [len(values) - 1]))))


def long_gaps(time: Array) -> Indices:
    """Return the indices after which data are missing."""
    steps = np.diff(time)
    if not len(steps):
        return np.empty(0, dtype=np.int64)
    return np.asarray(np.flatnonzero(steps > LONG_GAP * max(float(np.median(steps)), 1e-9)))


def rounded(values: Array, digits: int) -> list[Any]:
    """Return the values as Python numbers, rounded to so many digits of their range."""
    span = float(np.ptp(values)) if len(values) else 0.0
    span = span or float(np.abs(values).max(initial=0.0)) or 1.0
    places = digits - int(np.floor(np.log10(span))) - 1
    return [int(v) if places <= 0 else v for v in np.round(values, max(places, 0)).tolist()]


def thinned_curve(points: Array, most: int) -> Array:
    """Return about `most` points of a curve (n, 2) in the plane, with the peaks of both axes."""
    if len(points) <= most:
        return points
    place = np.arange(len(points), dtype=float)
    chosen = [peaks(place, points[:, k], most // 2) for k in (0, 1)]
    kept = np.unique(np.concatenate(([0], *chosen, [len(points) - 1])))
    return np.asarray(points[kept])
