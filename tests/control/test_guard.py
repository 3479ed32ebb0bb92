"""The guard: each limit at, just below and just above its threshold, to both sides.

Whatever comes in, what goes out is finite and inside the limits.
"""

import ast
import inspect
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import build, find, load, shipped
from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_msgs_config.types import LIMITS
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.supervision.guard import (
    LONGEST_PAUSE,
    MAX_GUARD_SPEED,
    MAX_MEASURED,
    MIN_LIMITED_SPEED,
    SHORTEST,
    Guard,
    GuardBounds,
    GuardResult,
    bounds,
    interpolate_linear,
    measured_range,
)

many = settings(max_examples=300, deadline=None, derandomize=True)
anything = st.floats(allow_nan=True, allow_infinity=True)
PERIOD = 0.1
CHASSIS = load_section(ChassisParameters, find("vehicles", "ordinary"), "chassis")
OVERSTEERING = replace(CHASSIS, rear_cornering_stiffness=20000.0)
NEUTRAL = replace(
    CHASSIS, cg_to_front_axle=1.35, cg_to_rear_axle=1.35, rear_cornering_stiffness=54000.0
)
LIMITS_BY_SPEED = GuardLimits(
    speed=(0.0, 10.0, 20.0),
    max_angle=(0.6, 0.4, 0.2),
    max_rate=(2.0, 1.0, 0.5),
    lateral_acceleration=(6.0, 5.0, 4.0),
    lateral_jerk=(40.0, 30.0, 20.0),
    measured_step=(0.4, 0.3, 0.2),
)
NO_POINTS = {
    "speed": [0.0],
    "max_angle": [1.5],
    "max_rate": [20.0],
    "lateral_acceleration": [50.0],
    "lateral_jerk": [1000.0],
    "measured_step": [3.0],
}
"""Limits that are not met below."""
SIDES = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
UP = math.inf


def guard(chassis: ChassisParameters = CHASSIS, **changes: Any) -> Guard:
    """Make a guard in which only the changed limits are met."""
    return Guard(build(GuardLimits, {**NO_POINTS, **changes}, "limits"), chassis, PERIOD)


def per_acceleration(v: float, chassis: ChassisParameters = CHASSIS) -> float:
    """Angle of the steady circle per lateral acceleration, from the textbook [rad s^2/m]."""
    return chassis.wheelbase / v**2 + chassis.understeer_gradient


def assert_clips_above(
    make: Any, threshold: float, name: str, side: float, v_x: float, **inputs: Any
) -> None:
    """Step to the threshold and its neighbours: at and below nothing happens, above it is cut."""
    limit = LIMITS.index(name)
    for angle in (math.nextafter(threshold, 0.0), threshold):
        one = make()
        mirrored = {key: side * value for key, value in inputs.items()}
        assert one.step(side * angle, 0.0, v_x, **mirrored) == (side * angle, 0.0, 0)
        assert one.steering == side * angle
        assert not any(one.count.values())
    one = make()
    above = math.nextafter(threshold, UP)
    answer = one.step(side * above, 0.0, v_x, **mirrored)
    assert answer.steering == side * threshold
    assert answer.limit == limit
    assert one.count == dict.fromkeys(LIMITS[1:], 0) | {name: 1}


@SIDES
@pytest.mark.parametrize("v_x", [0.0, 5.0, -5.0])
def test_the_angle_is_cut_above_its_largest(side: float, v_x: float) -> None:
    assert_clips_above(lambda: guard(max_angle=[0.3]), 0.3, "angle", side, v_x)


@SIDES
@pytest.mark.parametrize("v_x", [12.0, -12.0])
def test_the_angle_is_cut_above_that_of_the_largest_lateral_acceleration(
    side: float, v_x: float
) -> None:
    threshold = bounds(guard(lateral_acceleration=[5.0]).limits, CHASSIS, v_x).acceleration
    assert threshold == pytest.approx(5.0 * per_acceleration(12.0), rel=1e-12)
    make = lambda: guard(lateral_acceleration=[5.0])  # noqa: E731
    assert_clips_above(make, threshold, "lateral_acceleration", side, v_x)


