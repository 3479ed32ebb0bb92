"""The preview formulation's model against independent ways to the same motion."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import (
    MIN_SPEED,
    ChassisParameters,
    ControllerSettings,
    SteeringParameters,
)
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.mpc.internal_model import (
    Actuator,
    actuator_of,
    pack_internal_model,
    unpack_internal_model,
)
from ampc_ros.mpc.model import DELTA, STATES, V_Y, YAW_RATE, BicycleParameters
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.model import (
    E_PSI,
    E_Y,
    angle_bound,
    steady_steering,
    unmodelled_accelerations,
)
from ampc_ros.preview.nominal_steering import Road
from ampc_ros.preview.qp_assembly import Past, predict_on_road
from tests.filled import laguerre_sequence, lateral_dynamics, running_sum, sampled_model

T = 0.1
FINE = 100
"""Steps of the reference simulation in one tick: delays are multiples of T / FINE."""
CHASSIS = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
VEHICLE = astuple(CHASSIS)
ORDINARY = astuple(load_section(ChassisParameters, find("vehicles", "ordinary"), "chassis"))
many = settings(max_examples=100, deadline=None, derandomize=True)


def continuous_model(vehicle: BicycleParameters, v_x: float, lag: float) -> Array:
    """[[A, B, D], [0, 0, 0]] (7, 7): Eq. (7) on the path, input u, disturbance kappa."""
    A_c, B_c = lateral_dynamics(vehicle, v_x)
    block = np.zeros((STATES + 2, STATES + 2))
    block[:4, :4], block[:4, DELTA if lag > 0.0 else STATES] = A_c, B_c
    block[E_PSI, STATES + 1] = -max(v_x, MIN_SPEED)
    if lag > 0.0:
        block[DELTA, DELTA], block[DELTA, STATES] = -1.0 / lag, 1.0 / lag
    return block


def steering(delay: float, lag: float = 0.0) -> SteeringParameters:
    """Return an actuator with this delay and lag [s]."""
    return SteeringParameters(max_angle=0.5, delay=delay, lag=lag)


def simulated_finely(inputs: Array, kappa: Array, v: float, delay: float, lag: float) -> Array:
    """Drive with held inputs (n,) that arrive late, by the exponential over T / FINE."""
    exponential = expm(continuous_model(VEHICLE, v, lag) * T / FINE)
    late, x, ticks = round(delay / T * FINE), np.zeros(STATES), []
    for k in range(len(inputs) * FINE):
        arrived = inputs[(k - late) // FINE] if k >= late else 0.0
        x = (exponential @ np.concatenate((x, [arrived, kappa[k // FINE]])))[:STATES]
        if (k + 1) % FINE == 0:
            ticks.append(x)
    return np.array(ticks)


def simulated_by_ticks(inputs: Array, kappa: Array, v: float, delay: float, lag: float) -> Array:
    """Drive with the sampled model, one step a tick."""
    actuator = actuator_of(steering(delay, lag), T)
    A, B_old, B_new, D = sampled_model(VEHICLE, v, T, actuator)
    sent = np.concatenate((np.zeros(actuator.ticks + 1), inputs))
    x, ticks = np.zeros(STATES), []
    for k in range(len(inputs)):
        x = A @ x + B_old * sent[k] + B_new * sent[k + 1] + D * kappa[k]
        ticks.append(x)
    return np.array(ticks)


@pytest.mark.parametrize("lag", [0.0, 0.1])
@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1, 0.17, 0.3])
def test_sampled_model_is_the_continuous_one_under_a_delayed_input(
    delay: float, lag: float
) -> None:
    rng = np.random.default_rng(1)
    inputs, kappa = 0.1 * rng.standard_normal(20), 0.01 * rng.standard_normal(20)
    drive = (inputs, kappa, 12.0, delay, lag)
    used = slice(0, STATES if lag else STATES - 1)
    expected = simulated_finely(*drive)[:, used]
    np.testing.assert_allclose(simulated_by_ticks(*drive)[:, used], expected, rtol=0, atol=1e-10)


@many
@given(
    vehicle=st.sampled_from([VEHICLE, ORDINARY]),
    v_x=st.floats(0.0, 60.0),
    lag=st.one_of(st.just(0.0), st.floats(1e-3, 1.0)),
    T=st.floats(1e-3, 1.0),
    share=st.one_of(st.just(0.0), st.floats(1e-6, 1.0 - 1e-6)),
)
def test_step_is_the_exponentials_of_the_block_matrix_before_and_after_the_input_changes(
    vehicle: BicycleParameters, v_x: float, lag: float, T: float, share: float
) -> None:
    block = continuous_model(vehicle, v_x, lag)
    old, new = expm(block * share * T), expm(block * (1.0 - share) * T)
    n = STATES if lag else STATES - 1  # without a lag the angle is no state
    both, late = new @ old, new[:n, :n] @ old[:n, STATES]
    expected = np.column_stack((both[:n, :n], late, new[:n, STATES], both[:n, STATES + 1]))
    A, B_old, B_new, D = sampled_model(vehicle, v_x, T, Actuator(0, share, lag))
    result = np.column_stack((A[:n, :n], B_old[:n], B_new[:n], D[:n]))
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("lag", [0.0, 0.1])
@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1, 0.17, 0.3])
def test_prediction_is_the_drive_under_the_commands_in_the_delay_and_the_plan(
    delay: float, lag: float
) -> None:
    rng, H, N = np.random.default_rng(2), 12, 3
    chassis, settings = CHASSIS, load(ControllerSettings, find("controllers", "table3"))
    model = unpack_internal_model(pack_internal_model(chassis, settings, steering(delay, lag)))
    S = running_sum(laguerre_sequence(0.3, N, 4))
    eta, nominal = 0.1 * rng.standard_normal(N), 0.1 * rng.standard_normal(H)
    kappa, disturbance = 0.01 * rng.standard_normal(H + 1), 0.01 * rng.standard_normal(STATES)
    sent = 0.1 * rng.standard_normal(model.actuator.ticks + 1)
    past = Past(0.1 * rng.standard_normal(STATES), sent, disturbance)
    road = Road(np.full(H + 1, 12.0), kappa, np.zeros(H))
    free, Phi = np.full(H, np.nan), np.full((N, H), np.nan)
    predict_on_road(model, past, road, nominal, S, free, Phi, make_scratch(1000))
    A, B_old, B_new, D = sampled_model(VEHICLE, 12.0, model.limits.T, model.actuator)
    plan = nominal + S[np.minimum(np.arange(H), len(S) - 1)] @ eta
    inputs, x, expected = np.concatenate((sent, plan)), past.x, []
    for k in range(H):
        x = A @ x + B_old * inputs[k] + B_new * inputs[k + 1] + D * kappa[k + 1] + disturbance
        expected.append(x[E_Y])
    np.testing.assert_allclose(free + eta @ Phi, expected, rtol=0, atol=1e-12)


@many
@given(
    vehicle=st.sampled_from([VEHICLE, ORDINARY]),
    v_x=st.floats(0.0, 60.0),
    T_s=st.floats(1e-2, 1.0),
    a_y=st.floats(-5.0, 5.0),
    moment=st.floats(-2.0, 2.0),
)
def test_accelerations_are_recovered_from_the_change_of_the_state(
    vehicle: BicycleParameters, v_x: float, T_s: float, a_y: float, moment: float
) -> None:
    A_c, _ = lateral_dynamics(vehicle, v_x)
    block = np.zeros((5, 5))
    block[:4, :4], block[:4, 4] = A_c, (a_y, 0.0, moment, 0.0)
    change = np.append(expm(block * T_s)[:4, 4], 0.0)
    lateral, yaw = unmodelled_accelerations(vehicle, v_x, T_s, change, make_scratch(100))
    assert (lateral, yaw) == pytest.approx((a_y, moment), abs=1e-8)


@many
@given(st.floats(0.0, 0.5))
def test_ticks_and_share_make_up_the_delay(delay: float) -> None:
    ticks, share, _ = actuator_of(steering(delay), T)
    assert 0.0 <= share < 1.0
    assert (ticks + share) * T == pytest.approx(delay, abs=1e-6)


@many
@given(st.floats(1.0, 40.0), st.floats(-0.05, 0.05))
def test_the_steady_angle_holds_the_model_on_a_bend(v: float, kappa: float) -> None:
    block = continuous_model(VEHICLE, v, 0.0)
    balance = np.array([[block[0, V_Y], block[0, YAW_RATE]], [block[2, V_Y], block[2, YAW_RATE]]])
    forced = block[[0, 2], STATES] * steady_steering(VEHICLE, v, kappa)
    v_y, r = np.linalg.solve(balance, -forced)
    assert r == pytest.approx(v * kappa, abs=1e-12)
    x = np.zeros(STATES + 2)
    x[[V_Y, E_PSI, YAW_RATE]] = v_y, -v_y / v, r
    x[[STATES, STATES + 1]] = steady_steering(VEHICLE, v, kappa), kappa
    np.testing.assert_allclose((block @ x)[:4], 0.0, atol=1e-10)


@many
@given(st.floats(1.0, 40.0), st.floats(-0.1, 0.1), st.floats(-1.0, 1.0), st.floats(-0.05, 0.05))
def test_errors_change_by_the_kinematics_of_the_path(
    v: float, e_psi: float, r: float, kappa: float
) -> None:
    x = np.zeros(STATES + 2)
    x[[V_Y, E_PSI, YAW_RATE]], x[STATES + 1] = (0.3, e_psi, r), kappa
    change = continuous_model(VEHICLE, v, 0.0) @ x
    assert change[E_PSI] == pytest.approx(r - v * kappa)
    assert change[E_Y] == pytest.approx(0.3 + v * e_psi)


def test_a_lag_that_vanishes_is_no_lag() -> None:
    exact = sampled_model(VEHICLE, 9.0, T, Actuator(0, 0.0, 0.0))
    nearly = sampled_model(VEHICLE, 9.0, T, Actuator(0, 0.0, 1e-5))
    np.testing.assert_allclose(nearly[2][:4], exact[2][:4], rtol=2e-3)


def test_the_angle_bound_follows_the_tyre_and_never_exceeds_the_stop() -> None:
    bounds = [angle_bound(VEHICLE, v, 0.5, 8.0) for v in np.linspace(0.0, 40.0, 81)]
    assert max(bounds) == 0.5
    assert np.all(np.diff(bounds) <= 0)
    assert bounds[-1] == pytest.approx(steady_steering(VEHICLE, 40.0, 8.0 / 40.0**2))
    assert math.isfinite(bounds[0])
