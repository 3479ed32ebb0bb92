"""Discrete Laguerre functions, Eqs. (18)-(24)."""

import math

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.types import Array


@in_place
def laguerre_sequence(alpha: float, L: Array) -> None:
    """Fill the rows L(0)' .. L(steps - 1)': Delta u(k + i) = L(i)' eta, Eq. (24).

    Each function is the previous one filtered by the all-pass (z^-1 - alpha) / (1 - alpha z^-1) of
    Eq. (22). This recursion is the network (23) without its matrix.

    Args:
        alpha: Pole (scale factor), 0 <= alpha < 1.
        L: Receives the functions, (steps, N).

    Note:
        Eq. (24) prints i = 1 .. N_c. The move applied now is L(0)' eta, so i = 0 .. N_c - 1.
    """
    first = math.sqrt(1.0 - alpha**2)
    for j in range(L.shape[1]):
        L[0, j] = first
        first *= -alpha
    for i in range(1, len(L)):
        L[i, 0] = alpha * L[i - 1, 0]
        for j in range(1, L.shape[1]):
            L[i, j] = alpha * L[i - 1, j] + L[i - 1, j - 1] - alpha * L[i, j - 1]
