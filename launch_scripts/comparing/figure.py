"""Figures of a comparison: the matrix as a heat map, and all controllers on one road."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from scipy.ndimage import maximum_filter1d

from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.paths.path import Array, Path
from ampc_msgs_config.paths.path_frame import along_chord, path_frame
from launch_scripts.comparing.cells import QUANTITIES, Cell, Quantity, best_of
from launch_scripts.comparing.table import Comparison, number, shared
from launch_scripts.reporting.heat_map import HeatCell, draw_heat_map
from launch_scripts.reporting.style import CONTROLLER_STYLES, REFERENCE_STYLE, label_ends, stack
from launch_scripts.run.simulated import SimulatedDrive, centre_of_gravity, ticks_until_lost

FINEST = 1.0e-4
"""Smallest error on a logarithmic axis [m]."""
WINDOW = 1.0
"""Over which the largest error is taken there [s]."""
HEIGHT = {True: 1.8, False: 3.4}
"""Of the path's panel: stretched, or as a map [inch]."""
AROUND = 3.0
"""What is seen beside a path [m]."""
COLORS = ("#CC79A7", "#56B4E9", "#E69F00", "#777777")
SPARE: Sequence[tuple[str, Any]] = [(c, line) for line in ("-", (0, (6, 3))) for c in COLORS]
"""Colour (Okabe and Ito) and line of contenders with gains of the user."""


def draw_matrix(comparison: Comparison, quantity: str) -> Figure:
    """Draw one quantity as a heat map, logarithmic, with its numbers; the best gets a frame."""
    what, squares = QUANTITIES[quantity], []
    for _, cells in comparison.rows():
        best = best_of(cells, what.key)
        squares.append([_square(cell, what, cell.contender in best) for cell in cells])
    title = f"{what.heading}\n{shared(comparison.conditions)}"
    names = [scenario.name for scenario in comparison.scenarios]
    labels = [name.replace("=", "=\n") for name in comparison.labels]
    return draw_heat_map(title, names, labels, squares)


def _square(cell: Cell, quantity: Quantity, best: bool) -> HeatCell:
    """Give a square: coloured, or hatched where the car did not keep to the road."""
    hatch = "" if cell.kept else "////" if cell.numbers else "xxx"
    value = cell.numbers[quantity.key] if cell.kept else 0.0
    return HeatCell(number(cell, quantity), value, hatch, best)


def styles(labels: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Give colour and line of each contender: the same in every figure of the reproduction."""
    spare = cycle(SPARE)
    return {label: CONTROLLER_STYLES.get(label) or next(spare) for label in labels}


def draw_road(cells: Sequence[Cell], look: Mapping[str, tuple[str, Any]]) -> Figure | None:
    """Draw path, errors and steering of all who drove a road; nothing where nobody did."""
    shown = {cell.contender: cell.driven for cell in cells if cell.driven is not None}
    if not shown:
        return None
    path = next(iter(shown.values())).path
    figure, axes = stack([HEIGHT[_is_straight(path)], 1.6, 1.6, 1.4])
    curves = {name: _curves(driven) for name, driven in shown.items()}
    _draw_path(axes[0], path, max(float(lines[0][0].max()) for lines in curves.values()))
    _set_limits(axes[1:], curves, [cell.contender for cell in cells if cell.kept])
    for name, lines in curves.items():
        color, line = look[name]
        for ax, (a, b) in zip(axes, lines, strict=True):
            ax.plot(a, b, color=color, linestyle=line, linewidth=1.2)
            if len(a) < len(shown[name].error):
                _mark_end(ax, a, b, color)
    figure.draw_without_rendering()
    colors = {name: color for name, (color, _) in look.items()}
    for panel in range(1, len(axes)):
        ends = {name: float(lines[panel][1][-1]) for name, lines in curves.items()}
        label_ends(axes[panel], ends, colors)
    return figure


def _is_straight(path: Path) -> bool:
    """Tell whether a path is a graph over its chord."""
    try:
        return bool(path_frame(path))
    except ValueError:
        return False


def _straightened(path: Path, points: Array) -> Array:
    """Give points (n, 2) over the chord of a path, or in `map` where it is no graph over that."""
    return along_chord(path_frame(path), points) if _is_straight(path) else points


def _curves(driven: SimulatedDrive) -> list[tuple[Array, Array]]:
    """Give abscissa and ordinate of each panel, to where the car is lost."""
    n, time = ticks_until_lost(driven), ticks(driven.drive)
    place = _straightened(driven.path, centre_of_gravity(driven).T)
    largest = maximum_filter1d(np.abs(driven.error), 2 * round(WINDOW / time[1] / 2) + 1)
    panels = driven.error, np.maximum(largest, FINEST), np.degrees(driven.drive.steering)
    return [(place[:n, 0], place[:n, 1]), *((time[:n], values[:n]) for values in panels)]


def _draw_path(ax: Axes, path: Path, end: float) -> None:
    """Draw the path in its own panel, stretched and as far as driven, or as a map."""
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
    """Prepare the panels over time; they follow those who kept to the road, if any did."""
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
    largest.set_ylabel(f"its largest size\nwithin {WINDOW:g} s [m]")
    steering.set_ylabel("steering [deg]")
    steering.set_xlabel("time [s]")


def _mark_end(ax: Axes, a: Array, b: Array, color: str) -> None:
    """Mark where a car is lost, at the panel's edge if that is beyond it."""
    low, high = ax.get_ylim()
    height = min(max(float(b[-1]), low), high)
    ax.plot(a[-1], height, "x", color=color, markersize=8, mew=2, clip_on=False, zorder=5)
