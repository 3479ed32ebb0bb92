"""The two solvers against SciPy, a library, each other, and the Kuhn-Tucker conditions."""

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import daqp
import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, linprog, minimize

from ampc_msgs_config.types import Array
from ampc_ros.mpc.qp import INFEASIBLE, NOT_CONVEX, SOLVED, UNFINISHED, Qp
from tests.filled import (
    QpSolution,
    active_set,
    descent_solution,
    hildreth_solution,
    laguerre_sequence,
    running_sum,
)
from tests.workshop.proofs.prove_qp import main as prove_qp
from tests.workshop.proofs.prove_qp import verdicts
from tests.workshop.proofs.qp_problems import KINDS as DEGENERATE_KINDS

TWO_SIDED = ("two sides", "equal bounds", "shared slack")
KINDS = ("plain", "tight", "degenerate", "whole numbers", *TWO_SIDED, "badly scaled")
"""Random QPs; the last kind is too hard for comparisons to nine digits."""
Solver = Callable[[Qp], QpSolution]


def paper_hildreth(qp: Qp) -> QpSolution:
    """Hildreth's procedure with the authors' settings."""
    return hildreth_solution(qp, 38, 1e-7)


both_solvers = pytest.mark.parametrize("solver", [active_set, paper_hildreth])
many = settings(max_examples=100, deadline=None, derandomize=True)


def few(n: int) -> int:
    """Return a number of cases; a tenth without compilation, which is slower."""
    return n // 10 if numba.config.DISABLE_JIT else n  # type: ignore[attr-defined]


def random_problem(rng: np.random.Generator, kind: str) -> Qp:
    """Create a feasible QP of random size; all rows contain a point x_0, some with equality."""
    n, m = int(rng.integers(1, 9)), int(rng.integers(0, 60))
    B = rng.standard_normal((n, n)) + 0.3 * np.eye(n)
    if kind == "badly scaled":
        B = B @ np.diag(10 ** rng.uniform(-3, 0, n))
    E, K = B @ B.T + 1e-6 * np.trace(B @ B.T) * np.eye(n), 10 * rng.standard_normal(n)
    M, x_0 = rng.standard_normal((m, n)), rng.standard_normal(n)
    if kind == "whole numbers":
        M, x_0 = np.rint(M), np.rint(x_0)
    room = rng.uniform(0, 2, m) * (rng.random(m) < (0.2 if kind == "tight" else 0.8))
    if kind == "degenerate" and m > 6:
        M[1] = 0.0  # holds everywhere
        M[2], room[2] = -M[0], 0.0  # an equation together with row 0
        room[0] = 0.0
        M[3], room[3] = 3 * M[4], 3 * room[4]  # twice the same
        M[5], room[5] = M[0] + M[4], room[4]  # follows from two others
    factor = 10 ** rng.uniform(-6, 6) if kind == "badly scaled" else 1.0
    qp = upper(factor * E, factor * K, M, M @ x_0 + room)
    return two_sided(rng, qp, M @ x_0, kind) if kind in TWO_SIDED else qp


def upper(E: Array, K: Array, M: Array, gamma: Array) -> Qp:
    """Return a QP with M x <= gamma, as Eq. (17) prints it."""
    return Qp(E, K, M, np.full(len(gamma), -np.inf), gamma)


