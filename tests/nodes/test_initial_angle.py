"""The first command starts from the angle of the wheel, or from zero after a wait."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.parameters import SteeringParameters
from ampc_ros.nodes import initial_angle
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.supervision.guard import bounds
from tests.driver_of_nodes import Driver
from tests.ros_nodes import ros_context

pytestmark = pytest.mark.usefixtures("own_domain")


def one_step(node: ControllerNode) -> float:
    """Return the largest step of the guard in one period at the speed of the driver [rad]."""
    config = node.supervisor.config
    bound = bounds(config.guard, config.chassis, 9.0)
    return min(bound.rate, bound.jerk) * node.supervisor.period + 1e-9


class Wheel:
    """Publishes the angle of the wheel, or the commands of another controller, while it drives."""

    def __init__(self, driver: Driver, topic: str) -> None:
        """Create the publisher."""
        self.driver, self.angle = driver, 0.0
        self.publisher = driver.create_publisher(JointState, topic, ros.RELIABLE)

    def until(self, condition: Callable[[], bool]) -> None:
        """Publish angle and odometry until a condition holds."""

        def holds() -> bool:
            self.publisher.publish(ros.joint_message(self.driver.now_ns, self.angle, 0.0))
            return condition()

        self.driver.drive_until(holds)


def published(node: ControllerNode) -> list[float]:
    """Return the list of all angles that the controller publishes from now on [rad]."""
    angles: list[float] = []
    publish = node.outputs.commands.publish

    def store(message: JointState) -> None:
        angles.append(message.position[0])
        publish(message)

    node.outputs.commands.publish = store  # type: ignore[assignment, method-assign]
    return angles


@pytest.mark.parametrize("period", [0.1, 0.02, 0.01])
@pytest.mark.parametrize("angle", [0.25, -0.1])
def test_a_controller_that_starts_in_a_bend_starts_from_the_measured_angle(
    period: float, angle: float, tmp_path: Path
) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text(f"sample_time: {period}\nlook_ahead_time: 0.8\n", encoding="utf-8")
    parameters = {"controller": "pure_pursuit", "static_path": "true", "settings": str(settings)}
    with ros_context(**parameters, autostart="false") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        assert driver.change(Transition.TRANSITION_CONFIGURE)
        wheel = Wheel(driver, ros.STEERING_STATE)
        wheel.angle = angle
        wheel.until(lambda: node.initial.measured == angle and node.supervisor.is_ready)
        angles = published(node)
        node.trigger_activate()
        wheel.until(lambda: len(angles) > 1 and len(driver.commands) > 0)
        assert abs(angles[0] - angle) <= one_step(node)


def test_after_an_intervention_of_the_driver_steering_starts_from_the_measured_angle() -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        driver.drive_for(8)
        assert node.supervisor.steering > 0.05
        driver.change(Transition.TRANSITION_DEACTIVATE)
        wheel = Wheel(driver, ros.STEERING_STATE)
        wheel.angle = -0.2
        wheel.until(lambda: node.initial.measured == -0.2)
        angles = published(node)
        node.trigger_activate()
        wheel.until(lambda: bool(angles))
        assert abs(angles[0] + 0.2) <= one_step(node)


def test_without_a_measurement_steering_starts_from_the_last_command_heard() -> None:
    with ros_context(controller="pure_pursuit", static_path="true", autostart="false") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        assert driver.change(Transition.TRANSITION_CONFIGURE)
        other = Wheel(driver, ros.STEERING_COMMAND)
        other.angle = 0.3
        other.until(lambda: node.initial.heard == 0.3 and node.supervisor.is_ready)
        driver.destroy_publisher(other.publisher)  # the other controller ends
        angles = published(node)
        node.trigger_activate()
        driver.drive_until(lambda: bool(angles))
        assert abs(angles[0] - 0.3) <= one_step(node)
        assert node.initial.subscription is None


def test_an_old_measurement_is_not_used() -> None:
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        driver.drive_for(8)
        driver.change(Transition.TRANSITION_DEACTIVATE)
        own, now = node.supervisor.steering, time.monotonic()
        node.initial.on_measured(-0.4)
        node.initial.measured_at = now - initial_angle.FRESH - 1.0
        angles = published(node)
        node.trigger_activate()
        driver.drive_until(lambda: bool(angles))
        assert abs(angles[0] - own) <= one_step(node)


def test_without_any_angle_steering_waits_and_then_starts_from_zero_with_a_message(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(initial_angle, "START_WAIT", 0.5)
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        driver.drive_until(lambda: node.initial.since is not None)
        begin = node.initial.since
        assert begin is not None
        angles = published(node)
        driver.drive_until(lambda: bool(angles))
        assert time.monotonic() - begin >= 0.5
        assert abs(angles[0]) <= one_step(node)
    line = "no steering_state and no steering_command within 0.5 s: steering starts from zero"
    log = capfd.readouterr().err
    assert log.count(line) == 1
    assert "no command for" not in log  # the wait is no silence


def test_an_angle_that_arrives_during_the_wait_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(initial_angle, "START_WAIT", 1e9)
    with ros_context(controller="pure_pursuit", static_path="true") as executor:
        node = ControllerNode()
        driver = Driver(executor, node)
        driver.drive_until(lambda: node.initial.since is not None)
        wheel = Wheel(driver, ros.STEERING_STATE)
        wheel.angle = 0.2
        angles = published(node)
        wheel.until(lambda: bool(angles))
        assert abs(angles[0] - 0.2) <= one_step(node)


def test_in_lock_step_steering_starts_from_zero_at_once() -> None:
    with ros_context(controller="pure_pursuit", lock_step="true"):
        node = ControllerNode()
        assert not node.initial.is_pending
        assert node.initial.subscription is None
        node.destroy_node()


@pytest.mark.parametrize("message", [JointState(), ros.joint_message(1, 0.1, 0.0)])
def test_a_command_that_is_no_angle_is_not_heard(message: Any) -> None:
    heard = initial_angle.InitialAngle.__new__(initial_angle.InitialAngle)
    heard.steering, heard.heard = ros.ROAD_WHEEL, 0.5
    heard.on_command(message)
    assert heard.heard == (0.1 if message.position else 0.5)


def test_the_ratio_of_the_topic_holds_for_commands_that_are_heard() -> None:
    heard = initial_angle.InitialAngle.__new__(initial_angle.InitialAngle)
    heard.steering = SteeringParameters(max_angle=0.6, ratio=16.0, offset=0.02)
    heard.on_command(ros.joint_message(1, 0.3, 0.0, heard.steering))
    assert heard.heard == pytest.approx(0.3)
