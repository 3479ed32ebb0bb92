"""The plan that the gate follows where the controller falls silent: places, angles, message."""

import math
from itertools import pairwise

import numpy as np
import pytest

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.assumed_car import AssumedCar, assumed_car
from ampc_ros.configuration import Choices, configuration
from ampc_ros.ros import plan_message
from ampc_ros.supervision.stopping_plan import PlanStart, StoppingPlan, stopping_plan
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.parameters import load_vehicle_file

CONFIG = configuration(Choices("preview", "ordinary", static_path=True))
CAR = assumed_car(CONFIG)
PROMPT = CAR._replace(response=CAR.response._replace(delay=0.0, lag=0.0))
"""The same car whose steering acts at once."""
TO_CG = CONFIG.base_link_to_cg


def line(length: float = 400.0, heading: float = 0.0) -> Path:
    s = np.arange(0.0, length, 1.0)
    return make_path(np.column_stack((s * math.cos(heading), s * math.sin(heading))))


def circle(radius: float, side: float = 1.0) -> Path:
    a = np.linspace(0.0, math.tau, round(4 * radius) + 1)
    points = radius * np.column_stack((np.sin(a), side * (1.0 - np.cos(a))))
    points[-1] = points[0]
    return make_path(points)


def plan_on(
    path: Path,
    v: float,
    angles: tuple[float, ...] = (0.0,) * 15,
    s: float = 20.0,
    car: AssumedCar = CAR,
) -> StoppingPlan:
    return stopping_plan(PlanStart(path, s, v, TO_CG), angles, 0.1, car, 2.0)


@pytest.mark.parametrize("v", [0.0, 0.2, 1.0, 9.0, 20.0, 45.0])
@pytest.mark.parametrize("count", [1, 2, 20])
def test_time_distance_and_speed_of_a_plan_agree(v: float, count: int) -> None:
    plan = plan_on(line(), v, (0.01,) * count)
    assert all(len(each) == len(plan.time) for each in plan)
    assert plan.time[0] == plan.distance[0] == 0.0
    assert (np.diff(plan.time) > 0.0).all()
    assert (np.diff(plan.distance) >= 0.0).all()
    assert (np.diff(plan.speed) <= 0.0).all()
    driven = np.diff(plan.time) * (plan.speed[1:] + plan.speed[:-1]) / 2
    fast = plan.speed[1:] > 0.5
    assert driven[fast] == pytest.approx(np.diff(plan.distance)[fast], rel=1e-9)
    assert (plan.acceleration[:count] == 0.0).all()
    assert (plan.acceleration[count:] < 0.0).all()
    if v > 0.5:
        assert plan.speed[-1] == pytest.approx(0.5)
        assert plan.distance[-1] - plan.distance[count - 1] >= (v * v - 0.25) / 4.0 - 1e-6


