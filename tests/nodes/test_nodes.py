"""The nodes one by one: parameters, bad inputs, clocks, names, lost peers, no late compiling."""

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.msg import ParameterType
from rclpy.clock import ROSClock
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.base_node import spin
from ampc_msgs_config.types import FEED_FORWARD, NANOSECONDS, OPTIMAL, SHIFTED_PLAN, VehicleState
from ampc_ros.configuration import CONTROLLERS
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from sim_vehicle.nodes.simulator_node import RESEND, TIMED_OUT, SimulatorNode
from tests.fresh_process import compiled_signatures, in_a_fresh_process
from tests.ros_nodes import add, connect, ros_context, spin_to_the_end, spin_until

NODES: list[Callable[[], Any]] = [ControllerNode, PlannerNode, SimulatorNode]
TICK_NS = NANOSECONDS // 10
STRAIGHT = [(float(x), 0.0) for x in range(0, 500, 5)]
AT_RUN_TIME = {"settings", "gain_table", "guard", "static_path", "qp_fault"}


def odometry(stamp_ns: int, **changes: Any) -> Odometry:
    """Return a state beside a straight path, at 9 m/s, with some numbers changed."""
    x = 9.0 * (stamp_ns / NANOSECONDS % 40.0)
    state = VehicleState(stamp_ns, x, y=0.2, yaw=0.01, v_x=9.0, v_y=0.0, yaw_rate=0.0)
    return ros.odometry_message(state._replace(**changes))


def path(points: Any = STRAIGHT, frame: str = ros.MAP) -> PathMessage:
    """Return the message of a path."""
    message = ros.path_message(np.array(points), 0)
    message.header.frame_id = frame
    return message


class World(Node):
    """Publishes the inputs of a node, and stores its commands and reports."""

    def __init__(self, executor: SingleThreadedExecutor, node: Node) -> None:
        """Wait until both are connected."""
        super().__init__("world")
        self.executor_of_all = executor
        self.commands: list[ros.Stamped] = []
        self.reports: list[DiagnosticStatus] = []
        self.clock = self.create_publisher(ClockMessage, ros.CLOCK, ros.RELIABLE)
        self.odom = self.create_publisher(Odometry, ros.ODOM, ros.RELIABLE)
        self.paths = self.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.LATCHED)
        self.create_subscription(JointState, ros.STEERING_COMMAND, self.on_command, ros.RELIABLE)
        self.create_subscription(DiagnosticArray, ros.DIAGNOSTICS, self.on_report, ros.RELIABLE)
        add(executor, self, node)
        connect(executor, self, node)

    def on_command(self, message: JointState) -> None:
        """Store a command."""
        self.commands.append(ros.steering_angle(message))

    def on_report(self, message: DiagnosticArray) -> None:
        """Store a report."""
        self.reports.extend(message.status)

    def next_report(self, node: Any) -> DiagnosticStatus:
        """Request a report of a node and return it."""
        node.on_diagnostics()
        known = len(self.reports)
        self.spin_until(lambda: len(self.reports) > known)
        return self.reports[-1]

    def set_clock(self, seconds: float, node: Any) -> None:
        """Publish simulated time, and wait until a node has it."""
        stamp_ns = round(seconds * NANOSECONDS)
        self.clock.publish(ClockMessage(clock=ros.time_message(stamp_ns)))
        self.spin_until(lambda: bool(node.now_ns == stamp_ns))

    def spin_until(self, condition: Callable[[], bool]) -> None:
        """Run all nodes until a condition holds."""
        spin_until(self.executor_of_all, condition)


def test_every_parameter_has_a_description_every_number_a_range_and_five_change_at_run_time() -> (
    None
):
    with ros_context() as executor:
        for make_node in NODES:
            node = make_node()
            add(executor, node)
            names = node.get_parameters_by_prefix("").keys() - {"use_sim_time"}
            ours = [name for name in names if not name.startswith("start_type_description")]
            assert {"lock_step", "vehicle"} <= set(ours)
            for descriptor in node.describe_parameters(ours):
                assert descriptor.description
                assert descriptor.read_only == (descriptor.name not in AT_RUN_TIME)
                if descriptor.type == ParameterType.PARAMETER_DOUBLE:
                    assert descriptor.floating_point_range
                if descriptor.type == ParameterType.PARAMETER_INTEGER:
                    assert descriptor.integer_range


