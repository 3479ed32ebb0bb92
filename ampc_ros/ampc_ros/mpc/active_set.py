"""The exact solver: Goldfarb and Idnani's dual active-set method (1983)."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import (
    INFEASIBLE,
    SOLVED,
    UNFINISHED,
    NearestPoint,
    Qp,
    QpSolution,
    nearest_point,
    unit_row,
)
from ampc_ros.mpc.small_matrices import (
    Scratch,
    backward,
    dot,
    forward,
    make_scratch,
    matrix,
    project_out,
    vector,
)

TOLERANCE = 1e-11
"""Violation of a row that counts as none, as a share of the size of the numbers in it."""

DEPENDENT = 1e-18
"""Squared distance of a unit row from the span of the active ones that counts as none."""

MAX_ENTRIES = 500
"""Rows that may enter the working set before the solver gives up."""


class ActiveRows(NamedTuple):
    """Working set of k <= n rows; place k is that of the row which wants to enter."""

    size: Array
    """(1,) k."""
    chosen: Array
    """(n + 1,) index of the row."""
    holds: Array
    """(m,) whether a row is in the set."""
    side: Array
    """(n + 1,) 1: it holds at its upper bound, -1: at its lower one."""
    rows: Array
    """(n + 1, n) side * row C^-1', scaled to unit length."""
    bounds: Array
    """(n + 1,) of rows w."""
    lengths: Array
    """(n + 1,) of the rows before they were scaled."""
    multipliers: Array
    """(n + 1,)."""
    basis: Array
    """(n, n) orthonormal rows that span the active ones."""
    S: Array
    """(n, n) lower triangular: active rows = S basis."""
    coordinates: Array
    """(n,) of the last vector that was parted, in the basis."""
    rest: Array
    """(n,) of that vector."""
    held: Array
    """(n,) auxiliary."""


def solution_of(qp: Qp) -> QpSolution:
    """Solve a programme with `active_set`, in memory of its own."""
    memory = solver_memory(*qp.M.shape)
    iterations, status = solve_in(tuple(qp), memory)
    return QpSolution(memory[0], memory[1], iterations, status)


def solver_memory(m: int, n: int) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Make what `solve_in` needs for m rows of n unknowns; x and the multipliers come first."""
    return np.zeros(n), np.zeros(m), *make_scratch(solver_numbers(m, n))


@in_place
def solve_in(
    programme: tuple[Array, ...], memory: tuple[Array, Array, Array, NDArray[np.int64]]
) -> tuple[int, int]:
    """Call `active_set` from Python: plain tuples, whose type numba knows at once.

    Args:
        programme: The fields of a Qp.
        memory: Of `solver_memory`; it may be used again.

    Returns:
        How many rows entered, and the status.
    """
    x, multipliers, numbers, used = memory
    for i in range(len(multipliers)):
        multipliers[i] = 0.0
    return active_set(Qp(*programme), x, multipliers, Scratch(numbers, used))


def solver_numbers(m: int, n: int) -> int:
    """Give the scratch memory that `active_set` needs for m rows of n unknowns."""
    return m + 4 * n * n + 20 * n + 10


@inlined
def no_active_rows(m: int, n: int, scratch: Scratch) -> ActiveRows:
    """Give an empty working set for m rows of n unknowns."""
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
    """Largest violation and its row, of x (n,) and the rows that do not hold (m,).

    Only rows below a ceiling count, and those that reach it if they come after the last one.
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
def pick_up(qp: Qp, task: NearestPoint, active: ActiveRows, x: Array) -> bool:
    """Put the row that x (n,) violates most into the place of the one to enter, if there is one."""
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
    """Bring basis and S of the active rows from `first` on up to date."""
    for i in range(first, int(active.size[0])):
        rest = active.basis[i]
        project_out(active.rows[i], active.basis, i, active.S[i], rest)
        length = math.sqrt(dot(rest, rest))
        active.S[i, i] = length
        for j in range(len(rest)):
            rest[j] /= length


@inlined
def extend(active: ActiveRows, length: float) -> None:
    """Take the row in that was parted last, and whose rest has this length."""
    k = int(active.size[0])
    for i in range(k):
        active.S[k, i] = active.coordinates[i]
    active.S[k, k] = length
    for j in range(len(active.rest)):
        active.basis[k, j] = active.rest[j] / length
    active.holds[int(active.chosen[k])] = 1.0
    active.size[0] = k + 1


@inlined
def drop(active: ActiveRows, blocking: int) -> None:
    """Take a row out of the working set; the one that wants to enter moves up with the others."""
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
    """Step at which the first of k multipliers reaches zero while each falls at its rate."""
    step, blocking = math.inf, -1
    for i in range(k):
        if falling[i] > 0.0 and multipliers[i] < step * falling[i]:
            step, blocking = multipliers[i] / falling[i], i
    return step, blocking


@inlined
def enter(active: ActiveRows, w: Array) -> bool:
    """Let the row in that was picked up; rows that are in its way leave.

    A row is in the way if its multiplier would turn negative. The multipliers and w (n,), changed
    in place, are those of the way there: see `settle`.

    Returns:
        Whether there is a point that keeps these rows.
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
            extend(active, math.sqrt(slope))
            return True
        if blocking < 0:
            return False
        for i in range(k):
            active.multipliers[i] -= dual_step * falling[i]
        for j in range(len(w)):
            w[j] -= dual_step * rest[j]
        drop(active, blocking)


@inlined
def settle(start: Array, active: ActiveRows, w: Array) -> None:
    """Put w (n,) where the active rows hold, nearest to the start; set the multipliers of this.

    Note:
        Computed from the start each time, so that no rounding error of earlier changes stays.
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
    """Solve a strictly convex programme exactly, or say why not.

    Starts at the unconstrained minimum and lets the most violated row in until none is violated.

    Args:
        qp: The programme.
        x: Receives the minimiser (n,).
        multipliers: Receives lambda (m,), zeros before.
        scratch: At least `solver_numbers(m, n)` free.

    Returns:
        How many rows entered, and the status.
    """
    begin, n, entered = scratch.used[0], len(qp.K), 0
    task = nearest_point(qp, scratch)
    active, w, status = no_active_rows(len(qp.low), n, scratch), vector(scratch, n), task.status
    settle(task.start, active, w)
    backward(task.C, w, n, x)
    while status == SOLVED and pick_up(qp, task, active, x):
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
