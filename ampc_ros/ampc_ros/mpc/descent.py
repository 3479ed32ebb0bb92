"""Primal active-set method: from a feasible point down to the minimum, feasible at each step.

It is slower than the dual method of `active_set` and used where that one fails. A row enters the
working set only where it blocks a move, so a nearly dependent row never does. Each bound is relaxed
by another tiny amount, so that no two rows block at the same point and no step has length zero
(Charnes, 1952). The solution is moved back to the exact bounds where this keeps it feasible.
"""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import SOLVED, UNFINISHED, NearestPoint, Qp, unit_row
from ampc_ros.mpc.small_matrices import Scratch, backward, dot, matrix, project_out, vector
from ampc_ros.mpc.working_set import (
    LOOSE,
    ActiveRows,
    append_row,
    clear,
    fits,
    remove_row,
    settle,
)

RELAXED = 1e-10
"""Largest relaxation of a bound, relative to the order of magnitude of its numbers."""

GOLDEN = 0.6180339887498949
"""Its multiples modulo 1 differ from each other: the relaxation of row i is a function of i."""

STATIONARY = 1e-13
"""Length of a move below which there is none, relative to the order of magnitude of the numbers."""

PARALLEL = 1e-11
"""Sine of the angle between a move and a row below which the row does not block the move."""

MAX_MOVES = 500
"""Largest number of moves before the solver stops."""


class UnitRows(NamedTuple):
    """All rows of the QP, acting on w = C' x, with relaxed bounds."""

    rows: Array
    """(m, n) of unit length, or zeros."""
    low: Array
    """(m,)."""
    high: Array
    """(m,)."""
    lengths: Array
    """(m,) lengths before scaling."""


def descent_numbers(m: int, n: int) -> int:
    """Return the size of the scratch memory of `relaxed_rows` and `descend`."""
    return m * (n + 3) + n


@inlined
def relaxed_rows(qp: Qp, task: NearestPoint, scratch: Scratch) -> UnitRows:
    """Return the rows of a QP for w = C' x, scaled to unit length, with relaxed bounds."""
    m, n = len(qp.low), len(qp.K)
    unit = UnitRows(
        matrix(scratch, m, n), vector(scratch, m), vector(scratch, m), vector(scratch, m)
    )
    for i in range(m):
        length = unit_row(task.C, qp.M[i], 1.0, unit.rows[i])
        low, high = qp.low[i] / length, qp.high[i] / length
        share = RELAXED * (0.5 + 0.5 * (GOLDEN * (i + 1) % 1.0))
        unit.lengths[i] = length
        unit.low[i] = low - share * max(task.scale, abs(low))
        unit.high[i] = high + share * max(task.scale, abs(high))
    return unit


@inlined
def feasible_start(qp: Qp, task: NearestPoint, unit: UnitRows, w: Array) -> bool:
    """Fill w = C' x (n,) for the multiple x of the last unit vector that is feasible, nearest to 0.

    The last unknown is the shared slack of a QP with soft rows. Without soft rows x = 0 is tried.

    Returns:
        Whether there is one within the relaxed bounds.
    """
    last, smallest, largest = len(w) - 1, -math.inf, math.inf
    for i in range(len(unit.low)):
        a, low, high = qp.M[i, last] / unit.lengths[i], unit.low[i], unit.high[i]
        if low <= 0.0 <= high and a == 0.0:
            continue
        if a == 0.0:
            return False
        smallest = max(smallest, min(low / a, high / a))
        largest = min(largest, max(low / a, high / a))
    for j in range(len(w)):
        w[j] = task.C[last, j] * min(max(0.0, smallest), largest)
    return smallest <= largest


@inlined
def longest_move(
    unit: UnitRows, holds: Array, w: Array, move: Array, length: float
) -> tuple[float, int, float]:
    """Return the share of a move (n,) from w (n,) up to the first row, that row, and its side.

    The row is -1 if the complete move of the given length is possible.
    """
    share, blocking, side = 1.0, -1, 1.0
    for i in range(len(holds)):
        slope = dot(unit.rows[i], move)
        if holds[i] != 0.0 or not abs(slope) > PARALLEL * length:
            continue
        bound = unit.high[i] if slope > 0.0 else unit.low[i]
        until = max((bound - dot(unit.rows[i], w)) / slope, 0.0)
        if until < share:
            share, blocking, side = until, i, 1.0 if slope > 0.0 else -1.0
    return share, blocking, side


