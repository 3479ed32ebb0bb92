"""The controller's watchdog: silence, stopped and jumping clocks, and a fault in a tick."""

import time
from collections.abc import Callable
from typing import Any

import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock as ClockMessage

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.marker_node import MarkerNode
from ampc_msgs_config.types import ERROR, NANOSECONDS
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from ampc_ros.nodes.watchdog import MOST_COUNTED, WATCH_PERIOD, Watchdog, silence_limit
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.driver_of_nodes import Driver
from tests.ros_nodes import add, ros_context, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")
LIMIT = 0.4


class Clocks:
    """A watchdog whose clocks are set by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, simulated: bool) -> None:
        """Start both clocks."""
        self.wall, self.node = 100.0, 50.0
        monkeypatch.setattr("ampc_ros.nodes.watchdog.time.monotonic", lambda: self.wall)
        parameter = Parameter("use_sim_time", value=simulated)
        node: Any = type("Node", (), {"get_parameter": lambda *_: parameter})()
        self.watchdog = Watchdog(node, lambda: round(self.node * NANOSECONDS))

    def run(self, seconds: float, speed: float = 1.0, command: float | None = None) -> list[float]:
        """Advance both clocks; return the wall times at which a problem was found.

        Args:
            seconds: Wall time.
            speed: Rate of the node's clock.
            command: Simulated time between commands; None: there are none.
        """
        found, commanded, begin = [], self.node, self.wall
        while self.wall < begin + seconds - 1e-9:
            self.wall += WATCH_PERIOD
            self.node += speed * WATCH_PERIOD
            if command is not None and self.node - commanded >= command:
                self.watchdog.on_command()
                commanded = self.node
            if self.watchdog.check(LIMIT):
                found.append(self.wall - begin)
        return found


@pytest.fixture(params=[False, True])
def clocks(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Clocks:
    """A watchdog on both kinds of clock."""
    return Clocks(monkeypatch, simulated=request.param)


def test_commands_of_every_period_are_no_silence(clocks: Clocks) -> None:
    assert clocks.run(10.0, command=0.1) == []
    assert clocks.run(10.0, command=0.25) == []


def test_silence_is_found_within_half_a_second_and_ends_with_a_command(clocks: Clocks) -> None:
    assert clocks.run(1.0)[0] <= 0.5
    clocks.watchdog.on_command()
    assert clocks.watchdog.problem == ""
    assert clocks.run(1.0, command=0.1) == []


@pytest.mark.parametrize("speed", [0.3, 0.01, 1e-6])
def test_a_simulated_clock_that_advances_slowly_is_no_fault(
    speed: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = Clocks(monkeypatch, simulated=True)
    assert slow.run(60.0, speed, command=0.1) == []


def test_a_simulated_clock_that_stops_is_named_within_half_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    paused = Clocks(monkeypatch, simulated=True)
    paused.run(1.0, command=0.1)
    assert paused.run(2.0, speed=0.0)[0] <= 0.5
    assert "/clock has stopped" in paused.watchdog.problem
    assert paused.run(2.0, command=0.1) == []


@pytest.mark.parametrize("jump", [-3600.0, -1.0, 1.0, 3600.0])
def test_silence_after_a_jump_of_the_system_clock_names_it(
    jump: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    jumping = Clocks(monkeypatch, simulated=False)
    jumping.run(1.0, command=0.1)
    jumping.node += jump
    assert jumping.run(1.0)[0] <= 0.5
    assert f"the system clock jumped by {jump:+.1f} s" in jumping.watchdog.problem
    jumping.watchdog.on_command()
    assert jumping.run(1.0, command=0.1) == []


def test_a_simulated_clock_that_goes_back_counts_from_its_new_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    back = Clocks(monkeypatch, simulated=True)
    back.run(1.0, command=0.1)
    back.node -= 30.0
    assert back.run(5.0)[0] <= 0.5


def test_a_process_without_cpu_is_not_a_silent_controller(clocks: Clocks) -> None:
    clocks.run(1.0, command=0.1)
    clocks.wall += 30.0
    clocks.node += 30.0
    assert clocks.watchdog.check(LIMIT) == ""
    assert clocks.watchdog.silence <= 0.1 + MOST_COUNTED + WATCH_PERIOD


def test_the_limit_leaves_half_a_second_for_the_stop_at_every_rate() -> None:
    assert silence_limit(0.1, 0.2) + WATCH_PERIOD <= 0.5
    assert silence_limit(0.01, 0.2) < silence_limit(0.02, 0.2) < silence_limit(0.1, 0.2)
    assert silence_limit(0.1, 1.0) > 1.0


NODES: list[Callable[[], Any]] = [ControllerNode, PlannerNode, SimulatorNode, MarkerNode]


@pytest.mark.parametrize("make_node", NODES)
def test_use_sim_time_cannot_change_while_a_node_runs(make_node: Callable[[], Any]) -> None:
    with ros_context(controller="pure_pursuit") as executor:
        node = make_node()
        add(executor, node)
        (result,) = node.set_parameters([Parameter("use_sim_time", value=True)])
        assert not result.successful
        assert "read-only" in result.reason
        assert "use_sim_time" in result.reason
        before = node.now_ns
        assert before > 1e18  # still the system's clock
        both = [Parameter("guard", value="track"), Parameter("use_sim_time", value=True)]
        assert not node.set_parameters_atomically(
            both[-1 - isinstance(node, ControllerNode) :]
        ).successful
        if isinstance(node, ControllerNode):
            assert node.get_parameter("guard").value == "road"
            assert node.supervisor.number == 1


def test_a_clock_that_stops_over_ros_leaves_a_held_angle_a_stop_and_an_error_that_names_it() -> (
    None
):
    with ros_context(
        controller="pure_pursuit", static_path="true", use_sim_time="true"
    ) as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        clock = driver.create_publisher(ClockMessage, ros.CLOCK, ros.RELIABLE)
        begin = time.monotonic()
        reports: list[tuple[int, str]] = []

        def store(_: int, text: str, __: Any, level: int) -> None:
            reports.append((level, text))

        node.report = store  # type: ignore[assignment, method-assign]

        def runs() -> None:
            now_ns = round((100.0 + time.monotonic() - begin) * NANOSECONDS)
            clock.publish(ClockMessage(clock=ros.time_message(now_ns)))
            driver.drive()

        def is_steering() -> bool:
            runs()
            return len(driver.commands) > 5

        spin_until(executor, is_steering)
        angle, known = driver.commands[-1].position[0], len(driver.commands)
        driver.drive_until(lambda: driver.stops[-1:] == [True])  # odometry goes on
        spin_until(executor, lambda: len(driver.commands) > known + 2)
        held = driver.commands[-1]
        assert (held.position[0], held.velocity[0]) == (driver.commands[-2].position[0], 0.0)
        assert abs(held.position[0] - angle) < 0.1
        spin_until(executor, lambda: any("/clock has stopped" in text for _, text in reports))
        assert max(level for level, text in reports if "/clock has stopped" in text) == ERROR

        # The clock goes on: commands follow, and the stop stays until it is taken back.
        known = len(driver.commands)

        def steers_again() -> bool:
            runs()
            return node.watchdog.problem == "" and len(driver.commands) > known + 5

        spin_until(executor, steers_again)
        assert driver.stops[-1]
        node.withdraw_stop()

        def is_withdrawn() -> bool:
            runs()
            return not driver.stops[-1]

        spin_until(executor, is_withdrawn)


def test_a_tick_that_raises_leaves_a_held_angle_and_a_stop_and_the_node_continues(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        angle = driver.drive_for(6)[-1]
        executor.remove_node(node)
        own: Any = type(executor)()
        own.add_node(node)

        def drive_until(condition: Callable[[], bool]) -> None:
            def holds() -> bool:
                for _ in range(20):  # the driver runs one callback meanwhile
                    node.failed.run_next(own, timeout=0.0)
                return condition()

            driver.drive_until(holds)

        with monkeypatch.context() as patch:
            patch.setattr(node.supervisor, "tick", lambda *_: 1 / 0)
            drive_until(lambda: driver.stops[-1:] == [True])
            known = len(driver.commands)
            drive_until(lambda: len(driver.commands) > known + 3)
            assert {each.position[0] for each in driver.commands[known:]} == {angle}
            assert driver.commands[-1].velocity[0] == 0.0
            assert node.failed.count > 0
        counted = node.commands
        drive_until(lambda: node.commands > counted + 2)
        assert driver.stops[-1]
        node.destroy_node()


def test_a_plan_that_cannot_be_published_hides_no_request_to_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        driver.drive_for(3)
        monkeypatch.setattr(node.outputs, "publish_plan", lambda *_: 1 / 0)
        monkeypatch.setattr(type(node.supervisor), "stop_requested", True)
        with pytest.raises(ZeroDivisionError):
            node.step()
        assert node.outputs.published_stop
        assert node.watchdog.silence == 0.0


def test_a_step_of_the_controller_that_raises_is_logged_and_braked_over_ros(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        driver.drive_for(3)
        monkeypatch.setattr(node.supervisor.controller, "step", lambda *_: [][1])
        driver.drive_until(lambda: driver.stops[-1:] == [True])
        driver.drive_for(3)
        request = SetParameters.Request(parameters=[])
        client = driver.create_client(SetParameters, "controller/set_parameters")
        driver.answer(client, request, driving=True)
    said = capfd.readouterr().err
    assert said.count("the controller raised IndexError: list index out of range") >= 1
    assert "controller_fault" in said
