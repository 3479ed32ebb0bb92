"""Sections "eigenvalues" and "tyres" of the result table, and the generated roads."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import Array
from launch_scripts.certifying.linear_loop import delay_margin
from launch_scripts.certifying.margins import Drives, delay_margins, has_settled
from launch_scripts.tuning.drives import straight
from launch_scripts.tuning.fleet import CONVERGED, CROSS_TRACK_ERROR, LOGGED
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from tests.workshop.acceptance.loop_margins import (
    COLUMNS,
    DELAYS,
    LOOP_SPEEDS,
    SMALL,
    decays,
    loop_table,
    subject_with_delay,
)
from tests.workshop.acceptance.road_data import generate
from tests.workshop.acceptance.trials import LIMITS, Trial
from tests.workshop.acceptance.tyre_demand import (
    asked_acceleration,
    reached_acceleration,
    tyre_demand,
)

PAPER, ORDINARY = (load_vehicle_file(find("vehicles", name)) for name in ("paper", "ordinary"))


@pytest.mark.parametrize(
    ("car", "known", "v"), [("ordinary", 0.05, 12.0), ("paper", 0.15, 24.0), ("ordinary", 0.0, 6.0)]
)
def test_a_car_decays_below_its_delay_margin_and_grows_above_it(
    car: str, known: float, v: float
) -> None:
    """One car at a time, in the closed loop that the tests of the controllers use."""
    subject = subject_with_delay(car, known)
    (margin,) = delay_margins(
        Drives(subject, np.array([v]), 1, lambda _: None), SMALL, DELAYS, decays
    )

    def late_amplitude(delay: float) -> Array:
        steering = replace(subject.vehicle.steering, delay=known + delay)
        vehicle = subject.vehicle._replace(steering=steering)
        driven = drive(Simulation(vehicle, straight(v, 20.0, SMALL)), subject.controller())
        y = np.abs([state.y for state in driven.states])
        return np.array([part.max() for part in np.array_split(y, 4)])

    below, above = late_amplitude(margin - 0.01), late_amplitude(margin + 0.015)
    assert (np.diff(below[1:]) < 0.0).all()
    assert (np.diff(above[1:]) > 0.0).all()
    linear = delay_margin(
        subject.controller(), subject.vehicle.chassis, subject.vehicle.steering, v
    )
    assert linear - 0.03 < margin < linear


def test_a_limit_cycle_a_lost_car_and_rounding_errors_are_told_apart() -> None:
    period, n = 0.1, 150
    wave, envelope = np.cos(np.arange(n)), np.linspace(1.0, 0.5, n)

    def log(error: Array) -> Array:
        rows = np.zeros((n, LOGGED))
        rows[:, CONVERGED], rows[:, CROSS_TRACK_ERROR] = 1.0, error
        return rows

    assert decays(log(SMALL * envelope * wave), period)
    assert not decays(log(SMALL * envelope[::-1] * wave), period)
    assert not decays(log(5.0 * SMALL * envelope * wave), period)
    assert decays(log(1e-12 * envelope[::-1] * wave), period)
    lost = np.where(np.arange(n) > 120, np.nan, SMALL)
    assert not decays(log(lost), period)
    assert not has_settled(log(lost), period)
    assert has_settled(log(0.04 * wave), period)
    assert not has_settled(log(0.06 * wave), period)


def test_the_table_of_the_loop_contains_every_speed_and_both_radii() -> None:
    values = {f"{key} at {v:g} m/s": 0.5 for key in COLUMNS for v in LOOP_SPEEDS}
    values["estimator_radius at 9 m/s"] = 0.96
    text = loop_table({"one car": values})
    assert loop_table({}) == ""
    assert "all radii are 0.500 to 0.960" in text
    assert len([line for line in text.splitlines() if line.startswith("| ")]) == 1 + len(
        LOOP_SPEEDS
    )


def front_axle_limit(vehicle: Vehicle, friction: float) -> float:
    """Return the lateral acceleration at which both front tyres slide [m/s^2].

    Moments about the rear axle; the loads are those of this acceleration. Without the steering
    angle and drive forces, which take some percent.
    """
    chassis, body, tyre = vehicle.chassis, vehicle.body, vehicle.tyre
    static = 0.5 * chassis.mass * GRAVITY * chassis.cg_to_rear_axle / chassis.wheelbase
    a = friction * GRAVITY
    for _ in range(50):
        shift = body.front_roll_share * chassis.mass * a * body.cg_height / body.track
        loads = static + np.array([-1.0, 1.0]) * min(shift, static)
        force = friction * loads * (1.0 - tyre.load_sensitivity * (loads / static - 1.0))
        a = float(force.sum()) * chassis.wheelbase / (chassis.mass * chassis.cg_to_rear_axle)
    return a


@pytest.mark.parametrize("vehicle", [PAPER, ORDINARY], ids=["paper", "ordinary"])
@pytest.mark.parametrize("friction", [0.3, 0.6, 1.0])
def test_reached_acceleration_is_that_of_sliding_front_tyres(
    vehicle: Vehicle, friction: float
) -> None:
    limit = front_axle_limit(vehicle, friction)
    reached = reached_acceleration(vehicle, 22.0, friction)
    assert 0.88 * limit < reached < limit


def test_a_circle_asks_for_speed_squared_over_its_radius() -> None:
    radius = 1.0 / abs(float(np.median(driven_curvature("circle"))))
    asked, v = asked_acceleration(Trial("circle", speed=7.0), "preview")
    assert v == 7.0
    assert asked == pytest.approx(49.0 / radius, rel=1e-3)
    measured = tyre_demand(Trial("circle", speed=7.0, friction=0.4), "preview")
    assert measured["demand"] == pytest.approx(100.0 * measured["asked"] / measured["reached"])


def driven_curvature(scenario: str) -> Array:
    """Return the curvature of a shipped path, from its points [1/m]."""
    points = load_scenario(scenario, PAPER.size).points
    x, y = points.T
    dx, dy = np.gradient(x), np.gradient(y)
    turned = dx * np.gradient(dy) - dy * np.gradient(dx)
    return np.asarray(turned / np.hypot(dx, dy) ** 3)


def test_generated_roads_are_of_the_kind_of_the_recorded_ones(tmp_path: Path) -> None:
    files = generate(tmp_path / "one")
    again = generate(tmp_path / "two")
    assert [file.read_bytes() for file in files] == [file.read_bytes() for file in again]
    paths = {file.stem: from_csv(file, None, LIMITS, 2).path for file in files}
    expected = {"circuit": (3774, 20), "hairpins": (2299, 10), "oval": (4022, 185)}
    for name, (length, radius) in expected.items():
        path = paths[f"generated_{name}"]
        assert path.closed
        assert path.length == pytest.approx(length, rel=0.01)
        assert 1.0 / np.abs(path.curvature).max() == pytest.approx(radius, rel=0.1)
        every = round(5.0 / path.spacing)
        x, y, at = path.x[::every], path.y[::every], path.spacing * np.arange(len(path.x))[::every]
        apart = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))
        along = np.abs(np.subtract.outer(at, at))
        far = np.minimum(along, path.length - along) > math.pi * 1.1 * radius
        assert apart[far].min() > 15.0  # the lanes do not touch
    assert not any(path.closed for name, path in paths.items() if "_30mps" in name)
