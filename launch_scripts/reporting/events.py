"""Events of a drive: faults, fallbacks, guard and stop requests as bars over time."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ampc_msgs_config.types import LIMITS, MODES, REASONS, RUNGS, Array
from launch_scripts.reporting.drive import INDEX_RANGE, NO_POINTS, JudgedDrive
from launch_scripts.reporting.lines import PALETTE
from launch_scripts.reporting.panels import Panel, set_layout

EVENTS = Panel(
    "events",
    "Faults, fallbacks and guard",
    "Deviations from normal operation; each bar is an interval of ticks.",
    (),
)
NAMED = {
    "rung": ("rung", RUNGS),
    "reason": ("reason", REASONS),
    "clipped": ("guard clips", LIMITS),
    "mode": ("mode", tuple(mode.partition(":")[0] for mode in MODES)),
}
"""Published indices: label, and the names, of which the first is normal."""
FLAGS = {
    "stop_requested": "stop requested",
    "qp_fault": "injected QP fault",
    "outside_table": "outside the gain table",
}
COUNTERS = {"rejected_inputs": "inputs rejected", "resets": "controller reset"}
"""Published counters since the configuration of the controller."""
BARS = 400
"""Largest number of bars of one row and drive; the nearest ones are joined."""
ROW = 34
"""Height of a row without its bars [px]."""


class Event(NamedTuple):
    """One row of the chart for one drive."""

    label: str
    drive: int
    spans: Array
    """(n, 2) begin and end of each interval [s]."""
    ticks: int


def events_of(drive: JudgedDrive, number: int) -> Iterator[Event]:
    """Yield all events of a drive."""
    tick = drive.record.tick
    for name, (label, words) in NAMED.items():
        rows = tick.get(name, NO_POINTS)
        for value in np.unique(np.clip(rows[:, 1], *INDEX_RANGE)).astype(int).tolist():
            if value:
                word = words[value] if 0 <= value < len(words) else str(value)
                text = f"{label}: {word.replace('_', ' ')}"
                yield event(text, number, rows[:, 0], rows[:, 1] == value)
    flags = [(label, tick.get(name, NO_POINTS), 0.0) for name, label in FLAGS.items()]
    for name, label in COUNTERS.items():
        rows = tick.get(name, NO_POINTS)
        more = np.column_stack((rows[1:, 0], np.diff(rows[:, 1]) > 0)).astype(float)
        flags.append((label, more, 0.0))
    flags.append(("QP not solved", tick.get("converged", NO_POINTS), 1.0))
    for label, rows, normal in flags:
        if (rows[:, 1] != normal).any():
            yield event(label, number, rows[:, 0], rows[:, 1] != normal)
    time = drive.record.time
    gaps = np.flatnonzero(np.diff(time) > 1.5 * drive.record.period)
    if len(gaps):
        spans = np.column_stack((time[gaps], time[gaps + 1]))
        yield Event("missed ticks", number, spans, int(drive.metrics["missed_ticks"] or 0))


def event(label: str, number: int, time: Array, active: NDArray[np.bool_]) -> Event:
    """Return the event with the intervals of time (n,) [s] in which it was active (n,)."""
    edges = np.diff(np.concatenate(([False], active, [False])).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    ends = np.minimum(ends, len(time) - 1)  # a tick lasts until the next one
    spans = np.column_stack((time[begins], time[ends]))
    return Event(label, number, join_intervals(spans), int(active.sum()))


def join_intervals(spans: Array) -> Array:
    """Join the nearest intervals until at most `BARS` remain."""
    if len(spans) <= BARS:
        return spans
    gaps = spans[1:, 0] - spans[:-1, 1]
    apart = np.sort(np.argsort(gaps)[-(BARS - 1) :])
    begins = np.concatenate((spans[:1, 0], spans[apart + 1, 0]))
    return np.column_stack((begins, np.concatenate((spans[apart, 1], spans[-1:, 1]))))


def draw_events(drives: Sequence[JudgedDrive]) -> go.Figure | None:
    """Return the chart of all events, one row per label; None without events."""
    events = [each for k, drive in enumerate(drives) for each in events_of(drive, k)]
    if not events:
        return None
    labels = list(dict.fromkeys(each.label for each in events))
    figure, several = go.Figure(), len(drives) > 1
    for each in events:
        place = each.drive / (len(drives) - 1) if several else 0.5
        y = labels.index(each.label) + 0.06 + 0.3 * place
        x = [value for begin, end in each.spans.round(3).tolist() for value in (begin, end, None)]
        figure.add_scatter(
            x=x,
            y=[None if value is None else y for value in x],
            mode="lines+markers",  # the markers show the shortest intervals, too
            name=f"{drives[each.drive].name}: {each.label}" if several else each.label,
            line={"color": PALETTE[each.drive % len(PALETTE)], "width": 5 if several else 8},
            marker={"size": 4, "symbol": "line-ns-open"},
            hovertemplate=f"{each.ticks} ticks<br>%{{x:.2f}} s<extra>{each.label}</extra>",
        )
    set_layout(figure, 60 + (ROW + 6 * len(drives)) * max(1, len(labels)))
    figure.update_layout(showlegend=False, hovermode="closest")
    figure.update_xaxes(title={"text": "time [s]", "standoff": 4})
    figure.update_yaxes(
        showticklabels=False, range=[len(labels) - 0.4, -0.5], zeroline=False, showgrid=False
    )
    # Labels are inside the chart, so that the time axes of all charts are aligned.
    for row, label in enumerate(labels):
        at = {"x": 0, "xref": "paper", "xanchor": "left", "y": row - 0.24, "yanchor": "middle"}
        figure.add_annotation(text=label, showarrow=False, **at)
    return figure
