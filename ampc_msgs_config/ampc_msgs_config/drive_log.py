"""A drive as its bag tells it."""

from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.bag import read
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.path import Array, make_path
from ampc_msgs_config.path import Path as ReferencePath
from ampc_msgs_config.types import NANOSECONDS, VehicleState


class DriveLog(NamedTuple):
    """What a bag holds of a drive."""

    drive: Drive
    """Every state that was answered by a command."""
    path: ReferencePath
    """The last reference that was published."""
    target_speed: Array
    """(n, 2) time since the first command [s], target speed [m/s]."""


def read_drive(bag: File) -> DriveLog:
    """Read a drive from a bag; the topics may stand in any namespace.

    Raises:
        ValueError: Names the bag and what it lacks.
    """
    topics: dict[str, list[Any]] = {
        name: [] for name in (ros.ODOM, ros.STEERING_COMMAND, ros.TARGET_SPEED,
                              ros.REFERENCE_PATH, "debug/solve_time")
    }
    for entry in read(bag):
        for name in topics:
            if entry.topic.endswith("/" + name):
                topics[name].append(entry.message)
    for name, messages in topics.items():
        if not messages:
            raise ValueError(f"{bag}: holds no message on {name}")
    drive = _drive(bag, topics)
    start_ns = drive.states[0].stamp_ns
    speeds = [ros.target_speed(message) for message in topics[ros.TARGET_SPEED]]
    path = make_path(ros.path_points(topics[ros.REFERENCE_PATH][-1]))
    target = [((s.stamp_ns - start_ns) / NANOSECONDS, s.value) for s in speeds]
    return DriveLog(drive, path, np.array(target))


def _drive(bag: File, topics: dict[str, list[Any]]) -> Drive:
    states: dict[int, VehicleState] = {}
    for message in topics[ros.ODOM]:
        state = ros.vehicle_state(message)
        states[state.stamp_ns] = state
    commands = dict(ros.steering_angle(message) for message in topics[ros.STEERING_COMMAND])
    stamps = sorted(stamp for stamp in commands if stamp in states)
    if len(stamps) < 2:
        raise ValueError(f"{bag}: {len(stamps)} commands answer a recorded state, 2 are needed")
    return Drive(
        [states[stamp] for stamp in stamps],
        np.array([commands[stamp] for stamp in stamps]),
        np.array([message.data for message in topics["debug/solve_time"]]),
    )
