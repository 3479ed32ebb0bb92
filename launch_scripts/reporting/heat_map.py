"""A matrix of numbers as a figure: coloured where all is well, hatched where it is not."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from launch_scripts.reporting.style import FONT, INK

COLUMN, ROW = 1.15, 0.36
"""Size of a cell [inch]."""
MARGIN = 2.4
"""For the names of the rows and the bar of colours [inch]."""
MAP = "cividis_r"
"""The same to the colour-blind; the best is light, so that grey prints keep the order."""
LUMINANCE = (0.299, 0.587, 0.114)
"""Of red, green and blue."""
DARK = 0.5
"""Luminance below which the number of a cell is white."""


class Square(NamedTuple):
    """One cell."""

    text: str
    value: float = 0.0
    """Of its colour."""
    hatch: str = ""
    """In place of a colour."""
    framed: bool = False


class Matrix(NamedTuple):
    """What is to be drawn."""

    title: str
    rows: Sequence[str]
    columns: Sequence[str]
    squares: Sequence[Sequence[Square]]
    """Row by row."""
    margin: float = MARGIN


def draw(matrix: Matrix) -> Figure:
    """Draw a matrix, its colours logarithmic."""
    size = (COLUMN * len(matrix.columns) + matrix.margin, ROW * len(matrix.rows) + 1.3)
    with mpl.rc_context(FONT):
        figure = Figure(figsize=size, layout="constrained")
        ax = figure.subplots()
        colors = _colors(matrix)
        for row, squares in enumerate(matrix.squares):
            for column, square in enumerate(squares):
                _draw_square(ax, (column, row), square, colors)
        _name(ax, matrix)
        ax.set_title(matrix.title, fontsize=9, loc="left")
        bar = figure.colorbar(colors, ax=ax, fraction=0.06, pad=0.02)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.minorticks_off()
    return figure


def _name(ax: Axes, matrix: Matrix) -> None:
    """Write the names of rows and columns around the squares."""
    ax.set_xlim(-0.5, len(matrix.columns) - 0.5)
    ax.set_ylim(len(matrix.rows) - 0.5, -0.5)
    ax.set_xticks(range(len(matrix.columns)), list(matrix.columns))
    ax.set_yticks(range(len(matrix.rows)), list(matrix.rows))
    ax.tick_params(length=0, labeltop=True, labelbottom=False)
    ax.spines[:].set_visible(False)


def _colors(matrix: Matrix) -> ScalarMappable:
    """Spread the colours over the numbers of the squares that are not hatched."""
    values = [each.value for squares in matrix.squares for each in squares if not each.hatch]
    positive = [value for value in values if value > 0] or [1.0]
    low, high = min(positive), max(positive)
    return ScalarMappable(LogNorm(low, high if high > low else 1.01 * low, clip=True), MAP)


def _draw_square(ax: Axes, at: tuple[int, int], square: Square, colors: ScalarMappable) -> None:
    """Draw a square, coloured or hatched."""
    style: dict[str, Any] = {"facecolor": "white", "edgecolor": "#999999", "linewidth": 0.5}
    style["hatch"], ink = square.hatch, INK
    if not square.hatch:
        color = colors.to_rgba(np.array(square.value))
        style = {"facecolor": color, "edgecolor": "white"}
        ink = "white" if np.dot(color[:3], LUMINANCE) < DARK else INK
    ax.add_patch(Rectangle((at[0] - 0.5, at[1] - 0.5), 1, 1, **style))
    box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5} if square.hatch else None
    weight = "bold" if square.framed else "normal"
    ax.text(*at, square.text, ha="center", va="center", color=ink, bbox=box, weight=weight)
    if square.framed:
        corner = (at[0] - 0.46, at[1] - 0.42)
        ax.add_patch(Rectangle(corner, 0.92, 0.84, fill=False, edgecolor=ink, linewidth=1.4))
