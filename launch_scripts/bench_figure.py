"""Picture of the growth."""

from collections.abc import Sequence
from pathlib import Path as File

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from launch_scripts.bench_growth import AXES, HELD, SERIES, exponents
from launch_scripts.bench_report import Section
from launch_scripts.figure import BLUE, ORANGE

mpl.use("Agg")
STYLES = ((BLUE, "o", "-"), ("#56B4E9", "s", "--"), (ORANGE, "^", ":"))
"""Colour (Okabe and Ito), marker and line of each series: told apart in print, too."""


def draw_growth(sections: Sequence[Section], file: File) -> None:
    """Draw times over sizes, both axes logarithmic, the exponents in the legend."""
    figure = Figure(figsize=(14, 5), layout="constrained", dpi=110)
    found = {section.title.removeprefix("Growth with "): section.rows for section in sections}
    for ax, axis in zip(figure.subplots(1, len(AXES), sharey=True), AXES, strict=True):
        rows, powers = found[axis], exponents(axis, found[axis])
        sizes = [int(row[axis]) for row in rows]
        for name, (color, marker, line) in zip(SERIES, STYLES, strict=True):
            label = f"{name.removesuffix(' [us]')}, ~ size^{powers[name]:.2f}"
            style = {"color": color, "marker": marker, "linestyle": line}
            ax.loglog(sizes, [row[name] for row in rows], label=label, **style)
        ax.set_xticks(sizes, [str(size) for size in sizes])
        ax.minorticks_off()
        ax.set_xlabel(f"{axis}\n({HELD[axis]})")
        ax.set_ylabel("median time [us]")
        ax.grid(alpha=0.3)
        ax.legend(loc="upper left")
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.margins(y=0.3)
        ax.label_outer()
    figure.savefig(file)