@SIDES
@pytest.mark.parametrize("v_x", [0.0, 12.0, -12.0])
def test_the_angle_moves_no_faster_than_the_largest_rate(side: float, v_x: float) -> None:
    assert_clips_above(lambda: guard(max_rate=[0.8]), 0.8 * PERIOD, "rate", side, v_x)


@SIDES
@pytest.mark.parametrize("v_x", [12.0, -12.0])
def test_the_angle_moves_no_faster_than_the_largest_jerk_allows(side: float, v_x: float) -> None:
    threshold = bounds(guard(lateral_jerk=[30.0]).limits, CHASSIS, v_x).jerk * PERIOD
    assert threshold == pytest.approx(30.0 * per_acceleration(12.0) * PERIOD, rel=1e-12)
    make = lambda: guard(lateral_jerk=[30.0])  # noqa: E731
    assert_clips_above(make, threshold, "lateral_jerk", side, v_x)


@SIDES
def test_the_angle_goes_no_farther_from_the_measured_one_than_the_step(side: float) -> None:
    make = lambda: guard(measured_step=[0.25])  # noqa: E731
    assert_clips_above(make, 0.125 + 0.25, "measured_step", side, 5.0, measured=0.125)


@SIDES
def test_a_measured_wheel_elsewhere_holds_the_command_back_but_never_pulls_it(side: float) -> None:
    one = guard(measured_step=[0.25])
    one.reset(side * 0.5)
    hold = one.step(side * 0.75, 0.0, 5.0, measured=0.0)
    assert hold == (side * 0.5, 0.0, LIMITS.index("measured_step"))
    assert one.step(side * 0.375, 0.0, 5.0, measured=0.0) == (side * 0.375, 0.0, 0)
    assert one.step(side * 0.25, 0.0, 5.0, measured=0.0) == (side * 0.25, 0.0, 0)
    assert one.count["measured_step"] == 1


@SIDES
@pytest.mark.parametrize(("beyond", "believed"), [(0.0, True), (-1.0, True), (UP, False)])
def test_a_measured_angle_beyond_a_right_angle_is_not_believed(
    side: float, beyond: float, believed: bool
) -> None:
    measured = math.nextafter(MAX_MEASURED, beyond) if beyond else MAX_MEASURED
    expected = (0.0, measured + 0.25) if side > 0 else (-measured - 0.25, 0.0)
    nothing = (-math.inf, math.inf)
    assert measured_range(side * measured, 0.25, 0.0) == (expected if believed else nothing)


@pytest.mark.parametrize("measured", [None, math.nan, math.inf, -math.inf, 1e300])
def test_a_measured_angle_that_is_not_there_limits_nothing(measured: float | None) -> None:
    assert guard(measured_step=[0.01]).step(1.0, 0.5, 5.0, measured) == (1.0, 0.5, 0)


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf])
def test_an_angle_that_is_not_finite_holds_the_last_one(angle: float) -> None:
    one = guard()
    one.step(0.2, 0.7, 5.0)
    assert one.step(angle, 0.7, 5.0) == (0.2, 0.0, LIMITS.index("not_finite"))
    assert one.count == dict.fromkeys(LIMITS[1:], 0) | {"not_finite": 1}


@pytest.mark.parametrize("rate", [math.nan, math.inf, -math.inf])
def test_a_rate_that_is_not_finite_becomes_that_of_the_step(rate: float) -> None:
    one = guard()
    answer = one.step(0.2, rate, 5.0)
    assert answer.steering == 0.2
    assert answer.steering_rate == pytest.approx(2.0)
    assert LIMITS[answer.limit] == "not_finite"


