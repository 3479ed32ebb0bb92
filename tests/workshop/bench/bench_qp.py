"""Solvers of one quadratic program, and its exact first move with a bound of the error.

`prepare` converts the matrices into the form that a solver needs; this is not timed. Its result is
a call without arguments, which is timed and returns x, or None if the solver reports no solution.
"""

import importlib.util
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import daqp
import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csc_matrix

from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import Qp
from tests.workshop.bench.bench_ours import qp_alone

Answer = Callable[[], Array | None]
Settings = dict[str, Any]
OSQP_TIGHT = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000}
TIGHT = {"primal_tol": 1e-12, "dual_tol": 1e-13}
ON_BOUND = 1e-9
"""Relative distance to its bound below which a row counts as active."""
WRONG = 1e-3
"""Error of the first move from which an answer is wrong [rad]."""
LARGEST_DOUBT = 1e-4
"""Largest error bound of a reference, a tenth of a wrong answer [rad]."""


class Solver(NamedTuple):
    """A solver of the table."""

    name: str
    package: str
    """Required package."""
    call: str
    """Description of the timed call."""
    prepare: Callable[[Qp], Answer]
    slow: bool = False
    """True for fewer repetitions."""


def with_daqp(qp: Qp) -> Answer:
    """Prepare DAQP, a dual active-set method in C."""
    return partial(solve_daqp, qp.E, qp.K, qp.M, qp.high, qp.low)


def solve_daqp(*matrices: Array) -> Array | None:
    """Solve with default settings."""
    x, _, flag, _ = daqp.solve(*matrices)
    return np.asarray(x) if flag > 0 else None


def daqp_inside(problems: Sequence[Qp], rounds: int) -> Array:
    """Return the durations that DAQP reports, without the call from Python, (rounds, m) [us]."""
    times = np.empty((rounds, len(problems)))
    for k in range(rounds):
        for i, qp in enumerate(problems):
            *_, report = daqp.solve(qp.E, qp.K, qp.M, qp.high, qp.low)
            times[k, i] = 1e6 * (report["setup_time"] + report["solve_time"])
    return times


def with_quadprog(qp: Qp) -> Answer:
    """Prepare quadprog, the method of Goldfarb and Idnani in C: -K, M' as columns, >=."""
    import quadprog

    M, gamma = one_sided(qp)
    arguments = (qp.E, -qp.K, np.ascontiguousarray(-M.T), -gamma)

    def solve() -> Array | None:
        try:
            x: Array = quadprog.solve_qp(*arguments)[0]
        except ValueError:  # constraints are inconsistent
            return None
        return x

    return solve


def with_osqp(workspaces: dict[tuple[int, ...], Any], settings: Settings, qp: Qp) -> Answer:
    """Prepare OSQP, operator splitting in C; the workspace is reused and all numbers updated."""
    import osqp

    E, A = upper_triangle(qp.E), full(qp.M)
    if A.shape not in workspaces:
        workspaces[A.shape] = osqp.OSQP()
        workspaces[A.shape].setup(E, qp.K, A, qp.low, qp.high, verbose=False, **settings)
    solver = workspaces[A.shape]

    def solve() -> Array | None:
        solver.update(q=qp.K, l=qp.low, u=qp.high, Px=E.data, Ax=A.data)
        result = solver.solve(raise_error=False)
        return result.x if result.info.status_val == osqp.SolverStatus.OSQP_SOLVED else None

    return solve


def full(A: Array) -> Any:
    """Return the sparse form (m, n) with explicit zeros, so that the structure is constant."""
    m, n = A.shape
    rows = np.tile(np.arange(m), n)
    return csc_matrix((A.ravel(order="F"), rows, m * np.arange(n + 1)), shape=(m, n))


def upper_triangle(E: Array) -> Any:
    """Return the upper triangle of (n, n) in sparse form with explicit zeros."""
    n = len(E)
    columns, rows = np.tril_indices(n)
    values: Array = E[rows, columns]
    return csc_matrix((values, rows, np.cumsum(np.arange(n + 1))), shape=(n, n))


