"""The quadratic programme of Eq. (17) and its exact solver: Goldfarb and Idnani's method (1983)."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.small_matrices import backward, cholesky, dot, forward, project_out, put

Array = NDArray[np.float64]

SOLVED, INFEASIBLE, UNFINISHED, NOT_CONVEX = 0, 1, 2, 3
TOLERANCE = 1e-11
"""Violation of a row that counts as none, as a share of the size of the numbers in it."""
DEPENDENT = 1e-18
"""Squared distance of a unit row from the span of the active ones that counts as none."""
MAX_ENTRIES = 500
"""Rows that may enter the working set before the solver gives up."""


class Qp(NamedTuple):
    """Minimise 1/2 x' E x + x' K subject to M x <= gamma, Eq. (17)."""

    E: Array
    """(n, n), symmetric and positive definite."""
    K: Array
    """(n,)."""
    M: Array
    """(m, n)."""
    gamma: Array
    """(m,)."""


class QpSolution(NamedTuple):
    """What a solver gives back; unless `converged`, x must not be applied."""

    x: Array
    """(n,)."""
    multipliers: Array
    """lambda of Eq. (30), (m,)."""
    iterations: int
    """Rows that entered the active set, or sweeps."""
    status: int
    """SOLVED, INFEASIBLE, UNFINISHED or NOT_CONVEX."""

    @property
    def converged(self) -> bool:
        """Whether x is the minimiser."""
        return self.status == SOLVED


class NearestPoint(NamedTuple):
    """The same in w = C' x, with E = C C': find the point of a polyhedron nearest to `start`."""

    C: Array
    """(n, n), lower triangular."""
    start: Array
    """Unconstrained minimum -C^-1 K (n,)."""
    scale: float
    """Its length: the size of the numbers in the problem."""
    rows: Array
    """(m, n), each of unit length, or zero."""
    bounds: Array
    """(m,)."""
    lengths: Array
    """(m,) of the rows before they were scaled."""


@compiled
def nearest_point(qp: Qp) -> tuple[NearestPoint, int]:
    """Transform a programme; gives NOT_CONVEX, or UNFINISHED if its numbers are not finite."""
    C, convex = cholesky(qp.E)
    if not convex:
        C = np.eye(len(qp.K))
    start = forward(C, qp.K)
    for j in range(len(start)):
        start[j] = -start[j]
    scale = math.sqrt(dot(start, start))
    rows, bounds, lengths = unit_rows(C, qp.M, qp.gamma)
    status = SOLVED if scale < math.inf else UNFINISHED
    return NearestPoint(C, start, scale, rows, bounds, lengths), status if convex else NOT_CONVEX


@compiled
def unit_rows(C: Array, M: Array, gamma: Array) -> tuple[Array, Array, Array]:
    """Rows and bounds of the constraints on w = C' x, scaled to unit length, and the lengths."""
    rows, bounds, lengths = np.empty_like(M), np.empty_like(gamma), np.ones(len(gamma))
    for i in range(len(gamma)):
        row = forward(C, M[i])
        length = math.sqrt(dot(row, row))
        if length > 0.0:
            lengths[i] = length
        bounds[i] = gamma[i] / lengths[i]
        for j in range(len(row)):
            rows[i, j] = row[j] / lengths[i]
    return rows, bounds, lengths


@compiled
def solution_at(
    task: NearestPoint, w: Array, multipliers: Array, iterations: int, status: int
) -> QpSolution:
    """Transform a point w (n,) and its multipliers (m,) back."""
    for i in range(len(multipliers)):
        multipliers[i] /= task.lengths[i]
    return QpSolution(backward(task.C, w), multipliers, iterations, status)


@compiled
def most_violated(task: NearestPoint, w: Array) -> int:
    """Index of the row that w (n,) violates most, -1 if there is none."""
    worst, violation = -1, 0.0
    for i in range(len(task.bounds)):
        excess = dot(task.rows[i], w) - task.bounds[i]
        if excess > max(violation, TOLERANCE * max(task.scale, abs(task.bounds[i]))):
            worst, violation = i, excess
    return worst


class ActiveRows(NamedTuple):
    """Working set of the dual method; the first k entries of each array count, k <= n."""

    size: NDArray[np.int64]
    """(1,) k."""
    chosen: NDArray[np.int64]
    """(n,) rows that are held with equality."""
    multipliers: Array
    """(n,)."""
    basis: Array
    """(n, n) orthonormal rows that span them."""
    S: Array
    """(n, n) lower triangular: active rows = S basis."""