WRONG_VALUES = [
    (ControllerNode, "controller:=magic", "controller = 'magic' must be one of preview, paper"),
    (ControllerNode, "vehicle:=none.yaml", "'none.yaml' is neither a file nor one of the shipped"),
    (ControllerNode, "settings:=heavy.yaml", "heavy.yaml: max_angle = -1.0 must lie in [0, 1.5]"),
    (ControllerNode, "gain_table:=holes.yaml", "holes.yaml: missing key 'gains'"),
    (
        ControllerNode,
        "base_link_to_cg:=.nan",
        "base_link_to_cg out of range Min: -20.0, Max: 20.0, value: nan",
    ),
    (ControllerNode, "base_link_to_cg:=50.0", "base_link_to_cg out of range"),
    (PlannerNode, "scenario:=sc99", "'sc99' is neither a file nor one of the shipped scenarios"),
    (PlannerNode, "path:=road.csv", "road.csv: line 3: 'x' must be a number"),
    (PlannerNode, "speed:=.nan", "speed out of range Min: -1.0, Max: 100.0, value: nan"),
    (PlannerNode, "speed:=fast", "'speed' to 'fast' of type 'STRING', expecting type 'DOUBLE'"),
    (SimulatorNode, "friction:=3.1", "friction out of range Min: -1.0, Max: 3.0, value: 3.1"),
    (SimulatorNode, "friction:=-1.1", "friction out of range Min: -1.0, Max: 3.0, value: -1.1"),
    (SimulatorNode, "noise:=loud", "'loud' is neither a file nor one of the shipped noise"),
    (SimulatorNode, "seed:=-1", "seed out of range"),
    (SimulatorNode, "time_out:=.inf", "time_out out of range"),
]


