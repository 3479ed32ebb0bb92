"""The gate on its plan: angle by distance and speed, place of the car, return to the plan."""

import math

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_ros.gate.following import (
    CREDIBLE_ERROR,
    MeasuredPose,
    PlanPlace,
    followed_angle,
    place_on,
    pose_correction,
)
from ampc_ros.gate.plan import PlanPoint, SteeringPlan, make_plan
from sim_vehicle.parameters import load_vehicle_file

CHASSIS = load_vehicle_file(find("vehicles", "ordinary")).chassis
L, K_US = CHASSIS.wheelbase, CHASSIS.understeer_gradient


def circular_plan(radius: float, v: float, side: float = 1.0, turned: float = 0.0) -> SteeringPlan:
    """Return a plan along a circle that starts at the origin in the direction `turned`."""
    angle = side / radius * (L + K_US * v * v)
    points = []
    for i in range(80):
        s = 1.0 * i
        a = s / radius
        x, y = radius * math.sin(a), side * radius * (1.0 - math.cos(a))
        c, d = math.cos(turned), math.sin(turned)
        points.append(PlanPoint(s / v, angle, s, v, -1.0, c * x - d * y, d * x + c * y))
    return make_plan(points)


def pose_beside(
    radius: float, s: float, offset: float, *, side: float = 1.0, turn: float = 0.0, v: float = 9.0
) -> MeasuredPose:
    """Return a pose to the left of a circle through the origin by an offset."""
    a = s / radius
    yaw = side * a
    x, y = radius * math.sin(a), side * radius * (1.0 - math.cos(a))
    return MeasuredPose(x - offset * math.sin(yaw), y + offset * math.cos(yaw), yaw + turn, v, 0.0)


