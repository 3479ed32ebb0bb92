"""Figure of all controllers on one road."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, StrMethodFormatter
from scipy.ndimage import maximum_filter1d

from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.paths.path_frame import along_chord, path_frame
from launch_scripts.comparing.cells import Cell
from launch_scripts.reporting.style import (
    CONTROLLER_STYLES,
    REFERENCE_STYLE,
    label_ends,
    lay_out,
    stack,
)
from launch_scripts.run.simulated import centre_of_gravity, ticks_until_lost

FINEST = 1.0e-4
"""Smallest error on a logarithmic axis [m]."""
WINDOW = 1.0
"""Duration over which the largest error is taken there [s]."""
STRETCHED, MAP_PANEL, FURTHER_ROWS = 1.8, 3.4, (1.6, 1.6, 1.4)
"""Height of the path's panel: stretched, or as a map; height of the panels over time [inch]."""
AROUND = 3.0
"""Visible distance on both sides of a path [m]."""
COLORS = ("#CC79A7", "#56B4E9", "#E69F00", "#777777")
SPARE: Sequence[tuple[str, Any]] = [(c, line) for line in ("-", (0, (6, 3))) for c in COLORS]
"""Colours (Okabe and Ito) and lines of contenders with gains or controllers of the user."""


def colors_of(labels: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Return colour and line style of each contender; shipped ones look alike in all figures."""
    spare = cycle(SPARE)
    return {label: CONTROLLER_STYLES.get(label) or next(spare) for label in labels}


def draw_compared_road(cells: Sequence[Cell], colors: Mapping[str, tuple[str, Any]]) -> Figure:
    """Return path, errors and steering of all controllers that drove a road (at least one)."""
    shown = {cell.contender: cell.driven for cell in cells if cell.driven is not None}
    path = next(iter(shown.values())).path
    try:
        frame = path_frame(path)
    except ValueError:  # the path is not a graph over its chord
        frame = None
    # Abscissa and ordinate of each panel, up to where the car is lost
    curves = {}
    for name, driven in shown.items():
        n, time = ticks_until_lost(driven), ticks(driven.drive)
        points = centre_of_gravity(driven).T
        points = along_chord(frame, points) if frame else points
        largest = maximum_filter1d(np.abs(driven.error), 2 * round(WINDOW / time[1] / 2) + 1)
        panels = driven.error, np.maximum(largest, FINEST), np.degrees(driven.drive.steering)
        curves[name] = [(points[:n, 0], points[:n, 1]), *((time[:n], v[:n]) for v in panels)]
    # Path: stretched and as far as it was driven, or a map with equal scales
    figure, axes = stack([STRETCHED if frame else MAP_PANEL, *FURTHER_ROWS])
    points = np.column_stack((path.x, path.y))
    points = along_chord(frame, points) if frame else points
    axes[0].plot(*points.T, zorder=0, **REFERENCE_STYLE)
    if frame:
        end = max(float(lines[0][0].max()) for lines in curves.values())
        axes[0].set_xlim(points[0, 0], end)
        axes[0].set_ylim(points[:, 1].min() - AROUND, points[:, 1].max() + AROUND)
        axes[0].set(xlabel="distance along the chord of the path [m]")
        axes[0].set(ylabel="offset to its left [m]")
    else:
        axes[0].set_aspect("equal", adjustable="datalim")
        axes[0].set(xlabel="x in map [m]", ylabel="y in map [m]")
    # Panels over time; their limits are those of the cars that stayed on the road, if any did
    kept = [cell.contender for cell in cells if cell.kept] or list(curves)
    for panel, least in ((1, FINEST), (3, 0.1)):
        most = max(float(np.abs(curves[name][panel][1]).max()) for name in kept)
        axes[panel].set_ylim(-1.1 * most - least, 1.1 * most + least)
    values = np.concatenate([lines[2][1] for lines in curves.values()])
    axes[2].set_yscale("log")
    axes[2].set_ylim(0.8 * values.min(), 1.5 * values.max())
    axes[2].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes[2].yaxis.set_minor_formatter(NullFormatter())
    axes[1].set_ylabel("cross-track\nerror [m]")
    axes[2].set_ylabel(f"largest error\nwithin {WINDOW:g} s [m]")
    axes[3].set(xlabel="time [s]", ylabel="steering [deg]")
    # Lines; a cross marks where a car is lost, at the edge of the panel if this is outside
    for name, lines in curves.items():
        color, dash = colors[name]
        for ax, (a, b) in zip(axes, lines, strict=True):
            ax.plot(a, b, color=color, linestyle=dash, linewidth=1.2)
            if len(a) < len(shown[name].error):
                height = np.clip(b[-1], *ax.get_ylim())
                ax.plot(a[-1], height, "x", color=color, ms=8, mew=2, clip_on=False, zorder=5)
    lay_out(figure)
    for panel in range(1, len(axes)):
        ends = {name: float(lines[panel][1][-1]) for name, lines in curves.items()}
        label_ends(axes[panel], ends, {name: color for name, (color, _) in colors.items()})
    return figure
