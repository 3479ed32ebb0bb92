"""The point that odometry describes: estimated in turns, and compared with the parameter."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.supervision.measuring_point import MOST_OMISSION, TURNING_TIME, rear_slip
from ampc_ros.supervision.odometry import OdometryMonitor
from sim_vehicle.measurement import Deviations, noisy
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

CARS = {name: load_vehicle_file(find("vehicles", name)).chassis for name in ("paper", "ordinary")}
EVERY_CAR = pytest.mark.parametrize("car", CARS)
SIDES = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])


def circling(
    v: float, r: float, slip: float, seconds: float = 20.0, hz: int = 50
) -> Iterator[VehicleState]:
    """Yield the states of a rear axle whose lateral velocity is -slip v^2 r."""
    v_y = -slip * v**2 * r
    speed, course = math.hypot(v, v_y), math.atan2(v_y, v)
    for i in range(round(seconds * hz)):
        yaw = r * i / hz
        direction = yaw + course
        x = speed / r * (math.sin(direction) - math.sin(course))
        y = speed / r * (math.cos(course) - math.cos(direction))
        stamp_ns = NANOSECONDS + i * NANOSECONDS // hz
        yield VehicleState(stamp_ns, x, y, wrap_angle(yaw), v, v_y, r)


def monitor(
    states: Iterator[VehicleState], ahead: float, seed: int | None = None
) -> OdometryMonitor:
    """Return a monitor of odometry at a distance ahead of the rear axle [m]."""
    noise = load(MeasurementNoise, find("noise", "x1"))
    deviations = Deviations(*(getattr(noise, name) for name in Deviations._fields))
    rng, checks = np.random.default_rng(seed), OdometryMonitor()
    for state in states:
        state = at_distance(state, ahead)
        if seed is not None:
            state = noisy(state, deviations, rng.standard_normal(6))
        checks.correct(state)
    return checks


@EVERY_CAR
@SIDES
@pytest.mark.parametrize("v", [5.0, 7.0, 9.0])
@pytest.mark.parametrize("seed", [None, 1])
def test_the_front_bumper_is_named_with_the_value_to_set(
    car: str, side: float, v: float, seed: int | None
) -> None:
    chassis = CARS[car]
    ahead = chassis.wheelbase + 0.9
    states = circling(v, side * 0.25, rear_slip(chassis), 10.0)
    checks = monitor(states, ahead, seed)
    point = checks.point.estimate(chassis)
    assert point is not None
    assert point.ahead_of_axle == pytest.approx(ahead, abs=0.6)
    (sentence,) = checks.problems(chassis, chassis.cg_to_rear_axle)
    assert sentence.startswith("odom: measuring_point: ")
    assert (
        f"set base_link_to_cg to {chassis.cg_to_rear_axle - point.ahead_of_axle:.1f} m" in sentence
    )
    assert not checks.problems(chassis, chassis.cg_to_rear_axle - ahead)


@EVERY_CAR
@SIDES
@pytest.mark.parametrize("v", [5.0, 9.0, 15.0, 20.0])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0, 1.5])
def test_a_correct_parameter_is_accepted_whatever_the_slip_of_the_tyres(
    car: str, side: float, v: float, share: float
) -> None:
    chassis, l_r = CARS[car], CARS[car].cg_to_rear_axle
    r = side * min(0.3, 2.9 / v)
    for ahead in (0.0, l_r):
        states = circling(v, r, share * rear_slip(chassis), 60.0, 20)
        assert not monitor(states, ahead, 3).problems(chassis, l_r - ahead)


@EVERY_CAR
@SIDES
def test_odometry_at_the_centre_of_gravity_is_named_where_turns_go_both_ways(
    car: str, side: float
) -> None:
    chassis, checks = CARS[car], OdometryMonitor()
    end_ns = 0
    for turn in (side, -side):
        for state in circling(8.0, turn * 0.25, rear_slip(chassis), 8.0):
            at_cg = at_distance(state, chassis.cg_to_rear_axle)
            checks.correct(at_cg._replace(stamp_ns=at_cg.stamp_ns + end_ns))
        end_ns += 9 * NANOSECONDS
    assert checks.problems(chassis, chassis.cg_to_rear_axle)
    assert not checks.problems(chassis, 0.0)


def test_nothing_is_estimated_before_5_s_of_turning_or_beyond_linear_tyres() -> None:
    chassis = CARS["paper"]
    slip = rear_slip(chassis)
    assert (
        monitor(circling(5.0, 0.25, slip, TURNING_TIME - 0.1), 4.0).point.estimate(chassis) is None
    )
    assert monitor(circling(5.0, 0.25, slip, TURNING_TIME + 1.1), 4.0).point.estimate(chassis)
    for v, r in ((5.0, 0.05), (1.5, 0.5), (9.0, 0.4)):
        assert monitor(circling(v, r, slip, 30.0), 4.0).point.estimate(chassis) is None


def test_a_reset_forgets_the_point() -> None:
    chassis = CARS["paper"]
    checks = monitor(circling(5.0, 0.25, 0.0), 4.0)
    assert checks.problems(chassis, 1.6)
    checks.reset()
    assert not checks.problems(chassis, 1.6)


def test_a_course_that_is_misaligned_by_a_degree_is_no_other_point() -> None:
    chassis, checks = CARS["ordinary"], OdometryMonitor()
    for state in circling(9.0, 0.25, rear_slip(chassis), 20.0):
        checks.correct(state._replace(yaw=wrap_angle(state.yaw + math.radians(1.0))))
    assert not checks.problems(chassis, chassis.cg_to_rear_axle)


@SIDES
def test_a_twist_without_lateral_velocity_is_named_where_the_position_has_one(side: float) -> None:
    chassis = CARS["paper"]
    for ahead, is_named in ((4.0, True), (1.0, False), (0.0, False), (-3.0, True)):
        checks = OdometryMonitor()
        for state in circling(6.0, side * 0.3, rear_slip(chassis), 20.0):
            checks.correct(at_distance(state, ahead)._replace(v_y=0.0))
        problems = checks.problems(chassis, 1.6 - ahead)
        assert len(problems) == is_named
        if is_named:
            where = "inside" if ahead > 0 else "outside"
            assert problems[0].startswith("odom: lateral_velocity_missing: ")
            assert f"to the {where} of turns" in problems[0]
            assert abs(checks.point.omitted_velocity) > MOST_OMISSION


def test_a_single_lateral_velocity_ends_the_omission() -> None:
    states = [at_distance(each, 4.0) for each in circling(6.0, 0.3, 0.0)]
    checks = OdometryMonitor()
    for i, state in enumerate(states):
        checks.correct(state._replace(v_y=1.2 * (i == len(states) - 2)))
    checks.correct(states[-1]._replace(stamp_ns=states[-1].stamp_ns + NANOSECONDS // 2))
    assert checks.point.omitted_velocity == 0.0
