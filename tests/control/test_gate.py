"""The gate without ROS: its states, what it publishes in each, and what it never publishes."""

import math

import numpy as np
import pytest

from ampc_ros.gate.core import LIMIT_SHARE, Gate
from ampc_ros.gate.following import MeasuredPose
from ampc_ros.gate.lock_step import LockStepGate
from ampc_ros.gate.plan import PlanPoint, make_plan
from ampc_ros.gate.settings import GateSettings, GateState
from ampc_ros.supervision.guard import Guard, bounds
from tests.gates import (
    CHASSIS,
    PERIOD,
    ROAD,
    at_speed,
    driving_gate,
    new_gate,
    output_at,
    plan_of,
    state_of,
)

LATE, TIMEOUT = 1.5 * PERIOD, 2.5 * PERIOD
NOT_FINITE = [math.nan, math.inf, -math.inf]
BIT = 1e-6


def stopping_gate(now: float = 1.0, **settings: float) -> Gate:
    """Return a gate that has begun to stop at a time, because the command is lost."""
    gate = driving_gate(plan=plan_of([0.01 * i for i in range(12)]), **settings)
    gate.take_plan(plan_of([0.01 * i for i in range(12)]), now)
    gate.take_speed(8.0, now)
    gate.step(now)
    assert state_of(gate) is GateState.STOPPING
    return gate


# Waiting


def test_nothing_is_published_before_command_and_target_speed_have_come() -> None:
    gate = new_gate()
    assert gate.step(0.0) is None
    assert gate.reason == "no sound steering_command yet"
    gate.take_command(0.01, 0.0, 0.0)
    assert gate.step(0.0) is None
    assert gate.reason == "no target_speed yet"
    gate.take_speed(8.0, 0.0)
    assert output_at(gate, 0.0)[:3] == (0.01, 0.0, 8.0)


def test_a_second_publisher_keeps_the_gate_waiting() -> None:
    gate = new_gate()
    gate.take_command(0.01, 0.0, 0.0)
    gate.take_speed(8.0, 0.0)
    gate.intruders = "steering_command has 2 publishers: /a, /b"
    assert gate.step(0.0) is None
    assert (gate.state, gate.reason) == (GateState.WAITING, gate.intruders)
    gate.intruders = ""
    assert output_at(gate, 0.0)


def test_inputs_that_are_old_already_keep_the_gate_waiting() -> None:
    gate = new_gate()
    gate.take_command(0.01, 0.0, 0.0)
    gate.take_speed(8.0, 0.0)
    assert gate.step(TIMEOUT + BIT) is None
    assert state_of(gate) is GateState.WAITING


@pytest.mark.parametrize(("age", "first"), [(0.5, 0.1), (0.5 + BIT, 0.2)])
def test_the_first_output_is_the_measured_angle_unless_it_is_old(age: float, first: float) -> None:
    gate = new_gate()
    gate.take_measured(0.1, 0.0)
    gate.take_command(0.2, 0.0, age)
    gate.take_speed(3.0, age)
    output = output_at(gate, age)
    assert output.angle == first
    assert output.is_command == (first == 0.2)


def test_the_output_moves_from_the_measured_angle_to_the_command_at_the_limit_of_the_rate() -> None:
    gate = new_gate()
    gate.take_measured(-0.3, 0.0)
    gate.take_command(0.3, 0.0, 0.0)
    gate.take_speed(3.0, 0.0)
    angles = []
    for i in range(40):
        if i % 6 == 0:
            gate.take_command(0.3, 0.0, i / 50)
        angles.append(output_at(gate, i / 50).angle)
    assert angles[0] == -0.3
    assert angles[-1] == 0.3
    steps = np.diff(angles)
    rate = 1.3  # of the guard at 3 m/s
    assert steps.max() == pytest.approx(rate / 50)
    assert (steps >= 0.0).all()


# Driving


