"""Subscriber of a running drive: newest values, rates and ages of its topics."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from ampc_msgs_config import topics
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.nodes.inputs import Inputs
from launch_scripts.watching.live_drive import HISTORY, LiveDrive, TopicState

RATE_WINDOW = 2.0
"""Wall time over which a rate is measured [s]."""
NEWEST_FIRST = (qos.NEWEST,)
WATCHED: dict[str, tuple[type, tuple[QoSProfile, ...]]] = {
    topics.ODOM: (Odometry, NEWEST_FIRST),
    topics.REFERENCE_PATH: (PathMessage, qos.ANY_PUBLISHER),
    topics.TARGET_SPEED: (TwistStamped, NEWEST_FIRST),
    topics.STEERING_COMMAND: (JointState, NEWEST_FIRST),
    topics.TICK: (JointState, NEWEST_FIRST),
    topics.GATE_STATE: (String, qos.ANY_PUBLISHER),
    topics.STOP_REQUEST: (Bool, qos.ANY_PUBLISHER),
}
"""Type and profiles of each topic."""


class DriveListener(Node):
    """Keeps the newest message of each topic, and the wall times of the last ones."""

    def __init__(self, namespace: str = "") -> None:
        """Subscribe to a drive in a namespace."""
        super().__init__("watch", namespace=namespace, enable_rosout=False)
        self.newest: dict[str, Any] = {}
        self.arrivals: dict[str, deque[float]] = {name: deque(maxlen=200) for name in WATCHED}
        self.histories: dict[str, deque[float]] = {
            name: deque(maxlen=HISTORY) for name in ("cross_track_error", "steering", "speed")
        }
        self.inputs = Inputs(self)
        for name, (kind, profiles) in WATCHED.items():
            self.inputs.add(kind, name, partial(self.keep, name), *profiles)

    def keep(self, name: str, message: Any) -> None:
        """Keep a message."""
        self.newest[name] = message
        self.arrivals[name].append(time.monotonic())

    def state(self) -> LiveDrive:
        """Return the present state, and append it to the histories."""
        tick = self.newest.get(topics.TICK)
        values = dict(zip(tick.name, tick.position, strict=False)) if tick else {}
        odom, target = self.newest.get(topics.ODOM), self.newest.get(topics.TARGET_SPEED)
        values["speed"] = odom.twist.twist.linear.x if odom else math.nan
        values["target_speed"] = target.twist.linear.x if target else math.nan
        command = self.newest.get(topics.STEERING_COMMAND)
        if "steering" not in values and command and command.position:
            values["steering"] = command.position[0]
        for name, history in self.histories.items():
            if math.isfinite(value := values.get(name, math.nan)):
                history.append(value)
        gate, stop = self.newest.get(topics.GATE_STATE), self.newest.get(topics.STOP_REQUEST)
        return LiveDrive(
            self.get_namespace(),
            values,
            gate.data if gate else "",
            bool(stop.data) if stop else None,
            [self.topic_state(name) for name in WATCHED],
            {name: list(history) for name, history in self.histories.items()},
            self.inputs.mismatches(),
        )

    def topic_state(self, name: str) -> TopicState:
        """Return rate and age of a topic."""
        now, times = time.monotonic(), self.arrivals[name]
        recent = [each for each in times if now - each <= RATE_WINDOW]
        rate = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 2 else math.nan
        full = self.resolve_topic_name(name)
        return TopicState(
            full, self.count_publishers(full), rate, now - times[-1] if times else math.nan
        )


@contextmanager
def open_listener(namespace: str) -> Iterator[Callable[[float], LiveDrive]]:
    """Join ROS; yield a function that listens for a wall time [s] and returns the state."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node, executor = DriveListener(namespace), SingleThreadedExecutor()
    executor.add_node(node)

    def listen(duration: float) -> LiveDrive:
        until = time.monotonic() + duration
        while (rest := until - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=rest)
        return node.state()

    try:
        yield listen
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
