"""A drive as its bag tells it."""

from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.bag import read
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.path import Array
from ampc_msgs_config.path import Path as ReferencePath
from ampc_msgs_config.path_making import make_path
from ampc_msgs_config.types import NANOSECONDS, VehicleState

SOLVE_TIME = "controller/debug/solve_time"
NEEDED = (ros.ODOM, ros.STEERING_COMMAND, ros.TARGET_SPEED, ros.REFERENCE_PATH, SOLVE_TIME)


class DriveLog(NamedTuple):
    """What a bag holds of a drive."""

    drive: Drive
    """Every state that was answered by a command."""
    path: ReferencePath
    """The last reference that was published."""
    target_speed: Array
    """(n, 2) time since the first command [s], target speed [m/s]."""


def read_drive(bag: File, namespace: str | None = None) -> DriveLog:
    """Read a drive from a bag.

    Args:
        bag: Folder of the bag, or one MCAP file.
        namespace: Where the topics stand, such as `/car1`; by default where steering begins.

    Raises:
        ValueError: Names the bag and what it lacks.
    """
    prefix = _steered_namespace(bag) if namespace is None else namespace.rstrip("/")
    topics: dict[str, list[Any]] = {f"{prefix}/{name}": [] for name in NEEDED}
    for entry in read(bag, topics):
        topics[entry.topic].append(entry.message)
    for topic, messages in topics.items():
        if not messages:
            raise ValueError(f"{bag}: holds no message on {topic}")
    odom, commands, speeds, paths, solve_times = topics.values()
    states, steering = _answered(bag, odom, commands)
    drive = Drive(states, steering, np.array([message.data for message in solve_times]))
    return DriveLog(
        drive,
        make_path(ros.path_points(paths[-1])),
        _since(states[0].stamp_ns, [ros.target_speed(message) for message in speeds]),
    )


def _steered_namespace(bag: File) -> str:
    for entry in read(bag):
        if entry.topic.endswith(f"/{ros.STEERING_COMMAND}"):
            return entry.topic.removesuffix(f"/{ros.STEERING_COMMAND}")
    raise ValueError(f"{bag}: holds no message on {ros.STEERING_COMMAND}")


def _answered(bag: File, odom: list[Any], commands: list[Any]) -> tuple[list[VehicleState], Array]:
    """States that a command answers, in their order, and the commanded angles (n,) [rad]."""
    angles = dict(ros.steering_angle(message) for message in commands)
    states = {state.stamp_ns: state for state in map(ros.vehicle_state, odom)}
    stamps = sorted(angles.keys() & states.keys())
    if len(stamps) < 2:
        raise ValueError(f"{bag}: {len(stamps)} commands answer a recorded state, 2 are needed")
    return [states[stamp] for stamp in stamps], np.array([angles[stamp] for stamp in stamps])


def _since(start_ns: int, values: list[ros.Stamped]) -> Array:
    return np.array([((each.stamp_ns - start_ns) / NANOSECONDS, each.value) for each in values])
