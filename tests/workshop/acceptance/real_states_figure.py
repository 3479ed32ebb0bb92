"""Figure of the section "real states": largest errors before and now.

`python -m tests.workshop.acceptance.real_states --figure`.
"""

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from ampc_msgs_config.metrics import LOST
from launch_scripts.reporting.style import BLUE, FONT, ORANGE, save_png
from tests.supervised import between
from tests.workshop.acceptance.state_drives import SERVO_LAG, StateTrial, drive

FIGURE = Path("ampc_ros/doc/real_states.png")
OWN = ("paper", "ordinary")
DELAYS = (0.0, 0.05, 0.1, 0.15, 0.2)
"""Unknown delays [s]."""
LATE = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25)
"""Ages of the odometry [s]."""
BLIND = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Times without states [s]."""
BLIND_BEGINS = tuple(np.arange(5.0, 125.0, 9.0).tolist())
"""Positions on sc1 at which the time without states begins [m]."""
SPEED = 9.0
"""Speed on sc1 [m/s]."""
SMALLEST = 0.01
"""Lower end of the axis [m]."""


class Panel(NamedTuple):
    """One panel: a largest error over a disturbance."""

    title: str
    label: str
    scale: float
    """Unit of the axis."""
    values: tuple[float, ...]
    largest_error: partial[float]


def delay_error(delay: float) -> float:
    """Return the error with a delay that is not configured [m]."""
    trial = StateTrial("sc1_falcone", "independent", 11.0, lag=SERVO_LAG, configured=False)
    return drive(trial._replace(delay=delay)).max


def late_error(late: float) -> float:
    """Return the larger error of both cars on sc1 and sc2 with late odometry [m]."""
    trials = [StateTrial("sc1", car, SPEED, late=late) for car in OWN]
    trials += [trial._replace(road="sc2", speed=None) for trial in trials]
    return max(drive(trial).max for trial in trials)


def blind_error(seconds: float) -> float:
    """Return the largest error of both cars without states, from the worst position on [m]."""
    errors = []
    for car in OWN:
        for position in BLIND_BEGINS:
            begin = position / SPEED
            end = begin + seconds
            trial = StateTrial("sc1", car, SPEED)
            errors.append(drive(trial, blind=between(begin, end), end=end + 4.0).max)
    return max(errors)


PANELS = {
    "delay": Panel(
        "Delay and lag not configured", "delay of the actuator [ms]", 1000.0, DELAYS,
        partial(delay_error),
    ),
    "late": Panel("Late odometry", "age of the odometry [ms]", 1000.0, LATE, partial(late_error)),
    "blind": Panel(
        "Missing states", "time without states [s]", 1.0, BLIND, partial(blind_error)
    ),
}  # fmt: skip
Curves = Mapping[str, Sequence[float]]
"""Largest errors [m] by panel."""


def curves(workers: int) -> dict[str, list[float]]:
    """Measure all curves in parallel."""
    with ProcessPoolExecutor(workers) as pool:
        return {
            name: list(pool.map(panel.largest_error, panel.values))
            for name, panel in PANELS.items()
        }


def read_curves(file: Path) -> dict[str, list[float]]:
    """Return the stored curves of the version before."""
    stored = json.loads(file.read_text(encoding="utf-8"))["curves"]
    return {str(name): [float(value) for value in values] for name, values in stored.items()}


def draw(before: Curves, now: Curves, file: Path) -> None:
    """Draw one panel for each disturbance."""
    with mpl.rc_context(FONT):
        figure = Figure(figsize=(9.5, 3.4), layout="constrained")
        axes = figure.subplots(1, len(PANELS), sharey=True)
        for ax, (name, panel) in zip(axes, PANELS.items(), strict=True):
            at = [panel.scale * value for value in panel.values]
            for curve, color, line, label in (
                (before[name], ORANGE, "--", "before"),
                (now[name], BLUE, "-", "now"),
            ):
                errors = [min(max(error, SMALLEST), LOST) for error in curve]
                ax.plot(
                    at, errors, color=color, linestyle=line, marker="o", markersize=4, label=label
                )
            ax.set_title(panel.title, loc="left", fontweight="bold")
            ax.set_xlabel(panel.label)
            ax.set_yscale("log")
            ax.yaxis.set_major_formatter("{x:g}")
            ax.set_ylim(SMALLEST, 1.5 * LOST)
            ax.axhline(LOST, color="#777777", linewidth=0.8)
            ax.grid(alpha=0.25)
        axes[0].text(0.0, 1.08 * LOST, "lost: the drive ends", fontsize=8, color="#777777")
        axes[0].set_ylabel("largest true error [m]")
        axes[0].legend(loc="upper left", bbox_to_anchor=(0.0, 0.93))
    save_png(figure, file)
