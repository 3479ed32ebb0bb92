"""Node `gate`: the last station before the car. `ros2 run ampc_ros gate`.

It passes steering command and target speed on, inside the limits of its own guard. When the
controller is late, dead or unsafe, it brakes along the last plan until the car stands. It imports
no compiled code, reads files at its start only, and measures time with the steady clock.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import QoSSubscriptionEventType
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, UInt64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from ampc_msgs_config import ros, topics
from ampc_msgs_config.config import find, load, shipped_or_file
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.nodes.base_node import NO_EVENTS, BaseNode, declare, spin
from ampc_msgs_config.nodes.inputs import Inputs
from ampc_msgs_config.nodes.silent_clock import SilentClock
from ampc_msgs_config.nodes.waiting import WaitLog
from ampc_msgs_config.parameters import (
    ChassisParameters,
    ControllerSettings,
    GuardLimits,
    SteeringParameters,
)
from ampc_msgs_config.quaternions import yaw_of
from ampc_msgs_config.types import ERROR, OK, WARN
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.gate.core import Gate, GateOutput
from ampc_ros.gate.following import MeasuredPose
from ampc_ros.gate.lock_step import LockStepGate
from ampc_ros.gate.settings import DRIVES, STOPS, GateSettings, GateState
from ampc_ros.nodes.drive_messages import OUTPUT, OUTPUTS
from ampc_ros.nodes.gate_lock_step import LockStepAnswers
from ampc_ros.nodes.gate_outputs import GateOutputs, angle_rate, steering_plan
from ampc_ros.nodes.steering_feedback import FEEDBACK, NO_FEEDBACK, choose_feedback

GUARDED = (topics.STEERING_COMMAND, topics.TARGET_SPEED, topics.STEERING_PLAN)
"""Inputs that only one node may publish."""
LARGEST_MESSAGE = 20_000
"""Larger messages of the inputs are refused unread [bytes]."""
LARGEST_PLAN = 400_000
"""The same for plans [bytes]."""
UNSAFE = 1
"""Exit code in lock-step, where nothing can stop the car."""
CONNECT_PERIOD = 0.05
"""Lock-step: wall time between two looks for publishers of the inputs [s]."""
LEVELS = dict.fromkeys(GateState, WARN) | {GateState.DRIVING: OK} | dict.fromkeys(STOPS, ERROR)


class GateNode(BaseNode):
    """Receives what the car is to do, and publishes what it does."""

    has_compiled_code = False
    urgent_events = (
        QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED,
        QoSSubscriptionEventType.RCL_SUBSCRIPTION_LIVELINESS_CHANGED,
    )

    def __init__(self) -> None:
        """Read vehicle, guard and settings; publish nothing before all inputs are complete."""
        super().__init__("gate")
        self.load()
        car, deceleration = (self.steering, self.chassis.wheelbase), self.gate.settings.deceleration
        self.outputs = GateOutputs(self, *car, self.output, deceleration)
        self.command: JointState | None = None
        self.target: ros.Stamped | None = None
        self.rounds = 0
        self.subscribe()
        self.create_service(Trigger, "~/reset", self.on_reset)
        self.outputs.publish_state(self.gate.state)
        self.clock_check = SilentClock(self)
        self.waiting = WaitLog(self, self.waits_for)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self.on_diagnostics, clock=None if self.lock_step else steady)
        if self.lock_step:
            self.connecting = self.create_timer(CONNECT_PERIOD, self.connect, clock=steady)
        else:
            self.create_timer(1.0 / self.rate, self.on_timer, clock=steady)
        self.get_logger().info("ready")

    def load(self) -> None:
        """Declare the parameters, and load the files that they name."""
        vehicle = find(
            "vehicles", declare(self, "vehicle", "paper", "car", shipped_or_file("vehicles"))
        )
        guard = find("guards", declare(self, "guard", "road", "limits", shipped_or_file("guards")))
        text, allowed = "settings of the controller, for its period", shipped_or_file("controllers")
        settings = find("controllers", declare(self, "settings", "table3", text, allowed))
        text = "period of the commands [s]; -1: that of the settings"
        period = declare(self, "period", -1.0, text, (-1.0, 1.0))
        text = "rate of the outputs [Hz]"
        self.rate = declare(self, "rate", 50.0, text, (10.0, 200.0))
        text = "deceleration of a stop [m/s^2]"
        deceleration = declare(self, "deceleration", 2.5, text, (0.5, 8.0))
        text = "age of a steering command that stops the car [s]; -1: 2.5 periods, at least 0.12 s"
        timeout = declare(self, "command_timeout", -1.0, text, (-1.0, 5.0))
        text = "type of drive_command"
        self.output: str = declare(self, "output", OUTPUT, text, list(OUTPUTS))
        text = "type of steering_report, which is published as steering_state"
        feedback = declare(self, "feedback", NO_FEEDBACK, text, FEEDBACK)
        text, allowed = "joints whose mean is the angle", "names, joined by commas; empty: the only"
        joints = declare(self, "feedback_joints", "", text, allowed)
        self.feedback = choose_feedback(feedback, joints)
        if period <= 0.0:
            period = load(ControllerSettings, settings).sample_time
        self.chassis = load_section(ChassisParameters, vehicle, "chassis", "the gate")
        self.steering = load_section(SteeringParameters, vehicle, "steering", "the gate")
        limits = load(GuardLimits, guard)
        chosen = GateSettings(period, max(timeout, 0.0), deceleration)
        self.gate = Gate(limits, self.chassis, chosen)
        self.answers = LockStepAnswers(self, LockStepGate(limits, self.chassis, period))

    def subscribe(self) -> None:
        """Subscribe to all inputs; odometry first, so that it is received before a command."""
        self.inputs = Inputs(self)
        if self.lock_step:
            answers = self.answers
            self.listen(Odometry, topics.ODOM, answers.on_odometry, qos.RELIABLE)
            self.listen(JointState, topics.STEERING_COMMAND, answers.on_command, qos.RELIABLE)
            self.listen(TwistStamped, topics.TARGET_SPEED, answers.on_speed, qos.RELIABLE)
            return
        self.listen(Odometry, topics.ODOM, self.on_odometry, qos.NEWEST)
        if self.feedback:
            self.measured = self.create_publisher(
                JointState, topics.STEERING_STATE, qos.NEWEST, event_callbacks=NO_EVENTS
            )
            self.listen(self.feedback.kind, topics.STEERING_REPORT, self.on_report, qos.NEWEST)
        else:
            self.listen(JointState, topics.STEERING_STATE, self.on_steering, qos.NEWEST)
        profiles = qos.COMMAND, qos.NEWEST
        self.listen(JointTrajectory, topics.STEERING_PLAN, self.on_plan, *profiles)
        self.listen(TwistStamped, topics.TARGET_SPEED, self.on_speed, *profiles)
        watched = qos.controller_command(self.gate.settings.period)
        events = {"deadline": self.on_deadline, "liveliness": self.on_liveliness}
        self.listen(
            JointState, topics.STEERING_COMMAND, self.on_command, watched, *profiles, events=events
        )

    def listen(
        self, kind: Any, topic: str, callback: Callable[[Any], None], *profiles: Any, **how: Any
    ) -> None:
        """Subscribe to a topic, whose messages are refused unread where they are too large.

        In lock-step a refused message ends the process: all nodes would wait for ever.
        """
        most = LARGEST_PLAN if topic == topics.STEERING_PLAN else LARGEST_MESSAGE

        def on_data(data: bytes) -> None:
            try:
                if len(data) > most:
                    raise ValueError(f"{topic}: {len(data)} bytes must be at most {most}")
                callback(ros.decode(data, kind))
            except ValueError as error:
                self.reject(error)
                if self.lock_step:
                    raise SystemExit(UNSAFE) from error

        self.inputs.add(kind, topic, on_data, *profiles, raw=True, **how)

    def on_command(self, message: JointState) -> None:
        """Pass a sound command on at once.

        Raises:
            ValueError: The command is unsafe.
        """
        try:
            angle = ros.steering_angle(message, self.steering).value
        except ValueError as error:
            self.gate.suspect(str(error))
            raise
        rate = angle_rate(message, self.steering)
        if problem := self.gate.take_command(angle, rate, time.monotonic()):
            raise ValueError(problem)
        self.command = message
        self.advance()

    def on_speed(self, message: TwistStamped) -> None:
        """Use a target speed with the next output."""
        target = ros.target_speed(message)
        self.gate.take_speed(target.value, time.monotonic())
        self.target = target

    def on_plan(self, message: JointTrajectory) -> None:
        """Use a plan instead of the last one."""
        self.gate.take_plan(steering_plan(message, self.steering), time.monotonic())

    def on_odometry(self, message: Odometry) -> None:
        """Use the measured pose and speed."""
        position, twist = message.pose.pose.position, message.twist.twist
        q = message.pose.pose.orientation
        yaw = yaw_of(q.x, q.y, q.z, q.w)
        pose = MeasuredPose(position.x, position.y, yaw, twist.linear.x, twist.linear.y)
        self.gate.take_odometry(pose, time.monotonic())

    def on_steering(self, message: JointState) -> None:
        """Use the measured angle."""
        angle = ros.steering_angle(message, self.steering).value
        self.gate.take_measured(angle, time.monotonic())

    def on_report(self, message: Any) -> None:
        """Publish the measured angle of another message type, and use it."""
        assert self.feedback
        if state := self.feedback.state(message, self.now_ns):
            self.on_steering(state)
            self.measured.publish(state)

    def on_deadline(self, _: Any) -> None:
        """Doubt the last command: the middleware has noticed that the next one is late."""
        self.gate.suspect("deadline of steering_command missed")

    def on_liveliness(self, event: Any) -> None:
        """Doubt the last command of a controller that no longer lives."""
        if event.not_alive_count_change > 0:
            self.gate.suspect("the publisher of steering_command has lost its liveliness")

    def on_timer(self) -> None:
        """Publish heartbeat and output."""
        self.rounds += 1
        self.outputs.heartbeat.publish(UInt64(data=self.rounds))
        self.gate.intruders = self.second_publishers()
        self.advance()

    def is_ready(self) -> bool:
        """Return whether there are publishers to the car, and the recorder that is awaited."""
        return self.outputs.connect() and not self.unrecorded()

    def connect(self) -> None:
        """Lock-step: create the publishers to the car, once."""
        if self.outputs.connect():
            self.connecting.cancel()

    def advance(self) -> None:
        """Decide and publish; not before an awaited recorder is there."""
        if not self.is_ready():
            return
        before = self.gate.state
        output = self.gate.step(time.monotonic())
        if output:
            self.publish(output)
        if self.gate.state is not before:
            self.report_change(before)

    def publish(self, output: GateOutput) -> None:
        """Publish an output, with the stamps of what it passes on."""
        command = self.command if output.is_command else None
        now_ns = self.now_ns
        stamp_ns = ros.nanoseconds(command.header.stamp) if command else now_ns
        target = self.target if self.gate.state in DRIVES else None
        now = time.monotonic()
        self.outputs.publish_drive(output, stamp_ns, self.gate.speed_at(now), now)
        self.outputs.publish_steering(output, stamp_ns, command)
        self.outputs.publish_speed(output.speed, target.stamp_ns if target else now_ns)

    def publish_final(self) -> None:
        """Request a stop: nothing passes commands on any more."""
        if self.gate.state in DRIVES and not self.lock_step:
            self.outputs.stops.publish(Bool(data=True))

    def report_change(self, before: GateState) -> None:
        """Publish a new state, with a request to stop where it is one."""
        state = self.gate.state
        self.outputs.publish_state(state)
        line = ": ".join(filter(None, (state.value, self.gate.reason)))
        if state in STOPS:
            self.get_logger().error(line)
        elif state is GateState.DEGRADED:
            self.get_logger().warning(line, throttle_duration_sec=1.0)
        elif before is not GateState.DEGRADED:
            self.get_logger().info(line)
        if state in STOPS or before in STOPS:
            self.on_diagnostics()

    def second_publishers(self) -> str:
        """Return which inputs have more than one publisher, in one sentence; empty: none."""
        sentences = []
        for topic in GUARDED:
            if self.count_publishers(full := self.resolve_topic_name(topic)) > 1:
                each_of = self.get_publishers_info_by_topic(full)
                nodes = [f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in each_of]
                sentences.append(f"{topic} has {len(nodes)} publishers: {', '.join(sorted(nodes))}")
        return "; ".join(sentences)

    def on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Drive again after a stop."""
        before = self.gate.state
        if self.lock_step:
            response.message = "in lock-step the gate never stops the car"
            return response
        self.gate.intruders = self.second_publishers()
        problem = self.gate.reset(time.monotonic())
        response.success = not problem
        response.message = problem or "driving"
        if response.success:
            self.report_change(before)
        return response

    def waits_for(self) -> str:
        """Return which inputs the gate needs to start and why they are missing; empty: none."""
        if not self.lock_step and self.gate.state is not GateState.WAITING:
            return ""
        is_connected = self.lock_step and self.outputs.is_connected
        needed = {topics.STEERING_COMMAND: self.gate.command, topics.TARGET_SPEED: self.gate.target}
        problems = [
            self.inputs.topics[name].problem(is_used=is_connected or each is not None)
            for name, each in needed.items()
        ]
        return "; ".join(filter(None, problems))

    def on_diagnostics(self) -> None:
        """Report state, reason and numbers."""
        gate, now = self.gate, time.monotonic()
        problems = [self.clock_check.problem(), *self.inputs.mismatches()]
        level, sentence = LEVELS[gate.state], ""
        if gate.state is not GateState.DRIVING:
            sentence = ": ".join(filter(None, (gate.state.value, gate.reason)))
        if any(problems):
            level, sentence = max(level, WARN), "; ".join(filter(None, [sentence, *problems]))
        values = {"state": float(list(GateState).index(gate.state)), "rounds": float(self.rounds)}
        values["speed"] = gate.speed_at(now)
        if gate.output:
            values |= {"commanded_speed": gate.output.speed, "angle": gate.output.angle}
        ages = {"command": gate.command, "target_speed": gate.target, "plan": gate.plan}
        values |= {f"{name}_age": now - each.at for name, each in ages.items() if each}
        values |= {f"clipped_{name}": float(count) for name, count in gate.guard.count.items()}
        self.report(self.now_ns, sentence, values, level)


def main() -> int:
    """Run the node."""
    return spin(GateNode)


if __name__ == "__main__":
    sys.exit(main())