def test_commands_pass_unchanged_and_target_speeds_with_them() -> None:
    gate = driving_gate()
    for i in range(1, 20):
        now = i * PERIOD
        angle = 0.01 + 0.002 * i
        gate.take_plan(plan_of([angle] * 8), now)
        gate.take_speed(8.0 + i / 8, now)
        assert gate.take_command(angle, 0.016, now) == ""
        assert output_at(gate, now) == (angle, 0.016, 8.0 + i / 8, True)
        assert output_at(gate, now + 0.02)[:3] == (angle, 0.016, 8.0 + i / 8)
        assert (gate.state, gate.reason) == (GateState.DRIVING, "")


def test_the_rate_of_a_planned_angle_reaches_it_within_a_period() -> None:
    gate = driving_gate(angle=0.0, plan=plan_of([0.0, 0.02, 0.04, 0.06]))
    output_at(gate, LATE)
    output = output_at(gate, 0.25)
    assert output.angle == pytest.approx(0.02)
    assert output.rate == pytest.approx(0.02 / PERIOD)


def test_a_step_of_a_whole_period_passes_at_once_although_the_timer_has_published_since() -> None:
    gate = driving_gate(angle=0.0, speed=3.0)
    step = 1.3 * PERIOD
    for now in (0.05, 0.10):
        output_at(gate, now)
    gate.take_command(step, 0.0, PERIOD)
    assert output_at(gate, PERIOD).angle == step


def test_no_output_moves_by_more_than_the_guard_allows_over_the_time_since_the_last_change() -> (
    None
):
    gate = driving_gate(angle=0.0, speed=3.0)
    gate.take_command(1.3 * PERIOD, 0.0, PERIOD)
    output_at(gate, PERIOD)
    gate.take_command(2 * 1.3 * PERIOD, 0.0, PERIOD + 0.05)
    assert output_at(gate, PERIOD + 0.05).angle == pytest.approx(1.3 * (PERIOD + 0.05))
    output = output_at(gate, PERIOD + 0.07)
    assert output.angle == pytest.approx(1.3 * (PERIOD + 0.07))
    assert not output.is_command


def test_the_measured_angle_bounds_the_output_as_it_bounds_the_controller() -> None:
    gate = driving_gate(angle=0.0, speed=3.0)
    for i in range(1, 30):
        gate.take_measured(-0.1, i / 50)
        gate.take_command(min(0.02 * i, 0.5), 0.0, i / 50)
        angle = output_at(gate, i / 50).angle
    assert angle == pytest.approx(0.3)  # 0.4 from the measured one


# Degraded


def test_a_late_command_is_replaced_by_the_plan_at_its_time() -> None:
    gate = driving_gate(angle=0.0, plan=plan_of([0.0, 0.02, 0.04, 0.06]))
    assert output_at(gate, LATE).angle == 0.0
    assert state_of(gate) is GateState.DRIVING
    now = LATE + 1 / 64
    assert output_at(gate, now).angle == pytest.approx(0.02 * now / 0.25)
    assert state_of(gate) is GateState.DEGRADED
    assert gate.reason == "steering_command is 0.20 s old"
    assert output_at(gate, now).speed == 8.0
    gate.take_command(0.0, 0.0, now)
    assert output_at(gate, now + 0.15).angle == pytest.approx(0.0)
    assert state_of(gate) is GateState.DRIVING


def test_without_a_plan_a_late_command_is_held() -> None:
    gate = new_gate()
    gate.take_command(0.03, 0.0, 0.0)
    gate.take_speed(8.0, 0.0)
    assert output_at(gate, 0.0).angle == 0.03
    assert gate.reason == "no steering_plan yet: a stop would hold the angle"
    assert state_of(gate) is GateState.DEGRADED
    assert output_at(gate, LATE + BIT)[:2] == (0.03, 0.0)


