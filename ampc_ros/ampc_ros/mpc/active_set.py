"""Exact QP solver: the dual active-set method of Goldfarb and Idnani (1983).

Where the active rows are so nearly dependent that rounding decides, the method can fail on a
feasible problem. The primal method of `descent` then solves it, if it has a feasible start.

A library (DAQP) is not used because the solver must run inside compiled code without Python's
global lock. The tests compare it with DAQP and SciPy.
"""

import math

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.descent import descend, descent_numbers, feasible_start, relaxed_rows
from ampc_ros.mpc.qp import (
    INFEASIBLE,
    SOLVED,
    UNFINISHED,
    NearestPoint,
    Qp,
    nearest_point,
    unit_row,
)
from ampc_ros.mpc.small_matrices import Scratch, backward, dot, project_out, vector
from ampc_ros.mpc.working_set import (
    LOOSE,
    ActiveRows,
    append_row,
    fits,
    no_active_rows,
    remove_row,
    settle,
)

TOLERANCE = 1e-11
"""Accepted violation of a row, relative to the order of magnitude of its numbers."""

DEPENDENT = 1e-18
"""Squared distance of a unit row from the span of the active ones below which it is dependent."""

MAX_ENTRIES = 500
"""Largest number of rows that enter the working set before the solver stops."""


def active_set_numbers(m: int, n: int) -> int:
    """Return the size of the scratch memory of `active_set` for m rows of n unknowns."""
    return m + 4 * n * n + 20 * n + 10 + descent_numbers(m, n)


@in_place
def worst_excess(qp: Qp, x: Array, holds: Array, ceiling: float, last: int) -> tuple[float, int]:
    """Return the largest violation by x (n,) among the inactive rows, and its row.

    Only violations below a ceiling are considered, or equal to it in a row after `last`. Repeated
    calls therefore list the violated rows in descending order. The row is -1 if there is none.
    """
    worst, row = 0.0, -1
    for i in range(len(qp.low)):
        value = dot(qp.M[i], x)
        excess = max(value - qp.high[i], qp.low[i] - value)
        next_one = excess < ceiling or (excess == ceiling and i > last)
        if excess > worst and next_one and holds[i] == 0.0:
            worst, row = excess, i
    return worst, row


@inlined
def choose_entering_row(qp: Qp, task: NearestPoint, active: ActiveRows, x: Array) -> bool:
    """Store the row that x (n,) violates most as the entering row; return whether there is one."""
    k, excess, i = int(active.size[0]), math.inf, -1
    unit = active.rows[k]
    while True:
        excess, i = worst_excess(qp, x, active.holds, excess, i)
        if i < 0:
            return False
        side = 1.0 if dot(qp.M[i], x) > qp.high[i] else -1.0
        bound = qp.high[i] if side > 0.0 else -qp.low[i]
        length = unit_row(task.C, qp.M[i], side, unit)
        if excess > TOLERANCE * max(task.scale * length, abs(bound)):
            active.chosen[k], active.side[k], active.lengths[k] = i, side, length
            active.bounds[k], active.multipliers[k] = bound / length, 0.0
            return True


@in_place
def longest_step(falling: Array, multipliers: Array, k: int) -> tuple[float, int]:
    """Return the step at which the first of k falling multipliers is zero, and its position."""
    step, blocking = math.inf, -1
    for i in range(k):
        if falling[i] > 0.0 and multipliers[i] < step * falling[i]:
            step, blocking = multipliers[i] / falling[i], i
    return step, blocking


@inlined
def enter(active: ActiveRows, w: Array) -> bool:
    """Append the entering row; remove rows whose multiplier would become negative.

    Multipliers and w (n,) are changed in place along the way; `settle` recomputes them afterwards.

    Returns:
        Whether a point satisfies these rows.
    """
    while True:
        k = int(active.size[0])
        row, rest, falling = active.rows[k], active.rest, active.held
        project_out(row, active.basis, k, active.coordinates, rest)
        backward(active.S, active.coordinates, k, falling)
        dual_step, blocking = longest_step(falling, active.multipliers, k)
        slope = dot(rest, rest)
        excess = max(dot(row, w) - active.bounds[k], 0.0)
        primal_step = excess / slope if slope > DEPENDENT and k < len(w) else math.inf
        if primal_step <= dual_step and primal_step < math.inf:
            append_row(active, math.sqrt(slope))
            return True
        if blocking < 0:
            return False
        for i in range(k):
            active.multipliers[i] -= dual_step * falling[i]
        for j in range(len(w)):
            w[j] -= dual_step * rest[j]
        remove_row(active, blocking)


@inlined
def solve_dual(
    qp: Qp, task: NearestPoint, active: ActiveRows, w: Array, x: Array
) -> tuple[int, int, bool]:
    """Add the most violated row to the active ones until none is violated.

    Returns:
        Number of rows that entered; status; whether the result `fits` its active rows.
    """
    entered, status = 0, task.status
    while True:
        smallest = settle(task.start, active, w)
        backward(task.C, w, len(x), x)
        if status != SOLVED or not choose_entering_row(qp, task, active, x):
            return entered, status, fits(active, w, smallest, LOOSE * task.scale)
        feasible = enter(active, w)
        entered += 1
        if not feasible or entered == MAX_ENTRIES:
            status = UNFINISHED if feasible else INFEASIBLE


@in_place
def active_set(qp: Qp, x: Array, multipliers: Array, scratch: Scratch) -> tuple[int, int]:
    """Solve a strictly convex QP exactly, or return the reason for the failure as the status.

    Start at the unconstrained minimum and add the most violated row until none is violated. If this
    fails or has lost its digits, start again at a feasible point, see `descent`. A QP that x = 0
    satisfies is therefore never infeasible.

    Args:
        qp: The QP.
        x: Receives the minimiser (n,).
        multipliers: Receives lambda (m,), zeros before.
        scratch: At least `active_set_numbers(m, n)` free numbers.

    Returns:
        Number of rows that entered, and the status.
    """
    begin, n = scratch.used[0], len(qp.K)
    task = nearest_point(qp, scratch)
    active, w = no_active_rows(len(qp.low), n, scratch), vector(scratch, n)
    entered, status, exact = solve_dual(qp, task, active, w, x)
    if task.status == SOLVED and not (status == SOLVED and exact):
        unit = relaxed_rows(qp, task, scratch)
        if feasible_start(qp, task, unit, w):
            entered, status = descend(qp, task, unit, active, w, vector(scratch, n))
            backward(task.C, w, n, x)
    for i in range(int(active.size[0])):
        share = active.side[i] * active.multipliers[i] / active.lengths[i]
        multipliers[int(active.chosen[i])] = share
    scratch.used[0] = begin
    return entered, status
