"""Progress of a running drive, from its odometry."""

import time
from typing import Any

import rclpy
from nav_msgs.msg import Odometry
from rclpy.signals import SignalHandlerOptions

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS


class DriveWatch:
    """Subscriber of `odom`; a context manager."""

    def __init__(self, namespace: str = "") -> None:
        """Store the namespace of the drive."""
        self.namespace = namespace

    def __enter__(self) -> "DriveWatch":
        """Create the node; signal handlers of the caller remain."""
        self.elapsed = self.speed = 0.0
        self.start_ns: int | None = None
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("start", namespace=self.namespace)
        self.node.create_subscription(Odometry, ros.ODOM, self.on_odometry, ros.NEWEST)
        return self

    def __exit__(self, *_: Any) -> None:
        """Destroy the node."""
        self.node.destroy_node()
        rclpy.try_shutdown()

    @property
    def has_begun(self) -> bool:
        """Whether a state has arrived."""
        return self.start_ns is not None

    def look(self, wall_time: float) -> None:
        """Wait for a time [s], then read the newest state; the first state ends the wait."""
        if self.has_begun:
            time.sleep(wall_time)
            wall_time = 0.0
        rclpy.spin_once(self.node, timeout_sec=wall_time)

    def on_odometry(self, message: Odometry) -> None:
        """Store time since the start [s] and speed [m/s]."""
        stamp_ns = ros.nanoseconds(message.header.stamp)
        if self.start_ns is None:
            self.start_ns = stamp_ns
        self.elapsed = (stamp_ns - self.start_ns) / NANOSECONDS
        self.speed = message.twist.twist.linear.x