def test_a_command_inside_all_limits_passes_bit_for_bit() -> None:
    one = Guard(LIMITS_BY_SPEED, CHASSIS, PERIOD)
    assert one.step(0.0123456789, 0.123456789, 9.0, 0.01, 0.1) == (0.0123456789, 0.123456789, 0)


@SIDES
def test_the_rate_told_is_that_of_the_clipped_step_and_inside_its_limits(side: float) -> None:
    one = guard(max_rate=[0.5])
    answer = one.step(side * 1.0, side * 10.0, 5.0)
    assert answer.steering == side * 0.05
    assert answer.steering_rate == pytest.approx(side * 0.5)
    assert one.step(side * 0.06, side * 10.0, 5.0) == (side * 0.06, side * 0.5, 0)
    jerky = guard(lateral_jerk=[1.0])
    most = bounds(jerky.limits, CHASSIS, 12.0).jerk
    assert jerky.step(0.0, side * 10.0, 12.0).steering_rate == side * most
    assert guard(max_angle=[0.2]).step(side * 0.3, side * 7.0, 5.0).steering_rate == side * 2.0


NAMED = {
    "from above all": (20.0, None, "angle", {"angle", "lateral_acceleration", "lateral_jerk"}),
    "measured": (
        20.0,
        0.0,
        "lateral_acceleration",
        {"lateral_acceleration", "lateral_jerk", "measured_step"},
    ),
    "standing": (0.0, None, "angle", {"angle", "rate"}),
    "standing, measured": (0.0, 0.0, "rate", {"rate", "measured_step"}),
}


@SIDES
@pytest.mark.parametrize("case", NAMED)
def test_the_most_severe_limit_is_named_and_all_that_clip_are_counted(
    case: str, side: float
) -> None:
    v_x, measured, named, counted = NAMED[case]
    one = Guard(LIMITS_BY_SPEED, CHASSIS, PERIOD)
    for n in (1, 2):
        one.reset(0.0)
        assert LIMITS[one.step(side * 1.0, 0.0, v_x, measured).limit] == named
        assert one.count == {name: n * (name in counted) for name in LIMITS[1:]}


@SIDES
def test_when_the_speed_rises_the_wheel_goes_back_inside_at_the_largest_rate_and_stays(
    side: float,
) -> None:
    one = Guard(LIMITS_BY_SPEED, CHASSIS, PERIOD)
    one.reset(side * 0.5)
    bound = bounds(LIMITS_BY_SPEED, CHASSIS, 20.0)
    turn = bound.jerk * PERIOD
    assert bound.jerk < bound.rate
    angles = [side * 0.5]
    while abs(angles[-1]) > bound.acceleration:
        angles.append(one.step(side * 0.5, 0.0, 20.0).steering)
        left = abs(angles[-2]) - bound.acceleration
        assert abs(angles[-2]) - abs(angles[-1]) == pytest.approx(min(turn, left), abs=1e-15)
        assert len(angles) < 100
    assert angles[-1] == side * bound.acceleration
    assert one.step(side * 0.5, 0.0, 20.0).steering == angles[-1]


@SIDES
@pytest.mark.parametrize("v_x", [0.0, 10.0, 20.0, 99.0, math.nan])
def test_the_wheel_can_always_be_turned_to_the_other_side(side: float, v_x: float) -> None:
    one = Guard(LIMITS_BY_SPEED, NEUTRAL, PERIOD)
    one.reset(side * 0.6)
    for _ in range(2000):
        last = one.steering
        one.step(-side * 0.001, 0.0, v_x)
        if one.steering == last:
            break
    assert one.steering == -side * 0.001


