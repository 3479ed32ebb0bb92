"""Node `planner`: publishes path and target speed of a drive. `ros2 run ampc_ros planner`.

With the parameter `follow`, the path is that of another planner, and only the speed is ours.
In real time it brakes while a stop is requested, while the controller is silent, and after a
second publisher of one of its topics. In lock-step it does not: the order of a request and the
state of the same tick is undefined there, and a drive must be repeatable.
"""

import math
import sys
import time

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import BaseNode, declare, spin
from ampc_msgs_config.nodes.inputs import Inputs
from ampc_msgs_config.nodes.scenario_parameters import declare_scenario
from ampc_msgs_config.nodes.silent_clock import SilentClock
from ampc_msgs_config.nodes.sole_sources import SoleSources
from ampc_msgs_config.nodes.waiting import WaitLog
from ampc_msgs_config.paths.path import NOT_CAUGHT
from ampc_msgs_config.scenarios.scenario import MOVING, PathWithSpeed, Scenario, SpeedPlanner
from ampc_msgs_config.scenarios.scenario_yaml import document, scenario_content
from ampc_msgs_config.types import ERROR, NANOSECONDS, OK, STALE, WARN, Array, VehicleState
from ampc_ros.nodes.braking import Braking, StopRequests
from ampc_ros.nodes.fixed_frame import FRAME, FixedFrame
from ampc_ros.nodes.followed_path import (
    AUTOWARE,
    FOLLOW,
    NO_ROUTE,
    FollowedPath,
    Follower,
    declare_limits,
)
from ampc_ros.supervision.checks import StateFilter

SILENCE = 0.5
"""Age at which the newest state is reported as stale, and time without a steering command after
which the planner brakes [s]."""
BRAKING_PERIOD = 0.1
"""Wall time between target speeds while braking without a state [s]."""
RESET_PAUSE = 1.0
"""Wall time for which the planner still brakes after `~/reset_stop`, until publishers that are
alive have repeated their requests, and the lists of publishers were looked at [s]."""


