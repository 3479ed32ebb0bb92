"""The quadratic program of Eq. (17), and its transformation to a nearest-point problem."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.small_matrices import Scratch, cholesky, dot, forward, matrix, vector

SOLVED, INFEASIBLE, UNFINISHED, NOT_CONVEX = 0, 1, 2, 3
"""Status of a solution."""


class Qp(NamedTuple):
    """Minimise 1/2 x' E x + x' K subject to low <= M x <= high, Eq. (17) with two-sided rows."""

    E: Array
    """(n, n), symmetric and positive definite."""
    K: Array
    """(n,)."""
    M: Array
    """(m, n)."""
    low: Array
    """(m,), may be -inf."""
    high: Array
    """(m,), may be inf."""


class NearestPoint(NamedTuple):
    """The QP in w = C' x with E = C C': find the point of a polyhedron nearest to `start`."""

    C: Array
    """(n, n), lower triangular."""
    start: Array
    """Unconstrained minimum -C^-1 K (n,)."""
    scale: float
    """Length of `start`: order of magnitude of the numbers in the problem."""
    status: int
    """SOLVED, NOT_CONVEX, INFEASIBLE if low > high, or UNFINISHED if numbers are not finite."""


@inlined
def nearest_point(qp: Qp, scratch: Scratch) -> NearestPoint:
    """Transform a QP to a nearest-point problem."""
    n = len(qp.K)
    C, start = matrix(scratch, n, n), vector(scratch, n)
    if not cholesky(qp.E, C):
        for j in range(n):
            C[j, j] = 1.0
        return NearestPoint(C, start, 0.0, NOT_CONVEX)
    forward(C, qp.K, n, start)
    for j in range(n):
        start[j] = -start[j]
    scale = math.sqrt(dot(start, start))
    status = SOLVED if scale < math.inf else UNFINISHED
    for i in range(len(qp.low)):
        if qp.low[i] > qp.high[i]:
            status = INFEASIBLE
    return NearestPoint(C, start, scale, status)


@in_place
def unit_row(C: Array, row: Array, side: float, unit: Array) -> float:
    """Fill the unit row that acts on w = C' x as side * row (n,) on x; return its former length."""
    forward(C, row, len(row), unit)
    length = math.sqrt(dot(unit, unit))
    if not length > 0.0:
        return 1.0
    for j in range(len(unit)):
        unit[j] *= side / length
    return length
