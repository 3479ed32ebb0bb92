"""Node `controller`: path and state in, steering out. `ros2 run ampc_ros controller`."""

import sys
import time

from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.event_handler import PublisherEventCallbacks
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ampc_msgs_config import ros
from ampc_msgs_config.base_node import BaseNode, declare, spin
from ampc_msgs_config.path import Path
from ampc_msgs_config.path_making import make_path
from ampc_msgs_config.types import MODES, NANOSECONDS, STANDSTILL, Command, VehicleState
from ampc_ros.configuration import CONTROLLERS, Choices
from ampc_ros.controller import make_controller, warm_up
from ampc_ros.preview import PreviewMpc
from ampc_ros.ticks import Ticks

NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)
"""The executor looks at each event of each publisher at every turn, which for two dozen debug
topics costs more than the tick."""


class ControllerNode(BaseNode):
    """Steers on a timer of the node's clock, or, in lock-step, once for every state."""

    def __init__(self) -> None:
        """Load and compile everything; only then publish and subscribe."""
        super().__init__("controller")
        self.controller = make_controller(self._choices())
        warm_up(self.controller)
        self.state: VehicleState | None = None
        self.path: Path | None = None
        self.answer: JointState | None = None
        self.no_path = "waiting for reference_path"
        self.commands_given = 0
        self.ticks = Ticks(self.controller.period)
        self.debug = [
            self.create_publisher(
                Float64, f"~/debug/{name}", ros.RELIABLE, event_callbacks=NO_EVENTS
            )
            for name in ros.DEBUG_QUANTITIES
        ]
        qos = ros.RELIABLE if self.lock_step else ros.COMMAND  # a fast drive is recorded whole
        self.commands = self.create_publisher(JointState, ros.STEERING_COMMAND, qos)
        self.create_subscription(PathMessage, ros.REFERENCE_PATH, self.on_path, ros.LATCHED)
        self.predictions = self.create_publisher(PathMessage, ros.PREDICTED_PATH, ros.RELIABLE)
        qos = ros.RELIABLE if self.lock_step else ros.NEWEST
        self.create_subscription(Odometry, ros.ODOM, self.on_odometry, qos)
        if not self.lock_step:
            self.create_subscription(JointState, ros.STEERING_STATE, self.on_steering, ros.NEWEST)
            self.timer = self.create_timer(self.controller.period, self.on_timer)
        self.create_timer(1.0, self.on_diagnostics)
        self.get_logger().info("ready")

    def _choices(self) -> Choices:
        default = Choices()
        to_cg = declare(
            self, "base_link_to_cg", -1.0, "odom to centre of gravity [m]; -1: rear axle", (-1, 20)
        )
        return Choices(
            declare(self, "controller", default.controller, "which one", list(CONTROLLERS)),
            declare(self, "vehicle", default.vehicle, "shipped vehicle, or YAML file"),
            declare(self, "settings", default.settings, "shipped limits, or YAML file"),
            declare(self, "gain_table", default.gain_table, "shipped gains, or YAML file"),
            None if to_cg < 0 else to_cg,
        )

    def on_path(self, message: PathMessage) -> None:
        """Take a new path; a bad one is refused and the old one kept."""
        try:
            self.path = make_path(ros.path_points(message))
        except ValueError as error:
            self.reject(error)
        if self.lock_step:
            self.answer_state()

    def on_odometry(self, message: Odometry) -> None:
        """Keep the newest state; a bad one is refused, time going backwards starts anew."""
        try:
            state = ros.vehicle_state(message)
        except ValueError as error:
            self.reject(error)
            return
        if self.state is not None and state.stamp_ns < self.state.stamp_ns:
            self.get_logger().warning("time went backwards: controller reset")
            self.controller.reset()
            self.ticks.restart()
            self.answer = None
        self.state = state
        if self.lock_step:
            self.answer_state()
        elif self.ticks.owed:
            self.step()

    def on_steering(self, message: JointState) -> None:
        """Tell a controller that has an actuator in its model where the steering really is.

        Not in lock-step, where the order of `odom` and `steering_state` is nobody's promise.
        """
        try:
            angle = ros.steering_angle(message).value
        except ValueError as error:
            self.reject(error)
            return
        if isinstance(self.controller, PreviewMpc):
            self.controller.observe_steering(angle)

    def answer_state(self) -> None:
        """Answer the newest state; one that was answered before gets the same command again."""
        if self.answer is not None and self.is_answered():
            self.commands.publish(self.answer)
        else:
            self.step()

    def on_timer(self) -> None:
        """Answer the newest state, once; where there is none, the next one is answered at once."""
        left_out = self.ticks.begin(self.now_ns, self.timer.time_until_next_call())
        if left_out and self.answer is not None:
            self.trouble = f"the timer was late: {left_out} ticks left out"
        if not self.is_answered():
            self.step()
        elif self.ticks.owe():
            self.trouble = "no new odom since the last tick"

    def is_answered(self) -> bool:
        """Tell whether the newest state has its command."""
        if self.state is None or self.answer is None:
            return False
        return ros.nanoseconds(self.answer.header.stamp) == self.state.stamp_ns

    def step(self) -> None:
        """Give the newest state its command, if there is a path for it."""
        if self.state is None or self.path is None or self.unrecorded():
            return
        self.ticks.owed = False
        start = time.perf_counter()
        try:
            command = self.controller.step(self.state, self.path)
        except ValueError as error:
            if self.lock_step:
                raise
            self.reject(error)
            self.path, self.no_path = None, str(error)
            return
        self.publish(command, time.perf_counter() - start)

    def publish(self, command: Command, solve_time: float) -> None:
        """Publish a command and what is to be said about it."""
        self.answer = ros.steering_message(command)
        self.commands.publish(self.answer)
        self.commands_given += 1
        lateness = self.ticks.lateness_ns / NANOSECONDS
        values = (*command.diagnosis, solve_time, lateness)
        for publisher, value in zip(self.debug, values, strict=True):
            if publisher.get_subscription_count():
                publisher.publish(Float64(data=float(value)))
        if command.prediction is not None and self.predictions.get_subscription_count():
            message = ros.path_message(command.prediction, command.stamp_ns)
            self.predictions.publish(message)
        if command.diagnosis.mode > STANDSTILL:
            self.trouble = MODES[int(command.diagnosis.mode)]
        if command.diagnosis.outside_table:
            self.trouble = "outside the gain table: nearest edge in use"
        if not command.diagnosis.converged:
            self.trouble = "QP not solved: angle held"

    def on_diagnostics(self) -> None:
        """Report health once a second."""
        waiting = "waiting for odom" if self.state is None else ""
        if self.path is None:
            waiting = self.no_path
        values = {"commands": self.commands_given, "missed_ticks": self.ticks.missed}
        self.report(self.now_ns, waiting, values)


def main() -> int:
    """Run the node."""
    return spin(ControllerNode)


if __name__ == "__main__":
    sys.exit(main())
