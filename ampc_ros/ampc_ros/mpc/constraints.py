"""Bounds on increment, angle and output as rows of low <= M eta <= high, Eqs. (13)-(16)."""

import math

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import Qp

FIRST_OUTPUT_STEP = 5
"""First step whose output is bounded [ticks].

The output cannot react earlier, so earlier rows could not be influenced."""


@in_place
def running_sum(L: Array, S: Array) -> None:
    """Fill S (N_c, N): row i is L(0) + .. + L(i), so that S(i) eta is the change of the angle."""
    for j in range(L.shape[1]):
        total = 0.0
        for i in range(len(L)):
            total += L[i, j]
            S[i, j] = total


@in_place
def output_steps(N_p: int, N_c: int, half_width: float) -> int:
    """Return the number of bounded output steps: the fifth to N_c, or 0 without a bound."""
    if not math.isfinite(half_width):
        return 0
    return max(min(N_c, N_p) - (FIRST_OUTPUT_STEP - 1), 0)


@in_place
def row_count(N_c: int, bounded_outputs: int) -> int:
    """Return the number of rows: increments, angles, two per bounded output, one for the slack."""
    return 2 * N_c + (2 * bounded_outputs + 1 if bounded_outputs > 0 else 0)


@in_place
def input_rows(qp: Qp, L: Array, S: Array, u: float, bounds: tuple[float, float]) -> None:
    """Fill the bounds of increment and angle over the control horizon, Eqs. (13), (14): 2 N_c rows.

    Args:
        qp: Its first rows are filled.
        L: Laguerre functions (N_c, N).
        S: Their running sum (N_c, N).
        u: Angle in force, u(k - 1); it is clipped to its bound so that the rows are feasible [rad].
        bounds: Bounds of the increment per tick and of the angle [rad].
    """
    Delta_u_max, u_max = bounds
    held = min(max(u, -u_max), u_max)
    for i in range(len(L)):
        for j in range(L.shape[1]):
            qp.M[2 * i, j], qp.M[2 * i + 1, j] = L[i, j], S[i, j]
        qp.low[2 * i], qp.high[2 * i] = -Delta_u_max, Delta_u_max
        qp.low[2 * i + 1], qp.high[2 * i + 1] = -u_max - held, u_max - held


@in_place
def output_rows(qp: Qp, first: int, Phi: Array, error: Array, half_width: float) -> None:
    """Fill |y - r| <= half_width + slack, Eq. (15), from the fifth step on, and slack >= 0.

    Args:
        qp: Its rows from `first` to the end are filled; the slack is its last unknown.
        first: Number of preceding rows.
        Phi: Forced response, transposed (N, N_p).
        error: R_s - F x (N_p,) [m].
        half_width: Half width of the lane about the reference [m].
    """
    last, N = len(qp.low) - 1, len(Phi)
    for at in range(first, last, 2):
        step = FIRST_OUTPUT_STEP - 1 + (at - first) // 2
        for j in range(N):
            qp.M[at, j] = qp.M[at + 1, j] = Phi[j, step]
        qp.M[at, N], qp.M[at + 1, N] = -1.0, 1.0
        qp.low[at], qp.high[at] = -math.inf, error[step] + half_width
        qp.low[at + 1], qp.high[at + 1] = error[step] - half_width, math.inf
    qp.M[last, N] = 1.0
    qp.low[last], qp.high[last] = 0.0, math.inf
