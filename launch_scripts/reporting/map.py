"""Map of the report: paths, and the data from which the page moves the cars along them."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array
from launch_scripts.bags.bag_columns import BagColumns
from launch_scripts.reporting.drive import INDEX_RANGE, NO_POINTS, JudgedDrive
from launch_scripts.reporting.lines import PALETTE, rounded, thinned_curve
from launch_scripts.reporting.panels import LAYOUT

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


class ReportMap(NamedTuple):
    """Figure and moving parts."""

    figure: go.Figure
    drives: list[dict[str, Any]]
    """Data of each drive for the script of the page; see `motion`."""


def draw_map(drives: Sequence[JudgedDrive], points: int) -> ReportMap:
    """Return the map of one or several drives; a path that they share is drawn once."""
    figure, moving = go.Figure(), []
    reference = {"color": "#c4c4c4", "width": 7, "simplify": False}  # visible behind the car
    for number, path in enumerate(paths_of(drives)):
        add_curve(figure, path, points, "reference path", reference, number == 0)
    for k, drive in enumerate(drives):
        line = {"color": PALETTE[k % len(PALETTE)], "width": 2, "simplify": False}
        label = "driven path" if len(drives) == 1 else drive.name
        add_curve(figure, centres(drive), points, label, line)
    for k, drive in enumerate(drives):
        first, color = len(figure.data), PALETTE[k % len(PALETTE)]
        add_car(figure, color, k == 0)
        moving.append({"color": color, "trace": first} | motion(drive, len(drives)))
    set_map_layout(figure, 76 if len(drives) == 1 else 104)
    return ReportMap(figure, moving)


def paths_of(drives: Sequence[JudgedDrive]) -> list[Array]:
    """Return the different reference paths of all drives, each (n, 2) [m]."""
    paths: list[Array] = []
    for drive in drives:
        for path in visible_paths(drive.columns):
            if not any(np.array_equal(path, other) for other in paths):
                paths.append(path)
    return paths


def visible_paths(columns: BagColumns) -> list[Array]:
    """Return the last reference path before the start, and about `MAX_PATHS` later ones."""
    later = [path.points for path in columns.paths if path.time > 0.0]
    before = [path.points for path in columns.paths if path.time <= 0.0][-1:]
    chosen = before + later[:: max(1, len(later) // MAX_PATHS)]
    return [smooth(points) for points in chosen]


def smooth(points: Array) -> Array:
    """Return the curve to which the errors refer, or the points where no curve can be fitted."""
    try:
        path = make_path(points)
    except ValueError:
        return points
    return np.column_stack((path.x, path.y))


def add_curve(
    figure: go.Figure,
    curve: Array,
    points: int,
    name: str,
    line: dict[str, Any],
    legend: bool = True,
) -> None:
    """Add a curve (n, 2) [m] in the plane, thinned to about `points` points."""
    x, y = thinned_curve(curve, points).T
    hover = "skip" if name == "reference path" else None
    figure.add_scatter(
        x=to_plain(x),
        y=to_plain(y),
        mode="lines",
        name=name,
        legendgroup=name,
        showlegend=legend,
        line=line,
        hoverinfo=hover,
    )


def add_car(figure: go.Figure, color: str, legend: bool) -> None:
    """Add the moving traces of a car: prediction, outline, and a marker of fixed size."""
    add = partial(figure.add_scatter, x=[], y=[], hoverinfo="skip")
    prediction = {"color": "#000000", "width": 2.5, "dash": "dot"}
    name = f"predicted path, at most {OLDEST:g} s old"
    add(mode="lines", name=name, showlegend=legend, line=prediction)
    outline = {"color": color, "width": 2}
    add(mode="lines", fill="toself", fillcolor=f"{color}55", showlegend=False, line=outline)
    marker = {"size": 14, "symbol": "arrow", "angleref": "up", "color": color}
    marker["line"] = {"color": "white", "width": 1.5}
    add(mode="markers", name="car", showlegend=legend, marker=marker)


def centres(drive: JudgedDrive) -> Array:
    """Return the positions of the centre of gravity at all ticks (n, 2) [m]."""
    x, y, yaw = drive.states[:, :3].T
    to_cg = drive.context.to_cg
    return np.column_stack((x + to_cg * np.cos(yaw), y + to_cg * np.sin(yaw)))


def motion(drive: JudgedDrive, drives: int) -> dict[str, Any]:
    """Return what the page needs to draw a car at any time."""
    time, steering = drive.record.time, drive.record.steering
    kept = even_choice(len(time), MAX_FRAMES // drives)
    x, y, yaw, speed = drive.states[kept, :4].T
    error, heading = drive.errors[kept].T
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
        "rung": rungs(drive, time[kept]),
        "predictions": predictions(drive, MAX_PREDICTED // drives),
    }


def even_choice(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` indices below `count`, evenly spaced, with both ends."""
    return np.asarray(np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)))


def rungs(drive: JudgedDrive, time: Array) -> list[int]:
    """Return the rung at the given times [s], or an empty list where the bag has none."""
    rows = drive.record.tick.get("rung", NO_POINTS)
    if not len(rows):
        return []
    at = np.searchsorted(rows[:, 0], time, side="right") - 1
    return [int(value) for value in np.clip(rows[np.maximum(at, 0), 1], *INDEX_RANGE)]


def predictions(drive: JudgedDrive, most: int) -> list[dict[str, Any]]:
    """Return at most `most` predicted paths, evenly spaced."""
    samples, result = drive.columns.predictions, []
    for sample in (samples[k] for k in even_choice(len(samples), most)):
        x, y = sample.points[even_choice(len(sample.points), PREDICTED_POINTS)].T
        result.append({"t": round(sample.time, MILLISECOND), "x": to_plain(x), "y": to_plain(y)})
    return result


def to_plain(values: Array, decimals: int = CENTIMETRE) -> list[float | None]:
    """Return rounded Python numbers, with None in place of nan and infinity."""
    return [v if np.isfinite(v) else None for v in np.round(values, decimals).tolist()]


def set_map_layout(figure: go.Figure, bottom: int) -> None:
    """Set the layout with equal scales of both axes, and the margin of the legend [px]."""
    legend = {"orientation": "h", "yanchor": "bottom", "y": 0, "yref": "container"}
    figure.update_layout(
        LAYOUT,
        margin={"l": 64, "r": 12, "t": 34, "b": bottom},
        dragmode="pan",
        hovermode="closest",
        legend=legend | {"xanchor": "left", "x": 0},
    )
    grid = {"gridcolor": "#e4e4e4", "zeroline": False, "ticks": "outside"}
    figure.update_xaxes(title={"text": "x in the map [m]", "standoff": 4}, **grid)
    figure.update_yaxes(
        title={"text": "y in the map [m]", "standoff": 6}, scaleanchor="x", scaleratio=1, **grid
    )
