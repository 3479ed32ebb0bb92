"""The fixed frame that path and odometry share, and the transform of paths from other frames."""

import importlib
from typing import Any

from rclpy.node import Node
from rclpy.time import Time

from ampc_msgs_config.quaternions import yaw_of
from ampc_ros.nodes.received_path import Shift

FRAME = "name of a frame; empty: that of the first odom"
"""Values of the parameter `fixed_frame`."""
REMEDY = "publish both in one frame, or install tf2_ros and publish the transform"


class FixedFrame:
    """Frame of the states: that of the parameter `fixed_frame`, or of the first odometry."""

    def __init__(self, node: Node, name: str) -> None:
        """Use a frame.

        Args:
            node: Node that listens to transforms where they are needed.
            name: Parameter `fixed_frame`; empty: the frame of the first odometry.
        """
        self.node = node
        self.name = name
        """Empty before the first odometry, where the parameter is empty."""
        self.origin = "the parameter fixed_frame" if name else "the frame of the first odom"
        self._buffer: Any = None

    def accept(self, frame_id: str) -> None:
        """Check the frame of odometry; the first one becomes the fixed frame.

        Raises:
            ValueError: It is another one; with both and a remedy.
        """
        if not self.name:
            self.name = frame_id
        if frame_id != self.name:
            raise ValueError(
                f"odom: header.frame_id = {frame_id!r} must be {self.name!r}, {self.origin}; set "
                f"the parameter fixed_frame to the frame of odom and restart the controller"
            )

    def shift(self, frame_id: str, stamp_ns: int) -> Shift:
        """Return the transform of a path into the fixed frame.

        Args:
            frame_id: Frame of the path.
            stamp_ns: Time of the transform; 0: the newest one [ns].

        Raises:
            ValueError: There is no transform; with both frames and a remedy.
        """
        if frame_id == self.name or not self.name:
            return Shift()
        problem = (
            f"reference_path: header.frame_id = {frame_id!r} differs from {self.name!r}, "
            f"{self.origin}"
        )
        try:
            tf2_ros = importlib.import_module("tf2_ros")
        except ImportError:
            raise ValueError(f"{problem}: {REMEDY}") from None
        if self._buffer is None:
            self._buffer = tf2_ros.Buffer()
            self._listener = tf2_ros.TransformListener(self._buffer, self.node)
        try:
            time = Time(nanoseconds=stamp_ns)
            transform = self._buffer.lookup_transform(self.name, frame_id, time).transform
        except tf2_ros.TransformException as error:
            raise ValueError(f"{problem}, and there is no transform: {error}") from error
        at, q = transform.translation, transform.rotation
        return Shift(at.x, at.y, yaw_of(q.x, q.y, q.z, q.w))
