"""The car in the plane: handling against theory, wheel loads, symmetry, wind, numerics."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from ampc_msgs_config import config
from ampc_msgs_config.parameters import GRAVITY, ChassisParameters
from ampc_msgs_config.types import Array
from sim_vehicle.aerodynamics import air_forces
from sim_vehicle.car import Car
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from sim_vehicle.vehicle import (
    A_Y,
    CAR_STEERING,
    CAR_V_X,
    CAR_V_Y,
    CAR_X,
    CAR_Y,
    CAR_YAW,
    CAR_YAW_RATE,
    SLIP,
)
from sim_vehicle.vehicle_row import vehicle_numbers
from sim_vehicle.wheels import wheel_loads

PAPER = load_vehicle_file(config.find("vehicles", "paper"))
ORDINARY = load_vehicle_file(config.find("vehicles", "ordinary"))
both_cars = pytest.mark.parametrize("vehicle", [PAPER, ORDINARY], ids=["paper", "ordinary"])
both_sides = pytest.mark.parametrize("side", [1.0, -1.0], ids=["left", "right"])


def with_tyre(vehicle: Vehicle, model: str) -> Vehicle:
    """Return the car on tyres of this model."""
    return vehicle._replace(tyre=replace(vehicle.tyre, model=model))


def driven(
    car: Car, steering: Array, *, speed: float, wind: Array | None = None, step: float = 0.005
) -> Array:
    """Drive one control period of 0.1 s per steering angle and give the states, (n, SIZE)."""
    steps, states = round(0.1 / step), []
    for i, angle in enumerate(steering):
        air = np.zeros(2) if wind is None else wind[i]
        car.advance(float(angle), speed, np.tile(air, (steps, 1)))
        states.append(car.state)
    return np.array(states)


def lane_change(amplitude: float) -> Array:
    """Return the steering of a double lane change in one sine and back [rad]."""
    time = np.arange(0.0, 6.0, 0.1)
    move = amplitude * np.sin(math.tau * time / 2.0)
    return np.where(time < 2.0, move, np.where((time >= 3.0) & (time < 5.0), -move, 0.0))


@both_cars
@pytest.mark.parametrize(("model", "speed"), [("pacejka", 3.0), ("linear", 9.0), ("pacejka", 25.0)])
def test_steady_yaw_rate_is_that_of_the_understeer_gradient_within_one_percent(
    vehicle: Vehicle, model: str, speed: float
) -> None:
    L, K_us = vehicle.chassis.wheelbase, vehicle.chassis.understeer_gradient
    delta = 0.3 * (L / speed**2 + K_us)  # for 0.3 m/s^2
    car = Car(with_tyre(vehicle, model), speed=speed)
    v = driven(car, np.full(150, delta), speed=speed)[-1, CAR_V_X]
    expected = v * delta / (L + K_us * v**2)
    assert car.state[CAR_YAW_RATE] == pytest.approx(expected, rel=0.01)


def bicycle(chassis: ChassisParameters, v: float, sigma: float) -> tuple[Array, Array]:
    """Return A and B of the linear single-track model; states v_y, r and the lagged slip angles."""
    m, I_z, l_f, l_r = (
        chassis.mass,
        chassis.yaw_inertia,
        chassis.cg_to_front_axle,
        chassis.cg_to_rear_axle,
    )
    C_f, C_r = 2 * chassis.front_cornering_stiffness, 2 * chassis.rear_cornering_stiffness
    A = np.array(
        [
            [0.0, -v, C_f / m, C_r / m],
            [0.0, 0.0, l_f * C_f / I_z, -l_r * C_r / I_z],
            [-1.0 / sigma, -l_f / sigma, -v / sigma, 0.0],
            [-1.0 / sigma, l_r / sigma, 0.0, -v / sigma],
        ]
    )
    return A, np.array([[0.0], [0.0], [v / sigma], [0.0]])


@both_cars
@pytest.mark.parametrize("speed", [6.0, 15.0, 25.0])
def test_small_step_response_is_that_of_the_linear_model(vehicle: Vehicle, speed: float) -> None:
    delta = 0.2 * (vehicle.chassis.wheelbase / speed**2 + 0.005)
    ideal = vehicle._replace(steering=PAPER.steering)
    states = driven(Car(ideal, speed=speed), np.full(30, delta), speed=speed)
    A, B = bicycle(vehicle.chassis, speed, vehicle.tyre.relaxation_length)
    time: Any = np.arange(0.0, 3.0001, 0.005)
    system = (A, B, np.eye(4), np.zeros((4, 1)))
    held: Any = np.full(len(time), delta)
    _, linear, _ = lsim(system, held, time)
    for column, expected in ((CAR_V_Y, linear[20::20, 0]), (CAR_YAW_RATE, linear[20::20, 1])):
        assert np.abs(states[:, column] - expected).max() < 0.01 * np.abs(expected).max()


@both_cars
def test_driving_to_the_right_mirrors_driving_to_the_left(vehicle: Vehicle) -> None:
    rng = np.random.default_rng(3)
    steering, wind = 0.15 * rng.standard_normal(100), 10 * rng.standard_normal((100, 2))
    left = driven(Car(vehicle, (1.0, 2.0, 0.3), 14.0), steering, speed=17.0, wind=wind)
    mirror = np.array([1.0, -1.0])
    right = driven(Car(vehicle, (1.0, -2.0, -0.3), 14.0), -steering, speed=17.0, wind=mirror * wind)
    for column in (CAR_Y, CAR_YAW, CAR_V_Y, CAR_YAW_RATE, A_Y):
        right[:, column] *= -1
    right[:, SLIP : SLIP + 4] *= -1
    right[:, SLIP : SLIP + 4] = right[:, [SLIP + 1, SLIP, SLIP + 3, SLIP + 2]]
    right[:, CAR_STEERING] *= -1
    assert np.array_equal(left, right)


def test_motion_does_not_depend_on_the_compass() -> None:
    turn = 2.0
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    steering, wind = lane_change(0.05), np.tile([3.0, 12.0], (60, 1))
    states = driven(Car(PAPER, speed=14.0), steering, speed=14.0, wind=wind)
    turned = driven(
        Car(PAPER, (0.0, 0.0, turn), 14.0), steering, speed=14.0, wind=wind @ rotation.T
    )
    assert np.allclose(turned[:, [CAR_X, CAR_Y]], states[:, [CAR_X, CAR_Y]] @ rotation.T, atol=1e-9)
    assert np.allclose(turned[:, CAR_V_X:], states[:, CAR_V_X:], atol=1e-6)


@settings(max_examples=300, deadline=None)
@given(a_x=st.floats(-100.0, 100.0), a_y=st.floats(-100.0, 100.0))
def test_wheel_loads_are_never_negative_and_carry_the_weight(a_x: float, a_y: float) -> None:
    for vehicle in (PAPER, ORDINARY):
        car = vehicle_numbers(vehicle)
        loads = wheel_loads(a_x, a_y, car.chassis, car.body)
        assert min(loads) >= 0.0
        assert sum(loads) == pytest.approx(vehicle.chassis.mass * GRAVITY)


def test_wheel_loads_shift_to_the_outside_of_the_curve_and_forward_under_braking() -> None:
    car, m = vehicle_numbers(PAPER), PAPER.chassis.mass
    assert wheel_loads(0.0, 0.0, car.chassis, car.body) == pytest.approx(
        [4414.5] * 2 + [3310.9] * 2, abs=0.1
    )
    fl, fr, rl, rr = wheel_loads(0.0, 4.0, car.chassis, car.body)
    assert (fr - fl + rr - rl) * 1.55 / 2 == pytest.approx(m * 4.0 * 0.54)  # moments about x
    assert (fr - fl) / (fr - fl + rr - rl) == pytest.approx(0.55)
    fl, fr, rl, rr = wheel_loads(-4.0, 0.0, car.chassis, car.body)
    assert (fl + fr) * 1.2 - (rl + rr) * 1.6 == pytest.approx(m * 4.0 * 0.54)  # moments about y


def test_static_loads_are_the_reference_loads_of_the_tyres() -> None:
    car = vehicle_numbers(PAPER)
    loads = wheel_loads(0.0, 0.0, car.chassis, car.body)
    assert (car.front_tyre[-1], car.rear_tyre[-1]) == pytest.approx((loads[0], loads[2]))


@both_sides
@both_cars
@pytest.mark.parametrize("friction", [0.2, 0.9])
def test_lateral_acceleration_stays_below_the_friction(
    vehicle: Vehicle, friction: float, side: float
) -> None:
    car = Car(vehicle, speed=20.0, friction=friction)
    states = driven(car, np.full(60, 0.5 * side), speed=20.0)
    assert 0.75 * friction * GRAVITY < np.abs(states[:, A_Y]).max() < friction * GRAVITY


def test_side_wind_of_25_metres_a_second_is_that_of_the_nominal_plant() -> None:
    for side in (1.0, -1.0):
        _, force, moment = air_forces(
            (0.0, 0.0), (1.0, 0.0), (0.0, 25.0 * side), vehicle_numbers(PAPER).air
        )
        assert (force, moment) == pytest.approx((1723.0 * side, 603.0 * side), abs=1.0)


@settings(max_examples=100, deadline=None)
@given(angle=st.floats(-math.pi, math.pi), speed=st.floats(0.0, 40.0))
def test_side_force_and_yaw_moment_are_odd_in_the_wind_angle(angle: float, speed: float) -> None:
    def air(direction: float) -> tuple[float, float, float]:
        wind = 20.0 * math.cos(direction), 20.0 * math.sin(direction)
        return air_forces((speed, 0.0), (1.0, 0.0), wind, vehicle_numbers(PAPER).air)

    drag, side, moment = air(angle)
    assert air(-angle) == pytest.approx((drag, -side, -moment))
    assert side * math.sin(angle) >= 0.0


@pytest.mark.parametrize("amplitude", [0.05, -0.05])
@both_cars
def test_halving_the_step_does_not_change_a_lane_change(vehicle: Vehicle, amplitude: float) -> None:
    normal, fine = (
        driven(Car(vehicle, speed=15.0, step=h), lane_change(amplitude), speed=15.0, step=h)
        for h in (0.005, 0.0025)
    )
    moved = np.abs(normal[:, CAR_Y]).max()
    assert moved > 2.0
    assert np.abs(normal - fine)[:, [CAR_X, CAR_Y]].max() < 1e-5 * moved


def test_integration_is_of_fourth_order() -> None:
    ideal = ORDINARY._replace(steering=PAPER.steering)
    rough, smooth, exact = (
        driven(Car(ideal, speed=15.0, step=h), lane_change(0.05), speed=15.0, step=h)[:, :6]
        for h in (0.02, 0.01, 0.00125)
    )
    assert 12.0 < np.linalg.norm(rough - exact) / np.linalg.norm(smooth - exact) < 24.0


@both_cars
@pytest.mark.parametrize("model", ["pacejka", "linear"])
@pytest.mark.parametrize("seed", range(3))
def test_sliding_car_gains_no_energy_but_what_its_tyres_have_stored(
    vehicle: Vehicle, model: str, seed: int
) -> None:
    no_engine = replace(vehicle.powertrain, max_drive_force=0.0)
    still_air = replace(vehicle.aerodynamics, air_density=0.0)
    vehicle = with_tyre(vehicle, model)._replace(powertrain=no_engine, aerodynamics=still_air)
    rng, m, I_z = np.random.default_rng(seed), vehicle.chassis.mass, vehicle.chassis.yaw_inertia
    car, energy = Car(vehicle), []
    car.state[[CAR_V_X, CAR_V_Y, CAR_YAW_RATE]] = rng.uniform(-1, 1, 3) * [25.0, 15.0, 5.0]
    for _ in range(2000):
        car.advance(rng.uniform(-0.5, 0.5), 0.0, np.zeros((1, 2)))
        v_x, v_y, r = car.state[[CAR_V_X, CAR_V_Y, CAR_YAW_RATE]]
        energy.append(m * (v_x**2 + v_y**2) / 2 + I_z * r**2 / 2)
    stored = vehicle.tyre.friction * m * GRAVITY * vehicle.tyre.relaxation_length
    assert (energy - np.minimum.accumulate(energy)).max() < stored
    assert energy[-1] < 0.01


@both_cars
@pytest.mark.parametrize(
    ("speed", "friction"), [(0.0, 0.05), (0.5, 1.2), (20.0, 0.05), (60.0, 1.2)]
)
def test_wild_steering_never_breaks_the_simulation(
    vehicle: Vehicle, speed: float, friction: float
) -> None:
    rng = np.random.default_rng(5)
    car = Car(vehicle, speed=speed, friction=friction)
    steering, wind = rng.uniform(-0.6, 0.6, 200), rng.uniform(-40, 40, (200, 2))
    states = driven(
        car, np.concatenate((steering, -steering)), speed=speed, wind=np.vstack((wind,) * 2)
    )
    assert np.isfinite(states).all()
    assert np.abs(states[:, SLIP : SLIP + 4]).max() <= 1.0
    assert np.hypot(states[:, CAR_V_X], states[:, CAR_V_Y]).max() < max(speed, 1.0) + 10.0
