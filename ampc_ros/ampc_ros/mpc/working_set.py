"""Working set of an active-set method for the nearest-point problem, and its orthonormal basis."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.small_matrices import (
    Scratch,
    backward,
    dot,
    forward,
    matrix,
    project_out,
    vector,
)

LOOSE = 5e-10
"""Accepted violation of a row after rounding, relative to the order of magnitude of its numbers."""


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


@inlined
def clear(active: ActiveRows) -> None:
    """Remove all rows."""
    active.size[0] = 0.0
    for i in range(len(active.holds)):
        active.holds[i] = 0.0


@inlined
def fits(active: ActiveRows, w: Array, smallest: float, tolerance: float) -> bool:
    """Check that w (n,) lies on the active rows, and that no multiplier pulls it across its row.

    The rows are nearly dependent where one of these fails.

    Args:
        active: Working set after `settle`.
        w: The point that `settle` computed.
        smallest: The smallest multiplier, as `settle` returns it.
        tolerance: Accepted distance from a row [unit of w].
    """
    good = smallest >= -tolerance
    for i in range(int(active.size[0])):
        distance = abs(dot(active.rows[i], w) - active.bounds[i])
        good = good and distance <= max(tolerance, LOOSE * abs(active.bounds[i]))
    return good


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


@inlined
def settle(start: Array, active: ActiveRows, w: Array) -> float:
    """Compute the point w (n,) nearest to `start` on the active rows, and the multipliers.

    Returns:
        The smallest multiplier before negative ones are set to zero; inf without active rows.

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
    smallest = math.inf
    for i in range(k):
        smallest = min(smallest, active.multipliers[i])
        active.multipliers[i] = max(active.multipliers[i], 0.0)
    return smallest
