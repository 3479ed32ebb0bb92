"""The guard's rate limit holds over true elapsed time, whatever the rhythm of the ticks."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.types import NANOSECONDS, Array, TickRecord, VehicleState
from ampc_ros.configuration import Configuration
from ampc_ros.supervision.guard import LONGEST_PAUSE, bounds
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.tick_policy import TickPolicy
from tests.supervised import made_for

SPEED = 9.0
STRAIGHT = np.array([(float(x), 0.0) for x in range(-20, 500, 5)])


def zigzag(now_ns: int, side: float) -> VehicleState:
    """Return a state beside the straight road, which asks for a large angle to the other side."""
    x = SPEED * now_ns / NANOSECONDS
    return VehicleState(now_ns, x, 3.0 * side, 0.4 * side, SPEED, 0.0, 0.0)


def config() -> Configuration:
    """Return a configuration that does not judge states, so that each tick may turn hard."""
    return made_for(controller="pure_pursuit", guard="road")


def driven(intervals: list[float], lock_step: bool = False) -> tuple[Array, list[TickRecord]]:
    """Tick after each interval [s] with the wheel asked to the other side; return all angles."""
    supervisor = Supervisor(config())
    policy = TickPolicy(supervisor, lock_step=lock_step)
    supervisor.take_path(STRAIGHT, 0, 0)
    now_ns, angles, records = NANOSECONDS, [], []
    for i, interval in enumerate([0.1, *intervals]):
        now_ns += round(interval * NANOSECONDS)
        # past the filter, which would reject a car that jumps from side to side
        supervisor.replay_state(
            supervisor_state(now_ns, 1.0 if i % 6 < 3 else -1.0), resets=supervisor.resets
        )
        record = policy.tick(now_ns)
        assert record
        angles.append(record.command.steering)
        records.append(record)
    return np.array(angles), records


def supervisor_state(now_ns: int, side: float) -> Received[VehicleState]:
    """Return a received state."""
    return Received(zigzag(now_ns, side), now_ns, now_ns)


def rate() -> float:
    """Return the largest rate at this speed [rad/s]."""
    bound = bounds(config().guard, config().chassis, SPEED)
    return min(bound.rate, bound.jerk)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.0, 0.5), min_size=1, max_size=20))
def test_a_step_is_bounded_by_the_time_since_the_last_command(intervals: list[float]) -> None:
    angles, records = driven(intervals)
    for step, interval in zip(np.abs(np.diff(angles)), intervals, strict=True):
        most = min(interval, LONGEST_PAUSE * records[0].command_interval) * rate()
        assert step <= most + 1e-9
    assert [record.command_interval for record in records[1:]] == pytest.approx(
        [round(interval * NANOSECONDS) / NANOSECONDS for interval in intervals], abs=1e-9
    )


def test_two_commands_within_a_millisecond_differ_by_no_more_than_that_time_allows() -> None:
    angles, _ = driven([0.1, 0.1, 0.0012, 0.0988, 0.1])
    steps = np.abs(np.diff(angles))
    assert steps[2] <= 0.0012 * rate() + 1e-12
    assert steps.max() > 0.09 * rate()  # the road asks for more than the guard allows


@pytest.mark.parametrize("pause", [0.3, 2.0, 3600.0])
def test_a_pause_of_any_length_allows_two_periods(pause: float) -> None:
    angles, _ = driven([0.1, pause])
    assert abs(angles[2] - angles[1]) <= LONGEST_PAUSE * 0.1 * rate() + 1e-12


def test_a_clock_that_goes_back_gives_the_wheel_one_period() -> None:
    angles, records = driven([0.1, 0.1, -0.5, 0.1])
    assert abs(angles[3] - angles[2]) <= 0.1 * rate() + 1e-12
    assert abs(angles[4] - angles[3]) <= 0.1 * rate() + 1e-12
    assert records[3].command_interval == 0.1


def test_in_lock_step_every_command_has_exactly_one_period() -> None:
    _, records = driven([0.1, 0.1, 0.2, 0.05], lock_step=True)
    assert {record.command_interval for record in records} == {0.1}


def test_a_start_from_an_angle_is_recorded_once_and_limits_the_first_step() -> None:
    supervisor = Supervisor(config())
    supervisor.take_path(STRAIGHT, 0, 0)
    supervisor.start_from(0.25)
    first, second = None, None
    for i in (1, 2):
        supervisor.replay_state(supervisor_state(i * NANOSECONDS // 10, 1.0), 0)
        first, second = second, supervisor.tick(i * NANOSECONDS // 10)
    assert first
    assert second
    assert first.started_from == 0.25
    assert math.isnan(second.started_from)
    assert abs(first.command.steering - 0.25) <= 0.1 * rate() + 1e-12
    assert first.resets == 0.0
