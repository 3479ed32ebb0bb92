"""The filter of state and disturbance: its gains, and the limit cases without noise."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ASSUMED_LAG, ControllerSettings
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.gain_table import load_gain_table
from ampc_ros.mpc.internal_model import Actuator
from ampc_ros.mpc.model import STATES, BicycleParameters
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.preview.model import E_PSI, E_Y, SampledModel, sample_model
from ampc_ros.preview.state_filter import (
    BIAS,
    DISTURBANCE_GAIN,
    DISTURBANCE_NOISE,
    FULL_BIAS,
    FULL_LEVEL,
    GAINS,
    LEAST_LEVEL,
    LEAST_NOISE,
    LEAST_SHARE,
    LEVEL_SIZE,
    MEASURED,
    MODEL_NOISE,
    SPEEDS,
    Noise,
    correct,
    filter_numbers,
    filter_share,
    gains_at,
    noise_of,
    prediction_covariance,
    update_level,
)
from ampc_ros.preview.state_filter import NOISE as NOISE_PLACE
from ampc_ros.preview.tick import BEFORE, DISTURBANCE, EXPECTED, EXPECTS, LEVEL
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

PAPER = load_vehicle_file(find("vehicles", "paper"))
ORDINARY = load_vehicle_file(find("vehicles", "ordinary"))
LIMITS = load(ControllerSettings, find("controllers", "table3"))
NOISE = noise_of(LIMITS)
X1 = load(MeasurementNoise, find("noise", "x1"))
BICYCLE: BicycleParameters = tuple(vars(PAPER.chassis).values())
ACTUATOR = Actuator(0, 0.0, ASSUMED_LAG)
T = 0.1
TO_CG = PAPER.chassis.cg_to_rear_axle
STRAIGHT = make_path([(0.0, 0.0), (1000.0, 0.0)])
CASES = [(v, T) for v in SPEEDS for T in (0.02, 0.1)]


def augmented(
    vehicle: BicycleParameters, actuator: Actuator, T: float, noise: Noise, v: float
) -> tuple[Array, Array, Array]:
    """Return transition (8, 8) and covariances of state and disturbance, and of the measurement."""
    model = SampledModel(np.zeros((STATES, STATES)), *np.zeros((3, STATES)))
    sample_model(vehicle, v, T, actuator, model, make_scratch(400))
    n = MEASURED
    one: Array = np.eye(n)
    A: Array = np.block([[model.A[:n, :n], one], [0.0 * one, one]])
    state, disturbance = np.square(MODEL_NOISE) * T, np.square(DISTURBANCE_NOISE) * T**3
    Q: Array = np.diag(np.concatenate((state, disturbance)))
    R: Array = np.diag(np.square(np.maximum(noise, LEAST_NOISE)))
    return A, Q, R


def error_map(A: Array, K: Array) -> Array:
    """Return the map of the estimate's error from one measurement to the next."""
    n = len(A)
    return np.asarray((np.eye(n) - K @ np.eye(K.shape[1], n)) @ A)


