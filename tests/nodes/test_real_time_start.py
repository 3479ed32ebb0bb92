"""The simulated car in real time: its states agree with each other from the first one on."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rclpy.clock import ROSClock
from rclpy.time import Time

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.supervision.checks import StateFilter
from sim_vehicle.nodes.simulator_node import LONGEST_CATCH_UP, SimulatorNode
from tests.ros_nodes import add, ros_context

PERIOD_NS = NANOSECONDS // 50


class Started:
    """A simulator whose clock the test sets, and the states that it publishes."""

    def __init__(self, node: SimulatorNode, monkeypatch: pytest.MonkeyPatch) -> None:
        """Begin, as soon as both peers are there."""
        self.node, self.states = node, list[VehicleState]()
        clock = node.get_clock()
        assert isinstance(clock, ROSClock)
        self.clock = clock
        monkeypatch.setattr(node.odom, "publish", self.on_odometry)
        self.at(1000.0)
        node.begin()

    def on_odometry(self, message: Any) -> None:
        """Store a state."""
        self.states.append(ros.vehicle_state(message))

    def at(self, seconds: float) -> None:
        """Set the clock."""
        self.now = seconds
        self.clock.set_ros_time_override(Time(nanoseconds=round(seconds * NANOSECONDS)))

    def tick(self, period: float = 0.02) -> None:
        """Call the timer of the node after a period [s]."""
        self.at(self.now + period)
        self.node.on_real_time()

    def answer(self, target: float, angle: float = 0.0) -> None:
        """Send both commands."""
        node = self.node
        node.on_answer(ros.STEERING_COMMAND, node.angle_of, ros.joint_message(0, angle, 0.0))
        speed = ros.speed_message(ros.Stamped(0, target))
        node.on_answer(ros.TARGET_SPEED, ros.target_speed, speed)


@pytest.fixture
def started(request: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Started]:
    """A car that waits at its start for a drive at the speed of the parameter [m/s]."""
    speed = getattr(request, "param", 12.0)
    with ros_context(use_sim_time="true", scenario="straight", speed=speed) as executor:
        node = SimulatorNode()
        add(executor, node)
        yield Started(node, monkeypatch)


@pytest.mark.parametrize("started", [6.0, 9.0, 15.0, 22.0, 30.0], indirect=True)
def test_no_state_is_rejected_however_long_the_car_waits_and_whatever_gets_lost(
    started: Started,
) -> None:
    speed = started.node.simulation.start_speed
    rng = np.random.default_rng(round(speed))
    for _ in range(int(rng.integers(1, 200))):
        started.tick()
    assert {(state.v_x, state.x, state.y) for state in started.states} == {
        (0.0, started.states[0].x, started.states[0].y)
    }
    started.answer(speed)
    for _ in range(200):
        started.tick(0.02 if rng.random() < 0.9 else float(rng.uniform(0.02, 0.4)))
    assert started.states[-1].v_x == pytest.approx(speed, abs=0.2)
    for share in (0.0, 0.3, 0.8):
        check = StateFilter()
        received = [state for state in started.states if rng.random() >= share]
        results = [check.accept(state, state.stamp_ns) for state in received]
        assert [result.reason for result in results if result.reason] == []
        assert not any(result.reset for result in results)


@pytest.mark.parametrize("after", [0.0, 600.0])
def test_a_timer_that_jitters_neither_adds_nor_leaves_out_a_step(
    started: Started, after: float
) -> None:
    started.answer(12.0)
    started.tick()
    started.tick(0.02 + after)
    started.answer(12.0)
    begin, rng = started.now, np.random.default_rng(1)
    for tick in range(1, 200):
        started.tick(begin + 0.02 * tick + float(rng.uniform(-1e-3, 1e-3)) - started.now)
    steps = np.diff([state.stamp_ns for state in started.states[-199:]])
    assert set(steps.tolist()) == {PERIOD_NS}
    assert 1e-3 < started.now - started.states[-1].stamp_ns / NANOSECONDS < 4e-3


def test_a_pose_that_moves_without_its_twist_is_still_rejected() -> None:
    check = StateFilter()
    for tick in range(1, 101):  # a wheel sensor that fails: the car moves, the twist does not
        moved = max(tick - 50, 0) * 0.02 * 15.0
        state = VehicleState(tick * PERIOD_NS, moved, 0.0, 0.0, 0.0, 0.0, 0.0)
        last = check.accept(state, state.stamp_ns)
    assert not last.accepted
    assert check.rejected["position_jump"] + check.rejected["twist_contradicts_pose"] > 20


def test_a_twist_that_alternates_does_not_excuse_a_frozen_pose() -> None:
    check = StateFilter()
    for tick in range(1, 101):
        v = 20.0 if tick % 2 else 0.0
        check.accept(VehicleState(tick * PERIOD_NS, 0.0, 0.0, 0.0, v, 0.0, 0.0), tick * PERIOD_NS)
    assert check.rejected["twist_contradicts_pose"] > 50


def test_a_simulator_that_joins_a_running_graph_starts_its_drive(started: Started) -> None:
    started.at(1.8e9)
    started.answer(12.0)  # of nodes that were running before
    for _ in range(20):
        started.tick()
    assert 0.3 < started.node.simulation.elapsed_ns / NANOSECONDS < 0.5
    travelled = math.dist(started.states[-1][1:3], started.states[0][1:3])
    assert travelled == pytest.approx(12.0 * 0.38, abs=0.5)


def test_a_requested_stop_keeps_the_car_at_its_start_until_it_is_taken_back(
    started: Started,
) -> None:
    started.answer(0.0)
    for _ in range(50):
        started.tick()
    assert started.node.missing() == "the car waits at its start for target_speed above 0 m/s"
    assert started.node.simulation.elapsed_ns == 0
    started.answer(0.4)
    started.tick()
    started.tick()
    assert started.states[-1].v_x < 1.0
    assert started.node.missing() == ""


def test_a_car_stands_still_during_a_long_pause_and_continues_after_it(started: Started) -> None:
    started.answer(12.0)
    for _ in range(50):
        started.tick()
    before = started.states[-1]
    started.tick(600.0)
    started.answer(12.0)
    after = started.states[-1]
    assert after.stamp_ns - before.stamp_ns == pytest.approx(600e9, abs=1e8)
    assert math.dist(before[1:3], after[1:3]) < 0.2
    started.tick(LONGEST_CATCH_UP - 0.1)
    assert math.dist(started.states[-1][1:3], after[1:3]) == pytest.approx(4.8, abs=0.2)
