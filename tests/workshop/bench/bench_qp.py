"""Solvers of one quadratic programme, ours and others, behind one shape.

`prepare` brings the same matrices into the form that a solver wants and is not timed; what it
gives is a call without arguments, which is. The call answers with x, or with nothing where the
solver says that it has no solution.
"""

import importlib.util
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import daqp
import numpy as np
from scipy.sparse import csc_matrix

from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import Qp
from tests.workshop.bench.bench_ours import qp_alone
from tests.workshop.bench.bench_reference import one_sided

Answer = Callable[[], Array | None]
Settings = dict[str, Any]
OSQP_TIGHT = {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000}


class Solver(NamedTuple):
    """One row of the table."""

    name: str
    package: str
    """That has to be installed."""
    call: str
    """What is timed."""
    prepare: Callable[[Qp], Answer]
    slow: bool = False
    """Goes through the programmes less often."""


def with_daqp(qp: Qp) -> Answer:
    """DAQP, a dual active-set method in C."""
    return partial(solve_daqp, qp.E, qp.K, qp.M, qp.high, qp.low)


def solve_daqp(*matrices: Array) -> Array | None:
    """Solve, default settings."""
    x, _, flag, _ = daqp.solve(*matrices)
    return np.asarray(x) if flag > 0 else None


def daqp_inside(programmes: Sequence[Qp], rounds: int) -> Array:
    """What DAQP says that it needed, without the way there from Python, (rounds, m) [us]."""
    times = np.empty((rounds, len(programmes)))
    for k in range(rounds):
        for i, qp in enumerate(programmes):
            *_, told = daqp.solve(qp.E, qp.K, qp.M, qp.high, qp.low)
            times[k, i] = 1e6 * (told["setup_time"] + told["solve_time"])
    return times


def with_quadprog(qp: Qp) -> Answer:
    """Goldfarb and Idnani's own method, in C: maximal -K' x, M' as columns, >=."""
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
    """OSQP, an operator splitting in C; its workspace is kept and all numbers are updated."""
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
    """Sparse form (m, n) that keeps its zeros, so that one structure fits all numbers."""
    m, n = A.shape
    rows = np.tile(np.arange(m), n)
    return csc_matrix((A.ravel(order="F"), rows, m * np.arange(n + 1)), shape=(m, n))


def upper_triangle(E: Array) -> Any:
    """Upper triangle of (n, n) in sparse form that keeps its zeros."""
    n = len(E)
    columns, rows = np.tril_indices(n)
    values: Array = E[rows, columns]
    return csc_matrix((values, rows, np.cumsum(np.arange(n + 1))), shape=(n, n))


def with_piqp(qp: Qp) -> Answer:
    """PIQP, a proximal interior-point method in C++, dense."""
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
    """Whether a package is there."""
    return importlib.util.find_spec(package) is not None


def missing(packages: set[str]) -> str:
    """Say who could not take part."""
    absent = sorted(package for package in packages if not installed(package))
    return f"Not installed, left out: {', '.join(absent)}." if absent else ""
