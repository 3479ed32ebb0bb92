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
from ampc_msgs_config.topics import FAULTED as RENAMED
from ampc_msgs_config.types import REASONS, RUNGS, VehicleState
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from launch_scripts.faults.messages import ODOM_INPUT, PATH, STEERING_INPUT, Message
from launch_scripts.faults.schedule import load_faults
from launch_scripts.nodes.injector_node import InjectorNode, pack, unpack
from launch_scripts.replay import main as replay
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
def listener(tmp_path_factory: pytest.TempPathFactory) -> Listener:
    """Drive for 9 s with faults and return the recorded messages."""
    folder = tmp_path_factory.mktemp("faults")
    for name, text in (("road.yaml", SCENARIO), ("faults.yaml", FAULTS)):
        (folder / name).write_text(text, encoding="utf-8")
    renamed = [f"controller:{topic}:={ros.FAULTY}{topic}" for topic in RENAMED]
    arguments = [text for each in renamed for text in ("-r", each)]
    parameters = {"scenario": folder / "road.yaml", "faults": folder / "faults.yaml"}
    with ros_context(*arguments, **parameters) as executor:
        listener = Listener()
        nodes = (listener, InjectorNode(), ControllerNode(), PlannerNode(), SimulatorNode())
        add(executor, *nodes)
        assert spin_to_the_end(executor) == 0
    return listener


def test_the_faults_reach_the_controller_and_are_reported(listener: Listener) -> None:
    rungs = {RUNGS[int(tick["rung"])] for tick in listener.ticks}
    reasons = {REASONS[int(tick["reason"])] for tick in listener.ticks}
    assert rungs >= {"optimal", "shifted_plan"}
    assert reasons >= {"state_late", "qp_not_solved"}
    assert any(tick["qp_fault"] for tick in listener.ticks)
    assert listener.ticks[-1]["rejected_inputs"] >= 20


def test_the_controller_recovers_and_all_commands_are_inside_the_limits(listener: Listener) -> None:
    assert len(listener.commands) > 70
    assert np.isfinite(listener.commands).all()
    assert np.abs(listener.commands).max() < 0.2
    assert RUNGS[int(listener.ticks[-1]["rung"])] == "optimal"
    assert abs(listener.ticks[-1]["cross_track_error"]) < 0.1
    assert listener.ticks[-1]["qp_fault"] == 0.0


def test_a_path_is_republished_with_a_new_stamp(listener: Listener) -> None:
    assert max(tick["path_age"] for tick in listener.ticks) < 2.0


STATE = VehicleState(3_000_000_000, 1.0, -2.0, 0.5, 9.0, 0.1, 0.2)


def test_messages_without_a_fault_are_forwarded_unchanged() -> None:
    odom = ros.odometry_message(STATE)
    path = ros.path_message(np.array([(0.0, 0.0), (1.0, 0.0), (2.0, 1.0)]), 5)
    steering = ros.joint_message(7, 0.1, 0.0)
    for topic, message in ((ODOM_INPUT, odom), (PATH, path), (STEERING_INPUT, steering)):
        assert pack(unpack(topic, message, 0, ros.ROAD_WHEEL), ros.ROAD_WHEEL) == message


def test_faulty_messages_are_rejected_by_the_controller() -> None:
    message = Message(ODOM_INPUT, 0, 3_000_000_000, STATE)
    for wrong in ({"frame_id": ""}, {"length": 0.0}):
        with pytest.raises(ValueError, match="odom: "):
            ros.vehicle_state(pack(message._replace(**wrong), ros.ROAD_WHEEL))
    for points in (np.zeros((0, 2)), np.ones((1, 2))):
        sent = pack(Message(PATH, 0, 5, points), ros.ROAD_WHEEL)
        assert isinstance(sent, PathMessage)
        assert ros.path_points(sent) == [tuple(point) for point in points]


def test_the_topics_of_injector_recorder_and_controller_are_the_same() -> None:
    assert set(RENAMED) == {ODOM_INPUT, STEERING_INPUT, PATH}
    with ros_context() as executor:
        node = InjectorNode()
        add(executor, node)
        offered = {each.topic_name for each in node.publishers}
        assert offered >= {f"/{ros.FAULTY}{topic}" for topic in RENAMED}


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"lock_step": True}, "lock_step must be false"),
        ({"faults": "nothing"}, "nothing"),
    ],
)
def test_an_unusable_parameter_is_rejected_with_its_name(
    parameters: dict[str, Any], message: str
) -> None:
    with ros_context(**parameters), pytest.raises(ValueError, match=message):
        InjectorNode()


def test_a_clock_jump_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "clock.yaml"
    file.write_text("faults: [{kind: clock_jump, start: 1, duration: 1}]", encoding="utf-8")
    assert load_faults(str(file)).faults
    with ros_context(faults=file), pytest.raises(ValueError, match="clock_jump"):
        InjectorNode()


def test_an_invalid_state_is_counted_and_not_forwarded() -> None:
    with ros_context():
        node = InjectorNode()
        broken = Odometry()
        node.on_message(ODOM_INPUT, broken)
        assert node.rejected == 1
        assert not node.injector.waiting
        node.destroy_node()


def test_start_names_what_is_wrong_with_a_file_of_faults(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("faults: [{kind: fire, start: 1, duration: 1}]", encoding="utf-8")
    assert start(["--faults", str(file)]) == 2
    assert "mine.yaml: faults[0].kind = 'fire' must be one of" in capsys.readouterr().out


def test_a_run_with_faults_is_recorded_and_replays_bit_for_bit(tmp_path: Path) -> None:
    short = find("scenarios", "straight").read_text(encoding="utf-8")
    (tmp_path / "short.yaml").write_text(re.sub(r"duration: \S+", "duration: 3.0", short))
    chosen = ["--scenario", str(tmp_path / "short.yaml"), "--faults", "example"]
    assert start([*chosen, "--output", str(tmp_path / "run")]) == 0
    assert replay([str(tmp_path / "run" / "bag")]) == 0
