"""The right first move of a programme, with a bound of its error."""

import math

import daqp
import numpy as np
from scipy.optimize import nnls

from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import Qp

TIGHT = {"primal_tol": 1e-12, "dual_tol": 1e-13}
ON_BOUND = 1e-9
"""A row nearer to its bound than this share of the bound's size counts as active."""
WRONG = 1e-3
"""Error of the first move that counts as a wrong answer [rad]."""
LARGEST_DOUBT = 1e-4
"""Of a reference [rad]: a tenth of what counts as a wrong answer."""


def exact_move(qp: Qp, L_0: Array) -> tuple[float, float, int]:
    """Solve with DAQP at tight tolerances, and check the answer by its optimality conditions.

    Returns:
        First move L(0)' x [rad], the bound of its error [rad], the number of active rows.

    Raises:
        ArithmeticError: The answer cannot be trusted.
    """
    x, _, flag, _ = daqp.solve(qp.E, qp.K, qp.M, qp.high, qp.low, **TIGHT)
    doubt, active = certificate(qp, x, L_0) if flag > 0 else (math.inf, 0)
    if not doubt < LARGEST_DOUBT:
        raise ArithmeticError(f"reference: DAQP's flag {flag}, error up to {doubt:.1e} rad")
    return float(L_0 @ x), doubt, active


def certificate(qp: Qp, x: Array, L_0: Array) -> tuple[float, int]:
    """Bound of the error of L(0)' x [rad], and the number of active rows.

    The multipliers of the rows that x touches are the non-negative ones which leave the least of
    the gradient, r. As E is positive definite, the distance of x from the solution in the norm of
    E is at most that of E^-1 r from 0, plus the root of what the multipliers make of the distances
    to their bounds. A point outside its bounds gets no certificate.
    """
    M, gamma = one_sided(qp)
    slack = gamma - M @ x
    size = 1.0 + np.abs(gamma)
    active = slack < ON_BOUND * size
    r, gap = qp.E @ x + qp.K, 0.0
    if active.any():
        multipliers, _ = nnls(M[active].T, -r)
        r = r + M[active].T @ multipliers
        gap = float(multipliers @ np.abs(slack[active]))
    distance = math.sqrt(r @ np.linalg.solve(qp.E, r)) + math.sqrt(gap)
    bound = distance * math.sqrt(L_0 @ np.linalg.solve(qp.E, L_0))
    return (bound if (slack > -ON_BOUND * size).all() else math.inf), int(active.sum())


def one_sided(qp: Qp) -> tuple[Array, Array]:
    """Rows and bounds of M x <= gamma."""
    upper, lower = np.isfinite(qp.high), np.isfinite(qp.low)
    M = np.vstack((qp.M[upper], -qp.M[lower]))
    return np.ascontiguousarray(M), np.append(qp.high[upper], -qp.low[lower])
