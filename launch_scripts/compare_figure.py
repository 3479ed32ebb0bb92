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
from matplotlib.ticker import FuncFormatter

from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.path_frame import path_frame
from launch_scripts.compare_cells import QUANTITIES, Cell, best_of
from launch_scripts.compare_table import Comparison, number, shared
from launch_scripts.figure import WANTED, in_frame
from launch_scripts.reproduce_figures import FONT, INK, STYLE, label_ends, stack
from launch_scripts.reproduce_road_figure import centre, until_lost
from launch_scripts.trials import Driven

COLUMN, ROW = 1.05, 0.36
"""Size of a cell [inch]."""
MAP = "cividis_r"
"""The same to the colour-blind; the best is light, so that grey prints keep the order."""
DARK = 0.45
"""Luminance below which the number of a cell is white."""
LINEAR = 0.01
"""Up to this error the logarithmic axis is linear [m]."""
SPARE: Sequence[tuple[str, Any]] = (
    ("#0072B2", (0, (5, 2))),
    ("#D55E00", (0, (5, 2))),
    ("#CC79A7", "-"),
    ("#56B4E9", "-"),
    ("#E69F00", "-"),
    ("#666666", "-"),
)
"""Colour (Okabe and Ito) and line of contenders with gains of the user."""


def draw_matrix(comparison: Comparison, quantity: str) -> Figure:
    """Draw one quantity as a heat map, logarithmic, with its numbers."""
    what, labels = QUANTITIES[quantity], comparison.labels
    names = [scenario.name for scenario in comparison.scenarios]
    with mpl.rc_context(FONT):
        size = (COLUMN * len(labels) + 2.4, ROW * len(names) + 1.3)
        figure = Figure(figsize=size, layout="constrained")
        ax = figure.subplots()
        colors = _colors(comparison, what.key)
        for row, (_, cells) in enumerate(comparison.rows()):
            best = best_of(cells, what.key)
            for column, cell in enumerate(cells):
                text = number(cell, what)
                _draw_cell(ax, (column, row), cell, text, cell.contender in best, colors)
        ax.set_xlim(-0.5, len(labels) - 0.5)
        ax.set_ylim(len(names) - 0.5, -0.5)
        ax.set_xticks(range(len(labels)), [label.replace("=", "=\n") for label in labels])
        ax.set_yticks(range(len(names)), names)
        ax.tick_params(length=0, labeltop=True, labelbottom=False)
        ax.spines[:].set_visible(False)
        ax.set_title(f"{what.heading}\n{shared(comparison.conditions)}", fontsize=9, loc="left")
        bar = figure.colorbar(colors, ax=ax, fraction=0.06, pad=0.02)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.minorticks_off()
    return figure


def _colors(comparison: Comparison, key: str) -> ScalarMappable:
    """Spread the colours over the numbers of those who kept to the road."""
    values = [cell.numbers[key] for cell in comparison.cells if cell.kept]
    positive = [value for value in values if value > 0] or [1.0]
    low, high = min(positive), max(positive)
    return ScalarMappable(LogNorm(low, high if high > low else 1.01 * low, clip=True), MAP)


