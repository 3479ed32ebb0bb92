"""Bounds on increment, angle and output as rows of M eta <= gamma: Eqs. (13)-(16)."""

import math

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.small_matrices import put

Array = NDArray[np.float64]

FIRST_OUTPUT_STEP = 5
"""The output cannot answer earlier: rows before this step would only fight the past [ticks]."""


@compiled
def running_sum(L: Array) -> Array:
    """Row i is L(0) + .. + L(i): the angle that the increments add up to, (N_c, N)."""
    total = np.zeros_like(L)
    for i in range(len(L)):
        for j in range(L.shape[1]):
            total[i, j] = L[i, j] + (total[i - 1, j] if i > 0 else 0.0)
    return total


@compiled
def output_steps(N_p: int, N_c: int, half_width: float) -> int:
    """Number of steps whose output is bounded: the fifth to N_c; none without a bound."""
    if not math.isfinite(half_width):
        return 0
    return max(min(N_c, N_p) - (FIRST_OUTPUT_STEP - 1), 0)


@compiled
def put_two_sided(M: Array, gamma: Array, at: int, row: Array, low: float, high: float) -> None:
    """Write low <= row x <= high into rows `at` and `at` + 1 of M x <= gamma."""
    for j in range(len(row)):
        M[at, j] = row[j]
        M[at + 1, j] = -row[j]
    gamma[at] = high
    gamma[at + 1] = -low


@compiled
def input_rows(M: Array, gamma: Array, L: Array, u: float, bounds: tuple[float, float]) -> None:
    """Fill increment and angle bounds over the control horizon, Eqs. (13), (14): 4 N_c rows.

    Args:
        M: Rows to fill from the first on, (>= 4 N_c, >= N).
        gamma: Their bounds.
        L: Laguerre functions (N_c, N).
        u: Angle in force, u(k - 1), taken inside its bound so that no row is infeasible [rad].
        bounds: Of the increment per tick and of the angle [rad].
    """
    Delta_u_max, u_max = bounds
    held = min(max(u, -u_max), u_max)
    angles = running_sum(L)
    for i in range(len(L)):
        put_two_sided(M, gamma, 4 * i, L[i], -Delta_u_max, Delta_u_max)
        put_two_sided(M, gamma, 4 * i + 2, angles[i], -u_max - held, u_max - held)


@compiled
def output_rows(M: Array, gamma: Array, Phi: Array, error: Array, half_width: float) -> None:
    """Fill |y - r| <= half_width + slack, Eq. (15): from the fifth step on, then slack >= 0.

    Args:
        M: Rows to fill, one pair a step and one for the slack, (2 k + 1, N + 1).
        gamma: Their bounds.
        Phi: Forced response (N_p, N).
        error: R_s - F x (N_p,) [m].
        half_width: Of the lane about the reference [m].
    """
    rows, N = len(gamma), Phi.shape[1]
    for k in range((rows - 1) // 2):
        step = FIRST_OUTPUT_STEP - 1 + k
        low, high = error[step] - half_width, error[step] + half_width
        put_two_sided(M, gamma, 2 * k, Phi[step], low, high)
    for i in range(rows):
        M[i, N] = -1.0


@compiled
def with_slack(E: Array, K: Array, weight: float) -> tuple[Array, Array]:
    """Cost in [eta, slack]: E (N + 1, N + 1) and K (N + 1,), with weight * slack^2 added."""
    N = len(K)
    E_slack, K_slack = np.zeros((N + 1, N + 1)), np.zeros(N + 1)
    for i in range(N):
        put(E_slack[i], E[i])
    E_slack[N, N] = 2 * weight
    put(K_slack, K)
    return E_slack, K_slack