@pytest.mark.parametrize(("v", "T"), CASES)
def test_covariance_is_that_of_scipy(v: float, T: float) -> None:
    A, Q, R = augmented(BICYCLE, ACTUATOR, T, NOISE, v)
    C = np.eye(MEASURED, len(A))
    expected = solve_discrete_are(A.T, C.T, Q, R)
    P = prediction_covariance(A, Q, R)
    np.testing.assert_allclose(P, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(P, P.T, rtol=1e-9, atol=1e-12)


@st.composite
def vehicles(draw: st.DrawFn) -> BicycleParameters:
    """Return a car from scale 1:10 to a truck: mass follows length, stiffness follows load."""
    L = draw(st.floats(0.25, 7.0))
    m = draw(st.floats(0.5, 2.0)) * 1500.0 * (L / 2.7) ** 3
    front = draw(st.floats(0.35, 0.65))
    l_f, l_r = (1.0 - front) * L, front * L
    I_z = draw(st.floats(0.5, 1.5)) * m * l_f * l_r
    stiff = [draw(st.floats(4.0, 25.0)) * 9.81 * m * load / 2 for load in (front, 1.0 - front)]
    return m, I_z, l_f, l_r, stiff[0], stiff[1]


@given(
    vehicles(),
    st.floats(1.0, 60.0),
    st.floats(0.005, 0.1),
    st.sampled_from([0.0, ASSUMED_LAG, 0.5]),
    st.sampled_from([0.0, 0.5]),
    st.floats(1e-3, 10.0),
)
@settings(max_examples=150, deadline=None)
def test_gains_stabilise_the_estimate_of_every_car(
    vehicle: BicycleParameters, v: float, T: float, lag: float, share: float, scale: float
) -> None:
    actuator, noise = Actuator(1, share, lag), Noise(*(scale * each for each in NOISE))
    K = gains_at(vehicle, actuator, T, noise, v)
    assert np.isfinite(K).all()
    A, _, _ = augmented(vehicle, actuator, T, noise, v)
    assert np.abs(np.linalg.eigvals(error_map(A, K))).max() < 1.0


@pytest.mark.parametrize("T", [0.005, 0.1])
def test_estimate_is_stable_between_the_speeds_of_the_gains(T: float) -> None:
    numbers = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 1.0)
    gains = numbers[GAINS:].reshape(len(SPEEDS), 2 * MEASURED, MEASURED)
    for i, (slow, fast) in enumerate(pairwise(SPEEDS)):
        for part in (0.0, 0.25, 0.5, 0.75, 1.0):
            A, _, _ = augmented(BICYCLE, ACTUATOR, T, NOISE, slow + part * (fast - slow))
            K = gains[i] + part * (gains[i + 1] - gains[i])
            assert np.abs(np.linalg.eigvals(error_map(A, K))).max() < 1.0
    A, _, _ = augmented(BICYCLE, ACTUATOR, T, NOISE, 60.0)  # beyond the last speed
    assert np.abs(np.linalg.eigvals(error_map(A, gains[-1]))).max() < 1.0


@pytest.mark.parametrize("v", [1.5, 2.0, 4.0, 7.0, 20.0, 40.0, 60.0])
def test_one_correction_is_that_of_the_equations(v: float) -> None:
    numbers, rng = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 1.0), np.random.default_rng(1)
    gains = numbers[GAINS:].reshape(len(SPEEDS), -1)
    K = np.array([np.interp(v, SPEEDS, column) for column in gains.T]).reshape(-1, MEASURED)
    x, expected, d = np.array(NOISE) * rng.standard_normal((3, MEASURED))
    innovation = x - expected - d
    estimate, learnt = expected + d + K[:MEASURED] @ innovation, d + K[MEASURED:] @ innovation
    correct(numbers, v, levels(1.0), 1.0, x, expected, d)
    np.testing.assert_allclose(x, estimate, atol=1e-12)
    np.testing.assert_allclose(d, learnt, atol=1e-12)
    np.testing.assert_allclose(expected, innovation)


def levels(noise: float, bias: float = 0.0) -> Array:
    """Return levels of noise and bias after equal innovations of zero."""
    level: Array = np.zeros(LEVEL_SIZE)
    level[NOISE_PLACE], level[BIAS] = noise, bias
    return level


def test_share_of_the_filter_grows_from_its_least_value_to_one() -> None:
    numbers = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 0.2)
    shares = [filter_share(numbers, levels(each)) for each in np.linspace(0.0, 4.0, 100)]
    assert shares[0] == numbers[LEAST_SHARE] == 0.2
    assert (np.diff(shares) >= 0.0).all()
    assert filter_share(numbers, levels(FULL_LEVEL)) == shares[-1] == 1.0
    biased = [filter_share(numbers, levels(4.0, each)) for each in np.linspace(0.0, 2.0, 50)]
    assert (np.diff(biased) <= 0.0).all()
    assert (biased[0], biased[-1]) == (1.0, 0.0)
    numbers = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 0.0)
    assert filter_share(numbers, levels(LEAST_LEVEL)) == 0.0


def test_white_noise_is_noise_and_a_constant_innovation_is_bias() -> None:
    numbers, rng = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 0.0), np.random.default_rng(5)
    white, constant = levels(0.0), levels(0.0)
    for _ in range(100):
        update_level(numbers, 1.2 * rng.normal(0.0, NOISE), T, white)
        update_level(numbers, 1.5 * np.array(NOISE), T, constant)
    assert filter_share(numbers, white) > 0.8
    assert constant[BIAS] > FULL_BIAS
    assert constant[NOISE_PLACE] < 0.01