@compiled
def no_active_rows(n: int) -> ActiveRows:
    """Give an empty working set for n unknowns."""
    size, chosen = np.zeros(1, np.int64), np.zeros(n, np.int64)
    return ActiveRows(size, chosen, np.zeros(n), np.zeros((n, n)), np.zeros((n, n)))


@compiled
def orthonormalise(active: ActiveRows, rows: Array, first: int) -> None:
    """Bring basis and S of the active rows from `first` on up to date."""
    for i in range(first, active.size[0]):
        coordinates, rest = project_out(rows[active.chosen[i]], active.basis[:i])
        put(active.S[i], coordinates)
        active.S[i, i] = math.sqrt(dot(rest, rest))
        for j in range(len(rest)):
            active.basis[i, j] = rest[j] / active.S[i, i]


@compiled
def drop(active: ActiveRows, rows: Array, blocking: int) -> None:
    """Take a row out of the working set."""
    active.size[0] -= 1
    for i in range(blocking, active.size[0]):
        active.chosen[i] = active.chosen[i + 1]
        active.multipliers[i] = active.multipliers[i + 1]
    orthonormalise(active, rows, blocking)


@compiled
def longest_step(falling: Array, multipliers: Array) -> tuple[float, int]:
    """Step at which the first multiplier (k,) reaches zero while each falls at its rate (k,)."""
    step, blocking = math.inf, -1
    for i in range(len(falling)):
        if falling[i] > 0.0 and multipliers[i] < step * falling[i]:
            step, blocking = multipliers[i] / falling[i], i
    return step, blocking


@compiled
def enter(task: NearestPoint, active: ActiveRows, w: Array, target: int) -> bool:
    """Let a violated row into the working set; rows that are in its way leave.

    A row is in the way if its multiplier would turn negative. The multipliers and w (n,), changed
    in place, are those of the way there: see `settle`.

    Returns:
        Whether there is a point that keeps these rows.
    """
    while True:
        k = active.size[0]
        coordinates, rest = project_out(task.rows[target], active.basis[:k])
        falling = backward(active.S, coordinates)
        dual_step, blocking = longest_step(falling, active.multipliers)
        slope = dot(rest, rest)
        excess = max(dot(task.rows[target], w) - task.bounds[target], 0.0)
        primal_step = excess / slope if slope > DEPENDENT and k < len(w) else math.inf
        if primal_step <= dual_step and primal_step < math.inf:
            active.chosen[k], active.size[0] = target, k + 1
            orthonormalise(active, task.rows, k)
            return True
        if blocking < 0:
            return False
        for i in range(k):
            active.multipliers[i] -= dual_step * falling[i]
        for j in range(len(w)):
            w[j] -= dual_step * rest[j]
        drop(active, task.rows, blocking)


@compiled
def settle(task: NearestPoint, active: ActiveRows, w: Array) -> None:
    """Put w (n,) where the active rows hold, nearest to the start; set the multipliers of this.

    Note:
        Computed from the start each time, so that no rounding error of earlier changes stays.
    """
    k = active.size[0]
    coordinates, rest = project_out(task.start, active.basis[:k])
    held = np.empty(k)
    for i in range(k):
        held[i] = task.bounds[active.chosen[i]]
    held = forward(active.S, held)
    put(w, rest)
    for i in range(k):
        coordinates[i] -= held[i]
        for j in range(len(w)):
            w[j] += held[i] * active.basis[i, j]
    multipliers = backward(active.S, coordinates)
    for i in range(k):
        active.multipliers[i] = max(multipliers[i], 0.0)


@compiled
def active_set(qp: Qp) -> QpSolution:
    """Solve a strictly convex programme exactly, or say why not.

    Starts at the unconstrained minimum and lets the most violated row in until none is violated.
    """
    task, status = nearest_point(qp)
    active, w, entered = no_active_rows(len(qp.K)), task.start.copy(), 0
    target = most_violated(task, w)
    while status == SOLVED and target >= 0:
        feasible = enter(task, active, w, target)
        entered += 1
        settle(task, active, w)
        target = most_violated(task, w)
        if not feasible or entered == MAX_ENTRIES:
            status = UNFINISHED if feasible else INFEASIBLE
    multipliers = np.zeros(len(task.bounds))
    for i in range(active.size[0]):
        multipliers[active.chosen[i]] = active.multipliers[i]
    return solution_at(task, w, multipliers, entered, status)
