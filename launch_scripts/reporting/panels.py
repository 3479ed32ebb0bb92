"""The plots over time of a report, one plotly figure each."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from launch_scripts.reporting.drive import Judged
from launch_scripts.reporting.lines import Series, key, trace
from launch_scripts.reporting.plots import PLOTS, Axis, Plot

ROW, FIRST_ROW, LEGEND = 120, 250, 50
"""Height of further rows, of the first one, of many entries in the legend [px]."""


class Panel(NamedTuple):
    """A plot that is drawn."""

    plot: Plot
    figure: go.Figure


def panels(drives: Sequence[Judged], points: int) -> tuple[list[Panel], list[Plot]]:
    """Draw all plots for which there are data; gives those without as well.

    Args:
        drives: One or several bags.
        points: Of a line, at most, about.
    """
    drawn, empty = [], []
    for plot in PLOTS:
        figure = draw(plot, drives, points)
        if figure.data:
            drawn.append(Panel(plot, figure))
        else:
            empty.append(plot)
    return drawn, empty


def draw(plot: Plot, drives: Sequence[Judged], points: int) -> go.Figure:
    """Draw one plot."""
    rows, names = len(plot.axes), [drive.name for drive in drives]
    heights = [FIRST_ROW, *[ROW] * (rows - 1)]
    figure = make_subplots(rows, 1, shared_xaxes=True, vertical_spacing=0.06, row_heights=heights)
    kinds: dict[str, Series] = {}
    for row, axis in enumerate(plot.axes, 1):
        for k, drive in enumerate(drives):
            for series in axis.lines(drive):
                line = trace(series, k, names, points)
                line.showlegend = len(drives) == 1 and series.label not in kinds
                kinds.setdefault(series.label, series)
                figure.add_trace(line, row, 1)
        scale(figure, axis, row)
    for series in kinds.values() if len(drives) > 1 else ():
        figure.add_trace(key(series))
    style(figure, sum(heights) + (LEGEND if len(kinds) > 2 else 0))
    figure.update_xaxes(title={"text": "time [s]", "standoff": 4}, row=rows)
    figure.update_layout(showlegend=len(kinds) > 1)
    return figure


def scale(figure: go.Figure, axis: Axis, row: int) -> None:
    """Set up the vertical axis of a row."""
    figure.update_yaxes(title_text=axis.title, row=row)
    if axis.least:
        figure.update_yaxes(autorangeoptions={"include": list(axis.least)}, row=row)
        if min(axis.least) == 0.0:
            figure.update_yaxes(rangemode="nonnegative", row=row)
    if axis.log:
        figure.update_yaxes(type="log", **log_ticks(figure, row), row=row)


def log_ticks(figure: go.Figure, row: int) -> dict[str, list[Any]]:
    """Give the ticks 1, 2, 5 of each decade that the lines of a row reach."""
    axis = "y" if row == 1 else f"y{row}"
    lines = [line.y for line in figure.data if line.yaxis == axis]
    values = [value for line in lines for value in line if value and value > 0]
    low, high = min(values, default=1.0), max(values, default=1.0)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if len(decades) < 4 else (1,)
    ticks = [step * 10.0**decade for decade in decades for step in steps]
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def style(figure: go.Figure, height: int) -> None:
    """Lay a figure over time out as all of them are."""
    figure.update_layout(
        template="none",
        height=height,
        margin={"l": 64, "r": 12, "t": 8, "b": 44},
        font={"family": "system-ui, sans-serif", "size": 13, "color": "#1a1a1a"},
        hovermode="x unified",
        hoverlabel={"bgcolor": "white"},
        dragmode="zoom",
        showlegend=True,
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.0, "xanchor": "left", "x": 0},
        paper_bgcolor="white",
        plot_bgcolor="white",
    )
    figure.update_xaxes(gridcolor="#e4e4e4", zeroline=False, ticks="outside")
    figure.update_yaxes(
        gridcolor="#e4e4e4",
        zeroline=True,
        zerolinecolor="#9a9a9a",
        title_standoff=6,
        automargin=False,
    )