@inlined
def add_row(qp: Qp, unit: UnitRows, active: ActiveRows, i: int, side: float) -> None:
    """Append row i of the QP, with its exact bound."""
    k = int(active.size[0])
    bound = qp.high[i] if side > 0.0 else -qp.low[i]
    active.chosen[k], active.side[k], active.lengths[k] = i, side, unit.lengths[i]
    active.bounds[k], active.multipliers[k] = bound / unit.lengths[i], 0.0
    for j in range(len(active.rest)):
        active.rows[k, j] = side * unit.rows[i, j]
    project_out(active.rows[k], active.basis, k, active.coordinates, active.rest)
    append_row(active, math.sqrt(dot(active.rest, active.rest)))


@in_place
def smallest_multiplier(multipliers: Array, k: int) -> int:
    """Return the position of the smallest of k multipliers."""
    position = 0
    for i in range(1, k):
        if multipliers[i] < multipliers[position]:
            position = i
    return position


@inlined
def is_feasible(unit: UnitRows, w: Array, scale: float) -> bool:
    """Check that w (n,) satisfies all rows within `LOOSE` of the order of magnitude."""
    good = True
    for i in range(len(unit.low)):
        value = dot(unit.rows[i], w)
        good = good and value - unit.high[i] <= (LOOSE - RELAXED) * max(scale, abs(unit.high[i]))
        good = good and unit.low[i] - value <= (LOOSE - RELAXED) * max(scale, abs(unit.low[i]))
    return good


@inlined
def project_start(task: NearestPoint, active: ActiveRows, w: Array, way: Array) -> float:
    """Split the way from w (n,) to the unconstrained minimum along the active rows and across.

    Returns:
        Length of the part along the rows, which is the move that lowers the cost most.
    """
    for j in range(len(w)):
        way[j] = task.start[j] - w[j]
    project_out(way, active.basis, int(active.size[0]), active.coordinates, active.rest)
    return math.sqrt(dot(active.rest, active.rest))


@inlined
def move_to_exact_bounds(
    task: NearestPoint, unit: UnitRows, active: ActiveRows, w: Array, way: Array
) -> None:
    """Replace w (n,) by the nearest point on the exact bounds of the active rows, if feasible.

    The multipliers are those of the resulting point.
    """
    k = int(active.size[0])
    for j in range(len(w)):
        way[j] = w[j]
    smallest = settle(task.start, active, w)
    if fits(active, w, smallest, LOOSE * task.scale) and is_feasible(unit, w, task.scale):
        return
    for j in range(len(w)):
        w[j] = way[j]
    project_start(task, active, w, way)
    backward(active.S, active.coordinates, k, active.multipliers)
    for i in range(k):
        active.multipliers[i] = max(active.multipliers[i], 0.0)


@in_place
def descend(
    qp: Qp, task: NearestPoint, unit: UnitRows, active: ActiveRows, w: Array, way: Array
) -> tuple[int, int]:
    """Move from a feasible point to the nearest point of the polyhedron, feasible at each step.

    Args:
        qp: The QP.
        task: The same as a nearest-point problem.
        unit: Its rows with relaxed bounds.
        active: Working set; emptied first, then that of the solution.
        w: A feasible point (n,); receives the solution.
        way: Auxiliary (n,).

    Returns:
        Number of moves, and SOLVED or UNFINISHED. The point is feasible in either case.
    """
    n, moves, status = len(w), 0, UNFINISHED
    clear(active)
    while status == UNFINISHED and moves < MAX_MOVES:
        moves += 1
        k, length = int(active.size[0]), project_start(task, active, w, way)
        tiny = STATIONARY * (task.scale + math.sqrt(dot(w, w)))
        if k < n and length > tiny:
            # Move along the active rows up to the first other row
            share, blocking, side = longest_move(unit, active.holds, w, active.rest, length)
            for j in range(n):
                w[j] += share * active.rest[j]
            if blocking >= 0:
                add_row(qp, unit, active, blocking, side)
        else:
            # Remove the row that the multipliers pull away from most
            backward(active.S, active.coordinates, k, active.multipliers)
            smallest = smallest_multiplier(active.multipliers, k)
            if k == 0 or active.multipliers[smallest] >= -tiny:
                status = SOLVED
            else:
                remove_row(active, smallest)
    move_to_exact_bounds(task, unit, active, w, way)
    return moves, status
