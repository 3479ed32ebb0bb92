"""What the nodes report: every level, in sentences and with numbers, at once where it changes."""

import re
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Bool, String

from ampc_msgs_config import ros
from ampc_msgs_config.types import ERROR, NANOSECONDS, OK, STALE, WARN
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.driver_of_nodes import Driver
from tests.nodes.test_nodes import World, odometry, path
from tests.ros_nodes import add, ros_context, spin_until


class Reported(World):
    """Beside a node with simulated time that the test makes."""

    def at(self, seconds: float, node: Any, *, odom: bool = True, **changes: Any) -> Any:
        """Run a node at a time, with odometry of that time; return level and text of its report."""
        self.set_clock(seconds, node)
        if odom:
            message = odometry(round(seconds * NANOSECONDS), **changes)
            node.on_odometry(message)
        if isinstance(node, ControllerNode):
            node.on_timer()
        self.last = report_of(node)
        return self.last.level[0], self.last.message


def report_of(node: Any) -> DiagnosticStatus:
    """Return the report that a node would publish."""
    caught: list[DiagnosticArray] = []
    publisher, node.diagnostics = node.diagnostics, SimpleNamespace(publish=caught.append)
    node.on_diagnostics()
    node.diagnostics = publisher
    return caught[0].status[0]


@pytest.fixture
def controller() -> Iterator[tuple[Reported, ControllerNode]]:
    """A controller whose time the test makes."""
    with ros_context(use_sim_time="true", gain_table="preview_paper") as executor:
        node = ControllerNode()
        yield Reported(executor, node), node


