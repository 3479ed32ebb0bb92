"""Two solvers of the quadratic programme of Eq. (17): an exact one, and Hildreth's, Eqs. (25)-(30)."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled

Array = NDArray[np.float64]

SOLVED, INFEASIBLE, UNFINISHED, NOT_CONVEX = 0, 1, 2, 3
TOLERANCE = 1e-10
"""Largest violation of a row of unit length in the transformed problem that counts as none."""
MAX_STEPS = 500


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
        pivot = E[j, j] - (C[j, :j] ** 2).sum()
        if not pivot > 1e-14 * abs(E[j, j]):
            return C, False
        C[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            C[i, j] = (E[i, j] - (C[i, :j] * C[j, :j]).sum()) / C[j, j]
    return C, True


@compiled
def forward(C: Array, b: Array) -> Array:
    """Solve C x = b (n,) for a lower triangular C (n, n)."""
    x = b.copy()
    for i in range(len(b)):
        x[i] = (x[i] - (C[i, :i] * x[:i]).sum()) / C[i, i]
    return x


@compiled
def backward(C: Array, b: Array) -> Array:
    """Solve C' x = b (n,) for a lower triangular C (n, n)."""
    x = b.copy()
    for i in range(len(b) - 1, -1, -1):
        x[i] = (x[i] - (C[i + 1 :, i] * x[i + 1 :]).sum()) / C[i, i]
    return x


@compiled
def split(normal: Array, basis: Array) -> tuple[Array, Array]:
    """Part a vector (n,): coordinates (k,) in orthonormal rows (k, n), and what is left (n,).

    Note:
        Gram-Schmidt, done twice, which keeps orthogonality to working precision.
    """
    coordinates = np.zeros(len(basis))
    rest = normal.copy()
    for _ in range(2):
        for i in range(len(basis)):
            share = (basis[i] * rest).sum()
            coordinates[i] += share
            rest = rest - share * basis[i]
    return coordinates, rest


@compiled
def factorise(rows: Array, active: Array) -> tuple[Array, Array]:
    """Orthonormal basis (k, n) of the active rows, and lower S (k, k) with rows[active] = S basis."""
    k = len(active)
    basis, S = np.zeros((k, rows.shape[1])), np.zeros((k, k))
    for i in range(k):
        coordinates, rest = split(rows[active[i]], basis[:i])
        S[i, :i] = coordinates
        S[i, i] = math.sqrt((rest**2).sum())
        basis[i] = rest / S[i, i]
    return basis, S


@compiled
def most_violated(rows: Array, bounds: Array, w: Array) -> tuple[int, float]:
    """Index and size of the largest violation of rows w <= bounds; rows have unit length."""
    worst, violation = -1, TOLERANCE
    for i in range(len(bounds)):
        excess = (rows[i] * w).sum() - bounds[i]
        if excess > violation * max(1.0, abs(bounds[i])):
            worst, violation = i, excess
    return worst, violation


@compiled
def unit_rows(C: Array, M: Array, gamma: Array) -> tuple[Array, Array, Array]:
    """Rows and bounds of the constraints on w = C' x, scaled to unit length, and the lengths."""
    rows, bounds, lengths = np.empty_like(M), gamma.copy(), np.ones(len(gamma))
    for i in range(len(gamma)):
        rows[i] = forward(C, M[i])
        length = math.sqrt((rows[i] ** 2).sum())
        if length > 0.0:
            lengths[i] = length
        rows[i] /= lengths[i]
        bounds[i] /= lengths[i]
    return rows, bounds, lengths


@compiled
def longest_step(ratio_of: Array, multipliers: Array) -> tuple[float, int]:
    """Step at which the first multiplier (k,) reaches zero when it falls by ratio_of (k,) per step."""
    step, blocking = math.inf, -1
    for i in range(len(multipliers)):
        if ratio_of[i] > 0.0 and multipliers[i] < step * ratio_of[i]:
            step, blocking = multipliers[i] / ratio_of[i], i
    return step, blocking


@compiled
def nearest_feasible(rows: Array, bounds: Array, w: Array) -> tuple[Array, Array, int, int]:
    """Point nearest to w (n,) with rows w <= bounds: the dual method of Goldfarb and Idnani (1983).

    Starts at the unconstrained minimum and adds the most violated row until none is violated; a row
    whose multiplier would turn negative on the way is dropped.

    Returns:
        The point (n,), the multipliers (m,), the number of changes, the status.
    """
    active = np.empty(0, np.int64)
    multipliers = np.empty(0)
    start = w
    target, added = -1, 0.0
    for change in range(MAX_STEPS):
        basis, S = factorise(rows, active)
        w = start - rows[active].T @ multipliers
        if target < 0:
            target, _ = most_violated(rows, bounds, w)
            added = 0.0
            if target < 0:
                full = np.zeros(len(bounds))
                full[active] = multipliers
                return w, full, change, SOLVED
        w = w - added * rows[target]
        coordinates, rest = split(rows[target], basis)
        falling = backward(S, coordinates)
        dual_step, blocking = longest_step(falling, multipliers)
        slope = (rest**2).sum()
        independent = slope > 1e-18
        excess = (rows[target] * w).sum() - bounds[target]
        primal_step = max(excess, 0.0) / slope if independent else math.inf
        step = min(dual_step, primal_step)
        if not step < math.inf:
            return w, np.zeros(len(bounds)), change, INFEASIBLE
        multipliers = multipliers - step * falling
        added += step
        if primal_step <= dual_step:
            active, multipliers = np.append(active, target), np.append(multipliers, added)
            target = -1
        else:
            keep = np.arange(len(active)) != blocking
            active, multipliers = active[keep], multipliers[keep]
    return w, np.zeros(len(bounds)), MAX_STEPS, UNFINISHED


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
        A small change does not prove convergence, so a solution that violates a row by more than
        1e-6 of its scale is reported UNFINISHED.
    """
    E, K, M, gamma = qp
    C, convex = cholesky(E)
    if not convex:
        return QpSolution(np.zeros(len(K)), np.zeros(len(gamma)), 0, NOT_CONVEX)
    x = backward(C, -forward(C, K))
    multipliers = np.zeros(len(gamma))
    if (M @ x <= gamma).all():
        return QpSolution(x, multipliers, 0, SOLVED)
    rows, bounds, lengths = unit_rows(C, M, gamma)
    H = rows @ rows.T
    d = bounds + rows @ forward(C, K)
    sweeps, change = 0, math.inf
    while sweeps < max_sweeps and not change < tolerance:
        change = 0.0
        for i in range(len(gamma)):
            before = multipliers[i]
            if H[i, i] > 0.0:
                gradient = d[i] + (H[i] * multipliers).sum()
                multipliers[i] = max(0.0, before - gradient / H[i, i])
            change += (multipliers[i] - before) ** 2
        sweeps += 1
    x = backward(C, -forward(C, K) - rows.T @ multipliers)
    residual = M @ x - gamma
    tight = (residual <= 1e-6 * np.maximum(1.0, np.abs(gamma))).all()
    complementary = (np.abs(residual * multipliers) <= 1e-6 * (1.0 + np.abs(multipliers))).all()
    status = SOLVED if change < tolerance and tight and complementary else UNFINISHED
    return QpSolution(x, multipliers / lengths, sweeps, status)
