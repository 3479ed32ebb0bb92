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
from ampc_msgs_config.types import NANOSECONDS, WARN, VehicleState
from ampc_ros.nodes.configured_node import ConfiguredNode
from ampc_ros.ros import Outputs
from ampc_ros.supervision.health import Condition, change, condition, health, numbers
from ampc_ros.supervision.supervisor import Decision
from ampc_ros.supervision.ticks import Ticks

REPORT_PAUSE = 0.1
"""Least wall time between two reports of changes [s]."""


class ControllerNode(ConfiguredNode):
    """Steers on a timer of the node's clock, or, in lock-step, once for every state."""

    ticks: Ticks
    timer: Timer

    def __init__(self) -> None:
        """Declare everything; then, where it is to start by itself, configure and activate."""
        super().__init__("controller")
        self.decision: Decision | None = None
        self.condition = Condition()
        self.reported = -math.inf
        self.commands_given = 0
        self.declare_choices()
        self.create_timer(1.0, self.on_diagnostics)
        self.start()

    def set_up(self) -> None:
        """Load and compile everything; only then publish and subscribe."""
        self.load()
        self.ticks, self.decision = Ticks(self.supervisor.period), None
        self.outputs = Outputs(self, lock_step=self.lock_step)
        self.while_configured.callback(self.outputs.destroy)
        self.publish_configuration()
        self.listen()
        self.offer_changes()

    def listen(self) -> None:
        """Subscribe, and offer services."""
        qos = ros.RELIABLE if self.lock_step else ros.NEWEST
        inputs = [
            (PathMessage, ros.REFERENCE_PATH, self.on_path, ros.LATCHED),
            (Odometry, ros.ODOM, self.on_odometry, qos),
        ]
        if not self.lock_step:  # where the order of odom and steering_state is nobody's promise
            inputs.append((JointState, ros.STEERING_STATE, self.on_steering, ros.NEWEST))
        leave = self.while_configured.callback
        for each in inputs:
            leave(self.destroy_subscription, self.create_subscription(*each))
        reset_stop = self.create_service(Trigger, "~/reset_stop", self.on_reset_stop)
        leave(self.destroy_service, reset_stop)

    def begin(self) -> None:
        """Begin to steer, from the angle in force; plans of an earlier time are forgotten."""
        if self.decision:
            self.supervisor.restart()
        self.ticks.restart()
        self.supervisor.stop_requested = False
        self.outputs.stop(False)
        if not self.lock_step:
            self.timer = self.create_timer(self.supervisor.period, self.on_timer)
            self.while_active.callback(self.destroy_timer, self.timer)
        self.get_logger().info("ready")

    def finish(self) -> None:
        """Leave a safe last command where a car drives: the angle is held, a stop asked for."""
        if not self.lock_step:
            self.outputs.stop(True)
            self.outputs.hold()

    def publish_final(self) -> None:
        """Do the same at the end of the process."""
        if self.is_active:
            self.finish()

    def on_path(self, message: PathMessage) -> None:
        """Take a new path; a bad one is refused and the old one kept.

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
            self.answer_state()

    def on_odometry(self, message: Odometry) -> None:
        """Take the newest state; a bad one is refused and the old one kept."""
        try:
            state = ros.vehicle_state(message)
            if not (self.lock_step and state.stamp_ns == self.supervisor.newest_ns):
                self.take(state)
        except ValueError as error:
            self.reject(error)
            return
        if self.lock_step:
            self.answer_state()
        elif self.ticks.is_deferred:
            self.step()

    def take(self, state: VehicleState) -> None:
        """Give a state to the supervisor; where that starts anew, so does the account of ticks."""
        resets = self.supervisor.resets
        self.supervisor.take_state(state, state.stamp_ns if self.lock_step else self.now_ns)
        if self.supervisor.resets > resets:
            self.get_logger().warning("time went backwards, or the car jumped: controller reset")
            self.ticks.restart()
            self.decision = None

    def on_steering(self, message: JointState) -> None:
        """Take the measured angle."""
        try:
            self.supervisor.take_steering(ros.steering_angle(message).value)
        except ValueError as error:
            self.reject(error)

    def is_answered(self) -> bool:
        """Whether the newest state has its command."""
        newest = self.decision.command.stamp_ns if self.decision else None
        return newest == self.supervisor.newest_ns

    def answer_state(self) -> None:
        """Answer the newest state; one that was answered before gets the same command again."""
        if self.is_answered():
            self.outputs.again()
        else:
            self.step()

    def on_timer(self) -> None:
        """Answer the newest state, once; where there is none, the next one is answered at once."""
        left_out = self.ticks.begin(self.now_ns, self.timer.time_until_next_call())
        if left_out and self.decision:
            self.trouble = f"the timer was late: {left_out} ticks left out"
        if not self.is_answered() or self.supervisor.is_state_late(self.now_ns):
            self.step()
        elif self.ticks.defer_to_next_state():
            self.trouble = "no new odom since the last tick"

    def step(self) -> None:
        """Decide, where that is possible, and publish."""
        if not self.is_active or not self.supervisor.is_ready or self.unrecorded():
            return
        self.ticks.is_deferred = False
        start = time.perf_counter()
        decision = self.supervisor.tick(
            self.supervisor.newest_ns if self.lock_step else self.now_ns
        )
        if decision:
            timing = time.perf_counter() - start, self.ticks.lateness_ns / NANOSECONDS
            self.commands_given += 1
            account = self.rejected, self.ticks.missed, self.commands_given
            self.outputs.decision(decision, timing, account)
            self.decision = decision
            self.tell(decision)

    def tell(self, decision: Decision) -> None:
        """Ask for a stop where that is new, and report at once what has changed."""
        self.outputs.stop(self.supervisor.stop_requested)
        before, now = self.condition, condition(self.supervisor, decision)
        if now != before and time.monotonic() - self.reported > REPORT_PAUSE:
            self.condition = now
            if said := change(before, now):
                self.get_logger().warning(said)
            self.on_diagnostics()

    def on_diagnostics(self) -> None:
        """Report health, once a second and where it has changed."""
        self.reported = time.monotonic()
        if not self.is_active:
            state = self._state_machine.current_state[1]
            self.report(self.now_ns, f"{state}: no commands are given", {}, WARN)
            return
        level, sentence = health(self.supervisor, self.decision, self.now_ns)
        account = {"commands": self.commands_given, "missed_ticks": self.ticks.missed}
        values = account | numbers(self.supervisor, self.decision)
        self.report(self.now_ns, sentence, values, level)

    def on_reset_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Take the request to stop back."""
        self.supervisor.stop_requested = False
        self.outputs.stop(False)
        response.success, response.message = True, "no stop is requested any more"
        return response


def main() -> int:
    """Run the node."""
    return spin(ControllerNode)


if __name__ == "__main__":
    sys.exit(main())
