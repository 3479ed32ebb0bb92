"""Two solvers of the quadratic programme of Eq. (17): an exact one, and Hildreth's, Eqs. (25)-(30)."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.small_matrices import apply, apply_transposed, dot

Array = NDArray[np.float64]

SOLVED, INFEASIBLE, UNFINISHED, NOT_CONVEX = 0, 1, 2, 3
TOLERANCE = 1e-10
"""Largest violation of a row of unit length in the transformed problem that counts as none."""
DEPENDENT = 1e-18
"""Squared distance of a unit row from the span of the active ones that counts as none."""
MAX_CHANGES = 500


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
    """Changes of the active set, or sweeps."""
    status: int
    """SOLVED, INFEASIBLE, UNFINISHED or NOT_CONVEX."""

    @property
    def converged(self) -> bool:
        """Whether x is the minimiser."""
        return self.status == SOLVED


@compiled
def cholesky(E: Array) -> tuple[Array, bool]:
    """Lower factor C of E = C C' (n, n), and whether E is positive definite to working precision."""
    n = len(E)
    C = np.zeros((n, n))
    for j in range(n):
        pivot = E[j, j] - dot(C[j, :j], C[j, :j])
        if not pivot > 1e-14 * abs(E[j, j]):
            return C, False
        C[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            C[i, j] = (E[i, j] - dot(C[i, :j], C[j, :j])) / C[j, j]
    return C, True


@compiled
def forward(C: Array, b: Array) -> Array:
    """Solve C x = b for a lower triangular C, whose first len(b) rows and columns count."""
    x = np.empty(len(b))
    for i in range(len(b)):
        x[i] = (b[i] - dot(C[i, :i], x[:i])) / C[i, i]
    return x


@compiled
def backward(C: Array, b: Array) -> Array:
    """Solve C' x = b for a lower triangular C, whose first len(b) rows and columns count."""
    n = len(b)
    x = b.copy()
    for i in range(n - 1, -1, -1):
        x[i] /= C[i, i]
        for j in range(i):
            x[j] -= C[i, j] * x[i]
    return x


@compiled
def project_out(vector: Array, basis: Array) -> tuple[Array, Array]:
    """Part a vector (n,): coordinates (k,) in orthonormal rows (k, n), and what is left (n,).

    Note:
        Gram-Schmidt, done twice, which keeps orthogonality to working precision.
    """
    coordinates = np.zeros(len(basis))
    rest = vector.copy()
    for _ in range(2):
        for i in range(len(basis)):
            share = dot(basis[i], rest)
            coordinates[i] += share
            for j in range(len(rest)):
                rest[j] -= share * basis[i, j]
    return coordinates, rest


class ActiveRows(NamedTuple):
    """Working set of the dual method; the first k entries of each array count, k <= n."""

    index: NDArray[np.int64]
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
    return ActiveRows(np.zeros(n, np.int64), np.zeros(n), np.zeros((n, n)), np.zeros((n, n)))


@compiled
def orthonormalise(active: ActiveRows, rows: Array, first: int, k: int) -> None:
    """Bring basis and S of the active rows `first` .. k - 1 up to date."""
    for i in range(first, k):
        coordinates, rest = project_out(rows[active.index[i]], active.basis[:i])
        length = math.sqrt(dot(rest, rest))
        active.S[i, :i] = coordinates
        active.S[i, i] = length
        active.basis[i] = rest / length


@compiled
def drop(active: ActiveRows, rows: Array, blocking: int, k: int) -> None:
    """Take one of k rows out of the working set."""
    for i in range(blocking, k - 1):
        active.index[i] = active.index[i + 1]
        active.multipliers[i] = active.multipliers[i + 1]
    orthonormalise(active, rows, blocking, k - 1)


@compiled
def most_violated(rows: Array, bounds: Array, w: Array) -> int:
    """Index of the largest violation of rows w <= bounds, -1 if there is none."""
    worst, violation = -1, 0.0
    for i in range(len(bounds)):
        excess = dot(rows[i], w) - bounds[i]
        if excess > violation and excess > TOLERANCE * max(1.0, abs(bounds[i])):
            worst, violation = i, excess
    return worst


@compiled
def longest_step(falling: Array, multipliers: Array) -> tuple[float, int]:
    """Step at which the first multiplier (k,) reaches zero while each falls at its rate (k,)."""
    step, blocking = math.inf, -1
    for i in range(len(falling)):
        if falling[i] > 0.0 and multipliers[i] < step * falling[i]:
            step, blocking = multipliers[i] / falling[i], i
    return step, blocking


@compiled
def point_of(start: Array, rows: Array, active: ActiveRows, k: int) -> Array:
    """Point at which the cost's gradient balances the k active multipliers (n,)."""
    w = start.copy()
    for i in range(k):
        row, multiplier = rows[active.index[i]], active.multipliers[i]
        for j in range(len(w)):
            w[j] -= multiplier * row[j]
    return w


@compiled
def nearest_feasible(rows: Array, bounds: Array, start: Array) -> tuple[Array, Array, int, int]:
    """Point nearest to `start` (n,) with rows w <= bounds: Goldfarb and Idnani's dual method (1983).

    Starts at the unconstrained minimum and adds the most violated row until none is violated; a row
    whose multiplier would turn negative on the way is dropped.

    Returns:
        The point (n,), the multipliers (m,), the number of changes, the status.
    """
    active, k = no_active_rows(len(start)), 0
    multipliers = np.zeros(len(bounds))
    w, target, added = start.copy(), -1, 0.0
    for change in range(MAX_CHANGES):
        if target < 0:
            target, added = most_violated(rows, bounds, w), 0.0
            if target < 0:
                for i in range(k):
                    multipliers[active.index[i]] = active.multipliers[i]
                return w, multipliers, change, SOLVED
        coordinates, rest = project_out(rows[target], active.basis[:k])
        falling = backward(active.S, coordinates)
        dual_step, blocking = longest_step(falling, active.multipliers)
        slope = dot(rest, rest)
        excess = dot(rows[target], w) - bounds[target]
        primal_step = max(excess, 0.0) / slope if slope > DEPENDENT and k < len(w) else math.inf
        step = min(dual_step, primal_step)
        if not step < math.inf:
            return w, multipliers, change, INFEASIBLE
        added += step
        for i in range(k):
            active.multipliers[i] -= step * falling[i]
        if primal_step <= dual_step:
            active.index[k], active.multipliers[k] = target, added
            orthonormalise(active, rows, k, k + 1)
            k, target = k + 1, -1
            w = point_of(start, rows, active, k)
        else:
            drop(active, rows, blocking, k)
            k -= 1
            for j in range(len(w)):
                w[j] -= step * rest[j]
    return w, multipliers, MAX_CHANGES, UNFINISHED


@compiled
def unit_rows(C: Array, M: Array, gamma: Array) -> tuple[Array, Array, Array]:
    """Rows and bounds of the constraints on w = C' x, scaled to unit length, and the lengths."""
    rows, bounds, lengths = np.empty_like(M), np.empty_like(gamma), np.ones(len(gamma))
    for i in range(len(gamma)):
        row = forward(C, M[i])
        length = math.sqrt(dot(row, row))
        if length > 0.0:
            lengths[i] = length
        rows[i] = row / lengths[i]
        bounds[i] = gamma[i] / lengths[i]
    return rows, bounds, lengths


@compiled
def active_set(qp: Qp) -> QpSolution:
    """Solve a strictly convex programme exactly, or say that it has no solution.

    Note:
        With E = C C' and w = C' x the task is the point nearest to -C^-1 K in a polyhedron.
    """
    E, K, M, gamma = qp
    C, convex = cholesky(E)
    if not convex:
        return QpSolution(np.zeros(len(K)), np.zeros(len(gamma)), 0, NOT_CONVEX)
    rows, bounds, lengths = unit_rows(C, M, gamma)
    w, multipliers, changes, status = nearest_feasible(rows, bounds, -forward(C, K))
    return QpSolution(backward(C, w), multipliers / lengths, changes, status)


@compiled
def hildreth(qp: Qp, max_sweeps: int, tolerance: float) -> QpSolution:
    """Solve by Hildreth's procedure, Eqs. (25)-(30): Gauss-Seidel on the multipliers.

    Args:
        qp: The programme.
        max_sweeps: Sweeps over all multipliers (the authors: 38).
        tolerance: Stop once the squared change of the multipliers in a sweep is below (1e-7).

    Note:
        A small change does not prove convergence: a point that misses the Kuhn-Tucker conditions
        by more than 1e-6 of their scale is reported UNFINISHED.
    """
    E, K, M, gamma = qp
    C, convex = cholesky(E)
    if not convex:
        return QpSolution(np.zeros(len(K)), np.zeros(len(gamma)), 0, NOT_CONVEX)
    rows, bounds, lengths = unit_rows(C, M, gamma)
    start = -forward(C, K)
    multipliers, w = np.zeros(len(gamma)), start.copy()
    sweeps, change = 0, math.inf if most_violated(rows, bounds, w) >= 0 else 0.0
    while sweeps < max_sweeps and change >= tolerance and change > 0.0:
        change = sweep(rows, bounds, multipliers, w)
        sweeps += 1
    w = start - apply_transposed(rows, multipliers)
    residual = apply(rows, w) - bounds
    finished = not change > tolerance and kuhn_tucker_hold(residual, bounds, multipliers)
    status = SOLVED if finished else UNFINISHED
    return QpSolution(backward(C, w), multipliers / lengths, sweeps, status)


@compiled
def sweep(rows: Array, bounds: Array, multipliers: Array, w: Array) -> float:
    """Improve each multiplier once, and w with it, in place; gives their squared change."""
    change = 0.0
    for i in range(len(bounds)):
        before = multipliers[i]
        multipliers[i] = max(0.0, before + dot(rows[i], w) - bounds[i])
        step = multipliers[i] - before
        change += step * step
        for j in range(len(w)):
            w[j] -= step * rows[i, j]
    return change


@compiled
def kuhn_tucker_hold(residual: Array, bounds: Array, multipliers: Array) -> bool:
    """Whether rows are kept and multipliers of slack rows vanish, Eq. (30), to 1e-6 of the scale."""
    for i in range(len(bounds)):
        if residual[i] > 1e-6 * max(1.0, abs(bounds[i])):
            return False
        if multipliers[i] > 0.0 and abs(residual[i]) > 1e-6 * max(1.0, abs(bounds[i])):
            return False
    return True
