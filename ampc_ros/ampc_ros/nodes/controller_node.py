"""Node `controller`: path and state in, steering out. `ros2 run ampc_ros controller`."""

import math
import sys
import time

from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import spin
from ampc_msgs_config.types import NANOSECONDS, WARN, TickRecord
from ampc_ros.nodes.configured_node import ConfiguredNode
from ampc_ros.nodes.managed_node import lifecycle_state
from ampc_ros.ros import Outputs
from ampc_ros.supervision.health import (
    Condition,
    condition,
    describe_change,
    health,
    health_numbers,
)
from ampc_ros.supervision.tick_policy import Action, TickPolicy

REPORT_PAUSE = 0.1
"""Shortest wall time between two reports of changes [s]."""


class ControllerNode(ConfiguredNode):
    """Steers on a timer of the node's clock, or in lock-step once for every state."""

    policy: TickPolicy
    timer: Timer

    def __init__(self) -> None:
        """Declare everything; configure and activate where `autostart` is true."""
        super().__init__("controller")
        self.failure = ""
        self.condition = Condition()
        self.reported = -math.inf
        self.commands = 0
        """Number of published commands."""
        self.declare_choices()
        self.create_timer(1.0, self.on_diagnostics)
        self.start()

    def set_up(self) -> None:
        """Load and compile everything; only then publish and subscribe."""
        self.load()
        self.policy = TickPolicy(self.supervisor, lock_step=self.lock_step)
        self.outputs = Outputs(self, lock_step=self.lock_step)
        self.while_configured.callback(self.outputs.destroy)
        self.publish_configuration()
        self.subscribe()
        self.offer_changes()

    def subscribe(self) -> None:
        """Subscribe to all inputs and offer the service `~/reset_stop`."""
        qos = ros.RELIABLE if self.lock_step else ros.NEWEST
        inputs = [
            (PathMessage, ros.REFERENCE_PATH, self.on_path, ros.LATCHED),
            (Odometry, ros.ODOM, self.on_odometry, qos),
        ]
        if not self.lock_step:  # there, the order of odom and steering_state is undefined
            inputs.append((JointState, ros.STEERING_STATE, self.on_steering, ros.NEWEST))
        release = self.while_configured.callback
        for each in inputs:
            release(self.destroy_subscription, self.create_subscription(*each))
        reset_stop = self.create_service(Trigger, "~/reset_stop", self.on_reset_stop)
        release(self.destroy_service, reset_stop)

    def begin(self) -> None:
        """Start to steer from the angle in force; earlier plans are forgotten."""
        if self.policy.record:
            self.supervisor.restart()
        self.policy.restart_timer()
        self.supervisor.clear_stop()
        self.outputs.request_stop(False)
        if not self.lock_step:
            self.timer = self.create_timer(self.supervisor.period, self.on_timer)
            self.while_active.callback(self.destroy_timer, self.timer)
        self.get_logger().info("ready")

    def finish(self) -> None:
        """Publish a safe last command in real time: the angle is held, a stop is requested."""
        if not self.lock_step:
            self.outputs.request_stop(True)
            self.outputs.hold()

    def publish_final(self) -> None:
        """Publish the safe last command at the end of the process."""
        if self.is_active:
            self.finish()

    def on_path(self, message: PathMessage) -> None:
        """Use a new path; an invalid one is rejected and the old one kept.

        Raises:
            ValueError: In lock-step there is no old one: all nodes would wait for ever.
        """
        stamp_ns = ros.nanoseconds(message.header.stamp)
        now_ns = stamp_ns if self.lock_step else self.now_ns
        try:
            self.supervisor.take_path(ros.path_points(message), stamp_ns, now_ns)
        except ValueError as error:
            if self.lock_step and self.supervisor.path is None:
                raise
            self.reject(error)
        if self.lock_step:
            self.act(self.policy.on_input())

    def on_odometry(self, message: Odometry) -> None:
        """Use the newest state; an invalid one is rejected and the old one kept."""
        try:
            restarted = self.policy.take_state(ros.vehicle_state(message), self.now_ns)
        except ValueError as error:
            self.reject(error)
            return
        if restarted:
            self.get_logger().warning("time went backwards, or the car jumped: controller reset")
        self.act(self.policy.on_input())

    def on_steering(self, message: JointState) -> None:
        """Use the measured angle."""
        try:
            self.supervisor.take_steering(ros.steering_angle(message).value)
        except ValueError as error:
            self.reject(error)

    def on_timer(self) -> None:
        """Answer the newest state, or defer the tick to the next one."""
        missed = self.policy.missed
        action = self.policy.on_timer(self.now_ns, self.timer.time_until_next_call())
        if self.policy.left_out and self.policy.record:
            self.trouble = f"the timer was late: {self.policy.left_out} ticks left out"
        if action is Action.WAIT and self.policy.missed > missed + self.policy.left_out:
            self.trouble = "no new odom since the last tick"
        self.act(action)

    def act(self, action: Action) -> None:
        """Tick, or publish the newest command once more."""
        if action is Action.TICK:
            self.step()
        elif action is Action.REPEAT:
            self.outputs.repeat()

    def step(self) -> None:
        """Tick and publish, where inputs, life cycle and recorder allow it."""
        if not self.is_active or not self.supervisor.is_ready or self.unrecorded():
            return
        start = time.perf_counter()
        record = self.policy.tick(self.now_ns)
        if record:
            timing = time.perf_counter() - start, self.policy.lateness_ns / NANOSECONDS
            self.commands += 1
            account = self.rejected, self.policy.missed, self.commands
            self.outputs.publish_tick(record, timing, account)
            self.report_change(record)

    def report_change(self, record: TickRecord) -> None:
        """Request a stop where that is new, and report a changed condition at once."""
        self.outputs.request_stop(self.supervisor.stop_requested)
        failure = self.supervisor.controller.failure
        if failure and failure != self.failure:
            self.get_logger().warning(failure)
        self.failure, self.trouble = failure, failure or self.trouble
        before, now = self.condition, condition(self.supervisor, record)
        if now != before and time.monotonic() - self.reported > REPORT_PAUSE:
            self.condition = now
            if line := describe_change(before, now):
                self.get_logger().warning(line)
            self.on_diagnostics()

    def on_diagnostics(self) -> None:
        """Report health once a second and after a change."""
        self.reported = time.monotonic()
        if not self.is_active:
            state = lifecycle_state(self)
            self.report(self.now_ns, f"{state}: no commands are published", {}, WARN)
            return
        level, sentence = health(self.supervisor, self.policy.record, self.now_ns)
        account = {"commands": self.commands, "missed_ticks": self.policy.missed}
        values = account | health_numbers(self.supervisor, self.policy.record)
        self.report(self.now_ns, sentence, values, level)

    def on_reset_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Take back the request to stop."""
        self.supervisor.clear_stop()
        self.outputs.request_stop(False)
        response.success, response.message = True, "no stop is requested any more"
        return response


def main() -> int:
    """Run the node."""
    return spin(ControllerNode)


if __name__ == "__main__":
    sys.exit(main())
