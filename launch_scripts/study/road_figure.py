"""The figure of one scenario: path, error, steering, yaw rate, speed and wind of all contenders."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config.metrics import LOST, ticks
from ampc_msgs_config.scenarios.scenario import speed_at
from ampc_msgs_config.scenarios.wind import wind_at
from ampc_msgs_config.types import Array
from launch_scripts.reporting.style import (
    CONTROLLER_STYLES,
    INK,
    REFERENCE_STYLE,
    label_ends,
    stack,
)
from launch_scripts.run.simulated import SimulatedDrive, centre_of_gravity, ticks_until_lost
from launch_scripts.study.cases import CONTENDERS

BOUNDED = ("error", "steering", "yaw_rate")
"""Panels whose axis follows those who stay on the path."""


def lines(driven: SimulatedDrive) -> dict[str, tuple[Array, Array]]:
    """Give what is drawn of a drive: by panel, abscissa and ordinate."""
    n, time = ticks_until_lost(driven), ticks(driven.drive)
    state = np.array([s[1:] for s in driven.drive.states])
    x, y = centre_of_gravity(driven)
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


def draw_road(runs: Mapping[str, SimulatedDrive]) -> Figure:
    """Draw a scenario: path, error, steering, yaw rate, speed, and wind where it blows."""
    shown = {name: driven for name, driven in runs.items() if name in CONTROLLER_STYLES}
    scenario = next(iter(shown.values())).scenario
    panels = dict(PANELS) | ({"wind": ("side wind [m/s]", 1.0)} if scenario.wind else {})
    figure, axes = stack([height for _, height in panels.values()])
    by_name = dict(zip(panels, axes, strict=True))
    for name, (label, _) in panels.items():
        by_name[name].set_ylabel(label)
    _wanted(by_name, shown)
    curves = {name: lines(driven) for name, driven in shown.items()}
    for name, panel_lines in curves.items():
        color, line = CONTROLLER_STYLES[name]
        lost = ticks_until_lost(shown[name]) < len(shown[name].error)
        width = 0.6 if lost else 2.4 if name == "paper" else 1.3
        style: dict[str, Any] = {"linestyle": line, "color": color}
        for panel, (a, b) in panel_lines.items():
            by_name[panel].plot(a, b, linewidth=width if panel in BOUNDED else 1.3, **style)
            if lost:
                by_name[panel].plot(a[-1], b[-1], "x", color=color, markersize=8, mew=2)
        by_name["equal"].plot(*panel_lines["place"], linewidth=0.9, **style)
    kept = _finish(by_name, shown, curves)
    figure.draw_without_rendering()
    _label(by_name, shown, curves, kept)
    return figure


def _wanted(axes: Mapping[str, Axes], shown: Mapping[str, SimulatedDrive]) -> None:
    driven = next(iter(shown.values()))
    end, time = (
        max(float(centre_of_gravity(d)[0].max()) for d in shown.values()),
        ticks(driven.drive),
    )
    seen = driven.path.x <= end
    for name in ("equal", "place"):
        axes[name].plot(driven.path.x[seen], driven.path.y[seen], zorder=0, **REFERENCE_STYLE)
    target = [speed_at(driven.scenario.speed, float(t)) for t in time]
    axes["speed"].plot(time, target, zorder=0, **REFERENCE_STYLE)
    if "wind" in axes:
        axes["wind"].plot(time, wind_at(driven.scenario.wind, time)[:, 1], color=INK)


def _finish(
    axes: Mapping[str, Axes], shown: Mapping[str, SimulatedDrive], curves: Mapping[str, Any]
) -> list[str]:
    """Set limits and titles; gives the names of those who stay on the path."""
    driven = next(iter(shown.values()))
    low, high = float(driven.path.y.min()) - 3.0, float(driven.path.y.max()) + 3.0
    axes["equal"].set_aspect("equal", adjustable="datalim")
    axes["equal"].set_title("true proportions", fontsize=8, loc="left")
    axes["place"].set_ylim(low, high)
    axes["place"].set_xlabel("X [m]")
    kept = [name for name, d in shown.items() if ticks_until_lost(d) == len(d.error)]
    for panel in BOUNDED:
        most = max((float(np.abs(curves[name][panel][1]).max()) for name in kept), default=LOST)
        axes[panel].set_ylim(-1.15 * most, 1.15 * most)
    axes["speed"].set_ylim(0.0, None)
    list(axes.values())[-1].set_xlabel("time [s]")
    return kept


def _label(
    axes: Mapping[str, Axes],
    shown: Mapping[str, SimulatedDrive],
    curves: Mapping[str, Any],
    kept: list[str],
) -> None:
    colors = {CONTENDERS[name]: CONTROLLER_STYLES[name][0] for name in shown}
    for panel in ("place", *BOUNDED):
        named = kept if panel in BOUNDED else list(shown)
        ends = {CONTENDERS[name]: float(curves[name][panel][1][-1]) for name in named}
        label_ends(axes[panel], ends, colors)
