"""Build `/tf` and `/tf_static` from odometry, so that a 3D viewer can place the car.

The ROS wheels lack tf2_msgs; the library rosbags serialises its messages.
"""

import math
from typing import Any

from ampc_msgs_config.recording.message_types import JAZZY

ODOMETRY = "nav_msgs/msg/Odometry"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
FOOTPRINT = "base_footprint"
"""Projection of the car onto the ground (REP-120). Our motion is planar: it is `base_link`."""

TfMessage, TransformStamped, Transform, Vector3, Quaternion, Header = (
    JAZZY.types[name]
    for name in (
        TF_MESSAGE,
        "geometry_msgs/msg/TransformStamped",
        "geometry_msgs/msg/Transform",
        "geometry_msgs/msg/Vector3",
        "geometry_msgs/msg/Quaternion",
        "std_msgs/msg/Header",
    )
)


def pose_transform(odometry: bytes) -> bytes | None:
    """Build the `/tf` message of a serialised odometry: its frame -> its child frame.

    Returns:
        A serialised tf2_msgs/TFMessage with the stamp, position and quaternion of the odometry, or
        None if they are not finite, the quaternion is zero, or a frame has no name.
    """
    message: Any = JAZZY.deserialize_cdr(odometry, ODOMETRY)
    p, q = message.pose.pose.position, message.pose.pose.orientation
    translation, rotation = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, translation + rotation)) or not any(rotation):
        return None
    if not message.header.frame_id or not message.child_frame_id:
        return None
    transform: Any = Transform(Vector3(*translation), Quaternion(*rotation))
    return serialized(message.header, message.child_frame_id, transform)


def footprint_transform(odometry: bytes) -> bytes:
    """Build the `/tf_static` message of a serialised odometry: its child frame -> FOOTPRINT."""
    message: Any = JAZZY.deserialize_cdr(odometry, ODOMETRY)
    transform: Any = Transform(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    header: Any = Header(message.header.stamp, message.child_frame_id)
    return serialized(header, FOOTPRINT, transform)


def serialized(header: Any, child: str, transform: Any) -> bytes:
    """Return one transform as a serialised tf2_msgs/TFMessage."""
    stamped = TransformStamped(header, child, transform)
    return bytes(JAZZY.serialize_cdr(TfMessage([stamped]), TF_MESSAGE))
