"""Message types: that of each topic, and what a bag states about a type."""

import importlib
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ampc_msgs_config import topics

TOPIC_TYPES = {
    topics.CLOCK: "rosgraph_msgs/msg/Clock",
    topics.ODOM: "nav_msgs/msg/Odometry",
    topics.REFERENCE_PATH: "nav_msgs/msg/Path",
    topics.TARGET_SPEED: "geometry_msgs/msg/TwistStamped",
    topics.STEERING_COMMAND: "sensor_msgs/msg/JointState",
    topics.STEERING_PLAN: "trajectory_msgs/msg/JointTrajectory",
    topics.STEERING_STATE: "sensor_msgs/msg/JointState",
    topics.PREDICTED_PATH: "nav_msgs/msg/Path",
    topics.WIND: "geometry_msgs/msg/Vector3Stamped",
    topics.STOP_REQUEST: "std_msgs/msg/Bool",
    topics.DRIVE_COMMAND: "geometry_msgs/msg/TwistStamped",
    topics.GATE_STEERING: "sensor_msgs/msg/JointState",
    topics.GATE_SPEED: "geometry_msgs/msg/TwistStamped",
    topics.GATE_STATE: "std_msgs/msg/String",
    topics.GATE_HEARTBEAT: "std_msgs/msg/UInt64",
    topics.TICK: "sensor_msgs/msg/JointState",
    topics.MEMORY: "std_msgs/msg/UInt8MultiArray",
    topics.MARKERS: "visualization_msgs/msg/MarkerArray",
    topics.DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    topics.PARAMETER_EVENTS: "rcl_interfaces/msg/ParameterEvent",
    topics.ROSOUT: "rcl_interfaces/msg/Log",
    **dict.fromkeys(topics.CONFIGURATIONS, "std_msgs/msg/String"),
    **dict.fromkeys(topics.QUANTITIES, "std_msgs/msg/Float64"),
}
"""Message type of each topic of the contract."""


class Definition(NamedTuple):
    """Definition of a message type, enough for a reader that does not know the type."""

    text: str
    """The `.msg` text, followed by those of all types inside it."""
    type_hash: str
    """ROS type hash, `RIHS01_...`."""


@cache
def jazzy() -> Any:
    """Return the message types of ROS 2 Jazzy, installed or not; `define` adds others."""
    from rosbags.typesys import Stores, get_typestore  # loads the types of all distributions

    return get_typestore(Stores.ROS2_JAZZY)


@cache
def message_class(type_name: str) -> Any:
    """Return the Python class of a message type, such as `nav_msgs/msg/Odometry`.

    Raises:
        ValueError: The type is not installed.
    """
    try:
        package, _, name = type_name.split("/")
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{type_name}: this message type is not installed") from error


def type_name_of(message_class: Any) -> str:
    """Return the name of a message class, such as `nav_msgs/msg/Odometry`."""
    return f"{message_class.__module__.split('.')[0]}/msg/{message_class.__name__}"


@cache
def define(type_name: str) -> Definition:
    """Return the definition of a message type that is installed, or that belongs to ROS 2 Jazzy.

    Raises:
        ValueError: The type is neither.
    """
    if type_name not in jazzy().fielddefs:
        try:
            jazzy().register(read_definitions(type_name))
        except (ImportError, OSError, ValueError) as error:
            raise ValueError(f"{type_name}: this message type is not installed: {error}") from error
    text, _ = jazzy().generate_msgdef(type_name, ros_version=2)
    return Definition(text, jazzy().hash_rihs01(type_name))


def read_definitions(type_name: str) -> dict[str, Any]:
    """Return the parsed `.msg` files of a type and of the types inside it that `jazzy` lacks."""
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import get_types_from_msg

    package, _, name = type_name.split("/")
    # The files are beside the Python package, in <prefix>/share.
    module = Path(str(importlib.import_module(package).__file__))
    candidates = [parent / "share" / package / "msg" / f"{name}.msg" for parent in module.parents]
    file = next((file for file in candidates if file.is_file()), candidates[-1])
    types = dict(get_types_from_msg(file.read_text(encoding="utf-8"), type_name))
    kind: Any
    content: Any
    for _, (kind, content) in types[type_name][1]:
        while kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            kind, content = content[0]
        if kind is Nodetype.NAME and content not in jazzy().fielddefs:
            types |= read_definitions(content)
    return types
