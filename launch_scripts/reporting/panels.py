"""Panels of the report: charts over time.

To add a chart, write a function that yields the `Series` of one drive, and append a `Panel` with
this function to `PANELS`:

    def yaw_rate(drive: JudgedDrive) -> Iterator[Series]:
        yield Series("yaw rate", drive.record.time, drive.record.yaw_rate)

    PANELS.append(Panel("yaw_rate", "Yaw rate", "Measured.", (Axis("rate [rad/s]", yaw_rate),)))

The page, the SVG and PDF files, and the text for screen readers follow from this entry. A panel
without data is listed by its title.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ampc_msgs_config import ros
from ampc_msgs_config.types import Array
from launch_scripts.reporting.drive import NO_POINTS, JudgedDrive
from launch_scripts.reporting.lines import Series, color_of, thinned

Lines = Callable[[JudgedDrive], Iterator[Series]]
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
ROW, FIRST_ROW, LEGEND = 120, 250, 50
"""Height of further rows, of the first row, of a legend with many entries [px]."""


LAYOUT = {
    "template": "none",
    "font": {"family": "system-ui, sans-serif", "size": 13, "color": "#1a1a1a"},
    "paper_bgcolor": "white",
    "plot_bgcolor": "white",
}
"""Layout of all figures of the page."""


class Axis(NamedTuple):
    """One row of a panel."""

    title: str
    """With unit."""
    lines: Lines
    log: bool = False
    visible: tuple[float, ...] = ()
    """Values that are always within the range, so that noise does not fill the chart."""


class Panel(NamedTuple):
    """One chart over time; its rows share the time axis."""

    key: str
    """Part of element names and file names."""
    title: str
    description: str
    axes: tuple[Axis, ...]


def cross_track(drive: JudgedDrive) -> Iterator[Series]:
    """Yield the cross-track error."""
    if len(drive.record.error):
        yield Series("cross-track error", drive.record.time, drive.errors[:, 0])


def heading(drive: JudgedDrive) -> Iterator[Series]:
    """Yield the heading error."""
    if len(drive.record.heading):
        yield Series("heading error", drive.record.time, np.degrees(drive.errors[:, 1]))


def steering(drive: JudgedDrive) -> Iterator[Series]:
    """Yield bounds, measured angle, angle before the guard, and command."""
    time, speed = drive.record.time, drive.record.speed
    for name, kind, bound in (
        ("bound of the controller", 4, drive.record.angle_bound),
        ("bound of the guard", 3, drive.context.guard_bound(speed)),
    ):
        if bound is not None:
            for sign in (1.0, -1.0):
                yield Series(name, time, sign * np.degrees(bound), kind, bound=True)
    measured = topic(drive, ros.STEERING_STATE)
    if len(measured):
        yield Series("measured", measured[:, 0], np.degrees(measured[:, 1]), 1)
    planned = drive.record.tick.get("planned_steering", NO_POINTS)
    published = drive.record.tick.get("steering", planned)
    if len(planned) and not np.array_equal(planned, published):
        yield Series("before the guard", planned[:, 0], np.degrees(planned[:, 1]), 2)
    if len(drive.record.steering):
        yield Series("command", time, np.degrees(drive.record.steering), 0)


def speeds(drive: JudgedDrive) -> Iterator[Series]:
    """Yield target speed and measured speed."""
    target, odom = topic(drive, ros.TARGET_SPEED), topic(drive, ros.ODOM)
    if len(target):
        yield Series("target", target[:, 0], target[:, 1], 1)
    yield Series("speed", odom[:, 0], odom[:, 4], 0)


def lateral_acceleration(drive: JudgedDrive) -> Iterator[Series]:
    """Yield the product of speed and yaw rate."""
    odom = topic(drive, ros.ODOM)
    yield Series("lateral acceleration", odom[:, 0], odom[:, 4] * odom[:, 6])


def wind(drive: JudgedDrive) -> Iterator[Series]:
    """Yield both components in the fixed frame."""
    rows = topic(drive, ros.WIND)
    for k, name in enumerate(("to +x of the map", "to +y of the map")):
        if len(rows):
            yield Series(name, rows[:, 0], rows[:, k + 1], k)


def topic(drive: JudgedDrive, name: str) -> Array:
    """Return the rows of a topic, possibly none."""
    return drive.columns.values.get(name, NO_POINTS)


def published(*labels: tuple[str, str], scale: float = 1.0, first: int = 0) -> Lines:
    """Return the function that yields published quantities of the controller.

    Args:
        labels: Name and label of each quantity.
        scale: Factor from SI to the unit of the axis; where it is 1, values hold until the next.
        first: Kind of the first line.
    """

    def lines(drive: JudgedDrive) -> Iterator[Series]:
        for kind, (name, label) in enumerate(labels, first):
            rows = drive.record.tick.get(name, NO_POINTS)
            if len(rows):
                yield Series(label, rows[:, 0], scale * rows[:, 1], kind, step=scale == 1.0)

    return lines


HORIZONS = published(
    ("prediction_horizon", "prediction horizon N_p"),
    ("control_horizon", "control horizon N_c"),
    ("laguerre_terms", "Laguerre terms N"),
)
POLE = published(("laguerre_pole", "Laguerre pole \u03b1"), first=3)
WEIGHTS = published(
    ("output_weight", "output weight Q"), ("increment_weight", "increment weight R"), first=4
)
PANELS = [
    Panel(
        "cross_track",
        "Cross-track error",
        "Distance of the centre of gravity from the path, positive to its left.",
        (Axis("error [m]", cross_track, visible=(-0.05, 0.05)),),
    ),
    Panel(
        "heading",
        "Heading error",
        "Heading of the car minus heading of the path, positive to the left.",
        (Axis("error [deg]", heading, visible=(-0.5, 0.5)),),
    ),
    Panel(
        "steering",
        "Steering",
        "Road-wheel angle, positive to the left: command, measurement and bounds.",
        (Axis("angle [deg]", steering, visible=(-1.0, 1.0)),),
    ),
    Panel(
        "speed",
        "Speed",
        "Measured speed and target speed.",
        (Axis("speed [m/s]", speeds, visible=(0.0,)),),
    ),
    Panel(
        "lateral_acceleration",
        "Lateral acceleration",
        "Measured speed times measured yaw rate, positive to the left.",
        (Axis("a_y [m/s\u00b2]", lateral_acceleration, visible=(-0.5, 0.5)),),
    ),
    Panel(
        "wind",
        "Wind",
        "Velocity of the air over ground.",
        (Axis("wind [m/s]", wind, visible=(-1.0, 1.0)),),
    ),
    Panel(
        "gains",
        "Gains in use",
        "Gain table at the current speed: horizons in ticks, Laguerre pole, weights.",
        (
            Axis("ticks", HORIZONS),
            Axis("pole", POLE, visible=(0.0, 1.0)),
            Axis("weight", WEIGHTS, log=True),
        ),
    ),
    Panel(
        "constraints",
        "Constraints",
        "Constraint rows that hold with equality, and violation of the soft output constraint.",
        (
            Axis("rows", published(("active_constraints", "active constraints")), visible=(0, 1)),
            Axis("slack [m]", published(("slack", "slack")), visible=(0.0, 0.01)),
        ),
    ),
    Panel(
        "solve_time",
        "Solve time",
        "Wall time of one controller step, on a logarithmic scale.",
        (Axis("time [\u00b5s]", published(("solve_time", "solve time"), scale=1e6), log=True),),
    ),
]
"""All charts over time except the events, in the order of the page."""


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
                time, values = thinned(series, points)
                trace = line_of(series, color_of(series, k, len(drives)), several)
                name = f"{drive.name}: {series.label}" if several else series.label
                visible = not several and series.label not in kinds
                trace.update(x=time, y=values, name=name, showlegend=visible, connectgaps=False)
                kinds.setdefault(series.label, series)
                figure.add_trace(trace, row, 1)
        set_scale(figure, axis, row)
    # With several drives, colours are drives: one legend entry per dash explains the quantities.
    for series in kinds.values() if several else ():
        figure.add_trace(line_of(series, "#404040", True).update(x=[None], y=[None]))
    set_layout(figure, sum(heights) + (LEGEND if len(kinds) > 2 else 0))
    figure.update_xaxes(title={"text": "time [s]", "standoff": 4}, row=rows)
    figure.update_layout(showlegend=len(kinds) > 1)
    return figure


def line_of(series: Series, color: str, several: bool) -> go.Scatter:
    """Return a trace without points in the style of a series."""
    dash = DASHES[series.kind % len(DASHES)] if several or series.bound else "solid"
    shape, width = "hv" if series.step else "linear", 1.2 if series.bound else 1.8
    return go.Scatter(
        name=series.label,
        legendgroup=series.label,
        mode="lines",
        line={"color": color, "width": width, "dash": dash, "shape": shape},
    )


def set_scale(figure: go.Figure, axis: Axis, row: int) -> None:
    """Set title, range and ticks of the vertical axis of a row."""
    figure.update_yaxes(title_text=axis.title, row=row)
    if axis.visible:
        figure.update_yaxes(autorangeoptions={"include": list(axis.visible)}, row=row)
        if min(axis.visible) == 0.0:
            figure.update_yaxes(rangemode="nonnegative", row=row)
    if axis.log:
        figure.update_yaxes(type="log", **log_ticks(figure, row), row=row)


def log_ticks(figure: go.Figure, row: int) -> dict[str, list[Any]]:
    """Return the ticks 1, 2, 5 of each decade that the lines of a row reach."""
    axis = "y" if row == 1 else f"y{row}"
    lines = [line.y for line in figure.data if line.yaxis == axis]
    values = [value for line in lines for value in line if value and value > 0]
    low, high = min(values, default=1.0), max(values, default=1.0)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if len(decades) < 4 else (1,)
    ticks = [step * 10.0**decade for decade in decades for step in steps]
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def set_layout(figure: go.Figure, height: int) -> None:
    """Set the layout that all charts over time share."""
    figure.update_layout(
        LAYOUT,
        height=height,
        margin={"l": 64, "r": 12, "t": 8, "b": 44},
        hovermode="x unified",
        hoverlabel={"bgcolor": "white"},
        dragmode="zoom",
        showlegend=True,
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.0, "xanchor": "left", "x": 0},
    )
    figure.update_xaxes(gridcolor="#e4e4e4", zeroline=False, ticks="outside")
    figure.update_yaxes(
        gridcolor="#e4e4e4",
        zeroline=True,
        zerolinecolor="#9a9a9a",
        title_standoff=6,
        automargin=False,
    )
