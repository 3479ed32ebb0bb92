"""Node `injector`: stands between simulator and controller and spoils what the controller gets.

`python launch_scripts/start.py --faults FILE` starts it, with the controller's inputs renamed to
what it publishes: `faulty/odom`, `faulty/steering_state`, `faulty/reference_path`. All others, the
recorder among them, see the car as it is. Faults begin to count with the first steering command.
"""

import sys
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.types import NANOSECONDS
from launch_scripts.faults.messages import ODOM, PATH, STEERING, Message
from launch_scripts.faults.schedule import Injector, load_plan

PERIOD = 0.005
"""From one look at what is late to the next [s]."""
PATH_PERIOD = 0.5
"""The path, which our planner publishes once, comes anew: else it could not fail on the way [s]."""
TYPES = {ODOM: Odometry, STEERING: JointState, PATH: PathMessage}


class InjectorNode(BaseNode):
    """Passes messages on as a plan of faults lets them."""

    def __init__(self) -> None:
        """Read the plan, and join the line.

        Raises:
            ValueError: The plan is wrong, or asks for what a node cannot do.
        """
        super().__init__("injector")
        plan = load_plan(declare(self, "faults", "example", "shipped faults, or YAML file"))
        if self.lock_step:
            raise ValueError("faults need real time: lock_step must be false")
        if any(fault.kind == "clock_jump" for fault in plan.faults):
            raise ValueError("faults: clock_jump is for inject.py; here only stamps can jump")
        self.line = Injector(plan)
        self.begun_ns = -1
        self.qp_fails = False
        self.path: PathMessage | None = None
        self.outputs = {topic: self.output(topic) for topic in TYPES}
        for topic, kind in TYPES.items():
            qos = ros.LATCHED if topic == PATH else ros.RELIABLE
            self.create_subscription(kind, topic, partial(self.on_message, topic), qos)
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.on_command, ros.COMMAND)
        self.controller = AsyncParameterClient(self, "controller")
        self.create_timer(PERIOD, self.on_timer)
        self.create_timer(PATH_PERIOD, self.on_path_timer)
        self.create_timer(1.0, self.on_diagnostics)
        self.get_logger().info(f"ready: {len(plan.faults)} faults")

    def output(self, topic: str) -> Any:
        """Offer what the controller gets."""
        qos = ros.LATCHED if topic == PATH else ros.RELIABLE
        return self.create_publisher(TYPES[topic], ros.FAULTY + topic, qos)

    @property
    def since_ns(self) -> int:
        """Time since the first command; before it, less than the start of any fault [ns]."""
        return self.now_ns - self.begun_ns if self.begun_ns >= 0 else -NANOSECONDS

    def on_command(self, _: JointState) -> None:
        """Begin to count where the drive begins."""
        if self.begun_ns < 0:
            self.begun_ns = self.now_ns
            self.get_logger().info("the drive has begun: faults count from here")

    def on_message(self, topic: str, message: Any) -> None:
        """Send a message on its way."""
        if topic == PATH:
            self.path = message
        try:
            self.line.put(unpacked(topic, message, self.since_ns))
        except ValueError as error:
            self.reject(error)
        self.on_timer()

    def on_path_timer(self) -> None:
        """Send the path once more."""
        if self.path is not None:
            self.path.header.stamp = ros.time_message(self.now_ns)
            self.on_message(PATH, self.path)

    def on_timer(self) -> None:
        """Publish what arrives now, and let solutions fail where that is planned."""
        for message in self.line.due(self.since_ns):
            self.outputs[message.topic].publish(packed(message))
        fails = self.line.is_on("qp_fault", self.since_ns)
        if fails != self.qp_fails and self.controller.services_are_ready():
            self.qp_fails = fails
            self.controller.set_parameters([Parameter("qp_fault", value=fails)])

    def on_diagnostics(self) -> None:
        """Report the faults that are there."""
        there = [each.fault.kind for each in self.line.faults(self.since_ns)]
        self.report(self.now_ns, f"injected: {', '.join(there)}" if there else "", {})


def unpacked(topic: str, message: Any, arrival_ns: int) -> Message:
    """Unpack a message that comes in now.

    Raises:
        ValueError: It is wrong without a fault already.
    """
    stamp_ns = ros.nanoseconds(message.header.stamp)
    if topic == ODOM:
        return Message(topic, arrival_ns, stamp_ns, ros.vehicle_state(message))
    if topic == PATH:
        return Message(topic, arrival_ns, stamp_ns, np.array(ros.path_points(message)))
    return Message(topic, arrival_ns, stamp_ns, ros.steering_angle(message).value)


def packed(message: Message) -> Any:
    """Pack what the controller gets."""
    if message.topic == ODOM:
        packed = odometry(message)
    elif message.topic == PATH:
        packed = path(message)
    else:
        packed = ros.joint_message(message.stamp_ns, message.value, 0.0)
    packed.header.frame_id = message.frame_id if message.topic != STEERING else ros.BASE_LINK
    return packed


def odometry(message: Message) -> Odometry:
    """Pack a state, its quaternion as long as the fault wants it."""
    packed = ros.odometry_message(message.value._replace(stamp_ns=message.stamp_ns))
    orientation = packed.pose.pose.orientation
    orientation.z, orientation.w = orientation.z * message.length, orientation.w * message.length
    return packed


def path(message: Message) -> PathMessage:
    """Pack a path, also one of a single point, or of none."""
    if len(message.value) > 1:
        return ros.path_message(message.value, message.stamp_ns)
    packed = PathMessage()
    packed.header.stamp = ros.time_message(message.stamp_ns)
    packed.poses = [PoseStamped() for _ in message.value]
    for pose, (x, y) in zip(packed.poses, message.value.tolist(), strict=True):
        pose.pose.position.x, pose.pose.position.y = x, y
    return packed


def main() -> int:
    """Run the node."""
    return spin(InjectorNode)


if __name__ == "__main__":
    sys.exit(main())