def test_without_noise_level_the_measured_state_is_unchanged_bit_for_bit() -> None:
    numbers, rng = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 0.0), np.random.default_rng(2)
    for scale in (1e-9, 1.0, 100.0):
        x, expected, d = scale * rng.standard_normal((3, MEASURED))
        before, innovation, earlier = x.copy(), x - (expected + d), d.copy()
        correct(numbers, 9.0, levels(0.0), 1.0, x, expected, d)
        assert x.tobytes() == before.tobytes()
        np.testing.assert_allclose(d, earlier + np.array(DISTURBANCE_GAIN) * innovation)


def test_without_noise_of_the_pose_there_is_no_filter() -> None:
    numbers = filter_numbers(BICYCLE, ACTUATOR, T, NOISE._replace(heading=0.0, position=0.0), 1.0)
    assert numbers[LEAST_SHARE] == 0.0
    assert not numbers[GAINS:].any()
    x, expected, d = np.random.default_rng(3).standard_normal((3, MEASURED))
    before = x.copy()
    level = levels(0.0)
    correct(numbers, 9.0, level, 1.0, x, expected, d)
    update_level(numbers, expected, T, level)
    assert not level.any()
    assert x.tobytes() == before.tobytes()


def controller(lag: float = 0.0, **noise: Any) -> PreviewMpc:
    """Return the shipped controller for the paper's car; `lag` -1: not configured [s]."""
    steering = replace(PAPER.steering, lag=lag)
    limits, table = replace(LIMITS, **noise), load_gain_table("preview")
    return PreviewMpc(PAPER.chassis, steering, limits, table)


OFF = {"position_noise": 0.0, "heading_noise": 0.0}