@pytest.mark.parametrize(("age", "state"), [(0.6, "driving"), (0.6 + BIT, "degraded")])
def test_an_old_plan_degrades_although_commands_pass(age: float, state: str) -> None:
    gate = driving_gate()
    gate.take_command(0.01, 0.0, age)
    assert output_at(gate, age).is_command
    assert gate.state.value == state
    assert ("no steering_plan for 0.60 s: a stop" in gate.reason) == (state == "degraded")


@pytest.mark.parametrize("event", ["deadline missed", "not alive"])
def test_an_event_of_the_middleware_degrades_until_the_next_command(event: str) -> None:
    gate = driving_gate(angle=0.0, plan=plan_of([0.0, 0.02, 0.04, 0.06]))
    gate.suspect(event)
    assert output_at(gate, 0.1).angle == pytest.approx(0.008)
    assert (gate.state, gate.reason) == (GateState.DEGRADED, event)
    gate.take_command(0.0, 0.0, PERIOD)
    assert output_at(gate, 0.3).angle == pytest.approx(0.0)
    assert state_of(gate) is GateState.DRIVING


# Unsafe commands


@pytest.mark.parametrize("number", NOT_FINITE)
def test_a_number_that_is_not_finite_never_passes(number: float) -> None:
    gate = driving_gate()
    for command in ((number, 0.0), (0.01, number)):
        assert "must be finite" in gate.take_command(*command, PERIOD)
        assert output_at(gate, PERIOD).angle == pytest.approx(0.01)
        assert state_of(gate) is GateState.DEGRADED
    assert gate.take_command(0.01, 0.0, 0.2) == ""
    output_at(gate, 0.2)
    assert state_of(gate) is GateState.DRIVING


def test_unsafe_commands_that_continue_stop_the_car() -> None:
    gate = driving_gate()
    for now in (PERIOD, 2 * PERIOD, TIMEOUT):
        gate.take_command(math.nan, 0.0, now)
        output_at(gate, now)
        assert state_of(gate) is GateState.DEGRADED
    output_at(gate, TIMEOUT + BIT)
    assert state_of(gate) is GateState.STOPPING
    assert "no sound steering_command for 0.31 s (steering_command: angle nan" in gate.reason


