"""Prediction and quadratic cost, Eqs. (10)-(11)."""

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.types import Array
from ampc_ros.mpc.model import STATES
from ampc_ros.mpc.small_matrices import Scratch, dot, vector


@in_place
def predict(
    A: Array, B: Array, L: Array, x: Array, free: Array, Phi: Array, scratch: Scratch
) -> None:
    """Fill F x (N_p,) and Phi' of Y = F x + Phi eta, Eq. (10), with the increments of Eq. (24).

    Args:
        A: Augmented model (5, 5); its output is the last state.
        B: Augmented model (5,).
        L: Laguerre functions (N_c, N); increments after N_c are zero.
        x: Augmented state (5,).
        free: Receives F x (N_p,).
        Phi: Receives the forced response, transposed: (N, N_p), zeros before.
        scratch: Auxiliary memory.

    Note:
        The printed entries of Phi are those of the impulse response, h_i-j = C A^(i-j) B. With
        L in place of the single increments they are sums over h.
    """
    begin, N_p = scratch.used[0], len(free)
    h, state, impulse = vector(scratch, N_p), vector(scratch, STATES), vector(scratch, STATES)
    following = vector(scratch, STATES)
    for k in range(STATES):
        state[k], impulse[k] = x[k], B[k]
    for i in range(N_p):
        advance_state(A, state, following)
        free[i], h[i] = state[STATES - 1], impulse[STATES - 1]
        advance_state(A, impulse, following)
    for n in range(len(Phi)):
        response = Phi[n]
        for j in range(min(len(L), N_p)):
            share = L[j, n]
            for i in range(N_p - j):
                response[i + j] += share * h[i]
    scratch.used[0] = begin


@in_place
def advance_state(A: Array, x: Array, following: Array) -> None:
    """Replace x (5,) by A x; `following` is auxiliary."""
    for i in range(STATES):
        total = 0.0
        for k in range(STATES):
            total += A[i, k] * x[k]
        following[i] = total
    for i in range(STATES):
        x[i] = following[i]


@in_place
def quadratic_cost(
    Phi: Array, error: Array, L: Array, weights: tuple[float, float], E: Array, K: Array
) -> None:
    """Fill E and K of Eq. (17) for the cost of Eq. (11), in their first N rows and columns.

    Args:
        Phi: Forced response, transposed (N, N_p).
        error: R_s - F x, error of the free response (N_p,) [m].
        L: Laguerre functions (N_c, N).
        weights: Output weight Q, and increment weight R of Delta u.
        E: Receives the quadratic term, (>= N, >= N).
        K: Receives the linear term, (>= N,).

    Note:
        Truncation at N_c destroys the orthonormality of Eqs. (19)-(20). The increments are
        therefore weighted with sum L(i) L(i)', not with the identity on eta.
    """
    Q, R = weights
    for j in range(len(Phi)):
        K[j] = -2 * Q * dot(Phi[j], error)
        for k in range(j + 1):
            increments = 0.0
            for i in range(len(L)):
                increments += L[i, j] * L[i, k]
            E[j, k] = E[k, j] = 2 * (Q * dot(Phi[j], Phi[k]) + R * increments)
