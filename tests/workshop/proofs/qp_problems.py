"""Degenerate QPs, and checks of a solution by certificates and by two independent solvers.

All checks use the nearest-point problem in w = C' x with E = C C' and rows of unit length, divided
by the length of the unconstrained minimum. A residual of 1e-9 means the same at every scale.
"""

from typing import NamedTuple

import daqp
import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import Qp

TOLERANCE = 1e-9
"""Accepted residual of the Kuhn-Tucker conditions, relative to the size of the terms."""
KINDS = ("free", "tight", "laguerre", "slack", "moved")
"""Rows that x = 0 satisfies, mostly with equality from the second kind on; rows of increments and
angles as in a tick; soft rows with a shared slack; rows that another point satisfies."""
ONE_STEP, BOUND = 0.08, 0.15
"""Bounds of increment and angle of the rows of a tick [rad]."""


ROUNDING = 1e-14
"""Rounding error of a sum, relative to the size of its terms."""


class Unit(NamedTuple):
    """Nearest-point problem: minimise |w - start|^2 / 2 subject to rows w <= bounds."""

    C: Array
    """(n, n), lower triangular."""
    scale: float
    """Length by which w is divided."""
    start: Array
    """(n,) of length 1."""
    rows: Array
    """(k, n) upper sides, then lower sides, finite ones only; of unit length, or zeros."""
    bounds: Array
    """(k,)."""
    lengths: Array
    """(k,) lengths of the rows before scaling."""
    sources: Array
    """(k,) index of the row in the QP."""
    signs: Array
    """(k,) 1: upper side, -1: lower side."""


def degenerate_problem(rng: np.random.Generator, kind: str) -> Qp:
    """Create a QP with 1 to 9 unknowns and up to 60 rows, many of them dependent.

    Args:
        rng: Source of the numbers.
        kind: One of `KINDS`. All but the last are satisfied by x = 0, or by a large slack.
    """
    n, m = int(rng.integers(1, 10)), int(rng.integers(0, 61))
    M, low, high = laguerre_rows(rng, n) if kind == "laguerre" else random_rows(rng, n, m)
    if kind != "free" and rng.random() < 0.8:
        low[rng.random(len(low)) < 0.3] = 0.0
        high[rng.random(len(low)) < 0.3] = 0.0
    M, low, high = with_dependent_rows(rng, M, low, high)
    if kind == "moved":
        value = M @ rng.standard_normal(n)
        low, high = low + value, high + value
    E, K = cost(rng, n)
    if kind == "slack":
        E, K, M, low, high = with_slack(rng, Qp(E, K, M, low, high))
    rows = 10 ** rng.uniform(-9, 6, len(low)) if rng.random() < 0.5 else np.ones(len(low))
    unknowns = 10 ** rng.uniform(-2, 2, len(K)) if rng.random() < 0.3 else np.ones(len(K))
    all_of_them, price = 10 ** rng.uniform(-9, 6), 10 ** rng.uniform(-9, 6)
    return Qp(
        np.ascontiguousarray(price * E * unknowns[:, None] * unknowns),
        price * all_of_them * K * unknowns,
        np.ascontiguousarray(M * unknowns * rows[:, None]),
        all_of_them * low * rows,
        all_of_them * high * rows,
    )


