"""Node `controller`: path and state in, steering out. `ros2 run ampc_ros controller`."""

import math
import pickle
import sys
import time
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from rclpy.timer import Timer
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import spin
from ampc_msgs_config.nodes.failed_callbacks import shortened
from ampc_msgs_config.nodes.inputs import Inputs
from ampc_msgs_config.nodes.silent_clock import SilentClock
from ampc_msgs_config.nodes.sole_sources import SoleSources
from ampc_msgs_config.nodes.waiting import WaitLog
from ampc_msgs_config.types import ERROR, NANOSECONDS, WARN, Array, TickRecord
from ampc_ros.nodes.background import NICENESS, Background
from ampc_ros.nodes.configured_node import ConfiguredNode
from ampc_ros.nodes.fixed_frame import FixedFrame
from ampc_ros.nodes.initial_angle import START_WAIT, InitialAngle
from ampc_ros.nodes.managed_node import lifecycle_state
from ampc_ros.nodes.received_path import (
    BuiltPath,
    PathRequest,
    RepeatedPath,
    build_path,
    header_of,
    prepare,
)
from ampc_ros.nodes.watchdog import WATCH_PERIOD, Watchdog, silence_limit
from ampc_ros.ros import Outputs
from ampc_ros.supervision.health import (
    Condition,
    condition,
    describe_change,
    health,
    health_numbers,
)
from ampc_ros.supervision.playback import PlaybackAdvice
from ampc_ros.supervision.tick_policy import Action, TickPolicy

REPORT_PAUSE = 0.1
"""Shortest wall time between two reports of changes [s]."""


class ReceivedPath(NamedTuple):
    """A serialised path, before it is built."""

    data: bytes
    stamp_ns: int
    arrival_ns: int
    frame_id: str


