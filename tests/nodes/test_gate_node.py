"""The gate over ROS: lost, frozen, unsafe and doubled publishers, reset, QoS, lock-step."""

import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from ampc_msgs_config import ros, topics
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import NANOSECONDS
from ampc_ros.gate.plan import PlanPoint, SteeringPlan, make_plan
from ampc_ros.gate.settings import GateState
from ampc_ros.nodes import gate_outputs
from ampc_ros.nodes.gate_node import LARGEST_PLAN, UNSAFE, GateNode
from ampc_ros.nodes.gate_outputs import DEADLINE, LEASE, steering_plan
from tests.gate_inputs import ANGLE, PERIOD, SPEED, GateInputs, plan_message
from tests.ros_nodes import add, ros_context, spin_to_the_end, spin_until
from tests.waiting import TIMEOUT

pytestmark = pytest.mark.usefixtures("own_domain")
SLOW = {"command_timeout": 5.0}
"""A loaded machine must not stop the car in tests of something else."""


class Car(Node):
    """Receives what the gate publishes."""

    def __init__(self, executor: SingleThreadedExecutor, gate: GateNode) -> None:
        """Subscribe to everything."""
        super().__init__("car")
        self.executor_of_all, self.gate = executor, gate
        self.angles: list[JointState] = []
        self.speeds: list[TwistStamped] = []
        self.commands: list[TwistStamped] = []
        self.states: list[str] = []
        self.stops: list[bool] = []
        self.reports: list[DiagnosticStatus] = []
        listen = self.create_subscription
        listen(JointState, topics.GATE_STEERING, self.angles.append, qos.RELIABLE)
        listen(TwistStamped, topics.GATE_SPEED, self.speeds.append, qos.RELIABLE)
        listen(TwistStamped, topics.DRIVE_COMMAND, self.commands.append, qos.RELIABLE)
        listen(String, topics.GATE_STATE, self.on_state, qos.LATCHED)
        listen(Bool, topics.STOP_REQUEST, self.on_stop, qos.LATCHED)
        listen(DiagnosticArray, topics.DIAGNOSTICS, self.on_report, qos.RELIABLE)
        self.resetting = self.create_client(Trigger, "gate/reset")
        add(executor, gate, self)

    def on_state(self, message: String) -> None:
        """Store a state."""
        self.states.append(message.data)

    def on_stop(self, message: Bool) -> None:
        """Store a request to stop."""
        self.stops.append(message.data)

    def on_report(self, message: DiagnosticArray) -> None:
        """Store the reports of the gate."""
        self.reports += [each for each in message.status if each.name == "/gate"]

    def wait(self, condition: Callable[[], bool]) -> None:
        """Run the nodes until a condition holds."""
        spin_until(self.executor_of_all, condition)

    def wait_for_state(self, *states: str) -> None:
        """Run the nodes until the gate has one of the states."""
        self.wait(lambda: bool(self.states) and self.states[-1] in states)

    def wait_for_report(self, text: str) -> DiagnosticStatus:
        """Run the nodes until the newest report contains a text, and return the report."""
        self.wait(lambda: bool(self.reports) and text in self.reports[-1].message)
        return self.reports[-1]

    def reset(self) -> Trigger.Response:
        """Call the service of the gate, and return the response."""
        self.wait(self.resetting.service_is_ready)
        future = self.resetting.call_async(Trigger.Request())
        self.wait(future.done)
        return future.result()

    @property
    def path(self) -> list[float]:
        """Angles that were published [rad]."""
        return [message.position[0] for message in self.angles]


@contextmanager
def gated_car(**parameters: object) -> Iterator[tuple[Car, SingleThreadedExecutor]]:
    """Run a gate and a car."""
    with ros_context(**{"vehicle": "ordinary", **parameters}) as executor:
        yield Car(executor, GateNode()), executor


def drive(car: Car, inputs: GateInputs) -> None:
    """Publish the inputs until the gate passes commands on; then go on with a timer."""
    add(car.executor_of_all, inputs)
    inputs.create_timer(PERIOD, inputs.send)
    car.wait_for_state("driving")
    car.wait(lambda: len(car.angles) > 5)


