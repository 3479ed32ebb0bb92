"""The class that users hold: what it refuses, what it measures, and the files that describe it."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ampc_msgs_config import config
from sim_vehicle.car import Car
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file
from sim_vehicle.vehicle import CAR_V_X, CAR_V_Y, CAR_YAW_RATE

PAPER = load_vehicle_file(config.find("vehicles", "paper"))
STILL = np.zeros((20, 2))
BAD = (math.nan, math.inf, -math.inf)


@pytest.mark.parametrize("name", ["steering", "target_speed", "wind"])
@pytest.mark.parametrize("value", BAD)
def test_input_that_is_no_number_is_refused_by_name_value_and_bound(
    name: str, value: float
) -> None:
    inputs: dict[str, Any] = {"steering": 0.0, "target_speed": 5.0, "wind": STILL}
    inputs[name] = np.array([[0.0, 0.0], [0.0, value]]) if name == "wind" else value
    with pytest.raises(ValueError, match=rf"{name} = {value} must lie in \[.*, .*\]"):
        Car(PAPER).advance(**inputs)


@pytest.mark.parametrize("value", [*BAD, -1.0])
@pytest.mark.parametrize("name", ["speed", "friction", "step"])
def test_setup_outside_its_range_is_refused_by_name_value_and_bound(
    name: str, value: float
) -> None:
    setup: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=rf"{name} = {value} must lie in \[.*, .*\]"):
        Car(PAPER, **setup)


def test_start_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match=r"yaw = nan must lie in"):
        Car(PAPER, (0.0, 0.0, math.nan))


def test_noise_without_a_generator_and_wind_of_a_wrong_shape_are_refused() -> None:
    with pytest.raises(ValueError, match="noise needs rng"):
        Car(PAPER, noise=MeasurementNoise(speed=0.1))
    with pytest.raises(ValueError, match=r"wind has shape \(20,\), must be \(n, 2\)"):
        Car(PAPER).advance(0.0, 0.0, np.zeros(20))


def test_friction_may_change_on_the_way() -> None:
    car = Car(PAPER, speed=20.0)
    car.advance(0.0, 0.0, STILL)
    dry = 20.0 - car.state[CAR_V_X]
    car.friction, before = 0.3, car.state[CAR_V_X]
    car.advance(0.0, 0.0, STILL)
    assert before - car.state[CAR_V_X] == pytest.approx(dry / 3, rel=0.1)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])
def test_measurement_is_taken_at_the_centre_of_the_rear_axle(side: float) -> None:
    car = Car(PAPER, (10.0, 5.0, math.pi / 2), 8.0)
    start = car.measure(7)
    assert (start.stamp_ns, start.yaw, start.v_x, start.v_y) == (7, math.pi / 2, 8.0, 0.0)
    assert (start.x, start.y) == pytest.approx((10.0, 5.0 - 1.6))
    for _ in range(60):
        car.advance(0.1 * side, 8.0, STILL)
    now = car.measure(0)
    assert -math.pi <= now.yaw <= math.pi
    assert now.yaw_rate == car.state[CAR_YAW_RATE]
    assert now.v_y == pytest.approx(car.state[CAR_V_Y] - 1.6 * now.yaw_rate)
    assert side * now.v_y < 0.0  # the rear tyres slip to the outside


def test_measured_motion_is_the_motion_of_the_measured_point() -> None:
    car, period = Car(PAPER, speed=10.0, step=0.001), np.zeros((1, 2))
    for _ in range(700):
        car.advance(0.15, 10.0, period)
    before = car.measure(0)
    car.advance(0.15, 10.0, period)
    after = car.measure(0)
    cos, sin = math.cos(before.yaw), math.sin(before.yaw)
    velocity = cos * before.v_x - sin * before.v_y, sin * before.v_x + cos * before.v_y
    moved = (after.x - before.x) / 0.001, (after.y - before.y) / 0.001
    assert moved == pytest.approx(velocity, abs=0.01)


def test_noise_has_the_stated_deviations_and_repeats_with_its_seed() -> None:
    noise = MeasurementNoise(
        position=0.05, heading=0.01, yaw_rate=0.02, lateral_velocity=0.1, speed=0.03
    )
    first, second = (Car(PAPER, noise=noise, rng=np.random.default_rng(1)) for _ in range(2))
    samples = np.array([first.measure(0)[1:] for _ in range(4000)])
    again = np.array([second.measure(0)[1:] for _ in range(4000)])
    assert np.array_equal(samples, again)
    assert samples.std(axis=0) == pytest.approx([0.05, 0.05, 0.01, 0.03, 0.1, 0.02], rel=0.05)
    assert samples.mean(axis=0) == pytest.approx([-1.6, 0, 0, 0, 0, 0], abs=0.01)


def test_noise_does_not_touch_the_car() -> None:
    noisy = Car(PAPER, speed=9.0, noise=MeasurementNoise(position=1.0), rng=np.random.default_rng())
    exact = Car(PAPER, speed=9.0)
    for car in (noisy, exact):
        car.measure(0)
        car.advance(0.1, 9.0, STILL)
    assert np.array_equal(noisy.state, exact.state)


def test_paper_s_car_is_that_of_table_3_and_the_ordinary_one_understeers_mildly() -> None:
    chassis = PAPER.chassis
    assert (chassis.mass, chassis.yaw_inertia, chassis.wheelbase) == (1575.0, 2875.0, 2.8)
    assert (PAPER.steering.lag, PAPER.steering.delay, PAPER.steering.max_rate) == (0, 0, math.inf)
    assert PAPER.steering.max_angle == math.pi / 6
    ordinary = load_vehicle_file(config.find("vehicles", "ordinary"))
    assert 0.002 < ordinary.chassis.understeer_gradient < 0.003


def refusal(file: Path, content: Any) -> str:
    """Write a vehicle file and give the complaint of its loader."""
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(ValueError, match=file.name) as error:
        load_vehicle_file(file)
    return str(error.value)


@pytest.mark.parametrize(
    ("section", "key", "value", "complaint"),
    [
        ("chassis", "mass", -1.0, "vehicle.yaml: chassis.mass = -1.0 must lie in [1, 100000]"),
        ("tyre", "friction", math.nan, "tyre.friction = nan must lie in [0.01, 3]"),
        ("tyre", "model", "brush", "tyre.model = 'brush' must be one of pacejka, linea"),
        ("body", "track", "1_0", "body.track = '1_0' must be a number in ["),
        ("powertrain", "gears", 6, "powertrain: unknown key 'gears'; known are max_drive_force"),
        ("aero", "drag_area", 1.0, "vehicle.yaml: unknown section 'aero'; known are same_as"),
    ],
)
def test_wrong_vehicle_file_is_refused_by_file_section_key_value_and_bound(
    tmp_path: Path, section: str, key: str, value: Any, complaint: str
) -> None:
    content = yaml.safe_load(config.find("vehicles", "paper").read_text(encoding="utf-8"))
    content.setdefault(section, {})[key] = value
    assert complaint in refusal(tmp_path / "vehicle.yaml", content)


def test_vehicle_file_without_a_key_or_a_section_is_refused(tmp_path: Path) -> None:
    content = yaml.safe_load(config.find("vehicles", "paper").read_text(encoding="utf-8"))
    del content["chassis"]["mass"]
    assert "chassis: missing key 'mass'" in refusal(tmp_path / "vehicle.yaml", content)
    del content["chassis"]
    assert "missing section 'chassis', which the simulated car needs" in refusal(
        tmp_path / "vehicle.yaml", content
    )