def _draw_cell(
    ax: Axes, at: tuple[int, int], cell: Cell, text: str, best: bool, colors: ScalarMappable
) -> None:
    """Draw a square: coloured, or hatched where the car did not keep to the road."""
    column, row = at
    corner, ink = (column - 0.5, row - 0.5), INK
    if cell.kept:
        value = max(float(text), float(colors.norm.vmin or 0.0))
        color = colors.to_rgba(value)
        ax.add_patch(Rectangle(corner, 1, 1, facecolor=color, edgecolor="white"))
        ink = "white" if np.dot(color[:3], (0.299, 0.587, 0.114)) < DARK else INK
    else:
        style: dict[str, Any] = {"facecolor": "white", "edgecolor": "#999999", "linewidth": 0.5}
        ax.add_patch(Rectangle(corner, 1, 1, hatch="////" if cell.numbers else "....", **style))
    if best:
        inner = (column - 0.46, row - 0.42)
        ax.add_patch(Rectangle(inner, 0.92, 0.84, fill=False, edgecolor=ink, linewidth=1.4))
    box = None if cell.kept else {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
    weight = "bold" if best else "normal"
    ax.text(column, row, text, ha="center", va="center", color=ink, weight=weight, bbox=box)


def styles(labels: Sequence[str]) -> dict[str, tuple[str, Any]]:
    """Give colour and line of each contender: the same in every figure of the reproduction."""
    spare = cycle(SPARE)
    return {label: STYLE[label] if label in STYLE else next(spare) for label in labels}


def draw_road(cells: Sequence[Cell], look: Mapping[str, tuple[str, Any]]) -> Figure | None:
    """Draw path, error and steering of all who drove a road; nothing where nobody did."""
    shown = {cell.contender: cell.driven for cell in cells if cell.driven is not None}
    if not shown:
        return None
    figure, axes = stack([2.0, 1.9, 1.6])
    curves = {name: _curves(driven) for name, driven in shown.items()}
    _draw_path(axes[0], next(iter(shown.values())))
    for name, lines in curves.items():
        color, line = look[name]
        gone = len(lines[1][0]) < len(shown[name].error)
        for ax, (a, b) in zip(axes, lines, strict=True):
            ax.plot(a, b, color=color, linestyle=line, linewidth=1.2)
            if gone:
                ax.plot(a[-1], b[-1], "x", color=color, markersize=8, mew=2)
    _finish(axes, shown, curves)
    figure.draw_without_rendering()
    colors = {name: color for name, (color, _) in look.items()}
    for ax, panel in zip(axes[1:], (1, 2), strict=True):
        ends = {name: float(lines[panel][1][-1]) for name, lines in curves.items()}
        label_ends(ax, ends, colors)
    return figure


def _straightened(driven: Driven, points: Any) -> Any:
    """Give points over the chord of a path that is a graph over it, else in `map`."""
    try:
        return in_frame(path_frame(driven.path), points).T
    except ValueError:
        return points.T


def _curves(driven: Driven) -> list[tuple[Any, Any]]:
    """Give abscissa and ordinate of the panels, to where the car is lost."""
    n, time = until_lost(driven), ticks(driven.drive)
    x, y = _straightened(driven, centre(driven).T)
    steering = np.degrees(driven.drive.steering)
    return [(x[:n], y[:n]), (time[:n], driven.error[:n]), (time[:n], steering[:n])]


def _draw_path(ax: Axes, driven: Driven) -> None:
    ax.plot(
        *_straightened(driven, np.column_stack((driven.path.x, driven.path.y))), zorder=0, **WANTED
    )


def _finish(axes: Sequence[Axes], shown: Mapping[str, Driven], curves: Mapping[str, Any]) -> None:
    """Set limits and labels; the axes follow those who kept to the road, if there are any."""
    place, error, steering = axes
    driven = next(iter(shown.values()))
    x, y = _straightened(driven, np.column_stack((driven.path.x, driven.path.y)))
    try:
        path_frame(driven.path)
        place.set_xlim(0.0, max(float(lines[0][0].max()) for lines in curves.values()))
        place.set_ylim(float(y.min()) - 3.0, float(y.max()) + 3.0)
        place.set_xlabel("distance along the chord of the path [m]")
        place.set_ylabel("offset to its left [m]")
    except ValueError:
        place.set_aspect("equal", adjustable="datalim")
        place.set_xlabel("x in map [m]")
        place.set_ylabel("y in map [m]")
    kept = [name for name, d in shown.items() if until_lost(d) == len(d.error)] or list(shown)
    most = max(float(np.abs(curves[name][1][1]).max()) for name in kept)
    error.set_yscale("symlog", linthresh=LINEAR)
    error.set_ylim(-1.5 * most, 1.5 * most)
    error.set_ylabel("cross-track error [m]")
    most = max(float(np.abs(curves[name][2][1]).max()) for name in kept)
    steering.set_ylim(-1.1 * most, 1.1 * most)
    steering.set_ylabel("steering [deg]")
    steering.set_xlabel("time [s]")