class ControllerNode(ConfiguredNode):
    """Steers on a timer of the node's clock, or in lock-step once for every state.

    In real time another process builds the path, so that a large one does not delay a command. The
    executor takes the result between two callbacks. In lock-step everything is synchronous.
    """

    policy: TickPolicy
    timer: Timer
    builder: Background | None = None
    inputs: Inputs
    frame: FixedFrame

    def __init__(self) -> None:
        """Declare everything; configure and activate where `autostart` is true."""
        super().__init__("controller")
        self.failure = ""
        self.condition = Condition()
        self.reported = -math.inf
        self.commands = 0
        """Number of published commands."""
        self.was_silent = False
        """Whether a stop is requested because commands were missing; until it is taken back."""
        self.declare_choices()
        self.clock_check = SilentClock(self)
        self.playback = PlaybackAdvice()
        self.initial, self.watchdog = InitialAngle(self), Watchdog(self, lambda: self.now_ns)
        # In real time, the clock that no other clock can stop.
        clock = None if self.lock_step else Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self.on_diagnostics, clock=clock)
        self.waiting = WaitLog(self, self.waits_for)
        self.start()

    def set_up(self) -> None:
        """Load and compile everything; only then publish and subscribe."""
        self.start_builder()
        self.load()
        self.frame = FixedFrame(self, self.get_parameter("fixed_frame").value)
        self.newest_path: ReceivedPath | None = None
        self.path_frame = self.child_frame = ""
        self.policy = TickPolicy(self.supervisor, lock_step=self.lock_step)
        self.outputs = Outputs(self, self.supervisor.period, lock_step=self.lock_step)
        self.while_configured.callback(self.outputs.destroy)
        self.publish_configuration()
        self.subscribe()
        self.offer_changes()

    def subscribe(self) -> None:
        """Subscribe to all inputs and offer the service `~/reset_stop`."""
        self.inputs = inputs = Inputs(self)
        self.while_configured.callback(inputs.destroy)
        qos = ros.RELIABLE if self.lock_step else ros.NEWEST
        on_path = self.on_path if self.lock_step else self.on_serialized_path
        raw = not self.lock_step
        inputs.add(PathMessage, ros.REFERENCE_PATH, on_path, *ros.ANY_PUBLISHER, raw=raw)
        inputs.add(Odometry, ros.ODOM, self.on_odometry, qos)
        if not self.lock_step:  # there, the order of odom and steering_state is undefined
            inputs.add(JointState, ros.STEERING_STATE, self.on_steering, ros.NEWEST, polled=True)
            self.initial.listen(self.supervisor.config.steering)
            self.while_configured.callback(self.initial.close)
        listed = [ros.STEERING_COMMAND, ros.REFERENCE_PATH]
        self.sources = SoleSources(
            self, {ros.ODOM: Odometry}, listed, self.on_conflict, lock_step=self.lock_step
        )
        self.while_configured.callback(self.sources.destroy)
        reset_stop = self.create_service(Trigger, "~/reset_stop", self.on_reset_stop)
        self.while_configured.callback(self.destroy_service, reset_stop)

    def start_builder(self) -> None:
        """Start the process that builds paths, in real time."""
        if not self.lock_step:
            self.path_ready = self.create_guard_condition(self.on_built_path)
            self.while_configured.callback(self.destroy_guard_condition, self.path_ready)
            self.restart_builder()
            self.while_configured.callback(self.stop_builder)

    def restart_builder(self) -> None:
        """Start another process."""
        self.built, self.repeated = BuiltPath(None, None), RepeatedPath()
        self.builder = Background(self.path_ready.trigger, NICENESS)
        self.builder.submit(None, prepare)

    def stop_builder(self) -> None:
        """End the process that builds paths."""
        if self.builder:
            self.builder.close()

    def destroy_node(self) -> None:
        """End the background processes with the node."""
        self.stop_builder()
        self.stop_loader()
        super().destroy_node()

    def begin(self) -> None:
        """Start to steer from the angle in force; earlier plans are forgotten."""
        if self.policy.record and self.lock_step:
            self.supervisor.restart()
        self.policy.restart_timer()
        self.withdraw_stop()
        if not self.lock_step:
            self.initial.begin(self.supervisor.steering if self.commands else math.nan)
            self.timer = self.create_timer(self.supervisor.period, self.on_timer)
            self.while_active.callback(self.destroy_timer, self.timer)
            self.watchdog.restart(START_WAIT)
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            watch = self.create_timer(WATCH_PERIOD, self.on_watch, clock=steady)
            self.while_active.callback(self.destroy_timer, watch)
        self.get_logger().info("ready")

    def finish(self) -> None:
        """Publish a safe last command in real time: the angle is held, a stop is requested."""
        if not self.lock_step:
            self.stop_and_hold()
            self.store()
            self.initial.listen(self.supervisor.config.steering)

    def stop_and_hold(self) -> None:
        """Request a stop and publish the last angle once more."""
        self.outputs.request_stop(True)
        self.outputs.hold()

    def publish_final(self) -> None:
        """Publish the safe last command at the end of the process."""
        if self.is_active:
            self.finish()
        self.estimates.wait()

    def on_path(self, message: PathMessage) -> None:
        """Use a new path at once; an invalid one is rejected and the old one kept.

        Raises:
            ValueError: In lock-step there is no old one: all nodes would wait for ever.
        """
        stamp_ns, frame_id = ros.nanoseconds(message.header.stamp), message.header.frame_id
        now_ns = stamp_ns if self.lock_step else self.now_ns
        try:
            points: Array = np.array(ros.path_points(message), dtype=float).reshape(-1, 2)
            points = self.frame.shift(frame_id, stamp_ns).apply(points)
            self.supervisor.take_path(points, stamp_ns, now_ns)
            self.path_frame = frame_id
        except ValueError as error:
            if self.lock_step and self.supervisor.path is None:
                raise
            self.reject(error)
        if self.lock_step:
            self.act(self.policy.on_input())

    def on_serialized_path(self, data: bytes) -> None:
        """Have a new path built; an invalid one is rejected and the old one kept."""
        try:
            stamp_ns, frame_id = header_of(data)
            ros.require_frame(ros.REFERENCE_PATH, frame_id)
        except ValueError as error:
            self.reject(error)
            return
        if not stamp_ns and not self.supervisor.config.static_path and self.now_ns > NANOSECONDS:
            self.trouble = "reference_path: header.stamp = 0 must be the time of the path"
        self.newest_path = ReceivedPath(data, stamp_ns, self.now_ns, frame_id)
        try:
            self.request_path()
        except ValueError as error:
            self.reject(error)

    def request_path(self) -> None:
        """Have the newest path built in the fixed frame.

        Raises:
            ValueError: There is no transform into the fixed frame; the path is kept.
        """
        received, config = self.newest_path, self.supervisor.config
        if received is None:
            return
        shift = self.frame.shift(received.frame_id, received.stamp_ns)
        noise = config.settings.known_path_noise
        request = PathRequest(shift, config.chassis, config.max_angle, noise)
        self.newest_path = None if self.frame.name else received
        assert self.builder
        tag = received._replace(data=b""), self.frame.name
        if self.repeated.matches(received.data, request):
            self.use_path(*tag, BuiltPath(None, None))
            return
        self.repeated.submit(tag, received.data, request)
        self.builder.submit(tag, build_path, pickle.PickleBuffer(received.data), request)

    def on_built_path(self) -> None:
        """Use a path that the other process has built."""
        assert self.builder
        for tag, outcome in self.builder.take():
            try:
                built = outcome.result()
                if tag:
                    received, fixed_frame = tag
                    self.use_path(received, fixed_frame, built)
                    self.repeated.complete(tag)
            except ValueError as error:
                self.reject(error)
        if not self.builder.is_alive:
            self.restart_builder()

    def use_path(self, received: ReceivedPath, fixed_frame: str, built: BuiltPath) -> None:
        """Use a path, unless the first odometry has come in another frame in the meantime.

        Raises:
            ValueError: The controller cannot follow it; the last valid path is kept.
        """
        self.built = self.built if built.points is None else built
        assert self.built.points is not None
        if self.frame.name in (fixed_frame, received.frame_id):
            times = received.stamp_ns, received.arrival_ns
            self.supervisor.take_path(self.built.points, *times, self.built.path)
            self.path_frame = received.frame_id

    def on_odometry(self, message: Odometry) -> None:
        """Use the newest state; an invalid one is rejected and the old one kept."""
        try:
            state = ros.vehicle_state(message)
            self.check_frames(message)
            restarted = self.policy.take_state(state, self.now_ns)
        except ValueError as error:
            self.reject(error)
            return
        if restarted:
            self.get_logger().warning("time went backwards, or the car jumped: controller reset")
        self.act(self.policy.on_input())

    def check_frames(self, message: Odometry) -> None:
        """Check the frames of odometry; the first one decides whether the path can be used.

        Raises:
            ValueError: The frame differs from the fixed frame.
        """
        child = message.child_frame_id or "(empty)"
        if child != self.child_frame and child.rpartition("/")[2] != ros.BASE_LINK:
            meant = f"is taken for {ros.BASE_LINK}, see the parameter base_link_to_cg"
            self.trouble = f"odom: child_frame_id = {child!r} {meant}"
        self.child_frame = child
        is_first = not self.frame.name
        self.frame.accept(message.header.frame_id)
        if not is_first:
            return
        kept, name = self.newest_path, self.frame.name
        if self.path_frame not in ("", name):
            self.supervisor.forget()
        if kept and kept.frame_id == name:
            self.newest_path = None
        elif kept:
            self.request_path()
        elif self.path_frame:  # it was taken at once
            self.frame.shift(self.path_frame, 0)

    def on_steering(self, message: JointState) -> None:
        """Use the measured angle."""
        try:
            angle = ros.steering_angle(message, self.supervisor.config.steering).value
            self.supervisor.take_steering(angle)
            self.initial.on_measured(angle)
        except ValueError as error:
            self.reject(error)

    def on_timer(self) -> None:
        """Answer the newest state, or defer the tick to the next one."""
        missed = self.policy.missed
        action = self.policy.on_timer(self.now_ns, self.timer.time_until_next_call())
        if self.policy.left_out and self.policy.record:
            self.trouble = f"the timer was late: {self.policy.left_out} ticks left out"
        if self.policy.missed > missed + self.policy.left_out:
            self.trouble = "no new odom since the last tick"
        self.act(action)

    def act(self, action: Action) -> None:
        """Tick, or publish the newest command once more."""
        if action is Action.TICK:
            self.step()
        elif action is Action.REPEAT:
            self.outputs.repeat()

    def step(self) -> None:
        """Tick and publish, where inputs, life cycle and recorder allow it.

        In real time a tick that raises leaves the last angle and a requested stop.
        """
        if not self.is_active or not self.supervisor.is_ready or self.unrecorded():
            return
        if not self.lock_step:
            self.inputs.topics[ros.STEERING_STATE].read()
        if self.initial.is_pending and not self.has_started():
            return
        start = time.perf_counter()
        now_ns = self.supervisor.newest_ns if self.lock_step else self.now_ns
        try:
            record = self.policy.tick(now_ns)
        except Exception:
            if not self.lock_step:
                self.stop_and_hold()
            raise
        if record:
            timing = time.perf_counter() - start, self.policy.lateness_ns / NANOSECONDS
            self.commands += 1
            account = self.rejected, self.policy.missed, self.commands
            steering = self.supervisor.config.steering
            self.outputs.publish_tick(record, timing, account, steering, self.frame.name)
            self.report_change(record)
            self.outputs.publish_plan(self.supervisor, now_ns)
            self.outputs.publish_memory(self.supervisor, self.commands)

    def has_started(self) -> bool:
        """Start from the angle of the wheel as soon as it is known."""
        start = self.initial.choose()
        if start is None:
            return False
        self.get_logger().info(start.origin)
        if not math.isnan(start.angle):
            self.supervisor.start_from(start.angle)
        return True

    def on_watch(self) -> None:
        """Request a stop and hold the angle where inputs are complete but no command follows."""
        if not self.supervisor.is_ready or self.wait_for_recorder:
            self.watchdog.restart(START_WAIT)
            return
        before, late = self.watchdog.problem, self.supervisor.config.settings.state_late
        problem = self.watchdog.check(silence_limit(self.supervisor.period, late))
        if not problem:
            return
        self.was_silent = True
        self.stop_and_hold()
        left_ns = self.timer.time_until_next_call() or 0
        if left_ns > self.supervisor.period * NANOSECONDS:  # a system clock that went back
            self.timer.reset()
        if not before:
            self.get_logger().error(f"{problem}: a stop is requested")
            self.on_diagnostics()

    def report_change(self, record: TickRecord) -> None:
        """Request a stop where that is new, and report a changed condition at once."""
        self.watchdog.on_command()
        is_doubtful = self.was_silent or bool(self.sources.conflict)
        self.outputs.request_stop(self.supervisor.stop_requested or is_doubtful)
        failure = shortened(self.supervisor.failure)
        if failure and failure != self.failure:
            self.get_logger().warning(failure)
        self.failure, self.trouble = failure, failure or self.trouble
        before, now = self.condition, condition(self.supervisor, record)
        if now != before and time.monotonic() - self.reported > REPORT_PAUSE:
            self.condition, self.reported = now, time.monotonic()
            if line := describe_change(before, now):
                self.get_logger().warning(line)
            self.on_diagnostics()

    def on_conflict(self) -> None:
        """Request a stop after a second publisher of a topic, until it is taken back."""
        if self.is_active:
            self.outputs.request_stop(True)
        self.on_diagnostics()

    def on_diagnostics(self) -> None:
        """Report health once a second and after a change."""
        if not self.is_active:
            state = lifecycle_state(self)
            self.report(self.now_ns, f"{state}: no commands are published", {}, WARN)
            return
        level, sentence = health(self.supervisor, self.policy.record, self.now_ns)
        advice = self.playback.take(self.supervisor, self.now_ns, time.monotonic())
        if self.playback.is_new(advice):
            self.get_logger().error(advice)
        problems = [self.clock_check.problem(), *self.inputs.mismatches(), self.uncertified, advice]
        if fault := self.watchdog.problem or self.sources.conflict:
            level, sentence = ERROR, f"{fault}: a stop is requested"
        elif self.was_silent:
            problems.append("a stop is requested after a silence; ~/reset_stop takes it back")
        if any(problems):
            level, sentence = max(level, WARN), "; ".join(filter(None, [sentence, *problems]))
        account = {"commands": self.commands, "missed_ticks": self.policy.missed}
        values = account | health_numbers(self.supervisor, self.policy.record)
        self.report(self.now_ns, sentence, values, level)
        if self.frame.name:
            with suppress(ValueError):  # still no transform
                self.request_path()

    def waits_for(self) -> str:
        """Return which inputs are missing and why; empty: none, or the node is not active."""
        if not self.is_active:
            return ""
        odom, paths = self.inputs.topics[ros.ODOM], self.inputs.topics[ros.REFERENCE_PATH]
        path = paths.problem(is_used=self.supervisor.path is not None, is_periodic=False)
        kept, frame = self.newest_path, self.frame.name
        if path and kept and frame not in ("", kept.frame_id):
            path = f"a transform of {ros.REFERENCE_PATH} from {kept.frame_id!r} into {frame!r}"
        return "; ".join(
            filter(None, [odom.problem(is_used=self.supervisor.state is not None), path])
        )

    def withdraw_stop(self) -> None:
        """Take back the request to stop, whatever its cause."""
        self.supervisor.clear_stop()
        self.sources.clear()
        self.was_silent = False
        self.outputs.request_stop(False)

    def on_reset_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Take back the request to stop."""
        self.withdraw_stop()
        response.success, response.message = True, "no stop is requested any more"
        return response


def main() -> int:
    """Run the node."""
    return spin(ControllerNode)


if __name__ == "__main__":
    sys.exit(main())
