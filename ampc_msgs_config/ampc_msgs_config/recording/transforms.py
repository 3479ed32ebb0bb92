"""Build `/tf` and `/tf_static` from odometry, so that a 3D viewer can place the car.

The ROS wheels lack tf2_msgs; the library rosbags serialises its messages.
"""

import math
from typing import Any

from ampc_msgs_config.recording.message_types import jazzy

ODOMETRY = "nav_msgs/msg/Odometry"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
FOOTPRINT = "base_footprint"
"""Projection of the car onto the ground (REP-120). Our motion is planar: it is `base_link`."""


def prefixed(frame: str, prefix: str) -> str:
    """Return a frame of the car with its prefix, such as `car1/base_link`, once."""
    return frame if not frame or frame.startswith(prefix) else prefix + frame


def prefix_of(parameter: str, namespace: str) -> str:
    """Return the prefix of the frames of a car.

    Args:
        parameter: Value of `frame_prefix`; empty: the namespace.
        namespace: Namespace of the node, such as `/car1`.
    """
    return parameter or (f"{namespace.strip('/')}/" if namespace.strip("/") else "")


def pose_transform(odometry: bytes, prefix: str = "") -> bytes | None:
    """Build the `/tf` message of a serialised odometry: its frame -> its child frame.

    Args:
        odometry: Serialised nav_msgs/Odometry.
        prefix: Prefix of the child frame.

    Returns:
        A serialised tf2_msgs/TFMessage with the stamp, position and quaternion of the odometry, or
        None if they are not finite, the quaternion is zero, or a frame has no name.
    """
    message: Any = jazzy().deserialize_cdr(odometry, ODOMETRY)
    at, turned = message.pose.pose.position, message.pose.pose.orientation
    pose = at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w
    names = message.header.frame_id, message.child_frame_id
    if not (all(map(math.isfinite, pose)) and any(pose[3:]) and all(names)):
        return None
    return transform_message(message.header, prefixed(message.child_frame_id, prefix), pose)


def footprint_transform(odometry: bytes, prefix: str = "") -> bytes:
    """Build the `/tf_static` message of a serialised odometry: its child frame -> FOOTPRINT."""
    message: Any = jazzy().deserialize_cdr(odometry, ODOMETRY)
    frame = prefixed(message.child_frame_id, prefix)
    header = build_message("std_msgs/msg/Header", message.header.stamp, frame)
    return transform_message(header, prefix + FOOTPRINT, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


def transform_message(header: Any, child: str, pose: tuple[float, ...]) -> bytes:
    """Return position and quaternion as a serialised tf2_msgs/TFMessage."""
    translation = build_message("geometry_msgs/msg/Vector3", *pose[:3])
    rotation = build_message("geometry_msgs/msg/Quaternion", *pose[3:])
    transform = build_message("geometry_msgs/msg/Transform", translation, rotation)
    stamped = build_message("geometry_msgs/msg/TransformStamped", header, child, transform)
    return bytes(jazzy().serialize_cdr(build_message(TF_MESSAGE, [stamped]), TF_MESSAGE))


def build_message(type_name: str, *fields: Any) -> Any:
    """Return a message of ROS 2 Jazzy, whose type need not be installed."""
    return jazzy().types[type_name](*fields)
