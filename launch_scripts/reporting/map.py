"""The map of a report: paths, and all that is needed to move the cars along them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array
from launch_scripts.bags.bag_columns import BagColumns
from launch_scripts.reporting.drive import NO_POINTS, WORDS, Judged
from launch_scripts.reporting.lines import PALETTE, curve, rounded

MAX_FRAMES = 4000
"""Places of the car of all bags together; between them the page joins by straight lines."""
MAX_PREDICTED = 1000
"""Predictions of all bags together."""
PREDICTED_POINTS = 12
"""Of one prediction."""
OLDEST = 1.0
"""Age up to which a prediction is shown [s]."""
CENTIMETRE, MILLIRADIAN, MILLISECOND = 2, 4, 3
"""Decimals to which places, angles and times are rounded."""


class Map(NamedTuple):
    """The figure, and what moves in it."""

    figure: go.Figure
    drives: list[dict[str, Any]]
    """Of each bag: name, colour, numbers of its traces, outline, frames, predictions."""


def draw_map(drives: Sequence[Judged], points: int) -> Map:
    """Draw the map of one or several bags; a path that they share is drawn once."""
    figure, moving, drawn = go.Figure(), [], list[Array]()
    for drive in drives:
        for path in seen_paths(drive.columns):
            if not any(np.array_equal(path, other) for other in drawn):
                add_reference(figure, path, points, first=not drawn)
                drawn.append(path)
    for k, drive in enumerate(drives):
        line = {"color": PALETTE[k % len(PALETTE)], "width": 2, "simplify": False}
        x, y = curve(centres(drive), points).T
        label = "driven path" if len(drives) == 1 else drive.name
        figure.add_trace(go.Scatter(x=plain(x), y=plain(y), mode="lines", name=label, line=line))
    for k, drive in enumerate(drives):
        first = len(figure.data)
        add_car(figure, PALETTE[k % len(PALETTE)], k == 0)
        moving.append(motion(drive, PALETTE[k % len(PALETTE)], first, len(drives)))
    layout(figure)
    return Map(figure, moving)


def seen_paths(columns: BagColumns) -> list[Array]:
    """Give the references to draw: the last one before the start, and up to 20 later ones."""
    later = [path.points for path in columns.paths if path.time > 0.0]
    before = [path.points for path in columns.paths if path.time <= 0.0][-1:]
    return [smooth(points) for points in before + later[:: max(1, len(later) // 20)]]


def smooth(points: Array) -> Array:
    """Give the curve through points that the errors refer to, or the points if there is none."""
    try:
        path = make_path(points)
    except ValueError:
        return points
    return np.column_stack((path.x, path.y))


def add_reference(figure: go.Figure, path: Array, points: int, first: bool) -> None:
    """Draw what was asked for: wide and grey, so that it is seen behind a car that does that."""
    x, y = curve(path, points).T
    figure.add_trace(
        go.Scatter(
            x=plain(x),
            y=plain(y),
            mode="lines",
            name="reference path",
            legendgroup="reference",
            showlegend=first,
            line={"color": "#c4c4c4", "width": 7, "simplify": False},
            hoverinfo="skip",
        )
    )


def add_car(figure: go.Figure, color: str, first: bool) -> None:
    """Add what moves: the prediction, the outline, and a marker that is seen from afar."""
    predicted = {"color": "#000000", "width": 2.5, "dash": "dot"}
    outline = {"color": color, "width": 2}
    marker = {"size": 14, "symbol": "arrow", "angleref": "up", "color": color}
    name = f"predicted path, at most {OLDEST:g} s old"
    for style in (
        {"mode": "lines", "name": name, "showlegend": first, "line": predicted},
        {"mode": "lines", "fill": "toself", "fillcolor": f"{color}55", "line": outline}
        | {"showlegend": False},
        {"mode": "markers", "name": "car", "showlegend": first}
        | {"marker": marker | {"line": {"color": "white", "width": 1.5}}},
    ):
        figure.add_trace(go.Scatter(x=[], y=[], hoverinfo="skip", **style))


def centres(drive: Judged) -> Array:
    """Give the places of the centre of gravity at all ticks (n, 2) [m]."""
    x, y, yaw = drive.states[:, :3].T
    to_cg = drive.known.to_cg
    return np.column_stack((x + to_cg * np.cos(yaw), y + to_cg * np.sin(yaw)))


def motion(drive: Judged, color: str, first: int, drives: int) -> dict[str, Any]:
    """Give what the page needs to place a car at any time."""
    kept = np.unique(
        np.linspace(0, len(drive.time) - 1, min(len(drive.time), MAX_FRAMES // drives)).astype(int)
    )
    x, y, yaw, speed = drive.states[kept, :4].T
    steering = np.degrees(drive.steering[kept]) if len(drive.steering) else np.empty(0)
    error = drive.errors[kept]
    return {
        "name": drive.name,
        "color": color,
        "trace": first,
        "cg": drive.known.to_cg,
        "outline": drive.known.outline.round(3).tolist(),
        "t": plain(drive.time[kept], MILLISECOND),
        "x": plain(x),
        "y": plain(y),
        "yaw": plain(np.unwrap(yaw), MILLIRADIAN),
        "speed": rounded(speed, 4),
        "error": plain(error[:, 0], 4),
        "heading": plain(np.degrees(error[:, 1]), 3),
        "steering": rounded(steering, 4),
        "rung": rungs(drive, kept),
        "predictions": predictions(drive, MAX_PREDICTED // drives),
    }


def rungs(drive: Judged, kept: NDArray[np.int64]) -> list[int]:
    """Give the rung at the ticks kept; none where the bag does not tell."""
    rows = drive.columns.tick.get("rung", NO_POINTS)
    if not len(rows):
        return []
    at = np.searchsorted(rows[:, 0], drive.time[kept], side="right") - 1
    values = np.clip(rows[np.maximum(at, 0), 1], *WORDS)
    return [int(value) for value in values]


def predictions(drive: Judged, most: int) -> list[dict[str, Any]]:
    """Give an even choice of the predicted paths."""
    samples = drive.columns.predictions
    chosen = np.unique(np.linspace(0, len(samples) - 1, min(len(samples), most)).astype(int))
    result = []
    for sample in (samples[k] for k in chosen):
        some = np.linspace(0, len(sample.points) - 1, PREDICTED_POINTS).astype(int)
        x, y = sample.points[np.unique(some)].T if len(sample.points) else ([], [])
        result.append({"t": round(sample.time, MILLISECOND), "x": plain(x), "y": plain(y)})
    return result


def plain(values: Any, decimals: int = CENTIMETRE) -> list[float | None]:
    """Give rounded numbers; None for what is not finite."""
    return [v if np.isfinite(v) else None for v in np.round(values, decimals).tolist()]


def layout(figure: go.Figure) -> None:
    """Lay the map out: a metre is as long on both axes."""
    figure.update_layout(
        template="none",
        margin={"l": 64, "r": 12, "t": 34, "b": 76},
        font={"family": "system-ui, sans-serif", "size": 13, "color": "#1a1a1a"},
        dragmode="pan",
        hovermode="closest",
        legend={
            "orientation": "h",
            "yanchor": "bottom",
            "y": 0,
            "yref": "container",
            "xanchor": "left",
            "x": 0,
        },
        paper_bgcolor="white",
        plot_bgcolor="white",
    )
    grid = {"gridcolor": "#e4e4e4", "zeroline": False, "ticks": "outside"}
    figure.update_xaxes(title={"text": "x in the map [m]", "standoff": 4}, **grid)
    figure.update_yaxes(
        title={"text": "y in the map [m]", "standoff": 6}, scaleanchor="x", scaleratio=1, **grid
    )