@contextmanager
def process(module: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a module in a process of its own, and kill it at the end."""
    started = subprocess.Popen([sys.executable, "-m", module])
    try:
        yield started
    finally:
        started.kill()
        started.wait(TIMEOUT)


def test_the_gate_imports_no_compiled_code() -> None:
    code = (
        "import sys, ampc_ros.nodes.gate_node;"
        "print(*sorted({n.partition('.')[0] for n in sys.modules}));"
        "print(*sorted(n for n in sys.modules if n.startswith('ampc_')))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    packages, ours = (set(line.split()) for line in done.stdout.splitlines())
    assert "rclpy" in packages
    assert not {"numba", "scipy", "llvmlite", "daqp"} & packages
    parts = ("mpc", "preview", "paper", "controller")
    assert not [name for name in ours if name.startswith(tuple(f"ampc_ros.{p}" for p in parts))]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_dead_or_frozen_controller_stops_the_car_along_its_last_plan(
    number: signal.Signals,
) -> None:
    with gated_car(period=PERIOD) as (car, _), process("tests.gate_inputs") as peer:
        car.wait_for_state("driving")
        car.wait(lambda: len(car.angles) > 20)
        assert set(car.path) == {ANGLE}
        os.kill(peer.pid, number)
        car.wait_for_state("stopped")
        assert car.states[-2] == "stopping"
        assert car.stops[-1]
        speeds = [message.twist.linear.x for message in car.commands]
        assert speeds[-1] == 0.0
        assert speeds == sorted(speeds, reverse=True)
        # The stop of 1.8 m follows the plan of 0.002 rad each 0.3 m; before, it followed by time.
        assert ANGLE + 0.008 < car.path[-1] < ANGLE + 0.03
        assert np.diff(car.path).min() > -0.02
        assert np.diff(car.path).max() < 0.02
        report = car.wait_for_report("no sound steering_command for 0.")
        assert report.level == DiagnosticStatus.ERROR
        response = car.reset()
        assert not response.success
        assert "no sound steering_command for" in response.message
        if number == signal.SIGSTOP:
            held = car.path[-1]
            os.kill(peer.pid, signal.SIGCONT)
            car.wait(lambda: bool(car.reset().success))
            at = len(car.path)
            car.wait_for_state("driving")
            car.wait(lambda: car.path[-1] == ANGLE)
            assert not car.stops[-1]
            assert abs(np.diff([held, *car.path[at:]])).max() < 0.4


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1.0, -0.5], ids=str)
def test_an_unsafe_command_never_reaches_the_car(bad: float) -> None:
    with gated_car(**SLOW) as (car, _):
        inputs = GateInputs()
        drive(car, inputs)
        for inputs.angle in (bad, ANGLE, bad):
            before = len(car.states)
            target = "driving" if inputs.angle == ANGLE else "degraded"
            car.wait(lambda before=before: len(car.states) > before)  # type: ignore[misc]
            car.wait_for_state(target)
        assert "stopping" not in car.states
        assert all(abs(angle - ANGLE) < 0.1 for angle in car.path)
        rejected = car.gate.rejected
        car.wait(lambda: car.gate.rejected > rejected)


def test_unsafe_commands_that_continue_stop_the_car() -> None:
    with gated_car() as (car, _):
        inputs = GateInputs()
        drive(car, inputs)
        inputs.angle = math.nan
        car.wait_for_state("stopping", "stopped")
        report = car.wait_for_report("position[0] = nan must lie in")
        assert report.level == DiagnosticStatus.ERROR


def test_a_second_publisher_stops_the_car_and_both_are_named() -> None:
    with gated_car(**SLOW) as (car, executor):
        drive(car, GateInputs())
        other = Node("intruder")
        other.create_publisher(TwistStamped, topics.TARGET_SPEED, 1)
        add(executor, other)
        car.wait_for_state("stopping", "stopped")
        text = "target_speed has 2 publishers: /controller, /intruder"
        assert car.wait_for_report(text).level == DiagnosticStatus.ERROR
        response = car.reset()
        assert (response.success, response.message) == (False, text)
        executor.remove_node(other)
        other.destroy_node()
        car.wait(lambda: bool(car.reset().success))
        car.wait_for_state("driving")


def test_nothing_is_published_before_the_inputs_are_complete() -> None:
    with gated_car() as (car, executor):
        inputs = GateInputs()
        add(executor, inputs)
        car.wait(lambda: car.gate.outputs.is_connected and car.gate.rounds > 5)
        inputs.create_timer(
            PERIOD / 4, lambda: inputs.commands.publish(ros.joint_message(1, 0.01, 0.0))
        )
        car.wait_for_report("waiting: no target_speed yet")
        assert not car.angles
        assert not car.commands
        assert car.states == ["waiting"]
        response = car.reset()
        assert response.message == "the gate is waiting: there is no stop to reset"


def test_outputs_carry_the_stamps_of_what_they_pass_on_and_the_yaw_rate_of_the_angle() -> None:
    with gated_car(**SLOW) as (car, _):
        drive(car, GateInputs())
        car.wait(lambda: len(car.commands) > 20)
        command = car.commands[-1]
        assert command.twist.linear.x == SPEED
        wheelbase = car.gate.chassis.wheelbase
        assert command.twist.angular.z == pytest.approx(SPEED * math.tan(ANGLE) / wheelbase)
        assert command.header.stamp.nanosec == 0  # that of the inputs
        assert list(car.angles[-1].velocity) == [0.01]
        stamps = [message.header.stamp.sec for message in car.angles]
        assert stamps == sorted(stamps)
        assert stamps[-1] > stamps[0]
        assert {m.header.stamp.nanosec for m in (*car.angles, *car.speeds)} == {0}


def test_the_first_output_is_the_measured_angle(monkeypatch: pytest.MonkeyPatch) -> None:
    with gated_car(**SLOW) as (car, executor):
        inputs = GateInputs()
        steering = inputs.create_publisher(JointState, topics.STEERING_STATE, qos.RELIABLE)
        add(executor, inputs)

        def started() -> bool:
            steering.publish(ros.joint_message(1, -0.2, 0.0))
            inputs.send()
            return bool(car.angles)

        car.wait(lambda: car.gate.count_publishers(topics.STEERING_STATE) > 0)
        is_ready = car.gate.is_ready
        monkeypatch.setattr(
            car.gate, "is_ready", lambda: car.gate.gate.measured is not None and is_ready()
        )
        car.wait(started)
        assert car.path[0] == pytest.approx(-0.2)


def test_a_gate_that_ends_while_driving_requests_a_stop() -> None:
    with gated_car(**SLOW) as (car, _):
        drive(car, GateInputs())
        car.wait(lambda: car.stops == [False])
        car.gate.publish_final()
        car.wait(lambda: car.stops == [False, True])


# QoS


@pytest.mark.parametrize("offered", [qos.COMMAND, qos.NEWEST, qos.LATCHED], ids=qos.profile_text)
def test_a_controller_that_offers_neither_deadline_nor_lease_is_heard(offered: Any) -> None:
    with gated_car(**SLOW) as (car, _):
        drive(car, GateInputs(offered=offered))
        assert not car.gate.inputs.mismatches()


def test_a_car_that_requests_deadline_and_lease_notices_the_end_of_the_gate() -> None:
    with gated_car(**SLOW) as (car, _):
        events: set[str] = set()

        def on_liveliness(event: Any) -> None:
            events.add(f"alive {event.alive_count}")

        car.create_subscription(
            TwistStamped,
            topics.DRIVE_COMMAND,
            lambda _: events.add("command"),
            qos.watched_command(DEADLINE, LEASE),
            event_callbacks=SubscriptionEventCallbacks(
                deadline=lambda _: events.add("deadline"), liveliness=on_liveliness
            ),
        )
        drive(car, GateInputs())
        car.wait(lambda: {"command", "alive 1"} <= events)
        events.clear()
        car.gate.on_timer = lambda: None  # type: ignore[method-assign]
        car.gate.publish = lambda output: None  # type: ignore[method-assign]
        car.wait(lambda: {"deadline", "alive 0"} <= events)


def test_the_middleware_reports_a_controller_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    with gated_car(**SLOW) as (car, executor):
        inputs = GateInputs()
        add(executor, inputs)
        timer = inputs.create_timer(PERIOD, inputs.send)
        car.wait_for_state("driving")
        heard: set[str] = set()
        monkeypatch.setattr(car.gate.gate, "suspect", heard.add)
        timer.cancel()
        car.wait(lambda: len(heard) == 2)
        assert {text.split()[0] for text in heard} == {"deadline", "the"}


# Plans

RATIO = SteeringParameters(max_angle=0.6, ratio=15.0, offset=0.02)


def test_a_plan_is_unpacked_with_ratio_and_offset() -> None:
    plan = steering_plan(plan_message([0.01, 0.02, 0.03, 0.04], steering=RATIO), RATIO)
    assert plan.angles == pytest.approx((0.01, 0.02, 0.03, 0.04))
    assert plan.distances == pytest.approx((0.0, 0.3, 0.6, 0.9))
    assert plan.speeds == pytest.approx((3.0,) * 4)
    assert plan.places == ()


DAMAGES: dict[str, Callable[[Any], object]] = {
    "joint_names = ": lambda m: m.joint_names.reverse(),
    "joint_names = []": lambda m: m.joint_names.clear(),
    "must hold 2 numbers": lambda m: m.points[3].positions.append(0.0),
    "2 numbers each": lambda m: m.points[0].velocities.pop(),
    "accelerations must hold 2": lambda m: m.points[5].accelerations.pop(),
    "must be finite": lambda m: m.points[2].positions.__setitem__(0, math.nan),
    "points must have 2": lambda m: m.points.__delitem__(slice(1, None)),
    "must have at most 2000": lambda m: m.points.extend(m.points * 60),
    "must be greater than": lambda m: m.points[7].time_from_start.__setattr__("nanosec", 1),
    "must be 0 s": lambda m: m.points[0].time_from_start.__setattr__("nanosec", 1),
}


@pytest.mark.parametrize("text", DAMAGES)
def test_a_wrong_plan_is_rejected_with_its_cause(text: str) -> None:
    message = plan_message([0.01 * i for i in range(40)])
    DAMAGES[text](message)
    with pytest.raises(ValueError, match=rf"steering_plan: .*{re.escape(text)}"):
        steering_plan(message, ros.ROAD_WHEEL)


def test_a_wrong_plan_is_counted_and_the_last_one_kept() -> None:
    with gated_car(**SLOW) as (car, _):
        inputs = GateInputs()
        drive(car, inputs)
        inputs.plan = plan_message([math.nan] * 4)
        rejected = car.gate.rejected
        car.wait(lambda: car.gate.rejected > rejected + 2)
        kept = car.gate.gate.plan
        assert kept
        assert kept.plan.angles[0] == pytest.approx(ANGLE)
        car.wait_for_state("degraded")  # the kept plan grows old
        assert "no steering_plan for" in car.gate.gate.reason


def test_a_message_that_is_too_large_is_refused_unread(monkeypatch: pytest.MonkeyPatch) -> None:
    with gated_car(**SLOW) as (car, _):
        inputs = GateInputs()
        drive(car, inputs)
        read: list[int] = []

        def noted(points: list[PlanPoint], *, has_places: bool) -> SteeringPlan:
            read.append(len(points))
            return make_plan(points, has_places=has_places)

        monkeypatch.setattr(gate_outputs, "make_plan", noted)
        inputs.plan = plan_message([0.0, 0.1])
        inputs.plan.header.frame_id = "x" * LARGEST_PLAN
        rejected = car.gate.rejected
        car.wait(lambda: car.gate.rejected > rejected)
        assert len(inputs.plan.points) not in read


def test_an_internal_error_is_counted_and_the_gate_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with gated_car(**SLOW) as (car, executor):
        drive(car, GateInputs())
        step = car.gate.gate.step
        monkeypatch.setattr(car.gate.gate, "step", lambda _: 1 / 0)
        while car.gate.failed.count <= 3:
            car.gate.failed.run_next(executor, timeout=0.1)
        monkeypatch.setattr(car.gate.gate, "step", step)
        count = len(car.angles)
        car.wait(lambda: len(car.angles) > count + 5)
        assert car.states[-1] in ("driving", "degraded")


WRONG = {
    "rate:=9.0": "rate",
    "deceleration:=0.4": "deceleration",
    "vehicle:=none.yaml": "'none.yaml' is neither a file",
    "guard:=none.yaml": "'none.yaml' is neither a file",
    "settings:=none.yaml": "'none.yaml' is neither a file",
}


@pytest.mark.parametrize("parameter", WRONG)
def test_a_wrong_parameter_ends_the_gate_in_one_line(parameter: str) -> None:
    command = [sys.executable, "-m", "ampc_ros.nodes.gate_node", "--ros-args", "-p", parameter]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=False)
    assert done.returncode == 2
    assert WRONG[parameter] in done.stderr
    assert done.stderr.count("error: ") == 1
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("settings", "period"), [("table3", 0.1), ("50hz", 0.02)])
def test_the_period_is_that_of_the_settings_unless_it_is_stated(
    settings: str, period: float
) -> None:
    with ros_context(settings=settings) as executor:
        add(executor, node := GateNode())
        assert node.gate.settings.period == period
    with ros_context(settings=settings, period=0.05, command_timeout=0.4) as executor:
        add(executor, node := GateNode())
        assert node.gate.settings.period == 0.05
        assert node.gate.settings.command_timeout == 0.4


# Lock-step


class LockStepInputs(GateInputs):
    """Publishes states and answers with equal stamps, in any order."""

    def __init__(self) -> None:
        """Create the publishers, with the QoS of lock-step."""
        super().__init__(offered=qos.RELIABLE)
        self.passed: list[tuple[float, float]] = []

    def tick(self, number: int, angle: float, speed: float, *, odometry_first: bool) -> None:
        """Publish the state of a number, and the answers to it."""
        stamp_ns = NANOSECONDS + number * NANOSECONDS // 10
        odometry = Odometry()
        odometry.header.stamp = ros.time_message(stamp_ns)
        odometry.twist.twist.linear.x = speed
        if odometry_first:
            self.odom.publish(odometry)
        self.speeds.publish(ros.speed_message(ros.Stamped(stamp_ns, speed)))
        self.commands.publish(ros.joint_message(stamp_ns, angle, 0.3, RATIO))
        if not odometry_first:
            self.odom.publish(odometry)


@contextmanager
def in_lock_step() -> Iterator[tuple[Car, LockStepInputs]]:
    """Run a gate in lock-step, connected with its inputs."""
    with gated_car(lock_step=True) as (car, executor):
        car.gate.steering = RATIO
        car.gate.outputs.steering = RATIO
        inputs = LockStepInputs()
        add(executor, inputs)
        publishers = inputs.commands, inputs.speeds, inputs.odom
        car.wait(lambda: all(each.get_subscription_count() for each in publishers))
        car.wait(lambda: car.gate.outputs.is_connected)
        car.wait(lambda: all(car.gate.count_subscribers(t) for t in OF_THE_CAR))
        outputs = car.gate.outputs
        car.wait(
            lambda: all(
                each.get_subscription_count()
                for each in (outputs.drive, outputs.angles, outputs.speeds)
            )
        )
        yield car, inputs


OF_THE_CAR = (topics.DRIVE_COMMAND, topics.GATE_STEERING, topics.GATE_SPEED)


def test_in_lock_step_each_command_passes_unchanged_with_its_stamp() -> None:
    rng = np.random.default_rng(1)
    angles = np.cumsum(rng.uniform(-0.01, 0.01, 40)).tolist()
    with in_lock_step() as (car, inputs):
        for i, angle in enumerate(angles):
            inputs.tick(i, angle, 9.0 + 0.1 * i, odometry_first=i % 2 == 0)
            car.wait(lambda count=i + 1: len(car.commands) == count)  # type: ignore[misc]
        assert car.path == [RATIO.position(angle) for angle in angles]
        assert {tuple(message.velocity) for message in car.angles} == {(15.0 * 0.3,)}
        expected = [NANOSECONDS + i * NANOSECONDS // 10 for i in range(40)]
        for messages in (car.angles, car.speeds, car.commands):
            assert [ros.nanoseconds(m.header.stamp) for m in messages] == expected
        assert [m.twist.linear.x for m in car.speeds] == [9.0 + 0.1 * i for i in range(40)]
        assert car.states in (["waiting", "driving"], ["driving"])  # the latched one is the newest
        assert car.reset().message == "in lock-step the gate never stops the car"


def test_in_lock_step_an_unsafe_command_ends_the_gate() -> None:
    with in_lock_step() as (car, inputs):
        inputs.tick(0, math.nan, 9.0, odometry_first=True)
        assert spin_to_the_end(car.executor_of_all) == UNSAFE


def test_in_lock_step_a_second_publisher_ends_the_gate() -> None:
    with in_lock_step() as (car, inputs):
        other = GateInputs("intruder")
        add(car.executor_of_all, other)
        car.wait(lambda: car.gate.count_publishers(topics.STEERING_COMMAND) == 2)
        inputs.tick(0, 0.01, 9.0, odometry_first=True)
        assert spin_to_the_end(car.executor_of_all) == UNSAFE


def test_states_are_the_words_of_the_documentation() -> None:
    assert [state.value for state in GateState] == [
        "waiting", "driving", "degraded", "stopping", "stopped",
    ]  # fmt: skip
