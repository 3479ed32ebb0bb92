"""Figure of the acceptance table: both formulations on two scenarios."""

from collections.abc import Sequence
from pathlib import Path as File

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.metrics import ticks
from launch_scripts.reporting.style import BLUE, ORANGE, REFERENCE_STYLE
from launch_scripts.run.simulated import SimulatedDrive
from tests.workshop.acceptance.trials import Trial, run

mpl.use("Agg")
COLORS = {"paper": ORANGE, "preview": BLUE}
LINEAR = 0.01
"""Error below which the logarithmic axis is linear [m]."""
LABELS = ("Y [m]", "cross-track error [m]", "steering [deg]")


def draw_comparison(scenarios: Sequence[str], file: File) -> None:
    """Draw path, cross-track error and steering of both controllers, one column per scenario."""
    figure = Figure(figsize=(6.5 * len(scenarios), 9), layout="constrained", dpi=110)
    columns = figure.subplots(3, len(scenarios), squeeze=False).T
    for axes, name in zip(columns, scenarios, strict=True):
        driven = {controller: run(Trial(name), controller) for controller in COLORS}
        _column(axes, driven, name)
    for ax, label in zip(columns[0], LABELS, strict=True):
        ax.set_ylabel(label)
    columns[0][0].legend(loc="best")
    figure.savefig(file)


def _column(axes: Sequence[Axes], driven: dict[str, SimulatedDrive], name: str) -> None:
    place, error, steering = axes
    for controller, color in COLORS.items():
        _drive(axes, driven[controller], color, controller)
    path, end = driven["preview"].path, driven["preview"].drive.states[-1].x
    seen = path.x <= end
    place.plot(path.x[seen], path.y[seen], label="path", zorder=0, **REFERENCE_STYLE)
    place.set_title(name)
    place.set_xlabel("X [m]")
    error.set_yscale("symlog", linthresh=LINEAR)
    steering.set_xlabel("time [s]")
    for ax in axes:
        ax.grid(alpha=0.3)
        ax.margins(x=0)


def _drive(axes: Sequence[Axes], driven: SimulatedDrive, color: str, label: str) -> None:
    to_cg, time = driven.vehicle.chassis.cg_to_rear_axle, ticks(driven.drive)
    centre = np.array([at_distance(s, to_cg)[1:3] for s in driven.drive.states])
    axes[0].plot(*centre.T, color=color, label=label)
    axes[1].plot(time, driven.error, color=color)
    steering = np.degrees(driven.drive.steering)
    axes[2].plot(time, steering, color=color, drawstyle="steps-post")
