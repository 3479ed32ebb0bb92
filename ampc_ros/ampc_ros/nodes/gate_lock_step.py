"""The gate in lock-step: answers to a state are passed on with its stamp, after the state."""

from typing import TYPE_CHECKING

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.gate.core import GateOutput
from ampc_ros.gate.lock_step import LockStepGate
from ampc_ros.gate.settings import GateState
from ampc_ros.nodes.gate_outputs import angle_rate

if TYPE_CHECKING:
    from ampc_ros.nodes.gate_node import GateNode

SPEEDS_KEPT = 20
"""Number of states among which that of a command is found."""


class LockStepAnswers:
    """Passes commands and target speeds on."""

    def __init__(self, node: "GateNode", gate: LockStepGate) -> None:
        """Wait for the first command.

        Args:
            node: Owner, which publishes.
            gate: Limits of the commands.
        """
        self.node, self.gate = node, gate
        self.command: JointState | None = None
        self.target: ros.Stamped | None = None
        self.passed: GateOutput | None = None
        self.speeds: dict[int, float] = {}
        """Measured speed [m/s] by stamp [ns]."""

    def on_odometry(self, message: Odometry) -> None:
        """Store the speed of a state, and pass a command on that has waited for it."""
        self.speeds[ros.nanoseconds(message.header.stamp)] = message.twist.twist.linear.x
        while len(self.speeds) > SPEEDS_KEPT:
            del self.speeds[next(iter(self.speeds))]
        self.pass_on()

    def on_command(self, message: JointState) -> None:
        """Pass a command on.

        Raises:
            ValueError: The command is unsafe, or there is a second publisher.
        """
        if intruders := self.node.second_publishers():
            raise ValueError(intruders)
        ros.steering_angle(message, self.node.steering)
        self.command = message
        self.pass_on()

    def pass_on(self) -> None:
        """Publish the newest command once, after the state that it answers."""
        command, steering, outputs = self.command, self.node.steering, self.node.outputs
        stamp_ns = ros.nanoseconds(command.header.stamp) if command else -1
        if command is None or stamp_ns not in self.speeds or not self.node.is_ready():
            return
        self.command = None
        angle = ros.steering_angle(command, steering).value
        rate = angle_rate(command, steering)
        self.passed = self.gate.step(stamp_ns, angle, rate, self.speeds[stamp_ns])
        is_command = self.passed.is_command
        outputs.publish_steering(self.passed, stamp_ns, command if is_command else None)
        self.node.gate.state = GateState.DRIVING
        outputs.publish_state(GateState.DRIVING)
        self.pass_pair()

    def on_speed(self, message: TwistStamped) -> None:
        """Pass a target speed on, unchanged."""
        target = ros.target_speed(message)
        if self.node.is_ready():
            self.target = target
            self.node.outputs.speeds.publish(message)
            self.pass_pair()

    def pass_pair(self) -> None:
        """Publish the complete command once both parts answer the same state."""
        if self.passed and self.target and self.target.stamp_ns == self.gate.stamp_ns:
            output = self.passed._replace(speed=self.target.value)
            stamp_ns = self.target.stamp_ns
            measured = self.speeds.get(stamp_ns, output.speed)
            self.node.outputs.publish_drive(output, stamp_ns, measured, stamp_ns / NANOSECONDS)
