"""Faults over ROS: real nodes, and the injector between simulator and controller."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.types import REASONS, RUNGS, VehicleState
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from launch_scripts.faults.messages import ODOM, PATH, STEERING, Message
from launch_scripts.faults.schedule import load_plan
from launch_scripts.nodes.injector_node import InjectorNode, packed, unpacked
from launch_scripts.replay import main as replay
from launch_scripts.start import FAULTY as RENAMED
from launch_scripts.start import main as start
from sim_vehicle.nodes.simulator_node import SimulatorNode
from tests.ros_nodes import add, ros_context, spin_to_the_end

SCENARIO = """
path: {kind: sine, amplitude: 2.0, wavelength: 80.0}
speed: [[0.0, 9.0]]
duration: 9.0
"""
FAULTS = """
faults:
  - {kind: drop, start: 1.0, duration: 0.5}
  - {kind: nan, start: 2.5, duration: 0.5, field: yaw}
  - {kind: freeze, start: 4.0, duration: 0.5}
  - {kind: burst, start: 5.5, duration: 0.1, amount: 1000}
  - {kind: qp_fault, start: 6.5, duration: 0.3}
"""


class Listener(Node):
    """Subscribes to the commands and the records of the ticks."""

    def __init__(self) -> None:
        """Subscribe."""
        super().__init__("listener")
        self.commands: list[float] = []
        self.ticks: list[dict[str, float]] = []
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.on_command, ros.RELIABLE)
        self.create_subscription(JointState, ros.TICK, self.on_tick, ros.RELIABLE)

    def on_command(self, message: JointState) -> None:
        """Store a command."""
        self.commands.append(message.position[0])

    def on_tick(self, message: JointState) -> None:
        """Store the record of a tick."""
        self.ticks.append(dict(zip(message.name, message.position, strict=True)))


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Listener:
    """Drive for 9 s with faults."""
    folder = tmp_path_factory.mktemp("faults")
    for name, text in (("road.yaml", SCENARIO), ("faults.yaml", FAULTS)):
        (folder / name).write_text(text, encoding="utf-8")
    renamed = [f"controller:{topic}:={ros.FAULTY}{topic}" for topic in RENAMED]
    arguments = [text for each in renamed for text in ("-r", each)]
    given = {"scenario": folder / "road.yaml", "faults": folder / "faults.yaml"}
    with ros_context(*arguments, **given) as executor:
        listener = Listener()
        nodes = (listener, InjectorNode(), ControllerNode(), PlannerNode(), SimulatorNode())
        add(executor, *nodes)
        assert spin_to_the_end(executor) == 0
    return listener


def test_the_faults_reach_the_controller_and_it_says_so(heard: Listener) -> None:
    rungs = {RUNGS[int(tick["rung"])] for tick in heard.ticks}
    reasons = {REASONS[int(tick["reason"])] for tick in heard.ticks}
    assert rungs >= {"optimal", "shifted_plan"}
    assert reasons >= {"state_late", "qp_not_solved"}
    assert any(tick["qp_fault"] for tick in heard.ticks)
    assert heard.ticks[-1]["rejected_inputs"] >= 20


def test_the_controller_recovers_and_all_commands_are_inside_the_limits(heard: Listener) -> None:
    assert len(heard.commands) > 70
    assert np.isfinite(heard.commands).all()
    assert np.abs(heard.commands).max() < 0.2
    assert RUNGS[int(heard.ticks[-1]["rung"])] == "optimal"
    assert abs(heard.ticks[-1]["cross_track_error"]) < 0.1
    assert heard.ticks[-1]["qp_fault"] == 0.0


def test_a_path_goes_on_with_a_fresh_stamp_so_that_it_can_be_missed(heard: Listener) -> None:
    assert max(tick["path_age"] for tick in heard.ticks) < 2.0


STATE = VehicleState(3_000_000_000, 1.0, -2.0, 0.5, 9.0, 0.1, 0.2)


def test_what_has_no_fault_goes_on_as_it_came() -> None:
    odom = ros.odometry_message(STATE)
    path = ros.path_message(np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 1.0)]), 5)
    steering = ros.joint_message(7, 0.1, 0.0)
    for topic, message in ((ODOM, odom), (PATH, path), (STEERING, steering)):
        assert packed(unpacked(topic, message, 0)) == message


def test_what_has_a_fault_is_what_the_controller_refuses() -> None:
    message = Message(ODOM, 0, 3_000_000_000, STATE)
    for wrong in ({"frame_id": "odom"}, {"length": 0.0}):
        with pytest.raises(ValueError, match="odom: "):
            ros.vehicle_state(packed(message._replace(**wrong)))
    for points in (np.zeros((0, 2)), np.ones((1, 2))):
        sent = packed(Message(PATH, 0, 5, points))
        assert isinstance(sent, PathMessage)
        assert ros.path_points(sent) == [tuple(point) for point in points]


def test_the_topics_of_injector_recorder_and_controller_are_the_same() -> None:
    assert set(RENAMED) == {ODOM, STEERING, PATH}
    with ros_context() as executor:
        node = InjectorNode()
        add(executor, node)
        offered = {each.topic_name for each in node.publishers}
        assert offered >= {f"/{ros.FAULTY}{topic}" for topic in RENAMED}


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ({"lock_step": True}, "faults need real time"),
        ({"faults": "nothing"}, "neither a file nor one of the shipped faults"),
    ],
)
def test_an_injector_that_cannot_work_says_why(given: dict[str, Any], complaint: str) -> None:
    with ros_context(**given), pytest.raises(ValueError, match=complaint):
        InjectorNode()


def test_a_clock_that_only_the_offline_loop_can_move_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "clock.yaml"
    file.write_text("faults: [{kind: clock_jump, start: 1, duration: 1}]", encoding="utf-8")
    assert load_plan(str(file)).faults
    with ros_context(faults=file), pytest.raises(ValueError, match=r"clock_jump is for inject\.py"):
        InjectorNode()


def test_a_state_that_is_wrong_already_is_counted_and_not_passed_on() -> None:
    with ros_context():
        node = InjectorNode()
        broken = Odometry()
        node.on_message(ODOM, broken)
        assert node.rejected == 1
        assert not node.line.waiting
        node.destroy_node()


def test_start_names_what_is_wrong_with_a_file_of_faults(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("faults: [{kind: fire, start: 1, duration: 1}]", encoding="utf-8")
    assert start(["--faults", str(file)]) == 2
    assert "mine.yaml: faults[0]: kind = 'fire' must be one of" in capsys.readouterr().out


def test_a_run_with_faults_is_recorded_and_replays_bit_for_bit(tmp_path: Path) -> None:
    short = find("scenarios", "straight").read_text(encoding="utf-8")
    (tmp_path / "short.yaml").write_text(re.sub(r"duration: \S+", "duration: 3.0", short))
    chosen = ["--scenario", str(tmp_path / "short.yaml"), "--faults", "example"]
    assert start([*chosen, "--output", str(tmp_path / "run")]) == 0
    assert replay([str(tmp_path / "run" / "bag")]) == 0
