"""Yaw rates that contradict the heading: what is detected, when, and what replaces them."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.supervision.yaw_rate import (
    AGREEMENT_TIME,
    CONTRADICTS,
    MISSING,
    STUCK,
    YAW_RATE_CAUSES,
    YawRateCheck,
)
from sim_vehicle.measurement import Deviations, noisy
from sim_vehicle.parameters import MeasurementNoise

SIDES = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
Reported = Callable[[float, float], float]
"""Yaw rate that odometry reports for the true one at a time [rad/s, s]."""


def drive(
    hz: int = 100,
    seconds: float = 10.0,
    amplitude: float = 0.0,
    mean: float = 0.0,
    reported: Reported = lambda r, _: r,
) -> Iterator[VehicleState]:
    """Yield the states of a car at 9 m/s with a yaw rate that swings once in 6 s."""
    w = math.tau / 6
    for i in range(round(seconds * hz)):
        t = i / hz
        r = mean + amplitude * math.sin(w * t)
        yaw = mean * t + amplitude / w * (1 - math.cos(w * t))
        stamp_ns = NANOSECONDS + round(t * NANOSECONDS)
        yield VehicleState(stamp_ns, 9.0 * t, 0.0, wrap_angle(yaw), 9.0, 0.0, reported(r, t))


def from_3_s(fault: Callable[[float], float]) -> Reported:
    """Return a sensor that is healthy for 3 s."""
    return lambda r, t: r if t < 3.0 else fault(r)


def detection(states: Iterator[VehicleState], begin: float = 3.0) -> float:
    """Return the time from the fault to the first replaced yaw rate [s]."""
    check = YawRateCheck()
    for state in states:
        if check.correct(state) is not state:
            return (state.stamp_ns / NANOSECONDS - 1.0) - begin
    return math.inf


@SIDES
@pytest.mark.parametrize("hz", [10, 50, 100])
def test_states_of_a_consistent_car_are_returned_as_they_are(hz: int, side: float) -> None:
    check = YawRateCheck()
    for state in drive(hz, 60.0, side * 0.6, side * 0.2):
        assert check.correct(state) is state
    assert not any(check.replaced.values())
    assert check.cause == ""


@pytest.mark.parametrize("hz", [10, 50])
@pytest.mark.parametrize("factor", [1.0, 5.0])
def test_ten_minutes_of_noise_change_no_state(hz: int, factor: float) -> None:
    noise = load(MeasurementNoise, find("noise", "x1"))
    deviations = Deviations(*(factor * getattr(noise, name) for name in Deviations._fields))
    normal = np.random.default_rng(7).standard_normal((600 * hz, 6))
    check = YawRateCheck()
    for i, state in enumerate(drive(hz, 600.0, 0.4)):
        measured = noisy(state, deviations, normal[i])
        assert check.correct(measured) is measured


@SIDES
@pytest.mark.parametrize(
    ("fault", "latest"),
    [
        (lambda r: 9.0, 0.001),
        (lambda r: 1.0, 0.15),
        (lambda r: r + 0.3, 0.45),
        (lambda r: r + 0.1, 1.6),
        (lambda r: r + 0.05, 4.5),
    ],
    ids=["9 rad/s", "1 rad/s", "+0.3 rad/s", "+0.1 rad/s", "+0.05 rad/s"],
)
def test_wrong_yaw_rates_are_detected_in_time(
    fault: Callable[[float], float], latest: float, side: float
) -> None:
    def mirrored(r: float) -> float:
        return side * fault(side * r)

    assert -1e-9 <= detection(drive(100, 10.0, 0.1, reported=from_3_s(mirrored))) < latest


def test_a_slow_drift_is_detected_below_0_1_rad_per_s() -> None:
    def drifting(r: float, t: float) -> float:
        return r + 0.02 * max(t - 3.0, 0.0)

    assert 0.02 * detection(drive(100, 10.0, 0.1, reported=drifting)) < 0.1


def test_a_constant_error_within_the_allowance_is_not_detected() -> None:
    states = drive(50, 60.0, 0.1, reported=from_3_s(lambda r: r + 0.019))
    assert detection(states) == math.inf


@SIDES
def test_the_replacement_follows_the_heading(side: float) -> None:
    faults: dict[str, Callable[[float], float]] = {
        MISSING: lambda r: 0.0,
        STUCK: lambda r: 1.0,
        CONTRADICTS: lambda r: r + 0.3,
    }
    for cause, fault in faults.items():
        check = YawRateCheck()
        true = drive(100, 12.0, 0.3 * side, 0.1)
        wrong = drive(100, 12.0, 0.3 * side, 0.1, from_3_s(fault))
        for state, reported in zip(true, wrong, strict=True):
            corrected = check.correct(reported)
            if check.is_replaced and state.stamp_ns > 4.5 * NANOSECONDS:
                assert check.cause == cause
                assert corrected.yaw_rate == pytest.approx(state.yaw_rate, abs=0.06)
                assert corrected == reported._replace(yaw_rate=check.expected)
        assert check.is_replaced
        assert check.measured == reported.yaw_rate
        assert check.replaced[cause] > 700
    assert set(YAW_RATE_CAUSES) == set(faults)


def test_the_yaw_rate_is_used_again_when_it_agrees_for_5_s() -> None:
    def for_2_s(r: float, t: float) -> float:
        return r + 0.5 * (3.0 < t < 5.0)

    check = YawRateCheck()
    replaced = [
        check.correct(state) is not state for state in drive(50, 20.0, 0.3, reported=for_2_s)
    ]
    assert any(replaced[150:250])
    assert all(replaced[250:400])
    assert not any(replaced[round(50 * (5.0 + 2 * AGREEMENT_TIME)) :])


def test_a_constant_yaw_rate_is_not_used_again_on_a_straight() -> None:
    check = YawRateCheck()
    turns = drive(50, 6.0, 0.3, reported=lambda *_: 0.0)
    for last in turns:
        check.correct(last)
    assert check.cause == MISSING
    for i in range(1, 1000):
        stamp_ns = last.stamp_ns + i * NANOSECONDS // 50
        check.correct(last._replace(stamp_ns=stamp_ns))
    assert check.cause == MISSING
    assert check.expected == pytest.approx(0.0, abs=1e-12)


@SIDES
def test_a_heading_that_jumps_is_not_a_wrong_yaw_rate(side: float) -> None:
    check = YawRateCheck()
    for i, state in enumerate(drive(100, 20.0, 0.2)):
        jumped = state._replace(yaw=wrap_angle(state.yaw + side * 0.19 * (i > 900)))
        assert check.correct(jumped) is jumped


def test_a_car_that_stands_may_report_any_yaw_rate() -> None:
    check = YawRateCheck()
    for state in drive(50, 5.0, reported=lambda *_: 0.5):
        standing = state._replace(v_x=0.1)
        assert check.correct(standing) is standing


def test_after_a_gap_the_comparison_begins_again() -> None:
    check = YawRateCheck()
    states = list(drive(50, 10.0, reported=from_3_s(lambda r: 0.3)))
    for state in states[: 150 + 10]:
        assert check.correct(state) is state
    for state in states[200 : 200 + 10]:
        assert check.correct(state) is state
    for state in states[210:]:
        check.correct(state)
    assert check.cause == STUCK
    late = states[-1]._replace(stamp_ns=states[-1].stamp_ns + NANOSECONDS)
    before = check.expected
    assert check.correct(late).yaw_rate == before
    check.reset()
    assert check.cause == ""
    assert check.measured == 0.0
    assert check.replaced[STUCK] > 0


def test_a_replacement_is_bounded_however_close_the_states_are() -> None:
    check = YawRateCheck()
    first = next(drive())
    for i in range(200):
        yaw = 0.15 * (i % 2)
        state = first._replace(stamp_ns=first.stamp_ns + i, yaw=yaw, yaw_rate=9.0)
        assert check.correct(state).yaw_rate in (0.0, 9.0)
    for i in range(1, 50):
        stamp_ns = first.stamp_ns + 200 + i * NANOSECONDS // 20
        state = first._replace(stamp_ns=stamp_ns, yaw=wrap_angle(1.0 * i), yaw_rate=-9.0)
        assert abs(check.correct(state).yaw_rate) <= 10.0
    assert check.expected == 10.0
