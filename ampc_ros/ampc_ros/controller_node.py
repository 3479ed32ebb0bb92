"""Node `controller`: path and state in, steering out. `ros2 run ampc_ros controller`."""

import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ampc_msgs_config import ros
from ampc_msgs_config.path import Path, make_path
from ampc_msgs_config.types import Command, VehicleState
from ampc_ros.controller import CONTROLLERS, Choices, make_controller, warm_up


class ControllerNode(Node):
    """Solves on a timer of the node's clock, or, in lock-step, once for every state."""

    def __init__(self) -> None:
        """Load and compile everything; only then subscribe."""
        super().__init__("controller")
        lock_step = ros.declare(self, "lock_step", False, "answer every state, no timer")
        self.controller = make_controller(self._choices())
        warm_up(self.controller)
        self.state: VehicleState | None = None
        self.path: Path | None = None
        self.answered: JointState | None = None
        self.answered_ns = -1
        self.counts = {"ticks": 0.0, "missed_ticks": 0.0, "rejected_inputs": 0.0}
        self.trouble = "waiting for odom and reference_path"
        self.create_subscription(PathMessage, ros.REFERENCE_PATH, self.on_path, ros.LATCHED)
        if lock_step:
            self.create_subscription(Odometry, ros.ODOM, self.on_lock_step, ros.RELIABLE)
        else:
            self.create_subscription(Odometry, ros.ODOM, self.on_odometry, ros.NEWEST)
            self.create_timer(self.controller.period, self.on_timer)
        self.debug = {
            name: self.create_publisher(Float64, f"~/debug/{name}", ros.RELIABLE)
            for name in ros.DEBUG_QUANTITIES
        }
        self.diagnostics = self.create_publisher(DiagnosticArray, ros.DIAGNOSTICS, ros.RELIABLE)
        self.commands = self.create_publisher(JointState, ros.STEERING_COMMAND, ros.COMMAND)
        self.create_timer(1.0, self.on_diagnostics)
        self.get_logger().info("ready")

    def _choices(self) -> Choices:
        default = Choices()
        to_cg = ros.declare(
            self, "base_link_to_cg", -1.0, "odom to centre of gravity [m]; -1: rear axle", (-1, 20)
        )
        names = list(CONTROLLERS)
        return Choices(
            ros.declare(self, "controller", default.controller, "controller", names),
            ros.declare(self, "vehicle", default.vehicle, "shipped vehicle, or YAML file"),
            ros.declare(self, "settings", default.settings, "shipped limits, or YAML file"),
            ros.declare(self, "gain_table", default.gain_table, "shipped gains, or YAML file"),
            None if to_cg < 0 else to_cg,
        )

    def on_path(self, message: PathMessage) -> None:
        """Take a new path; a bad one is refused and the old one kept."""
        try:
            self.path = make_path(ros.path_points(message))
        except ValueError as error:
            self._reject(error)

    def on_odometry(self, message: Odometry) -> None:
        """Keep the newest state; a bad one is refused, time going backwards starts anew."""
        try:
            state = ros.vehicle_state(message)
        except ValueError as error:
            self._reject(error)
            return
        if self.state is not None and state.stamp_ns < self.state.stamp_ns:
            self.get_logger().warning("time went backwards: controller reset")
            self.controller.reset()
            self.answered_ns = -1
        self.state = state

    def on_lock_step(self, message: Odometry) -> None:
        """Answer a state; a state that was answered before gets the same command again."""
        self.on_odometry(message)
        if self.state is not None and self.state.stamp_ns == self.answered_ns:
            self.commands.publish(self.answered)
        else:
            self.on_timer()

    def on_timer(self) -> None:
        """Answer the newest state, once."""
        if self.state is None or self.path is None:
            return
        self.counts["ticks"] += 1
        if self.state.stamp_ns == self.answered_ns:
            self.counts["missed_ticks"] += 1
            self.trouble = "no new odom since the last tick"
            return
        start = time.perf_counter()
        try:
            command = self.controller.step(self.state, self.path)
        except ValueError as error:
            self._reject(error)
            self.path = None
            return
        self._publish(command, time.perf_counter() - start)

    def _publish(self, command: Command, solve_time: float) -> None:
        self.answered, self.answered_ns = ros.steering_message(command), command.stamp_ns
        self.commands.publish(self.answered)
        for name, value in (*command.diagnosis._asdict().items(), ("solve_time", solve_time)):
            self.debug[name].publish(Float64(data=float(value)))
        self.trouble = ""
        if command.diagnosis.outside_table:
            self.trouble = "outside the gain table: nearest edge in use"
        if not command.diagnosis.converged:
            self.trouble = "QP not solved: angle held"

    def _reject(self, error: ValueError) -> None:
        self.counts["rejected_inputs"] += 1
        self.trouble = str(error)
        self.get_logger().error(str(error), throttle_duration_sec=1.0)

    def on_diagnostics(self) -> None:
        """Report health once a second."""
        self.diagnostics.publish(ros.diagnostics_message(self, self.trouble, self.counts))


def main() -> int:
    """Run the node."""
    return ros.spin(ControllerNode)


if __name__ == "__main__":
    sys.exit(main())
