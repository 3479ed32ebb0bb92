"""Publishers that are not ours: their QoS, frames, windows and sizes, over a real ROS graph."""

import math
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from ampc_msgs_config import ros
from ampc_msgs_config.config import shipped
from ampc_msgs_config.nodes import serialized_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from tests.nodes.test_reports import report_of
from tests.ros_nodes import add, ros_context, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")

DURABILITIES = {
    "volatile": DurabilityPolicy.VOLATILE,
    "transient local": DurabilityPolicy.TRANSIENT_LOCAL,
}
RELIABILITIES = {
    "reliable": ReliabilityPolicy.RELIABLE,
    "best effort": ReliabilityPolicy.BEST_EFFORT,
}
QOS = {
    f"{durability}, {reliability}": QoSProfile(
        depth=1, durability=DURABILITIES[durability], reliability=RELIABILITIES[reliability]
    )
    for durability in DURABILITIES
    for reliability in RELIABILITIES
}
PERIOD = 0.02
"""Time between two states of the car [s]."""
WHEELBASE = 2.7
"""Of the kinematic car [m]."""
SPEED = 8.0
"""Speed of the kinematic car [m/s]."""
STRAIGHT = np.column_stack((np.arange(0.0, 400.0, 2.0), np.zeros(200)))


def sine(s: Any) -> Array:
    """Return points (n, 2) of a gentle slalom at the given x [m]."""
    return np.column_stack((s, 1.5 * np.sin(s / 12.0)))


class Foreign(Node):
    """A kinematic bicycle, and a planner of its own.

    With `use_sim_time` it publishes the clock: time stands still while the machine has no time for
    this process, so that no state is late because of that.
    """

    def __init__(
        self,
        executor: SingleThreadedExecutor,
        controller: ControllerNode,
        qos: QoSProfile = QOS["volatile, reliable"],
        frame: str = "map",
    ) -> None:
        """Create all publishers; the car stands until `drive_for`.

        Args:
            executor: Executor of all nodes.
            controller: Controller under test.
            qos: QoS of the path.
            frame: Frame of the odometry.
        """
        super().__init__("foreign")
        self.executor_of_all, self.controller, self.frame = executor, controller, frame
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, qos)
        self.odom = self.create_publisher(Odometry, ros.ODOM, 1)
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.on_steering, 1)
        self.x, self.y, self.yaw, self.steering, self.commands = 0.0, 0.0, 0.0, 0.0, 0
        self.track: list[tuple[float, float]] = []
        self.last = time.monotonic()
        self.wall = Clock(clock_type=ClockType.STEADY_TIME)
        self.simulated_ns = NANOSECONDS if self.get_parameter("use_sim_time").value else 0
        if self.simulated_ns:
            self.clocks = self.create_publisher(ClockMessage, ros.CLOCK, 1)
            self.create_timer(PERIOD, self.publish_clock, clock=self.wall)
        add(executor, self, controller)

    @property
    def now_ns(self) -> int:
        """Time of the node's clock [ns]."""
        return self.simulated_ns or int(self.get_clock().now().nanoseconds)

    def publish_clock(self) -> None:
        """Publish the simulated time."""
        self.clocks.publish(ClockMessage(clock=ros.time_message(self.simulated_ns)))

    def pass_time(self) -> float:
        """Return the time since the last call, at most 0.1 s [s]; simulated time advances."""
        if self.simulated_ns:
            self.simulated_ns += round(PERIOD * NANOSECONDS)
            self.publish_clock()
            return PERIOD
        now = time.monotonic()
        elapsed, self.last = min(now - self.last, 0.1), now
        return elapsed

    def on_steering(self, message: JointState) -> None:
        """Turn the wheels."""
        self.steering, self.commands = message.position[0], self.commands + 1

    def publish_path(self, points: Array, frame: str = "map", stamp_ns: int | None = None) -> None:
        """Publish a path with the stamp of now, poses without a frame."""
        stamp_ns = self.now_ns if stamp_ns is None else stamp_ns
        message = ros.path_message(points, stamp_ns, frame)
        for pose in message.poses:
            pose.header = type(pose.header)()
        self.paths.publish(message)

    def on_drive(self) -> None:
        """Move the car by the time that has passed, and publish its state."""
        dt = self.pass_time()
        rate = SPEED * math.tan(self.steering) / WHEELBASE
        self.x += SPEED * math.cos(self.yaw) * dt
        self.y += SPEED * math.sin(self.yaw) * dt
        self.yaw += rate * dt
        self.track.append((self.x, self.y))
        self.publish_state(rate)

    def publish_state(self, yaw_rate: float = 0.0, stamp_ns: int | None = None) -> None:
        """Publish the state of the car."""
        stamp_ns = self.now_ns if stamp_ns is None else stamp_ns
        state = VehicleState(stamp_ns, self.x, self.y, self.yaw, SPEED, 0.0, yaw_rate)
        self.odom.publish(ros.odometry_message(state, self.frame))

    def drive_for(self, commands: int) -> None:
        """Drive until so many further commands have arrived."""
        known, self.last = self.commands, time.monotonic()
        timer = self.create_timer(PERIOD, self.on_drive, clock=self.wall)
        self.spin_until(lambda: self.commands >= known + commands)
        self.destroy_timer(timer)

    def spin_until(self, condition: Any) -> None:
        """Run all nodes until a condition holds."""
        spin_until(self.executor_of_all, condition)

    def report(self) -> str:
        """Return the sentence of the controller's diagnostics."""
        return str(report_of(self.controller).message)


