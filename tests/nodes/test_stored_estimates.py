"""Estimates of the car that a controller node stores, uses and forgets, over a real ROS graph."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from ampc_ros.configuration import CarDifference, Choices, configuration
from ampc_ros.estimation.adaptation import LATENCY_CHANGE
from ampc_ros.estimation.stored_difference import (
    difference_file,
    read_difference,
    store_difference,
)
from ampc_ros.nodes.controller_node import ControllerNode
from tests.nodes.test_late_odometry import Bicycle, on_a_circle
from tests.ros_nodes import ros_context

pytestmark = pytest.mark.usefixtures("own_domain")

CONFIG = configuration(Choices(static_path=True))
STORED = CarDifference(0.01, 1e-4, 0.005, 0.05)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of stored estimates."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def executor(folder: Path) -> Iterator[SingleThreadedExecutor]:
    """The executor of a controller that starts with stored estimates."""
    store_difference(CONFIG, STORED)
    with ros_context(gain_table="preview_paper", static_path="true", guard="track") as nodes:
        yield nodes


def forget(car: Bicycle) -> Trigger.Response:
    """Call the service."""
    client = car.create_client(Trigger, f"{car.controller.get_name()}/forget")
    car.spin_until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    car.spin_until(future.done)
    response = future.result()
    assert response
    return response


def test_estimates_are_used_forgotten_and_stored_again(executor: SingleThreadedExecutor) -> None:
    car = on_a_circle(executor)
    supervisor = car.controller.supervisor
    assert supervisor.adaptation
    assert supervisor.config.difference == STORED
    assert supervisor.adaptation.difference == STORED
    assert supervisor.assumed_car.offset == STORED.steering_offset

    car.begin()
    car.drive_on(20)
    assert forget(car).success
    assert supervisor.config.difference == CarDifference()
    assert not math.isclose(supervisor.adaptation.x[4], STORED.steering_offset)
    assert read_difference(CONFIG) is None

    car.drive_on(20)
    supervisor.adaptation.P[LATENCY_CHANGE, LATENCY_CHANGE] = 1e-6  # as after bends
    car.controller.publish_final()
    stored = read_difference(CONFIG)
    assert stored is not None
    assert stored == supervisor.adaptation.difference


def test_damaged_estimates_do_not_stop_the_node(folder: Path) -> None:
    file = difference_file(CONFIG)
    file.parent.mkdir()
    file.write_text("{", encoding="utf-8")
    with ros_context(gain_table="preview_paper", static_path="true"):
        node = ControllerNode()
        assert node.supervisor.adaptation
        assert node.supervisor.adaptation.difference == CarDifference()
        node.destroy_node()


@pytest.mark.parametrize("mode", ["lock_step", "use_sim_time"])
def test_simulated_time_uses_no_stored_estimates(mode: str, folder: Path) -> None:
    store_difference(CONFIG, STORED)
    with ros_context(gain_table="preview_paper", **{mode: "true"}):
        node = ControllerNode()
        assert not node.estimates.is_used
        assert node.supervisor.config.difference is None
        node.destroy_node()
