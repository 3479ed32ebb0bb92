"""Node `planner`: publishes path and target speed of a drive. `ros2 run ampc_ros planner`."""

import sys

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage

from ampc_msgs_config import ros
from ampc_msgs_config.base_node import BaseNode, declare_scenario, spin
from ampc_msgs_config.scenario import SpeedPlanner
from ampc_msgs_config.types import VehicleState


class PlannerNode(BaseNode):
    """Publishes the path once, latched, and answers every state with a target speed."""

    def __init__(self) -> None:
        """Load the drive; publish its path as soon as the time is known."""
        super().__init__("planner")
        self.scenario = declare_scenario(self)
        self.plan = SpeedPlanner(self.scenario)
        self.plan.target_speed(VehicleState(0, *self.scenario.start, 0.0, 0.0, 0.0))  # compiles
        self.answer: TwistStamped | None = None
        self.path_is_out = False
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.speeds = self.create_publisher(TwistStamped, ros.TARGET_SPEED, ros.RELIABLE)
        qos = ros.RELIABLE if self.lock_step else ros.NEWEST
        self.create_subscription(Odometry, ros.ODOM, self.on_odometry, qos)
        self.create_timer(1.0, self.on_diagnostics)
        if self.now_ns > 0:
            self.publish_path(self.now_ns)
        self.get_logger().info(f"ready: {self.scenario.name}, {self.scenario.duration:g} s")

    def publish_path(self, stamp_ns: int) -> None:
        """Publish the path, which whoever comes late gets too."""
        self.paths.publish(ros.path_message(self.scenario.points, stamp_ns))
        self.path_is_out = True

    def on_odometry(self, message: Odometry) -> None:
        """Answer a state; one that was answered before gets the same answer."""
        try:
            state = ros.vehicle_state(message)
        except ValueError as error:
            self.reject(error)
            return
        if self.unrecorded():
            return
        if not self.path_is_out:
            self.publish_path(state.stamp_ns)
        self.speeds.publish(self.answer_to(state))

    def answer_to(self, state: VehicleState) -> TwistStamped:
        """Give the target speed at a state; the drive starts anew where time goes backwards."""
        answered_ns = -1 if self.answer is None else ros.nanoseconds(self.answer.header.stamp)
        if self.answer is None or state.stamp_ns < answered_ns:
            self.plan = SpeedPlanner(self.scenario)
            self.get_logger().info("the drive starts")
        if state.stamp_ns != answered_ns:
            speed = ros.Stamped(state.stamp_ns, self.plan.target_speed(state))
            self.answer = ros.speed_message(speed)
        return self.answer

    def on_diagnostics(self) -> None:
        """Report health once a second."""
        waiting = "waiting for odom" if self.answer is None else ""
        speed = self.answer.twist.linear.x if self.answer else 0.0
        self.report(self.now_ns, waiting, {"target_speed": speed})


def main() -> int:
    """Run the node."""
    return spin(PlannerNode)


if __name__ == "__main__":
    sys.exit(main())