def test_the_controller_reports_every_level_with_its_reason(
    controller: tuple[Reported, ControllerNode],
) -> None:
    world, node = controller
    assert world.at(1.0, node, odom=False) == (STALE, "waiting for odom")
    assert world.at(1.1, node) == (WARN, "waiting for reference_path")
    message = path()
    message.header.stamp = ros.time_message(NANOSECONDS * 11 // 10)
    node.on_path(message)
    assert world.at(1.2, node) == (OK, "OK")
    assert world.at(2.1, node) == (WARN, "reference_path is 1.0 s old")
    level, said = world.at(3.2, node)
    assert level == ERROR
    assert said.startswith("reference_path is 2.1 s old: a stop is requested; a path that is pub")
    message.header.stamp = ros.time_message(NANOSECONDS * 32 // 10)
    node.on_path(message)
    level, said = world.at(3.5, node, odom=False)
    assert level == WARN
    assert re.search("shifted_plan, .*state_late", said)
    level, said = world.at(3.8, node, odom=False)
    assert level == STALE
    assert said.startswith("odom is 0.6 s old: a stop is requested")


def test_a_stop_that_was_requested_is_reported_until_it_is_taken_back(
    controller: tuple[Reported, ControllerNode],
) -> None:
    world, node = controller
    node.on_path(path())
    world.at(0.1, node)
    world.at(0.7, node, odom=False)
    assert node.supervisor.stop_requested
    level, said = world.at(0.8, node)
    assert (level, "~/reset_stop" in said) == (WARN, True)
    node.supervisor.clear_stop()
    assert world.at(0.9, node) == (OK, "OK")


def test_outside_of_what_was_tuned_the_report_says_how_far(
    controller: tuple[Reported, ControllerNode],
) -> None:
    world, node = controller
    highest = node.supervisor.config.gains["speed"][-1]
    node.on_path(path([(20.0 * i, 0.0) for i in range(100)]))
    level, said = world.at(0.1, node, v_x=highest + 2.5, y=0.0, yaw=0.0)  # nothing to steer
    assert level == WARN
    assert f"{highest + 2.5:.1f} m/s is 2.5 m/s outside the gain table" in said
    values = {each.key: float(each.value) for each in world.last.values}
    assert {"commands", "missed_ticks", "rejected_inputs", "rung", "state_age"} <= values.keys()


def test_a_controller_that_does_not_steer_reports_that() -> None:
    with ros_context(autostart="false", controller="pure_pursuit") as executor:
        node = ControllerNode()
        add(executor, node)
        assert report_of(node).message == "unconfigured: no commands are published"
        node.trigger_configure()
        report = report_of(node)
        assert (report.level[0], report.message) == (WARN, "inactive: no commands are published")


def test_an_odom_that_falls_silent_is_reported_at_once_and_logged_rung_by_rung(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        heard: list[tuple[int, int]] = []

        def on_report(message: DiagnosticArray) -> None:
            stamp_ns = ros.nanoseconds(message.header.stamp)
            heard.append((message.status[0].level[0], stamp_ns))

        driver.create_subscription(DiagnosticArray, ros.DIAGNOSTICS, on_report, ros.RELIABLE)
        driver.drive_for(6)
        last = driver.drive()
        spin_until(executor, lambda: any(level == STALE for level, _ in heard))
        assert [level for level, _ in heard[-2:]] == [WARN, STALE]
        driver.drive_for(3)
    said = [line.partition("]: ")[2] for line in capfd.readouterr().err.split("\n")]
    wanted = ("shifted_plan.*state_late", "stop is requested.*state_lost", "fallback ended")
    for line, pattern in zip(said[-4:-1], wanted, strict=True):
        assert re.search(pattern, line)
    assert last.stamp_ns < heard[-1][1]


def receive_stop_request(node: PlannerNode, requested: bool, number: int) -> None:
    """Pass a stop request on, as its subscription does."""
    times = {"source_timestamp": 0, "received_timestamp": 0}
    info = times | {"publication_sequence_number": number}
    node.inputs.topics[ros.STOP_REQUEST].info = info
    node.on_stop_request(Bool(data=requested))


def test_the_planner_says_what_it_waits_for_and_that_it_brakes() -> None:
    with ros_context(use_sim_time="true", scenario="straight") as executor:
        node = PlannerNode()
        world = Reported(executor, node)
        assert world.at(1.0, node, odom=False) == (STALE, "waiting for odom")
        assert world.at(1.1, node) == (OK, "OK")
        level, said = world.at(1.7, node, odom=False)
        assert (level, said) == (STALE, "odom is 0.6 s old: no target speed is published")
        receive_stop_request(node, True, 2)
        assert world.at(1.8, node) == (WARN, "a stop is requested: braking")
        values = {each.key: float(each.value) for each in world.last.values}
        assert values.pop("target_speed") == pytest.approx(
            8.9, abs=0.11
        )  # braking for 0.1 s at most
        assert values == {"stop_requested": 1.0, "rejected_inputs": 0.0}
        receive_stop_request(node, False, 3)
        assert world.at(1.9, node) == (OK, "OK")


def test_the_car_is_braked_too_where_the_state_is_what_was_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ros_context(use_sim_time="true", scenario="straight") as executor:
        node = PlannerNode()
        world, speeds = Reported(executor, node), list[float]()

        def note(message: Any) -> None:
            speeds.append(message.twist.linear.x)

        monkeypatch.setattr(node.speeds, "publish", note)
        world.at(1.1, node)
        receive_stop_request(node, True, 2)
        for tick in range(1, 31):
            world.at(2.0 + tick / 10, node, odom=False)
            node.on_braking_timer()
    assert speeds[0] == 9.0
    assert speeds[1:] == sorted(speeds[1:], reverse=True)
    assert speeds[-1] < 4.0


@pytest.mark.parametrize("lock_step", [False, True])
def test_the_car_is_braked_while_a_stop_is_requested_in_real_time_only(lock_step: bool) -> None:
    with ros_context(lock_step=str(lock_step).lower(), scenario="straight") as executor:
        node = PlannerNode()
        world = World(executor, node)
        stops = world.create_publisher(Bool, ros.STOP_REQUEST, ros.LATCHED)
        stops.publish(Bool(data=True))
        spin_until(executor, lambda: lock_step or node.stop_requested)
        speeds = []
        for tick in range(1, 60):
            node.on_odometry(odometry(tick * NANOSECONDS // 10))
            assert node.newest
            speeds.append(node.newest.twist.linear.x)
    if lock_step:
        assert min(speeds) > 5.0
    else:
        assert speeds[0] == 9.0
        assert speeds[-1] == 0.0
        assert all(0.0 <= a - b < 0.2 + 1e-9 for a, b in pairwise(speeds))


def test_the_simulator_says_whose_answers_the_car_does_without() -> None:
    with ros_context(scenario="straight") as executor:
        node = SimulatorNode()
        add(executor, node)
        message = report_of(node).message
        assert message == "the car waits at its start for steering_command and target_speed"
        now_ns = node.now_ns
        node.answers = {
            ros.STEERING_COMMAND: ros.Stamped(now_ns - NANOSECONDS, 0.0),
            ros.TARGET_SPEED: ros.Stamped(now_ns + NANOSECONDS, 9.0),
        }
        message = report_of(node).message
        assert message.startswith("no steering_command for 1.0 s: ")


def test_each_node_tells_its_configuration_to_whoever_comes_late() -> None:
    told: dict[str, str] = {}

    def note(topic: str, message: String) -> None:
        told[topic] = message.data

    with ros_context(lock_step="true", controller="pure_pursuit") as executor:
        nodes = ControllerNode(), PlannerNode(), SimulatorNode()
        listener = World(executor, nodes[0])
        add(executor, *nodes[1:])
        for topic in ros.CONFIGURATIONS:
            listener.create_subscription(String, topic, partial(note, topic), ros.LATCHED)
        spin_until(executor, lambda: len(told) == 3)
    assert all(text.startswith("version: ") for text in told.values())