def two_sided(rng: np.random.Generator, qp: Qp, value: Array, kind: str) -> Qp:
    """Return a QP with lower bounds as well, which hold at the point with these row values."""
    m, n = qp.M.shape
    low = value - rng.uniform(0, 2, m) * (rng.random(m) < 0.7)
    if kind == "equal bounds":
        equations = rng.permutation(m)[: n // 2]
        low[equations] = qp.high[equations] = value[equations]
    if kind != "shared slack":
        open_low, open_high = rng.random(m) < 0.2, rng.random(m) < 0.2
        low, high = np.where(open_low, -np.inf, low), np.where(open_high, np.inf, qp.high)
        return qp._replace(low=low, high=high)
    none, one = np.zeros((m, 1)), np.ones((m, 1))
    rows = np.block([[qp.M, -one], [qp.M, one], [np.zeros((1, n)), np.ones((1, 1))]])
    centre, width = rng.standard_normal(m), rng.uniform(0, 0.5, m)  # needs the slack
    return Qp(
        np.block([[qp.E, np.zeros((n, 1))], [np.zeros((1, n)), 200 * np.ones((1, 1))]]),
        np.append(qp.K, 0.0),
        np.vstack((rows, np.hstack((qp.M, none)))),
        np.concatenate((np.full(m, -np.inf), centre - width, [0.0], low)),
        np.concatenate((centre + width, np.full(m + 1, np.inf), qp.high)),
    )


def excess(value: Array, bound: Array, size: Array) -> Array:
    """Return the relative excess of values over their bounds; -inf without a bound."""
    finite = np.isfinite(bound)
    limit = np.where(finite, bound, 0.0)
    return np.where(finite, (value - limit) / (size + np.abs(limit)), -np.inf)


def kuhn_tucker_residual(qp: Qp, solution: QpSolution) -> float:
    """Return the residual of Eq. (30), each line relative to the size of its terms.

    The sum of the absolute values of a line's terms is that size; for rows, the length of the
    way from the unconstrained minimum to zero in the metric of E is added, on which they act.
    """
    E, K, M, low, high = qp
    x, multipliers = solution.x, solution.multipliers
    gradient = E @ x + K + M.T @ multipliers
    size = np.abs(E) @ np.abs(x) + np.abs(K) + np.abs(M.T) @ np.abs(multipliers)
    reach = np.sqrt(K @ np.linalg.solve(E, K) * np.sum(M.T * np.linalg.solve(E, M.T), axis=0))
    size_of_row = np.abs(M) @ np.abs(x) + reach + 1e-300
    above, below = excess(M @ x, high, size_of_row), excess(-M @ x, -low, size_of_row)
    stationary = float(np.max(np.abs(gradient) / (size + 1e-300), initial=0.0))
    feasible = float(max(np.max(above, initial=0.0), np.max(below, initial=0.0)))
    at_upper = float(np.max(np.abs(above[multipliers > 0]), initial=0.0))
    at_lower = float(np.max(np.abs(below[multipliers < 0]), initial=0.0))
    return max(stationary, feasible, at_upper, at_lower)


@pytest.mark.parametrize("kind", KINDS)
def test_exact_solver_keeps_the_kuhn_tucker_conditions_on_random_problems(kind: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(few(500)):
        qp = random_problem(rng, kind)
        solution = active_set(qp)
        assert solution.converged
        assert kuhn_tucker_residual(qp, solution) < 1e-9


def test_exact_solver_agrees_with_daqp_on_500_random_problems() -> None:
    rng = np.random.default_rng(2)
    for i in range(few(500)):
        qp = random_problem(rng, KINDS[i % 7])
        sense = np.zeros(len(qp.low), np.int32)
        high, low = np.minimum(qp.high, 1e30), np.maximum(qp.low, -1e30)
        expected, _, flag, _ = daqp.solve(qp.E, qp.K, qp.M, high, low, sense)
        assert flag == 1
        x = active_set(qp).x
        np.testing.assert_allclose(x, expected, atol=1e-9 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("kind", KINDS[:-1])
def test_exact_solver_returns_the_solution_of_the_only_valid_active_set(kind: str) -> None:
    """Every set of at most n rows is tried as the active set, with Eqs. (28) and (29)."""
    rng = np.random.default_rng(3)
    problems = (random_problem(rng, kind) for _ in range(few(2000)))
    for qp in (qp for qp in problems if len(qp.K) <= 3 and len(qp.M) <= 8):
        candidates = list(points_of_all_active_sets(qp))
        assert candidates
        for x in candidates:
            np.testing.assert_allclose(active_set(qp).x, x, atol=1e-6)


def points_of_all_active_sets(qp: Qp) -> Iterator[Array]:
    """Yield the points that satisfy Eq. (30), with each side of a row as a separate row."""
    E, K, sides = qp.E, qp.K, np.append(np.isfinite(qp.high), np.isfinite(qp.low))
    M, gamma = np.vstack((qp.M, -qp.M))[sides], np.append(qp.high, -qp.low)[sides]
    for rows in active_sets(len(gamma), len(K)):
        H = M[rows] @ np.linalg.solve(E, M[rows].T)
        if len(rows) and np.linalg.cond(H) > 1e10:
            continue
        multipliers = -np.linalg.solve(H, gamma[rows] + M[rows] @ np.linalg.solve(E, K))
        x = -np.linalg.solve(E, K + M[rows].T @ multipliers)
        if (multipliers >= -1e-9).all() and (M @ x <= gamma + 1e-9).all():
            yield x


def active_sets(m: int, n: int) -> Iterator[list[int]]:
    """Yield all sets of at most n of m rows."""
    for size in range(min(m, n) + 1):
        yield from map(list, itertools.combinations(range(m), size))


@pytest.mark.parametrize(("kind", "digits"), [("plain", 1e-5), ("two sides", 1e-4)])
@pytest.mark.parametrize("seed", range(2))
def test_exact_solver_agrees_with_scipy(kind: str, digits: float, seed: int) -> None:
    E, K, M, low, high = qp = random_problem(np.random.default_rng(100 + seed), kind)
    options: Any = {"gtol": 1e-10, "xtol": 1e-12, "barrier_tol": 1e-11, "maxiter": 2000}
    result: Any = minimize(
        lambda x: float(0.5 * x @ E @ x + K @ x),
        np.zeros(len(K)),
        jac=lambda x: np.asarray(E @ x + K),
        hess=lambda x: E,
        constraints=LinearConstraint(M, low, high),
        method="trust-constr",  # type: ignore[call-overload]
        options=options,
    )
    x = active_set(qp).x
    np.testing.assert_allclose(x, result.x, atol=digits * (1 + np.abs(x).max()))


@many
@given(scale=st.floats(1e-8, 1e8), seed=st.integers(0, 2**32 - 1))
def test_scale_of_the_cost_does_not_move_the_minimum(scale: float, seed: int) -> None:
    qp = random_problem(np.random.default_rng(seed), "degenerate")
    plain = active_set(qp)
    scaled = active_set(qp._replace(E=scale * qp.E, K=scale * qp.K))
    assert scaled.converged
    np.testing.assert_allclose(scaled.x, plain.x, atol=1e-7 * (1 + np.abs(plain.x).max()))


def infeasible_problem(rng: np.random.Generator) -> tuple[Qp, float]:
    """Create an infeasible QP; return it and the smallest violation of its rows."""
    qp = random_problem(rng, "plain")
    m, n = max(len(qp.M), 2), len(qp.K)
    M, gamma = rng.standard_normal((m, n)), rng.standard_normal(m) - rng.uniform(0, 1)
    M[-1], gamma[-1] = -M[0], -gamma[0] - 10 ** rng.uniform(-4, 0)
    lengths = np.linalg.norm(M, axis=1)
    depth = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=np.column_stack((M, -lengths)),
        b_ub=gamma,
        bounds=(None, None),
    )
    return upper(qp.E, qp.K, M, gamma), float(depth.fun)


def test_infeasible_problems_are_detected() -> None:
    rng = np.random.default_rng(4)
    for _ in range(few(200)):
        qp, depth = infeasible_problem(rng)
        assert depth > 1e-6
        assert active_set(qp).status == INFEASIBLE
        mirrored = qp._replace(M=-qp.M, low=-qp.high, high=-qp.low)
        assert active_set(mirrored).status == INFEASIBLE


def test_two_equations_that_contradict_each_other_are_infeasible() -> None:
    rows, bounds = np.array([[1.0, 2.0], [2.0, 4.0]]), np.array([1.0, 2.1])
    qp = Qp(np.eye(2), np.ones(2), rows, bounds, bounds)
    assert active_set(qp).status == INFEASIBLE
    assert active_set(qp._replace(low=np.array([1.0, 2.0]), high=np.array([1.0, 2.0]))).converged


@both_solvers
def test_row_whose_sides_contradict_each_other_is_infeasible(solver: Solver) -> None:
    one = np.ones(1)
    for start in (-5.0, 0.0, 5.0):
        assert solver(Qp(np.eye(1), -start * one, np.eye(1), one, -one)).status == INFEASIBLE


def test_row_that_is_violated_as_much_as_one_of_larger_numbers_is_not_passed_over() -> None:
    M, high = np.array([[1e6, 0.0], [0.0, 1e-3]]), np.array([1e12 - 1.0, 999.0])
    x = active_set(upper(np.eye(2), np.full(2, -1e6), M, high)).x
    np.testing.assert_allclose(x, [1e6, 999e3], rtol=1e-11)


def test_row_of_zeros_with_a_negative_bound_is_infeasible() -> None:
    qp = upper(np.eye(2), np.zeros(2), np.zeros((1, 2)), np.array([-1.0]))
    assert active_set(qp).status == INFEASIBLE
    assert active_set(qp._replace(high=np.array([0.0]))).converged
    assert active_set(qp._replace(low=np.array([1.0]), high=np.array([2.0]))).status == INFEASIBLE


@both_solvers
@pytest.mark.parametrize(
    "E",
    [
        [[1.0, 2.0], [2.0, 1.0]],
        [[1.0, 1.0], [1.0, 1.0]],
        [[0.0, 0.0], [0.0, 1.0]],
        [[-1.0, 0.0], [0.0, 1.0]],
    ],
    ids=["indefinite", "singular", "flat", "negative"],
)
def test_qp_that_is_not_strictly_convex_is_rejected(solver: Solver, E: list[list[float]]) -> None:
    qp = upper(np.array(E), np.ones(2), np.eye(2), np.ones(2))
    solution = solver(qp)
    assert solution.status == NOT_CONVEX
    assert np.isfinite(solution.x).all()


@both_solvers
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_never_a_solution(solver: Solver, bad: float) -> None:
    qp = upper(np.eye(2), np.array([bad, 0.0]), np.eye(2), np.ones(2))
    assert solver(qp).status == UNFINISHED


def test_qp_without_rows_is_solved_without_iterations() -> None:
    qp = upper(2 * np.eye(2), np.array([2.0, 4.0]), np.zeros((0, 2)), np.zeros(0))
    solution = active_set(qp)
    np.testing.assert_allclose(solution.x, [-1.0, -2.0])
    assert solution.iterations == 0


def disagreement(qp: Qp, one: QpSolution, other: QpSolution) -> float:
    """Return the distance of two points in the metric of E, over the way from start to zero."""
    difference = one.x - other.x
    return float(np.sqrt(difference @ qp.E @ difference / (qp.K @ np.linalg.solve(qp.E, qp.K))))


@pytest.mark.parametrize("kind", KINDS)
def test_hildreth_is_exact_if_it_reports_convergence(kind: str) -> None:
    for sweeps in (1, 38, 2000):
        rng, converged = np.random.default_rng(5), 0
        for _ in range(few(200)):
            qp = random_problem(rng, kind)
            solution = hildreth_solution(qp, sweeps, 1e-7)
            assert solution.iterations <= sweeps
            if solution.converged:
                converged += 1
                assert disagreement(qp, solution, active_set(qp)) < 1e-5
        rare = sweeps == 1 or kind == "shared slack"  # which takes thousands of sweeps
        assert converged > (0 if rare else 20) or few(200) < 200


def test_hildreth_never_reports_convergence_on_an_infeasible_problem() -> None:
    rng = np.random.default_rng(6)
    for _ in range(few(100)):
        qp, _ = infeasible_problem(rng)
        for sweeps in (1, 38, 2000):
            assert hildreth_solution(qp, sweeps, 1e-7).status == UNFINISHED


def textbook_sweeps(E: Array, K: Array, M: Array, gamma: Array, sweeps: int) -> Array:
    """Return the multipliers by Eq. (29) with H = M E^-1 M', one after the other, in numpy."""
    H, d = M @ np.linalg.solve(E, M.T), gamma + M @ np.linalg.solve(E, K)
    multipliers = np.zeros(len(gamma))
    for _ in range(sweeps):
        for i in range(len(gamma)):
            others = H[i] @ multipliers - H[i, i] * multipliers[i]
            multipliers[i] = max(0.0, -(d[i] + others) / H[i, i])
    return multipliers


def test_hildreth_steps_are_those_of_the_textbook() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        qp = random_problem(rng, "plain")
        multipliers = textbook_sweeps(qp.E, qp.K, qp.M, qp.high, 3)
        x = -np.linalg.solve(qp.E, qp.K + qp.M.T @ multipliers)
        solution = hildreth_solution(qp, 3, 0.0)
        np.testing.assert_allclose(solution.multipliers, multipliers, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(solution.x, x, rtol=1e-6, atol=1e-6)


def test_hildreth_takes_lower_bounds_as_upper_ones_of_the_mirrored_rows() -> None:
    rng = np.random.default_rng(9)
    for _ in range(50):
        qp = random_problem(rng, "tight")
        mirrored = qp._replace(M=-qp.M, low=-qp.high, high=-qp.low)
        one, other = hildreth_solution(qp, 5, 0.0), hildreth_solution(mirrored, 5, 0.0)
        np.testing.assert_array_equal(other.x, one.x)
        np.testing.assert_array_equal(other.multipliers, -one.multipliers)


def test_hildreth_needs_no_sweep_where_no_row_is_violated() -> None:
    qp = Qp(np.eye(2), np.array([-0.5, 0.5]), np.eye(2), -np.ones(2), np.ones(2))
    solution = hildreth_solution(qp, 38, 1e-7)
    assert (solution.converged, solution.iterations) == (True, 0)
    np.testing.assert_allclose(solution.x, [0.5, -0.5])


@both_solvers
def test_nearest_point_of_a_box_is_the_clipped_one(solver: Solver) -> None:
    K = np.array([-3.0, 0.2, 5.0])
    one_sided = upper(np.eye(3), K, np.vstack((np.eye(3), -np.eye(3))), np.ones(6))
    both_sided = Qp(np.eye(3), K, np.eye(3), -np.ones(3), np.ones(3))
    for qp, multipliers in ((one_sided, [2, 0, 0, 0, 0, 4]), (both_sided, [2, 0, -4])):
        solution = solver(qp)
        np.testing.assert_allclose(solution.x, np.clip(-K, -1.0, 1.0), atol=1e-12)
        np.testing.assert_allclose(solution.multipliers, multipliers, atol=1e-12)


@pytest.mark.parametrize("kind", TWO_SIDED)
def test_multiplier_is_positive_at_the_upper_and_negative_at_the_lower_bound(kind: str) -> None:
    rng = np.random.default_rng(10)
    signs = set()
    for _ in range(few(200)):
        qp = random_problem(rng, kind)
        solution = active_set(qp)
        assert solution.status == SOLVED
        value, held = qp.M @ solution.x, solution.multipliers
        np.testing.assert_allclose(value[held > 0], qp.high[held > 0], atol=1e-6)
        np.testing.assert_allclose(value[held < 0], qp.low[held < 0], atol=1e-6)
        signs |= set(np.sign(held))
    assert signs == {-1.0, 0.0, 1.0}


def test_no_feasible_point_nearby_costs_less() -> None:
    rng = np.random.default_rng(8)
    for i in range(50):
        E, K, M, low, high = qp = random_problem(rng, ("plain", "two sides")[i % 2])
        x = active_set(qp).x

        def cost(x: Array, E: Array = E, K: Array = K) -> float:
            return float(0.5 * x @ E @ x + K @ x)

        other = x + 0.1 * rng.standard_normal((100, len(x)))
        values = other @ M.T
        for point in other[((low <= values) & (values <= high)).all(axis=1)]:
            assert cost(point) >= cost(x) - 1e-9 * (1 + abs(cost(x)))


@pytest.mark.parametrize("kind", DEGENERATE_KINDS[:-1])
def test_degenerate_problems_that_zero_satisfies_are_solved(kind: str) -> None:
    """The complete proof, 10^5 problems, is `python -m tests.workshop.proofs.prove_qp`."""
    results = list(verdicts(kind, few(500), seed=7))
    assert all(result.status == SOLVED for result in results)
    assert not any(result.wrong for result in results)
    same_as_daqp = sum(result.equal[0] for result in results)
    assert same_as_daqp > 0.9 * len(results)
    assert sum(result.equal[1] for result in results) > 0.5 * len(results)


def test_the_proof_of_the_solver_reports_success_as_exit_code(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert prove_qp(["--problems", "20", "--seed", "3"]) == 0
    assert "unfinished" in capsys.readouterr().out


def rate_limited_rows(lateness: float) -> Qp:
    """Return a QP of a nominal angle that changes at the largest increment, up then down.

    Late increments of Laguerre functions nearly vanish, so the rows that are tight at x = 0 are
    nearly dependent. `lateness` shifts the bounds beyond 0, as rounding does [rad].
    """
    L = laguerre_sequence(0.3, 6, 20)
    S, step = running_sum(L), 0.08
    up = np.array([0.4, -0.9, 0.9, 0.9, 0.6, 1.0, -1.0, 1.0, -1.0, 1.0] + 10 * [1.0]) * step
    M = np.empty((40, 6))
    M[::2], M[1::2] = L, S
    angle = np.cumsum(up)
    low, high = np.empty(40), np.empty(40)
    low[::2], high[::2] = -step - up + lateness, step - up - lateness
    low[1::2], high[1::2] = -2.0 - angle, 2.0 - angle
    E = 500.0 * np.eye(6) + 1e4 * S.T @ S
    return Qp(E, 1e4 * np.array([1.7, 1.4, 1.1, 0.9, 0.7, 0.5]), M, low, high)


@pytest.mark.parametrize("lateness", [0.0, 1e-17, 1e-15])
def test_rows_of_a_nominal_angle_at_the_rate_limit_are_never_infeasible(lateness: float) -> None:
    for sign in (1.0, -1.0):
        qp = rate_limited_rows(lateness)
        qp = qp._replace(K=sign * qp.K)
        solution = active_set(qp)
        assert solution.status == SOLVED
        assert kuhn_tucker_residual(qp, solution) < 1e-9


@pytest.mark.parametrize("kind", ["plain", "tight", "degenerate", "two sides", "shared slack"])
def test_primal_method_finds_the_solution_of_the_dual_one(kind: str) -> None:
    rng = np.random.default_rng(12)
    for _ in range(few(300)):
        qp = random_problem(rng, kind)
        inside = qp._replace(low=np.minimum(qp.low, 0.0), high=np.maximum(qp.high, 0.0))
        expected = active_set(inside)
        x, status = descent_solution(inside)
        assert (status, expected.status) == (SOLVED, SOLVED)
        assert disagreement(inside, QpSolution(x, *expected[1:]), expected) < 1e-7


def test_primal_method_starts_with_the_slack_that_the_soft_rows_need() -> None:
    rng = np.random.default_rng(13)
    for _ in range(few(200)):
        qp = random_problem(rng, "shared slack")
        hard = np.abs(qp.M[:, -1]) == 0.0
        low, high = np.where(hard, -np.inf, qp.low), np.where(hard, np.inf, qp.high)
        soft = qp._replace(low=low, high=high)
        x, status = descent_solution(soft)
        assert status == SOLVED
        assert disagreement(soft, QpSolution(x, *active_set(soft)[1:]), active_set(soft)) < 1e-7


def test_primal_method_needs_a_feasible_start() -> None:
    far = Qp(np.eye(2), np.zeros(2), np.eye(2), np.full(2, 1.0), np.full(2, 2.0))
    assert descent_solution(far)[1] == INFEASIBLE
    assert active_set(far).status == SOLVED
