"""Figure of the benchmark: durations of solvers and ticks, rate of a swarm, growth with size."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path as File
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from launch_scripts.reporting.style import BLUE, ORANGE
from tests.workshop.bench.bench_growth import AXES, HELD, SERIES, exponents
from tests.workshop.bench.bench_report import Row, Section
from tests.workshop.bench.bench_solvers import INSIDE as QP_INSIDE
from tests.workshop.bench.bench_solvers import OWN_CLOCK
from tests.workshop.bench.bench_ticks import DAQP_ALONE, FULL
from tests.workshop.bench.bench_ticks import INSIDE as TICK_INSIDE

mpl.use("Agg")
GREY, SKY = "#777777", "#56B4E9"
STYLES = ((BLUE, "o", "-"), (SKY, "s", "--"), (ORANGE, "^", ":"))
"""Colour (Okabe and Ito), marker and line style of each series, distinct in print."""
GROWTH = {axis: f"growth_{axis.split()[0]}" for axis in AXES}
ROOM = 5.0
"""Factor of the axis beyond the longest line, for labels."""
CLOSE = 1.1
"""Minimum ratio of two labels on a logarithmic axis."""
DRAWN = ("qp", "tick", "swarm_paper", "swarm_preview", *GROWTH.values())
"""Tables that the figure needs."""
SHORT = {
    "ours": "ours, from Python",
    FULL: "ours, state to command",
    TICK_INSIDE: "ours, in compiled code",
    QP_INSIDE: "ours, in the compiled tick",
    OWN_CLOCK: "DAQP, by its own clock",
    DAQP_ALONE: "(daqp.solve alone, no model)",
    "OSQP, default settings": "OSQP, default",
    "CasADi + DAQP, multiple shooting": "CasADi + DAQP, shooting",
    "CasADi + OSQP, multiple shooting": "CasADi + OSQP, shooting",
}


def draw(sections: Sequence[Section], file: File) -> None:
    """Draw six panels from all tables in `DRAWN`."""
    rows = {section.key: section.rows for section in sections}
    figure = Figure(figsize=(16, 9.5), layout="constrained", dpi=100)
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.1, 1))
    ticks, qp, swarm = top.subplots(1, 3, width_ratios=(1.1, 1, 1))
    ranking(ticks, "One tick of the MPC", rows["tick"], "wrong [%]")
    ranking(qp, "The quadratic program alone", rows["qp"], "wrong in all [%]")
    rates(swarm, rows["swarm_paper"], rows["swarm_preview"])
    for ax, axis in zip(bottom.subplots(1, len(AXES), sharey=True), AXES, strict=True):
        growth(ax, axis, rows[GROWTH[axis]])
    figure.savefig(file)


def simplify(ax: Axes, title: str) -> None:
    """Remove decoration that carries no number."""
    ax.set_title(title, loc="left", fontweight="bold")
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(alpha=0.25)
    ax.set_axisbelow(True)


def write_beside(ax: Axes, text: str, place: tuple[float, float], color: Any) -> None:
    """Write a text to the right of a point."""
    style: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 9}
    ax.annotate(text, place, (8, 0), color=color, **style)


def ranking(ax: Axes, title: str, rows: Sequence[Row], wrong: str) -> None:
    """Draw medians, the fastest on top, with the share of wrong answers beside the number."""
    ordered = sorted(rows, key=lambda row: row["median [us]"], reverse=True)
    names = [next(iter(row.values())) for row in ordered]
    times = [row["median [us]"] for row in ordered]
    colors = [BLUE if name.startswith("ours") else GREY for name in names]
    ax.hlines(range(len(names)), min(times) / 2, times, colors=colors, linewidth=3, alpha=0.4)
    ax.scatter(times, range(len(names)), c=colors, s=45, zorder=3)
    for y, row in enumerate(ordered):
        amiss = f", {row[wrong]:.2g} % wrong" if row[wrong] else ""
        write_beside(ax, f"{in_unit(times[y])}{amiss}", (times[y], y), ORANGE if amiss else "black")
    ax.set_yticks(range(len(names)), [SHORT.get(name, name) for name in names])
    ax.set_xscale("log")
    ax.set_xlim(min(times) / 2, max(times) * ROOM * (max(times) / min(times)) ** 0.3)
    ax.set_xlabel("median [us]")
    simplify(ax, title)
    ax.grid(visible=False, axis="y")


def in_unit(microseconds: float) -> str:
    """Return a time as text with two or three digits."""
    if microseconds >= 1000:
        return f"{microseconds / 1000:.1f} ms"
    return f"{microseconds:.{0 if microseconds >= 100 else 1}f} us"


def rates(ax: Axes, paper: Sequence[Row], preview: Sequence[Row]) -> None:
    """Draw ticks per second over cars, a line for each integration step."""
    steps = [name for name in paper[0] if name != "cars"]
    drawn = [(paper, step, f"paper, {step}", "o-") for step in steps]
    drawn.append((preview, "5 ms", "preview, 5 ms", "^:"))
    cars = [int(row["cars"]) for row in paper]
    heights = apart([rows[-1][step] for rows, step, _, _ in drawn])
    shades = mpl.colormaps["Blues"](np.linspace(0.95, 0.5, len(steps)))
    colors = [*shades, ORANGE]
    for (rows, step, label, style), height, color in zip(drawn, heights, colors, strict=True):
        ax.plot(cars, [row[step] for row in rows], style, color=color, markersize=4)
        write_beside(ax, label, (cars[-1], height), color)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xticks(cars, [str(n) for n in cars])
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:,.0f}")
    ax.minorticks_off()
    ax.set_xlim(cars[0] / 1.3, cars[-1] * (cars[-1] / cars[0]) ** 0.45)
    ax.set_xlabel("cars in lock-step (10 ticks drive 1 s)")
    simplify(ax, "Closed loop, ticks/s and core")


def apart(values: Sequence[float]) -> list[float]:
    """Return label positions that do not overlap."""
    order, heights = np.argsort(values), list(values)
    for below, above in pairwise(order):
        heights[above] = max(heights[above], CLOSE * heights[below])
    return heights


def growth(ax: Axes, axis: str, rows: list[Row]) -> None:
    """Draw times over sizes on logarithmic axes, with name and exponent at the end of the line."""
    powers = exponents(axis, rows)
    sizes = [int(row[axis]) for row in rows]
    values = {name: [row[name] for row in rows] for name in SERIES}
    heights = apart([values[name][-1] for name in SERIES])
    for name, height, (color, marker, line) in zip(SERIES, heights, STYLES, strict=True):
        ax.plot(sizes, values[name], color=color, marker=marker, linestyle=line, markersize=4)
        label = f"{name.removesuffix(' [us]')} ~ size$^{{{powers[name]:.2f}}}$"
        write_beside(ax, label, (sizes[-1], height), color)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xticks(sizes, [str(size) for size in sizes])
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.minorticks_off()
    ax.set_xlim(sizes[0] / 1.1, sizes[-1] * (sizes[-1] / sizes[0]) ** 0.5)
    ax.set_ylabel("median [us]")
    ax.set_xlabel(f"{axis}   ({HELD[axis]})")
    simplify(ax, f"Growth with {axis}")
    ax.label_outer()
