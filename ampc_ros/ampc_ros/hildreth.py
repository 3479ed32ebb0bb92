"""Hildreth's quadratic programming procedure, the paper's solver: Eqs. (25)-(30)."""

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.qp import (
    SOLVED,
    UNFINISHED,
    NearestPoint,
    Qp,
    QpSolution,
    most_violated,
    nearest_point,
    solution_at,
)
from ampc_ros.small_matrices import dot

Array = NDArray[np.float64]

KUHN_TUCKER = 1e-10
"""How far Eq. (30) may be missed, as a share of the size of the numbers in the problem."""


@compiled
def hildreth(qp: Qp, max_sweeps: int, tolerance: float) -> QpSolution:
    """Solve by Gauss-Seidel sweeps over the multipliers, from the unconstrained minimum.

    Args:
        qp: The programme.
        max_sweeps: Sweeps over all multipliers (the authors: 38).
        tolerance: Squared change of the multipliers in a sweep that ends the search (1e-7).

    Note:
        A small change does not prove convergence: unless the Kuhn-Tucker conditions of Eq. (30)
        hold as well, the sweeps go on, and in the end the solution is UNFINISHED.
    """
    task, status = nearest_point(qp)
    w, multipliers, sweeps = task.start.copy(), np.zeros(len(task.bounds)), 0
    finished = status != SOLVED or most_violated(task, w) < 0
    while not finished and sweeps < max_sweeps:
        change = sweep(task, multipliers, w)
        sweeps += 1
        finished = change <= tolerance and kuhn_tucker_hold(task, multipliers, w)
    if not finished:
        status = UNFINISHED
    return solution_at(task, w, multipliers, sweeps, status)


@compiled
def sweep(task: NearestPoint, multipliers: Array, w: Array) -> float:
    """Improve each multiplier once, and w with it, in place, Eq. (29); gives the squared change."""
    change = 0.0
    for i in range(len(multipliers)):
        before = multipliers[i]
        multipliers[i] = max(0.0, before + dot(task.rows[i], w) - task.bounds[i])
        step = multipliers[i] - before
        change += step * step
        for j in range(len(w)):
            w[j] -= step * task.rows[i, j]
    return change


@compiled
def kuhn_tucker_hold(task: NearestPoint, multipliers: Array, w: Array) -> bool:
    """Whether rows are kept, and those with a multiplier hold with equality, Eq. (30)."""
    for i in range(len(multipliers)):
        excess = dot(task.rows[i], w) - task.bounds[i]
        if multipliers[i] > 0.0:
            excess = abs(excess)
        if excess > KUHN_TUCKER * max(task.scale, abs(task.bounds[i])):
            return False
    return True
