"""The controller as a managed node: every transition, by its services, and what it leaves."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from ampc_msgs_config import ros
from ampc_msgs_config.config import shipped
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import from_yaml
from ampc_ros.controller_node import ControllerNode
from tests.ros_nodes import add, ros_context, spin_until

CIRCLE = np.array([(30.0 * np.sin(a), 30.0 - 30.0 * np.cos(a)) for a in np.arange(0.0, 3.0, 0.05)])
OURS = {f"/{ros.STEERING_COMMAND}", f"/{ros.STOP_REQUEST}", f"/{ros.TICK}"}


class Driver(Node):
    """Manages a controller by its services, gives it a drive, and hears what it says."""

    def __init__(self, executor: SingleThreadedExecutor, node: ControllerNode) -> None:
        """Join the graph beside the controller."""
        super().__init__("driver")
        self.executor_of_all, self.node = executor, node
        self.commands: list[JointState] = []
        self.stops: list[bool] = []
        self.made: list[str] = []
        self.first_ns = node.now_ns
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.create_subscription(
            JointState, ros.STEERING_COMMAND, self.commands.append, ros.COMMAND
        )
        self.create_subscription(Bool, ros.STOP_REQUEST, self.on_stop, ros.LATCHED)
        self.create_subscription(String, "controller/configuration", self.on_made, ros.LATCHED)
        self.paths.publish(ros.path_message(CIRCLE, self.first_ns))
        self.changing = self.create_client(ChangeState, "controller/change_state")
        self.asking = self.create_client(GetState, "controller/get_state")
        add(executor, self, node)

    def on_stop(self, message: Bool) -> None:
        """Note a request."""
        self.stops.append(message.data)

    def on_made(self, message: String) -> None:
        """Note a configuration."""
        self.made.append(message.data)

    def answer(self, client: Any, request: Any) -> Any:
        """Call a service."""
        spin_until(self.executor_of_all, client.service_is_ready)
        future = client.call_async(request)
        spin_until(self.executor_of_all, future.done)
        return future.result()

    def change(self, transition: int) -> bool:
        """Ask for a transition; tells whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.answer(self.changing, request).success)

    def state(self) -> str:
        """Ask for the state."""
        return str(self.answer(self.asking, GetState.Request()).current_state.label)

    def drive(self) -> VehicleState:
        """Publish a state on the circle, at 9 m/s, as old as the test."""
        s = 9.0 * (self.node.now_ns - self.first_ns) / NANOSECONDS % 80.0
        x, y, yaw = 30.0 * np.sin(s / 30.0), 30.0 - 30.0 * np.cos(s / 30.0), s / 30.0
        state = VehicleState(self.node.now_ns, float(x), float(y), float(yaw), 9.0, 0.0, 0.3)
        self.odom.publish(ros.odometry_message(state))
        return state

    def drive_until(self, condition: Callable[[], bool]) -> None:
        """Publish states until a condition holds."""

        def driven() -> bool:
            self.drive()
            return condition()

        spin_until(self.executor_of_all, driven)

    def drive_for(self, commands: int) -> list[float]:
        """Drive until that many more commands have come; gives their angles."""
        known = len(self.commands)
        self.drive_until(lambda: len(self.commands) >= known + commands)
        return [message.position[0] for message in self.commands[known:]]

    def topics(self) -> set[str]:
        """Give the topics on which the controller publishes."""
        return {each.topic_name for each in self.node.publishers} & OURS


@pytest.fixture
def unconfigured() -> Any:
    """A controller that waits to be configured."""
    with ros_context(controller="pure_pursuit", static_path="true", autostart="false") as executor:
        yield Driver(executor, ControllerNode())


@pytest.fixture
def active(unconfigured: Driver) -> Driver:
    """A controller that steers."""
    assert unconfigured.change(Transition.TRANSITION_CONFIGURE)
    assert unconfigured.change(Transition.TRANSITION_ACTIVATE)
    unconfigured.drive_for(8)
    return unconfigured