def cost(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Create a positive definite E with a condition number of up to 1e10, and K."""
    B = np.linalg.qr(rng.standard_normal((n, n)))[0] * 10 ** rng.uniform(-rng.uniform(0, 5), 0, n)
    E = B @ B.T
    E = (E + E.T) / 2 + 1e-10 * np.trace(E) * np.eye(n)
    if rng.random() < 0.3:
        return E, rng.standard_normal(n)
    return E, -E @ (10 ** rng.uniform(-1, 2) * rng.standard_normal(n))


def random_rows(rng: np.random.Generator, n: int, m: int) -> tuple[Array, Array, Array]:
    """Create two-sided rows that contain 0."""
    M = rng.standard_normal((m, n))
    if rng.random() < 0.3:
        M = np.rint(M)
    low, high = -rng.uniform(0, 2, m), rng.uniform(0, 2, m)
    low[rng.random(m) < 0.2], high[rng.random(m) < 0.2] = -np.inf, np.inf
    return M, low, high


def laguerre_rows(rng: np.random.Generator, n: int) -> tuple[Array, Array, Array]:
    """Create rows of increment and angle whose late ones nearly vanish, as those of a tick do."""
    steps, pole = int(rng.integers(1, 31)), rng.uniform(0.0, 0.8)
    L, terms = np.zeros((steps, n)), np.arange(n)
    L[0] = np.sqrt(1 - pole**2) * (-pole) ** terms
    A = np.diag(np.full(n, pole))
    for i in range(n):
        for j in range(i):
            A[i, j] = (1 - pole**2) * (-pole) ** (i - j - 1)
    for i in range(1, steps):
        L[i] = A @ L[i - 1]
    M = np.empty((2 * steps, n))
    M[::2], M[1::2] = L, np.cumsum(L, axis=0)
    nominal = np.clip(rng.standard_normal(steps), -1, 1) * ONE_STEP
    angle = np.clip(np.cumsum(nominal), -BOUND, BOUND)
    low, high = np.empty(2 * steps), np.empty(2 * steps)
    low[::2], high[::2] = -ONE_STEP - nominal, ONE_STEP - nominal
    low[1::2], high[1::2] = -BOUND - angle, BOUND - angle
    return M, low, high


def with_dependent_rows(
    rng: np.random.Generator, M: Array, low: Array, high: Array
) -> tuple[Array, Array, Array]:
    """Append rows that repeat others, are opposite to them, or nearly follow from them."""
    if not len(M):
        return M, low, high
    count = int(rng.integers(0, 1 + min(12, max(60 - len(M), 0))))
    rows, lows, highs = [M], [low], [high]
    for _ in range(count):
        i, j = rng.integers(0, len(M), 2)
        factor, other = rng.choice([1.0, -1.0, 3.0]), rng.choice([0.0, 1.0, -0.5])
        row, limits = factor * M[i], sorted((factor * low[i], factor * high[i]))
        if other != 0.0:  # follows from two rows
            row = row + other * M[j]
            limits = np.add(limits, sorted((other * low[j], other * high[j]))).tolist()
        if rng.random() < 0.5:  # nearly dependent
            row = row + 10 ** rng.uniform(-14, -4) * rng.standard_normal(M.shape[1])
        rows.append(row[None])
        lows.append(np.array([limits[0]]))
        highs.append(np.array([limits[1]]))
    return np.vstack(rows), np.concatenate(lows), np.concatenate(highs)


def with_slack(rng: np.random.Generator, qp: Qp) -> Qp:
    """Append a shared slack with soft rows that x = 0 violates without it."""
    soft, n = int(rng.integers(1, 12)), len(qp.K)
    rows, centre = rng.standard_normal((soft, n)), 3 * rng.standard_normal(soft)
    one, free = np.ones((soft, 1)), np.full(soft, np.inf)
    width = rng.uniform(0, 0.5, soft)
    E = np.zeros((n + 1, n + 1))
    E[:n, :n], E[n, n] = qp.E, 10 ** rng.uniform(-1, 3) * np.trace(qp.E)
    M = np.block(
        [
            [qp.M, np.zeros((len(qp.M), 1))],
            [rows, -one],
            [rows, one],
            [np.zeros((1, n)), np.ones((1, 1))],
        ]
    )
    low = np.concatenate((qp.low, -free, centre - width, [0.0]))
    high = np.concatenate((qp.high, centre + width, free, [np.inf]))
    return Qp(E, np.append(qp.K, 0.0), M, low, high)


def unit_problem(qp: Qp) -> Unit:
    """Transform a QP to the nearest-point problem of the checks."""
    C = np.asarray(np.linalg.cholesky(qp.E), dtype=np.float64)
    start: Array = np.asarray(-solve_triangular(C, qp.K, lower=True), dtype=np.float64)
    scale = float(np.linalg.norm(start)) or 1.0
    rows = solve_triangular(C, qp.M.T, lower=True).T if len(qp.M) else np.zeros((0, len(C)))
    lengths = np.linalg.norm(rows, axis=1)
    lengths = np.where(lengths > 0, lengths, 1.0)
    upper, lower = np.isfinite(qp.high), np.isfinite(qp.low)
    rows = rows / lengths[:, None]
    bounds = np.concatenate(((qp.high / lengths)[upper], (-qp.low / lengths)[lower])) / scale
    return Unit(
        C,
        scale,
        start / scale,
        np.vstack((rows[upper], -rows[lower])),
        bounds,
        np.concatenate((lengths[upper], lengths[lower])),
        np.concatenate((np.flatnonzero(upper), np.flatnonzero(lower))),
        np.concatenate((np.ones(upper.sum()), -np.ones(lower.sum()))),
    )


class Certificate(NamedTuple):
    """Solution with its residuals, relative to the size of their terms."""

    point: Array
    """w (n,), divided by the scale."""
    multipliers: Array
    """(k,) of the unit rows."""
    cost: float
    """|w - start|^2 / 2."""
    bound: float
    """Dual bound by the multipliers."""
    residual: float
    """Largest of violation, stationarity, and distance of cost and bound."""


def certificate(unit: Unit, point: Array, multipliers: Array) -> Certificate:
    """Compute the residuals of a point and of multipliers >= 0 of the unit rows.

    The dual bound holds for any multipliers: |start|^2 / 2 - |start - rows' lambda|^2 / 2
    - bounds' lambda is below the cost of every feasible point.
    """
    excess, pull = unit.rows @ point - unit.bounds, unit.rows.T @ multipliers
    forces = 1.0 + float(np.linalg.norm(point)) + float(multipliers.sum())
    stationary = float(np.linalg.norm(point - unit.start + pull)) / forces
    cost = 0.5 * float(np.sum((point - unit.start) ** 2))
    bound = 0.5 * (1.0 - float(np.sum((unit.start - pull) ** 2))) - float(multipliers @ unit.bounds)
    sizes = np.maximum(np.abs(unit.bounds), 1.0)
    gap = abs(cost - bound) / (1.0 + cost + float(multipliers @ sizes))
    violation = float(np.max(excess / sizes, initial=0.0))
    return Certificate(point, multipliers, cost, bound, max(violation, stationary, gap))


def own_certificate(qp: Qp, unit: Unit, x: Array, multipliers: Array) -> Certificate:
    """Compute the residuals of a solution of the QP."""
    sided = unit.signs * multipliers[unit.sources] * unit.lengths / unit.scale
    return certificate(unit, unit.C.T @ x / unit.scale, np.maximum(sided, 0.0))


def by_daqp(unit: Unit) -> Certificate | None:
    """Solve with the library DAQP; None if it reports no solution."""
    n, k = len(unit.start), len(unit.bounds)
    x, _, flag, info = daqp.solve(
        np.eye(n),
        -unit.start,
        np.ascontiguousarray(unit.rows),
        unit.bounds,
        np.full(k, -1e30),
        np.zeros(k, np.int32),
        primal_tol=1e-10,
    )
    return certificate(unit, x, np.maximum(info["lam"], 0.0)) if flag == 1 else None


def by_nnls(unit: Unit) -> Certificate | None:
    """Solve as least distance programming by non-negative least squares.

    Source: Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23. The point is then
    computed again from the rows with a positive multiplier. None if the problem is infeasible or
    the iteration limit is reached.
    """
    columns = np.vstack((-unit.rows.T, unit.rows @ unit.start - unit.bounds))
    target = np.append(np.zeros(len(unit.start)), 1.0)
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(lengths > 0, lengths, 1.0)
    try:
        y, _ = nnls(columns, target)
    except RuntimeError:
        return None
    active = y > 0
    rows, way = unit.rows[active], unit.bounds[active] - unit.rows[active] @ unit.start
    point = unit.start + np.linalg.lstsq(rows, way, rcond=None)[0]
    multipliers = np.zeros(len(y))
    multipliers[active] = nnls(rows.T, unit.start - point)[0]
    return certificate(unit, point, multipliers)


def disagreement(unit: Unit, one: Certificate, other: Certificate) -> float:
    """Return how much half the squared distance of two solutions exceeds its bounds.

    For any point w and multipliers lambda >= 0: |w - start + rows' lambda|^2 / 2 <=
    cost(w) - dual bound(lambda) + lambda' (rows w - bounds), as the Lagrangian is strongly convex.
    """
    return max(crossed(unit, one, other), crossed(unit, other, one))


def crossed(unit: Unit, one: Certificate, other: Certificate) -> float:
    """Return the excess for the point of one solution and the multipliers of the other."""
    away = one.point - unit.start + unit.rows.T @ other.multipliers
    excess = unit.rows @ one.point - unit.bounds
    pressing = float(other.multipliers @ np.maximum(excess, 0.0))
    rounding = ROUNDING * float(other.multipliers @ np.maximum(np.abs(unit.bounds), 1.0))
    return 0.5 * float(away @ away) - (one.cost - other.bound) - pressing - rounding
