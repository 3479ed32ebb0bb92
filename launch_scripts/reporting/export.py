"""Further files of a report: time series as CSV, charts as SVG and PDF."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config import ros
from ampc_msgs_config.types import Array
from launch_scripts.reporting.drive import JudgedDrive
from launch_scripts.reporting.events import EVENTS, Event, events_of
from launch_scripts.reporting.lines import PALETTE, Series, color_of
from launch_scripts.reporting.map import centres, paths_of
from launch_scripts.reporting.panels import PANELS, Panel
from launch_scripts.reporting.style import FONT, REFERENCE_STYLE, save_figures, stack

DASHES = ("-", (0, (4, 2)), (0, (1, 1.5)), "-.", (0, (8, 2)))
"""Line styles by kind of series, as on the page."""
FIRST_ROW, FURTHER_ROW, EVENT_ROW = 2.2, 1.2, 0.3
"""Height of the rows of a chart [inch]."""
STATE = {"x": "m", "y": "m", "yaw": "rad", "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s"}
TICK_UNITS = {
    "m": ("cross_track_error", "slack"),
    "rad": ("heading_error", "feed_forward", "planned_steering", "steering"),
    "1/m": ("curvature",),
    "m/s^2": ("disturbance",),
    "s": (
        *("solve_time", "timer_lateness"),
        *("state_age", "state_silence", "path_age", "path_silence"),
    ),
}
"""Published quantities by unit; the others are counts, indices and dimensionless numbers."""


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
        write_time_series(drive, files[-1])
    if not {"svg", "pdf"} & set(formats):
        return files
    figures = {"map": map_figure(drives)}
    figures |= {
        panel.key: panel_figure(panel, drives) for panel in PANELS if has_data(panel, drives)
    }
    events = [event for k, drive in enumerate(drives) for event in events_of(drive, k)]
    if events:
        figures[EVENTS.key] = events_figure(events, drives)
    named = {f"{file.stem}_{key}": figure for key, figure in figures.items()}
    return files + save_figures(named, file, formats)


def write_time_series(drive: JudgedDrive, file: Path) -> None:
    """Write one row per tick; the header contains name and unit of each column."""
    columns = time_series(drive)
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for row in np.column_stack(list(columns.values())).tolist():
            writer.writerow(["" if np.isnan(value) else f"{value:.9g}" for value in row])


def time_series(drive: JudgedDrive) -> dict[str, Array]:
    """Return the values at the ticks (n,) of each column, by header; nan where there is none."""
    record, values = drive.record, drive.columns.values
    time = record.time
    columns = {"time [s]": time}
    units = STATE.items()
    columns |= {f"{key} [{unit}]": drive.states[:, k] for k, (key, unit) in enumerate(units)}
    columns["cross_track_error [m]"], columns["heading_error [rad]"] = drive.errors.T
    if len(record.steering):
        columns["steering_command [rad]"] = record.steering
    for head, topic in (
        ("steering_state [rad]", ros.STEERING_STATE),
        ("target_speed [m/s]", ros.TARGET_SPEED),
    ):
        if topic in values:
            columns[head] = latest(values[topic], time)
    if ros.WIND in values:
        for k, axis in enumerate("xy", 1):
            columns[f"wind_{axis} [m/s]"] = latest(values[ros.WIND][:, [0, k]], time)
    if record.angle_bound is not None:
        columns["angle_bound [rad]"] = record.angle_bound
    tick_units = {name: f" [{unit}]" for unit, names in TICK_UNITS.items() for name in names}
    for name, rows in record.tick.items():
        if len(rows):
            columns[f"tick/{name}{tick_units.get(name, '')}"] = latest(rows, time)
    return columns


def latest(rows: Array, time: Array) -> Array:
    """Return the last value of rows (m, 2) of time [s] and value at or before each time (n,)."""
    at = np.searchsorted(rows[:, 0], time + 1e-9, side="right") - 1
    return np.where(at < 0, np.nan, rows[np.maximum(at, 0), 1])


def has_data(panel: Panel, drives: Sequence[JudgedDrive]) -> bool:
    """Return whether a panel has at least one line."""
    return any(True for axis in panel.axes for drive in drives for _ in axis.lines(drive))


def panel_figure(panel: Panel, drives: Sequence[JudgedDrive]) -> Figure:
    """Return the chart of a panel with all data of the drives."""
    figure, axes = stack([FIRST_ROW, *[FURTHER_ROW] * (len(panel.axes) - 1)])
    for ax, axis in zip(axes, panel.axes, strict=True):
        for k, drive in enumerate(drives):
            for series in axis.lines(drive):
                draw_series(ax, series, drive.name, k, len(drives))
        ax.set_ylabel(axis.title)
        ax.set_xlim(*time_range(drives))
        if axis.log:
            ax.set_yscale("log")
        low, high = ax.get_ylim()
        if axis.visible:
            ax.set_ylim(min(low, *axis.visible), max(high, *axis.visible))
        if len(ax.get_legend_handles_labels()[1]) > 1:
            ax.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    axes[0].set_title(panel.title, loc="left")
    axes[-1].set_xlabel("time [s]")
    return figure


def draw_series(ax: Axes, series: Series, name: str, drive: int, drives: int) -> None:
    """Draw a line; the same line with the opposite sign has no second entry in the legend."""
    label = f"{name}: {series.label}" if drives > 1 else series.label
    known = label in ax.get_legend_handles_labels()[1]
    dashed = drives > 1 or series.bound
    ax.plot(
        series.time,
        series.values,
        color=color_of(series, drive, drives),
        linestyle=DASHES[series.kind % len(DASHES)] if dashed else "-",
        linewidth=0.8 if series.bound else 1.2,
        drawstyle="steps-post" if series.step else "default",
        label=f"_{label}" if known else label,
    )


def events_figure(events: Sequence[Event], drives: Sequence[JudgedDrive]) -> Figure:
    """Return the chart of all events, one row per label."""
    labels = list(dict.fromkeys(event.label for event in events))
    figure, (ax,) = stack([EVENT_ROW * len(labels) + 0.6])
    height = 0.8 / len(drives)
    for event in events:
        bottom = labels.index(event.label) - 0.4 + height * event.drive
        bars = [(begin, max(end - begin, 1e-3)) for begin, end in event.spans.tolist()]
        ax.broken_barh(bars, (bottom, height), color=PALETTE[event.drive % len(PALETTE)])
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_xlim(*time_range(drives))
    ax.set_title(EVENTS.title, loc="left")
    ax.set_xlabel("time [s]")
    return figure


def map_figure(drives: Sequence[JudgedDrive]) -> Figure:
    """Return the map with reference paths and driven paths."""
    with mpl.rc_context(FONT):
        figure = Figure(figsize=(6.4, 5.0), layout="constrained")
        ax = figure.subplots()
    for number, path in enumerate(paths_of(drives)):
        ax.plot(*path.T, **REFERENCE_STYLE, label="reference path" if number == 0 else None)
    for k, drive in enumerate(drives):
        label = "driven path" if len(drives) == 1 else drive.name
        ax.plot(*centres(drive).T, color=PALETTE[k % len(PALETTE)], linewidth=1.2, label=label)
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(alpha=0.25)
    ax.set_xlabel("x in the map [m]")
    ax.set_ylabel("y in the map [m]")
    ax.legend(fontsize=7, frameon=False)
    return figure


def time_range(drives: Sequence[JudgedDrive]) -> tuple[float, float]:
    """Return first and last time of all drives [s]."""
    times = [drive.record.time for drive in drives]
    return min(float(time[0]) for time in times), max(float(time[-1]) for time in times)
