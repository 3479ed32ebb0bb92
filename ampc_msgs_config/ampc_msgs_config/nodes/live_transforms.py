"""Broadcast of the pose of the car on `/tf`, where tf2_msgs is installed; the wheels lack it."""

import math
from typing import Any

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

from ampc_msgs_config.nodes import qos
from ampc_msgs_config.recording.message_types import message_class
from ampc_msgs_config.recording.transforms import TF_MESSAGE, prefixed
from ampc_msgs_config.topics import TF

BROADCASTER = "markers"
"""Name of the node that broadcasts the pose of the car."""


class LiveTransforms:
    """Broadcaster of the pose of one car, while somebody subscribes and nobody else publishes."""

    def __init__(self, node: Node, prefix: str) -> None:
        """Create the publisher, or log in one line that the message type is missing.

        Args:
            node: Owner.
            prefix: Prefix of the frame of the car.
        """
        self.node, self.prefix = node, prefix
        self.is_wanted = False
        self.publisher: Any = None
        try:
            self.message_class = message_class(TF_MESSAGE)
        except ValueError:
            node.get_logger().info(f"{TF} is not published: tf2_msgs is not installed")
            return
        self.publisher = node.create_publisher(self.message_class, TF, qos.RELIABLE)

    def look(self) -> None:
        """Update `is_wanted`."""
        self.is_wanted = (
            self.publisher is not None
            and self.publisher.get_subscription_count() > 0
            and not has_other_broadcaster(self.node)
        )

    def send(self, odometry: Odometry) -> None:
        """Broadcast the pose of a valid odometry."""
        if self.is_wanted and (transform := transform_of(odometry, self.prefix)):
            self.publisher.publish(self.message_class(transforms=[transform]))


def has_other_broadcaster(node: Node) -> bool:
    """Return whether a node other than the markers of a car publishes `/tf`."""
    publishers = node.get_publishers_info_by_topic(node.resolve_topic_name(TF))
    return any(each.node_name != BROADCASTER for each in publishers)


def transform_of(odometry: Odometry, prefix: str) -> TransformStamped | None:
    """Return the transform from the frame of an odometry to its child frame.

    Returns:
        None where the pose is not finite, the quaternion is zero, or a frame has no name.
    """
    at, turned = odometry.pose.pose.position, odometry.pose.pose.orientation
    rotation = turned.x, turned.y, turned.z, turned.w
    names = odometry.header.frame_id, odometry.child_frame_id
    if not (
        all(map(math.isfinite, (at.x, at.y, at.z, *rotation))) and any(rotation) and all(names)
    ):
        return None
    message = TransformStamped(header=odometry.header)
    message.child_frame_id = prefixed(odometry.child_frame_id, prefix)
    place = message.transform.translation
    place.x, place.y, place.z = at.x, at.y, at.z
    message.transform.rotation = turned
    return message
