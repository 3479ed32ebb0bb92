"""Plans of the gate: what is accepted, and how a plan is followed."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampc_ros.gate.following import followed_angle
from ampc_ros.gate.plan import MOST_PLAN_POINTS, PlanPoint, SteeringPlan, make_plan
from tests.gates import CHASSIS, plan_of

POINTS = [
    PlanPoint(0.0, 0.01, 0.0, 8.0, 0.0),
    PlanPoint(0.5, 0.02, 4.0, 8.0, 0.0),
    PlanPoint(1.0, 0.04, 7.0, 6.0, -2.0),
    PlanPoint(1.5, 0.05, 7.0, 0.0, -2.0),
]
LIMITS = {
    "angle": (-math.pi / 2, math.pi / 2),
    "speed": (0.0, 100.0),
    "distance": (0.0, 1e300),
    "acceleration": (-1e300, 0.0),
}


def changed(number: int, **change: float) -> list[PlanPoint]:
    """Return the points with one of them changed."""
    return [p._replace(**change) if i == number else p for i, p in enumerate(POINTS)]


def test_a_plan_holds_its_points_by_quantity() -> None:
    angles, distances = (0.01, 0.02, 0.04, 0.05), (0.0, 4.0, 7.0, 7.0)
    speeds, places = (8.0, 8.0, 6.0, 0.0), ((0.0, 0.0),) * 4
    assert make_plan(POINTS) == SteeringPlan(distances, angles, speeds, places)
    assert make_plan(POINTS, has_places=False).places == ()


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("field", PlanPoint._fields)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_rejected(number: int, field: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"points\[{number}\].{field} = .* must be finite"):
        make_plan(changed(number, **{field: value}))


@pytest.mark.parametrize("field", LIMITS)
def test_numbers_at_their_limits_are_accepted_and_those_beyond_rejected(field: str) -> None:
    low, high = LIMITS[field]
    single = [POINTS[0], POINTS[1]]
    for value in (low, high):
        make_plan([single[0], single[1]._replace(**{field: value})])
    for value in (low - 1e-3, high + 1e-3):
        if low - 1e-3 != low and high + 1e-3 != high:
            with pytest.raises(ValueError, match=f"points.1..{field}"):
                make_plan([single[0], single[1]._replace(**{field: value})])
    negative: dict[str, Any] = {"distance": -1e-3, "acceleration": 1e-3}
    if field in negative:
        with pytest.raises(ValueError, match=f"{field} = "):
            make_plan(changed(0, **{field: negative[field]}))


def test_times_increase_strictly_from_zero_and_distances_never_fall() -> None:
    with pytest.raises(ValueError, match=r"points\[0\].time = 0.1 must be 0 s"):
        make_plan(changed(0, time=0.1))
    for time in (0.5, 0.4):
        with pytest.raises(ValueError, match=r"points\[2\].time = 0..* than 0.5 s before it"):
            make_plan(changed(2, time=time))
    with pytest.raises(ValueError, match=r"points\[2\].distance = 3.9 .* than 4 m before it"):
        make_plan(changed(2, distance=3.9))
    make_plan(changed(2, distance=4.0))


@pytest.mark.parametrize(("count", "is_valid"), [(0, 0), (1, 0), (2, 1), (2000, 1), (2001, 0)])
def test_a_plan_has_2_to_2000_points(count: int, is_valid: bool) -> None:
    points = [PlanPoint(float(i), 0.0, float(i), 1.0, 0.0) for i in range(count)]
    if is_valid:
        assert len(make_plan(points).angles) == count
    else:
        with pytest.raises(
            ValueError, match=f"{count} points must have 2 to {MOST_PLAN_POINTS} points"
        ):
            make_plan(points)


@given(
    angles=st.lists(st.floats(-1.5, 1.5), min_size=2, max_size=9),
    distance=st.floats(0.0, 50.0),
)
def test_a_planned_angle_lies_between_those_of_the_plan(
    angles: list[float], distance: float
) -> None:
    plan = plan_of(angles)
    angle = followed_angle(plan, CHASSIS, distance, 8.0)
    assert min(angles) <= angle + 1e-12
    assert angle <= max(angles) + 1e-12
    assert angle == pytest.approx(np.interp(distance, plan.distances, angles), abs=1e-9)
