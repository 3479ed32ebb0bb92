"""Hildreth's quadratic programming procedure, Eqs. (25)-(30): the solver of the paper.

A library (DAQP) is not used because the solver must run inside compiled code without Python's
global lock, and because the paper uses this procedure.
"""

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import SOLVED, UNFINISHED, NearestPoint, Qp, nearest_point, unit_row
from ampc_ros.mpc.small_matrices import Scratch, backward, dot, matrix, vector

KUHN_TUCKER = 1e-10
"""Tolerance of Eq. (30), relative to the order of magnitude of the numbers in the problem."""


@in_place
def hildreth(
    qp: Qp, sweeps: tuple[int, float], x: Array, multipliers: Array, scratch: Scratch
) -> tuple[int, int]:
    """Solve by Gauss-Seidel sweeps over the multipliers, from the unconstrained minimum.

    Args:
        qp: The QP.
        sweeps: Largest number of sweeps (the authors: 38), and the squared change of the
            multipliers in a sweep that ends the search (1e-7).
        x: Receives the minimiser (n,).
        multipliers: Receives lambda (m,), zeros before.
        scratch: At least `hildreth_numbers(m, n)` free numbers.

    Returns:
        Number of sweeps, and the status.

    Note:
        A small change does not prove convergence. The sweeps continue until the Kuhn-Tucker
        conditions of Eq. (30) hold as well; otherwise the solution is UNFINISHED.
    """
    begin, n, done = scratch.used[0], len(qp.K), 0
    task, w = nearest_point(qp, scratch), vector(scratch, n)
    rows, lengths = matrix(scratch, len(qp.low), n), vector(scratch, len(qp.low))
    for i in range(len(lengths)):
        lengths[i] = unit_row(task.C, qp.M[i], 1.0, rows[i])
    for j in range(n):
        w[j] = task.start[j]
    status = task.status
    finished = status != SOLVED or kuhn_tucker_hold(qp, task, rows, lengths, multipliers, w)
    while not finished and done < sweeps[0]:
        change = sweep(qp, rows, lengths, multipliers, w)
        done += 1
        finished = change <= sweeps[1] and kuhn_tucker_hold(qp, task, rows, lengths, multipliers, w)
    for i in range(len(lengths)):
        multipliers[i] /= lengths[i]
    backward(task.C, w, n, x)
    scratch.used[0] = begin
    return done, status if finished else UNFINISHED


def hildreth_numbers(m: int, n: int) -> int:
    """Return the size of the scratch memory of `hildreth` for m rows of n unknowns."""
    return (m + n + 2) * (n + 1)


@in_place
def sweep(qp: Qp, rows: Array, lengths: Array, multipliers: Array, w: Array) -> float:
    """Improve each multiplier once, and w with it, in place, Eq. (29); return the squared change.

    A two-sided row has one multiplier, which is negative if its lower bound is active.
    """
    change = 0.0
    for i in range(len(multipliers)):
        before = multipliers[i]
        value = before + dot(rows[i], w)
        high, low = qp.high[i] / lengths[i], qp.low[i] / lengths[i]
        multipliers[i] = max(value - high, 0.0) + min(value - low, 0.0)
        step = multipliers[i] - before
        change += step * step
        for j in range(len(w)):
            w[j] -= step * rows[i, j]
    return change


@in_place
def kuhn_tucker_hold(
    qp: Qp, task: NearestPoint, rows: Array, lengths: Array, multipliers: Array, w: Array
) -> bool:
    """Return whether all rows hold, and those with a multiplier hold with equality, Eq. (30)."""
    for i in range(len(multipliers)):
        value, high, low = dot(rows[i], w), qp.high[i] / lengths[i], qp.low[i] / lengths[i]
        excess, bound = max(value - high, low - value), high if value > high else low
        if multipliers[i] != 0.0:
            bound = high if multipliers[i] > 0.0 else low
            excess = abs(value - bound)
        if excess > 0.0 and excess > KUHN_TUCKER * max(task.scale, abs(bound)):
            return False
    return True
