"""Drive of a bag: the states that a command answers, reference path and target speed."""

from typing import NamedTuple

from ampc_msgs_config import topics
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.paths.path import Path as ReferencePath
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array
from launch_scripts.bags.bag_columns import BagColumns, answered, states_of

SOLVE_TIME = "solve_time"
NEEDED = (topics.STEERING_COMMAND, topics.TARGET_SPEED, topics.REFERENCE_PATH)


class DriveLog(NamedTuple):
    """Drive of a bag."""

    drive: Drive
    """All states that a command answers."""
    path: ReferencePath
    """The last reference path that was published."""
    target_speed: Array
    """(n, 2) time since the first command [s], target speed [m/s]."""


def drive_log(columns: BagColumns) -> DriveLog:
    """Return the drive of a bag.

    Raises:
        ValueError: Names the bag and the missing topic.
    """
    bag, namespace, values = columns.bag, columns.namespace, columns.values
    for topic in NEEDED:
        if topic not in values:
            raise ValueError(f"{bag}: holds no message on {namespace}/{topic}")
    if SOLVE_TIME not in columns.tick:
        raise ValueError(f"{bag}: holds no message on {namespace}/controller/debug/{SOLVE_TIME}")
    odom, steering = answered(values[topics.ODOM], values[topics.STEERING_COMMAND])
    if len(odom) < 2:
        raise ValueError(f"{bag}: {len(odom)} commands answer a recorded state, 2 are needed")
    drive = Drive(
        states_of(odom, columns.start_ns), steering, columns.tick[SOLVE_TIME][:, 1].copy()
    )
    return DriveLog(drive, make_path(columns.paths[-1].points), values[topics.TARGET_SPEED])
