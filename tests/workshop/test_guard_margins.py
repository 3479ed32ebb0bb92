"""Ordinary driving is not clipped by the guard for roads, and no drive by that for tracks."""

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import GuardLimits
from ampc_ros.supervision.guard import Guard
from tests.workshop.acceptance.guard_margins import CARS, DRIVES_AT_THE_LIMIT, Margin, cells, margin
from tests.workshop.acceptance.trials import Trial, run

ORDINARY = ("sc1", "sc1_falcone", "circle", "sine", "straight", "sc3_fast_wind")
ON_TRACKS = ("iso3888_1", "iso3888_2", *DRIVES_AT_THE_LIMIT)


def measure_margin(limits: str, scenario: str, car: str) -> Margin:
    """Drive a scenario and compare the commands with shipped limits."""
    return margin(run(Trial(scenario, car), "preview"), load(GuardLimits, find("guards", limits)))


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("scenario", ORDINARY)
def test_ordinary_driving_stays_inside_the_limits_of_the_road(scenario: str, car: str) -> None:
    result = measure_margin("road", scenario, car)
    assert result.clipped == 0
    assert max(result.shares) < 0.95


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("scenario", [*ORDINARY, *ON_TRACKS])
def test_no_manoeuvre_within_the_tyre_limits_is_clipped_on_a_track(scenario: str, car: str) -> None:
    assert measure_margin("track", scenario, car).clipped == 0


def test_a_manoeuvre_at_the_limit_of_the_tyre_is_clipped_and_counted_on_the_road() -> None:
    trial = Trial("sc3_constant", "ordinary")
    result = measure_margin("road", trial.scenario, trial.car)
    driven = run(trial, "preview")
    v = np.array([state.v_x for state in driven.drive.states])
    L, K_us = driven.vehicle.chassis.wheelbase, driven.vehicle.chassis.understeer_gradient
    steady = v**2 * np.abs(driven.drive.steering) / (L + K_us * v**2)  # of the circle of the angle
    assert result.clipped == result.limits["lateral_acceleration"] > 10
    assert cells(trial, result)[-1] == f"lateral_acceleration {result.clipped}"
    assert result.shares[1] == pytest.approx(steady.max() / 5.0)
    assert result.shares[1] > 1.5


def test_margins_are_those_of_commands_one_by_one() -> None:
    driven = run(Trial("sc2", "paper"), "preview")
    limits = load(GuardLimits, find("guards", "road"))
    guard, clipped = Guard(limits, driven.vehicle.chassis, 0.1), 0
    for angle, state in zip(driven.drive.steering.tolist(), driven.drive.states, strict=True):
        clipped += guard.step(angle, 0.0, state.v_x).limit > 0
        guard.steering = angle
    assert clipped == margin(driven, limits).clipped
