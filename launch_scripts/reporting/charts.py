"""Charts of the report page: drawing with plotly, and thinning that preserves the peaks."""

import math
from collections.abc import Sequence
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io as pio
from numpy.typing import NDArray
from plotly.subplots import make_subplots
from tsdownsample import MinMaxDownsampler, MinMaxLTTBDownsampler

from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array
from launch_scripts.reporting.drive import INDEX_RANGE, NO_POINTS, JudgedDrive
from launch_scripts.reporting.panels import PALETTE, Panel, Series, events_of

CHART_DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
ROW, FIRST_ROW, LEGEND = 120, 250, 50
"""Height of further rows, of the first row, of a legend with many entries [px]."""
EVENT_ROW = 34
"""Height of a row of events without its bars [px]."""
BARS = 400
"""Largest number of bars of one row and drive; the nearest ones are joined."""
AXIS = {"gridcolor": "#e4e4e4", "zeroline": False}
pio.templates["report"] = {
    "layout": {
        "font": {"family": "system-ui, sans-serif", "size": 13, "color": "#1a1a1a"},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "hoverlabel": {"bgcolor": "white"},
        "legend": {"orientation": "h", "yanchor": "bottom", "xanchor": "left", "x": 0},
        "xaxis": AXIS | {"ticks": "outside", "title": {"standoff": 4}},
        "yaxis": AXIS | {"title": {"standoff": 6}},
    }
}
TIME_LAYOUT = {
    "template": "report",
    "margin": {"l": 64, "r": 12, "t": 8, "b": 44},
    "hovermode": "x unified",
    "dragmode": "zoom",
    "legend": {"y": 1.0},
}
"""Layout of the charts over time."""
EDGE = 0.05
"""Space beyond the lines of a row, per its range."""
LONG_GAP = 5.0
"""A line is interrupted where data are missing for more than this many median steps."""
DIGITS = 4
"""Digits of the range of a line that remain after rounding; they decide the size of the page."""
FEW = 4
"""Smallest number of points of a thinned line."""
SHAPE, EXTREMES = MinMaxLTTBDownsampler(), MinMaxDownsampler()
Indices = NDArray[np.int64]


MAX_FRAMES = 4000
"""Positions of the cars of all drives together; the page interpolates linearly between them."""
MAX_PREDICTED = 1000
"""Predictions of all drives together."""
PREDICTED_POINTS = 12
"""Points of one prediction."""
MAX_PATHS = 20
"""Reference paths of one drive, about."""
OLDEST = 1.0
"""Largest age of a displayed prediction [s]."""
CENTIMETRE, MILLIRADIAN, MILLISECOND = 2, 4, 3
"""Decimals to which positions, angles and times are rounded."""


def draw_panel(panel: Panel, drives: Sequence[JudgedDrive], points: int) -> go.Figure:
    """Return the chart of a panel, without traces where no drive has data.

    Args:
        panel: Entry of `PANELS`.
        drives: One or several drives.
        points: Approximate largest number of points of a line.
    """
    rows, several = len(panel.axes), len(drives) > 1
    heights = [FIRST_ROW, *[ROW] * (rows - 1)]
    figure = make_subplots(rows, 1, shared_xaxes=True, vertical_spacing=0.06, row_heights=heights)
    kinds: dict[str, Series] = {}
    for row, axis in enumerate(panel.axes, 1):
        for k, drive in enumerate(drives):
            for series in axis.lines(drive):
                time, values = thin_series(series, points)
                trace = line_of(series, series.color(k, len(drives)), several)
                name = f"{drive.name}: {series.label}" if several else series.label
                visible = not several and series.label not in kinds
                trace.update(x=time, y=values, name=name, showlegend=visible, connectgaps=False)
                kinds.setdefault(series.label, series)
                figure.add_trace(trace, row, 1)
        scale = log_ticks(figure, row) if axis.log else {}
        if axis.visible:
            scale["autorangeoptions"] = {"include": [*axis.visible, *edges_of(figure, row)]}
            scale["rangemode"] = "nonnegative" if min(axis.visible) == 0.0 else "normal"
        figure.update_yaxes(title_text=axis.title, **scale, row=row)
    # With several drives, colours are drives: one legend entry per dash explains the quantities.
    for series in kinds.values() if several else ():
        figure.add_trace(line_of(series, "#404040", True).update(x=[None], y=[None]))
    height = sum(heights) + (LEGEND if len(kinds) > 2 else 0)
    figure.update_layout(TIME_LAYOUT, height=height, showlegend=len(kinds) > 1)
    figure.update_xaxes(title_text="time [s]", row=rows)
    figure.update_yaxes(zeroline=True, zerolinecolor="#9a9a9a")
    return figure


