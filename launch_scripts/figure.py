"""One picture of a drive."""

from pathlib import Path as File

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config.drive_log import DriveLog
from ampc_msgs_config.metrics import errors, ticks
from ampc_msgs_config.types import at_distance

mpl.use("Agg")
BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#999999"  # colour-blind safe (Okabe and Ito)


def draw(log: DriveLog, base_link_to_cg: float, title: str, file: File) -> None:
    """Draw path, cross-track error, steering and speed of a drive into a PNG file."""
    figure = Figure(figsize=(10, 11), layout="constrained", dpi=110)
    figure.suptitle(title, fontsize=13)
    axes = figure.subplots(4, 1, height_ratios=(1.6, 1, 1, 1))
    time = ticks(log.drive)
    _path(axes[0], log, base_link_to_cg)
    error = errors(log.drive, log.path, base_link_to_cg)[:, 0]
    _over_time(axes[1], time, error, "cross-track error [m]")
    steering = np.degrees(log.drive.steering)
    _over_time(axes[2], time, steering, "steering command [deg]", step=True)
    speed = np.array([state.v_x for state in log.drive.states])
    axes[3].plot(*log.target_speed.T, "--", color=GREY, label="target, 0.5 s ahead")
    _over_time(axes[3], time, speed, "speed [m/s]", label="car")
    axes[3].set_ylim(0, None)
    axes[3].set_xlabel("time [s]")
    axes[3].legend(loc="lower right")
    figure.savefig(file)


def _path(ax: Axes, log: DriveLog, base_link_to_cg: float) -> None:
    centre = np.array([at_distance(s, base_link_to_cg)[1:3] for s in log.drive.states])
    ax.plot(log.path.x, log.path.y, "--", color=GREY, label="reference")
    ax.plot(*centre.T, color=BLUE, label="car (centre of gravity)")
    ax.plot(*centre[0], "o", color=ORANGE, label="start")
    spread = np.ptp(log.path.y) / max(np.ptp(log.path.x), 1e-9)
    if spread > 0.2:
        ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("x in map [m]")
    ax.set_ylabel("y in map [m]")
    ax.grid(alpha=0.3)
    ax.legend(loc="best")


def _over_time(
    ax: Axes, time: np.ndarray, values: np.ndarray, name: str, *, step: bool = False, label: str = ""
) -> None:
    style = "steps-post" if step else "default"
    ax.plot(time, values, color=BLUE, drawstyle=style, label=label)
    ax.set_ylabel(name)
    ax.set_xlim(0, time[-1])
    ax.grid(alpha=0.3)
