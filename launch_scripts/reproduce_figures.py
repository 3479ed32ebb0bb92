"""Figures of the reproduction, as SVG text: labelled at the lines, legible on a phone."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.path import Array
from ampc_msgs_config.scenario import speed_at
from ampc_msgs_config.types import at_distance
from ampc_msgs_config.wind import wind_at
from launch_scripts.bench_pso_figure import STYLES, spread
from launch_scripts.bench_pso_tables import REPORTED
from launch_scripts.figure import WANTED
from launch_scripts.pso_yardsticks import GENERATIONS
from launch_scripts.reproduce_cases import CONTENDERS, LOST, Run

mpl.use("Agg")
WIDTH = 6.4
"""Of every figure [inch]."""
STYLE: dict[str, tuple[str, str]] = {
    "paper": ("#D55E00", "-"),
    "paper_pso": ("#E69F00", "-"),
    "classic": ("#000000", "--"),
    "classic_pso": ("#CC79A7", "-"),
    "pure_pursuit": ("#009E73", "-."),
    "preview": ("#0072B2", "-"),
}
"""Colour (Okabe and Ito) and line of the contenders that are drawn."""
FONT: dict[str, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "reproduce",
}
INK = "#222222"
BOUNDED = ("error", "steering", "yaw_rate")
"""Panels whose axis follows those who stay on the path."""


def svg(figure: Figure) -> str:
    """Give a figure as SVG text, the same bytes for the same figure."""
    file = io.StringIO()
    with mpl.rc_context(FONT):
        figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()


def stack(heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Give a figure of panels one below the other, of these heights [inch]."""
    with mpl.rc_context(FONT):
        figure = Figure(figsize=(WIDTH, sum(heights) + 0.5), layout="constrained")
        axes = figure.subplots(len(heights), 1, height_ratios=list(heights), squeeze=False)[:, 0]
    for ax in axes:
        ax.grid(alpha=0.25)
        ax.margins(x=0)
    return figure, list(axes)


def label_ends(ax: Axes, ends: Mapping[str, float], colors: Mapping[str, str]) -> None:
    """Write the names of lines beside their ends, whose heights are data [axis units]."""
    place = {
        name: float(ax.transAxes.inverted().transform(ax.transData.transform((0.0, end)))[1])
        for name, end in ends.items()
    }
    place = {name: min(max(height, 0.0), 1.0) for name, height in place.items()}
    height = ax.figure.get_size_inches()[1] * ax.get_position().height
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


def until_lost(driven: Run) -> int:
    """Give the number of ticks before a car is lost: what it does then is nobody's control."""
    gone = np.abs(driven.error) > LOST
    return int(np.argmax(gone)) if gone.any() else len(driven.error)


def centre(driven: Run) -> Array:
    """Give x and y of the centre of gravity (2, n) [m]."""
    to_cg = driven.vehicle.chassis.cg_to_rear_axle
    return np.array([at_distance(state, to_cg)[1:3] for state in driven.drive.states]).T


def lines(driven: Run) -> dict[str, tuple[Array, Array]]:
    """Give what is drawn of a drive: by panel, abscissa and ordinate."""
    n, time = until_lost(driven), ticks(driven.drive)
    state = np.array([s[1:] for s in driven.drive.states])
    x, y = centre(driven)
    curves = {
        "place": (x, y),
        "error": (time, driven.error),
        "steering": (time, np.degrees(driven.drive.steering)),
        "yaw_rate": (time, np.degrees(state[:, 5])),
        "speed": (time, state[:, 3]),
    }
    return {panel: (a[:n], b[:n]) for panel, (a, b) in curves.items()}


PANELS = {
    "equal": ("Y [m]", 0.55),
    "place": ("Y [m], stretched", 1.7),
    "error": ("cross-track error [m]", 1.7),
    "steering": ("steering [deg]", 1.5),
    "yaw_rate": ("yaw rate [deg/s]", 1.5),
    "speed": ("speed [m/s]", 1.2),
}


def draw_road(runs: Mapping[str, Run]) -> str:
    """Draw a scenario: path, error, steering, yaw rate, speed, and wind where it blows."""
    shown = {name: driven for name, driven in runs.items() if name in STYLE}
    scenario = next(iter(shown.values())).scenario
    panels = dict(PANELS) | ({"wind": ("side wind [m/s]", 1.0)} if scenario.wind else {})
    figure, axes = stack([height for _, height in panels.values()])
    by_name = dict(zip(panels, axes, strict=True))
    for name, (label, _) in panels.items():
        by_name[name].set_ylabel(label)
    _wanted(by_name, shown)
    curves = {name: lines(driven) for name, driven in shown.items()}
    for name, panel_lines in curves.items():
        color, line = STYLE[name]
        for panel, (a, b) in panel_lines.items():
            by_name[panel].plot(a, b, line, color=color, linewidth=1.3)
            if until_lost(shown[name]) < len(shown[name].error):
                by_name[panel].plot(a[-1], b[-1], "x", color=color, markersize=8, mew=2)
        by_name["equal"].plot(*panel_lines["place"], line, color=color, linewidth=0.9)
    _finish(by_name, shown, curves)
    return svg(figure)


