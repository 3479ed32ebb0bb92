"""`/tf` and `/tf_static` as odometry implies them: where a 3D viewer has to draw the car.

tf2_msgs does not come with the ROS wheels, so its messages are serialised by the library rosbags.
"""

import math
from typing import Any

from ampc_msgs_config.recording.message_types import JAZZY

ODOMETRY = "nav_msgs/msg/Odometry"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
FOOTPRINT = "base_footprint"
"""The car's place on the ground, as REP-120 names it. Our motion is planar: it is `base_link`."""

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
    """Give the `/tf` message of a serialised odometry: its frame -> its child frame.

    Returns:
        A serialised tf2_msgs/TFMessage with the stamp, position and quaternion of the odometry,
        or None where they are no place: not finite, a quaternion of zeros, or a frame without name.
    """
    message: Any = JAZZY.deserialize_cdr(odometry, ODOMETRY)
    p, q = message.pose.pose.position, message.pose.pose.orientation
    translation, rotation = (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)
    if not all(map(math.isfinite, translation + rotation)) or not any(rotation):
        return None
    if not message.header.frame_id or not message.child_frame_id:
        return None
    place: Any = Transform(Vector3(*translation), Quaternion(*rotation))
    return serialized(message.header, message.child_frame_id, place)


def footprint_transform(odometry: bytes) -> bytes:
    """Give the `/tf_static` message of a serialised odometry: its child frame -> FOOTPRINT."""
    message: Any = JAZZY.deserialize_cdr(odometry, ODOMETRY)
    place: Any = Transform(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    header: Any = Header(message.header.stamp, message.child_frame_id)
    return serialized(header, FOOTPRINT, place)


def serialized(header: Any, child: str, place: Any) -> bytes:
    """Give one transform as a serialised tf2_msgs/TFMessage."""
    transform = TransformStamped(header, child, place)
    return bytes(JAZZY.serialize_cdr(TfMessage([transform]), TF_MESSAGE))
