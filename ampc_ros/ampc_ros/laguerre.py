"""Discrete Laguerre functions, Eqs. (18)-(24)."""

import math

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.small_matrices import apply, put

Array = NDArray[np.float64]


@compiled
def network(alpha: float, N: int) -> tuple[Array, Array]:
    """A_l (N, N) and L(0) (N,) of Eq. (23).

    Args:
        alpha: Pole (scale factor), 0 <= alpha < 1.
        N: Number of terms.
    """
    beta = 1 - alpha**2
    A_l = np.zeros((N, N))
    L_0 = np.empty(N)
    for i in range(N):
        L_0[i] = math.sqrt(beta) * (-alpha) ** i
        A_l[i, i] = alpha
        for j in range(i):
            A_l[i, j] = beta * (-alpha) ** (i - j - 1)
    return A_l, L_0


@compiled
def laguerre_sequence(alpha: float, N: int, steps: int) -> Array:
    """L(0)' .. L(steps - 1)' as rows, (steps, N): Delta u(k + i) = row i times eta, Eq. (24).

    Note:
        Eq. (24) prints i = 1 .. N_c. The move applied now is L(0)' eta, so i = 0 .. N_c - 1.
    """
    A_l, L_i = network(alpha, N)
    L = np.empty((steps, N))
    for i in range(steps):
        put(L[i], L_i)
        L_i = apply(A_l, L_i)
    return L
