"""Inputs of a gate: messages, and a process that publishes them until it is killed.

`python -m tests.gate_inputs` publishes command, plan, target speed and odometry at 10 Hz.
"""

import time
from collections.abc import Sequence

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import NANOSECONDS

PERIOD = 0.1
SPEED = 3.0
"""Low, so that a stop takes little time [m/s]."""
ANGLE = 0.05
"""Angle of the commands [rad]; plans go on from there."""


def plan_message(
    angles: Sequence[float],
    speed: float = SPEED,
    dt: float = 0.1,
    steering: SteeringParameters = ros.ROAD_WHEEL,
) -> JointTrajectory:
    """Return a plan at constant speed, whose first half is the optimised part."""
    message = JointTrajectory(joint_names=list(topics.PLAN_JOINTS[:2]))
    for i, angle in enumerate(angles):
        point = JointTrajectoryPoint()
        point.positions = [steering.position(angle), i * dt * speed]
        point.velocities = [0.0, speed]
        point.accelerations = [0.0, 0.0 if 2 * i < len(angles) else -2.5]
        point.effort = [0.0, 0.0]  # rosbags misreads an empty list inside a list
        time_ns = round(i * dt * NANOSECONDS)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(time_ns, NANOSECONDS)
        message.points.append(point)
    return message


class GateInputs(Node):
    """Publishes all inputs of a gate."""

    def __init__(self, name: str = "controller", offered: QoSProfile | None = None) -> None:
        """Create the publishers.

        Args:
            name: Name of the node.
            offered: QoS of the command; None: that of the controller.
        """
        super().__init__(name)
        offered = offered or qos.controller_command(PERIOD)
        self.commands = self.create_publisher(JointState, topics.STEERING_COMMAND, offered)
        self.plans = self.create_publisher(JointTrajectory, topics.STEERING_PLAN, qos.COMMAND)
        self.speeds = self.create_publisher(TwistStamped, topics.TARGET_SPEED, qos.RELIABLE)
        self.odom = self.create_publisher(Odometry, topics.ODOM, qos.RELIABLE)
        self.angle, self.rounds = ANGLE, 0
        self.plan = plan_message([ANGLE + 0.002 * i for i in range(40)])

    def send(self) -> None:
        """Publish all inputs once; the stamp of the command is the number of the round."""
        self.rounds += 1
        odometry = Odometry()
        odometry.twist.twist.linear.x = SPEED
        self.odom.publish(odometry)
        self.plans.publish(self.plan)
        stamp_ns = self.rounds * NANOSECONDS
        self.speeds.publish(ros.speed_message(ros.Stamped(stamp_ns, SPEED)))
        self.commands.publish(ros.joint_message(stamp_ns, self.angle, 0.01))


def main() -> None:
    """Publish until the process is killed."""
    rclpy.init()
    node = GateInputs()
    while True:
        node.send()
        time.sleep(PERIOD)


if __name__ == "__main__":
    main()