@pytest.mark.parametrize(("make_node", "value", "sentence"), WRONG_VALUES)
def test_a_wrong_value_ends_a_node_with_one_line_that_names_it(
    make_node: Callable[[], Any],
    value: str,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "heavy.yaml").write_text("max_angle: -1.0\n", encoding="utf-8")
    (tmp_path / "holes.yaml").write_text("speed: [1.0]\n", encoding="utf-8")
    (tmp_path / "road.csv").write_text("x_m,y_m\n0,0\nx,0\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["node", "--ros-args", "-p", value])
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # this process keeps its own
    assert spin(make_node) == 2
    said = capfd.readouterr()
    assert said.err.startswith("error: ")
    assert sentence in said.err
    assert (said.out + said.err).count("\n") == 1


BAD_STATES = [
    (odometry(2, x=float("nan")), "odom: pose.pose.position.x = nan must be finite"),
    (odometry(2, v_x=float("inf")), "odom: twist.twist.linear.x = inf must be finite"),
    (odometry(2), "odom: pose.pose.orientation = (0, 0, 0, 0) must have a length in [0.9, 1.1]"),
    (odometry(2), "odom: header.frame_id = 'odom' must be 'map', the frame of the first odom"),
]
orientation = BAD_STATES[2][0].pose.pose.orientation
orientation.z = orientation.w = 0.0
BAD_STATES[3][0].header.frame_id = "odom"
BAD_PATHS = [
    (
        path(frame="odom"),
        "header.frame_id = 'odom' differs from 'map', the frame of the first odom: publish",
    ),
    (path([(0.0, 0.0), (float("nan"), 1.0)]), "must be finite"),
    (path([(1.0, 2.0), (1.0, 2.0)]), "at least 2 are needed"),
]


def test_bad_inputs_are_rejected_counted_and_reported_and_the_last_good_ones_kept() -> None:
    with ros_context(controller="pure_pursuit", use_sim_time="true") as executor:
        node = ControllerNode()
        world = World(executor, node)
        node.on_odometry(odometry(1))
        node.on_path(path())
        state, good_path = node.supervisor.state, node.supervisor.path
        for message, sentence in BAD_STATES + BAD_PATHS:
            callback = node.on_odometry if isinstance(message, Odometry) else node.on_path
            callback(message)
            report = world.next_report(node)
            assert report.level == DiagnosticStatus.WARN
            assert sentence in report.message
            assert node.supervisor.state is state
            assert node.supervisor.path is good_path
        last = world.next_report(node)
    assert last.level == DiagnosticStatus.OK
    assert {pair.key: pair.value for pair in last.values}["rejected_inputs"] == str(
        len(BAD_STATES + BAD_PATHS)
    )


def test_the_controller_steers_on_its_timer_and_stamps_its_command_with_the_state() -> None:
    with ros_context(controller="pure_pursuit") as executor:
        node = ControllerNode()
        world = World(executor, node)
        world.paths.publish(path())
        sent: list[int] = []

        def has_five_commands() -> bool:
            sent.append(node.now_ns)
            driven = 9.0 * (sent[-1] - sent[0]) / NANOSECONDS
            world.odom.publish(odometry(sent[-1], x=driven))
            return len(world.commands) >= 5

        world.spin_until(has_five_commands)
    stamps = [command.stamp_ns for command in world.commands]
    assert stamps == sorted(set(stamps))
    assert set(stamps) <= set(sent)


def test_a_state_that_comes_after_its_tick_is_answered_at_once_and_none_is_missed() -> None:
    with ros_context(controller="pure_pursuit", use_sim_time="true") as executor:
        node = ControllerNode()
        add(executor, node)
        node.on_path(path())
        node.on_odometry(odometry(TICK_NS))
        assert not node.policy.is_answered
        node.on_timer()
        for tick in range(2, 7):
            node.on_timer()
            node.on_odometry(odometry(tick * TICK_NS))
            assert node.policy.is_answered
        assert (node.commands, node.policy.missed, node.trouble) == (6, 0, "")
        for _ in range(3):
            node.on_timer()
        assert node.policy.missed == 2
        assert node.trouble == "no new odom since the last tick"


def test_debug_topics_are_published_where_somebody_listens() -> None:
    with ros_context(controller="pure_pursuit", use_sim_time="true") as executor:
        node = ControllerNode()
        world = World(executor, node)
        heard: list[float] = []
        topic = "controller/debug/cross_track_error"

        def on_error(message: Any) -> None:
            heard.append(message.data)

        world.create_subscription(Float64, topic, on_error, ros.RELIABLE)
        world.spin_until(lambda: world.count_publishers(topic) > 0)
        world.spin_until(lambda: any(each.get_subscription_count() for each in node.outputs.debug))
        node.on_path(path())
        node.on_odometry(odometry(TICK_NS, y=0.25, yaw=0.0))
        node.on_timer()
        world.spin_until(lambda: bool(heard))
        listening = [
            each.topic_name for each in node.outputs.debug if each.get_subscription_count()
        ]
    assert heard == [pytest.approx(0.25)]
    assert listening == [f"/{topic}"]


def test_predicted_paths_are_published_at_each_slow_tick_and_20_times_a_second_at_fast_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ros_context(controller="paper", use_sim_time="true", static_path="true") as executor:
        node = ControllerNode()
        add(executor, node)
        stamps: list[int] = []
        predictions = node.outputs.predictions
        monkeypatch.setattr(predictions, "get_subscription_count", lambda: 1)
        monkeypatch.setattr(
            predictions, "publish", lambda m: stamps.append(ros.nanoseconds(m.header.stamp))
        )
        node.on_path(path())
        node.initial.is_pending = False
        node.on_odometry(odometry(TICK_NS))
        node.step()
        record = node.policy.record
        assert record
        plan = record.command.plan._replace(prediction=np.zeros((2, 2)))
        fast = [NANOSECONDS + number * NANOSECONDS // 100 for number in range(11)]
        slow = [2 * NANOSECONDS + number * NANOSECONDS // 10 for number in range(4)]
        for stamp_ns in (*fast, *slow):
            command = record.command._replace(stamp_ns=stamp_ns, plan=plan)
            now, steering = record._replace(command=command), node.supervisor.config.steering
            node.outputs.publish_tick(now, (0.0, 0.0), (0, 0, 0), steering)
    assert stamps[-7:] == [*fast[::5], *slow]


def test_the_timer_follows_simulated_time_and_time_going_backwards_starts_anew() -> None:
    with ros_context(controller="paper", use_sim_time="true", static_path="true") as executor:
        node = ControllerNode()
        world = World(executor, node)
        world.paths.publish(path())
        world.spin_until(lambda: node.supervisor.path is not None)
        for _ in range(2):
            world.set_clock(0.9, node)
            for stamp_ns in range(NANOSECONDS, 2 * NANOSECONDS, TICK_NS):
                world.odom.publish(odometry(stamp_ns))
                world.spin_until(lambda: node.supervisor.newest_ns == stamp_ns)  # noqa: B023
                world.set_clock(stamp_ns / NANOSECONDS, node)
                world.spin_until(lambda: node.policy.is_answered)
        world.spin_until(lambda: len(world.commands) == 20)
    first, second = world.commands[:10], world.commands[10:]
    assert [command.stamp_ns for command in first] == list(
        range(NANOSECONDS, 2 * NANOSECONDS, TICK_NS)
    )
    assert first == second
    assert len({command.value for command in first}) > 1


def test_the_simulated_car_follows_the_clock_and_starts_anew_when_time_goes_back() -> None:
    with ros_context(use_sim_time="true", scenario="straight", time_out=60.0) as executor:
        simulator = SimulatorNode()
        world = World(executor, simulator)
        add(executor, PlannerNode())
        steering = world.create_publisher(JointState, ros.STEERING_COMMAND, ros.RELIABLE)

        def run_clock(start: int, end: int) -> None:
            for tick in range(start, end):
                world.set_clock(0.1 * tick, simulator)
                steering.publish(ros.joint_message(0, 0.0, 0.0))
                world.spin_until(lambda: abs(simulator.stamp_ns - simulator.now_ns) <= TICK_NS)

        simulator.begin()
        run_clock(40, 50)
        world.spin_until(lambda: not simulator.unanswered())
        run_clock(50, 71)
        gone = simulator.simulation.elapsed_ns
        world.set_clock(0.9, simulator)
        run_clock(10, 12)
    assert 19 * TICK_NS <= gone <= 31 * TICK_NS
    assert simulator.simulation.elapsed_ns <= TICK_NS


def test_a_namespace_and_remapping_move_the_topics() -> None:
    arguments = ("-r", "__ns:=/car1", "-r", "odom:=/localisation")
    with ros_context(*arguments, lock_step="true", controller="pure_pursuit") as executor:
        nodes = [make_node() for make_node in NODES]
        add(executor, *nodes)
        topics = {each.topic_name for node in nodes for each in node.publishers}
        assert {"/car1/steering_command", "/car1/controller/debug/solve_time"} <= topics
        assert {"/localisation", "/clock", "/diagnostics"} <= topics
        assert "/car1/odom" not in topics
        assert spin_to_the_end(executor) == 0


def test_a_simulator_without_peers_ends_in_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    with ros_context(lock_step="true", start_time_out=0.3) as executor:
        add(executor, SimulatorNode())
        assert spin_to_the_end(executor) == TIMED_OUT
    fatal = [line for line in capfd.readouterr().err.split("\n") if "FATAL" in line]
    assert len(fatal) == 1
    assert "no publisher of /steering_command and /target_speed within 0.3 s" in fatal[0]


def test_the_exit_code_of_a_process_is_that_of_its_node(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ["node", "--ros-args", "-p", "lock_step:=true", "-p", "start_time_out:=0.3"]
    monkeypatch.setattr(sys, "argv", words)
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # this process keeps its own
    assert spin(SimulatorNode) == TIMED_OUT


@pytest.mark.parametrize("lock_step", ["true", "false"])
def test_a_simulator_that_loses_its_controller_ends_in_one_line(
    lock_step: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with ros_context(lock_step=lock_step, time_out=0.5, controller="pure_pursuit") as executor:
        controller, simulator = ControllerNode(), SimulatorNode()
        add(executor, controller, simulator, PlannerNode())
        spin_until(executor, lambda: simulator.simulation.elapsed_ns > 3 * TICK_NS)
        executor.remove_node(controller)
        controller.destroy_node()
        assert spin_to_the_end(executor) == TIMED_OUT
    fatal = [line for line in capfd.readouterr().err.split("\n") if "FATAL" in line]
    assert len(fatal) == 1
    assert "no steering_command" in fatal[0]
    assert "target_speed" not in fatal[0]


def test_a_state_is_sent_again_only_after_it_has_waited_for_its_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ros_context(lock_step="true") as executor:
        simulator = SimulatorNode()
        add(executor, simulator)
        simulator.publish_state()
        sent: list[Any] = []
        monkeypatch.setattr(simulator, "send", lambda: sent.append(simulator.state))
        simulator.waiting_since = time.monotonic() - RESEND / 2
        simulator.on_unanswered()
        assert sent == []
        simulator.waiting_since -= 2 * RESEND
        simulator.on_unanswered()
        assert sent == [simulator.state]


def test_the_simulator_refuses_commands_that_no_car_can_follow() -> None:
    with ros_context() as executor:
        simulator = SimulatorNode()
        add(executor, simulator)
        for angles in ([], [float("nan")], [2.0], [0.1, 0.1]):
            message = JointState(position=angles)
            simulator.on_answer(ros.STEERING_COMMAND, ros.steering_angle, message)
        for speed in (float("nan"), -1.0, 200.0):
            message = ros.speed_message(ros.Stamped(0, speed))
            simulator.on_answer(ros.TARGET_SPEED, ros.target_speed, message)
        assert simulator.rejected == 7
        assert simulator.unanswered() == [ros.STEERING_COMMAND, ros.TARGET_SPEED]


MET = [(0.2, 9.0), (0.2, 9.0), (6.0, 30.0), (-3.0, 12.0), (-3.0, 12.0), (-3.0, 9.0)]
"""Lateral position [m] and speed [m/s], a second apart; the last ones go on at ticks."""


def compiled_within_ticks(controller: str) -> dict[str, int]:
    """Return the functions that a fresh process compiles after its nodes are created."""
    given = {"controller": controller, "path": "road.csv", "speed": 8.0, "use_sim_time": "true"}
    with ros_context(**given) as executor:
        nodes = ControllerNode(), PlannerNode(), SimulatorNode()
        add(executor, *nodes)
        steerer, planner, simulator = nodes
        clock, before = steerer.get_clock(), compiled_signatures()
        assert isinstance(clock, ROSClock)
        steerer.on_path(path())
        rungs: set[float] = set()
        for tick in range(16):
            last = min(tick, len(MET) - 1)
            seconds, (y, v_x) = 1 + last + (tick - last) / 10, MET[last]
            stamp_ns = round(seconds * NANOSECONDS)
            clock.set_ros_time_override(Time(nanoseconds=stamp_ns))
            message = odometry(stamp_ns, x=9.0 * seconds, y=y, v_x=v_x)
            steerer.on_odometry(message)
            steerer.on_steering(ros.joint_message(0, 0.0, 0.0))
            steerer.on_timer()
            assert steerer.policy.is_answered
            planner.on_odometry(message)
            simulator.simulation.advance(0.1, 9.0, TICK_NS)
            simulator.publish_state()
            assert steerer.policy.record
            rungs.add(steerer.policy.record.command.rung)
            steerer.supervisor.inject_qp_fault(tick > len(MET))
        assert {OPTIMAL, SHIFTED_PLAN, FEED_FORWARD} <= rungs
        assert steerer.set_parameters([Parameter("guard", value="track")])[0].successful
        stamp_ns += TICK_NS
        steerer.on_odometry(odometry(stamp_ns, x=9.0 * stamp_ns / NANOSECONDS, y=-3.0))
        steerer.on_timer()
        assert steerer.policy.record
        assert steerer.policy.record.configuration == 2
        after = compiled_signatures()
    return {
        name: after[name] - before.get(name, 0) for name in after if after[name] != before[name]
    }


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_nothing_is_compiled_or_loaded_inside_a_tick(
    controller: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = "".join(f"{x},{y}\n" for x, y in STRAIGHT)
    (tmp_path / "road.csv").write_text("x_m,y_m\n" + rows, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert in_a_fresh_process(compiled_within_ticks, controller) == {}