@pytest.mark.parametrize("speed", [0.0, 3.0, 9.0, 14.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_angle_gives_the_planned_curvature_at_any_speed(speed: float, side: float) -> None:
    plan = circular_plan(30.0, 9.0, side)
    angle = followed_angle(plan, CHASSIS, 12.3, speed)
    assert angle / (L + K_US * speed**2) == pytest.approx(side / 30.0)


def test_the_angle_is_linear_between_points_and_held_beyond_both_ends() -> None:
    rows = [(0.0, 0.1, 0.0), (1.0, 0.3, 10.0), (2.0, -0.1, 20.0)]
    plan = make_plan([PlanPoint(t, angle, d, 10.0, 0.0) for t, angle, d in rows], has_places=False)
    at = {-5.0: 0.1, 0.0: 0.1, 2.5: 0.15, 10.0: 0.3, 15.0: 0.1, 20.0: -0.1, 99.0: -0.1}
    found = {d: followed_angle(plan, CHASSIS, d, 10.0) for d in at}
    assert found == pytest.approx(at)


@pytest.mark.parametrize("radius", [12.0, 30.0, 500.0])
@pytest.mark.parametrize("offset", [-1.5, -0.2, 0.0, 0.7])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("turn", [-0.3, 0.0, 0.5])
def test_a_car_beside_its_plan_is_found(
    radius: float, offset: float, side: float, turn: float
) -> None:
    plan = circular_plan(radius, 9.0, side)
    pose = pose_beside(radius, 20.4, offset, side=side, turn=turn)
    place = place_on(plan, pose, 18.0)
    assert place is not None
    assert place.distance == pytest.approx(20.4, abs=0.05)
    assert place.error == pytest.approx(offset, abs=0.02)
    assert place.heading_error == pytest.approx(turn, abs=0.01)


@pytest.mark.parametrize("turned", [math.pi, -3.0, 1.0])
def test_directions_are_compared_across_the_half_turn(turned: float) -> None:
    plan = circular_plan(1e6, 9.0, 1.0, turned)
    x, y = 10.0 * math.cos(turned), 10.0 * math.sin(turned)
    for turns in (-1, 0, 1):
        yaw = turned + 0.1 + math.tau * turns
        place = place_on(plan, MeasuredPose(x, y, yaw, 9.0, 0.0), 10.0)
        assert place is not None
        assert place.heading_error == pytest.approx(0.1, abs=1e-4)


def test_a_pose_that_is_not_credible_is_not_used() -> None:
    plan, near = circular_plan(30.0, 9.0), pose_beside(30.0, 20.0, 0.0)
    assert place_on(plan, near, 20.0)
    behind = place_on(plan, near, 20.0 + 9.0)  # farther than the range of the projection
    assert behind is not None
    assert behind.distance == pytest.approx(29.0 - 6.5, abs=1.0)
    assert place_on(plan, pose_beside(30.0, 20.0, CREDIBLE_ERROR + 0.1), 20.0) is None
    assert place_on(plan, pose_beside(30.0, 20.0, 0.0, turn=1.1), 20.0) is None
    assert place_on(plan, near._replace(x=math.nan), 20.0) is None
    assert place_on(plan, near._replace(yaw=math.inf), 20.0) is None
    assert place_on(plan._replace(places=()), near, 20.0) is None


def test_places_that_coincide_are_no_obstacle() -> None:
    rows = [PlanPoint(0.1 * i, 0.0, 0.0, 0.0, 0.0, 3.0, 4.0) for i in range(5)]
    place = place_on(make_plan(rows), MeasuredPose(3.0, 4.5, 0.0, 0.0, 0.0), 0.0)
    assert place is not None
    assert (place.distance, place.error) == pytest.approx((0.0, 0.5))


def test_the_correction_steers_back_to_the_plan_and_is_odd() -> None:
    pose = MeasuredPose(0.0, 0.0, 0.0, 9.0, 0.0)
    left = pose_correction(PlanPlace(0.0, 0.4, 0.05), CHASSIS, pose)
    right = pose_correction(PlanPlace(0.0, -0.4, -0.05), CHASSIS, pose)
    assert left == -right
    assert left < 0.0
    far, farther = (pose_correction(PlanPlace(0.0, e, 0.0), CHASSIS, pose) for e in (1.0, 2.5))
    assert far == farther
    drifting = pose_correction(PlanPlace(0.0, 0.0, 0.0), CHASSIS, pose._replace(v_y=0.5))
    assert drifting < 0.0
    for v in (-0.2, 0.0, 0.5, 1.0):
        slow = pose_correction(PlanPlace(0.0, 1.0, 0.5), CHASSIS, pose._replace(v_x=v))
        assert -1.0 < slow < 0.0


@pytest.mark.parametrize("speed", [2.0, 9.0, 20.0])
@pytest.mark.parametrize("delay", [0.0, 0.3])
@pytest.mark.parametrize("offset", [0.5, -0.5])
def test_a_car_without_slip_returns_to_its_plan_without_oscillation(
    speed: float, delay: float, offset: float
) -> None:
    plan = circular_plan(200.0, speed)
    straight = plan._replace(
        places=tuple((d, 0.0) for d in plan.distances), angles=(0.0,) * len(plan.angles)
    )
    straight = straight._replace(
        distances=tuple(10.0 * d for d in plan.distances),
        places=tuple((10.0 * d, 0.0) for d in plan.distances),
    )
    x, y, yaw, dt = 0.0, offset, 0.0, 0.02
    waiting = [0.0] * round(delay / dt)
    errors = []
    for _ in range(round(12.0 / dt)):
        pose = MeasuredPose(x, y, yaw, speed, 0.0)
        place = place_on(straight, pose, x)
        assert place is not None
        angle = followed_angle(straight, CHASSIS, place.distance, speed)
        waiting.append(angle + pose_correction(place, CHASSIS, pose))
        turn = speed * waiting.pop(0) / (L + K_US * speed * speed)
        yaw += turn * dt
        x, y = x + speed * math.cos(yaw) * dt, y + speed * math.sin(yaw) * dt
        errors.append(y * math.copysign(1.0, offset))
    assert abs(errors[-1]) < 0.05
    assert min(errors) > -0.1
    assert max(np.abs(errors)) < 0.52
