"""Lines of the report's plots: thinned with their peaks, and coloured alike everywhere."""

from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from tsdownsample import MinMaxDownsampler, MinMaxLTTBDownsampler

from ampc_msgs_config.types import Array

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito: told apart by the colour-blind; their yellow is not seen on white."""
GREY = "#767676"
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
LONG_GAP = 5.0
"""A line is broken where data are missing for longer than this many of its usual steps."""
DIGITS = 4
"""Of the range of a line: rounded further, so that the page stays small."""
FEW = 4
"""Down to this a thinned line makes sense [points]."""


Places = NDArray[np.int64]


class Series(NamedTuple):
    """One line of a plot."""

    label: str
    """What it shows; the same for all bags."""
    time: Array
    values: Array
    kind: int = 0
    """Number of the line within its plot: decides its colour or dash."""
    step: bool = False
    """Whether a value holds until the next one."""
    bound: bool = False
    """Whether it is a limit of the others."""


def color_of(drive: int, drives: int, series: Series) -> str:
    """Give the colour of a line: of its bag, or where there is one bag only, of its kind."""
    if series.bound and drives == 1:
        return GREY
    return PALETTE[(drive if drives > 1 else series.kind) % len(PALETTE)]


def trace(series: Series, drive: int, names: list[str], points: int) -> go.Scatter:
    """Give a line as plotly draws it.

    Args:
        series: What to draw.
        drive: Number of its bag.
        names: Of all bags.
        points: That it may have at most, about.
    """
    time, values = thinned(series, points)
    label = series.label if len(names) == 1 else f"{names[drive]}: {series.label}"
    color = color_of(drive, len(names), series)
    return go.Scatter(
        x=time,
        y=values,
        name=label,
        legendgroup=series.label,
        mode="lines",
        connectgaps=False,
        line=style_of(series, color, len(names)),
    )


def key(series: Series) -> go.Scatter:
    """Give a line for the legend alone: where colours are bags, dashes are what is shown."""
    return go.Scatter(
        x=[None],
        y=[None],
        name=series.label,
        legendgroup=series.label,
        mode="lines",
        line=style_of(series, "#404040", 2),
    )


def style_of(series: Series, color: str, drives: int) -> dict[str, Any]:
    """Give the style of a line."""
    several = drives > 1 or series.bound
    dash = DASHES[series.kind % len(DASHES)] if several else "solid"
    shape = "hv" if series.step else "linear"
    return {"color": color, "width": 1.2 if series.bound else 1.8, "dash": dash, "shape": shape}


SHAPE = MinMaxLTTBDownsampler()
EXTREMES = MinMaxDownsampler()


def thinned(series: Series, points: int) -> tuple[list[Any], list[Any]]:
    """Give at most about `points` places of a line, its peaks among them; None is a gap."""
    finite = np.isfinite(series.values)
    time, values = series.time[finite], series.values[finite]
    keep: Places = np.arange(len(time))
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


def peaks(time: Array, values: Array, points: int) -> Places:
    """Choose places by MinMaxLTTB, and the least and largest of each piece besides.

    Largest triangles alone, which make the shape, may pass by the very top of a peak.
    """
    x, y = np.ascontiguousarray(time), np.ascontiguousarray(values)
    shape = SHAPE.downsample(x, y, n_out=max(points, FEW))
    extremes = EXTREMES.downsample(y, n_out=max(points // 8 * 2, FEW))
    return np.asarray(np.union1d(shape, extremes), dtype=np.int64)


def changes(values: Array) -> Places:
    """Give the places at which a value that holds becomes another, and both ends."""
    moved = np.flatnonzero(np.diff(values)) + 1
    return np.asarray(np.unique(np.concatenate(([0], moved, [len(values) - 1]))))


def long_gaps(time: Array) -> Places:
    """Give the places after which data are missing."""
    steps = np.diff(time)
    if not len(steps):
        return np.empty(0, dtype=np.int64)
    return np.asarray(np.flatnonzero(steps > LONG_GAP * max(float(np.median(steps)), 1e-9)))


def rounded(values: Array, digits: int) -> list[Any]:
    """Round to so many digits of the range; gives plain numbers."""
    span = float(np.ptp(values)) if len(values) else 0.0
    span = span or float(np.abs(values).max(initial=0.0)) or 1.0
    places = digits - int(np.floor(np.log10(span))) - 1
    return [int(v) if places <= 0 else v for v in np.round(values, max(places, 0)).tolist()]


def curve(points: Array, most: int) -> Array:
    """Thin a curve (n, 2) in the plane, keeping the peaks of both coordinates."""
    if len(points) <= most:
        return points
    place = np.arange(len(points), dtype=float)
    chosen = [peaks(place, points[:, k], most // 2) for k in (0, 1)]
    kept = np.unique(np.concatenate(([0], *chosen, [len(points) - 1])))
    return np.asarray(points[kept])