def noise_free_states(count: int = 80) -> list[VehicleState]:
    """Return the states of a drive of sc1."""
    simulation, steers = Simulation(PAPER, load_scenario("sc1", PAPER.size)), controller()
    path, states = simulation.scenario.path, []
    for k in range(count):
        states.append(simulation.car.measure(k * NANOSECONDS // 10))
        simulation.advance(steers.step(states[-1], path).steering, 9.0, NANOSECONDS // 10)
    return states


def test_clean_measurements_are_steered_as_without_filter_bit_for_bit() -> None:
    path, on, off = load_scenario("sc1", PAPER.size).path, controller(), controller(**OFF)
    for state in noise_free_states():
        assert on.step(state, path).steering == off.step(state, path).steering
        assert (
            on.memory[DISTURBANCE:EXPECTED].tobytes() == off.memory[DISTURBANCE:EXPECTED].tobytes()
        )
    assert on.memory[LEVEL + NOISE_PLACE] < LEAST_LEVEL


@pytest.mark.parametrize("noise", [OFF, {}, dict.fromkeys((*OFF, "yaw_rate_noise"), 0.0)])
@pytest.mark.parametrize("lag", [0.0, -1.0])
def test_mirrored_measurements_are_steered_mirrored(lag: float, noise: dict[str, float]) -> None:
    left, right, rng = controller(lag, **noise), controller(lag, **noise), np.random.default_rng(5)
    for state in noise_free_states():
        y, yaw, v_y, r = rng.normal(0.0, (0.05, 0.0087, 0.1, 0.0087))
        state = state._replace(y=y, yaw=yaw, v_y=v_y, yaw_rate=r)
        mirrored = state._replace(y=-y, yaw=-yaw, v_y=-v_y, yaw_rate=-r)
        steering = left.step(state, STRAIGHT).steering
        assert right.step(mirrored, STRAIGHT).steering == pytest.approx(-steering, abs=1e-12)


@pytest.mark.parametrize(("v", "T"), [(5.0, 0.1), (9.0, 0.1), (9.0, 0.02), (25.0, 0.1)])
def test_white_noise_is_reduced_as_the_covariance_predicts(v: float, T: float) -> None:
    """Monte Carlo of the model's own equations: 500 cars at once, 60 steps."""
    A, Q, R = augmented(BICYCLE, ACTUATOR, T, NOISE, v)
    numbers = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 1.0)
    at_speed = gains_at(BICYCLE, ACTUATOR, T, NOISE, v)
    gains = numbers[GAINS:].reshape(len(SPEEDS), -1)
    interpolated = [np.interp(v, SPEEDS, column) for column in gains.T]
    n, rng = MEASURED, np.random.default_rng(6)
    P = prediction_covariance(A, Q, R)
    optimal = np.sqrt(np.diag(P - at_speed @ P[:n])[:n])
    cars, L_Q, L_R = 500, np.sqrt(np.diag(Q)), np.sqrt(np.diag(R))
    actual, estimate = np.zeros((2, cars, 2 * n))
    for _ in range(round(6.0 / T)):
        actual = actual @ A.T + L_Q * rng.standard_normal((cars, 2 * n))
        measured = actual[:, :n] + L_R * rng.standard_normal((cars, n))
        K = np.reshape(interpolated, (2 * n, n))
        predicted = estimate @ A.T
        estimate = predicted + (measured - predicted[:, :n]) @ K.T
    deviation = (estimate - actual)[:, :n].std(axis=0)
    np.testing.assert_allclose(deviation, optimal, rtol=0.15)
    assert (deviation < L_R).all()


def errors_of_straight_drive(lag: float, seed: int, **noise: Any) -> tuple[Array, Array]:
    """Return errors of estimate and measurement (n, 4) in a drive with noise `x1`, 15 m/s."""
    car = PAPER._replace(steering=replace(PAPER.steering, lag=ASSUMED_LAG if lag < 0 else lag))
    scenario = load_scenario("straight", car.size, 15.0)._replace(start_offset=0.0)
    simulation, steers = Simulation(car, scenario), controller(lag, **noise)
    rng, sigma = (
        np.random.default_rng(seed),
        (X1.lateral_velocity, X1.heading, X1.yaw_rate, X1.position),
    )
    estimated, measured = [], []
    for k in range(150):
        actual = at_distance(simulation.car.measure(k * NANOSECONDS // 10), TO_CG)
        error = rng.normal(0.0, sigma)
        state = actual._replace(
            y=actual.y + error[E_Y],
            yaw=actual.yaw + error[E_PSI],
            v_y=actual.v_y + error[0],
            yaw_rate=actual.yaw_rate + error[2],
        )
        noisy = at_distance(state, -TO_CG)
        last = steers.memory.copy()
        plan = steers.step(noisy, STRAIGHT)
        if last[EXPECTS]:
            x = np.array([state.v_y, math.sin(state.yaw), state.yaw_rate, state.y])
            numbers = steers.model_row[-len(filter_numbers(*arguments(steers, lag, **noise))) :]
            correct(
                numbers, state.v_x, last[LEVEL:BEFORE], 1.0, x, last[EXPECTED:], last[DISTURBANCE:]
            )
            estimated.append(x - (actual.v_y, math.sin(actual.yaw), actual.yaw_rate, actual.y))
            measured.append(error)
        simulation.advance(plan.steering, 15.0, NANOSECONDS // 10)
    return np.array(estimated), np.array(measured)


def arguments(
    steers: PreviewMpc, lag: float, **noise: Any
) -> tuple[BicycleParameters, Actuator, float, Noise, float]:
    """Return the arguments of `filter_numbers` for a controller."""
    level = noise_of(replace(LIMITS, **noise))
    return steers.model.vehicle, steers.model.actuator, steers.period, level, float(lag < 0)


@pytest.mark.parametrize("lag", [0.0, -1.0])
def test_estimate_of_a_driven_car_is_better_than_its_measurement(lag: float) -> None:
    estimated, measured = errors_of_straight_drive(lag, seed=7)
    ratio = estimated[30:].std(axis=0) / measured[30:].std(axis=0)
    assert (ratio < (0.8, 0.85, 1.0, 0.85)).all(), ratio


@pytest.mark.parametrize("noise_level", [0.4, 1.0, 2.9])
@pytest.mark.parametrize(("state", "jump"), [(E_Y, 0.5), (E_Y, -0.5), (E_PSI, 0.06)])
def test_a_jump_is_used_as_measured_and_is_no_disturbance(
    state: int, jump: float, noise_level: float
) -> None:
    numbers = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 0.0)
    x, expected, d = np.zeros((3, MEASURED))
    jump *= math.sqrt(max(noise_level, 1.0))  # beyond the noise there is
    x[state] = jump
    correct(numbers, 9.0, levels(noise_level), 1.0, x, expected, d)
    assert x[state] == jump
    assert np.count_nonzero(x) == 1
    assert not d.any()


@pytest.mark.parametrize("change", [0.2, -0.4, 9.0])
def test_a_yaw_rate_that_no_noise_explains_is_used_without_filter(change: float) -> None:
    numbers = filter_numbers(BICYCLE, ACTUATOR, T, NOISE, 1.0)
    x, expected, d = np.zeros((3, MEASURED))
    x[:] = 0.01, 0.005, change, 0.03
    before = x.copy()
    correct(numbers, 9.0, levels(1.0), 1.0, x, expected, d)
    assert x.tobytes() == before.tobytes()
    np.testing.assert_allclose(d, np.array(DISTURBANCE_GAIN) * before)


def test_with_a_replaced_yaw_rate_the_next_state_is_not_filtered() -> None:
    filtered, off, rng = controller(), controller(**OFF), np.random.default_rng(9)
    for k in range(60):
        y, yaw = rng.normal(0.0, (0.05, 0.0087))
        state = VehicleState(k * NANOSECONDS // 10, 0.9 * k, y, yaw, 9.0, 0.0, 0.0)
        if k >= 40:  # the same memory, but for the level of noise
            filtered.distrust_noise()
            off.memory[:] = filtered.memory
        steering = [each.step(state, STRAIGHT).steering for each in (filtered, off)]
        assert k < 40 or steering[0] == steering[1]


def test_a_controller_without_filter_that_inherits_uses_the_measured_state() -> None:
    filtered, off, rng = controller(), controller(**OFF), np.random.default_rng(10)
    for k in range(40):
        y, yaw = rng.normal(0.0, (0.05, 0.0087))
        state = VehicleState(k * NANOSECONDS // 10, 0.9 * k, y, yaw, 9.0, 0.0, 0.0)
        filtered.step(state, STRAIGHT)
    assert filtered.memory[LEVEL + NOISE_PLACE] > FULL_LEVEL
    off.inherit(filtered)
    assert off.memory[LEVEL + NOISE_PLACE] == 0.0
    assert (
        off.memory[DISTURBANCE:EXPECTED].tobytes()
        == filtered.memory[DISTURBANCE:EXPECTED].tobytes()
    )


@pytest.mark.parametrize(("position", "heading"), [(0.005, 0.001), (0.05, 0.0), (0.0, 0.0087)])
@pytest.mark.parametrize("lag", [0.0, -1.0])
def test_a_misaligned_wheel_is_learnt_with_noise_that_is_configured_too_low(
    lag: float, position: float, heading: float
) -> None:
    scenario = load_scenario("straight", ORDINARY.size, 15.0)._replace(start_offset=0.0)
    limits = replace(LIMITS, position_noise=position, heading_noise=heading)
    steering, table = replace(ORDINARY.steering, lag=lag), load_gain_table("preview")
    steers, simulation = (
        PreviewMpc(ORDINARY.chassis, steering, limits, table),
        Simulation(ORDINARY, scenario),
    )
    for k in range(150):
        plan = steers.step(simulation.car.measure(k * NANOSECONDS // 10), scenario.path)
        simulation.advance(plan.steering + math.radians(2.0), 15.0, NANOSECONDS // 10)
    assert abs(plan.diagnosis.cross_track_error) < 0.05


def after_a_new_path(lag: float, seed: int | None, **noise: Any) -> Array:
    """Return the distances from a path 0.4 m beside `STRAIGHT` in 5 s after it has come [m]."""
    scenario = load_scenario("straight", PAPER.size, 9.0)._replace(start_offset=0.0)
    rng = np.random.default_rng(seed)
    simulation = Simulation(PAPER, scenario, noise=X1 if seed else None, rng=rng)
    steers, beside, distance = controller(lag, **noise), make_path([(0.0, 0.4), (1000.0, 0.4)]), []
    for k in range(100):
        state = simulation.car.measure(k * NANOSECONDS // 10)
        before = steers.steering
        steering = steers.step(state, beside if k >= 50 else STRAIGHT).steering
        if k >= 50:
            distance.append(at_distance(state, TO_CG).y - 0.4)
        if k == 50:
            assert steering > before + 0.01  # in the first tick
        simulation.advance(steering, 9.0, NANOSECONDS // 10)
    return np.array(distance)


@pytest.mark.parametrize("lag", [0.0, -1.0])
@pytest.mark.parametrize("seed", [None, 8])
def test_a_new_path_beside_the_old_one_is_followed_without_delay(
    lag: float, seed: int | None
) -> None:
    on, off = after_a_new_path(lag, seed), after_a_new_path(lag, seed, **OFF)
    arrival = [int(np.argmax(np.abs(distance) < 0.1)) for distance in (on, off)]
    assert 0 < arrival[0] <= arrival[1] + 1
    assert on.max() <= off.max() + 0.02  # overshoot
