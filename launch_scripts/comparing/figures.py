"""Figure of all controllers on one road."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from scipy.ndimage import maximum_filter1d

from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_frame import along_chord, path_frame
from ampc_msgs_config.types import Array
from launch_scripts.comparing.cells import Cell
from launch_scripts.reporting.style import CONTROLLER_STYLES, REFERENCE_STYLE, label_ends, stack
from launch_scripts.run.simulated import SimulatedDrive, centre_of_gravity, ticks_until_lost

FINEST = 1.0e-4
"""Smallest error on a logarithmic axis [m]."""
WINDOW = 1.0
"""Duration over which the largest error is taken there [s]."""
HEIGHT = {True: 1.8, False: 3.4}
"""Height of the path's panel: stretched, or as a map [inch]."""
AROUND = 3.0
"""Visible distance on both sides of a path [m]."""
COLORS = ("#CC79A7", "#56B4E9", "#E69F00", "#777777")
SPARE: Sequence[tuple[str, Any]] = [(c, line) for line in ("-", (0, (6, 3))) for c in COLORS]
"""Colours (Okabe and Ito) and lines of contenders with gains or controllers of the user."""


def colors_of(labels: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Return colour and line style of each contender; shipped ones look alike in all figures."""
    spare = cycle(SPARE)
    return {label: CONTROLLER_STYLES.get(label) or next(spare) for label in labels}


def draw_scenario(cells: Sequence[Cell], colors: Mapping[str, tuple[str, Any]]) -> Figure:
    """Return path, errors and steering of all controllers that drove a road (at least one)."""
    shown = {cell.contender: cell.driven for cell in cells if cell.driven is not None}
    path = next(iter(shown.values())).path
    figure, axes = stack([HEIGHT[_is_straight(path)], 1.6, 1.6, 1.4])
    curves = {name: _curves(driven) for name, driven in shown.items()}
    _draw_path(axes[0], path, max(float(lines[0][0].max()) for lines in curves.values()))
    _set_limits(axes[1:], curves, [cell.contender for cell in cells if cell.kept])
    for name, lines in curves.items():
        color, line = colors[name]
        for ax, (a, b) in zip(axes, lines, strict=True):
            ax.plot(a, b, color=color, linestyle=line, linewidth=1.2)
            if len(a) < len(shown[name].error):
                _mark_end(ax, a, b, color)
    figure.draw_without_rendering()
    for panel in range(1, len(axes)):
        ends = {name: float(lines[panel][1][-1]) for name, lines in curves.items()}
        label_ends(axes[panel], ends, {name: color for name, (color, _) in colors.items()})
    return figure


def _is_straight(path: Path) -> bool:
    """Return whether a path is a graph over its chord."""
    try:
        return bool(path_frame(path))
    except ValueError:
        return False


def _straightened(path: Path, points: Array) -> Array:
    """Return points (n, 2) over the chord of a path, or unchanged if it is not a graph over it."""
    return along_chord(path_frame(path), points) if _is_straight(path) else points


def _curves(driven: SimulatedDrive) -> list[tuple[Array, Array]]:
    """Return abscissa and ordinate of each panel, up to where the car is lost."""
    n, time = ticks_until_lost(driven), ticks(driven.drive)
    place = _straightened(driven.path, centre_of_gravity(driven).T)
    largest = maximum_filter1d(np.abs(driven.error), 2 * round(WINDOW / time[1] / 2) + 1)
    panels = driven.error, np.maximum(largest, FINEST), np.degrees(driven.drive.steering)
    return [(place[:n, 0], place[:n, 1]), *((time[:n], values[:n]) for values in panels)]


def _draw_path(ax: Axes, path: Path, end: float) -> None:
    """Draw the path, stretched and as far as it was driven, or as a map with equal scales."""
    points = _straightened(path, np.column_stack((path.x, path.y)))
    ax.plot(*points.T, zorder=0, **REFERENCE_STYLE)
    if _is_straight(path):
        ax.set_xlim(points[0, 0], end)
        ax.set_ylim(points[:, 1].min() - AROUND, points[:, 1].max() + AROUND)
        ax.set_xlabel("distance along the chord of the path [m]")
        ax.set_ylabel("offset to its left [m]")
    else:
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("x in map [m]")
        ax.set_ylabel("y in map [m]")


def _set_limits(axes: Sequence[Axes], curves: Mapping[str, Any], kept: Sequence[str]) -> None:
    """Set the limits of the panels over time by the cars that stayed on the road, if any did."""
    error, largest, steering = axes
    for ax, panel, least in ((error, 1, FINEST), (steering, 3, 0.1)):
        most = max(float(np.abs(curves[name][panel][1]).max()) for name in kept or curves)
        ax.set_ylim(-1.1 * most - least, 1.1 * most + least)
    values = np.concatenate([lines[2][1] for lines in curves.values()])
    largest.set_yscale("log")
    largest.set_ylim(0.8 * values.min(), 1.5 * values.max())
    largest.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    largest.yaxis.set_minor_formatter(NullFormatter())
    error.set_ylabel("cross-track\nerror [m]")
    largest.set_ylabel(f"largest error\nwithin {WINDOW:g} s [m]")
    steering.set_ylabel("steering [deg]")
    steering.set_xlabel("time [s]")


def _mark_end(ax: Axes, a: Array, b: Array, color: str) -> None:
    """Mark where a car is lost, at the edge of the panel if this is outside."""
    low, high = ax.get_ylim()
    height = min(max(float(b[-1]), low), high)
    ax.plot(a[-1], height, "x", color=color, markersize=8, mew=2, clip_on=False, zorder=5)
