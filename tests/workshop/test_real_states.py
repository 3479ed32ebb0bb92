"""The section "real states" of the acceptance: a reduced set of its drives, and its files."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.types import VehicleState
from tests.supervised import between
from tests.workshop.acceptance.independent_plant import Disturbance, IndependentSimulation
from tests.workshop.acceptance.real_states import (
    BEFORE_FILE,
    BLIND,
    CHANGE,
    FALSE,
    LATE,
    SECTION,
    SEEDS,
    drive_at_point,
    known_trials,
    measure_false,
    measure_late,
    measure_unknown,
    measure_yaw_rate,
    stored_errors,
    tasks,
)
from tests.workshop.acceptance.real_states_figure import FIGURE, PANELS, draw, read_curves
from tests.workshop.acceptance.state_drives import (
    LANE,
    MOTORWAY,
    MOTORWAY_SPEED,
    StateTrial,
    drive,
    motorway,
)
from tests.workshop.acceptance.targets import END, Observation, Row, Target
from tests.workshop.leaderboard.fast_plant import FastSimulation

ROOT = Path(__file__).resolve().parents[2]
MODULE = "tests.workshop.acceptance.real_states"
SC1 = StateTrial("sc1", "ordinary", 9.0)


def missed(observations: list[Observation]) -> list[Row]:
    """Return the rows that are not met."""
    return [row for row in SECTION.rows(observations) if not row.holds]


def test_an_unknown_actuator_meets_its_target() -> None:
    observations = measure_unknown("11 m/s")
    assert not missed(observations)
    assert observations[0].value > 1e-4


def test_the_servo_of_the_compiled_plant_is_that_of_the_plant() -> None:
    road, disturbance = SC1.scenario, Disturbance(delay=0.02, servo_lag=0.03)
    fast, slow = (kind(road, 2, disturbance) for kind in (FastSimulation, IndependentSimulation))
    for angle in (0.02, -0.03, 0.01):
        for car in (fast, slow):
            car.advance(angle, 9.0, 100_000_000)
    assert fast.measure(0) == pytest.approx(slow.measure(0), abs=1e-9)
    other = FastSimulation(road, 2, disturbance._replace(servo_lag=0.1))
    other.advance(0.02, 9.0, 300_000_000)
    assert other.measure(0).yaw != pytest.approx(fast.measure(0).yaw, abs=1e-4)


@pytest.mark.parametrize("road", ["sc1", "sc2"])
def test_late_odometry_meets_its_targets(road: str) -> None:
    observations = measure_late("paper", road)
    assert len(observations) == len(LATE)
    assert not missed(observations)


def test_missing_states_cost_less_than_their_target() -> None:
    for begin in (3.0, 5.5, 10.0):
        driven = drive(SC1, blind=between(begin, begin + BLIND), end=begin + 6.0)
        assert driven.max < 0.5
        assert len(driven.error) == round((begin + 6.0) / driven.period)


def test_a_driver_who_brakes_is_slower_after_the_stop_request() -> None:
    end = 8.0
    fast, slow = (
        drive(SC1, blind=between(3.0, 5.0), brakes=brakes, end=end) for brakes in (False, True)
    )
    assert np.array_equal(fast.error[:70], slow.error[:70])  # the request comes after 0.5 s
    assert not np.array_equal(fast.error, slow.error)


def test_noise_is_equal_for_equal_seeds_and_does_not_enter_the_true_error() -> None:
    trial = StateTrial(MOTORWAY, "paper", seed=SEEDS[0])
    first, again, other = (drive(each, end=4.0) for each in (trial, trial, trial._replace(seed=1)))
    assert np.array_equal(first.error, again.error)
    assert not np.array_equal(first.error, other.error)
    steps = np.abs(np.diff(first.error))
    assert 0.0 < steps.max() < 0.05
    assert first.activity > 3 * drive(trial._replace(seed=None), end=4.0).activity


def test_the_lane_change_at_high_speed_takes_5_s() -> None:
    x, y = motorway().points.T
    rising = (y > 1e-9) & (y < LANE - 1e-9)
    assert np.ptp(x[rising]) / MOTORWAY_SPEED == pytest.approx(5.0, abs=0.1)
    assert y[-1] == LANE


def test_the_measured_yaw_rate_is_distorted_and_the_true_one_is_not() -> None:
    def distort(state: VehicleState, t: float) -> VehicleState:
        return state._replace(yaw_rate=5.0)

    driven = drive(StateTrial("straight", "ordinary", 9.0), distort=distort, end=1.0)
    assert np.abs(driven.acceleration).max() < 9.0
    found = SECTION.rows(measure_yaw_rate("ordinary"))
    assert len(found) == 4
    assert all(row.holds for row in found)


def test_odometry_of_the_bumper_is_warned_about_and_correct_odometry_is_not() -> None:
    driven = drive_at_point("at the front bumper", StateTrial("circle", "paper", 9.0))
    assert driven.is_warned(10.0)
    assert not driven.is_warned(2.0)
    correct = measure_false("circle")
    assert [(o.target.quantity, o.value) for o in correct] == [(FALSE, 0.0)] * 4


def test_every_target_has_a_task_and_a_result_of_the_version_before() -> None:
    names = [str(trial) for _, trial in known_trials()]
    assert len(names) == len(set(names))
    assert set(stored_errors()) == set(names)
    before = SECTION.before()
    assert {t for t in SECTION.limits if t.quantity != CHANGE} == set(before)
    assert all(math.isfinite(value) for value in before.values())
    content = json.loads(BEFORE_FILE.read_text(encoding="utf-8"))
    assert "9c869f3" in content["source"]
    assert len(tasks()) == len({(job.func.__name__, job.args) for job in tasks()})


def test_a_drive_without_stored_result_does_not_meet_its_target(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(f"{MODULE}.BEFORE_FILE", tmp_path / "none.json")
    assert stored_errors() == {}
    row = Row(Target("configured, delay 0 ms", CHANGE), 0.01, (0.02 - math.nan,), "drive")
    assert not row.holds
    assert row.to_json["worst"] is None


def test_the_page_contains_the_table_and_the_figure_is_drawn(tmp_path: Path) -> None:
    text = (ROOT / "ampc_ros/doc/real_states.md").read_text(encoding="utf-8")
    table = text.split(SECTION.begin)[1].split(END)[0].strip().splitlines()
    assert len(table) == len(SECTION.limits) + 2
    curves = read_curves(BEFORE_FILE)
    assert set(curves) == set(PANELS)
    draw(curves, curves, tmp_path / FIGURE.name)
    assert (tmp_path / FIGURE.name).stat().st_size > 10_000
    assert (ROOT / FIGURE).is_file()
