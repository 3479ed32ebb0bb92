"""A drive as its bag tells it."""

from pathlib import Path as File
from typing import NamedTuple

import numpy as np

from ampc_msgs_config import ros
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.paths.path import Path as ReferencePath
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from launch_scripts.bags.bag_columns import BagColumns, read_columns

SOLVE_TIME = "solve_time"
NEEDED = (ros.STEERING_COMMAND, ros.TARGET_SPEED, ros.REFERENCE_PATH)


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
    return drive_log(read_columns(bag, namespace))


def drive_log(columns: BagColumns) -> DriveLog:
    """Give the drive that a bag holds.

    Raises:
        ValueError: Names the bag and what it lacks.
    """
    bag, namespace, values = columns.bag, columns.namespace, columns.values
    for topic in NEEDED:
        if topic not in values:
            raise ValueError(f"{bag}: holds no message on {namespace}/{topic}")
    if SOLVE_TIME not in columns.tick:
        raise ValueError(f"{bag}: holds no message on {namespace}/controller/debug/{SOLVE_TIME}")
    odom, steering = answered(values[ros.ODOM], values[ros.STEERING_COMMAND])
    if len(odom) < 2:
        raise ValueError(f"{bag}: {len(odom)} commands answer a recorded state, 2 are needed")
    drive = Drive(
        states_of(odom, columns.start_ns), steering, columns.tick[SOLVE_TIME][:, 1].copy()
    )
    return DriveLog(drive, make_path(columns.paths[-1].points), values[ros.TARGET_SPEED])


def answered(odom: Array, commands: Array) -> tuple[Array, Array]:
    """Give the states (n, 7) that a command answers, by its stamp, and its angle (n,) [rad]."""
    _, state, last = np.intersect1d(odom[:, 0], commands[::-1, 0], return_indices=True)
    return odom[state], commands[::-1][last, 1]


def states_of(odom: Array, start_ns: int) -> list[VehicleState]:
    """Give rows of time since `start_ns` [s] and state (n, 7) as states."""
    return [
        VehicleState(start_ns + round(time * NANOSECONDS), *state) for time, *state in odom.tolist()
    ]
