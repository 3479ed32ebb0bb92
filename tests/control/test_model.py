"""The bicycle model against the equations that it is the linearisation of, and against SciPy."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import MIN_SPEED, ChassisParameters
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.mpc.model import DELTA, STATES
from tests.filled import augment, exponential_integrals, lateral_dynamics, zero_order_hold

PAPER = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
ORDINARY = load_section(ChassisParameters, find("vehicles", "ordinary"), "chassis")
both_cars = pytest.mark.parametrize("chassis", [PAPER, ORDINARY], ids=["paper", "ordinary"])
many = settings(max_examples=100, deadline=None, derandomize=True)


def nonlinear_bicycle(chassis: ChassisParameters, v_x: float, x: Array, delta: float) -> Array:
    """Return the rates of [v_y, yaw, yaw rate, Y] by Eqs. (1)-(5), nothing linearised."""
    m, I_z, l_f, l_r, C_f, C_r = astuple(chassis)
    v_y, yaw, r, _ = x
    F_f = C_f * (delta - math.atan((v_y + l_f * r) / v_x))  # per tyre, Eqs. (2)-(4)
    F_r = C_r * (0.0 - math.atan((v_y - l_r * r) / v_x))
    return np.array(
        [
            2 * (F_f + F_r) / m - v_x * r,  # Eq. (1)
            r,
            2 * (l_f * F_f - l_r * F_r) / I_z,
            v_x * math.sin(yaw) + v_y * math.cos(yaw),  # Eq. (5)
        ]
    )


def numerical_jacobian(chassis: ChassisParameters, v_x: float) -> Array:
    """Return d rates / d (state, angle) about straight driving by central differences, (4, 5)."""
    h = 1e-4
    columns = []
    for step in h * np.eye(5):
        ahead = nonlinear_bicycle(chassis, v_x, step[:4], step[4])
        columns.append((ahead - nonlinear_bicycle(chassis, v_x, -step[:4], -step[4])) / (2 * h))
    return np.column_stack(columns)


@both_cars
@pytest.mark.parametrize("v_x", [1.0, 9.0, 40.0])
def test_model_is_the_jacobian_of_the_nonlinear_bicycle(
    chassis: ChassisParameters, v_x: float
) -> None:
    A, B = lateral_dynamics(astuple(chassis), v_x)
    expected = numerical_jacobian(chassis, v_x)
    np.testing.assert_allclose(np.column_stack((A, B)), expected, rtol=1e-7, atol=1e-6)


@both_cars
def test_model_below_one_metre_per_second_is_that_of_one_metre_per_second(
    chassis: ChassisParameters,
) -> None:
    held = lateral_dynamics(astuple(chassis), MIN_SPEED)
    for v_x in (-2.0, 0.0, 0.999):
        slow = lateral_dynamics(astuple(chassis), v_x)
        for one, other in zip(slow, held, strict=True):
            np.testing.assert_array_equal(one, other)


@many
@given(
    n=st.integers(1, 3),
    size=st.floats(1e-6, 30.0),
    T=st.floats(1e-3, 1.0),
    seed=st.integers(0, 2**32 - 1),
)
def test_exponential_and_its_integrals_are_those_of_van_loan_s_block_matrix(
    n: int, size: float, T: float, seed: int
) -> None:
    D = size / (n * T) * np.random.default_rng(seed).standard_normal((n, n))
    block = np.zeros((4 * n, 4 * n))
    block[:n, :n] = D
    for k in range(3):  # the exponential's first row of blocks: e^(D T) and its integrals
        block[k * n : (k + 1) * n, (k + 1) * n : (k + 2) * n] = np.eye(n)
    expected = expm(block * T)[:n]
    for k, Phi in enumerate(exponential_integrals(D, T)):
        exact = expected[:, k * n : (k + 1) * n]
        assert np.abs(Phi - exact).max() <= 1e-11 * np.abs(exact).max()


def block_matrix(chassis: ChassisParameters, v_x: float, lag: float) -> Array:
    """Return [[A, B], [0, 0]] (6, 6) of Eq. (7) with a steering that lags."""
    block = np.zeros((STATES + 1, STATES + 1))
    block[:4, :4], B_c = lateral_dynamics(astuple(chassis), v_x)
    block[:4, DELTA if lag > 0.0 else STATES] = B_c
    if lag > 0.0:
        block[DELTA, DELTA], block[DELTA, STATES] = -1.0 / lag, 1.0 / lag
    return block


@both_cars
@pytest.mark.parametrize(
    ("v_x", "lag", "T"),
    [(0.0, 0.0, 0.1), (1.7, 0.001, 1.0), (9.0, 0.1, 0.001), (60.0, 1.0, 0.05)],
    ids=["standstill without lag", "stiff lag", "small step", "fast"],
)
def test_zero_order_hold_is_the_exponential_of_the_block_matrix(
    chassis: ChassisParameters, v_x: float, lag: float, T: float
) -> None:
    n = STATES if lag else STATES - 1  # without a lag the angle is no state
    expected = expm(block_matrix(chassis, v_x, lag) * T)
    A, B = zero_order_hold(astuple(chassis), v_x, T, lag)
    np.testing.assert_allclose(A[:n, :n], expected[:n, :n], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(B[:n], expected[:n, STATES], rtol=1e-10, atol=1e-12)


@many
@given(v_x=st.floats(0.0, 60.0), lag=st.floats(1e-3, 1.0), T=st.floats(1e-3, 1.0))
def test_a_lag_is_exact_at_any_speed_and_step(v_x: float, lag: float, T: float) -> None:
    expected = expm(block_matrix(ORDINARY, v_x, lag) * T)
    A, B = zero_order_hold(astuple(ORDINARY), v_x, T, lag)
    np.testing.assert_allclose(A, expected[:STATES, :STATES], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(B, expected[:STATES, STATES], rtol=1e-9, atol=1e-12)


def test_forward_euler_would_be_unstable_below_4_6_metres_per_second() -> None:
    def largest_eigenvalue(v_x: float, exact: bool) -> float:
        A_c, _ = lateral_dynamics(astuple(PAPER), v_x)
        held, _ = zero_order_hold(astuple(PAPER), v_x, 0.1)
        A_k = held if exact else np.eye(4) + 0.1 * A_c
        lateral = A_k[np.ix_([0, 2], [0, 2])]  # yaw and Y integrate in any case
        return float(np.abs(np.linalg.eigvals(lateral)).max())

    assert largest_eigenvalue(4.5, exact=False) > 1.0 > largest_eigenvalue(4.7, exact=False)
    assert all(largest_eigenvalue(v_x, exact=True) < 1.0 for v_x in (0.0, 1.0, 4.5, 27.0))


@both_cars
def test_augmented_model_is_the_printed_block_matrix(chassis: ChassisParameters) -> None:
    held = zero_order_hold(astuple(chassis), 9.0, 0.1)
    A_k, B = held[0][:4, :4], held[1][:4]
    C = np.array([[0.0, 0.0, 0.0, 1.0]])
    A_augmented, B_augmented = augment(*held)
    np.testing.assert_array_equal(A_augmented, np.block([[A_k, np.zeros((4, 1))], [C @ A_k, 1.0]]))
    np.testing.assert_array_equal(B_augmented, np.concatenate((B, C @ B)))


@many
@given(v_x=st.floats(0.0, 40.0), seed=st.integers(0, 2**32 - 1))
def test_augmented_model_follows_the_plain_one_for_any_steering(v_x: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    held = zero_order_hold(astuple(PAPER), v_x, 0.1)
    A, B = held[0][:4, :4], held[1][:4]
    A_augmented, B_augmented = augment(*held)
    u_before, x_before = rng.normal(0, 0.1), rng.normal(0, 1, 4)
    x = A @ x_before + B * u_before
    augmented = np.append(x - x_before, x[3])
    for Delta_u in rng.normal(0, 0.05, 20):
        u_before += Delta_u
        x, x_before = A @ x + B * u_before, x
        augmented = A_augmented @ augmented + B_augmented * Delta_u
        np.testing.assert_allclose(augmented, np.append(x - x_before, x[3]), rtol=1e-9, atol=1e-9)
