"""Plot style of every matplotlib figure: colours, fonts, labelled line ends, SVG and PNG output."""

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

mpl.use("Agg")
WIDTH = 6.4
"""Width of a figure [inch]."""
BLUE, ORANGE = "#0072B2", "#D55E00"
"""Colour-blind safe (Okabe and Ito)."""
INK = "#222222"
CONTROLLER_STYLES: dict[str, tuple[str, Any]] = {
    "paper": (ORANGE, "-"),
    "paper_pso": ("#E69F00", "-"),
    "classic": ("#000000", (0, (4, 3))),
    "classic_pso": ("#CC79A7", "-"),
    "pure_pursuit": ("#009E73", "-."),
    "preview": (BLUE, "-"),
}
"""Colour (Okabe and Ito) and line style by controller."""
REFERENCE_STYLE: dict[str, Any] = {"color": "#CCCCCC", "linewidth": 4}
"""Style of the reference: visible behind a car that follows it exactly."""
FONT: dict[str, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "reproduce",
}
SVG_PATHS = re.compile(r' d="[^"]*"')
SVG_DIGITS = re.compile(r"(\.\d\d)\d+")
"""Digits beyond hundredths of a point, half of the bytes of a page."""
SVG_CLIPS = re.compile(r"\bp[0-9a-f]{10}\b")
"""Names of clip paths; on logarithmic axes they contain addresses of memory."""


def lay_out(figure: Figure) -> None:
    """Place the panels of a figure, without drawing it."""
    if engine := figure.get_layout_engine():
        engine.execute(figure)


def svg(figure: Figure) -> str:
    """Return a figure as SVG text; equal figures have equal bytes."""
    file = io.StringIO()
    with mpl.rc_context(FONT):
        lay_out(figure)
        figure.set_layout_engine("none")  # else, savefig would draw the figure twice
        figure.savefig(file, format="svg", metadata={"Date": None})
    names: dict[str, str] = {}
    text = SVG_CLIPS.sub(
        lambda clip: names.setdefault(clip[0], f"clip{len(names)}"), file.getvalue()
    )
    return SVG_PATHS.sub(lambda path: SVG_DIGITS.sub(r"\1", path[0]), text)


def save_png(figure: Figure, file: Path) -> None:
    """Write a figure as PNG."""
    with mpl.rc_context(FONT):
        figure.savefig(file, dpi=120)


def save_figures(figures: Mapping[str, Figure], file: Path, formats: Sequence[str]) -> list[Path]:
    """Write figures as vector graphics and return the files.

    Args:
        figures: By name of the SVG file, without its suffix.
        file: Its folder is that of all files; the PDF file has its name, with a page per figure.
        formats: Any of svg, pdf.
    """
    files = []
    if "svg" in formats:
        for name, figure in figures.items():
            files.append(file.with_name(f"{name}.svg"))
            files[-1].write_text(svg(figure), encoding="utf-8")
    if "pdf" in formats:
        files.append(file.with_name(f"{file.stem}.pdf"))
        with mpl.rc_context(FONT), PdfPages(files[-1], metadata={"CreationDate": None}) as pages:
            for figure in figures.values():
                pages.savefig(figure)
    return files


def stack(heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel per height [inch], from top to bottom."""
    with mpl.rc_context(FONT):
        figure = Figure(figsize=(WIDTH, sum(heights) + 0.5), layout="constrained")
        axes = figure.subplots(len(heights), 1, height_ratios=list(heights), squeeze=False)[:, 0]
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.margins(x=0)
    return figure, list(axes)


def label_ends(ax: Axes, ends: Mapping[str, float], colors: Mapping[str, str]) -> None:
    """Label lines at their right ends.

    Args:
        ax: Axes that contain the lines.
        ends: Last ordinate of each line, by name [data units].
        colors: Colour of each line, by name.
    """
    place = {
        name: float(ax.transAxes.inverted().transform(ax.transData.transform((0.0, end)))[1])
        for name, end in ends.items()
    }
    place = {name: min(max(height, 0.0), 1.0) for name, height in place.items()}
    height = ax.get_window_extent().height / ax.figure.dpi
    for name, at in spread(place, 0.16 / max(height, 0.5)).items():
        ax.annotate(
            name,
            xy=(1.0, place[name]),
            xytext=(1.06, at),
            xycoords="axes fraction",
            va="center",
            color=INK,
            fontsize=8,
            arrowprops={
                "arrowstyle": "-",
                "color": colors[name],
                "linewidth": 1.6,
                "relpos": (0.0, 0.5),
            },
        )


def spread(places: Mapping[str, float], gap: float) -> dict[str, float]:
    """Move label positions apart to a minimum gap, in their order and about their mean."""
    names = sorted(places, key=lambda name: places[name])
    moved = np.array([places[name] for name in names])
    for _ in range(500):
        short = np.maximum(gap - np.diff(moved), 0.0) / 2
        if short.max(initial=0.0) < gap / 100:
            break
        moved[:-1] -= short
        moved[1:] += short
    moved += min(0.0, 1.0 - moved[-1]) + max(0.0, -moved[0])
    return dict(zip(names, moved.tolist(), strict=True))
