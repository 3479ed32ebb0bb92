"""First move of a linear model predictive controller without inequality constraints.

The solution is linear in the state, in the curvature ahead and in the reference of the input, so
its gains are computed once for each speed. Condensed form as in Maciejowski, "Predictive Control
with Constraints", 2002, ch. 3.
"""

from typing import NamedTuple

import numpy as np

from ampc_msgs_config.types import Array


class Model(NamedTuple):
    """x(k+1) = A x(k) + B u(k) + E kappa(k)."""

    A: Array
    """(n, n)."""
    B: Array
    """(n,)."""
    E: Array
    """(n,)."""


class Differences(NamedTuple):
    """Cost of differences of the input: weight |now @ u + before @ (u(-1), u(-2))|^2."""

    weight: float
    now: Array
    """(m, N)."""
    before: Array
    """(m, 2)."""


class Move(NamedTuple):
    """First input = state @ x + curvature @ kappa + reference @ u_ref + before @ (u(-1), u(-2))."""

    state: Array
    """(n,)."""
    curvature: Array
    """(N + 1,)."""
    reference: Array
    """(N,)."""
    before: Array
    """(2,)."""


def first_move(
    model: Model, Q: Array, steady: Array, R: float, differences: tuple[Differences, ...]
) -> Move:
    """Minimise sum |x(i) - steady kappa(i)|^2_Q(i) + R (u(i) - u_ref(i))^2 + differences.

    Args:
        model: Model of one step.
        Q: (N, n) diagonals of the weights of x(1) to x(N).
        steady: (n,) state that is aimed at on a curvature of 1.
        R: Weight of the input.
        differences: Weights of its differences.
    """
    A, B, E = model
    N, n = Q.shape
    free, forced = np.empty((N, n, n)), np.zeros((N, n, N))
    bent = np.zeros((N, n, N + 1))
    power: Array = np.eye(n)
    input_row: Array = np.zeros((n, N))
    curvature_row: Array = np.zeros((n, N + 1))
    for i in range(N):
        power = A @ power
        input_row, curvature_row = A @ input_row, A @ curvature_row
        input_row[:, i] += B
        curvature_row[:, i] += E
        free[i], forced[i], bent[i] = power, input_row, curvature_row
        bent[i, :, i + 1] -= steady
    G, Phi, Gamma = forced.reshape(N * n, N), free.reshape(N * n, n), bent.reshape(N * n, N + 1)
    weighted = G.T * Q.reshape(-1)
    H, before = weighted @ G + R * np.eye(N), np.zeros((N, 2))
    for weight, now, past in differences:
        H += weight * now.T @ now
        before += weight * now.T @ past
    row = np.asarray(np.linalg.solve(H, np.eye(N)[:, 0]), dtype=np.float64)
    return Move(-row @ weighted @ Phi, -row @ weighted @ Gamma, R * row, -row @ before)


def first_differences(N: int, step: float) -> tuple[Array, Array]:
    """Return `now` and `before` of the rates of N inputs, the first one against u(-1)."""
    now, before = np.eye(N) - np.eye(N, k=-1), np.zeros((N, 2))
    before[0, 0] = -1.0
    return now / step, before / step
