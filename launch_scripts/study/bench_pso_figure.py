"""One picture of how searches converge: a panel for each problem, a curve for each method."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation

from ampc_msgs_config.types import Array
from launch_scripts.reporting.style import spread
from launch_scripts.study.pso_yardsticks import BUDGET, METHODS, PARTICLES, PROBLEMS

mpl.use("Agg")
STYLES: dict[str, tuple[str, str]] = {
    "proposed": ("#D55E00", "-"),
    "linear": ("#0072B2", "-"),
    "damped": ("#56B4E9", "--"),
    "classic": ("#777777", "-"),
    "Zhan's adaptive": ("#CC79A7", "-"),
    "random": ("#777777", ":"),
    "CMA-ES": ("#009E73", "-"),
    "SciPy's DE": ("#000000", "--"),
}
"""Colour (Okabe and Ito) and line of the methods that are drawn; the others are in the table."""
COLUMNS = 4
GAP = 0.062
"""Between the middles of two labels, as a share of the panel's height."""


def draw_curves(runs: Mapping[tuple[str, str], Array], file: Path) -> None:
    """Draw medians over seeds, labelled at their ends, into a PNG file.

    Args:
        runs: By names of problem and method: best value after each generation, a row for each seed.
        file: To write.
    """
    rows = -(-len(PROBLEMS) // COLUMNS)
    figure = Figure(figsize=(4.6 * COLUMNS, 4.2 * rows), layout="constrained", dpi=80)
    panels = figure.subplots(rows, COLUMNS, squeeze=False)
    for ax, problem in zip(panels.flat, PROBLEMS, strict=False):
        shown = {name: runs[problem.name, name] for name in STYLES if name in METHODS}
        _panel(ax, {name: np.median(values, axis=0) for name, values in shown.items()})
        ax.set_title(problem.name)
    for ax in panels[-1]:
        ax.set_xlabel("evaluations")
    for ax in panels[:, 0]:
        ax.set_ylabel("best value so far, median")
    figure.savefig(file)


def _panel(ax: Axes, medians: dict[str, Array]) -> None:
    ax.set_yscale("log")
    ax.yaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(2, 0.6)))
    evaluations = PARTICLES * np.arange(1, BUDGET // PARTICLES + 1)
    for name, values in medians.items():
        color, line = STYLES[name]
        width = 2.6 if name == "proposed" else 1.5
        ax.plot(evaluations, values, line, color=color, linewidth=width)
    ax.set_xlim(0, BUDGET)
    ax.grid(alpha=0.3)
    ends = {name: float(_height(ax, values[-1])) for name, values in medians.items()}
    for name, place in spread(ends, GAP).items():
        ax.annotate(
            name,
            xy=(1.0, ends[name]),
            xytext=(1.05, place),
            xycoords="axes fraction",
            va="center",
            color=STYLES[name][0],
            fontsize=9,
            fontweight="bold" if name == "proposed" else "normal",
            arrowprops={"arrowstyle": "-", "color": STYLES[name][0], "linewidth": 0.7},
        )


def _height(ax: Axes, value: float) -> float:
    """Place of a value on the axis, as a share of its height."""
    return float(ax.transAxes.inverted().transform(ax.transData.transform((0, value)))[1])