def test_a_controller_without_autostart_waits_publishes_nothing_and_says_so(
    unconfigured: Driver,
) -> None:
    assert unconfigured.state() == "unconfigured"
    assert unconfigured.topics() == set()
    assert unconfigured.change(Transition.TRANSITION_CONFIGURE)
    assert unconfigured.state() == "inactive"
    assert unconfigured.topics() == OURS
    for _ in range(20):
        unconfigured.drive()
        unconfigured.executor_of_all.spin_once(timeout_sec=0.02)
    assert unconfigured.commands == []


def test_a_deactivated_controller_holds_its_angle_asks_for_a_stop_and_is_silent(
    active: Driver,
) -> None:
    angle = active.node.supervisor.steering
    assert angle > 0.01
    assert active.change(Transition.TRANSITION_DEACTIVATE)
    spin_until(active.executor_of_all, lambda: active.stops[-1:] == [True])
    assert (active.commands[-1].position[0], active.commands[-1].velocity[0]) == (angle, 0.0)
    known = len(active.commands)
    for _ in range(20):
        active.drive()
        active.executor_of_all.spin_once(timeout_sec=0.02)
    assert len(active.commands) == known
    assert active.state() == "inactive"


def test_a_controller_that_is_activated_again_goes_on_from_its_angle_and_takes_the_stop_back(
    active: Driver,
) -> None:
    ordinary = largest_step(active.drive_for(5))
    angle = active.node.supervisor.steering
    active.change(Transition.TRANSITION_DEACTIVATE)
    assert active.change(Transition.TRANSITION_ACTIVATE)
    later = active.drive_for(3)
    assert active.stops[-3:] == [False, True, False]
    assert largest_step([angle, *later]) < max(2.0 * ordinary, 0.02)


def test_after_a_clean_up_another_configuration_goes_on_from_the_angle_in_force(
    active: Driver, tmp_path: Path
) -> None:
    angle = active.node.supervisor.steering
    active.change(Transition.TRANSITION_DEACTIVATE)
    assert active.change(Transition.TRANSITION_CLEANUP)
    assert active.state() == "unconfigured"
    assert active.topics() == set()
    slower = tmp_path / "slower.yaml"
    slower.write_text("sample_time: 0.05\nlook_ahead_time: 0.8\n", encoding="utf-8")
    set_parameter(active.node, "settings", str(slower))
    assert active.change(Transition.TRANSITION_CONFIGURE)
    assert active.change(Transition.TRANSITION_ACTIVATE)
    assert active.node.supervisor.steering == angle
    active.drive_for(2)
    made, number = from_yaml(active.made[-1], "controller/configuration")
    assert (made.settings.sample_time, number) == (0.05, 2)


