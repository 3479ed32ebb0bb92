"""Prediction against simulation, and against the matrices of Eq. (10) as they are printed."""

from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from tests.filled import augment, laguerre_sequence, predict, quadratic_cost, zero_order_hold

CHASSIS = astuple(load_section(ChassisParameters, find("vehicles", "paper"), "chassis"))
C = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=50, deadline=None, derandomize=True)


def augmented_model(v_x: float) -> tuple[Array, Array]:
    """Return the model of Eq. (9) at a speed, for T = 0.1 s."""
    return augment(*zero_order_hold(CHASSIS, v_x, 0.1))


def printed_prediction(A: Array, B: Array, N_p: int, N_c: int) -> tuple[Array, Array]:
    """Return F and Phi entry by entry as Eq. (10) prints them."""
    power = [np.linalg.matrix_power(A, i) for i in range(N_p + 1)]
    F = np.array([C @ power[i + 1] for i in range(N_p)])
    Phi = [[C @ power[i - j] @ B if i >= j else 0.0 for j in range(N_c)] for i in range(N_p)]
    return F, np.array(Phi)


@many
@given(
    v_x=st.floats(0.0, 40.0),
    N_p=st.integers(1, 60),
    N_c=st.integers(1, 20),
    N=st.integers(1, 8),
    alpha=st.floats(0.0, 0.95),
    seed=seeds,
)
def test_prediction_is_what_the_augmented_model_does_step_by_step(
    v_x: float, N_p: int, N_c: int, N: int, alpha: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    A, B = augmented_model(v_x)
    L = laguerre_sequence(alpha, N, N_c)
    x_0, eta = rng.normal(0, 1, 5), rng.normal(0, 0.1, N)
    free, Phi = predict(A, B, L, x_0, N_p)
    x, outputs = x_0, []
    for i in range(N_p):
        Delta_u = L[i] @ eta if i < N_c else 0.0
        x = A @ x + B * Delta_u
        outputs.append(C @ x)
    np.testing.assert_allclose(free + Phi @ eta, outputs, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("N_p", "N_c"), [(45, 15), (10, 10), (3, 1)])
@pytest.mark.parametrize("v_x", [1.0, 9.0, 27.0])
def test_pole_zero_gives_the_classic_prediction_as_printed(v_x: float, N_p: int, N_c: int) -> None:
    A, B = augmented_model(v_x)
    L = laguerre_sequence(0.0, N_c, N_c)
    F = np.column_stack([predict(A, B, L, unit, N_p)[0] for unit in np.eye(5)])
    _, Phi = predict(A, B, L, np.zeros(5), N_p)
    F_printed, Phi_printed = printed_prediction(A, B, N_p, N_c)
    np.testing.assert_allclose(F, F_printed, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(Phi, Phi_printed, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("v_x", [3.0, 9.0, 27.0])
def test_pole_zero_gives_the_moves_of_the_classic_controller(v_x: float) -> None:
    N_p, N_c, Q, R = 45, 15, 10.0, 10.0  # well conditioned, so that all digits count
    A, B = augmented_model(v_x)
    x = np.array([0.02, 0.01, -0.03, 0.1, 0.8])
    F, Phi = printed_prediction(A, B, N_p, N_c)
    R_s = np.full(N_p, 3.5)
    classic = np.linalg.solve(Phi.T @ Phi * Q + R * np.eye(N_c), Phi.T @ (R_s - F @ x) * Q)
    L = laguerre_sequence(0.0, N_c, N_c)
    free, Phi_own = predict(A, B, L, x, N_p)
    E, K = quadratic_cost(Phi_own, R_s - free, L, Q, R)
    np.testing.assert_allclose(L @ np.linalg.solve(E, -K), classic, rtol=1e-8, atol=1e-9)


@many
@given(
    N=st.integers(1, 5),
    alpha=st.floats(0.0, 0.9),
    Q=st.floats(0.1, 100.0),
    R=st.floats(1e-3, 100.0),
    seed=seeds,
)
def test_quadratic_form_is_the_cost_of_errors_and_increments_up_to_a_constant(
    N: int, alpha: float, Q: float, R: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    L = laguerre_sequence(alpha, N, 15)
    _, Phi = predict(*augmented_model(9.0), L, np.zeros(5), 45)
    error, eta = rng.normal(0, 1, 45), rng.normal(0, 0.1, N)
    E, K = quadratic_cost(Phi, error, L, Q, R)

    def cost(eta: Array) -> float:
        """J of Eq. (11)."""
        return float(Q * np.sum((error - Phi @ eta) ** 2) + R * np.sum((L @ eta) ** 2))

    form = 0.5 * eta @ E @ eta + K @ eta
    assert form == pytest.approx(cost(eta) - cost(np.zeros(N)), rel=1e-9, abs=1e-9 * Q * 45)


@many
@given(scale=st.floats(1e-6, 1e6))
def test_only_the_ratio_of_the_weights_matters(scale: float) -> None:
    L = laguerre_sequence(0.75, 5, 15)
    _, Phi = predict(*augmented_model(9.0), L, np.zeros(5), 45)
    error = np.linspace(1.0, 3.0, 45, dtype=np.float64)
    E, K = quadratic_cost(Phi, error, L, 10.0, 0.01)
    E_scaled, K_scaled = quadratic_cost(Phi, error, L, 10.0 * scale, 0.01 * scale)
    np.testing.assert_allclose(
        np.linalg.solve(E_scaled, K_scaled), np.linalg.solve(E, K), rtol=1e-6
    )
