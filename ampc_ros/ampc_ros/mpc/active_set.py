"""Exact QP solver: the dual active-set method of Goldfarb and Idnani (1983).

A library (DAQP) is not used because the solver must run inside compiled code without Python's
global lock. The tests compare it with DAQP and SciPy.
"""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import (
    INFEASIBLE,
    SOLVED,
    UNFINISHED,
    NearestPoint,
    Qp,
    nearest_point,
    unit_row,
)
from ampc_ros.mpc.small_matrices import (
    Scratch,
    backward,
    dot,
    forward,
    matrix,
    project_out,
    vector,
)

TOLERANCE = 1e-11
"""Accepted violation of a row, relative to the order of magnitude of its numbers."""

DEPENDENT = 1e-18
"""Squared distance of a unit row from the span of the active ones below which it is dependent."""

MAX_ENTRIES = 500
"""Largest number of rows that enter the working set before the solver stops."""


class ActiveRows(NamedTuple):
    """Working set of k <= n rows; position k belongs to the entering row."""

    size: Array
    """(1,) k."""
    chosen: Array
    """(n + 1,) indices of the rows in the QP."""
    holds: Array
    """(m,) 1 for each row of the QP that is in the set."""
    side: Array
    """(n + 1,) 1: upper bound active, -1: lower bound active."""
    rows: Array
    """(n + 1, n) side * row C^-1', scaled to unit length."""
    bounds: Array
    """(n + 1,) bounds of rows w."""
    lengths: Array
    """(n + 1,) lengths of the rows before scaling."""
    multipliers: Array
    """(n + 1,)."""
    basis: Array
    """(n, n) orthonormal rows that span the active ones."""
    S: Array
    """(n, n) lower triangular: active rows = S basis."""
    coordinates: Array
    """(n,) coordinates in the basis of the last vector that was split."""
    rest: Array
    """(n,) part of that vector orthogonal to the basis."""
    held: Array
    """(n,) auxiliary."""


def active_set_numbers(m: int, n: int) -> int:
    """Return the size of the scratch memory of `active_set` for m rows of n unknowns."""
    return m + 4 * n * n + 20 * n + 10


@inlined
def no_active_rows(m: int, n: int, scratch: Scratch) -> ActiveRows:
    """Allocate an empty working set for m rows of n unknowns."""
    return ActiveRows(
        vector(scratch, 1),
        vector(scratch, n + 1),
        vector(scratch, m),
        vector(scratch, n + 1),
        matrix(scratch, n + 1, n),
        vector(scratch, n + 1),
        vector(scratch, n + 1),
        vector(scratch, n + 1),
        matrix(scratch, n, n),
        matrix(scratch, n, n),
        vector(scratch, n),
        vector(scratch, n),
        vector(scratch, n),
    )


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


@inlined
def orthonormalise(active: ActiveRows, first: int) -> None:
    """Update basis and S for the active rows from `first` on."""
    for i in range(first, int(active.size[0])):
        rest = active.basis[i]
        project_out(active.rows[i], active.basis, i, active.S[i], rest)
        length = math.sqrt(dot(rest, rest))
        active.S[i, i] = length
        for j in range(len(rest)):
            rest[j] /= length


@inlined
def append_row(active: ActiveRows, length: float) -> None:
    """Append the entering row, which was split last and whose rest has this length."""
    k = int(active.size[0])
    for i in range(k):
        active.S[k, i] = active.coordinates[i]
    active.S[k, k] = length
    for j in range(len(active.rest)):
        active.basis[k, j] = active.rest[j] / length
    active.holds[int(active.chosen[k])] = 1.0
    active.size[0] = k + 1


@inlined
def remove_row(active: ActiveRows, blocking: int) -> None:
    """Remove a row from the working set; later rows and the entering one move up."""
    active.size[0] -= 1
    active.holds[int(active.chosen[blocking])] = 0.0
    for i in range(blocking, int(active.size[0]) + 1):
        active.chosen[i], active.side[i] = active.chosen[i + 1], active.side[i + 1]
        active.bounds[i], active.lengths[i] = active.bounds[i + 1], active.lengths[i + 1]
        active.multipliers[i] = active.multipliers[i + 1]
        for j in range(active.rows.shape[1]):
            active.rows[i, j] = active.rows[i + 1, j]
    orthonormalise(active, blocking)


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
def settle(start: Array, active: ActiveRows, w: Array) -> None:
    """Compute the point w (n,) nearest to `start` on the active rows, and the multipliers.

    Note:
        The computation begins at `start` each time, so that rounding errors do not accumulate.
    """
    k = int(active.size[0])
    forward(active.S, active.bounds, k, active.held)
    for j in range(len(w)):
        w[j] = start[j]
    for i in range(k):
        active.coordinates[i] = dot(active.basis[i], start) - active.held[i]
        for j in range(len(w)):
            w[j] -= active.coordinates[i] * active.basis[i, j]
    backward(active.S, active.coordinates, k, active.multipliers)
    for i in range(k):
        active.multipliers[i] = max(active.multipliers[i], 0.0)


@in_place
def active_set(qp: Qp, x: Array, multipliers: Array, scratch: Scratch) -> tuple[int, int]:
    """Solve a strictly convex QP exactly, or return the reason for the failure as the status.

    Start at the unconstrained minimum and add the most violated row until none is violated.

    Args:
        qp: The QP.
        x: Receives the minimiser (n,).
        multipliers: Receives lambda (m,), zeros before.
        scratch: At least `active_set_numbers(m, n)` free numbers.

    Returns:
        Number of rows that entered, and the status.
    """
    begin, n, entered = scratch.used[0], len(qp.K), 0
    task = nearest_point(qp, scratch)
    active, w, status = no_active_rows(len(qp.low), n, scratch), vector(scratch, n), task.status
    settle(task.start, active, w)
    backward(task.C, w, n, x)
    while status == SOLVED and choose_entering_row(qp, task, active, x):
        feasible = enter(active, w)
        entered += 1
        settle(task.start, active, w)
        backward(task.C, w, n, x)
        if not feasible or entered == MAX_ENTRIES:
            status = UNFINISHED if feasible else INFEASIBLE
    for i in range(int(active.size[0])):
        share = active.side[i] * active.multipliers[i] / active.lengths[i]
        multipliers[int(active.chosen[i])] = share
    scratch.used[0] = begin
    return entered, status
