"""Identification: drives of known cars, limit cases, what cannot be known, and the manoeuvre."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.paths.manoeuvre import identification_points
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import Array
from ampc_ros.identification.estimate import Start, car_parameters
from ampc_ros.identification.model import ModelActuator, actuator_angles, car_motion
from ampc_ros.identification.recording import RecordedDrive, recording_of, usable_rows
from ampc_ros.identification.result import RULES, Identification, identified_chassis, identify
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file
from tests.workshop.acceptance.identification_drives import (
    Driven,
    KnownCar,
    drive_manoeuvre,
    random_car,
    start_of,
    vehicle_of,
)

CARS_OF_ALL_SIZES = [(0.25, 0.4), (1.2, 0.5), (2.9, 0.6), (6.0, 0.7)]
"""Wheelbase [m] and largest angle [rad]."""
CHASSIS = load_vehicle_file(find("vehicles", "ordinary")).chassis


@cache
def known(name: str, seed: int, delay: float | None = None) -> KnownCar:
    """Return a random car; with a delay, its lag is 0."""
    car = random_car(name, np.random.default_rng(seed))
    if delay is None:
        return car
    steering = replace(car.vehicle.steering, delay=delay, lag=0.0)
    return car._replace(vehicle=car.vehicle._replace(steering=steering))


@cache
def driven(name: str, seed: int, delay: float | None = None) -> Driven:
    """Return the drive of a random car."""
    return drive_manoeuvre(known(name, seed, delay), np.random.default_rng(seed))


def recorded(name: str, seed: int, delay: float | None = None) -> RecordedDrive:
    """Return the recording of the drive of a random car."""
    return driven(name, seed, delay).recording


def first_part(recording: RecordedDrive, seconds: float) -> RecordedDrive:
    """Return the begin of a drive, which is identified in less time."""
    end = recording.time[0] + seconds
    state, command, steering = (
        t < end for t in (recording.time, recording.command_time, recording.steering_time)
    )
    t, x, y, yaw, v_x, v_y, r = (values[state] for values in recording[:7])
    sent = recording.command_time[command], recording.command[command]
    seen = recording.steering_time[steering], recording.steering[steering]
    return RecordedDrive(t, x, y, yaw, v_x, v_y, r, *sent, *seen, recording.age)


def without_steering(recording: RecordedDrive) -> RecordedDrive:
    """Return the drive without measured steering."""
    return recording._replace(steering_time=np.array([]), steering=np.array([]))


@cache
def identified(name: str, seed: int) -> Identification:
    """Return the result of the drive of a random car."""
    return identify(recorded(name, seed), start_of(known(name, seed)))


def check_targets(car: KnownCar, result: Identification) -> None:
    """Check the targets of all that the drive identifies at least."""
    found, c = {name: q.value for name, q in result.quantities.items()}, car.vehicle.chassis
    K = c.understeer_gradient
    assert found["understeer_gradient"] == pytest.approx(K, abs=0.15 * K)
    stiffness = c.rear_cornering_stiffness
    assert found["rear_cornering_stiffness"] == pytest.approx(stiffness, rel=0.15)
    assert found["offset"] == pytest.approx(car.offset, abs=math.radians(0.1))
    assert found["ratio"] == pytest.approx(car.ratio, rel=0.015)
    assert found["measured_point"] == pytest.approx(car.x_P, abs=0.05)


def test_a_known_car_is_identified_from_a_start_that_is_wrong() -> None:
    car, result = known("ordinary", 41), identified("ordinary", 41)
    check_targets(car, result)
    steering, found = car.vehicle.steering, result.quantities
    assert found["delay"].value == pytest.approx(steering.delay, abs=0.01)
    assert found["lag"].value == pytest.approx(steering.lag, abs=0.015)
    names = set(RULES) - {"max_rate"}
    assert all(found[name].is_identified for name in names)


def test_intervals_contain_the_true_values_of_most_quantities() -> None:
    car, result = known("ordinary", 41), identified("ordinary", 41)
    c, s = car.vehicle.chassis, car.vehicle.steering
    true = {
        "delay": s.delay,
        "lag": s.lag,
        "ratio": car.ratio,
        "offset": car.offset,
        "understeer_gradient": c.understeer_gradient,
        "front_cornering_stiffness": c.front_cornering_stiffness,
        "rear_cornering_stiffness": c.rear_cornering_stiffness,
        "yaw_inertia": c.yaw_inertia,
        "measured_point": car.x_P,
    }
    inside = [
        result.quantities[name].interval[0] <= value <= result.quantities[name].interval[1]
        for name, value in true.items()
    ]
    assert sum(inside) >= len(true) - 1


def test_without_measured_steering_the_sum_of_delay_and_lag_is_identified() -> None:
    car = known("paper", 42)
    drive = first_part(recorded("paper", 42), 30.0)
    result = identify(without_steering(drive), start_of(car))
    check_targets(car, result)
    steering, found = car.vehicle.steering, result.quantities
    total = steering.delay + steering.lag
    assert found["total_latency"].value == pytest.approx(total, abs=0.02)
    assert "part of the delay" in found["latency"].reason


def test_stamps_may_jump_and_those_of_the_steering_may_differ_from_the_odometry() -> None:
    car, drive = known("ordinary", 41), first_part(recorded("ordinary", 41), 30.0)
    jump = drive.time[0] + 15.0

    def late(time: Array) -> Array:
        return np.where(time > jump, time + 1000.0, time)

    time = drive.steering_time[1:-5:3] + 0.007
    shifted = drive._replace(
        time=late(drive.time),
        command_time=late(drive.command_time),
        steering_time=late(time),
        steering=np.interp(time, drive.steering_time, drive.steering),
    )
    result = identify(shifted, start_of(car))
    steering, found = car.vehicle.steering, result.quantities
    assert found["offset"].value == pytest.approx(car.offset, abs=math.radians(0.1))
    assert found["delay"].value == pytest.approx(steering.delay, abs=0.01)
    assert found["lag"].value == pytest.approx(steering.lag, abs=0.015)


def test_a_steering_without_delay_and_lag_is_found_to_have_none() -> None:
    car = known("ordinary", 43, 0.0)
    result = identify(first_part(recorded("ordinary", 43, 0.0), 25.0), start_of(car))
    for name, most in (("delay", 0.01), ("lag", 0.015)):
        assert result.quantities[name].value <= most
        assert result.quantities[name].interval[0] >= 0.0


def straight(seconds: float = 12.0) -> RecordedDrive:
    """Return a noisy drive straight ahead with a steering that hardly moves."""
    rng, t = np.random.default_rng(5), np.arange(0.0, seconds, 0.02)
    zero, noise = np.zeros(len(t)), rng.standard_normal((4, len(t)))
    command = 1e-3 * np.sin(0.5 * t)
    yaw_rate = 0.0087 * noise[1]
    states = np.column_stack((t, 15 * t, zero, zero, 15 + zero, 0.1 * noise[2], yaw_rate))
    steering = np.column_stack((t, command + 1e-3 * noise[3]))
    return recording_of(states, np.column_stack((t, command)), steering, np.array([]))


def test_a_straight_drive_says_nothing_about_tyres_and_says_so() -> None:
    result = identify(straight(), Start(CHASSIS))
    for name in ("understeer_gradient", "rear_cornering_stiffness", "yaw_inertia"):
        quantity = result.quantities[name]
        assert not quantity.is_identified
        assert "lateral acceleration" in quantity.reason
        assert "start.py --manoeuvre identification" in quantity.help
    assert not result.quantities["delay"].is_identified
    assert not result.quantities["measured_point"].is_identified
    assert result.chassis == CHASSIS


def test_the_noise_of_the_odometry_is_reported() -> None:
    noise = identified("ordinary", 41).noise
    assert noise.position_noise == pytest.approx(0.05, rel=0.1)
    assert noise.heading_noise == pytest.approx(math.radians(0.5), rel=0.1)
    assert noise.yaw_rate_noise == pytest.approx(math.radians(0.5), rel=0.1)
    assert noise.lateral_velocity_noise == pytest.approx(0.1, rel=0.1)


def test_a_constant_lateral_velocity_is_no_measurement_of_tyres() -> None:
    drive = straight()
    result = identify(drive._replace(v_y=0.0 * drive.v_y), Start(CHASSIS))
    for name in ("measured_point", "rear_cornering_stiffness"):
        assert "lateral velocity" in result.quantities[name].reason
        assert "GNSS/INS" in result.quantities[name].help


def test_unusable_parts_of_a_drive_are_left_out_by_reason() -> None:
    drive = straight(60.0)
    t, v_x, yaw_rate = drive.time, drive.v_x.copy(), drive.yaw_rate.copy()
    v_x[(t > 10) & (t < 15)] = 0.0
    v_x[(t > 15) & (t < 18)] = -2.0
    yaw_rate[(t > 30) & (t < 35)] = 0.5
    silent = (drive.command_time > 45) & (drive.command_time < 50)
    drive = drive._replace(
        v_x=v_x,
        yaw_rate=yaw_rate,
        command_time=drive.command_time[~silent],
        command=drive.command[~silent],
    )
    usable, shares = usable_rows(drive, 0.9)
    for begin, end in ((10.5, 17.5), (30.5, 34.5), (46.0, 49.5)):
        assert not usable[(t > begin) & (t < end)].any()
    for begin, end in ((2.0, 8.0), (22.0, 28.0), (37.0, 44.0), (52.0, 58.0)):
        assert usable[(t > begin) & (t < end)].all()
    assert {"lateral acceleration", "no command"} <= shares.keys()


def test_a_drive_without_a_usable_part_is_refused_with_the_reason() -> None:
    drive = straight(5.0)
    with pytest.raises(ValueError, match="standstill"):
        identify(drive._replace(v_x=0.0 * drive.v_x), Start(CHASSIS))


def test_front_stiffness_follows_the_gradient_where_only_that_is_identified() -> None:
    found = dict(identified("ordinary", 41).quantities)
    gradient = found["understeer_gradient"].value
    for name in ("front_cornering_stiffness", "rear_cornering_stiffness"):
        found[name] = found[name]._replace(reason="too wide")
    chassis = identified_chassis(CHASSIS, found)
    assert chassis.rear_cornering_stiffness == CHASSIS.rear_cornering_stiffness
    assert chassis.understeer_gradient == pytest.approx(gradient)


def test_the_actuator_answers_a_step_with_its_delay_and_lag() -> None:
    time, command = np.array([0.0, 1.0]), np.array([0.0, 2.0])
    grid: Array = np.arange(0.0, 3.0, 0.01, dtype=np.float64)
    angles = actuator_angles(time, command, grid, ModelActuator(0.123, 0.2, math.inf, 0.5, 0.01))
    expected = 0.01 + 1.0 - np.exp(-np.maximum(grid - 1.123, 0.0) / 0.2)
    assert angles == pytest.approx(expected, abs=0.02)
    limited = actuator_angles(time, command, grid, ModelActuator(0.0, 0.0, 0.5, 0.5, 0.0))
    assert np.diff(limited).max() == pytest.approx(0.005)


@pytest.mark.parametrize("v", [4.0, 12.0, 25.0])
def test_at_small_angles_the_model_drives_the_steady_circle_of_the_linear_car(v: float) -> None:
    delta, n = 1e-3, 600
    flat = np.full(n, v)
    start = Start(CHASSIS, front_drive=0.0, rolling=0.0)
    car = car_parameters(np.zeros(14), start)
    motion = car_motion(np.full(n, delta), flat, 0.0 * flat, np.full(n, np.nan), 0.01, car)
    expected = v * delta / (CHASSIS.wheelbase + CHASSIS.understeer_gradient * v**2)
    assert motion[-1, 1] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
    ("wheelbase", "max_angle"), [(0.25, 0.4), (1.2, 0.5), (2.9, 0.6), (6, 0.7)]
)
def test_the_manoeuvre_stays_within_its_area_acceleration_and_time(
    wheelbase: float, max_angle: float
) -> None:
    rows = identification_points(wheelbase, max_angle)
    points, speed = rows[:, :2], rows[:, 2]
    steps = np.hypot(*np.diff(points, axis=0).T)
    assert np.ptp(points, axis=0).max() < 75.0
    assert 55.0 < np.sum(2 * steps / (speed[1:] + speed[:-1])) < 65.0
    path = make_path(points)
    at = np.linspace(0.0, 1.0, len(path.x))
    driven = np.interp(at, np.linspace(0.0, 1.0, len(speed)), speed)
    assert np.abs(driven**2 * path.curvature).max() < 2.8
    assert np.abs(np.arctan(wheelbase * path.curvature)).max() < 0.9 * max_angle
    assert not path.closed


def test_badly_known_cars_of_all_sizes_drive_the_manoeuvre_below_3_m_s2() -> None:
    for name, seed in (("bus", 44), ("model_car", 44), ("ordinary", 41)):
        drive = driven(name, seed)
        assert drive.lateral_acceleration < 3.0
        assert max(drive.area) < 80.0


def test_odometry_without_noise_gives_no_false_certainty() -> None:
    car = known("paper", 45)
    drive = drive_manoeuvre(car, np.random.default_rng(45), noise=MeasurementNoise())
    result = identify(first_part(drive.recording, 40.0), start_of(car))
    check_targets(car, result)
    assert vehicle_of("paper").chassis.mass == result.chassis.mass


def test_lateral_load_transfer_makes_the_stiffly_rolling_axle_softer() -> None:
    """A car whose front axle carries the roll understeers more, by the formula of Pacejka."""
    v, n = 9.5, 600
    flat, delta = np.full(n, v), np.full(n, 0.08)

    def yaw_rate(share: float, height: float) -> float:
        start = Start(CHASSIS, front_drive=0.0, rolling=0.0, height=height, front_roll_share=share)
        theta = np.zeros(14)
        theta[13] = -0.5  # Ackermann steering: equal slip angles
        car = car_parameters(theta, start)
        return float(car_motion(delta, flat, 0.0 * flat, np.full(n, np.nan), 0.01, car)[-1, 1])

    flat_car = yaw_rate(0.5, 0.0)
    assert yaw_rate(1.0, 0.55) < flat_car < yaw_rate(0.0, 0.55)
    # Front axle: x = h a_y / (w g l_r / L), the sum of u 5 / (4 + u^2) over both tyres
    r = yaw_rate(1.0, 0.55)
    x = 0.55 * v * r / (0.75 * 9.81 * CHASSIS.cg_to_rear_axle / CHASSIS.wheelbase)
    softer = sum(5 * u / (4 + u * u) for u in (1 - x, 1 + x)) / 2
    m, L = CHASSIS.mass, CHASSIS.wheelbase
    C_f, C_r = CHASSIS.front_cornering_stiffness * softer, CHASSIS.rear_cornering_stiffness
    K = m / L * (CHASSIS.cg_to_rear_axle / (2 * C_f) - CHASSIS.cg_to_front_axle / (2 * C_r))
    assert r / flat_car == pytest.approx(
        (L + CHASSIS.understeer_gradient * v**2) / (L + K * v**2), rel=2e-3
    )
