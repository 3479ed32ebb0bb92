"""The Laguerre network against its z-transform, its printed matrix and its orthonormality."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from tests.filled import laguerre_sequence

any_network = given(alpha=st.floats(0.0, 0.95), N=st.integers(1, 8))
many = settings(max_examples=100, deadline=None, derandomize=True)


def test_five_terms_follow_the_printed_network() -> None:
    a = 0.75
    b = 1 - a**2
    A_l = np.array(
        [
            [a, 0, 0, 0, 0],
            [b, a, 0, 0, 0],
            [-a * b, b, a, 0, 0],
            [a**2 * b, -a * b, b, a, 0],
            [-(a**3) * b, a**2 * b, -a * b, b, a],
        ]
    )
    L = laguerre_sequence(a, 5, 40)
    np.testing.assert_allclose(L[0], math.sqrt(b) * np.array([1, -a, a**2, -(a**3), a**4]))
    np.testing.assert_allclose(L[1:], L[:-1] @ A_l.T, rtol=1e-12, atol=1e-15)


@many
@any_network
def test_sequence_is_the_impulse_response_of_the_z_transform(alpha: float, N: int) -> None:
    impulse = np.zeros(60)
    impulse[0] = 1.0
    term = lfilter([math.sqrt(1 - alpha**2)], [1.0, -alpha], impulse)  # Gamma_1 of Eq. (18)
    for j in range(N):
        np.testing.assert_allclose(laguerre_sequence(alpha, N, 60)[:, j], term, atol=1e-12)
        term = lfilter([-alpha, 1.0], [1.0, -alpha], term)  # Eq. (22)


@many
@any_network
def test_laguerre_functions_are_orthonormal_over_a_long_sequence(alpha: float, N: int) -> None:
    L = laguerre_sequence(alpha, N, 4000)
    np.testing.assert_allclose(L.T @ L, np.eye(N), atol=1e-11)


def test_truncation_at_the_control_horizon_destroys_orthonormality() -> None:
    L = laguerre_sequence(0.75, 5, 15)
    assert np.linalg.norm(L.T @ L - np.eye(5), 2) == pytest.approx(0.945, abs=5e-4)


@pytest.mark.parametrize("N", [1, 5, 15])
def test_pole_zero_with_as_many_terms_as_moves_gives_the_identity(N: int) -> None:
    np.testing.assert_array_equal(laguerre_sequence(0.0, N, N), np.eye(N))
