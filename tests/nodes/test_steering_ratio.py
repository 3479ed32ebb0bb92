"""A car whose steering topics carry steering-wheel angles drives like one without a ratio."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from ampc_msgs_config import ros, topics
from ampc_msgs_config.config import find
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.nodes.controller_node import ControllerNode
from launch_scripts.bags.bag import open_bag
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.bags.drive_log import drive_log
from launch_scripts.replay import main as replay
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.nodes.simulator_node import SimulatorNode
from sim_vehicle.parameters import load_vehicle_file
from tests.ros_nodes import add, ros_context, spin_until
from tests.tools.test_start import run

RATIO, OFFSET = 15.0, math.radians(1.0)


@pytest.fixture
def geared(tmp_path: Path) -> Path:
    """Write the ordinary car with a steering ratio and an offset."""
    file = tmp_path / "geared.yaml"
    steering = f"{{ratio: {RATIO}, offset: {OFFSET}}}"
    file.write_text(f"same_as: ordinary\nsteering: {steering}\n", encoding="utf-8")
    return file


def test_a_geared_car_drives_as_without_gear_and_its_topics_turn_with_the_steering_wheel(
    geared: Path, tmp_path: Path
) -> None:
    options = ("--vehicle", str(geared), "--gain-table", "preview_ordinary")
    code, said = run(tmp_path / "run", *options)
    assert code == 0, said
    bag = tmp_path / "run" / "bag"
    # The same drive without ROS and gear
    vehicle = load_vehicle_file(find("vehicles", "ordinary"))
    road = load_scenario("sc1", vehicle.size)
    plain = drive(Simulation(vehicle, road), make_controller(Choices(vehicle="ordinary")))
    log = drive_log(read_columns(bag))
    np.testing.assert_allclose(log.drive.steering, plain.steering, rtol=0, atol=1e-9)
    np.testing.assert_allclose(log.drive.states, plain.states, rtol=0, atol=1e-6)
    # Topics, report and replay
    commands = {}
    with open_bag(bag) as opened:
        for each in opened.messages({f"/{topics.STEERING_COMMAND}", f"/{topics.STEERING_STATE}"}):
            message = opened.decode(each)
            key = each.topic, ros.nanoseconds(message.header.stamp)
            commands[key] = message.position[0]
    sent = [v for (topic, _), v in sorted(commands.items()) if topic.endswith("command")]
    expected = RATIO * (plain.steering - OFFSET)
    np.testing.assert_allclose(sent, expected, rtol=0, atol=1e-8)
    measured = [v for (topic, _), v in sorted(commands.items()) if topic.endswith("state")]
    assert measured[0] == pytest.approx(-RATIO * OFFSET)
    assert np.ptp(measured) > 0.5 * np.ptp(sent)
    report = json.loads((tmp_path / "run" / "report.json").read_text())["drives"][0]
    largest = math.degrees(np.abs(plain.steering).max())
    assert math.degrees(report["summary"]["max_steering"]) == pytest.approx(largest, rel=1e-6)
    assert replay([str(bag)]) == 0


def test_controller_and_simulator_convert_in_real_time(geared: Path) -> None:
    with ros_context(vehicle=str(geared)) as executor:
        controller, simulator = ControllerNode(), SimulatorNode()
        add(executor, controller, simulator)
        controller.on_steering(
            ros.joint_message(0, 0.1, 0.0, controller.supervisor.config.steering)
        )
        assert controller.supervisor._measured == pytest.approx(0.1, abs=1e-15)
        simulator.publish_state()
        state = next(
            message for publisher, message in simulator.state if publisher is simulator.steering
        )
        assert state.position[0] == pytest.approx(-RATIO * OFFSET)
        simulator.on_answer(ros.STEERING_COMMAND, simulator.angle_of, state)
        assert simulator.answers[ros.STEERING_COMMAND].value == pytest.approx(0.0, abs=1e-15)


def test_an_implausible_vehicle_is_a_warning_in_the_diagnostics_once(tmp_path: Path) -> None:
    file = tmp_path / "soft.yaml"
    stiffness = "{front_cornering_stiffness: 942.0, rear_cornering_stiffness: 1082.0}"
    file.write_text(f"same_as: ordinary\nchassis: {stiffness}\n", encoding="utf-8")
    said: list[str] = []
    with ros_context(vehicle=str(file)) as executor:
        viewer = Node("viewer")
        add(executor, viewer)

        def hear(message: DiagnosticArray) -> None:
            said.extend(status.message for status in message.status)

        viewer.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, hear, ros.RELIABLE)
        controller = ControllerNode()
        add(executor, controller)
        spin_until(executor, lambda: controller.diagnostics.get_subscription_count() > 0)
        said.clear()
        controller.trouble, controller.warned = "", ()
        controller.warn_of_vehicle()
        controller.warn_of_vehicle()
        for _ in range(2):
            controller.on_diagnostics()
        spin_until(executor, lambda: len(said) >= 2)
    found = [text for text in said if "is it in N/deg? Then state 53972.6" in text]
    assert len(found) == 1
