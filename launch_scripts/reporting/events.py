"""When something was not in order: faults, fall-backs, guard, stop request, as bars over time."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ampc_msgs_config import ros
from ampc_msgs_config.types import LIMITS, MODES, REASONS, RUNGS, Array
from launch_scripts.reporting.drive import NO_POINTS, WORDS, Judged
from launch_scripts.reporting.lines import PALETTE
from launch_scripts.reporting.panels import Panel, style
from launch_scripts.reporting.plots import Plot

PLOT = Plot(
    "events",
    "Faults, fall-backs and guard",
    "When something was not in order; each bar is a stretch of ticks.",
    (),
)
COUNTED = {
    "rung": ("rung", RUNGS),
    "reason": ("reason", REASONS),
    "clipped": ("guard clips", LIMITS),
    "mode": ("mode", tuple(mode.partition(":")[0] for mode in MODES)),
}
"""Quantities that count words, of which the first is in order."""
FLAGS = {
    "stop_requested": "stop requested",
    "qp_fault": "solver made to fail",
    "outside_table": "outside the gain table",
}
COUNTERS = {"rejected_inputs": "inputs rejected", "resets": "controller started anew"}
"""What has been counted since the controller was configured."""
BARS = 400
"""Of one row and bag, at most; nearer ones are joined."""
ROW = 34
"""Height of a row without its bars [px]."""


class Event(NamedTuple):
    """One row of one bag."""

    label: str
    drive: int
    spans: Array
    """(n, 2) begin and end of each stretch [s]."""
    ticks: int


def events(drive: Judged, number: int) -> Iterator[Event]:
    """Give all that was not in order in a bag."""
    tick = drive.columns.tick
    for name, (label, words) in COUNTED.items():
        rows = tick.get(name, NO_POINTS)
        for value in np.unique(np.clip(rows[:, 1], *WORDS)).astype(int).tolist():
            if value:
                word = words[value] if 0 <= value < len(words) else str(value)
                text = f"{label}: {word.replace('_', ' ')}"
                yield event(text, number, rows[:, 0], rows[:, 1] == value)
    for name, label in FLAGS.items():
        yield from flagged(label, number, tick.get(name, NO_POINTS))
    for name, label in COUNTERS.items():
        rows = tick.get(name, NO_POINTS)
        more = np.column_stack((rows[1:, 0], np.diff(rows[:, 1]) > 0)).astype(float)
        yield from flagged(label, number, more)
    if "stop_requested" not in tick:
        stops = drive.columns.values.get(ros.STOP_REQUEST, NO_POINTS)
        yield from flagged("stop requested", number, stops)
    unsolved = tick.get("converged", NO_POINTS)
    yield from flagged("programme not solved", number, unsolved, in_order=1.0)
    gaps = np.flatnonzero(np.diff(drive.time) > 1.5 * drive.period)
    if len(gaps):
        spans = np.column_stack((drive.time[gaps], drive.time[gaps + 1]))
        yield Event("ticks missed", number, spans, int(drive.summary["missed_ticks"] or 0))


def flagged(label: str, number: int, rows: Array, in_order: float = 0.0) -> Iterator[Event]:
    """Give the row of a flag, if it was ever up."""
    if (rows[:, 1] != in_order).any():
        yield event(label, number, rows[:, 0], rows[:, 1] != in_order)


def event(label: str, number: int, time: Array, active: NDArray[np.bool_]) -> Event:
    """Give the stretches of time (n,) in which something was active."""
    edges = np.diff(np.concatenate(([False], active, [False])).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    ends = np.minimum(ends, len(time) - 1)  # a tick lasts until the next one
    spans = np.column_stack((time[begins], time[ends]))
    return Event(label, number, joined(spans), int(active.sum()))


def joined(spans: Array) -> Array:
    """Join the nearest stretches until they are few enough to draw."""
    if len(spans) <= BARS:
        return spans
    gaps = spans[1:, 0] - spans[:-1, 1]
    apart = np.sort(np.argsort(gaps)[-(BARS - 1) :])
    begins = np.concatenate((spans[:1, 0], spans[apart + 1, 0]))
    return np.column_stack((begins, np.concatenate((spans[apart, 1], spans[-1:, 1]))))


def events_panel(drives: Sequence[Judged]) -> Panel | None:
    """Draw all events, a row each; None where everything was in order."""
    found = [each for k, drive in enumerate(drives) for each in events(drive, k)]
    if not found:
        return None
    labels = list(dict.fromkeys(each.label for each in found))
    figure = go.Figure()
    for each in found:
        place = 0.5 if len(drives) == 1 else each.drive / (len(drives) - 1)
        figure.add_trace(bars(each, labels.index(each.label) + 0.06 + 0.3 * place, drives))
    style(figure, 60 + (ROW + 6 * len(drives)) * max(1, len(labels)))
    figure.update_layout(showlegend=False, hovermode="closest")
    figure.update_xaxes(title={"text": "time [s]", "standoff": 4})
    figure.update_yaxes(
        showticklabels=False, range=[len(labels) - 0.4, -0.5], zeroline=False, showgrid=False
    )
    for row, label in enumerate(labels):  # inside, so that all plots begin at the same place
        at = {"x": 0, "xref": "paper", "xanchor": "left", "y": row - 0.24, "yanchor": "middle"}
        figure.add_annotation(text=label, showarrow=False, **at)
    return Panel(PLOT, figure)


def bars(each: Event, y: float, drives: Sequence[Judged]) -> go.Scatter:
    """Draw the stretches of one row; a marker where each begins shows the shortest ones too."""
    x: list[float | None] = []
    for begin, end in each.spans.round(3).tolist():
        x += [begin, end, None]
    name = drives[each.drive].name
    return go.Scatter(
        x=x,
        y=[None if value is None else y for value in x],
        mode="lines+markers",
        name=f"{name}: {each.label}" if len(drives) > 1 else each.label,
        line={"color": PALETTE[each.drive % len(PALETTE)], "width": 8 if len(drives) == 1 else 5},
        marker={"size": 4, "symbol": "line-ns-open"},
        hovertemplate=f"{each.ticks} ticks<br>%{{x:.2f}} s<extra>{each.label}</extra>",
    )
