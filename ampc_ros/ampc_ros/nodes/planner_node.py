"""Node `planner`: publishes path and target speed of a drive. `ros2 run ampc_ros planner`.

In real time it brakes while a stop is requested. In lock-step it does not: the order of a request
and the state of the same tick is undefined there, and a drive must be repeatable.
"""

import sys

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Bool, String

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.nodes.inputs import Inputs
from ampc_msgs_config.nodes.scenario_parameters import declare_scenario
from ampc_msgs_config.nodes.silent_clock import SilentClock
from ampc_msgs_config.scenarios.scenario import SpeedPlanner
from ampc_msgs_config.scenarios.scenario_yaml import document, scenario_content
from ampc_msgs_config.types import NANOSECONDS, OK, STALE, WARN, VehicleState
from ampc_ros.nodes.braking import Braking

SILENCE = 0.5
"""Age at which the newest state is reported as stale [s]."""
BRAKING_PERIOD = 0.1
"""Time between target speeds while a stop is requested and no state arrives [s]."""


class PlannerNode(BaseNode):
    """Publishes the path once, latched, and a target speed for every state."""

    def __init__(self) -> None:
        """Load the drive; publish its path as soon as the clock runs."""
        super().__init__("planner")
        self.scenario = declare_scenario(self)
        self.plan = SpeedPlanner(self.scenario)
        self.plan.target_speed(VehicleState(0, *self.scenario.start, 0.0, 0.0, 0.0))  # compiles
        self.braking, self.stop_requested = Braking(), False
        self.newest: TwistStamped | None = None
        self.path_is_out = False
        text = "frame of path and odom; empty: that of the first odom"
        self.frame_id: str = declare(self, "fixed_frame", "", text)
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.speeds = self.create_publisher(TwistStamped, ros.TARGET_SPEED, ros.RELIABLE)
        qos = ros.RELIABLE if self.lock_step else ros.NEWEST
        self.inputs = Inputs(self)
        self.inputs.add(Odometry, ros.ODOM, self.on_odometry, qos)
        if not self.lock_step:
            profiles = ros.ANY_PUBLISHER
            self.inputs.add(Bool, ros.STOP_REQUEST, self.on_stop_request, *profiles)
            self.create_timer(BRAKING_PERIOD, self.on_braking_timer)
        self.configurations = self.create_publisher(String, f"~/{ros.CONFIGURATION}", ros.LATCHED)
        text = document({"scenario": scenario_content(self.scenario)})
        self.configurations.publish(String(data=text))
        self.clock_check = SilentClock(self)
        # In real time, the clock that no other clock can stop.
        clock = None if self.lock_step else Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self.on_diagnostics, clock=clock)
        if self.now_ns > 0:
            self.publish_path(self.now_ns)
        self.get_logger().info(f"ready: {self.scenario.name}, {self.scenario.duration:g} s")

    def publish_path(self, stamp_ns: int) -> None:
        """Publish the path, latched."""
        frame_id = self.frame_id or ros.MAP
        self.paths.publish(ros.path_message(self.scenario.points, stamp_ns, frame_id))
        self.path_is_out = True

    def on_odometry(self, message: Odometry) -> None:
        """Publish the target speed for a state; the same state again repeats the message."""
        try:
            state = ros.vehicle_state(message)
        except ValueError as error:
            self.reject(error)
            return
        if self.unrecorded():
            return
        is_first, frame_id = not self.frame_id, message.header.frame_id
        self.frame_id = self.frame_id or frame_id
        if not self.path_is_out or (is_first and frame_id != ros.MAP):
            self.publish_path(state.stamp_ns)
        self.speeds.publish(self.speed_message(state))

    def speed_message(self, state: VehicleState) -> TwistStamped:
        """Return the target speed for a state; the drive restarts where time goes backwards."""
        newest_ns = -1 if self.newest is None else ros.nanoseconds(self.newest.header.stamp)
        if self.newest is None or state.stamp_ns < newest_ns:
            self.plan, self.braking = SpeedPlanner(self.scenario), Braking()
            self.get_logger().info("the drive starts")
        if state.stamp_ns != newest_ns:
            planned = self.plan.target_speed(state)
            speed = self.braking.limited(planned, state, stop=self.stop_requested)
            self.newest = ros.speed_message(ros.Stamped(state.stamp_ns, speed))
        return self.newest

    def on_braking_timer(self) -> None:
        """Continue to brake without a state: its loss may be the reason for the stop."""
        if not self.stop_requested or self.newest is None:
            return
        if self.now_ns - ros.nanoseconds(self.newest.header.stamp) <= SILENCE * NANOSECONDS:
            return
        speed = self.newest.twist.linear.x
        expected = VehicleState(self.now_ns, 0.0, 0.0, 0.0, speed, 0.0, 0.0)
        slower = self.braking.limited(speed, expected, stop=True)
        self.speeds.publish(ros.speed_message(ros.Stamped(self.now_ns, slower)))

    def on_stop_request(self, message: Bool) -> None:
        """Brake from the next state on, or continue the drive."""
        if message.data != self.stop_requested:
            self.stop_requested = bool(message.data)
            text = "a stop is requested: braking" if message.data else "the drive continues"
            self.get_logger().warning(text)
            self.on_diagnostics()

    def on_diagnostics(self) -> None:
        """Report health once a second and when a stop is requested or taken back."""
        level, sentence = self.health()
        problems = [self.clock_check.problem(), *self.inputs.mismatches()]
        if any(problems):
            level, sentence = max(level, WARN), "; ".join(filter(None, [sentence, *problems]))
        speed = self.newest.twist.linear.x if self.newest else 0.0
        values = {"target_speed": speed, "stop_requested": float(self.stop_requested)}
        self.report(self.now_ns, sentence, values, level)

    def health(self) -> tuple[int, str]:
        """Return level and sentence of the diagnostics."""
        if self.newest is None:
            return STALE, "waiting for odom"
        age = (self.now_ns - ros.nanoseconds(self.newest.header.stamp)) / NANOSECONDS
        if age > SILENCE:
            return STALE, f"odom is {age:.1f} s old: no target speed is published"
        return (WARN, "a stop is requested: braking") if self.stop_requested else (OK, "")


def main() -> int:
    """Run the node."""
    return spin(PlannerNode)


if __name__ == "__main__":
    sys.exit(main())
