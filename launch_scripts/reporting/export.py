"""Further files of a report: time series as CSV, charts as SVG and PDF."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config import topics
from ampc_msgs_config.types import Array
from launch_scripts.reporting.charts import paths_of
from launch_scripts.reporting.drive import JudgedDrive
from launch_scripts.reporting.panels import EVENTS, PALETTE, PANELS, Panel, events_of
from launch_scripts.reporting.style import REFERENCE_STYLE, save_figures, stack

DASHES = ("-", (0, (4, 2)), (0, (1, 1.5)), "-.", (0, (8, 2)))
"""Line styles by kind of series, as on the page."""
MAP_ROW, FIRST_ROW, FURTHER_ROW, EVENT_ROW = 4.5, 2.2, 1.2, 0.3
"""Height of the rows of a chart [inch]."""
STATE = ("x [m]", "y [m]", "yaw [rad]", "v_x [m/s]", "v_y [m/s]", "yaw_rate [rad/s]")
SAMPLED = (
    ("steering_state [rad]", topics.STEERING_STATE, 1),
    ("target_speed [m/s]", topics.TARGET_SPEED, 1),
    ("wind_x [m/s]", topics.WIND, 1),
    ("wind_y [m/s]", topics.WIND, 2),
)
"""Columns of other topics: header, topic, column of its rows."""
TICK_UNITS = {
    **dict.fromkeys(("cross_track_error", "slack"), " [m]"),
    **dict.fromkeys(("heading_error", "feed_forward", "planned_steering", "steering"), " [rad]"),
    **dict.fromkeys(("solve_time", "timer_lateness", "state_age", "state_silence"), " [s]"),
    **dict.fromkeys(("path_age", "path_silence"), " [s]"),
    **{"curvature": " [1/m]", "disturbance": " [m/s^2]", "steering_latency": " [s]"},
    **{"steering_offset": " [rad]", "understeer_gradient": " [rad s^2/m]"},
    **{"rear_cornering_stiffness": " [N/rad]"},
}
"""Units of published quantities; the others are counts, indices and dimensionless numbers."""


def export_report(file: Path, drives: Sequence[JudgedDrive], formats: Sequence[str]) -> list[Path]:
    """Write further files next to the page and return them.

    Args:
        file: The page; the names of all files start with its name without suffix.
        drives: Content.
        formats: Any of csv (one file per drive), svg (one file per chart), pdf (one file).
    """
    files = []
    for drive in drives if "csv" in formats else ():
        suffix = f"_{re.sub(r'[^A-Za-z0-9_.-]', '_', drive.name)}" if len(drives) > 1 else ""
        files.append(file.with_name(f"{file.stem}{suffix}.csv"))
        columns = time_series(drive)
        with files[-1].open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(columns)
            for row in np.column_stack(list(columns.values())).tolist():
                writer.writerow(["" if np.isnan(value) else f"{value:.9g}" for value in row])
    if not {"svg", "pdf"} & set(formats):
        return files
    figures: dict[str, Figure | None] = {"map": map_figure(drives)}
    figures |= {panel.key: panel_figure(panel, drives) for panel in PANELS}
    figures[EVENTS.key] = events_figure(drives)
    named = {f"{file.stem}_{key}": each for key, each in figures.items() if each is not None}
    return files + save_figures(named, file, formats)


def time_series(drive: JudgedDrive) -> dict[str, Array]:
    """Return the values at the ticks (n,) of each column, by header; nan where there is none."""
    record, values = drive.record, drive.columns.values
    columns = {"time [s]": record.time, **dict(zip(STATE, drive.states.T, strict=True))}
    columns["cross_track_error [m]"], columns["heading_error [rad]"] = drive.errors.T
    if len(record.steering):
        columns["steering_command [rad]"] = record.steering
    for head, topic, column in SAMPLED:
        if topic in values:
            columns[head] = latest(values[topic][:, [0, column]], record.time)
    if record.angle_bound is not None:
        columns["angle_bound [rad]"] = record.angle_bound
    for name, rows in record.tick.items():
        if len(rows):
            columns[f"tick/{name}{TICK_UNITS.get(name, '')}"] = latest(rows, record.time)
    return columns


def latest(rows: Array, time: Array) -> Array:
    """Return the last value of rows (m, 2) of time [s] and value at or before each time (n,)."""
    at = np.searchsorted(rows[:, 0], time + 1e-9, side="right") - 1
    return np.where(at < 0, np.nan, rows[np.maximum(at, 0), 1])


def time_chart(
    title: str, heights: Sequence[float], drives: Sequence[JudgedDrive]
) -> tuple[Figure, list[Axes]]:
    """Return a figure with rows [inch] that share the time axis of all drives."""
    figure, axes = stack(heights)
    times = [drive.record.time for drive in drives]
    for ax in axes:
        ax.set_xlim(min(time[0] for time in times), max(time[-1] for time in times))
    axes[0].set_title(title, loc="left")
    axes[-1].set_xlabel("time [s]")
    return figure, axes


def panel_figure(panel: Panel, drives: Sequence[JudgedDrive]) -> Figure | None:
    """Return the chart of a panel with all data of the drives; None without data."""
    heights = [FIRST_ROW, *[FURTHER_ROW] * (len(panel.axes) - 1)]
    figure, axes = time_chart(panel.title, heights, drives)
    for ax, axis in zip(axes, panel.axes, strict=True):
        lines = [(k, drive, s) for k, drive in enumerate(drives) for s in axis.lines(drive)]
        labels: list[str] = []
        for k, drive, series in lines:
            label = f"{drive.name}: {series.label}" if len(drives) > 1 else series.label
            dashed = len(drives) > 1 or series.bound
            ax.plot(
                series.time,
                series.values,
                color=series.color(k, len(drives)),
                linestyle=DASHES[series.kind % len(DASHES)] if dashed else "-",
                linewidth=0.8 if series.bound else 1.2,
                drawstyle="steps-post" if series.step else "default",
                label=f"_{label}" if label in labels else label,
            )
            labels.append(label)
        ax.set_ylabel(axis.title)
        if axis.log:
            ax.set_yscale("log")
        if axis.visible:
            low, high = ax.get_ylim()
            ax.set_ylim(min(low, *axis.visible), max(high, *axis.visible))
        if len(set(labels)) > 1:
            ax.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return figure if any(ax.lines for ax in axes) else None


def events_figure(drives: Sequence[JudgedDrive]) -> Figure | None:
    """Return the chart of all events, one row per label; None without events."""
    events = events_of(drives)
    if not events:
        return None
    labels = list(dict.fromkeys(event.label for event in events))
    figure, (ax,) = time_chart(EVENTS.title, [EVENT_ROW * len(labels) + 0.6], drives)
    height = 0.8 / len(drives)
    for event in events:
        bottom = labels.index(event.label) - 0.4 + height * event.drive
        bars = [(begin, max(end - begin, 1e-3)) for begin, end in event.spans.tolist()]
        ax.broken_barh(bars, (bottom, height), color=PALETTE[event.drive % len(PALETTE)])
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    return figure


def map_figure(drives: Sequence[JudgedDrive]) -> Figure:
    """Return the map with reference paths and driven paths."""
    figure, (ax,) = stack([MAP_ROW])
    for number, path in enumerate(paths_of(drives)):
        ax.plot(*path.T, **REFERENCE_STYLE, label="reference path" if number == 0 else None)
    for k, drive in enumerate(drives):
        label = "driven path" if len(drives) == 1 else drive.name
        ax.plot(*drive.centres.T, color=PALETTE[k % len(PALETTE)], linewidth=1.2, label=label)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("x in the map [m]")
    ax.set_ylabel("y in the map [m]")
    ax.legend(fontsize=7, frameon=False)
    return figure