class PlannerNode(BaseNode):
    """Publishes the path once, latched, and a target speed for every state."""

    def __init__(self) -> None:
        """Load the drive; publish its path as soon as the clock runs."""
        super().__init__("planner")
        text = "path and speed of another planner; none: those of scenario or path"
        follow = declare(self, "follow", NO_ROUTE, text, FOLLOW)
        self.scenario: Scenario | PathWithSpeed | None
        self.plan: SpeedPlanner | None = None
        self.follower: Follower | None = None
        if follow == NO_ROUTE:
            self.scenario = declare_scenario(self)
            self.plan = SpeedPlanner(self.scenario)
            self.plan.target_speed(VehicleState(0, *self.scenario.start, 0.0, 0.0, 0.0))  # compiles
        else:
            self.scenario, limits = None, declare_limits(self, follow)
        self.filter, self.braking, self.requests = StateFilter(), Braking(), StopRequests()
        self.stop, self.reset_at = "", -math.inf
        self.newest: TwistStamped | None = None
        self.path_is_out = False
        self.frame_id: str = declare(self, "fixed_frame", "", "frame of path and odom", FRAME)
        if follow in (NO_ROUTE, AUTOWARE):
            self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.speeds = self.create_publisher(TwistStamped, ros.TARGET_SPEED, ros.RELIABLE)
        qos = ros.RELIABLE if self.lock_step else ros.NEWEST
        self.inputs = Inputs(self)
        if follow != NO_ROUTE:
            self.follower = Follower(self, self.inputs, follow, limits, self.on_path, self.reject)
        self.inputs.add(Odometry, ros.ODOM, self.on_odometry, qos)
        heard = {ros.ODOM: Odometry, ros.TARGET_SPEED: TwistStamped}
        heard[ros.STEERING_COMMAND] = JointState
        self.sources = SoleSources(
            self, heard, [ros.REFERENCE_PATH], self.update_stop, lock_step=self.lock_step
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if not self.lock_step:
            self.inputs.add(Bool, ros.STOP_REQUEST, self.on_stop_request, *ros.ANY_PUBLISHER)
            self.create_timer(BRAKING_PERIOD, self.on_braking_timer, clock=steady)
            self.create_service(Trigger, "~/reset_stop", self.on_reset_stop)
        self.clock_check = SilentClock(self)
        self.waiting = WaitLog(self, self.waits_for)
        # In real time, the clock that no other clock can stop.
        self.create_timer(1.0, self.on_diagnostics, clock=None if self.lock_step else steady)
        if isinstance(self.scenario, Scenario):
            self.publish_configuration(self.scenario)
        else:
            self.get_logger().info(f"ready: follow = {follow}")

    def publish_configuration(self, scenario: Scenario) -> None:
        """Publish the drive, and its path as soon as the clock runs."""
        self.configurations = self.create_publisher(String, f"~/{ros.CONFIGURATION}", ros.LATCHED)
        text = document({"scenario": scenario_content(scenario)})
        self.configurations.publish(String(data=text))
        if self.now_ns > 0:
            self.publish_path(scenario.points, self.now_ns)
        self.get_logger().info(f"ready: {scenario.name}, {scenario.duration:g} s")

    @property
    def stop_requested(self) -> bool:
        """Whether the planner brakes."""
        return bool(self.stop)

    def publish_path(self, points: Array, stamp_ns: int) -> None:
        """Publish the path, latched."""
        self.paths.publish(ros.path_message(points, stamp_ns, self.frame_id or ros.MAP))
        self.path_is_out = True

    def on_path(self, followed: FollowedPath) -> None:
        """Use the path of another planner; the position on it is looked for."""
        if followed.points is not None:
            self.points, self.scenario = followed.points, followed.route
            self.plan = SpeedPlanner(followed.route) if followed.route else None
        if self.follower and self.follower.kind == AUTOWARE:  # an empty one stops the car
            self.publish_path(self.points, followed.stamp_ns)

    def destroy_node(self) -> None:
        """End the process of the follower with the node."""
        if self.follower:
            self.follower.close()
        super().destroy_node()

    def on_odometry(self, message: Odometry) -> None:
        """Publish the target speed for a state; the same state again repeats the message."""
        try:
            state = ros.vehicle_state(message)
            if self.unrecorded():
                return
            speed = self.speed_message(state)
        except ValueError as error:
            self.reject(error)
            return
        is_first, frame_id = not self.frame_id, message.header.frame_id
        self.frame_id = self.frame_id or frame_id
        if self.follower and self.follower.frame is None:
            frame = FixedFrame(self, self.get_parameter("fixed_frame").value)
            frame.accept(frame_id)
            self.follower.use_frame(frame)
        if isinstance(self.scenario, Scenario) and (
            not self.path_is_out or (is_first and frame_id != ros.MAP)
        ):
            self.publish_path(self.scenario.points, state.stamp_ns)
        if speed:
            self.speeds.publish(speed)

    def speed_message(self, state: VehicleState) -> TwistStamped | None:
        """Return the target speed for a state; None: there has never been a path.

        Raises:
            ValueError: The state contradicts the earlier ones.
        """
        if self.newest and state.stamp_ns == ros.nanoseconds(self.newest.header.stamp):
            return self.newest
        last = self.filter.track.last if self.filter.track else None
        check = self.filter.accept(state, state.stamp_ns if self.lock_step else self.now_ns)
        if not check.accepted:
            raise ValueError(check.reason)
        if last is None or (check.reset and (state.stamp_ns < last.stamp_ns or is_at_rest(state))):
            self.plan = SpeedPlanner(self.scenario) if self.scenario else None
            self.get_logger().info("the drive starts")
        elif check.reset:
            self.get_logger().warning(f"{check.reason}: the position on the path is looked for")
            if self.plan:
                self.plan.index = NOT_CAUGHT
        if self.plan is None and self.newest is None:
            return None
        planned = self.plan.target_speed(state) if self.plan else max(state.v_x, 0.0)
        stop = self.stop_requested or self.plan is None
        speed = self.braking.limited(planned, state, stop=stop)
        self.newest = ros.speed_message(ros.Stamped(state.stamp_ns, speed))
        return self.newest

    def on_braking_timer(self) -> None:
        """Decide whether to brake, and do so also without a state: its loss may be the reason."""
        self.update_stop()
        if not self.stop or self.newest is None:
            return
        if self.now_ns - ros.nanoseconds(self.newest.header.stamp) <= SILENCE * NANOSECONDS:
            return
        speed = self.newest.twist.linear.x
        expected = VehicleState(self.now_ns, 0.0, 0.0, 0.0, speed, 0.0, 0.0)
        slower = self.braking.limited(speed, expected, stop=True)
        self.speeds.publish(ros.speed_message(ros.Stamped(self.now_ns, slower)))

    def on_stop_request(self, message: Bool) -> None:
        """Brake from the next state on; a publisher takes back only its own request."""
        info = self.inputs.topics[ros.STOP_REQUEST].info
        age = (info["received_timestamp"] - info["source_timestamp"]) / NANOSECONDS
        self.requests.receive(message.data, info["publication_sequence_number"], age)
        self.update_stop()

    def update_stop(self) -> None:
        """Decide whether to brake, and report a change."""
        before, self.stop = self.stop, self.reason_to_stop()
        if self.stop != before:
            text = f"{self.stop}: braking" if self.stop else "the drive continues"
            self.get_logger().warning(text)
            self.on_diagnostics()

    def reason_to_stop(self) -> str:
        """Return why the planner brakes; empty: it does not."""
        if self.requests.in_force:
            return "a stop is requested"
        if self.sources.conflict:
            return self.sources.conflict
        if self.sources.silence(ros.STEERING_COMMAND) > SILENCE:
            return f"no {ros.STEERING_COMMAND} for {SILENCE:g} s"
        is_resetting = time.monotonic() - self.reset_at < RESET_PAUSE
        return "the stop is being reset" if is_resetting and self.stop else ""

    def on_reset_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Forget all requests; publishers that are alive repeat theirs to a new subscription."""
        self.requests, self.reset_at = StopRequests(), time.monotonic()
        self.sources.clear()
        self.inputs.topics.pop(ros.STOP_REQUEST).destroy()
        self.inputs.add(Bool, ros.STOP_REQUEST, self.on_stop_request, *ros.ANY_PUBLISHER)
        response.success = True
        response.message = "requests of nodes that have left are forgotten, others remain in force"
        return response

    def waits_for(self) -> str:
        """Return which inputs are missing and why; empty: none."""
        inputs = self.inputs.topics
        problems = [inputs[ros.ODOM].problem(is_used=self.filter.track is not None)]
        if self.follower:
            followed, is_used = inputs[self.follower.topic], self.scenario is not None
            problems.append(followed.problem(is_used=is_used, is_periodic=False))
        return "; ".join(filter(None, problems))

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
        if self.sources.conflict:
            return ERROR, f"{self.sources.conflict}: braking"
        if self.scenario is None:
            assert self.follower
            return STALE, f"waiting for {self.follower.topic}"
        if self.newest is None:
            return STALE, "waiting for odom"
        age = (self.now_ns - ros.nanoseconds(self.newest.header.stamp)) / NANOSECONDS
        if age > SILENCE:
            return STALE, f"odom is {age:.1f} s old: no target speed is published"
        level = ERROR if self.stop and not self.requests.in_force else WARN
        return (level, f"{self.stop}: braking") if self.stop else (OK, "")


def is_at_rest(state: VehicleState) -> bool:
    """Return whether the car stands."""
    return abs(state.v_x) < MOVING


def main() -> int:
    """Run the node."""
    return spin(PlannerNode)


if __name__ == "__main__":
    sys.exit(main())