@pytest.mark.parametrize("speed", [3.0, 8.0, 20.0, 30.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_never_passes_but_a_step_at_the_limit_of_the_rate_does(
    speed: float, sign: int
) -> None:
    bound = bounds(ROAD, CHASSIS, speed)
    reach = min(bound.rate, bound.jerk) * 2 * PERIOD  # as the guard allows after a pause
    for share, is_sound in ((0.999, True), (1.001, False)):
        gate = driving_gate(angle=-sign * 0.5 * reach, speed=speed)
        gate.guard.reset(-sign * 0.5 * reach)
        problem = gate.take_command(sign * (share - 0.5) * reach, 0.0, 0.1)
        assert (problem == "") == is_sound
        assert ("step of" in problem) == (not is_sound)


@pytest.mark.parametrize("speed", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_angle_far_beyond_the_limits_is_unsafe_and_one_near_them_is_clipped(
    speed: float, sign: int
) -> None:
    bound = bounds(ROAD, CHASSIS, speed)
    most = min(bound.angle, bound.acceleration)
    assert LIMIT_SHARE == 1.25
    gate = new_gate()
    gate.take_speed(speed, 0.0)
    assert "must lie in" in gate.take_command(sign * 1.001 * LIMIT_SHARE * most, 0.0, 0.0)
    assert gate.command is None
    assert gate.take_command(sign * 0.999 * LIMIT_SHARE * most, 0.0, 0.0) == ""
    gate.take_measured(0.0, 0.0)
    for i in range(60):
        gate.take_command(sign * 0.999 * LIMIT_SHARE * most, 0.0, i / 50)
        gate.take_speed(speed, i / 50)
        angle = output_at(gate, i / 50).angle
    assert angle == pytest.approx(sign * most)


def test_a_step_of_exactly_the_reach_is_sound() -> None:
    gate = driving_gate(angle=0.0, speed=3.0)
    assert gate.take_command(1.3 * 2 * PERIOD, 0.0, PERIOD) == ""


def test_a_command_on_its_way_back_into_the_limits_is_sound() -> None:
    gate = driving_gate(angle=0.3, speed=3.0)
    gate.take_odometry(at_speed(20.0), 0.1)  # where the limit of the angle is below 0.1
    assert gate.take_command(0.3, 0.0, 0.1) == ""
    assert gate.take_command(0.29, 0.0, 0.1) == ""
    assert gate.take_command(0.3, 0.0, 0.1) != ""


def test_a_command_that_comes_twice_at_the_same_time_is_sound() -> None:
    gate = driving_gate()
    assert gate.take_command(0.01, 0.0, 0.0) == ""
    assert gate.take_command(0.01, 0.0, -1.0) == ""  # a clock that goes back gives no time


@pytest.mark.parametrize("speed", [-0.1, 100.1, math.nan, math.inf])
def test_an_impossible_target_speed_is_refused(speed: float) -> None:
    gate = driving_gate()
    assert "must lie in [0, 100] m/s" in gate.take_speed(speed, 0.1)
    assert output_at(gate, 0.1).speed == 8.0
    assert gate.take_speed(100.0, 0.1) == gate.take_speed(0.0, 0.1) == ""


# Stopping


def test_a_lost_command_stops_the_car() -> None:
    gate = driving_gate()
    output_at(gate, TIMEOUT)
    assert state_of(gate) is GateState.DEGRADED
    output_at(gate, TIMEOUT + BIT)
    assert (gate.state, gate.reason) == (
        GateState.STOPPING,
        "no sound steering_command for 0.31 s",
    )
    gate.take_command(0.02, 0.0, 0.4)
    assert output_at(gate, 0.4).angle == pytest.approx(0.01)  # of the plan
    assert state_of(gate) is GateState.STOPPING


def test_a_lost_target_speed_stops_the_car_which_still_follows_sound_commands() -> None:
    gate = driving_gate()
    for now in np.arange(1, 9) * PERIOD:
        gate.take_command(0.01, 0.0, now)
        output_at(gate, now)
        assert state_of(gate) is not GateState.STOPPING
    gate.take_command(0.02, 0.0, 1.0 + BIT)
    output = output_at(gate, 1.0 + BIT)
    assert (gate.state, gate.reason) == (GateState.STOPPING, "no target_speed for 1.00 s")
    assert output.angle == 0.02
    gate.take_command(0.03, 0.0, 1.1)
    output = output_at(gate, 1.1)
    assert output.angle == 0.03
    assert output.speed == pytest.approx(8.0 - 2.5 * 0.1)
    # The command ends, too: the newest plan is followed.
    gate.take_plan(plan_of([0.03, 0.05, 0.07, 0.09]), 1.1)
    expected = 0.05 * slower(output.speed - 2.5 * 0.25)
    assert output_at(gate, 1.35).angle == pytest.approx(expected, rel=0.01)
    # A second publisher: neither commands nor new plans are followed.
    gate.intruders = "two"
    held = output_at(gate, 1.4).angle
    gate.take_command(0.06, 0.0, 1.4)
    assert output_at(gate, 1.45).angle == held
    assert gate.reason == "no target_speed for 1.00 s"


def test_a_second_publisher_stops_the_car_at_once_along_the_plan_of_that_time() -> None:
    gate = driving_gate(angle=0.0, plan=plan_of([0.0, 0.02, 0.04, 0.06]))
    gate.intruders = "steering_command has 2 publishers: /a, /b"
    output_at(gate, 0.02)
    assert (gate.state, gate.reason) == (GateState.STOPPING, gate.intruders)
    gate.take_command(-0.05, 0.0, 0.1)
    gate.take_plan(plan_of([-0.05] * 4), 0.1)
    assert output_at(gate, 0.25).angle == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("measured", "age", "first"),
    [(6.0, 0.5, 6.0), (6.0, 0.5 + BIT, 8.0), (9.0, 0.0, 8.0), (-1.0, 0.0, 0.0)],
)
def test_the_speed_of_a_stop_falls_from_the_lower_one_of_measured_and_commanded(
    measured: float, age: float, first: float
) -> None:
    gate = driving_gate(deceleration=2.0)
    for now in (0.1, 0.2, 0.3):
        gate.take_command(0.01, 0.0, now)
        output_at(gate, now)
    at = 0.3 + TIMEOUT + BIT
    gate.take_odometry(at_speed(measured), at - age)
    assert output_at(gate, at).speed == first
    assert output_at(gate, at + 0.5).speed == pytest.approx(max(first - 1.0, 0.0))
    gate.take_speed(50.0, at + 0.6)
    gate.take_odometry(at_speed(50.0), at + 0.6)
    assert output_at(gate, at + 1.0).speed == pytest.approx(max(first - 2.0, 0.0))
    assert output_at(gate, at + 20.0).speed == 0.0


def test_a_stop_before_the_first_output_commands_standstill() -> None:
    gate = driving_gate()
    gate.output = None
    gate.intruders = "two"
    assert output_at(gate, 0.1).speed == 0.0


def slower(speed: float) -> float:
    """Return the ratio of the angles of the same curvature at a speed and at 8 m/s."""
    L, K_us = CHASSIS.wheelbase, CHASSIS.understeer_gradient
    return (L + K_us * speed**2) / (L + K_us * 64.0)


def test_a_stop_follows_the_plan_by_the_distance_travelled_for_the_actual_speed() -> None:
    gate = stopping_gate()  # plan from time 1: 0.01 rad each 2 m, at 8 m/s
    gate.take_odometry(at_speed(6.0), 1.0)
    assert output_at(gate, 1.25).angle == pytest.approx(slower(6.0) * 0.01 * 1.5 / 2.0)
    # At the measured speed of 6 m/s, 4.5 m are behind the car after 0.75 s.
    gate.take_odometry(at_speed(6.0), 1.5)
    assert output_at(gate, 1.75).angle == pytest.approx(slower(6.0) * 0.01 * 4.5 / 2.0)
    # Odometry ends: the commanded speed takes its place after 0.5 s.
    output_at(gate, 2.0)
    before = output_at(gate, 2.0 + BIT)
    after = output_at(gate, 2.1)
    distance = 6.0 + before.speed * 0.1
    assert gate.odometer == pytest.approx(8.0 + distance, abs=1e-4)
    assert after.angle == pytest.approx(slower(before.speed) * 0.01 * distance / 2.0, abs=1e-4)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_stop_returns_to_the_places_of_its_plan_while_the_pose_is_measured(side: float) -> None:
    straight = [PlanPoint(0.25 * i, 0.0, 2.0 * i, 8.0, 0.0, 2.0 * i, 0.0) for i in range(20)]
    gate = driving_gate(angle=0.0, plan=make_plan(straight))
    gate.intruders = "two"
    gate.take_odometry(MeasuredPose(3.0, 0.5 * side, 0.0, 8.0, 0.0), 0.1)
    assert output_at(gate, 0.1).angle * side < 0.0
    assert gate.plan
    assert gate.odometer - gate.plan.odometer == pytest.approx(3.0)
    near = output_at(gate, 0.29).angle  # the pose is not yet 0.2 s old
    gate.take_odometry(at_speed(8.0), 0.3 + BIT)
    ended = output_at(gate, 2.0).angle
    assert near * side < 0.0
    assert ended == pytest.approx(0.0)


def test_a_pose_far_from_the_plan_is_not_used() -> None:
    straight = [PlanPoint(0.25 * i, 0.0, 2.0 * i, 8.0, 0.0, 2.0 * i, 0.0) for i in range(20)]
    gate = driving_gate(angle=0.0, plan=make_plan(straight))
    gate.intruders = "two"
    gate.take_odometry(MeasuredPose(1.0, 30.0, 0.0, 8.0, 0.0), 0.125)
    assert output_at(gate, 0.125).angle == 0.0
    assert gate.odometer == pytest.approx(1.0)


def test_a_controller_that_stays_where_it_has_jumped_stops_the_car() -> None:
    gate = driving_gate(angle=0.0, plan=plan_of([0.0] * 8))
    gate.take_odometry(at_speed(3.0), 0.0)  # 0.36 rad lie within the limits of this speed
    for tick in range(1, 4):
        now = tick * PERIOD
        gate.take_odometry(at_speed(3.0), now)
        assert "step of" in gate.take_command(0.36, 0.0, now)
        assert abs(output_at(gate, now).angle) < 0.01
    assert state_of(gate) is GateState.STOPPING


def test_the_distance_of_a_plan_counts_from_its_arrival_between_two_outputs() -> None:
    gate = driving_gate(plan=plan_of([0.0] * 8))
    gate.take_odometry(at_speed(6.0), 0.0)
    gate.take_plan(plan_of([0.0] * 8), 0.25)
    assert gate.plan
    assert gate.plan.odometer == 1.5
    gate.take_odometry(at_speed(2.0), 0.5)
    assert gate.odometer == 3.0


@pytest.mark.parametrize(("age", "angle"), [(0.6, 0.04), (0.6 + BIT, 0.01)])
def test_a_plan_that_is_old_when_the_stop_begins_is_not_followed(age: float, angle: float) -> None:
    gate = driving_gate(plan=plan_of([0.04] * 8))
    for now in np.arange(1, 9) * 0.1:
        gate.take_command(0.01, 0.0, now)
        gate.take_speed(8.0, now)
        output_at(gate, now)
    at = 0.8 + TIMEOUT + BIT
    gate.take_plan(plan_of([0.04] * 8), at - age)
    gate.intruders = "two"
    output_at(gate, at)
    gate.take_plan(plan_of([0.05] * 8), at + 0.1)
    output_at(gate, at + 0.2)
    assert output_at(gate, at + 0.4).angle == pytest.approx(angle, rel=0.02)


def test_the_car_has_stopped_when_it_stands_not_when_it_should() -> None:
    gate = stopping_gate()
    at = 1.0 + 8.0 / 2.5
    gate.take_odometry(at_speed(0.2), at)
    assert output_at(gate, at).speed == 0.0
    assert state_of(gate) is GateState.STOPPING
    gate.take_odometry(at_speed(-0.2), at)
    output_at(gate, at)
    assert state_of(gate) is GateState.STOPPING
    gate.take_odometry(at_speed(0.19), at - BIT)
    assert output_at(gate, at - BIT).speed > 0.0
    assert state_of(gate) is GateState.STOPPING
    angle = output_at(gate, at).angle
    assert state_of(gate) is GateState.STOPPED
    gate.take_odometry(at_speed(3.0), at + 0.5)  # pushed
    assert output_at(gate, at + 1.0)[:3] == (angle, 0.0, 0.0)
    assert output_at(gate, at + 100.0)[:3] == (angle, 0.0, 0.0)
    assert gate.reason == "no sound steering_command for 1.00 s"


def test_without_odometry_the_car_has_stopped_when_it_should_have() -> None:
    gate = stopping_gate()
    output_at(gate, 1.0 + 8.0 / 2.5)
    assert state_of(gate) is GateState.STOPPED


# Reset


def fresh(gate: Gate, now: float, angle: float = 0.0) -> Gate:
    """Send a gate all inputs anew."""
    gate.take_command(angle, 0.0, now)
    gate.take_speed(8.0, now)
    gate.take_plan(plan_of([angle] * 8), now)
    return gate


@pytest.mark.parametrize("at", [1.5, 60.0])
def test_a_reset_continues_from_the_present_angle(at: float) -> None:
    gate = stopping_gate()
    for now in np.linspace(1.0, at, 200):
        before = output_at(gate, now)
    fresh(gate, at)
    assert gate.reset(at) == ""
    assert (gate.state, gate.reason) == (GateState.DRIVING, "")
    output = output_at(gate, at + 0.02)
    assert state_of(gate) is GateState.DRIVING
    assert output.speed == 8.0
    bound = bounds(ROAD, CHASSIS, before.speed)
    assert 0.0 < before.angle - output.angle <= min(bound.rate, bound.jerk) * 2 * PERIOD
    gate.take_command(0.0, 0.0, at + 0.1)
    assert output_at(gate, at + 0.25).is_command


@pytest.mark.parametrize("state", ["waiting", "driving"])
def test_only_a_stop_can_be_reset(state: str) -> None:
    gate = new_gate() if state == "waiting" else driving_gate()
    assert gate.reset(0.0) == f"the gate is {state}: there is no stop to reset"
    assert gate.state.value == state


def test_a_reset_needs_inputs_that_are_fresh_sound_and_single() -> None:
    gate = stopping_gate()
    assert gate.reset(3.0) == "no sound steering_command for 3.00 s"
    fresh(gate, 3.0)
    assert gate.reset(3.0 + LATE + BIT) == "steering_command is 0.19 s old"
    gate.take_command(-0.2, 0.0, 3.05)
    gate.take_command(0.2, 0.0, 3.05)
    assert "step of 0.400 rad" in gate.reset(3.05)
    gate.take_command(0.0, 0.0, 3.6)
    assert gate.plan
    gate.plan = gate.plan._replace(at=0.0)
    gate.command = gate.command and gate.command._replace(at=0.6)
    gate.target = gate.target and gate.target._replace(at=0.6)
    assert gate.reset(0.6) == ""
    gate.state = GateState.STOPPING
    fresh(gate, 3.0)
    gate.take_command(0.0, 0.0, 3.6)
    assert gate.reset(3.6 + BIT) == "steering_plan is 0.6 s old"
    gate.take_command(0.0, 0.0, 4.1)
    assert gate.reset(4.1) == "no target_speed for 1.10 s"
    fresh(gate, 5.0)
    gate.intruders = "two"
    assert gate.reset(5.0) == "two"
    assert state_of(gate) is GateState.STOPPING
    gate.intruders = ""
    gate.take_command(0.0, 0.0, 5.6)
    assert gate.reset(5.6) == ""


def test_a_controller_that_publishes_no_plan_can_be_reset() -> None:
    gate = new_gate()
    gate.take_command(0.0, 0.0, 0.0)
    gate.take_speed(8.0, 0.0)
    output_at(gate, 0.0)
    output_at(gate, 1.0)
    gate.take_command(0.0, 0.0, 1.0)
    gate.take_speed(8.0, 1.0)
    assert gate.reset(1.0) == ""


# Measurements


@pytest.mark.parametrize("number", [*NOT_FINITE, 100.1, -100.1])
def test_impossible_measurements_are_ignored(number: float) -> None:
    gate = driving_gate()
    gate.take_odometry(at_speed(5.0), 0.0)
    gate.take_odometry(at_speed(number), 0.1)
    assert gate.speed_at(0.2) == 5.0
    gate.take_measured(0.2, 0.0)
    gate.take_measured(number, 0.1)
    assert gate.measured == (0.2, 0.0)


def test_the_greatest_measurements_are_used() -> None:
    gate = driving_gate()
    gate.take_odometry(at_speed(-100.0), 0.0)
    assert gate.speed_at(0.5) == -100.0
    gate.take_measured(-math.pi / 2, 0.0)
    assert gate.measured == (-math.pi / 2, 0.0)


def test_the_speed_is_the_measured_one_else_the_commanded_one_else_the_target() -> None:
    gate = new_gate()
    assert gate.speed_at(0.0) == 0.0
    gate.take_speed(7.0, 0.0)
    assert gate.speed_at(0.0) == 7.0
    fresh(gate, 0.0)
    output_at(gate, 0.0)
    gate.take_speed(9.0, 0.0)
    assert gate.speed_at(0.0) == 8.0
    gate.take_odometry(at_speed(7.5), 0.1)
    assert gate.speed_at(0.6) == 7.5
    assert gate.speed_at(0.6 + BIT) == 8.0


def test_the_distance_grows_forward_only_and_from_the_first_output_on() -> None:
    gate = new_gate()
    gate.take_odometry(at_speed(4.0), 0.0)
    fresh(gate, 0.0)
    fresh(gate, 1.0)
    gate.take_odometry(at_speed(4.0), 1.0)
    output_at(gate, 1.0)
    assert gate.odometer == 0.0
    output_at(gate, 1.25)
    assert gate.odometer == 1.0
    output_at(gate, 1.0)
    assert gate.odometer == 1.0
    gate.take_odometry(at_speed(-4.0), 1.0)
    output_at(gate, 1.25)
    assert gate.odometer == 1.0
    gate.take_odometry(at_speed(4.0), 1.25)
    output_at(gate, 1.5)
    assert gate.odometer == 2.0


@pytest.mark.parametrize(
    ("period", "late", "timeout"),
    [(0.1, 0.15, 0.25), (0.02, 0.06, 0.12), (0.044, 0.066, 0.12), (0.2, 0.3, 0.5)],
)
def test_times_follow_from_the_period_with_a_lower_bound(
    period: float, late: float, timeout: float
) -> None:
    settings = GateSettings(period=period)
    assert GateSettings().period == 0.1
    assert settings.late == pytest.approx(late)
    assert settings.command_timeout == pytest.approx(timeout)
    assert settings._replace(timeout=0.7).command_timeout == 0.7


# Lock-step


@pytest.mark.parametrize("seed", range(3))
def test_in_lock_step_the_commands_of_an_equal_guard_pass_bit_for_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    guard, gate = Guard(ROAD, CHASSIS, 0.1), LockStepGate(ROAD, CHASSIS, 0.1)
    clipped = 0
    for i in range(300):
        speed = float(rng.uniform(0.0, 40.0))
        wanted = guard.step(float(rng.normal(0.0, 0.3)), float(rng.normal()), speed)
        clipped += wanted.limit > 0
        output = gate.step(10**9 + i * 10**8, wanted.steering, wanted.steering_rate, speed)
        assert output.is_command
        assert output[:3] == (wanted.steering, wanted.steering_rate, speed)
    assert clipped > 100


def test_in_lock_step_a_jump_is_clipped_over_the_time_between_the_stamps() -> None:
    gate = LockStepGate(ROAD, CHASSIS, 0.1)
    assert gate.step(10**9, 0.1, 0.0, 3.0) == (0.1, 0.0, 3.0, True)
    assert gate.step(10**9, 0.5, 0.0, 3.0)[0] == 0.1  # no time, no step
    assert gate.step(10**9, 0.1, 0.0, 3.0).is_command
    output = gate.step(10**9 + 5 * 10**7, 0.5, 0.0, 3.0)
    assert output.angle == pytest.approx(0.1 + 1.3 * 0.05)
    assert not output.is_command
    assert gate.step(10**8, -0.3, 0.0, 3.0).angle == -0.3  # time has gone back


def test_the_curvature_of_an_output_is_that_of_the_kinematic_model() -> None:
    output = LockStepGate(ROAD, CHASSIS, 0.1).step(1, 0.2, 0.0, 3.0)
    assert output.curvature(2.0) == pytest.approx(math.tan(0.2) / 2.0)