@pytest.mark.parametrize(("v", "radius"), [(3.0, 12.0), (9.0, 20.0), (15.0, 60.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_on_a_circle_the_continuation_is_the_steady_angle_of_each_speed(
    v: float, radius: float, side: float
) -> None:
    plan = plan_on(circle(radius, side), v, car=PROMPT)
    beyond = plan.acceleration < 0.0
    steady = (
        side
        / radius
        * (CONFIG.chassis.wheelbase + CONFIG.chassis.understeer_gradient * plan.speed**2)
    )
    assert plan.angle[beyond] == pytest.approx(steady[beyond], rel=0.01)  # ripple of the path
    assert np.hypot(plan.x, plan.y - side * radius) == pytest.approx(
        np.full(len(plan.x), radius), abs=0.01
    )


def test_angles_come_before_their_place_by_the_response_of_the_steering() -> None:
    s = np.arange(0.0, 400.0, 1.0)
    path = make_path(np.column_stack((s, 8.0 * np.sin(s / 15.0))))
    slow = PROMPT._replace(response=PROMPT.response._replace(delay=0.2, lag=0.1))
    early, prompt = plan_on(path, 12.0, car=slow), plan_on(path, 12.0, car=PROMPT)
    beyond = prompt.acceleration < 0.0
    place = prompt.distance + 0.3 * prompt.speed
    fast = beyond & (prompt.speed > 8.0)
    expected = np.interp(place, prompt.distance, prompt.angle)  # that of a slightly slower car
    moved = np.abs(early.angle[fast] - prompt.angle[fast]).max()
    assert np.abs(early.angle[fast] - expected[fast]).max() < 0.15 * moved


def test_a_mirrored_road_gives_mirrored_angles_and_places() -> None:
    s = np.arange(0.0, 300.0, 1.0)
    left, right = (
        plan_on(make_path(np.column_stack((s, side * np.sin(s / 12.0)))), 10.0) for side in (1, -1)
    )
    assert left.angle == pytest.approx(-right.angle, abs=1e-9)
    assert left.y == pytest.approx(-right.y, abs=1e-9)


@pytest.mark.parametrize("heading", [0.0, 2.5, -1.0])
@pytest.mark.parametrize("s", [-30.0, 0.5, 390.0])
def test_an_open_road_continues_straight_beyond_both_ends(heading: float, s: float) -> None:
    plan = plan_on(line(400.0, heading), 12.0, s=s)
    along = s + plan.distance - TO_CG
    assert plan.x == pytest.approx(along * math.cos(heading), abs=1e-6)
    assert plan.y == pytest.approx(along * math.sin(heading), abs=1e-6)
    assert np.abs(plan.angle).max() < 1e-9


def test_a_plan_continues_over_the_end_of_a_lap() -> None:
    path = circle(20.0)
    plan = plan_on(path, 9.0, s=path.length - 5.0)
    again = plan_on(path, 9.0, s=2 * path.length - 5.0)
    assert plan.angle == pytest.approx(again.angle, abs=1e-9)
    assert plan.x == pytest.approx(again.x, abs=1e-9)
    steps = np.hypot(np.diff(plan.x), np.diff(plan.y))
    assert steps == pytest.approx(np.diff(plan.distance), rel=0.02)


def test_the_estimated_offset_is_taken_off_every_angle() -> None:
    plain, corrected = (
        plan_on(circle(30.0), 9.0, (0.1,) * 9, car=CAR._replace(offset=x)) for x in (0.0, 0.02)
    )
    assert corrected.angle == pytest.approx(plain.angle - 0.02)


def test_fast_controllers_publish_points_a_tenth_of_a_second_apart() -> None:
    angles = np.linspace(0.0, 0.1, 100).tolist()
    start = PlanStart(line(), 10.0, 9.0, TO_CG)
    plan = stopping_plan(start, angles, 0.01, CAR, 2.0)
    assert plan.time[:10] == pytest.approx(0.1 * np.arange(10))
    assert plan.angle[:10] == pytest.approx(np.array(angles)[::10])


def test_the_message_has_the_units_of_the_car_and_increasing_times() -> None:
    steering = SteeringParameters(max_angle=0.5, ratio=15.0, offset=0.01)
    plan = plan_on(circle(30.0), 9.0, (0.08, 0.09, 0.1))
    command = ros.joint_message(5 * NANOSECONDS, 0.08, 0.0, steering)
    message = plan_message(plan, command, steering)
    assert message.header.stamp.sec == 5
    assert list(message.joint_names) == ["front_steering", "distance", "x", "y"]
    assert len(message.points) == len(plan.time)
    times = [ros.nanoseconds(point.time_from_start) for point in message.points]
    assert times[0] == 0
    assert all(a < b for a, b in pairwise(times))
    first, second = message.points[:2]
    assert first.positions[0] == pytest.approx(15.0 * (0.08 - 0.01))
    assert first.velocities[0] == pytest.approx(15.0 * 0.1)
    assert second.positions[1:] == pytest.approx([0.9, plan.x[1], plan.y[1]])
    assert second.velocities[1] == pytest.approx(9.0)
    assert [point.accelerations[1] for point in message.points] == plan.acceleration.tolist()


@pytest.mark.parametrize("controller", ["preview", "paper", "pure_pursuit"])
def test_every_controller_has_a_plan_that_begins_at_its_command(controller: str) -> None:
    supervisor = Supervisor(configuration(Choices(controller, "ordinary", static_path=True)))
    path = line()
    assert supervisor.stopping_plan(0) is None
    for tick in range(4):
        now = NANOSECONDS + tick * NANOSECONDS // 10
        command = supervisor.step(
            VehicleState(now, 10.0 + 0.9 * tick, 0.2, 0.0, 9.0, 0.0, 0.0), path
        )
        plan = supervisor.stopping_plan(now)
        assert plan is not None
        assert plan.angle[0] == pytest.approx(command.steering, abs=1e-12)
        assert plan.speed[0] == 9.0
        assert (plan.x[0], plan.y[0]) == pytest.approx((10.0 + 0.9 * tick, 0.0), abs=0.02)


def test_a_tick_without_a_place_has_no_plan_and_a_failed_solution_uses_the_last_one() -> None:
    supervisor, path = Supervisor(CONFIG), line()
    for tick in range(3):
        now = NANOSECONDS + tick * NANOSECONDS // 10
        supervisor.inject_qp_fault(tick == 2)
        supervisor.step(VehicleState(now, 10.0 + 0.9 * tick, 0.2, 0.0, 9.0, 0.0, 0.0), path)
        plans = supervisor.stopping_plan(now)
        assert plans is not None
    late = now + 5 * NANOSECONDS
    supervisor.take_path(np.column_stack((path.x, path.y)), late, late)
    supervisor.tick(late)  # the state is too old to be predicted
    assert supervisor.stopping_plan(late) is None


def test_a_standing_car_holds_its_angle() -> None:
    plan = plan_on(circle(15.0), 0.0, (0.123,))
    assert plan.angle == pytest.approx(np.full(len(plan.angle), 0.123))
    assert (plan.distance[0], plan.speed.max()) == (0.0, 0.0)


def test_a_small_car_has_points_that_are_as_close_as_it_is_small() -> None:
    small = load_vehicle_file(find("vehicles", "paper")).chassis
    assert small.wheelbase > 2.0
    vehicle = (3.5, 0.05, 0.16, 0.16, 60.0, 60.0)
    plan = stopping_plan(
        PlanStart(line(30.0), 5.0, 2.0, 0.16), [0.0], 0.1, CAR._replace(vehicle=vehicle), 2.0
    )
    assert np.diff(plan.distance).max() < 0.13