@pytest.mark.parametrize("v_x", [0.0, -0.0, 1e-3, MIN_LIMITED_SPEED, 5e-324])
def test_at_standstill_only_angle_and_rate_limit(v_x: float) -> None:
    bound = bounds(LIMITS_BY_SPEED, CHASSIS, v_x)
    assert bound.angle == pytest.approx(0.6, abs=0.01)
    assert bound.acceleration > 100 * bound.angle
    assert bound.jerk > 100 * bound.rate
    assert bound == bounds(LIMITS_BY_SPEED, CHASSIS, MIN_LIMITED_SPEED)


def test_between_the_speeds_limits_are_linear_and_beyond_them_held() -> None:
    at, values = (2.0, 4.0, 8.0), (1.0, 3.0, -1.0)
    places = {1.0: 1.0, 2.0: 1.0, 2.5: 1.5, 4.0: 3.0, 5.0: 2.0, 7.0: 0.0, 8.0: -1.0, 9.0: -1.0}
    assert {place: interpolate_linear(at, values, place) for place in places} == places
    assert interpolate_linear((3.0,), (7.0,), 2.0) == interpolate_linear((3.0,), (7.0,), 3.0) == 7.0


def test_bounds_are_the_rows_of_the_limits_at_the_speed() -> None:
    per = per_acceleration(15.0)
    expected = GuardBounds(0.3, 4.5 * per, 0.75, 25.0 * per, 0.25)
    assert bounds(LIMITS_BY_SPEED, CHASSIS, 15.0) == pytest.approx(expected, rel=1e-12)
    assert bounds(LIMITS_BY_SPEED, CHASSIS, -15.0) == bounds(LIMITS_BY_SPEED, CHASSIS, 15.0)


@pytest.mark.parametrize("v_x", [math.nan, math.inf, -math.inf, 1e300, math.nextafter(100.0, UP)])
def test_a_speed_that_cannot_be_gives_the_strictest_limits_of_all_speeds(v_x: float) -> None:
    wavy = replace(LIMITS_BY_SPEED, max_angle=(0.5, 0.1, 0.3), lateral_jerk=(9.0, 20.0, 30.0))
    strict = bounds(wavy, CHASSIS, v_x)
    per = per_acceleration(MAX_GUARD_SPEED)
    assert strict == pytest.approx(GuardBounds(0.1, 4.0 * per, 0.5, 9.0 * per, 0.2), rel=1e-12)
    for speed in (0.0, 5.0, 10.0, 20.0, 50.0, MAX_GUARD_SPEED):
        assert all(a <= b for a, b in zip(strict, bounds(wavy, CHASSIS, speed), strict=True))


def test_the_guard_shares_no_code_with_the_controllers() -> None:
    tree = ast.parse(Path(inspect.getfile(Guard)).read_text(encoding="utf-8"))
    froms = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    ours = {name for name in froms if name and name.startswith(("ampc", "sim"))}
    assert ours == {"ampc_msgs_config.parameters", "ampc_msgs_config.types"}


def test_the_constants_are_what_the_documents_say() -> None:
    assert (100.0, 0.1, math.pi / 2) == (MAX_GUARD_SPEED, MIN_LIMITED_SPEED, MAX_MEASURED)
    assert (LONGEST_PAUSE, SHORTEST) == (2.0, 0.5)


def test_the_largest_speed_that_can_be_is_100_metres_a_second() -> None:
    wide = replace(LIMITS_BY_SPEED, max_angle=(0.1, 0.4, 0.2))
    assert bounds(wide, CHASSIS, MAX_GUARD_SPEED).angle == 0.2
    assert bounds(wide, CHASSIS, math.nextafter(MAX_GUARD_SPEED, UP)).angle == 0.1


