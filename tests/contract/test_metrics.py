"""Metrics of drives whose values are computed by hand."""

import math

import numpy as np
import pytest

from ampc_msgs_config.metrics import (
    ALIASES,
    METRICS,
    TABLE,
    Drive,
    DriveRecord,
    distance_driven,
    errors,
    evaluate_drive,
    lateral_errors,
    measure,
    missed_ticks,
    record_of,
    reversals,
    ticks,
    time_where,
)
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState

ROAD = make_path([(0.0, 0.0), (100.0, 0.0)])
SLOPE = make_path([(0.0, 0.0), (60.0, 80.0)])


def drive(left: list[float], steering: list[float], times: list[float]) -> Drive:
    """Return a drive along the x axis at 10 m/s with these offsets, angles and times."""
    states = [
        VehicleState(round(t * NANOSECONDS), 10.0 * t, y, 0.0, 10.0, 0.0, 0.0)
        for t, y in zip(times, left, strict=True)
    ]
    return Drive(states, np.array(steering), np.array([1e-5, 2e-5, 3e-5]))


def along_slope(left: Array) -> Drive:
    """Return a drive parallel to SLOPE, to its left."""
    s, yaw = 10.0 * np.arange(len(left)), math.atan2(80.0, 60.0)
    states = [
        VehicleState(
            i * NANOSECONDS // 10,
            s[i] * math.cos(yaw) - left[i] * math.sin(yaw),
            s[i] * math.sin(yaw) + left[i] * math.cos(yaw),
            yaw,
            10.0,
            0.0,
            0.0,
        )
        for i in range(len(left))
    ]
    return Drive(states, np.zeros(len(left)), np.ones(len(left)))


def test_numbers_of_a_short_drive_are_those_worked_out_by_hand() -> None:
    actual = evaluate_drive(
        drive([1.0, -2.0, 0.0], [0.0, math.radians(3.0), math.radians(-1.0)], [5.0, 5.1, 5.2]),
        ROAD,
        base_link_to_cg=1.6,
        period=0.1,
    )
    expected = {
        "ticks": 3,
        "missed_ticks": 0,
        "mse_m2": 5.0 / 3.0,
        "mse_lateral_m2": 5.0 / 3.0,
        "rms_error_m": math.sqrt(5.0 / 3.0),
        "p95_error_m": 1.9,
        "max_error_m": 2.0,
        "rms_heading_error_deg": 0.0,
        "steering_reversals": 1,
        "steering_rms_increment_deg": math.sqrt((9.0 + 16.0) / 2.0),
        "steering_max_deg": 3.0,
        "solve_time_p50_us": 20.0,
        "solve_time_p99_us": 29.8,
        "solve_time_max_us": 30.0,
    }
    assert actual == pytest.approx({**actual, **expected})
    assert expected.keys() <= actual.keys()


@pytest.mark.parametrize(
    ("times", "missed"),
    [([0.0, 0.1, 0.2], 0), ([0.0, 0.2, 0.3], 1), ([0.0, 0.1, 0.6], 4), ([0.0, 0.104, 0.19], 0)],
)
def test_missed_ticks_are_the_gaps_of_the_stamps(times: list[float], missed: int) -> None:
    judged = evaluate_drive(drive([0.0] * 3, [0.0] * 3, times), ROAD, 0.0, period=0.1)
    assert judged["missed_ticks"] == missed


@pytest.mark.parametrize("period", [0.01, 0.1])
def test_stamps_that_jitter_or_drift_are_no_missed_ticks_but_a_lower_rate_is(period: float) -> None:
    rng, count = np.random.default_rng(2), 2000
    even = np.arange(count) * period
    assert missed_ticks(np.cumsum(np.tile([0.5, 1.5, 1.0], 300) * period), period) == 0
    assert missed_ticks(even * 1.01 + rng.uniform(-0.2, 0.2, count) * period, period) == 0
    slow = np.asarray(even * 1.5, float)
    assert missed_ticks(slow, period) == pytest.approx(0.5 * count, rel=0.05)
    lost = np.delete(even, np.arange(10, count, 10))
    lost += rng.uniform(-0.1, 0.1, len(lost)) * period
    assert missed_ticks(lost, period) == 199


def test_time_of_ticks_counts_from_the_first() -> None:
    times = ticks(drive([0.0] * 3, [0.0] * 3, [7.0, 7.1, 7.3]))
    np.testing.assert_allclose(times, [0.0, 0.1, 0.3])


def test_error_is_that_of_the_centre_of_gravity() -> None:
    turned = VehicleState(0, 10.0, 0.0, math.pi / 2, 5.0, 0.0, 0.0)  # stands across the road
    judged = errors(Drive([turned], np.zeros(1), np.ones(1)), ROAD, base_link_to_cg=1.6)
    np.testing.assert_allclose(judged, [[1.6, math.pi / 2]])


