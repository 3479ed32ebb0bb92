"""ROS nodes in lock-step and the offline loop are one drive, bit for bit."""

from collections import Counter
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ampc_msgs_config import ros
from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import VehicleState
from ampc_ros.configuration import Choices, configuration
from ampc_ros.controller import make_controller
from ampc_ros.nodes.controller_node import ControllerNode
from ampc_ros.nodes.planner_node import PlannerNode
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.nodes.simulator_node import SimulatorNode
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file
from tests.ros_nodes import ros_context, spin_to_the_end, spin_until


class Case(NamedTuple):
    """A drive, by shipped names."""

    scenario: str
    controller: str
    noise: str = ""
    seed: int = 0
    guard: str = "road"


CASES = [
    Case("sc1", "paper"),
    Case("sc3_wind", "pure_pursuit"),
    Case("sc1", "classic", "x1", 7),
    Case("sc2", "preview"),
    Case("sc2", "preview", guard="track"),
]


def name_of(case: Case) -> str:
    """Return the name of a test."""
    return "-".join(map(str, filter(None, case)))


class Heard(NamedTuple):
    """What was published, in order."""

    states: list[VehicleState]
    commands: list[ros.Stamped]
    reports_ns: list[int]
    paths_ns: list[int]


class Listener(Node):
    """Subscribes to the topics of the nodes."""

    def __init__(self) -> None:
        """Subscribe."""
        super().__init__("listener")
        self.heard = Heard([], [], [], [])
        listen = partial(self.create_subscription, qos_profile=ros.RELIABLE)
        listen(Odometry, ros.ODOM, self.on_odometry)
        listen(JointState, ros.STEERING_COMMAND, self.on_steering)
        listen(DiagnosticArray, ros.DIAGNOSTICS, self.on_report)
        self.create_subscription(PathMessage, ros.REFERENCE_PATH, self.on_path, ros.LATCHED)

    def on_odometry(self, message: Odometry) -> None:
        """Store a state."""
        self.heard.states.append(ros.vehicle_state(message))

    def on_steering(self, message: JointState) -> None:
        """Store a command."""
        self.heard.commands.append(ros.steering_angle(message))

    def on_report(self, message: DiagnosticArray) -> None:
        """Store the stamp of a report."""
        self.heard.reports_ns.append(ros.nanoseconds(message.header.stamp))

    def on_path(self, message: PathMessage) -> None:
        """Store the stamp of a path."""
        self.heard.paths_ns.append(ros.nanoseconds(message.header.stamp))


def drive_over_ros(case: Case) -> Heard:
    """Drive with the nodes in lock-step, to the end."""
    parameters = {key: value for key, value in case._asdict().items() if value}
    with ros_context(lock_step="true", **parameters) as executor:
        listener = Listener()
        for node in (listener, ControllerNode(), PlannerNode(), SimulatorNode()):
            executor.add_node(node)
        assert spin_to_the_end(executor) == 0
        executor.remove_node(node)
        ticks = len(drive_offline(case).states)
        spin_until(executor, lambda: len(dict(listener.heard.commands)) == ticks)
    return listener.heard


@cache
def drive_offline(case: Case) -> Drive:
    """Drive without ROS, supervised as in the node."""
    return drive(car_of(case), Supervisor(configuration(choices_of(case))))


def choices_of(case: Case) -> Choices:
    """Return the choices that the parameters of the node make in lock-step."""
    return Choices(
        controller=case.controller, guard=case.guard, static_path=True, simulated_time=True
    )


def car_of(case: Case) -> Simulation:
    """Place the car at its start."""
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    scenario = load_scenario(case.scenario, vehicle.size)
    noise = load(MeasurementNoise, find("noise", case.noise)) if case.noise else None
    rng = np.random.default_rng(case.seed)
    return Simulation(vehicle, scenario, noise=noise, rng=rng)


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_ros_in_lock_step_and_the_offline_loop_give_the_same_bits(case: Case) -> None:
    offline, heard = drive_offline(case), drive_over_ros(case)
    commands = dict(heard.commands)
    assert sorted(set(heard.states)) == offline.states
    assert list(commands) == [state.stamp_ns for state in offline.states]
    assert list(commands.values()) == offline.steering.tolist()


@pytest.mark.parametrize("case", CASES, ids=name_of)
def test_a_guard_that_clips_nothing_leaves_every_bit_of_the_controller(case: Case) -> None:
    case = case._replace(guard="track")
    alone = drive(car_of(case), make_controller(choices_of(case)))
    config = configuration(choices_of(case))  # the adaptation changes the model
    config = config._replace(settings=replace(config.settings, adaptation=False))
    guarded = drive(car_of(case), Supervisor(config))
    assert guarded.steering.tolist() == alone.steering.tolist()


def test_every_state_is_answered_once_and_all_stamps_are_simulated_time() -> None:
    heard = drive_over_ros(CASES[0])
    asked = Counter(state.stamp_ns for state in heard.states)
    answered = Counter(stamp_ns for stamp_ns, _ in heard.commands)
    assert asked.keys() == answered.keys()
    assert all(answered[stamp_ns] <= asked[stamp_ns] for stamp_ns in asked)
    assert len(set(heard.commands)) == len(answered)
    first, last = min(asked), max(asked)
    assert heard.paths_ns == [first]
    assert heard.reports_ns
    assert all(first <= stamp_ns <= last for stamp_ns in heard.reports_ns)