@pytest.mark.parametrize("v", [1.0, 20.0, 30.0, 40.0, 100.0])
def test_an_oversteering_car_is_credited_with_half_its_wheelbase(v: float) -> None:
    L, K_us = OVERSTEERING.wheelbase, OVERSTEERING.understeer_gradient
    assert K_us < 0
    length = max(L + K_us * v**2, SHORTEST * L)
    held = bounds(LIMITS_BY_SPEED, OVERSTEERING, v)
    assert held.jerk == pytest.approx(
        interpolate_linear((0.0, 10.0, 20.0), (40.0, 30.0, 20.0), v) * length / v**2
    )
    assert bounds(LIMITS_BY_SPEED, OVERSTEERING, 100.0).jerk == pytest.approx(
        20.0 * 0.5 * L / 100.0**2, rel=1e-12
    )


@SIDES
@pytest.mark.parametrize(
    ("elapsed", "periods"),
    [
        (None, 1.0),
        (PERIOD, 1.0),
        (0.5 * PERIOD, 0.5),
        (0.0, 0.0),
        (-1.0, 0.0),
        (math.nan, 0.0),
        (-math.inf, 0.0),
        (math.nextafter(LONGEST_PAUSE * PERIOD, 0.0), LONGEST_PAUSE),
        (LONGEST_PAUSE * PERIOD, LONGEST_PAUSE),
        (math.nextafter(LONGEST_PAUSE * PERIOD, UP), LONGEST_PAUSE),
        (math.inf, LONGEST_PAUSE),
        (1e300, LONGEST_PAUSE),
    ],
)
def test_the_wheel_moves_for_the_time_since_the_last_command_but_not_for_a_long_pause(
    elapsed: float | None, periods: float, side: float
) -> None:
    assert LONGEST_PAUSE == 2.0
    answer = guard(max_rate=[0.5]).step(side * 1.0, 0.0, 5.0, elapsed=elapsed)
    assert answer.steering == pytest.approx(side * 0.05 * periods, rel=1e-12)


@SIDES
def test_a_reset_starts_from_an_angle_as_far_as_it_can_be_and_keeps_the_counts(
    side: float,
) -> None:
    one = guard(max_angle=[0.3], max_rate=[1.0])
    assert one.steering == 0.0
    one.step(side * 1.0, 0.0, 5.0)
    count = dict(one.count)
    for angle, start in ((0.2, 0.2), (0.3, 0.3), (math.nextafter(0.3, UP), 0.3), (9.0, 0.3)):
        one.reset(side * angle)
        assert one.steering == side * start
    assert one.count == count
    one.reset(side * 0.25)
    for angle in (math.nan, math.inf, -math.inf):
        one.reset(angle)
        assert one.steering == side * 0.25


def test_a_reset_goes_as_far_as_the_largest_angle_of_all_speeds() -> None:
    one = Guard(LIMITS_BY_SPEED, CHASSIS, PERIOD)
    one.reset(1.0)
    assert one.steering == max(LIMITS_BY_SPEED.max_angle)


def steps(count: int) -> st.SearchStrategy[list[tuple[float, float, float, float | None, float]]]:
    """Draw inputs of some steps, of any floating-point value."""
    near = st.floats(-1.0, 1.0)
    speed = st.one_of(anything, st.floats(-60.0, 60.0))
    time = st.one_of(anything, st.floats(0.0, 0.3))
    one = st.tuples(
        st.one_of(anything, near),
        st.one_of(anything, near),
        speed,
        st.one_of(st.none(), anything, near),
        time,
    )
    return st.lists(one, min_size=1, max_size=count)


@many
@given(inputs=steps(8), limits=st.sampled_from(["road", "track"]))
def test_whatever_comes_in_what_goes_out_is_finite_and_inside_the_limits(
    inputs: list[tuple[float, float, float, float | None, float]], limits: str
) -> None:
    one = Guard(load(GuardLimits, find("guards", limits)), CHASSIS, PERIOD)
    most = max(one.limits.max_angle)
    for angle, rate, v_x, measured, elapsed in inputs:
        last, bound = one.steering, bounds(one.limits, CHASSIS, v_x)
        out = one.step(angle, rate, v_x, measured, elapsed)
        assert all(map(math.isfinite, out))
        assert out.steering == one.steering
        assert abs(out.steering) <= most
        allowed = max(abs(last), min(bound.angle, bound.acceleration))
        assert abs(out.steering) <= allowed
        time = elapsed if 0.0 < elapsed <= LONGEST_PAUSE * PERIOD else 0.0
        time = LONGEST_PAUSE * PERIOD if elapsed > LONGEST_PAUSE * PERIOD else time
        turn = min(bound.rate, bound.jerk) * time
        assert abs(out.steering - last) <= turn + math.ulp(1.0)
        assert abs(out.steering_rate) <= min(bound.rate, bound.jerk)
        assert 0 <= out.limit < len(LIMITS)


