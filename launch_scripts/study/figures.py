"""Figures of the reproduction: scenarios, adaptation, swarms, searches and sweeps."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ampc_msgs_config.metrics import LOST, ticks
from ampc_msgs_config.scenarios.scenario import speed_at
from ampc_msgs_config.scenarios.wind import wind_at
from ampc_msgs_config.types import Array, Diagnosis
from launch_scripts.reporting.style import (
    CONTROLLER_STYLES,
    INK,
    REFERENCE_STYLE,
    label_ends,
    stack,
)
from launch_scripts.run.simulated import SimulatedDrive, centre_of_gravity, ticks_until_lost
from launch_scripts.study.claim_by_speed import draw_claim
from launch_scripts.study.claims import PAPER_MSE
from launch_scripts.study.drives import CONTENDERS, STUDY_ROADS
from launch_scripts.study.measurements import LOOK_AHEAD_DISTANCES
from launch_scripts.study.pso_methods import GENERATIONS, METHOD_STYLES, REPORTED

SCENARIO_PANELS = {
    "equal": ("Y [m]", 0.55),
    "place": ("Y [m], stretched", 1.7),
    "error": ("cross-track error [m]", 1.7),
    "steering": ("steering [deg]", 1.5),
    "yaw_rate": ("yaw rate [deg/s]", 1.5),
    "speed": ("speed [m/s]", 1.2),
}
"""Panels of a scenario: label of the ordinate, height [inch]."""
SCALED_PANELS = ("error", "steering", "yaw_rate")
"""Panels whose range is that of the drives that stay on the path."""
SHOWN_SWARMS = ("proposed", "linear", "damped", "classic", "Zhan's adaptive")
CURVE_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00")


def draw_figures(
    results: Mapping[str, Any],
    driven: Mapping[str, Mapping[str, SimulatedDrive]],
    labels: Mapping[str, str] = CONTENDERS,
) -> dict[str, Figure]:
    """Draw all figures of the page, by name; `labels` are the names of the contenders."""
    # curves by name: abscissa, ordinate
    searches = {
        f"{t['model']}, seed {t['seed']}": (range(len(t["history_m2"])), t["history_m2"])
        for t in results["tuning"]
        if t["used"]
    }
    trials, sweep = results["look_ahead"]["trials"], results["sweep"]
    look_ahead = {}
    for distance in LOOK_AHEAD_DISTANCES:
        own = [trial for trial in trials if trial["distance_m"] == distance]
        curve = [trial["time_s"] for trial in own], [trial["fitness_m2"] for trial in own]
        look_ahead[f"at least {distance:g} m"] = curve
    weights = {
        STUDY_ROADS[road]: ([row["R"] for row in sweep], [row["mse_m2"][road] for row in sweep])
        for road in sweep[0]["mse_m2"]
    }
    sc1 = PAPER_MSE["sc1"]
    levels = {"paper's AMPC": sc1["paper"], "paper's classic": sc1["classic"]}
    return {
        "claim_by_speed": draw_claim(results["claim_by_speed"]),
        **{road: draw_road(row, labels) for road, row in driven.items()},
        "adaptation": draw_adaptation(driven.get("sc3_varying") or driven["sc2"], labels),
        "sphere": draw_sphere({name: results["sphere"]["curves"][name] for name in SHOWN_SWARMS}),
        "tuning": draw_curves(searches, "generation", "best fitness [m\u00b2]"),
        "look_ahead": draw_curves(look_ahead, "look-ahead time [s]", "mean MSE [m\u00b2]"),
        "sweep": draw_curves(weights, "increment weight R", "MSE [m\u00b2]", levels),
    }


def draw_road(driven: Mapping[str, SimulatedDrive], labels: Mapping[str, str]) -> Figure:
    """Draw a scenario: path, error, steering, yaw rate, speed, and wind if there is any."""
    shown = {name: d for name, d in driven.items() if name in CONTROLLER_STYLES}
    first = next(iter(shown.values()))
    panels = SCENARIO_PANELS | ({"wind": ("side wind [m/s]", 1.0)} if first.scenario.wind else {})
    figure, rows = stack([height for _, height in panels.values()])
    axes = dict(zip(panels, rows, strict=True))
    for name, (label, _) in panels.items():
        axes[name].set_ylabel(label)
    # reference path, target speed and wind
    end = max(float(centre_of_gravity(d)[0].max()) for d in shown.values())
    seen, time = first.path.x <= end, ticks(first.drive)
    for name in ("equal", "place"):
        axes[name].plot(first.path.x[seen], first.path.y[seen], zorder=0, **REFERENCE_STYLE)
    target = [speed_at(first.scenario.speed, float(t)) for t in time]
    axes["speed"].plot(time, target, zorder=0, **REFERENCE_STYLE)
    if first.scenario.wind:
        axes["wind"].plot(time, wind_at(first.scenario.wind, time)[:, 1], color=INK)
    # drives until they are lost
    curves = {name: panel_curves(d) for name, d in shown.items()}
    stayed = [name for name, d in shown.items() if ticks_until_lost(d) == len(d.error)]
    for name, own in curves.items():
        (color, line), lost = CONTROLLER_STYLES[name], name not in stayed
        for panel, (a, b) in own.items():
            width = {"equal": 0.9, "place": 1.3, "speed": 1.3}.get(
                panel, 0.6 if lost else 2.4 if name == "paper" else 1.3
            )
            axes[panel].plot(a, b, linestyle=line, color=color, linewidth=width)
            if lost and panel != "equal":  # a cross marks where the car is lost
                axes[panel].plot(a[-1], b[-1], "x", color=color, markersize=8, mew=2)
    # ranges
    y = first.path.y
    axes["equal"].set_aspect("equal", adjustable="datalim")
    axes["equal"].set_title("true proportions", fontsize=8, loc="left")
    axes["place"].set_ylim(float(y.min()) - 3.0, float(y.max()) + 3.0)
    axes["place"].set_xlabel("X [m]")
    for panel in SCALED_PANELS:
        most = max((float(np.abs(curves[name][panel][1]).max()) for name in stayed), default=LOST)
        axes[panel].set_ylim(-1.15 * most, 1.15 * most)
    axes["speed"].set_ylim(0.0, None)
    rows[-1].set_xlabel("time [s]")
    # labels at the line ends
    figure.draw_without_rendering()
    for panel in ("place", *SCALED_PANELS):
        named = stayed if panel in SCALED_PANELS else list(shown)
        ends = {name: float(curves[name][panel][1][-1]) for name in named}
        label_contenders(axes[panel], ends, labels)
    return figure


def panel_curves(driven: SimulatedDrive) -> dict[str, tuple[Array, Array]]:
    """Return abscissa and ordinate of a drive by panel, until the car is lost."""
    n, time = ticks_until_lost(driven), ticks(driven.drive)
    state = np.array([s[1:] for s in driven.drive.states])
    x, y = centre_of_gravity(driven)
    curves = {
        "equal": (x, y),
        "place": (x, y),
        "error": (time, driven.error),
        "steering": (time, np.degrees(driven.drive.steering)),
        "yaw_rate": (time, np.degrees(state[:, 5])),
        "speed": (time, state[:, 3]),
    }
    return {panel: (a[:n], b[:n]) for panel, (a, b) in curves.items()}


def label_contenders(ax: Axes, ends: Mapping[str, float], labels: Mapping[str, str]) -> None:
    """Label the lines of contenders at their right ends."""
    colors = {labels[name]: CONTROLLER_STYLES[name][0] for name in ends}
    label_ends(ax, {labels[name]: end for name, end in ends.items()}, colors)


def draw_adaptation(driven: Mapping[str, SimulatedDrive], labels: Mapping[str, str]) -> Figure:
    """Draw the gains in use over time: horizons, Laguerre terms, Q / R."""
    gains: dict[str, Callable[[Diagnosis], float]] = {
        "N_p [ticks]": lambda d: d.prediction_horizon,
        "N_c [ticks]": lambda d: d.control_horizon,
        "N": lambda d: d.laguerre_terms,
        "Q / R": lambda d: d.output_weight / d.increment_weight,
    }
    figure, axes = stack([1.5, 1.3, 1.3, 1.5])
    drives = {name: driven[name] for name in ("paper", "paper_pso", "preview")}
    values = {
        label: {name: [gain(d) for d in drive.diagnosis] for name, drive in drives.items()}
        for label, gain in gains.items()
    }
    for ax, (label, rows) in zip(axes, values.items(), strict=True):
        ax.set_ylabel(label)
        for name, row in rows.items():
            color, line = CONTROLLER_STYLES[name]
            style = "default" if ax is axes[-1] else "steps-post"
            ax.plot(ticks(drives[name].drive), row, linestyle=line, color=color, drawstyle=style)
        if ax is not axes[-1]:
            ax.set_ylim(0, None)
    axes[-1].set_yscale("log")
    axes[-1].set_xlabel("time [s]")
    figure.draw_without_rendering()
    for ax, rows in zip(axes, values.values(), strict=True):
        label_contenders(ax, {name: row[-1] for name, row in rows.items()}, labels)
    return figure


def draw_sphere(curves: Mapping[str, Array]) -> Figure:
    """Draw median and quartiles of the best value over the generations, and the paper's values."""
    figure, (ax,) = stack([3.4])
    ax.set_yscale("log")
    ends = {}
    for name, values in curves.items():
        color, line = METHOD_STYLES[name]
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
    label_ends(ax, ends, {name: METHOD_STYLES[name][0] for name in curves})
    return figure


def draw_curves(
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    abscissa: str,
    ordinate: str,
    levels: Mapping[str, float] | None = None,
) -> Figure:
    """Draw labelled curves on a logarithmic ordinate.

    Args:
        curves: Abscissa and ordinate by name.
        abscissa: Label of the axis.
        ordinate: Label of the axis.
        levels: Horizontal lines to compare with, by name; with them the abscissa is logarithmic.
    """
    levels = levels or {}
    figure, (ax,) = stack([2.6])
    colors = dict(zip((*curves, *levels), CURVE_COLORS * 2, strict=False))
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    if levels:
        ax.set_xscale("log")
    for name, (a, b) in curves.items():
        ax.plot(a, b, ".-", color=colors[name])
    for name, level in levels.items():
        ax.axhline(level, color=colors[name], linestyle=":", linewidth=1.3)
    ax.set_xlabel(abscissa)
    ax.set_ylabel(ordinate)
    figure.draw_without_rendering()
    label_ends(ax, {name: float(b[-1]) for name, (_, b) in curves.items()} | dict(levels), colors)
    return figure
