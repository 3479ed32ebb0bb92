"""States that must not be believed, and how the car goes on without any."""

import math
from dataclasses import replace

import pytest

from ampc_msgs_config.types import (
    FEED_FORWARD,
    NANOSECONDS,
    OPTIMAL,
    REASONS,
    STOP,
    TickRecord,
    VehicleState,
)
from ampc_ros.configuration import Choices, configuration
from ampc_ros.supervision.checks import PACE, StateFilter
from ampc_ros.supervision.fallback import STOP_RATE
from ampc_ros.supervision.supervisor import Supervisor

MS = 1_000_000
START_NS = 1000 * NANOSECONDS
WAVES = [(float(x), 2.0 * math.sin(0.05 * x)) for x in range(300)]
V = 9.0


def state(time: float) -> VehicleState:
    """Return the state of a car on a straight line along x."""
    stamp_ns = START_NS + round(time * NANOSECONDS)
    return VehicleState(stamp_ns, V * time, 0.0, 0.0, V, 0.0, 0.0)


def running(until: float = 3.0) -> StateFilter:
    """Return a filter that has taken a state each 20 ms."""
    filtered = StateFilter()
    for i in range(round(until / 0.02) + 1):
        one = state(0.02 * i)
        assert filtered.accept(one, one.stamp_ns).accepted
    return filtered


def test_a_queue_of_old_states_that_comes_at_once_does_not_set_the_clock_back() -> None:
    filtered = running()
    now_ns = state(3.0).stamp_ns
    for i in range(1000):
        assert not filtered.accept(state(0.02 * (i % 150)), now_ns).accepted
    assert filtered.accept(state(3.02), now_ns + 20 * MS) == (True, False, "", "")


@pytest.mark.parametrize(("pace", "believed"), [(0.99 * PACE, False), (PACE, True), (1.0, True)])
def test_a_clock_that_jumped_back_is_believed_where_its_states_take_their_time(
    pace: float, believed: bool
) -> None:
    filtered = running()
    now_ns = state(3.0).stamp_ns
    verdicts = [filtered.accept(state(0.1 * i), now_ns + round(pace * i * 100 * MS))
                for i in range(3)]  # fmt: skip
    assert [verdict.reset for verdict in verdicts] == [False, False, believed]


def frozen(filtered: StateFilter, time: float, duration: float) -> float:
    """Let the pose stand while the stamps and the twist go on; gives the time of the last one."""
    held = state(time)
    for i in range(1, round(duration / 0.02) + 1):
        one = state(time + 0.02 * i)._replace(x=held.x)
        filtered.accept(one, one.stamp_ns)
    return time + duration


@pytest.mark.parametrize("duration", [0.02, 0.1, 0.3, 0.44])
def test_a_pose_that_stood_for_moments_goes_on_at_once(duration: float) -> None:
    filtered = running()
    end = frozen(filtered, 3.0, duration)
    assert any(filtered.rejected.values()) == (duration > 0.06)
    one = state(end + 0.02)
    assert filtered.accept(one, one.stamp_ns) == (True, False, "", "")


def test_a_pose_that_stands_longer_than_the_window_is_refused_all_the_time() -> None:
    filtered = running()
    frozen(filtered, 3.0, 2.2)
    assert filtered.track is not None
    assert filtered.track.last.stamp_ns < state(3.1).stamp_ns
    assert sum(filtered.rejected.values()) > 105


@pytest.mark.parametrize("jump", [0.51, 2.0])
def test_a_jump_is_still_refused_where_the_states_before_it_were_right(jump: float) -> None:
    filtered = running()
    one = state(3.02)
    one = one._replace(x=one.x + jump)
    assert filtered.accept(one, one.stamp_ns).cause == "position_jump"


def test_a_heading_that_jumps_is_refused_where_the_position_returns() -> None:
    filtered = running()
    end = frozen(filtered, 3.0, 0.3)
    one = state(end + 0.02)._replace(yaw=0.3)
    assert filtered.accept(one, one.stamp_ns).cause == "heading_jump"


def supervised() -> Supervisor:
    """Return a controller without prediction, with a fast wheel, on a winding road."""
    config = configuration(Choices(guard="track"))
    settings = replace(config.settings, state_prediction=0.0, adaptation=False)
    supervisor = Supervisor(config._replace(settings=settings))
    supervisor.take_path(WAVES, START_NS, START_NS)
    return supervisor


def on_waves(time: float) -> VehicleState:
    """Return the state of a car that follows the road."""
    x = 8.9 * time
    yaw = math.atan(0.1 * math.cos(0.05 * x))
    rate = -0.005 * math.sin(0.05 * x) * 8.9
    stamp_ns = START_NS + round(time * NANOSECONDS)
    return VehicleState(stamp_ns, x, 2.0 * math.sin(0.05 * x), yaw, V, 0.0, rate)


def tick(supervisor: Supervisor, time: float, *, seeing: bool = True) -> TickRecord:
    """Let a tick pass."""
    now_ns = START_NS + round(time * NANOSECONDS)
    if seeing:
        supervisor.take_state(on_waves(time), now_ns)
    supervisor.take_path(WAVES, now_ns, now_ns)
    decision = supervisor.tick(now_ns)
    assert decision is not None
    return decision


def test_blind_the_wheel_follows_what_is_left_of_the_last_plan_and_no_faster_than_it_may() -> None:
    supervisor = supervised()
    plan = [tick(supervisor, 0.1 * i) for i in range(20)][-1].command.plan.angles
    assert plan is not None
    last = supervisor.steering
    for i in range(3, 25):  # as the node: at 2.0 and 2.1 s it waits for a state
        decision = tick(supervisor, 1.9 + 0.1 * i, seeing=False)
        steering, told = decision.command.steering, decision.command
        assert abs(steering - last) <= (0.1 * STOP_RATE + 1e-12 if told.rung == STOP else 0.3)
        if abs(steering - last) < 0.1 * STOP_RATE - 1e-12:
            assert steering == pytest.approx(plan[min(i, len(plan) - 1)])
        last = steering
    assert (told.rung, REASONS[int(told.reason)]) == (STOP, "state_lost")
    assert last == pytest.approx(plan[-1])


def test_a_tick_that_nobody_answered_ages_the_plan_too() -> None:
    supervisor = supervised()
    plan = [tick(supervisor, 0.1 * i) for i in range(20)][-1].command.plan.angles
    assert plan is not None
    late = tick(supervisor, 2.2, seeing=False)
    assert late.command.planned_steering == plan[3]


def test_after_the_feed_forward_or_a_refusal_no_older_plan_comes_back() -> None:
    supervisor = supervised()
    for i in range(10):
        tick(supervisor, 0.1 * i)
    supervisor.inject_qp_fault(True)
    for i in range(10, 20):
        newest = tick(supervisor, 0.1 * i)
    assert newest.command.rung == FEED_FORWARD
    for i in range(20, 40):
        blind = tick(supervisor, 0.1 * i, seeing=False)
    assert blind.command.steering == pytest.approx(newest.command.planned_steering)
    supervisor.inject_qp_fault(False)
    assert tick(supervisor, 4.0).command.rung == OPTIMAL