@many
@given(inputs=steps(5))
def test_the_mirrored_guard_does_the_mirrored_same(
    inputs: list[tuple[float, float, float, float | None, float]],
) -> None:
    left, right = (Guard(LIMITS_BY_SPEED, CHASSIS, PERIOD) for _ in range(2))
    for angle, rate, v_x, measured, elapsed in inputs:
        there = None if measured is None else -measured
        out = left.step(angle, rate, v_x, measured, elapsed)
        mirrored = right.step(-angle, -rate, v_x, there, elapsed)
        assert mirrored == GuardResult(-out.steering, -out.steering_rate, out.limit)
    assert left.count == right.count


@many
@given(inputs=steps(5))
def test_the_guard_remembers_only_the_angle_published_last(
    inputs: list[tuple[float, float, float, float | None, float]],
) -> None:
    one, other = (Guard(LIMITS_BY_SPEED, CHASSIS, PERIOD) for _ in range(2))
    for each in inputs:
        other = Guard(LIMITS_BY_SPEED, CHASSIS, PERIOD)
        other.reset(one.steering)
        assert other.step(*each) == one.step(*each)


WRONG: dict[str, dict[str, Any]] = {
    "lateral_acceleration[2] = -1 must lie in [0.1, 50] m/s^2": {
        "lateral_acceleration": [5, 5, -1]
    },
    "max_rate[0] = nan must lie in [0.01, 20] rad/s": {"max_rate": [math.nan, 1, 1]},
    "max_rate[1] = 'fast' must be a number": {"max_rate": [1.0, "fast", 1.0]},
    "max_rate[1] = True must be a number": {"max_rate": [1.0, True, 1.0]},
    "max_angle = 0.5 must be a list of numbers": {"max_angle": 0.5},
    "max_angle = [] must have 3 values": {"max_angle": []},
    "max_angle = [0.5, 0.5] must have 3 values, as speed has": {"max_angle": [0.5, 0.5]},
    "speed[2] = 10 must be greater than 10 before it": {"speed": [0, 10, 10]},
    "speed[1] = 5 must be greater than 6 before it": {"speed": [6, 5, 10]},
    "missing key 'lateral_jerk'": {"lateral_jerk": None},
    "unknown key 'jerk'": {"jerk": [1.0]},
}


@pytest.mark.parametrize("sentence", WRONG)
def test_wrong_limits_are_refused_by_name_value_and_bound(sentence: str) -> None:
    content: dict[str, Any] = asdict(LIMITS_BY_SPEED) | WRONG[sentence]
    content = {key: value for key, value in content.items() if value is not None}
    with pytest.raises(ValueError, match=r"my\.yaml: ") as error:
        build(GuardLimits, content, "my.yaml")
    assert sentence in str(error.value)


@pytest.mark.parametrize("name", shipped("guards"))
def test_shipped_limits_grow_no_wider_with_speed(name: str) -> None:
    limits = load(GuardLimits, find("guards", name))
    for row in list(asdict(limits).values())[1:]:
        assert list(row) == sorted(row, reverse=True)


def test_the_road_is_limited_to_5_metres_per_second_squared() -> None:
    assert set(load(GuardLimits, find("guards", "road")).lateral_acceleration) == {5.0}