def test_both_errors_are_distances_from_a_straight_road_wherever_it_leads() -> None:
    left = np.array([0.5, 0.0, -1.5])
    np.testing.assert_allclose(errors(along_slope(left), SLOPE, 1.6)[:, 0], left, atol=1e-9)
    np.testing.assert_allclose(lateral_errors(along_slope(left), SLOPE, 1.6), left, atol=1e-9)


def test_paper_s_error_is_undefined_where_the_path_is_no_graph() -> None:
    angle = np.linspace(0.0, 3.6, 40, dtype=np.float64)
    bend = make_path(20.0 * np.column_stack((np.sin(angle), 1 - np.cos(angle))))
    judged = evaluate_drive(drive([0.0] * 3, [0.0] * 3, [0.0, 0.1, 0.2]), bend, 0.0, 0.1)
    assert math.isnan(judged["mse_lateral_m2"])
    assert math.isfinite(judged["mse_m2"])


@pytest.mark.parametrize(
    ("angles", "count"),
    [
        ([0.0, 0.0, 0.0], 0),
        ([0.0, 1.0, 2.0, 3.0], 0),
        ([0.0, 2.0, 1.0, 3.0], 2),
        ([0.0, -2.0, -1.0, -3.0], 2),
        ([1.0, 1.05, 0.95, 1.05, 0.95], 0),
        ([0.0, 1.0, 0.9, 0.8, 0.7], 1),
        ([0.0, 0.15, 0.3, 0.15, 0.05], 1),
    ],
)
def test_a_reversal_is_a_turn_by_more_than_the_band(angles: list[float], count: int) -> None:
    assert reversals(np.radians(angles), band=math.radians(0.2)) == count
    assert reversals(-np.radians(angles), band=math.radians(0.2)) == count


def test_time_counts_from_an_active_tick_to_the_next_one() -> None:
    time = np.array([0.0, 0.1, 0.4, 0.5])
    assert time_where(time, np.array([False, True, False, True])) == pytest.approx(0.3)


def test_distance_is_the_integral_of_the_speed_forward_or_backward() -> None:
    time, speed = np.array([0.0, 1.0, 3.0]), np.array([2.0, 4.0, -4.0])
    assert distance_driven(time, speed) == pytest.approx(3.0 + 8.0)


def test_every_metric_has_its_own_key_and_a_title() -> None:
    assert len(METRICS) == len(TABLE) + len(ALIASES)
    assert all(metric.title for metric in TABLE)


@pytest.mark.parametrize("duration", [0.2, 0.02])
def test_reversals_per_second_of_a_drive_below_a_second(duration: float) -> None:
    time = np.linspace(0.0, duration, 4, dtype=np.float64)
    record = DriveRecord(time, 0.05, steering=np.radians([0.0, 2.0, 1.0, 3.0]))
    expected = 2 / max(duration, 0.05)
    assert measure(["steering_reversal_rate"], record) == pytest.approx(
        {"steering_reversal_rate": expected}
    )


def test_metrics_of_quantities_that_were_not_recorded_are_none() -> None:
    values = measure(METRICS, DriveRecord(np.array([0.0, 0.1]), 0.1))
    assert {key for key, value in values.items() if value is not None} == {
        "ticks",
        "missed_ticks",
        "duration",
    }


def test_metrics_with_two_keys_differ_in_the_unit_at_most() -> None:
    record = record_of(drive([1.0, -2.0, 0.0], [0.0, 0.05, -0.02], [5.0, 5.1, 5.2]), ROAD, 1.6, 0.1)
    values = measure(METRICS, record)
    for result, report in (
        ("rms_error_m", "rms_cross_track_error"),
        ("rms_heading_error_deg", "rms_heading_error"),
        ("steering_rms_increment_deg", "steering_effort"),
        ("steering_max_deg", "max_steering"),
        ("solve_time_p99_us", "solve_time_p99"),
        ("solve_time_p50_us", "solve_time_median"),
    ):
        value = values[report]
        assert value is not None
        assert values[result] == pytest.approx(value * METRICS[report].scale, rel=1e-12)


def test_quantities_of_the_controller_are_counted_and_timed() -> None:
    time = np.array([0.0, 0.1, 0.2, 0.3])

    def rows(*values: float) -> Array:
        return np.column_stack((time, values))

    record = DriveRecord(
        time,
        0.1,
        steering=np.array([0.0, 0.5, -0.4999, 0.0]),
        angle_bound=np.full(4, 0.5),
        tick={
            "rung": rows(0, 1, 2, 4),
            "converged": rows(1, 0, 1, 1),
            "clipped": rows(0, 3, 0, 0),
            "stop_requested": rows(1, 0, 1, 1),
        },
    )
    keys = ("fall_backs", "rung_slack", "unsolved_ticks", "time_clipped", "stop_requests")
    assert measure((*keys, "time_at_limit"), record) == pytest.approx(
        {
            "fall_backs": 2,
            "rung_slack": 1,
            "unsolved_ticks": 1,
            "time_clipped": 0.1,
            "stop_requests": 2,
            "time_at_limit": 0.2,
        }
    )
