"""Node `controller`: path and state in, steering out. `ros2 run ampc_ros controller`."""

import math
import sys
import time
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.base_node import declare, spin
from ampc_msgs_config.managed_node import ManagedNode
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import CONTROLLERS, Choices, configuration, gain_file
from ampc_ros.controller import warm_up
from ampc_ros.health import health, numbers
from ampc_ros.ros import Outputs
from ampc_ros.supervisor import Decision, Supervisor, rehearse
from ampc_ros.ticks import Ticks

RUN_TIME = ("settings", "gain_table", "guard", "static_path")
"""What a running controller may exchange."""
REPORT_PAUSE = 0.1
"""Least wall time between two reports of changes [s]."""


class ControllerNode(ManagedNode):
    """Steers on a timer of the node's clock, or, in lock-step, once for every state."""

    supervisor: Supervisor
    outputs: Outputs
    ticks: Ticks
    timer: Timer

    def __init__(self) -> None:
        """Declare everything; then, where it is to start by itself, configure and activate."""
        super().__init__("controller")
        self.decision: Decision | None = None
        self.condition: tuple[float, ...] = ()
        self.reported = -math.inf
        self.commands_given = 0
        self.declare_choices()
        self.start()

    def declare_choices(self) -> None:
        """Declare the parameters that say what the controller is made of."""
        default, offer = Choices(), partial(declare, self)
        offer("controller", default.controller, "which one", list(CONTROLLERS))
        offer("vehicle", default.vehicle, "shipped vehicle, or YAML file")
        offer("base_link_to_cg", -1.0, "odom to centre of gravity [m]; -1: rear axle", (-1, 20))
        offer = partial(declare, self, at_run_time=True)
        offer("settings", default.settings, "shipped limits, or YAML file")
        offer("gain_table", default.gain_table, "shipped gains, or YAML file")
        offer("guard", default.guard, "shipped limits of the guard, or YAML file")
        offer("static_path", self.lock_step, "the path is published once and does not grow old")
        offer("qp_fault", False, "let every solution fail, to see what happens")

    def choices(self, changed: dict[str, Any]) -> Choices:
        """Give what the parameters choose, some of them changed."""
        chosen = {name: self.get_parameter(name).value for name in Choices._fields[:-1]}
        chosen |= {key: value for key, value in changed.items() if key in chosen}
        if chosen["base_link_to_cg"] < 0:
            chosen["base_link_to_cg"] = None
        simulated = self.lock_step or bool(self.get_parameter("use_sim_time").value)
        return Choices(**chosen, simulated_time=simulated)

    def set_up(self) -> None:
        """Load and compile everything; only then publish and subscribe."""
        self.load()
        self.ticks, self.decision = Ticks(self.supervisor.period), None
        self.outputs = Outputs(self, lock_step=self.lock_step)
        self.while_configured.callback(self.outputs.destroy)
        self.publish_configuration()
        self.listen()

    def load(self) -> None:
        """Make a supervisor, or exchange what it is made of: the angle in force is kept."""
        choices = self.choices({})
        made, source = configuration(choices), gain_file(choices)
        if hasattr(self, "supervisor"):
            self.supervisor.reset()
            self.supervisor.reconfigure(made, source)
        else:
            self.supervisor = Supervisor(made, source)
        ladder = self.supervisor.ladder
        warm_up(ladder.controller)
        ladder.restart(self.supervisor.steering)
        ladder.qp_fault = self.get_parameter("qp_fault").value
        rehearse(made)

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
        for name, answer in (("reload", self.on_reload), ("reset_stop", self.on_reset_stop)):
            leave(self.destroy_service, self.create_service(Trigger, f"~/{name}", answer))
        self.add_on_set_parameters_callback(self.on_parameters)
        leave(self.remove_on_set_parameters_callback, self.on_parameters)

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
        reporting = self.create_timer(1.0, self.on_diagnostics)
        self.while_active.callback(self.destroy_timer, reporting)
        self.get_logger().info("ready")

    def finish(self) -> None:
        """Leave a safe last command where a car drives: the angle is held, a stop asked for."""
        if not self.lock_step:
            self.outputs.hold()
            self.outputs.stop(True)

    def say_last(self) -> None:
        """Do the same at the end of the process."""
        if self.is_active:
            self.finish()

    def on_path(self, message: PathMessage) -> None:
        """Take a new path; a bad one is refused and the old one kept."""
        stamp_ns = ros.nanoseconds(message.header.stamp)
        now_ns = stamp_ns if self.lock_step else self.now_ns
        try:
            self.supervisor.take_path(ros.path_points(message), stamp_ns, now_ns)
        except ValueError as error:
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
        elif self.ticks.owed:
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
        elif self.ticks.owe():
            self.trouble = "no new odom since the last tick"

    def step(self) -> None:
        """Decide, where that is possible, and publish."""
        if not self.is_active or not self.supervisor.is_ready or self.unrecorded():
            return
        self.ticks.owed = False
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
        told = decision.supervision
        condition = told.rung, told.reason, told.clipped
        if condition != self.condition and time.monotonic() - self.reported > REPORT_PAUSE:
            self.condition = condition
            self.on_diagnostics()

    def on_diagnostics(self) -> None:
        """Report health."""
        self.reported = time.monotonic()
        level, sentence = health(self.supervisor, self.decision, self.now_ns)
        account = {"commands": self.commands_given, "missed_ticks": self.ticks.missed}
        values = account | numbers(self.supervisor, self.decision)
        self.report(self.now_ns, sentence, values, level)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Use new values, all at once, or refuse them all; the steering goes on where it is."""
        changed = {each.name: each.value for each in parameters}
        try:
            if set(changed) & set(RUN_TIME):
                self.reconfigure(self.choices(changed))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        ladder = self.supervisor.ladder
        ladder.qp_fault = changed.get("qp_fault", ladder.qp_fault)
        return SetParametersResult(successful=True)

    def reconfigure(self, choices: Choices) -> None:
        """Go on with what was chosen; where that is wrong, with what there was."""
        made, period = configuration(choices), self.supervisor.period
        if made.settings.sample_time != period:
            raise ValueError(
                f"sample_time = {made.settings.sample_time:g} s must stay {period:g} s while the "
                "controller is configured"
            )
        self.supervisor.reconfigure(made, gain_file(choices))
        self.publish_configuration()

    def publish_configuration(self) -> None:
        """Say what the controller is made of now."""
        self.outputs.configuration(self.supervisor)
        self.get_logger().info(f"configuration {self.supervisor.number} in use")

    def on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Read gains, limits and guard from their files again; a bad one changes nothing."""
        try:
            self.reconfigure(self.choices({}))
        except ValueError as error:
            self.get_logger().error(f"not reloaded: {error}")
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, f"configuration {self.supervisor.number}"
        return response

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
