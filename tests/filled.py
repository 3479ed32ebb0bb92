"""The core's functions, which fill arrays they are given, as functions that give new ones."""

import numpy as np

from ampc_msgs_config.paths.path import Array
from ampc_ros.mpc import constraints, hildreth, laguerre, model, prediction
from ampc_ros.mpc.active_set import solution_of
from ampc_ros.mpc.internal_model import Actuator
from ampc_ros.mpc.model import STATES, Vehicle
from ampc_ros.mpc.qp import Qp, QpSolution
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview import model as preview_model
from ampc_ros.preview.model import SampledModel

ENOUGH = 4000
"""Scratch numbers for any function here but the solvers."""


def laguerre_sequence(alpha: float, N: int, steps: int) -> Array:
    """Give the Laguerre functions (steps, N)."""
    L = np.full((steps, N), np.nan)
    laguerre.laguerre_sequence(alpha, L)
    return L


def running_sum(L: Array) -> Array:
    """Give the angles that the increments add up to (N_c, N)."""
    S = np.full(L.shape, np.nan)
    constraints.running_sum(L, S)
    return S


def lateral_dynamics(vehicle: Vehicle, v_x: float) -> tuple[Array, Array]:
    """Give A_c (4, 4) and B_c (4,)."""
    A, B = np.zeros((4, 4)), np.zeros(4)
    model.lateral_dynamics(vehicle, v_x, A, B)
    return A, B


def exponential_integrals(D: Array, T: float) -> Array:
    """Give e^(D T) and its first three integrals (4, n, n)."""
    Phi = np.zeros((4, *D.shape))
    model.exponential_integrals(D, T, Phi, make_scratch(ENOUGH))
    return Phi


def zero_order_hold(
    vehicle: Vehicle, v_x: float, T: float, lag: float = 0.0
) -> tuple[Array, Array]:
    """Give A_k (5, 5) and B (5,)."""
    A, B = np.zeros((STATES, STATES)), np.zeros(STATES)
    model.zero_order_hold(vehicle, v_x, lag, T, A, B, make_scratch(ENOUGH))
    return A, B


def augment(A_k: Array, B: Array) -> tuple[Array, Array]:
    """Give A~ (5, 5) and B~ (5,)."""
    A_augmented, B_augmented = np.zeros((STATES, STATES)), np.full(STATES, np.nan)
    model.augment(A_k, B, A_augmented, B_augmented)
    return A_augmented, B_augmented


def predict(A: Array, B: Array, L: Array, x: Array, N_p: int) -> tuple[Array, Array]:
    """Give F x (N_p,) and Phi (N_p, N)."""
    free, Phi = np.full(N_p, np.nan), np.zeros((L.shape[1], N_p))
    prediction.predict(A, B, L, x, free, Phi, make_scratch(ENOUGH))
    return free, Phi.T


def quadratic_cost(Phi: Array, error: Array, L: Array, Q: float, R: float) -> tuple[Array, Array]:
    """Give E (N, N) and K (N,) for Phi (N_p, N)."""
    N = L.shape[1]
    E, K = np.full((N, N), np.nan), np.full(N, np.nan)
    prediction.quadratic_cost(np.ascontiguousarray(Phi.T), error, L, (Q, R), E, K)
    return E, K


def sampled_model(vehicle: Vehicle, v_x: float, T: float, actuator: Actuator) -> SampledModel:
    """Give the model of one step of T [s]."""
    blank = SampledModel(np.full((STATES, STATES), np.nan), *np.zeros((3, STATES)))
    preview_model.sample_model(vehicle, v_x, T, actuator, blank, make_scratch(ENOUGH))
    return blank


def active_set(problem: Qp) -> QpSolution:
    """Solve with the exact solver."""
    return solution_of(problem)


def hildreth_solution(problem: Qp, sweeps: int, tolerance: float) -> QpSolution:
    """Solve with Hildreth's procedure."""
    m, n = problem.M.shape
    x, multipliers = np.zeros(n), np.zeros(m)
    scratch = make_scratch(hildreth.hildreth_numbers(m, n))
    done, status = hildreth.hildreth(problem, (sweeps, tolerance), x, multipliers, scratch)
    return QpSolution(x, multipliers, done, status)