def line_of(series: Series, color: str, several: bool) -> go.Scatter:
    """Return a trace without points in the style of a series."""
    dash = CHART_DASHES[series.kind % len(CHART_DASHES)] if several or series.bound else "solid"
    shape = "hv" if series.step else "linear"
    width = 1.2 if series.bound else 6.0 if series.wide else 1.8
    return go.Scatter(
        name=series.label,
        legendgroup=series.label,
        mode="lines",
        line={"color": color, "width": width, "dash": dash, "shape": shape},
    )


def edges_of(figure: go.Figure, row: int) -> tuple[float, float]:
    """Return values a little beyond those of a row's lines, so that no line is on the edge."""
    values = [value for value in values_of(figure, row) if value is not None] or [0.0]
    low, high = min(*values, 0.0), max(*values, 0.0)
    margin = EDGE * (high - low)
    return low - margin if low < 0.0 else 0.0, high + margin


def values_of(figure: go.Figure, row: int) -> list[float | None]:
    """Return the values of all lines of a row."""
    axis = "y" if row == 1 else f"y{row}"
    return [value for line in figure.data if line.yaxis == axis for value in line.y]


def log_ticks(figure: go.Figure, row: int) -> dict[str, Any]:
    """Return a logarithmic scale with ticks 1, 2, 5 of each decade that a row's lines reach."""
    values = [value for value in values_of(figure, row) if value and value > 0]
    low, high = min(values, default=1.0), max(values, default=1.0)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if len(decades) < 4 else (1,)
    ticks = [step * 10.0**decade for decade in decades for step in steps]
    return {"type": "log", "tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def draw_events(drives: Sequence[JudgedDrive]) -> go.Figure | None:
    """Return the chart of all events, one row per label; None without events."""
    events = events_of(drives)
    if not events:
        return None
    labels = list(dict.fromkeys(each.label for each in events))
    figure, several = go.Figure(), len(drives) > 1
    for each in events:
        place = each.drive / (len(drives) - 1) if several else 0.5
        y = labels.index(each.label) + 0.06 + 0.3 * place
        spans = join_intervals(each.spans)
        x = [value for begin, end in spans.round(3).tolist() for value in (begin, end, None)]
        figure.add_scatter(
            x=x,
            y=[None if value is None else y for value in x],
            mode="lines+markers",  # the markers show the shortest intervals, too
            name=f"{drives[each.drive].name}: {each.label}" if several else each.label,
            line={"color": PALETTE[each.drive % len(PALETTE)], "width": 5 if several else 8},
            marker={"size": 4, "symbol": "line-ns-open"},
            hovertemplate=f"{each.ticks} ticks<br>%{{x:.2f}} s<extra>{each.label}</extra>",
        )
    height = 60 + (EVENT_ROW + 6 * len(drives)) * len(labels)
    figure.update_layout(TIME_LAYOUT, height=height, showlegend=False, hovermode="closest")
    figure.update_xaxes(title_text="time [s]")
    figure.update_yaxes(showticklabels=False, range=[len(labels) - 0.4, -0.5], showgrid=False)
    # Labels are inside the chart, so that the time axes of all charts are aligned.
    for row, label in enumerate(labels):
        at = {"x": 0, "xref": "paper", "xanchor": "left", "y": row - 0.24, "yanchor": "middle"}
        figure.add_annotation(text=label, showarrow=False, **at)
    return figure


def join_intervals(spans: Array) -> Array:
    """Join the nearest intervals until at most `BARS` remain."""
    if len(spans) <= BARS:
        return spans
    gaps = spans[1:, 0] - spans[:-1, 1]
    apart = np.sort(np.argsort(gaps)[-(BARS - 1) :])
    begins = np.concatenate((spans[:1, 0], spans[apart + 1, 0]))
    return np.column_stack((begins, np.concatenate((spans[apart, 1], spans[-1:, 1]))))


def draw_map(drives: Sequence[JudgedDrive], points: int) -> tuple[go.Figure, list[dict[str, Any]]]:
    """Return the map of one or several drives, and the data of each for the script of the page.

    A path that several drives share is drawn once.
    """
    figure, moving, name = go.Figure(), [], "reference path"
    line = {"color": "#c4c4c4", "width": 7, "simplify": False}  # visible behind the car
    for number, path in enumerate(paths_of(drives)):
        legend = {"name": name, "legendgroup": name, "showlegend": number == 0}
        x, y = thinned_curve(path, points)
        figure.add_scatter(x=x, y=y, mode="lines", line=line, hoverinfo="skip", **legend)
    for drive, color in zip(drives, cycle(PALETTE)):
        line = {"color": color, "width": 2, "simplify": False}
        name = "driven path" if len(drives) == 1 else drive.name
        x, y = thinned_curve(drive.centres, points)
        figure.add_scatter(x=x, y=y, mode="lines", name=name, line=line)
    # Moving traces of each car: prediction, outline, and a marker of fixed size
    add = partial(figure.add_scatter, x=[], y=[], hoverinfo="skip")
    for k, (drive, color) in enumerate(zip(drives, cycle(PALETTE))):
        moving.append({"color": color, "trace": len(figure.data)} | motion(drive, len(drives)))
        line = {"color": "#000000", "width": 2.5, "dash": "dot"}
        name = f"predicted path, at most {OLDEST:g} s old"
        add(mode="lines", name=name, showlegend=k == 0, line=line)
        line = {"color": color, "width": 2}
        add(mode="lines", fill="toself", fillcolor=f"{color}55", showlegend=False, line=line)
        marker = {"size": 14, "symbol": "arrow", "angleref": "up", "color": color}
        marker["line"] = {"color": "white", "width": 1.5}
        add(mode="markers", name="car", showlegend=k == 0, marker=marker)
    figure.update_layout(
        template="report",
        margin={"l": 64, "r": 12, "t": 34, "b": 76 if len(drives) == 1 else 104},
        dragmode="pan",
        hovermode="closest",
        legend={"y": 0, "yref": "container"},
    )
    figure.update_xaxes(title_text="x in the map [m]")
    figure.update_yaxes(
        title_text="y in the map [m]", scaleanchor="x", scaleratio=1, ticks="outside"
    )
    return figure, moving


def paths_of(drives: Sequence[JudgedDrive]) -> list[Array]:
    """Return the different reference paths of all drives, each (n, 2) [m].

    Of each drive, these are the last path before the start, and about `MAX_PATHS` later ones: the
    curve to which the errors refer, or the points where no curve can be fitted.
    """
    paths: list[Array] = []
    for drive in drives:
        later = [path.points for path in drive.columns.paths if path.time > 0.0]
        before = [path.points for path in drive.columns.paths if path.time <= 0.0][-1:]
        for points in before + later[:: max(1, len(later) // MAX_PATHS)]:
            try:
                path = make_path(points)
                points = np.column_stack((path.x, path.y))
            except ValueError:
                pass
            if not any(np.array_equal(points, other) for other in paths):
                paths.append(points)
    return paths


def motion(drive: JudgedDrive, drives: int) -> dict[str, Any]:
    """Return what the page needs to draw a car at any time."""
    time, steering = drive.record.time, drive.record.steering
    kept = even_choice(len(time), MAX_FRAMES // drives)
    x, y, yaw, speed = drive.states[kept, :4].T
    error, heading = drive.errors[kept].T
    rows, rungs = drive.record.tick.get("rung", NO_POINTS), []
    if len(rows):
        at = np.searchsorted(rows[:, 0], time[kept], side="right") - 1
        rungs = np.clip(rows[np.maximum(at, 0), 1], *INDEX_RANGE).astype(int).tolist()
    predictions, samples = [], drive.columns.predictions
    for k in even_choice(len(samples), MAX_PREDICTED // drives):
        points = samples[k].points[even_choice(len(samples[k].points), PREDICTED_POINTS)]
        t = round(samples[k].time, MILLISECOND)
        predictions.append({"t": t, "x": to_plain(points[:, 0]), "y": to_plain(points[:, 1])})
    return {
        "name": drive.name,
        "cg": drive.context.to_cg,
        "outline": drive.context.outline.round(3).tolist(),
        "t": to_plain(time[kept], MILLISECOND),
        "x": to_plain(x),
        "y": to_plain(y),
        "yaw": to_plain(np.unwrap(yaw), MILLIRADIAN),
        "speed": rounded(speed, 4),
        "error": to_plain(error, 4),
        "heading": to_plain(np.degrees(heading), 3),
        "steering": rounded(np.degrees(steering[kept]) if len(steering) else steering, 4),
        "rung": rungs,
        "predictions": predictions,
    }


def even_choice(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` indices below `count`, evenly spaced, with both ends."""
    return np.asarray(np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)))


def to_plain(values: Array, decimals: int = CENTIMETRE) -> list[float | None]:
    """Return rounded Python numbers, with None in place of nan and infinity."""
    return [v if np.isfinite(v) else None for v in np.round(values, decimals).tolist()]


def thin_series(series: Series, points: int) -> tuple[list[Any], list[Any]]:
    """Return time and values of about `points` points, with all peaks; None marks a gap."""
    finite = np.isfinite(series.values)
    time, values = series.time[finite], series.values[finite]
    keep: Indices = np.arange(len(time))
    if series.step and len(time) > FEW:  # where the value changes, and both ends
        keep = np.union1d(np.flatnonzero(np.diff(values, prepend=np.nan)), keep[-1])
    if len(keep) > points:
        keep = keep[peaks(time[keep], values[keep], points)]
    steps = np.diff(time)
    usual = float(np.median(steps)) if len(steps) else 0.0
    gaps = np.flatnonzero(steps > LONG_GAP * max(usual, 1e-9))
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


def rounded(values: Array, digits: int) -> list[Any]:
    """Return the values as Python numbers, rounded to so many digits of their range."""
    span = float(np.ptp(values)) if len(values) else 0.0
    span = span or float(np.abs(values).max(initial=0.0)) or 1.0
    places = min(digits - int(np.floor(np.log10(span))) - 1, 300)  # 10^places is finite
    return [int(v) if places <= 0 else v for v in np.round(values, max(places, 0)).tolist()]


def thinned_curve(curve: Array, most: int) -> tuple[list[Any], list[Any]]:
    """Return x and y of about `most` points of a curve (n, 2), with the peaks of both axes."""
    if len(curve) > most:
        place = np.arange(len(curve), dtype=float)
        chosen = [peaks(place, curve[:, k], most // 2) for k in (0, 1)]
        curve = curve[np.unique(np.concatenate(([0], *chosen, [len(curve) - 1])))]
    return to_plain(curve[:, 0]), to_plain(curve[:, 1])
