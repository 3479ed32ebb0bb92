"""Node `planner`: publishes path and target speed of a drive. `ros2 run ampc_ros planner`."""

import sys

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node

from ampc_msgs_config import ros
from ampc_msgs_config.scenario import SpeedPlanner


class PlannerNode(Node):
    """Publishes the path once, latched, and answers every state with a target speed."""

    def __init__(self) -> None:
        """Load the drive, publish its path."""
        super().__init__("planner")
        self.scenario = ros.declare_scenario(self)
        lock_step = ros.declare(self, "lock_step", False, "answer every state reliably")
        self.plan = SpeedPlanner(self.scenario)
        self.answered: TwistStamped | None = None
        self.create_subscription(
            Odometry, ros.ODOM, self.on_odometry, ros.RELIABLE if lock_step else ros.NEWEST
        )
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.speeds = self.create_publisher(TwistStamped, ros.TARGET_SPEED, ros.RELIABLE)
        self.diagnostics = self.create_publisher(DiagnosticArray, ros.DIAGNOSTICS, ros.RELIABLE)
        now = self.get_clock().now().nanoseconds
        self.paths.publish(ros.path_message(self.scenario.points, now))
        self.create_timer(1.0, self.on_diagnostics)
        self.trouble = "waiting for odom"
        self.get_logger().info(f"{self.scenario.name}: {self.scenario.duration:g} s")

    def on_odometry(self, message: Odometry) -> None:
        """Answer a state; time going backwards starts the drive anew."""
        try:
            state = ros.vehicle_state(message)
        except ValueError as error:
            self.trouble = str(error)
            self.get_logger().error(self.trouble, throttle_duration_sec=1.0)
            return
        if self.answered is not None:
            last_ns = ros.nanoseconds(self.answered.header.stamp)
            if state.stamp_ns == last_ns:
                self.speeds.publish(self.answered)
                return
            if state.stamp_ns < last_ns:
                self.get_logger().warning("time went backwards: drive starts anew")
                self.plan = SpeedPlanner(self.scenario)
        speed = ros.Stamped(state.stamp_ns, self.plan.target_speed(state))
        self.answered = ros.speed_message(speed)
        self.speeds.publish(self.answered)
        self.trouble = ""

    def on_diagnostics(self) -> None:
        """Report health once a second."""
        speed = self.answered.twist.linear.x if self.answered else 0.0
        self.diagnostics.publish(ros.diagnostics_message(self, self.trouble, {"target_speed": speed}))


def main() -> int:
    """Run the node."""
    return ros.spin(PlannerNode)


if __name__ == "__main__":
    sys.exit(main())
