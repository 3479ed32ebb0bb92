"""The filter of states: every threshold at, just below and just above; every cause is reached."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.supervision import plausibility as track
from ampc_ros.supervision.checks import StateCheck, StateFilter
from ampc_ros.supervision.plausibility import CAUSES, CHECK_WINDOW
from sim_vehicle.measurement import Deviations, noisy
from sim_vehicle.parameters import MeasurementNoise

START_NS = 1_700_000_000_000_000_000
TICK_NS = NANOSECONDS // 10
MS = NANOSECONDS // 1000
ACCEPTED = StateCheck(True)
SIDES = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
UP = math.inf


def state(seconds: float = 0.0, **changes: Any) -> VehicleState:
    """Return a state on the way straight on at 9 m/s."""
    stamp_ns = START_NS + round(seconds * NANOSECONDS)
    here = VehicleState(stamp_ns, 9.0 * seconds, 0.0, 0.0, 9.0, 0.0, 0.0)
    return here._replace(**changes)


def circling(seconds: float, v: float = 9.0, yaw_rate: float = 0.3) -> VehicleState:
    """Return a state of a steady circle through the origin."""
    yaw, radius = yaw_rate * seconds, v / yaw_rate
    stamp_ns = START_NS + round(seconds * NANOSECONDS)
    x, y = radius * math.sin(yaw), radius - radius * math.cos(yaw)
    return VehicleState(stamp_ns, x, y, wrap_angle(yaw), v, 0.0, yaw_rate)


def mirrored(one: VehicleState) -> VehicleState:
    """Return the same on the other side of the x axis."""
    return one._replace(y=-one.y, yaw=-one.yaw, v_y=-one.v_y, yaw_rate=-one.yaw_rate)


def arrive(filtered: StateFilter, one: VehicleState, late_ns: int = 0) -> StateCheck:
    """Let a state arrive some time after its stamp."""
    return filtered.accept(one, one.stamp_ns + late_ns)


def running(until: float = 1.0, step: float = 0.1) -> StateFilter:
    """Return a filter that has accepted states up to a time."""
    filtered = StateFilter()
    for i in range(round(until / step) + 1):
        assert arrive(filtered, state(i * step)) == ACCEPTED
    return filtered


def refused(filtered: StateFilter, one: VehicleState, cause: str, late_ns: int = 0) -> str:
    """Assert that a state is refused for a cause and changes nothing but its count."""
    newest = filtered.track.last if filtered.track else None
    count = dict(filtered.rejected)
    verdict = arrive(filtered, one, late_ns)
    assert verdict[:3] == (False, False, cause)
    assert (filtered.track.last if filtered.track else None) is newest
    assert filtered.rejected == count | {cause: count[cause] + 1}
    return verdict.reason


def test_states_that_follow_from_each_other_are_accepted() -> None:
    filtered = running()
    assert filtered.rejected == dict.fromkeys(CAUSES, 0)


@pytest.mark.parametrize("name", VehicleState._fields[1:])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_refused_by_name(name: str, value: float) -> None:
    reason = refused(running(), state(1.1, **{name: value}), "not_finite")
    assert reason == f"odom: {name} = {value} must be finite"


RANGES = {
    "x": 1.0e8,
    "y": 1.0e8,
    "yaw": 1.0e6,
    "v_x": 100.0,
    "v_y": 100.0,
    "yaw_rate": 10.0,
}


@SIDES
@pytest.mark.parametrize("name", RANGES)
def test_numbers_beyond_any_car_are_refused_with_value_and_bound(name: str, side: float) -> None:
    most = RANGES[name]
    for value in (math.nextafter(most, 0.0), most):
        assert arrive(StateFilter(), state(**{name: side * value})) == ACCEPTED
    above = side * math.nextafter(most, UP)
    reason = refused(StateFilter(), state(**{name: above}), "implausible")
    assert reason.startswith(f"odom: {name} = {above:g} must lie in [{-most:g}, {most:g}]")


def test_a_stamp_more_than_100_ms_in_the_future_is_refused() -> None:
    for ahead_ns in (100 * MS - 1, 100 * MS):
        assert arrive(StateFilter(), state(), -ahead_ns) == ACCEPTED
    reason = refused(StateFilter(), state(), "in_the_future", -100 * MS - 1)
    assert reason == "odom: stamp is 0.1 s in the future, must be at most 0.1 s"


def test_a_stamp_of_zero_is_named_unless_it_is_the_time_of_a_simulation() -> None:
    unset = state()._replace(stamp_ns=0)
    for now_ns in (0, NANOSECONDS):
        assert StateFilter().accept(unset, now_ns) == ACCEPTED
    for filtered in (StateFilter(), running()):
        verdict = filtered.accept(unset, START_NS)
        assert verdict[:3] == (False, False, "zero_stamp")
        assert verdict.reason == (
            "odom: header.stamp = 0: the publisher does not set it; must be the time of the "
            "measurement"
        )
        assert filtered.rejected["zero_stamp"] == 1


def test_without_a_clock_no_stamp_is_in_the_future() -> None:
    filtered = StateFilter()
    assert filtered.accept(state(), 0) == ACCEPTED
    assert filtered.accept(state(0.1), 0) == ACCEPTED
    assert filtered.accept(state(0.2), 1).cause == "in_the_future"


def test_an_old_state_is_the_matter_of_the_time_outs_and_accepted_here() -> None:
    assert arrive(StateFilter(), state(), 3600 * NANOSECONDS) == ACCEPTED


def test_a_stamp_that_has_been_here_is_a_duplicate() -> None:
    filtered = running()
    for _ in range(10):
        reason = refused(filtered, state(1.0), "duplicate")
        assert reason == f"odom: stamp {START_NS + NANOSECONDS} ns has been here before"
    assert filtered.candidate is None


@pytest.mark.parametrize(
    ("back_ns", "cause"),
    [
        (1, "out_of_order"),
        (500 * MS - 1, "out_of_order"),
        (500 * MS, "out_of_order"),
        (500 * MS + 1, "clock_jumped_back"),
    ],
)
def test_a_stamp_half_a_second_back_is_overtaken_and_beyond_that_its_clock_may_have_jumped(
    back_ns: int, cause: str
) -> None:
    filtered = running()
    one = state(1.0)
    one = one._replace(stamp_ns=one.stamp_ns - back_ns)
    reason = refused(filtered, one, cause, back_ns)
    assert reason == {
        "out_of_order": f"odom: stamp is {back_ns / 1e9:.3g} s before that of the newest state",
        "clock_jumped_back": "odom: stamp went back by 0.5 s, more than 0.5 s",
    }.get(cause)
    assert arrive(filtered, state(1.1)) == ACCEPTED


def test_overtaken_states_never_reset_however_many_come() -> None:
    filtered = running(3.0)
    for i in range(26, 30):
        refused(filtered, state(0.1 * i), "out_of_order", round((3.0 - 0.1 * i) * NANOSECONDS))
    assert filtered.candidate is None


def test_a_clock_that_jumped_back_is_believed_with_the_third_state_that_goes_on_there() -> None:
    filtered = running(3.0)
    now_ns = START_NS + 3 * NANOSECONDS
    for i, expected in enumerate((False, False, True)):
        verdict = filtered.accept(state(0.1 * i), now_ns + i * TICK_NS)
        assert verdict[:3] == (expected, expected, "clock_jumped_back")
    assert arrive(filtered, state(0.3)) == ACCEPTED
    assert filtered.rejected["clock_jumped_back"] == 2


def test_old_states_from_several_places_do_not_prove_a_jump_of_the_clock() -> None:
    filtered = running(3.0)
    for i in range(4):
        refused(filtered, state(0.1 * i, x=100.0 * i), "clock_jumped_back", 3 * NANOSECONDS)


@pytest.mark.parametrize("back", [0.2, 2.9])
def test_where_the_node_s_clock_went_back_too_one_state_resets(back: float) -> None:
    filtered = running(3.0)
    verdict = arrive(filtered, state(3.0 - back))
    assert verdict[:2] == (True, True)
    assert verdict.cause == ("out_of_order" if back <= 0.5 else "clock_jumped_back")
    assert arrive(filtered, state(3.1 - back)) == ACCEPTED
    assert not any(filtered.rejected.values())


@pytest.mark.parametrize(("now_back_ns", "reset"), [(100 * MS, False), (100 * MS + 1, True)])
def test_the_node_s_clock_went_back_where_it_is_100_ms_earlier(
    now_back_ns: int, reset: bool
) -> None:
    filtered = running(3.0)
    verdict = filtered.accept(state(2.95), START_NS + 3 * NANOSECONDS - now_back_ns)
    assert verdict.reset == reset


def test_a_clock_that_is_not_there_has_not_gone_back() -> None:
    filtered = running(3.0)
    assert not filtered.accept(state(2.5), 0).reset


@pytest.mark.parametrize("ran", [0.11, 0.5, 60.0])
def test_a_simulator_that_starts_again_in_lock_step_resets_at_once(ran: float) -> None:
    filtered, begin = StateFilter(), state(0.0)._replace(stamp_ns=NANOSECONDS)
    for t in np.linspace(0.0, ran, 1 + math.ceil(ran / 0.1)).tolist():
        moved = begin._replace(stamp_ns=NANOSECONDS + round(t * NANOSECONDS), x=9.0 * t)
        assert filtered.accept(moved, moved.stamp_ns) == ACCEPTED
    assert filtered.accept(begin, begin.stamp_ns)[:2] == (True, True)
    later = begin._replace(stamp_ns=begin.stamp_ns + TICK_NS, x=0.9)
    assert filtered.accept(later, later.stamp_ns) == ACCEPTED
    further = later._replace(stamp_ns=later.stamp_ns + TICK_NS, x=500.0)
    assert not filtered.accept(further, further.stamp_ns).accepted


def test_after_a_clock_that_went_back_the_next_state_has_to_follow_from_the_first() -> None:
    filtered = running(3.0)
    assert arrive(filtered, state(0.0)).reset
    refused(filtered, state(0.1, x=500.0), "position_jump")


def test_after_a_silence_a_state_follows_from_a_refused_one_in_spite_of_its_twist() -> None:
    filtered = running(1.0)
    refused(filtered, state(1.1, x=500.0), "position_jump")
    assert arrive(filtered, state(1.75, x=500.0))[:2] == (True, True)


@SIDES
@pytest.mark.parametrize("v", [0.0, 9.0])
def test_a_position_may_differ_by_half_a_metre_from_where_the_speed_takes_it(
    v: float, side: float
) -> None:
    most = v * 0.1 + 0.5
    first = VehicleState(START_NS, 0.0, 0.0, side * math.pi / 2, v, 0.0, 0.0)
    later = first._replace(stamp_ns=START_NS + TICK_NS)
    for there in (math.nextafter(most, 0.0), most):
        filtered = StateFilter()
        arrive(filtered, first)
        assert arrive(filtered, later._replace(y=side * there)) == ACCEPTED
    filtered = StateFilter()
    arrive(filtered, first)
    above = math.nextafter(most, UP)
    reason = refused(filtered, later._replace(y=side * above), "position_jump")
    assert reason == (
        f"odom: position jumped by {above:.3g} m in 0.1 s, must be at most {most:.3g} m"
    )


def lagging(*, behind: float) -> StateFilter:
    """Return a filter whose last state, of 1 s, was so far behind a car of 8 m/s [m]."""
    filtered = StateFilter()
    for i in range(9):
        late = behind if i == 8 else 0.0
        assert arrive(filtered, state(0.125 * i, x=1.0 * i - late, v_x=8.0)) == ACCEPTED
    return filtered


@SIDES
def test_a_jump_is_none_up_to_half_a_metre_from_where_the_twist_leads_from_half_a_second_before(
    side: float,
) -> None:
    jumped = state(1.125, x=9.5, v_x=8.0)
    assert arrive(lagging(behind=0.625), jumped) == ACCEPTED
    aside = jumped._replace(x=9.25, y=side * 0.4)
    assert arrive(lagging(behind=0.625), aside) == ACCEPTED
    above = jumped._replace(x=math.nextafter(9.5, UP))
    reason = refused(lagging(behind=0.625), above, "position_jump")
    assert reason == "odom: position jumped by 2.13 m in 0.125 s, must be at most 1.5 m"
    refused(lagging(behind=0.625), jumped._replace(x=9.25, y=side * 0.45), "position_jump")


@SIDES
def test_a_position_that_comes_back_to_where_the_twist_leads_must_not_have_turned(
    side: float,
) -> None:
    jumped = state(1.125, x=9.25, v_x=8.0)
    assert arrive(lagging(behind=0.625), jumped._replace(yaw=side * 0.2)) == ACCEPTED
    turned = jumped._replace(yaw=side * math.nextafter(0.2, UP))
    refused(lagging(behind=0.625), turned, "heading_jump")


def test_a_state_that_jumps_away_is_refused_however_the_last_ones_lagged() -> None:
    for behind in (0.0, 0.3, 0.6):
        filtered = lagging(behind=behind)
        for i in range(4):
            t = 1.125 + 0.125 * i
            verdict = arrive(filtered, state(t, x=8.0 * t + 2.0, v_x=8.0))
            assert (verdict.accepted, verdict.cause) == (False, "position_jump")
        assert arrive(filtered, state(1.625, x=15.0, v_x=8.0))[:2] == (True, True)


@pytest.mark.parametrize("hz", [20, 50, 100])
def test_a_pose_that_was_frozen_for_a_moment_goes_on_at_once(hz: int) -> None:
    filtered, causes = StateFilter(), []
    for i in range(3 * hz):
        t = i / hz
        shown = 2.0 if 2.0 < t < 2.3 else t
        causes.append(arrive(filtered, state(t, x=9.0 * shown)).cause)
    assert set(causes[: 2 * hz + 1]) == {""}
    assert "twist_contradicts_pose" in causes
    assert set(causes[round(2.3 * hz) + 1 :]) == {""}


@pytest.mark.parametrize(("short_ns", "reset"), [(0, True), (1, False)])
def test_a_clock_that_jumped_back_is_believed_where_states_take_half_the_time_that_they_tell(
    short_ns: int, reset: bool
) -> None:
    filtered = running(3.0)
    begin_ns = START_NS + 3 * NANOSECONDS
    for i in range(2):
        assert not filtered.accept(state(0.1 * i), begin_ns + i * TICK_NS // 2).accepted
    assert filtered.accept(state(0.2), begin_ns + TICK_NS - short_ns).reset == reset


def test_a_queue_of_old_states_that_empties_itself_proves_no_jump_of_the_clock() -> None:
    filtered = running(3.0)
    for i in range(20):
        verdict = filtered.accept(state(0.1 * i), START_NS + 3 * NANOSECONDS + i)
        assert not verdict.accepted
    assert arrive(filtered, state(3.1)) == ACCEPTED


def test_the_larger_of_two_speeds_tells_how_far_a_position_may_move() -> None:
    slow, fast = state(0.0, v_x=0.0), state(0.1, x=1.4)
    for first, then in ((slow, fast), (fast._replace(stamp_ns=slow.stamp_ns), fast)):
        filtered = StateFilter()
        arrive(filtered, first._replace(x=0.0))
        assert filtered.accept(then, then.stamp_ns).cause != "position_jump"


@SIDES
@pytest.mark.parametrize("field", ["v_x", "v_y"])
@pytest.mark.parametrize("first_moves", [True, False])
def test_a_speed_to_the_side_counts_as_one_ahead_does(
    first_moves: bool, field: str, side: float
) -> None:
    still = VehicleState(START_NS, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    speed: dict[str, Any] = {field: 9.0}
    moving = still._replace(**speed)
    first, then = (moving, still) if first_moves else (still, moving)
    for moved, jumped in ((1.39, False), (1.41, True)):
        filtered = StateFilter()
        arrive(filtered, first)
        there = then._replace(stamp_ns=START_NS + TICK_NS, y=side * moved)
        assert (arrive(filtered, there).cause == "position_jump") == jumped


@SIDES
def test_a_heading_may_turn_by_exactly_the_threshold(side: float) -> None:
    for turned, cause in ((0.2, ""), (math.nextafter(0.2, UP), "heading_jump")):
        filtered = StateFilter()
        arrive(filtered, state(0.0))
        assert arrive(filtered, state(0.1, yaw=side * turned)).cause == cause


@SIDES
@pytest.mark.parametrize("yaw_rate", [0.0, 0.5, -0.5])
@pytest.mark.parametrize("yaw", [0.0, 3.1])
def test_a_heading_may_differ_by_0_2_rad_from_where_the_yaw_rate_takes_it(
    yaw_rate: float, yaw: float, side: float
) -> None:
    most = abs(yaw_rate) * 0.1 + 0.2
    first = VehicleState(START_NS, 0.0, 0.0, side * yaw, 0.0, 0.0, yaw_rate)
    for turned, expected in ((most - 1e-12, ""), (most + 1e-12, "heading_jump")):
        filtered = StateFilter()
        arrive(filtered, first)
        there = wrap_angle(side * (yaw + turned))
        verdict = arrive(filtered, first._replace(stamp_ns=START_NS + TICK_NS, yaw=there))
        assert verdict.cause == expected
    reason = f"odom: heading jumped by {most:.3g} rad in 0.1 s, must be at most {most:.3g} rad"
    assert verdict.reason == reason


def test_a_pose_may_differ_from_its_twist_by_half_a_metre_and_5_percent_of_the_way() -> None:
    v = 4.0
    most = 0.5 + 0.05 * v * CHECK_WINDOW
    for drift, expected in ((most - 1e-9, ""), (most + 1e-9, "twist_contradicts_pose")):
        filtered = StateFilter()
        for i in range(6):
            x = (v * 0.1 - drift / 5) * i
            verdict = arrive(filtered, state(0.1 * i, x=x, v_x=v))
        assert verdict.cause == expected
    assert f"differs by {most:.3g} m" in verdict.reason
    assert f"at most {most:.3g} m" in verdict.reason


@SIDES
def test_a_side_slip_is_part_of_the_twist(side: float) -> None:
    filtered = StateFilter()
    for i in range(20):
        assert arrive(filtered, state(0.1 * i, y=side * 0.2 * i, v_y=side * 2.0)) == ACCEPTED
    for i in range(20, 40):
        verdict = arrive(filtered, state(0.1 * i, y=side * 3.8, v_y=side * 2.0))
    assert verdict.cause == "twist_contradicts_pose"


@pytest.mark.parametrize("hz", [10, 20, 50, 100])
@pytest.mark.parametrize("v", [1.5, 9.0, 30.0])
def test_a_frozen_pose_is_found_and_never_accepted_again_while_its_twist_moves(
    hz: int, v: float
) -> None:
    filtered, found = StateFilter(), None
    for i in range(20 * hz):
        t = i / hz
        verdict = arrive(filtered, state(t, x=v * min(t, 2.0), v_x=v))
        assert not verdict.reset
        if not verdict.accepted and found is None:
            found = t - 2.0
        assert verdict.accepted == (found is None)
    threshold = 0.5 + 0.05 * v * CHECK_WINDOW
    assert found is not None
    assert found <= threshold / v + 1.0 / hz + 1e-9
    assert found <= threshold / v + 0.1 + 1e-9


@pytest.mark.parametrize("hz", [10, 50])
@pytest.mark.parametrize("v", np.arange(0.1, 2.0, 0.05).tolist())
def test_a_slowly_moving_twist_beside_a_frozen_pose_is_either_found_for_good_or_not_at_all(
    hz: int, v: float
) -> None:
    filtered = StateFilter()
    verdicts = [arrive(filtered, state(i / hz, x=0.0, v_x=v)) for i in range(10 * hz)]
    assert not any(verdict.reset for verdict in verdicts)


def test_a_car_that_is_placed_anew_is_accepted_after_half_a_second() -> None:
    filtered = running(1.0)
    for i in range(11, 30):
        verdict = arrive(filtered, state(0.1 * i, y=50.0))
        if i < 16:
            assert verdict[:3] == (False, False, "position_jump")
        elif i == 16:
            assert verdict[:3] == (True, True, "position_jump")
        else:
            assert verdict == ACCEPTED
    assert filtered.rejected["position_jump"] == 5


@pytest.mark.parametrize(("short_ns", "reset"), [(1, False), (0, True), (-1, True)])
def test_a_fresh_start_takes_half_a_second_to_the_nanosecond(short_ns: int, reset: bool) -> None:
    filtered = running(1.0)
    for i in range(11, 16):
        assert not arrive(filtered, state(0.1 * i, y=50.0)).accepted
    last = state(1.6, y=50.0)
    assert arrive(filtered, last._replace(stamp_ns=last.stamp_ns - short_ns)).reset == reset


def test_a_valid_state_in_between_ends_a_fresh_start() -> None:
    filtered = running(1.0)
    for i in range(11, 40):
        expected = i % 3 == 0
        y = 0.0 if expected else 50.0
        assert arrive(filtered, state(0.1 * i, y=y)).accepted == expected


def test_a_position_that_keeps_jumping_is_never_accepted() -> None:
    filtered = running(1.0)
    for i in range(11, 60):
        assert not arrive(filtered, state(0.1 * i, y=50.0 * (i % 2 + 1))).accepted


def test_duplicates_and_overtaken_states_do_not_delay_a_fresh_start() -> None:
    filtered = running(1.0)
    for i in range(11, 17):
        verdict = arrive(filtered, state(0.1 * i, y=50.0))
        assert not arrive(filtered, state(0.1 * i, y=50.0), MS).accepted
        assert not arrive(filtered, state(0.1 * i - 0.05, y=50.0), 51 * MS).accepted
    assert verdict.reset


def test_a_gap_in_time_ends_the_window_and_the_car_may_have_gone_on_meanwhile() -> None:
    filtered = StateFilter()
    assert arrive(filtered, circling(0.0)) == ACCEPTED
    assert arrive(filtered, circling(3.0)._replace(yaw=wrap_angle(0.9))) == ACCEPTED
    for i in range(31, 50):
        assert arrive(filtered, circling(0.1 * i)) == ACCEPTED


def test_a_twist_is_held_against_the_pose_up_to_a_gap_of_half_a_second() -> None:
    for gap, cause in ((CHECK_WINDOW, "twist_contradicts_pose"), (CHECK_WINDOW + 1e-9, "")):
        filtered = StateFilter()
        arrive(filtered, state(0.0))
        assert arrive(filtered, state(gap, x=0.0)).cause == cause


def test_the_window_goes_on_over_a_gap_of_half_a_second() -> None:
    for gap, cause in ((CHECK_WINDOW, "twist_contradicts_pose"), (CHECK_WINDOW + 1e-3, "")):
        filtered = StateFilter()
        arrive(filtered, state(0.0))
        assert arrive(filtered, state(gap, x=9.0 * gap - 0.45)) == ACCEPTED
        later = gap + 0.1
        assert arrive(filtered, state(later, x=9.0 * later - 0.9)).cause == cause


@pytest.mark.parametrize("yaw", np.arange(-3.0, 3.1, 0.5).tolist())
def test_the_way_counts_in_all_directions(yaw: float) -> None:
    v, most = 40.0, 0.5 + 0.05 * 40.0 * CHECK_WINDOW
    for drift, cause in ((most - 1e-6, ""), (most + 1e-6, "twist_contradicts_pose")):
        filtered = StateFilter()
        for i in range(6):
            way = (v * 0.1 - drift / 5) * i
            there = VehicleState(
                START_NS + i * TICK_NS,
                way * math.cos(yaw),
                way * math.sin(yaw),
                yaw,
                v,
                0.0,
                0.0,
            )
            verdict = arrive(filtered, there)
        assert verdict.cause == cause


def test_the_window_stays_small_however_fast_states_come() -> None:
    filtered = StateFilter()
    for i in range(3 * track.MOST_STATES):
        assert arrive(filtered, state(1e-4 * i)) == ACCEPTED
    assert filtered.track is not None
    assert len(filtered.track.window) == track.MOST_STATES
    for i in range(1, 100):
        arrive(filtered, state(0.3 + 0.1 * i))
    assert len(filtered.track.window) <= 7


def test_a_filter_that_is_reset_takes_any_state_and_keeps_its_counts() -> None:
    filtered = running()
    refused(filtered, state(1.1, y=90.0), "position_jump")
    filtered.reset()
    assert filtered.candidate is None
    assert arrive(filtered, state(0.2, y=-90.0)) == ACCEPTED
    assert filtered.rejected["position_jump"] == 1


@pytest.mark.parametrize(("hz", "seed"), [(10, 0), (10, 1), (10, 2), (50, 0)])
@pytest.mark.parametrize(("v", "yaw_rate"), [(9.0, 0.3), (25.0, 0.02), (1e-3, 1e-4)])
def test_ten_minutes_of_noisy_measurements_are_all_accepted(
    hz: int, seed: int, v: float, yaw_rate: float
) -> None:
    noise = load(MeasurementNoise, find("noise", "x1"))
    deviations = Deviations(*(getattr(noise, name) for name in Deviations._fields))
    normal = np.random.default_rng(seed).standard_normal((600 * hz, 6))
    filtered = StateFilter()
    for i in range(600 * hz):
        one = noisy(circling(i / hz, v, yaw_rate), deviations, normal[i])
        assert arrive(filtered, one) == ACCEPTED


def test_the_point_that_odometry_describes_does_not_matter() -> None:
    filtered = StateFilter()
    for i in range(100):
        assert arrive(filtered, at_distance(circling(0.1 * i, 5.0, 0.8), 3.0)) == ACCEPTED


def test_every_cause_is_reached() -> None:
    filtered = running(3.0)
    arrive(filtered, state(3.1, x=math.nan))
    arrive(filtered, state(3.1, v_x=300.0))
    filtered.accept(state()._replace(stamp_ns=0), START_NS)
    arrive(filtered, state(3.1), -NANOSECONDS)
    arrive(filtered, state(3.0))
    arrive(filtered, state(2.9), TICK_NS)
    arrive(filtered, state(1.0), 2 * NANOSECONDS)
    arrive(filtered, state(3.1, x=200.0))
    arrive(filtered, state(3.1, yaw=1.0))
    arrive(filtered, state(3.1, x=26.5))
    assert filtered.rejected == dict.fromkeys(CAUSES, 1)


numbers = st.one_of(st.floats(), st.floats(-50.0, 50.0))
stamps = st.one_of(
    st.integers(0, 2**63 - 1), st.integers(0, 3000).map(lambda ms: START_NS + ms * MS)
)
states = st.builds(VehicleState, stamps, numbers, numbers, numbers, numbers, numbers, numbers)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(arrivals=st.lists(st.tuples(states, stamps), max_size=12))
def test_whatever_arrives_is_judged_and_the_mirrored_is_judged_alike(
    arrivals: list[tuple[VehicleState, int]],
) -> None:
    filtered, other = StateFilter(), StateFilter()
    refused_ones = 0
    for one, now_ns in arrivals:
        verdict = filtered.accept(one, now_ns)
        assert verdict[:3] == other.accept(mirrored(one), now_ns)[:3]
        assert verdict.accepted or not verdict.reset
        assert verdict.accepted == (filtered.track is not None and filtered.track.last is one)
        assert (verdict.cause == "") == (verdict == ACCEPTED)
        refused_ones += not verdict.accepted
    assert sum(filtered.rejected.values()) == refused_ones
    if filtered.track is not None:
        assert all(map(math.isfinite, filtered.track.last))
