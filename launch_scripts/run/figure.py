"""One picture of a drive."""

from collections.abc import Sequence
from pathlib import Path as File

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.metrics import errors, ticks
from ampc_msgs_config.paths.curves import Lane
from ampc_msgs_config.paths.path_frame import PathFrame, along_chord, path_frame
from ampc_msgs_config.scenarios.scenario import SPEED_PREVIEW
from ampc_msgs_config.types import Array
from launch_scripts.bags.drive_log import DriveLog
from launch_scripts.reporting.style import BLUE, ORANGE, REFERENCE_STYLE

NARROWEST = 0.5
"""Smallest offset from the chord that fills the picture [m]."""


def draw(
    log: DriveLog, lanes: Sequence[Lane], base_link_to_cg: float, title: str, file: File
) -> None:
    """Draw path, cross-track error, steering and speed of a drive into a PNG file.

    Args:
        log: The drive.
        lanes: Gates of cones, where the scenario has them.
        base_link_to_cg: From the point that the states describe to the centre of gravity [m].
        title: Above the picture.
        file: To write.
    """
    figure = Figure(figsize=(10, 11), layout="constrained", dpi=110)
    figure.suptitle(title, fontsize=13)
    place, *axes = figure.subplots(4, 1, height_ratios=(2, 1, 1, 1))
    centre = np.array([at_distance(s, base_link_to_cg)[1:3] for s in log.drive.states])
    try:
        _along_chord(place, path_frame(log.path), centre, lanes)
    except ValueError:
        _map(place, np.column_stack((log.path.x, log.path.y)), centre)
    time = ticks(log.drive)
    error = errors(log.drive, log.path, base_link_to_cg)[:, 0]
    _over_time(axes[0], time, error, "cross-track error [m]")
    steering = np.degrees(log.drive.steering)
    _over_time(axes[1], time, steering, "steering command [deg]", step=True)
    speed = np.array([state.v_x for state in log.drive.states])
    label = f"target, {SPEED_PREVIEW:g} s ahead"
    axes[2].plot(*log.target_speed.T, **REFERENCE_STYLE, label=label)
    _over_time(axes[2], time, speed, "speed [m/s]", label="car")
    axes[2].set_ylim(0, 1.1 * max(speed.max(), log.target_speed[:, 1].max()))
    axes[2].set_xlabel("time [s]")
    axes[2].legend(loc="lower right")
    figure.savefig(file)


def _along_chord(ax: Axes, frame: PathFrame, centre: Array, lanes: Sequence[Lane]) -> None:
    """Draw offset over distance, where the path is a graph over its chord: any length is seen."""
    car = along_chord(frame, centre)
    low, high = car[:, 0].min(), car[:, 0].max()
    seen = np.clip(frame.X, low, high) == frame.X
    for lane in lanes:
        for y in (lane.right, lane.left):
            ends = along_chord(frame, np.array([[lane.start, y], [lane.end, y]]))
            ax.plot(*ends.T, color=ORANGE, label="cones" if lane is lanes[0] and y < 0 else None)
    _path_and_car(ax, np.column_stack((frame.X, frame.Y))[seen], car)
    bottom, top = ax.get_ylim()
    ax.set_ylim(min(bottom, -NARROWEST), max(top, NARROWEST))
    ax.margins(x=0.01)
    ax.set_xlabel("distance along the chord of the path [m]")
    ax.set_ylabel("offset to its left [m]")


def _map(ax: Axes, path: Array, centre: Array) -> None:
    """Draw a map with equal axes."""
    _path_and_car(ax, path, centre)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("x in map [m]")
    ax.set_ylabel("y in map [m]")


def _path_and_car(ax: Axes, path: Array, car: Array) -> None:
    ax.plot(*path.T, **REFERENCE_STYLE, label="reference")
    ax.plot(*car.T, color=BLUE, label="car (centre of gravity)")
    ax.plot(*car[0], "o", color=ORANGE, label="start")
    ax.grid(alpha=0.3)
    ax.legend(loc="best")


def _over_time(
    ax: Axes, time: Array, values: Array, name: str, *, step: bool = False, label: str = ""
) -> None:
    style = "steps-post" if step else "default"
    ax.plot(time, values, color=BLUE, drawstyle=style, label=label)
    ax.set_ylabel(name)
    ax.set_xlim(0, time[-1])
    ax.grid(alpha=0.3)