def _wanted(axes: Mapping[str, Axes], shown: Mapping[str, Run]) -> None:
    driven = next(iter(shown.values()))
    end, time = max(float(centre(d)[0].max()) for d in shown.values()), ticks(driven.drive)
    seen = driven.path.x <= end
    for name in ("equal", "place"):
        axes[name].plot(driven.path.x[seen], driven.path.y[seen], zorder=0, **WANTED)
    target = [speed_at(driven.scenario.speed, float(t)) for t in time]
    axes["speed"].plot(time, target, zorder=0, **WANTED)
    if "wind" in axes:
        axes["wind"].plot(time, wind_at(driven.scenario.wind, time)[:, 1], color=INK)


def _finish(axes: Mapping[str, Axes], shown: Mapping[str, Run], curves: Mapping[str, Any]) -> None:
    driven = next(iter(shown.values()))
    low, high = float(driven.path.y.min()) - 3.0, float(driven.path.y.max()) + 3.0
    axes["equal"].set_aspect("equal", adjustable="datalim")
    axes["equal"].set_title("true proportions", fontsize=8, loc="left")
    axes["place"].set_ylim(low, high)
    axes["place"].set_xlabel("X [m]")
    kept = [name for name, d in shown.items() if until_lost(d) == len(d.error)]
    for panel in BOUNDED:
        most = max((float(np.abs(curves[name][panel][1]).max()) for name in kept), default=LOST)
        axes[panel].set_ylim(-1.15 * most, 1.15 * most)
    axes["speed"].set_ylim(0.0, None)
    list(axes.values())[-1].set_xlabel("time [s]")
    axes["place"].figure.draw_without_rendering()
    colors = {CONTENDERS[name]: STYLE[name][0] for name in shown}
    for panel in ("place", *BOUNDED):
        named = kept if panel in BOUNDED else list(shown)
        ends = {CONTENDERS[name]: float(curves[name][panel][1][-1]) for name in named}
        label_ends(axes[panel], ends, colors)


def draw_adaptation(runs: Mapping[str, Run]) -> str:
    """Draw which gains were in use: horizons and terms, then Q / R."""
    figure, axes = stack([1.5, 1.3, 1.3, 1.5])
    fields = (
        ("prediction_horizon", "N_p [ticks]"),
        ("control_horizon", "N_c [ticks]"),
        ("laguerre_terms", "N"),
    )
    shown = {n: d for n, d in runs.items() if n in ("paper", "paper_pso", "preview")}
    last: dict[str, dict[str, float]] = {label: {} for label in ("N_p", "N_c", "N", "ratio")}
    for name, driven in shown.items():
        color, line = STYLE[name]
        time = ticks(driven.drive)
        for ax, (field, label) in zip(axes, fields, strict=False):
            values = np.array([getattr(d, field) for d in driven.diagnosis])
            ax.plot(time, values, line, color=color, drawstyle="steps-post")
            ax.set_ylabel(label)
            last[label.split()[0]][CONTENDERS[name]] = float(values[-1])
        ratio = np.array([d.output_weight / d.increment_weight for d in driven.diagnosis])
        axes[3].plot(time, ratio, line, color=color)
        last["ratio"][CONTENDERS[name]] = float(ratio[-1])
    axes[3].set_yscale("log")
    axes[3].set_ylabel("Q / R")
    axes[3].set_xlabel("time [s]")
    for ax in axes[:3]:
        ax.set_ylim(0, None)
    figure.draw_without_rendering()
    colors = {CONTENDERS[name]: STYLE[name][0] for name in shown}
    for ax, ends in zip(axes, last.values(), strict=True):
        label_ends(ax, ends, colors)
    return svg(figure)


def draw_sphere(curves: Mapping[str, Array]) -> str:
    """Draw medians and quartiles of the best value over the generations, and the paper's."""
    figure, (ax,) = stack([3.4])
    ax.set_yscale("log")
    ends = {}
    for name, values in curves.items():
        color, line = STYLES[name]
        low, middle, high = np.percentile(values, (25, 50, 75), axis=0)
        generation = np.arange(len(middle))
        ax.fill_between(generation, low, high, color=color, alpha=0.15, linewidth=0)
        ax.plot(generation, middle, line, color=color, linewidth=1.6)
        ends[name] = float(middle[-1])
        if name in REPORTED:
            style: dict[str, Any] = {"clip_on": False, "markersize": 9, "zorder": 5, "mew": 1}
            ax.plot(GENERATIONS, REPORTED[name], "*", color=color, mec=INK, **style)
    ax.set_xlabel("generation")
    ax.set_ylabel("best value so far")
    figure.draw_without_rendering()
    label_ends(ax, ends, {name: STYLES[name][0] for name in curves})
    return svg(figure)


def draw_lines(
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    labels: tuple[str, str],
    levels: Mapping[str, float] | None = None,
    log_x: bool = False,
) -> str:
    """Draw some labelled curves on a logarithmic axis, and levels to compare them with."""
    figure, (ax,) = stack([2.6])
    palette = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00")
    colors = dict(zip((*curves, *(levels or {})), palette * 2, strict=False))
    ax.set_yscale("log")
    if log_x:
        ax.set_xscale("log")
    for name, (a, b) in curves.items():
        ax.plot(a, b, ".-", color=colors[name])
    for name, level in (levels or {}).items():
        ax.axhline(level, color=colors[name], linestyle=":", linewidth=1.3)
    ax.set_xlabel(labels[0])
    ax.set_ylabel(labels[1])
    figure.draw_without_rendering()
    ends = {name: float(b[-1]) for name, (_, b) in curves.items()} | dict(levels or {})
    label_ends(ax, ends, colors)
    return svg(figure)