@pytest.fixture
def executor() -> Iterator[SingleThreadedExecutor]:
    """The executor of a controller that is quickly compiled."""
    with ros_context(controller="pure_pursuit", static_path="true") as nodes:
        yield nodes


@pytest.mark.parametrize("offered", QOS)
def test_a_path_arrives_once_from_publishers_of_any_qos(
    offered: str, executor: SingleThreadedExecutor
) -> None:
    node = ControllerNode()
    world = Foreign(executor, node, QOS[offered])
    world.spin_until(lambda: world.paths.get_subscription_count() > 0)
    received: list[bytes] = []
    entry, used = node.inputs.topics[ros.REFERENCE_PATH], node.on_serialized_path

    def on_data(data: bytes) -> None:
        received.append(data)
        used(data)

    entry.callback = on_data
    if "volatile" in offered:  # all subscriptions that the chain creates for another publisher
        latched = world.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        latched.publish(ros.path_message(sine(np.arange(0.0, 50.0)), world.now_ns))
        world.spin_until(lambda: len(received) == 1)
        world.spin_until(lambda: node.supervisor.path is not None)
    known = len(received)

    def is_received() -> bool:
        if len(received) == known:
            world.publish_path(STRAIGHT, stamp_ns=0)
        return len(received) > known

    world.spin_until(is_received)
    world.spin_until(
        lambda: node.supervisor.path is not None and len(node.supervisor.path.value.x) > 1000
    )
    assert len(set(received)) == len(received)
    world.drive_for(3)
    assert "QoS" not in world.report()
    assert "offers" not in world.report()


def test_a_path_that_was_latched_before_the_controller_starts_arrives(
    executor: SingleThreadedExecutor,
) -> None:
    early = Node("early")
    publisher = early.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
    publisher.publish(ros.path_message(STRAIGHT, early.get_clock().now().nanoseconds))
    add(executor, early)
    world = Foreign(executor, ControllerNode(), QOS["volatile, best effort"])
    world.spin_until(lambda: world.controller.supervisor.path is not None)
    world.drive_for(2)


