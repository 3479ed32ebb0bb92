"""Heat map of a matrix of numbers, with hatched cells where there is no valid number."""

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from launch_scripts.reporting.style import FONT, INK

COLUMN, ROW_HEIGHT = 1.15, 0.36
"""Size of a cell [inch]."""
MARGIN = 2.4
"""Width of the row names and of the colour bar [inch]."""
COLOR_MAP = "cividis_r"
"""Equal for colour-blind readers; small values are light, so that grey prints keep the order."""
LUMINANCE = (0.299, 0.587, 0.114)
"""Weights of red, green and blue."""
DARK = 0.5
"""Luminance below which the text of a cell is white."""


class HeatCell(NamedTuple):
    """One cell of a heat map."""

    text: str
    value: float = 0.0
    """Decides the colour."""
    hatch: str = ""
    """Hatch of matplotlib that replaces the colour, such as `////`; empty: coloured."""
    framed: bool = False


def draw_heat_map(
    title: str,
    rows: Sequence[str],
    columns: Sequence[str],
    cells: Sequence[Sequence[HeatCell]],
    margin: float = MARGIN,
) -> Figure:
    """Return a figure of a matrix with a logarithmic colour scale.

    Args:
        title: Text above the matrix.
        rows: Names of the rows.
        columns: Names of the columns.
        cells: Row by row, `len(rows)` x `len(columns)`.
        margin: Width of the row names and of the colour bar [inch].
    """
    values = np.array([[np.nan if each.hatch else each.value for each in row] for row in cells])
    positive = values[values > 0]
    low, high = (positive.min(), positive.max()) if positive.size else (1.0, 1.0)
    size = (COLUMN * len(columns) + margin, ROW_HEIGHT * len(rows) + 1.3)
    with mpl.rc_context(FONT):
        figure = Figure(figsize=size, layout="constrained")
        ax = figure.subplots()
        x, y = np.arange(len(columns) + 1) - 0.5, np.arange(len(rows) + 1) - 0.5
        norm = LogNorm(low, high if high > low else 1.01 * low, clip=True)
        mesh = ax.pcolormesh(x, y, values, cmap=COLOR_MAP, norm=norm, edgecolors="white", lw=0.5)
        for i, row in enumerate(cells):
            for j, cell in enumerate(row):
                corner, ink, box = (j - 0.5, i - 0.5), INK, None
                if cell.hatch:
                    square = Rectangle(corner, 1, 1, hatch=cell.hatch, fc="white", ec="#999999")
                    square.set_linewidth(0.5)
                    ax.add_patch(square)
                    box = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}
                elif np.dot(mesh.to_rgba(np.array(cell.value))[:3], LUMINANCE) < DARK:
                    ink = "white"
                weight = "bold" if cell.framed else "normal"
                ax.text(
                    j, i, cell.text, ha="center", va="center", color=ink, bbox=box, weight=weight
                )
                if cell.framed:
                    inner = (j - 0.46, i - 0.42)
                    ax.add_patch(Rectangle(inner, 0.92, 0.84, fill=False, edgecolor=ink, lw=1.4))
        ax.invert_yaxis()
        ax.set_xticks(range(len(columns)), list(columns))
        ax.set_yticks(range(len(rows)), list(rows))
        ax.tick_params(length=0, labeltop=True, labelbottom=False)
        ax.spines[:].set_visible(False)
        ax.set_title(title, fontsize=9, loc="left")
        bar = figure.colorbar(mesh, ax=ax, fraction=0.06, pad=0.02)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.minorticks_off()
    return figure