def test_a_broken_file_leaves_the_node_unconfigured_and_a_mended_one_configures_it(
    unconfigured: Driver, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "guard.yaml"
    text = shipped("guards")["road"].read_text(encoding="utf-8")
    file.write_text(text.replace("max_rate:", "most_rate:"), encoding="utf-8")
    set_parameter(unconfigured.node, "guard", str(file))
    assert not unconfigured.change(Transition.TRANSITION_CONFIGURE)
    assert unconfigured.state() == "unconfigured"
    said = [line for line in capfd.readouterr().err.split("\n") if "ERROR" in line]
    assert len(said) == 1
    assert f"{file}: unknown key 'most_rate'" in said[0]
    file.write_text(text, encoding="utf-8")
    assert unconfigured.change(Transition.TRANSITION_CONFIGURE)
    assert unconfigured.state() == "inactive"


@pytest.mark.parametrize(
    ("state", "transition"),
    [
        ("unconfigured", Transition.TRANSITION_ACTIVATE),
        ("unconfigured", Transition.TRANSITION_CLEANUP),
        ("active", Transition.TRANSITION_CONFIGURE),
        ("active", Transition.TRANSITION_ACTIVATE),
        ("active", 99),
    ],
)
def test_a_transition_that_the_state_does_not_have_is_refused_and_ends_nothing(
    state: str, transition: int, request: pytest.FixtureRequest
) -> None:
    driver: Driver = request.getfixturevalue(state)
    assert not driver.change(transition)
    assert driver.state() == state
    if state == "active":
        driver.drive_for(2)


@pytest.mark.parametrize("state", ["unconfigured", "inactive", "active"])
def test_a_shutdown_leaves_no_topic_and_from_a_driving_car_the_last_angle_and_a_stop(
    state: str, request: pytest.FixtureRequest
) -> None:
    driver: Driver = request.getfixturevalue("active" if state == "active" else "unconfigured")
    if state == "inactive":
        driver.change(Transition.TRANSITION_CONFIGURE)
    angles = [message.position[0] for message in driver.commands]
    shutdown = f"TRANSITION_{state.upper()}_SHUTDOWN"
    assert driver.change(getattr(Transition, shutdown))
    assert driver.state() == "finalized"
    assert driver.topics() == set()
    if state == "active":
        spin_until(driver.executor_of_all, lambda: driver.stops[-1:] == [True])
        assert driver.commands[-1].velocity[0] == 0.0
        assert driver.commands[-1].position[0] == angles[-1]
    else:
        assert driver.commands == []
        assert True not in driver.stops


@pytest.mark.parametrize(
    ("broken", "transition"),
    [
        ("load", Transition.TRANSITION_CONFIGURE),
        ("offer_changes", Transition.TRANSITION_CONFIGURE),
        ("begin", Transition.TRANSITION_ACTIVATE),
    ],
)
def test_what_goes_wrong_on_the_way_up_leaves_nothing_half_made_and_may_be_tried_again(
    broken: str,
    transition: int,
    unconfigured: Driver,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    if transition == Transition.TRANSITION_ACTIVATE:
        unconfigured.change(Transition.TRANSITION_CONFIGURE)
    with monkeypatch.context() as patch:
        patch.setattr(unconfigured.node, broken, lambda: 1 / 0)
        assert not unconfigured.change(transition)
    assert unconfigured.state() == "unconfigured"
    assert unconfigured.topics() == set()
    assert "ZeroDivisionError: division by zero" in capfd.readouterr().err
    assert unconfigured.change(Transition.TRANSITION_CONFIGURE)
    assert unconfigured.change(Transition.TRANSITION_ACTIVATE)
    unconfigured.drive_for(2)


@pytest.mark.parametrize(
    ("broken", "state"), [("last command", "finalized"), ("timer", "unconfigured")]
)
def test_a_deactivation_that_fails_still_asks_for_a_stop_and_gives_no_more_commands(
    broken: str, state: str, active: Driver, monkeypatch: pytest.MonkeyPatch
) -> None:
    if broken == "timer":
        active.node.while_active.callback(lambda: 1 / 0)
    else:
        monkeypatch.setattr(active.node.outputs, "hold", lambda: 1 / 0)
    assert not active.change(Transition.TRANSITION_DEACTIVATE)
    assert active.state() == state
    spin_until(active.executor_of_all, lambda: active.stops[-1:] == [True])
    assert active.topics() == set()
    known = len(active.commands)
    for _ in range(20):
        active.drive()
        active.executor_of_all.spin_once(timeout_sec=0.02)
    assert len(active.commands) == known


def largest_step(angles: list[float]) -> float:
    """Give the largest change from one command to the next [rad]."""
    return float(np.abs(np.diff(angles)).max())


def set_parameter(node: ControllerNode, name: str, value: Any) -> None:
    """Set a parameter as a service call would; it has to succeed."""
    from rclpy.parameter import Parameter

    (result,) = node.set_parameters([Parameter(name, value=value)])
    assert result.successful, result.reason
