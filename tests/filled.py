"""Functions of the controller that fill arrays, wrapped as functions that return new arrays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.types import Array
from ampc_ros.mpc import active_set as exact_solver
from ampc_ros.mpc import constraints, hildreth, laguerre, model, prediction
from ampc_ros.mpc.active_set import active_set_numbers
from ampc_ros.mpc.descent import descend, feasible_start, relaxed_rows
from ampc_ros.mpc.internal_model import Actuator
from ampc_ros.mpc.model import STATES, BicycleParameters
from ampc_ros.mpc.qp import INFEASIBLE, SOLVED, Qp, nearest_point
from ampc_ros.mpc.small_matrices import Scratch, backward, make_scratch, vector
from ampc_ros.mpc.working_set import no_active_rows
from ampc_ros.preview import model as preview_model
from ampc_ros.preview.model import SampledModel

ENOUGH = 4000
"""Size of the scratch memory of all functions here except the solvers."""


class QpSolution(NamedTuple):
    """Solution of a QP; x is the minimiser only if `converged`."""

    x: Array
    """(n,)."""
    multipliers: Array
    """lambda of Eq. (30), (m,): positive at the upper bound, negative at the lower one."""
    iterations: int
    """Number of rows that entered the active set, or of sweeps."""
    status: int
    """SOLVED, INFEASIBLE, UNFINISHED or NOT_CONVEX."""

    @property
    def converged(self) -> bool:
        """Whether x is the minimiser."""
        return self.status == SOLVED


def laguerre_sequence(alpha: float, N: int, steps: int) -> Array:
    """Return the Laguerre functions (steps, N)."""
    L = np.full((steps, N), np.nan)
    laguerre.laguerre_sequence(alpha, L)
    return L


def running_sum(L: Array) -> Array:
    """Return the running sum of the Laguerre functions (N_c, N)."""
    S = np.full(L.shape, np.nan)
    constraints.running_sum(L, S)
    return S


def lateral_dynamics(vehicle: BicycleParameters, v_x: float) -> tuple[Array, Array]:
    """Return A_c (4, 4) and B_c (4,)."""
    A, B = np.zeros((4, 4)), np.zeros(4)
    model.lateral_dynamics(vehicle, v_x, A, B)
    return A, B


def exponential_integrals(D: Array, T: float) -> Array:
    """Return e^(D T) and its first three integrals (4, n, n)."""
    Phi = np.zeros((4, *D.shape))
    model.exponential_integrals(D, T, Phi, make_scratch(ENOUGH))
    return Phi


def zero_order_hold(
    vehicle: BicycleParameters, v_x: float, T: float, lag: float = 0.0
) -> tuple[Array, Array]:
    """Return A_k (5, 5) and B (5,)."""
    A, B = np.zeros((STATES, STATES)), np.zeros(STATES)
    model.zero_order_hold(vehicle, v_x, lag, T, A, B, make_scratch(ENOUGH))
    return A, B


def augment(A_k: Array, B: Array) -> tuple[Array, Array]:
    """Return A~ (5, 5) and B~ (5,)."""
    A_augmented, B_augmented = np.zeros((STATES, STATES)), np.full(STATES, np.nan)
    model.augment(A_k, B, A_augmented, B_augmented)
    return A_augmented, B_augmented


def predict(A: Array, B: Array, L: Array, x: Array, N_p: int) -> tuple[Array, Array]:
    """Return F x (N_p,) and Phi (N_p, N)."""
    free, Phi = np.full(N_p, np.nan), np.zeros((L.shape[1], N_p))
    prediction.predict(A, B, L, x, free, Phi, make_scratch(ENOUGH))
    return free, Phi.T


def quadratic_cost(Phi: Array, error: Array, L: Array, Q: float, R: float) -> tuple[Array, Array]:
    """Return E (N, N) and K (N,) for Phi (N_p, N)."""
    N = L.shape[1]
    E, K = np.full((N, N), np.nan), np.full(N, np.nan)
    prediction.quadratic_cost(np.ascontiguousarray(Phi.T), error, L, (Q, R), E, K)
    return E, K


def sampled_model(
    vehicle: BicycleParameters, v_x: float, T: float, actuator: Actuator
) -> SampledModel:
    """Return the model of one step of T [s]."""
    blank = SampledModel(np.full((STATES, STATES), np.nan), *np.zeros((3, STATES)))
    preview_model.sample_model(vehicle, v_x, T, actuator, blank, make_scratch(ENOUGH))
    return blank


def solver_memory(m: int, n: int) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Allocate the memory of `solve_in` for m rows of n unknowns: x, multipliers, scratch."""
    return np.zeros(n), np.zeros(m), *make_scratch(active_set_numbers(m, n))


@in_place
def solve_in(
    qp: tuple[Array, ...], memory: tuple[Array, Array, Array, NDArray[np.int64]]
) -> tuple[int, int]:
    """Call `active_set` from Python with plain tuples; see doc/compiled_code.md.

    Args:
        qp: Fields of a Qp.
        memory: From `solver_memory`; may be reused.

    Returns:
        Number of rows that entered, and the status.
    """
    x, multipliers, numbers, used = memory
    for i in range(len(multipliers)):
        multipliers[i] = 0.0
    return exact_solver.active_set(Qp(*qp), x, multipliers, Scratch(numbers, used))


def active_set(qp: Qp) -> QpSolution:
    """Solve a QP with the exact solver in newly allocated memory."""
    memory = solver_memory(*qp.M.shape)
    iterations, status = solve_in(tuple(qp), memory)
    return QpSolution(memory[0], memory[1], iterations, status)


@in_place
def descend_in(qp: tuple[Array, ...], x: Array, numbers: Array, used: NDArray[np.int64]) -> int:
    """Solve a QP that x = 0 satisfies with `descent` alone; return the status."""
    problem, scratch = Qp(*qp), Scratch(numbers, used)
    n = len(x)
    task = nearest_point(problem, scratch)
    active, w = no_active_rows(len(problem.low), n, scratch), vector(scratch, n)
    unit = relaxed_rows(problem, task, scratch)
    if not feasible_start(problem, task, unit, w):
        return INFEASIBLE
    _, status = descend(problem, task, unit, active, w, vector(scratch, n))
    backward(task.C, w, n, x)
    return int(status)


def descent_solution(qp: Qp) -> tuple[Array, int]:
    """Return the solution of the primal method and its status."""
    m, n = qp.M.shape
    x = np.zeros(n)
    status = descend_in(tuple(qp), x, *make_scratch(active_set_numbers(m, n)))
    return x, status


def hildreth_solution(qp: Qp, sweeps: int, tolerance: float) -> QpSolution:
    """Solve a QP with Hildreth's procedure."""
    m, n = qp.M.shape
    x, multipliers = np.zeros(n), np.zeros(m)
    scratch = make_scratch(hildreth.hildreth_numbers(m, n))
    done, status = hildreth.hildreth(qp, (sweeps, tolerance), x, multipliers, scratch)
    return QpSolution(x, multipliers, done, status)
