"""The preview formulation's model against independent ways to the same motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_ros.preview_model import (
    E_PSI,
    E_Y,
    STATES,
    V_Y,
    Actuator,
    Array,
    R,
    actuator_of,
    angle_bound,
    continuous_model,
    sampled_model,
    steady_steering,
)

T = 0.1
FINE = 100
"""Steps of the reference simulation in one tick: delays are multiples of T / FINE."""
CHASSIS = load(ChassisParameters, find("vehicles", "paper"), "chassis")
VEHICLE = tuple(vars(CHASSIS).values())


def steering(delay: float, lag: float = 0.0) -> SteeringParameters:
    """Give an actuator with this delay and lag [s]."""
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


@given(st.floats(0.0, 0.5))
def test_ticks_and_share_make_up_the_delay(delay: float) -> None:
    ticks, share, _ = actuator_of(steering(delay), T)
    assert 0.0 <= share < 1.0
    assert (ticks + share) * T == pytest.approx(delay, abs=1e-6)


@given(st.floats(1.0, 40.0), st.floats(-0.05, 0.05))
def test_the_steady_angle_holds_the_model_on_a_bend(v: float, kappa: float) -> None:
    block = continuous_model(VEHICLE, v, 0.0)
    balance = np.array([[block[0, V_Y], block[0, R]], [block[2, V_Y], block[2, R]]])
    forced = block[[0, 2], STATES] * steady_steering(VEHICLE, v, kappa)
    v_y, r = np.linalg.solve(balance, -forced)
    assert r == pytest.approx(v * kappa, abs=1e-12)
    x = np.zeros(STATES + 2)
    x[[V_Y, E_PSI, R]] = v_y, -v_y / v, r
    x[[STATES, STATES + 1]] = steady_steering(VEHICLE, v, kappa), kappa
    np.testing.assert_allclose((block @ x)[:4], 0.0, atol=1e-10)


@given(st.floats(1.0, 40.0), st.floats(-0.1, 0.1), st.floats(-1.0, 1.0), st.floats(-0.05, 0.05))
def test_errors_change_as_geometry_says(v: float, e_psi: float, r: float, kappa: float) -> None:
    x = np.zeros(STATES + 2)
    x[[V_Y, E_PSI, R]], x[STATES + 1] = (0.3, e_psi, r), kappa
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
