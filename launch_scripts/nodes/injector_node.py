"""Node `injector`: applies a schedule of faults to the inputs of the controller.

`python launch_scripts/start.py --faults FILE` starts it and remaps the inputs of the controller to
its topics `faulty/odom`, `faulty/steering_state` and `faulty/reference_path`. All other nodes,
including the recorder, receive the original messages. Fault times count from the first steering
command.
"""

import sys
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.config import find, shipped_or_file
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import NANOSECONDS
from ampc_msgs_config.vehicle_file import load_section
from launch_scripts.faults.messages import ODOM_INPUT, PATH, STEERING_INPUT, Message
from launch_scripts.faults.schedule import Injector, load_faults

CHECK_PERIOD = 0.005
"""Period of the check for delayed messages [s]."""
PATH_PERIOD = 0.5
"""Period of republishing the path [s]. The planner sends it once, too rarely to fail."""
INPUT_TYPES = {
    ODOM_INPUT: (Odometry, ros.RELIABLE),
    STEERING_INPUT: (JointState, ros.RELIABLE),
    PATH: (PathMessage, ros.LATCHED),
}
"""Type and QoS of the topics that faults change."""


class InjectorNode(BaseNode):
    """Forwards messages to the controller, changed by the active faults."""

    def __init__(self) -> None:
        """Load the schedule and create publishers, subscriptions and timers.

        Raises:
            ValueError: The schedule is invalid, or needs a clock that a node cannot change.
        """
        super().__init__("injector")
        allowed = shipped_or_file("faults")
        schedule = load_faults(declare(self, "faults", "example", "faults to inject", allowed))
        if self.lock_step:
            raise ValueError("faults need real time: lock_step must be false")
        if any(fault.kind == "clock_jump" for fault in schedule.faults):
            raise ValueError(
                "faults: kind = clock_jump works only in the offline fault matrix; use stamp_jump"
            )
        allowed = shipped_or_file("vehicles")
        file = find("vehicles", declare(self, "vehicle", "paper", "car", allowed))
        self.steering = load_section(SteeringParameters, file, "steering", "the node injector")
        self.injector = Injector(schedule)
        self.start_ns = -1
        self.qp_fails = False
        self.path: PathMessage | None = None
        self.outputs: dict[str, Any] = {}
        for topic, (kind, qos) in INPUT_TYPES.items():
            self.outputs[topic] = self.create_publisher(kind, ros.FAULTY + topic, qos)
            self.create_subscription(kind, topic, partial(self.on_message, topic), qos)
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.on_command, ros.COMMAND)
        self.controller = AsyncParameterClient(self, "controller")
        self.create_timer(CHECK_PERIOD, self.on_timer)
        self.create_timer(PATH_PERIOD, self.on_path_timer)
        self.create_timer(1.0, self.on_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"ready: {len(schedule.faults)} faults")

    @property
    def since_ns(self) -> int:
        """Time since the first command [ns]; negative before it, so that no fault is active."""
        return self.now_ns - self.start_ns if self.start_ns >= 0 else -NANOSECONDS

    def on_command(self, _: JointState) -> None:
        """Start the fault schedule with the first command."""
        if self.start_ns < 0:
            self.start_ns = self.now_ns
            self.get_logger().info("drive started: fault times count from now")

    def on_message(self, topic: str, message: Any) -> None:
        """Pass a message to the injector; reject it if it is already invalid."""
        if topic == PATH:
            self.path = message
        try:
            self.injector.put(unpack(topic, message, self.since_ns, self.steering))
        except ValueError as error:
            self.reject(error)
        self.on_timer()

    def on_path_timer(self) -> None:
        """Republish the path with a new stamp."""
        if self.path is not None:
            self.path.header.stamp = ros.time_message(self.now_ns)
            self.on_message(PATH, self.path)

    def on_timer(self) -> None:
        """Publish the messages that are due, and switch the QP fault of the controller."""
        for message in self.injector.due(self.since_ns):
            self.outputs[message.topic].publish(pack(message, self.steering))
        fails = self.injector.is_on("qp_fault", self.since_ns)
        if fails != self.qp_fails and self.controller.services_are_ready():
            self.qp_fails = fails
            self.controller.set_parameters([Parameter("qp_fault", value=fails)])

    def on_diagnostics(self) -> None:
        """Report the active faults."""
        active = [each.kind for each in self.injector.active(self.since_ns)]
        self.report(self.now_ns, f"injected: {', '.join(active)}" if active else "", {})


def unpack(topic: str, message: Any, arrival_ns: int, steering: SteeringParameters) -> Message:
    """Unpack a ROS message that arrives now.

    Args:
        topic: Name of its topic.
        message: Message.
        arrival_ns: Time of arrival [ns].
        steering: Ratio and offset of the steering topics.

    Raises:
        ValueError: The message is invalid without any fault.
    """
    stamp_ns, frame_id = ros.nanoseconds(message.header.stamp), message.header.frame_id
    if topic == ODOM_INPUT:
        return Message(topic, arrival_ns, stamp_ns, ros.vehicle_state(message), frame_id)
    if topic == PATH:
        return Message(topic, arrival_ns, stamp_ns, np.array(ros.path_points(message)), frame_id)
    return Message(topic, arrival_ns, stamp_ns, ros.steering_angle(message, steering).value)


def pack(message: Message, steering: SteeringParameters) -> Any:
    """Pack a message for the controller; a path may have no or a single point."""
    stamp_ns, value = message.stamp_ns, message.value
    if message.topic == STEERING_INPUT:
        return ros.joint_message(stamp_ns, value, 0.0, steering)
    if message.topic == ODOM_INPUT:
        result = ros.odometry_message(value._replace(stamp_ns=stamp_ns))
        orientation = result.pose.pose.orientation
        orientation.z, orientation.w = (
            orientation.z * message.length,
            orientation.w * message.length,
        )
    elif len(value) > 1:
        result = ros.path_message(value, stamp_ns)
    else:
        result = PathMessage(poses=[PoseStamped() for _ in value])
        result.header.stamp = ros.time_message(stamp_ns)
        for pose, (x, y) in zip(result.poses, value.tolist(), strict=True):
            pose.pose.position.x, pose.pose.position.y = x, y
    result.header.frame_id = message.frame_id
    return result


def main() -> int:
    """Run the node."""
    return spin(InjectorNode)


if __name__ == "__main__":
    sys.exit(main())