def test_a_qos_that_cannot_match_is_named_with_both_profiles(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with ros_context(controller="pure_pursuit", lock_step="true") as executor:
        node = ControllerNode()
        world = Node("car")
        publisher = world.create_publisher(Odometry, ros.ODOM, QOS["volatile, best effort"])
        add(executor, node, world)
        spin_until(executor, lambda: bool(node.inputs.mismatches()))
        sentence = (
            "odom: the publisher of /car offers volatile, best effort, but this node requests "
            "volatile, reliable: none of its messages arrive"
        )
        assert report_of(node).message == f"waiting for odom; {sentence}"
        assert sentence in capfd.readouterr().err
        world.destroy_publisher(publisher)
        spin_until(executor, lambda: not node.inputs.mismatches())


def test_path_and_odometry_may_use_any_common_frame(executor: SingleThreadedExecutor) -> None:
    node = ControllerNode()
    world = Foreign(executor, node, ros.LATCHED, "odom")
    predicted: list[PathMessage] = []
    world.create_subscription(PathMessage, ros.PREDICTED_PATH, predicted.append, 1)
    world.publish_path(STRAIGHT, "odom")
    world.drive_for(3)
    assert node.frame.name == "odom"
    assert {message.header.frame_id for message in predicted} <= {"odom"}
    world.frame = "utm"
    rejected = node.rejected
    world.publish_state()
    world.spin_until(lambda: node.rejected > rejected)
    assert (
        "odom: header.frame_id = 'utm' must be 'odom', the frame of the first odom; set the "
        "parameter fixed_frame" in world.report()
    )


@pytest.mark.parametrize("path_first", [True, False])
def test_a_path_in_another_frame_is_named_with_both_frames_and_the_remedy(
    path_first: bool, executor: SingleThreadedExecutor
) -> None:
    node = ControllerNode()
    world = Foreign(executor, node, ros.LATCHED, "odom")
    steps = [
        (lambda: world.publish_path(STRAIGHT, "map"), lambda: node.newest_path is not None),
        (world.publish_state, lambda: bool(node.frame.name)),
    ]
    for act, is_done in steps if path_first else steps[::-1]:
        world.spin_until(lambda: world.odom.get_subscription_count() > 0)
        act()
        world.spin_until(is_done)
    world.spin_until(lambda: node.rejected > 0)
    assert node.supervisor.path is None
    assert (
        "reference_path: header.frame_id = 'map' differs from 'odom', the frame of the first "
        "odom: publish both in one frame, or install tf2_ros" in world.report()
    )


class LateBuffer:
    """Stands for tf2_ros.Buffer; its transform comes with the third lookup."""

    lookups = 0

    def lookup_transform(self, target: str, source: str, at: Any) -> Any:
        """Return a transform of 90 degrees to the left and 10 m forward."""
        self.lookups += 1
        assert (target, source) == ("odom", "map")
        assert at.nanoseconds > 0
        if self.lookups < 3:
            raise LookupError("no transform yet")
        half = math.sqrt(0.5)
        return SimpleNamespace(
            transform=SimpleNamespace(
                translation=SimpleNamespace(x=10.0, y=0.0),
                rotation=SimpleNamespace(x=0.0, y=0.0, z=half, w=half),
            )
        )


def test_a_path_in_another_frame_is_transformed_as_soon_as_tf2_ros_knows_how(
    executor: SingleThreadedExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    tf2_ros: Any = ModuleType("tf2_ros")
    tf2_ros.Buffer, tf2_ros.TransformException = LateBuffer, LookupError
    tf2_ros.TransformListener = lambda *_: None
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2_ros)
    node = ControllerNode()
    world = Foreign(executor, node, ros.LATCHED, "odom")
    world.spin_until(lambda: world.odom.get_subscription_count() > 0)
    world.publish_state()
    world.spin_until(lambda: bool(node.frame.name))
    world.publish_path(STRAIGHT, "map")
    world.spin_until(lambda: node.rejected == 1)
    assert "and there is no transform: no transform yet" in world.report()
    world.spin_until(lambda: node.supervisor.path is not None)
    assert node.supervisor.path
    path = node.supervisor.path.value
    assert path.x == pytest.approx(np.full(len(path.x), 10.0), abs=1e-9)
    assert path.y[-1] == pytest.approx(398.0)


def test_zero_stamps_and_an_unusual_child_frame_are_named(executor: SingleThreadedExecutor) -> None:
    with_zero = Foreign(executor, ControllerNode(), ros.LATCHED)
    node, world = with_zero.controller, with_zero
    message = ros.odometry_message(VehicleState(0, 0.0, 0.0, 0.0, SPEED, 0.0, 0.0))
    node.on_odometry(message)
    assert "odom: header.stamp = 0: the publisher does not set it" in world.report()
    for child in ("imu_link", ""):
        message.child_frame_id = child
        message.header.stamp = ros.time_message(world.now_ns)
        node.on_odometry(message)
        said = world.report()
        assert f"odom: child_frame_id = '{child or '(empty)'}' is taken for base_link" in said
        node.on_odometry(message)
        assert "child_frame_id" not in world.report()
    message.child_frame_id = "car1/base_link"
    node.on_odometry(message)
    assert "child_frame_id" not in world.report()
    node.supervisor.forget()
    config = node.supervisor.config._replace(static_path=False)
    node.supervisor.reconfigure(config)
    node.on_serialized_path(serialize_message(ros.path_message(STRAIGHT, 0)))
    assert "reference_path: header.stamp = 0 must be the time of the path" in world.report()


class Rolling(Foreign):
    """A car that waits for the process that builds its paths."""

    def on_drive(self) -> None:
        """Drive on unless the newest path is old."""
        path = self.controller.supervisor.path
        assert path
        if self.now_ns - path.stamp_ns < 0.5 * NANOSECONDS:
            super().on_drive()


def test_a_window_that_rolls_with_the_car_is_followed() -> None:
    with ros_context(gain_table="preview_paper", use_sim_time="true") as executor:
        node = ControllerNode()
        world = Rolling(executor, node, QOS["volatile, best effort"])
        rng = np.random.default_rng(3)

        def plan() -> None:
            window = world.x + np.arange(-5.0, 55.0, 1.0)
            world.publish_path(sine(window) + rng.normal(0.0, 0.002, (60, 2)))

        world.yaw = math.atan(1.5 / 12.0)
        world.create_timer(0.1, plan, clock=world.wall)
        world.spin_until(lambda: node.supervisor.path is not None)
        world.drive_for(60)
        track = np.array(world.track[len(world.track) // 3 :])
        error = (track[:, 1] - sine(track[:, 0])[:, 1]) * math.cos(math.atan(1.5 / 12.0))
        assert not node.supervisor.stop_requested
    assert np.abs(error).max() < 0.3


def test_commands_continue_while_a_path_of_many_poses_is_built() -> None:
    with ros_context(controller="pure_pursuit", static_path="true", use_sim_time="true") as nodes:
        drive_while_a_path_is_built(nodes)


def drive_while_a_path_is_built(executor: SingleThreadedExecutor) -> None:
    node = ControllerNode()
    world = Foreign(executor, node, QOS["volatile, reliable"])
    world.publish_path(STRAIGHT)
    world.spin_until(lambda: world.paths.get_subscription_count() > 0)
    long = sine(np.arange(0.0, 20_000.0))
    big = serialize_message(ros.path_message(long, world.now_ns))
    world.publish_path(STRAIGHT)
    world.spin_until(lambda: node.supervisor.path is not None)
    world.drive_for(5)
    before, process = node.commands, node.builder and node.builder._process
    assert process

    def is_in_use() -> bool:
        assert node.supervisor.path
        return len(node.supervisor.path.value.x) > 50_000

    process.send_signal(signal.SIGSTOP)  # as if it were slow
    world.paths.publish(big)
    timer = world.create_timer(PERIOD, world.on_drive, clock=world.wall)
    spin_until(executor, lambda: node.commands > before + 10)
    assert not is_in_use()
    process.send_signal(signal.SIGCONT)
    spin_until(executor, is_in_use)
    world.destroy_timer(timer)
    assert not node.supervisor.stop_requested


def test_a_path_that_is_sent_again_is_used_at_once_and_another_one_after_it_was_built(
    executor: SingleThreadedExecutor,
) -> None:
    node = ControllerNode()
    world = Foreign(executor, node, ros.LATCHED)

    def send(points: Array, stamp_ns: int) -> None:
        node.on_serialized_path(serialize_message(ros.path_message(points, stamp_ns)))

    def stamp_in_use() -> int:
        path = node.supervisor.path
        return path.stamp_ns if path else 0

    def samples_in_use() -> int:
        path = node.supervisor.path
        return len(path.value.x) if path else 0

    send(STRAIGHT, 1)
    world.spin_until(lambda: stamp_in_use() == 1)
    samples = samples_in_use()
    process = node.builder and node.builder._process
    assert process
    process.send_signal(signal.SIGSTOP)
    send(STRAIGHT, 2)
    assert stamp_in_use() == 2
    assert samples_in_use() == samples
    moved = STRAIGHT.copy()
    moved[-1, 1] += 1e-12
    send(moved, 3)
    send(STRAIGHT, 4)  # the other path is not yet built, and must not be used after this one
    assert stamp_in_use() == 2
    process.send_signal(signal.SIGCONT)
    world.spin_until(lambda: stamp_in_use() == 4)
    send(STRAIGHT[:-1], 5)
    world.spin_until(lambda: stamp_in_use() == 5)
    assert 0 < samples_in_use() < samples


def test_a_large_file_is_loaded_while_the_controller_steers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = shipped("guards")["road"].read_text(encoding="utf-8")
    Path("guard.yaml").write_text(text, encoding="utf-8")
    arguments = {"controller": "pure_pursuit", "static_path": "true", "guard": "guard.yaml"}
    with ros_context(**arguments) as executor:
        node = ControllerNode()
        world = Foreign(executor, node, ros.LATCHED)
        world.publish_path(STRAIGHT)
        world.drive_for(5)
        # They end with an error: some tenths of a second of work for the parser.
        values = "".join(f"key_{i}: [1, 2, 3, 4]\n" for i in range(500))
        Path("guard.yaml").write_text(text + values, encoding="utf-8")
        client = world.create_client(Trigger, "controller/reload")
        world.spin_until(client.service_is_ready)
        before = node.commands
        future = client.call_async(Trigger.Request())
        timer = world.create_timer(PERIOD, world.on_drive)
        world.last = time.monotonic()
        world.spin_until(future.done)
        world.destroy_timer(timer)
        answer = future.result()
        assert answer is not None
        assert not answer.success
        assert "guard.yaml: unknown key" in answer.message
        ticks = node.commands - before
        assert ticks > 2
        Path("guard.yaml").write_text(" " * serialized_path.MAX_PATH_BYTES, encoding="utf-8")
        future = client.call_async(Trigger.Request())
        world.spin_until(future.done)
        assert (
            f"guard.yaml: {serialized_path.MAX_PATH_BYTES} bytes are more than 5000000"
            in future.result().message
        )


def test_too_large_a_path_is_rejected_in_one_line(
    executor: SingleThreadedExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = Foreign(executor, ControllerNode(), ros.LATCHED)
    data = serialize_message(ros.path_message(STRAIGHT, 1))
    monkeypatch.setattr(serialized_path, "MAX_POSES", 199)
    world.controller.on_serialized_path(data)
    assert "reference_path: 200 poses must be at most 199" in world.report()
    monkeypatch.setattr(serialized_path, "MAX_PATH_BYTES", 1000)
    world.controller.on_serialized_path(data)
    assert f"message of {len(data)} bytes must have at most 1000" in world.report()
    world.controller.on_serialized_path(b"\0\1\0\0nonsense")
    assert "12 bytes cannot be decoded as Path" in world.report()


@pytest.mark.parametrize("make_node", [ControllerNode, PlannerNode])
def test_simulated_time_without_a_clock_is_reported_in_wall_time(
    make_node: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    sentence = "use_sim_time is set but /clock has no publisher"
    with ros_context(use_sim_time="true", controller="pure_pursuit") as executor:
        node = make_node()
        add(executor, node)
        assert "use_sim_time" not in report_of(node).message
        node.clock_check.limit = time.monotonic()
        spin_until(executor, lambda: node.clock_check.is_logged)
        assert sentence in report_of(node).message
    assert capfd.readouterr().err.count(sentence) == 1


def test_the_planner_publishes_its_path_in_the_frame_of_the_odometry() -> None:
    with ros_context(scenario="straight") as executor:
        node, car = PlannerNode(), Node("car")
        frames: list[str] = []

        def on_path(message: PathMessage) -> None:
            frames.append(message.header.frame_id)

        car.create_subscription(
            PathMessage,
            ros.REFERENCE_PATH,
            on_path,
            ros.LATCHED,
        )
        odom = car.create_publisher(Odometry, ros.ODOM, 1)
        add(executor, node, car)
        spin_until(executor, lambda: frames == ["map"] and odom.get_subscription_count() > 0)
        state = VehicleState(NANOSECONDS, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0)
        odom.publish(ros.odometry_message(state, "odom"))
        spin_until(executor, lambda: frames == ["map", "odom"])
