"""From the model to the quadratic cost: Eqs. (10)-(11)."""

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.small_matrices import apply_transposed, gram, product, put

Array = NDArray[np.float64]


@compiled
def predict(A: Array, B: Array, L: Array, N_p: int) -> tuple[Array, Array]:
    """F (N_p, n) and Phi (N_p, N) of Y = F x + Phi eta, Eq. (10) with the increments of Eq. (24).

    Args:
        A: Augmented model (n, n); its output is the last state.
        B: Augmented model (n,).
        L: Laguerre functions (N_c, N); increments after N_c are zero.
        N_p: Prediction horizon [ticks].

    Note:
        The identity for L gives F and Phi of Eq. (10) as printed.
    """
    n, N = len(A), L.shape[1]
    F, Phi = np.empty((N_p, n)), np.empty((N_p, N))
    row: Array = np.zeros(n)
    row[n - 1] = 1.0
    response: Array = np.zeros((n, N))
    for i in range(N_p):
        row = apply_transposed(A, row)
        response = product(A, response)
        if i < len(L):
            add_outer(response, B, L[i])
        put(F[i], row)
        put(Phi[i], response[n - 1])
    return F, Phi


@compiled
def add_outer(C: Array, a: Array, b: Array) -> None:
    """Add a b' to C (m, n) in place."""
    for i in range(len(a)):
        for j in range(len(b)):
            C[i, j] += a[i] * b[j]


@compiled
def quadratic_cost(Phi: Array, error: Array, L: Array, Q: float, R: float) -> tuple[Array, Array]:
    """E (N, N) and K (N,) of Eq. (17) for the cost of Eq. (11).

    Args:
        Phi: Forced response (N_p, N).
        error: R_s - F x, what the free response leaves of the reference (N_p,) [m].
        L: Laguerre functions (N_c, N).
        Q: Weight of the output error.
        R: Weight of the increments Delta u.

    Note:
        Truncation at N_c spoils the orthonormality of Eqs. (19)-(20), so the increments are
        weighted with sum L(i) L(i)', not with the identity on eta.
    """
    E, R_term, K = gram(Phi), gram(L), apply_transposed(Phi, error)
    for i in range(len(K)):
        K[i] *= -2 * Q
        for j in range(len(K)):
            E[i, j] = 2 * (Q * E[i, j] + R * R_term[i, j])
    return E, K
