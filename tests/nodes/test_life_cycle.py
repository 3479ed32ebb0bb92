"""The controller as a managed node: every transition, by its services, and what it leaves."""

from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition

from ampc_msgs_config.config import shipped
from ampc_ros.configuration import from_yaml
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.managed_node import lifecycle_state
from tests.driver_of_nodes import OURS, Driver, largest_step, set_parameter
from tests.ros_nodes import ros_context, spin_until

pytestmark = pytest.mark.usefixtures("own_domain")


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


def test_lifecycle_state(unconfigured: Driver) -> None:
    """The private interface of rclpy that `managed_node.lifecycle_state` uses."""
    assert lifecycle_state(unconfigured.node) == unconfigured.state() == "unconfigured"
    assert unconfigured.change(Transition.TRANSITION_CONFIGURE)
    assert lifecycle_state(unconfigured.node) == unconfigured.state() == "inactive"


def test_wrap_change_state(unconfigured: Driver) -> None:
    """The private interface of rclpy that `managed_node.wrap_change_state` uses."""
    assert not unconfigured.change(Transition.TRANSITION_DEACTIVATE)
    assert unconfigured.change(Transition.TRANSITION_CONFIGURE)


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
    config, number = from_yaml(active.config[-1], "controller/configuration")
    assert (config.settings.sample_time, number) == (0.05, 2)


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


@pytest.mark.parametrize("stated", [False, True])
def test_a_steering_lag_that_is_not_configured_is_logged_once(
    stated: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lines = shipped("vehicles")["ordinary"].read_text(encoding="utf-8").splitlines(keepends=True)
    file = tmp_path / "mine.yaml"
    kept = (line for line in lines if stated or not line.startswith("  lag: "))
    file.write_text("".join(kept), encoding="utf-8")
    with ros_context(controller="pure_pursuit", vehicle=file):
        ControllerNode().destroy_node()
    sentence = f"vehicle file {file}: steering.lag is not configured: 0.08 s is assumed"
    assert capfd.readouterr().err.count(sentence) == (not stated)