def with_piqp(qp: Qp) -> Answer:
    """Prepare PIQP, a dense proximal interior-point method in C++."""
    import piqp

    E, A = np.asfortranarray(qp.E), np.asfortranarray(qp.M)

    def solve() -> Array | None:
        solver = piqp.DenseSolver()
        solver.setup(E, qp.K, G=A, h_l=qp.low, h_u=qp.high)
        return solver.result.x if solver.solve() == piqp.PIQP_SOLVED else None

    return solve


OSQP_CALLS = "OSQP.update and solve"
SOLVERS = (
    Solver("ours", "numba", "active_set", qp_alone),
    Solver("DAQP", "daqp", "daqp.solve", with_daqp),
    Solver("quadprog", "quadprog", "quadprog.solve_qp", with_quadprog),
    Solver("OSQP, default settings", "osqp", OSQP_CALLS, partial(with_osqp, {}, {}), slow=True),
    Solver("OSQP, 1e-9", "osqp", OSQP_CALLS, partial(with_osqp, {}, OSQP_TIGHT), slow=True),
    Solver("PIQP", "piqp", "DenseSolver, setup and solve", with_piqp),
)


def installed(package: str) -> bool:
    """Check whether a package is installed."""
    return importlib.util.find_spec(package) is not None


def missing(packages: set[str]) -> str:
    """Return a note on packages that are not installed."""
    absent = sorted(package for package in packages if not installed(package))
    return f"Not installed and omitted: {', '.join(absent)}." if absent else ""


def exact_move(qp: Qp, L_0: Array) -> tuple[float, float, int]:
    """Solve with DAQP at tight tolerances, and verify the optimality conditions.

    Returns:
        First move L(0)' x [rad], bound of its error [rad], and number of active rows.

    Raises:
        ArithmeticError: The error bound is too large.
    """
    x, _, flag, _ = daqp.solve(qp.E, qp.K, qp.M, qp.high, qp.low, **TIGHT)
    doubt, active = certificate(qp, x, L_0) if flag > 0 else (math.inf, 0)
    if not doubt < LARGEST_DOUBT:
        raise ArithmeticError(f"reference: DAQP's flag {flag}, error up to {doubt:.1e} rad")
    return float(L_0 @ x), doubt, active


def certificate(qp: Qp, x: Array, L_0: Array) -> tuple[float, int]:
    """Return a bound of the error of L(0)' x [rad], and the number of active rows.

    The multipliers of the active rows are the non-negative ones that minimise the residual r of
    the gradient. As E is positive definite, the distance of x from the solution in the norm of E
    is at most the norm of E^-1 r plus the root of the sum of multiplier times distance to the
    bound. The bound of an infeasible point is infinite.
    """
    M, gamma = one_sided(qp)
    slack = gamma - M @ x
    size = 1.0 + np.abs(gamma)
    active = slack < ON_BOUND * size
    r, gap = qp.E @ x + qp.K, 0.0
    if active.any():
        multipliers, _ = nnls(M[active].T, -r)
        r = r + M[active].T @ multipliers
        gap = float(multipliers @ np.abs(slack[active]))
    distance = math.sqrt(r @ np.linalg.solve(qp.E, r)) + math.sqrt(gap)
    bound = distance * math.sqrt(L_0 @ np.linalg.solve(qp.E, L_0))
    return (bound if (slack > -ON_BOUND * size).all() else math.inf), int(active.sum())


def one_sided(qp: Qp) -> tuple[Array, Array]:
    """Return rows and bounds of M x <= gamma."""
    upper, lower = np.isfinite(qp.high), np.isfinite(qp.low)
    M = np.vstack((qp.M[upper], -qp.M[lower]))
    return np.ascontiguousarray(M), np.append(qp.high[upper], -qp.low[lower])
