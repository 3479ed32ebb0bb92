"""Bounds on increment, angle and output as rows of M eta <= gamma: Eqs. (13)-(16)."""

import math

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled

Array = NDArray[np.float64]

FIRST_OUTPUT_STEP = 5
"""The output cannot answer earlier: rows before this step would only fight the past [ticks]."""


@compiled
def two_sided(rows: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Write low <= rows x <= high as M x <= gamma, (2 k, n) and (2 k,)."""
    return np.vstack((rows, -rows)), np.concatenate((high, -low))


@compiled
def input_rows(L: Array, u: float, Delta_u_max: float, u_max: float) -> tuple[Array, Array]:
    """Increment and angle bounds over the control horizon, Eqs. (13) and (14).

    Args:
        L: Laguerre functions (N_c, N).
        u: Angle in force, u(k - 1), clipped into its bound so that no bound is infeasible [rad].
        Delta_u_max: Bound of the increment per tick [rad].
        u_max: Bound of the angle [rad].
    """
    N_c = len(L)
    angles = np.empty_like(L)
    total = np.zeros(L.shape[1])
    for i in range(N_c):
        total = total + L[i]
        angles[i] = total
    M, gamma = two_sided(L, np.full(N_c, -Delta_u_max), np.full(N_c, Delta_u_max))
    held = min(max(u, -u_max), u_max)
    M_u, gamma_u = two_sided(angles, np.full(N_c, -u_max - held), np.full(N_c, u_max - held))
    return np.vstack((M, M_u)), np.concatenate((gamma, gamma_u))


@compiled
def output_rows(Phi: Array, error: Array, N_c: int, half_width: float) -> tuple[Array, Array]:
    """Bounds |y - r| <= half_width from the fifth step to N_c, Eq. (15); none if it is infinite.

    Args:
        Phi: Forced response (N_p, N).
        error: R_s - F x (N_p,) [m].
        N_c: Last step with output rows [ticks].
        half_width: Of the lane about the reference [m].
    """
    stop = min(N_c, len(Phi)) if math.isfinite(half_width) else 0
    first = min(FIRST_OUTPUT_STEP - 1, stop)
    rows, middle = Phi[first:stop], error[first:stop]
    return two_sided(rows, middle - half_width, middle + half_width)


@compiled
def soften(
    E: Array, K: Array, hard: tuple[Array, Array], soft: tuple[Array, Array], weight: float
) -> tuple[Array, Array, Array, Array]:
    """Add one shared slack epsilon >= 0 for all soft rows: E, K, M, gamma of Eq. (17).

    Args:
        E: Hessian (N, N).
        K: Linear term (N,).
        hard: M (h, N) and gamma (h,) of the bounds that hold always.
        soft: M (s, N) and gamma (s,) of the bounds that hold up to the slack.
        weight: Of epsilon^2 in the cost.

    Returns:
        The problem in [eta, epsilon], of size N + 1; without soft rows the problem in eta alone.
    """
    (M_h, gamma_h), (M_s, gamma_s) = hard, soft
    h, s, N = len(gamma_h), len(gamma_s), len(K)
    if s == 0:
        return E, K, M_h, gamma_h
    E_slack, K_slack = np.zeros((N + 1, N + 1)), np.zeros(N + 1)
    E_slack[:N, :N], E_slack[N, N], K_slack[:N] = E, 2 * weight, K
    M = np.zeros((h + s + 1, N + 1))
    M[:h, :N], M[h : h + s, :N] = M_h, M_s
    M[h:, N] = -1.0
    return E_slack, K_slack, M, np.concatenate((gamma_h, gamma_s, np.zeros(1)))
