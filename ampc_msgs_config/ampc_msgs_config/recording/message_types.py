"""The message type of each topic, and what is known about a type, given by its name."""

import importlib
import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_typestore

from ampc_msgs_config import topics

TYPES = {
    topics.CLOCK: "rosgraph_msgs/msg/Clock",
    topics.ODOM: "nav_msgs/msg/Odometry",
    topics.REFERENCE_PATH: "nav_msgs/msg/Path",
    topics.TARGET_SPEED: "geometry_msgs/msg/TwistStamped",
    topics.STEERING_COMMAND: "sensor_msgs/msg/JointState",
    topics.STEERING_STATE: "sensor_msgs/msg/JointState",
    topics.PREDICTED_PATH: "nav_msgs/msg/Path",
    topics.WIND: "geometry_msgs/msg/Vector3Stamped",
    topics.STOP_REQUEST: "std_msgs/msg/Bool",
    topics.TICK: "sensor_msgs/msg/JointState",
    topics.MARKERS: "visualization_msgs/msg/MarkerArray",
    topics.DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    topics.PARAMETER_EVENTS: "rcl_interfaces/msg/ParameterEvent",
    topics.ROSOUT: "rcl_interfaces/msg/Log",
    **dict.fromkeys(topics.CONFIGURATIONS, "std_msgs/msg/String"),
    **dict.fromkeys(topics.QUANTITIES, "std_msgs/msg/Float64"),
}
"""Message type of each topic of the contract."""
JAZZY = get_typestore(Stores.ROS2_JAZZY)
"""The message types that come with ROS 2 Jazzy, whether they are installed or not."""
SEPARATOR = "\n" + "=" * 80 + "\nMSG: {}\n"


class Definition(NamedTuple):
    """What a reader needs to understand a message type that it does not know."""

    text: str
    """The `.msg` text, followed by those of all types inside it."""
    type_hash: str
    """ROS type hash, `RIHS01_...`."""


def message_class(type_name: str) -> Any:
    """Give the Python class of a message type, such as `nav_msgs/msg/Odometry`.

    Raises:
        ValueError: The type is not installed.
    """
    try:
        package, _, name = type_name.split("/")
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{type_name}: this message type is not installed") from error


def type_name_of(message: Any) -> str:
    """Give the name of a message class, such as `nav_msgs/msg/Odometry`."""
    return f"{message.__module__.split('.')[0]}/msg/{message.__name__}"


@cache
def define(type_name: str) -> Definition:
    """Give the definition of a message type that is installed, or that comes with ROS 2 Jazzy.

    Args:
        type_name: Such as `nav_msgs/msg/Odometry`.

    Raises:
        ValueError: The type is neither.
    """
    try:
        description = json.loads(share(type_name).with_suffix(".json").read_text(encoding="utf-8"))
        hashes = {item["type_name"]: item["hash_string"] for item in description["type_hashes"]}
        text = share(type_name).read_text(encoding="utf-8")
        for inner in sorted(hashes.keys() - {type_name}):
            text += SEPARATOR.format(inner.replace("/msg/", "/"))
            text += share(inner).read_text(encoding="utf-8")
    except (ImportError, OSError, ValueError) as error:
        if type_name in JAZZY.fielddefs:
            text, _ = JAZZY.generate_msgdef(type_name, ros_version=2)
            return Definition(text, JAZZY.hash_rihs01(type_name))
        raise ValueError(f"{type_name}: this message type is not installed: {error}") from error
    return Definition(text, hashes[type_name])


def share(type_name: str) -> Path:
    """Give the `.msg` file of a type, which lies beside its Python package in `<prefix>/share`."""
    package, _, name = type_name.split("/")
    module = Path(str(importlib.import_module(package).__file__))
    files = [parent / "share" / package / "msg" / f"{name}.msg" for parent in module.parents]
    return next((file for file in files if file.is_file()), files[-1])
