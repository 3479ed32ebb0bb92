"""Figures of a comparison: the matrix as a heat map, and all controllers on one road."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, NullFormatter
from scipy.ndimage import maximum_filter1d

from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.path import Array, Path
from ampc_msgs_config.path_frame import path_frame
from launch_scripts.compare_cells import QUANTITIES, Cell, Quantity, best_of
from launch_scripts.compare_table import Comparison, number, shared
from launch_scripts.figure import WANTED, in_frame
from launch_scripts.reproduce_figures import FONT, INK, STYLE, label_ends, stack
from launch_scripts.reproduce_road_figure import centre, until_lost
from launch_scripts.trials import Driven

COLUMN, ROW = 1.15, 0.36
"""Size of a cell [inch]."""
MAP = "cividis_r"
"""The same to the colour-blind; the best is light, so that grey prints keep the order."""
LUMINANCE = (0.299, 0.587, 0.114)
"""Of red, green and blue."""
DARK = 0.5
"""Luminance below which the number of a cell is white."""
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
    """Draw one quantity as a heat map, logarithmic, with its numbers."""
    what, labels = QUANTITIES[quantity], comparison.labels
    names = [scenario.name for scenario in comparison.scenarios]
    size = (COLUMN * len(labels) + 2.4, ROW * len(names) + 1.3)
    with mpl.rc_context(FONT):
        figure = Figure(figsize=size, layout="constrained")
        ax = figure.subplots()
        colors = _colors(comparison, what.key)
        for row, (_, cells) in enumerate(comparison.rows()):
            best = best_of(cells, what.key)
            for column, cell in enumerate(cells):
                _draw_cell(ax, (column, row), cell, what, colors)
                if cell.contender in best:
                    _frame(ax, (column, row))
        _name(ax, names, labels)
        ax.set_title(f"{what.heading}\n{shared(comparison.conditions)}", fontsize=9, loc="left")
        bar = figure.colorbar(colors, ax=ax, fraction=0.06, pad=0.02)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.minorticks_off()
    return figure


def _name(ax: Axes, rows: Sequence[str], columns: Sequence[str]) -> None:
    """Write the names of rows and columns around the squares."""
    ax.set_xlim(-0.5, len(columns) - 0.5)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xticks(range(len(columns)), [name.replace("=", "=\n") for name in columns])
    ax.set_yticks(range(len(rows)), rows)
    ax.tick_params(length=0, labeltop=True, labelbottom=False)
    ax.spines[:].set_visible(False)


def _colors(comparison: Comparison, key: str) -> ScalarMappable:
    """Spread the colours over the numbers of those who kept to the road."""
    values = [cell.numbers[key] for cell in comparison.cells if cell.kept]
    positive = [value for value in values if value > 0] or [1.0]
    low, high = min(positive), max(positive)
    return ScalarMappable(LogNorm(low, high if high > low else 1.01 * low, clip=True), MAP)


def _draw_cell(
    ax: Axes, at: tuple[int, int], cell: Cell, quantity: Quantity, colors: ScalarMappable
) -> None:
    """Draw a square: coloured, or hatched where the car did not keep to the road."""
    style: dict[str, Any] = {"facecolor": "white", "edgecolor": "#999999", "linewidth": 0.5}
    style["hatch"], ink = "////" if cell.numbers else "xxx", INK
    if cell.kept:
        color = colors.to_rgba(np.array(cell.numbers[quantity.key]))
        style = {"facecolor": color, "edgecolor": "white"}
        ink = "white" if np.dot(color[:3], LUMINANCE) < DARK else INK
    ax.add_patch(Rectangle((at[0] - 0.5, at[1] - 0.5), 1, 1, **style))
    box = None if cell.kept else {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
    ax.text(*at, number(cell, quantity), ha="center", va="center", color=ink, bbox=box)


def _frame(ax: Axes, at: tuple[int, int]) -> None:
    """Mark the best of a scenario: the number, drawn last, gets bold and a frame."""
    text = ax.texts[-1]
    text.set_fontweight("bold")
    corner, color = (at[0] - 0.46, at[1] - 0.42), text.get_color()
    ax.add_patch(Rectangle(corner, 0.92, 0.84, fill=False, edgecolor=color, linewidth=1.4))


def styles(labels: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Give colour and line of each contender: the same in every figure of the reproduction."""
    spare = cycle(SPARE)
    return {label: STYLE[label] if label in STYLE else next(spare) for label in labels}


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
    return in_frame(path_frame(path), points) if _is_straight(path) else points


def _curves(driven: Driven) -> list[tuple[Array, Array]]:
    """Give abscissa and ordinate of each panel, to where the car is lost."""
    n, time = until_lost(driven), ticks(driven.drive)
    place = _straightened(driven.path, centre(driven).T)
    largest = maximum_filter1d(np.abs(driven.error), 2 * round(WINDOW / time[1] / 2) + 1)
    panels = driven.error, np.maximum(largest, FINEST), np.degrees(driven.drive.steering)
    return [(place[:n, 0], place[:n, 1]), *((time[:n], values[:n]) for values in panels)]


def _draw_path(ax: Axes, path: Path, end: float) -> None:
    """Draw the path in its own panel, stretched and as far as driven, or as a map."""
    points = _straightened(path, np.column_stack((path.x, path.y)))
    ax.plot(*points.T, zorder=0, **WANTED)
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
