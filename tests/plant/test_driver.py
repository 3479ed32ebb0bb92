"""Along the road: driver, powertrain, resistances, brakes and standstill."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from ampc_msgs_config import config
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.scenarios.scenario import SPEED_PREVIEW
from ampc_msgs_config.types import Array
from sim_vehicle.car import Car
from sim_vehicle.driver import stands
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from sim_vehicle.vehicle import CAR_V_X, CAR_V_Y, CAR_X, CAR_YAW_RATE

PAPER = load_vehicle_file(config.find("vehicles", "paper"))
ORDINARY = load_vehicle_file(config.find("vehicles", "ordinary"))
both_cars = pytest.mark.parametrize("vehicle", [PAPER, ORDINARY], ids=["paper", "ordinary"])
both_sides = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])


def calm(seconds: float) -> Array:
    """Return still air for a while, at the default step."""
    return np.zeros((round(seconds / 0.005), 2))


def without_resistance(vehicle: Vehicle) -> Vehicle:
    """Return the car without drag, side force and rolling resistance."""
    return vehicle._replace(
        aerodynamics=replace(vehicle.aerodynamics, drag_area=0.0, side_area=0.0),
        powertrain=replace(vehicle.powertrain, rolling_resistance=0.0),
    )


@both_cars
def test_car_coasts_at_constant_speed_where_nothing_resists(vehicle: Vehicle) -> None:
    free = without_resistance(vehicle)
    neutral = replace(free.powertrain, max_drive_force=0.0, max_brake_force=0.0)
    car = Car(free._replace(powertrain=neutral), speed=20.0)
    car.advance(0.0, 30.0, calm(20.0))
    assert car.state[CAR_V_X] == 20.0
    assert car.state[CAR_X] == pytest.approx(400.0)


@both_cars
def test_top_speed_is_where_the_power_is_used_up(vehicle: Vehicle) -> None:
    car = Car(vehicle, speed=50.0)
    car.advance(0.0, 100.0, calm(300.0))
    air, powertrain = vehicle.aerodynamics, vehicle.powertrain
    drag = 0.5 * air.air_density * air.drag_area
    rolling = powertrain.rolling_resistance * vehicle.chassis.mass * GRAVITY
    expected = brentq(lambda v: (drag * v**2 + rolling) * v - powertrain.max_power, 10.0, 100.0)
    assert car.state[CAR_V_X] == pytest.approx(expected, rel=1e-3)


@both_cars
@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_braking_distance_is_that_of_the_friction(vehicle: Vehicle, friction: float) -> None:
    car = Car(without_resistance(vehicle), speed=30.0, friction=friction)
    while car.state[CAR_V_X] > 10.0:
        car.advance(0.0, 0.0, calm(0.005))
    shortest = (30.0**2 - car.state[CAR_V_X] ** 2) / (2 * friction * GRAVITY)
    assert 1.0 < car.state[CAR_X] / shortest < 1.05


@both_cars
@pytest.mark.parametrize("acceleration", [2.0, -2.0])
def test_driver_follows_a_previewed_ramp_without_lag(vehicle: Vehicle, acceleration: float) -> None:
    car = Car(vehicle, speed=18.0)
    for i in range(40):
        car.advance(0.0, 18.0 + acceleration * (0.1 * i + SPEED_PREVIEW), calm(0.1))
    half_a_period = 0.05  # a target that is held for 0.1 s is that late on average
    expected = 18.0 + acceleration * (4.0 - half_a_period)
    assert car.state[CAR_V_X] == pytest.approx(expected, abs=0.01)


@both_cars
@both_sides
def test_driver_keeps_the_speed_in_a_tight_curve(vehicle: Vehicle, side: float) -> None:
    car = Car(vehicle, speed=10.0)
    car.advance(0.2 * side, 10.0, calm(10.0))
    assert abs(car.state[CAR_YAW_RATE]) > 0.4
    assert car.state[CAR_V_X] == pytest.approx(10.0, abs=0.01)


@both_cars
@pytest.mark.parametrize("wind", [-20.0, 0.0, 20.0])
def test_car_stops_cleanly_and_never_drives_backwards(vehicle: Vehicle, wind: float) -> None:
    car, slowest = Car(vehicle, speed=12.0), 12.0
    for _ in range(1000):
        car.advance(0.0, 0.0, np.array([[wind, 0.0]]))
        slowest = min(slowest, car.state[CAR_V_X])
    assert slowest == car.state[CAR_V_X] == 0.0
    place = car.state[CAR_X]
    car.advance(0.0, 0.0, np.tile([wind, 0.0], (2000, 1)))
    assert car.state[CAR_X] == place


@both_cars
def test_car_at_rest_in_still_air_stays_exactly_where_it_is_while_it_is_steered(
    vehicle: Vehicle,
) -> None:
    car = Car(vehicle, (3.0, -2.0, 1.0))
    for i in range(100):
        car.advance(0.4 * math.sin(i), 0.0, calm(0.1))
    assert np.array_equal(car.state[:6], [3.0, -2.0, 1.0, 0.0, 0.0, 0.0])


@both_cars
@pytest.mark.parametrize(("side", "direction"), [(1.0, 0.0), (-1.0, 0.5), (1.0, 1.6), (-1.0, 3.0)])
def test_parked_car_leans_into_the_wind_and_does_not_creep(
    vehicle: Vehicle, side: float, direction: float
) -> None:
    wind = 25.0 * np.array([math.cos(direction), side * math.sin(direction)])
    car = Car(vehicle)
    car.advance(0.3 * side, 0.0, np.tile(wind, (2000, 1)))
    leaning = car.state.copy()
    assert np.abs(leaning[:3]).max() < 0.005
    car.advance(0.3 * side, 0.0, np.tile(wind, (12000, 1)))
    assert np.abs(car.state - leaning)[:6].max() < 1e-9


@both_cars
@both_sides
def test_car_starts_with_its_wheels_turned(vehicle: Vehicle, side: float) -> None:
    car = Car(vehicle)
    for _ in range(100):
        car.advance(0.4 * side, 5.0, calm(0.1))
        assert np.isfinite(car.state).all()
        assert car.state[CAR_V_X] >= 0.0
    chassis = vehicle.chassis
    radius = chassis.wheelbase / math.tan(0.4) + 25.0 * chassis.understeer_gradient / 0.4
    assert car.state[CAR_V_X] == pytest.approx(5.0, abs=0.01)
    assert side * car.state[CAR_YAW_RATE] == pytest.approx(5.0 / radius, rel=0.1)


@both_cars
def test_driver_compensates_head_and_tail_wind(vehicle: Vehicle) -> None:
    for wind in (-15.0, 15.0):
        car = Car(vehicle, speed=20.0)
        car.advance(0.0, 20.0, np.tile([wind, 0.0], (2000, 1)))
        assert car.state[CAR_V_X] == pytest.approx(20.0, abs=1e-6)
        assert car.state[CAR_V_Y] == 0.0


@pytest.mark.parametrize(
    ("v_x", "v_y", "target", "expected"),
    [
        (0.0, 0.0, 0.0, True),
        (-0.049, 0.49, 0.049, True),
        (0.051, 0.0, 0.0, False),
        (-0.051, 0.0, 0.0, False),
        (0.0, -0.51, 0.0, False),
        (0.0, 0.51, 0.0, False),
        (0.0, 0.0, 0.051, False),
    ],
)
def test_parking_brake_acts_at_standstill_only(
    v_x: float, v_y: float, target: float, expected: bool
) -> None:
    assert stands(v_x, v_y, target) is expected
