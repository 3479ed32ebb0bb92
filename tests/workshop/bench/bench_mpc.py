"""The same controller built with other tools: functions from tick to first move.

Model, horizons, weights and bounds are those of AMPC. Everything that does not change from tick to
tick is prepared: Laguerre functions, rows of the bounds, symbolic problems. `multiple_shooting`
follows the MPC examples of CasADi: the unknowns are the states of all 45 steps and 15 increments,
and each step of the model is an equality constraint.
"""

import math
import warnings
from collections.abc import Callable
from typing import Any

import daqp
import numpy as np
from scipy.linalg import expm

from ampc_msgs_config.types import Array
from ampc_ros.mpc.model import lateral_dynamics
from ampc_ros.paper.qp_assembly import StepInput
from tests.workshop.bench.bench_ours import GAINS, VEHICLE, laguerre, limits

Answer = Callable[[StepInput], float | None]
N_P, N_C, N, _, Q, R = GAINS
LIMITS = limits()
SQUARINGS = 6
"""Squarings of the symbolic matrix exponential, sufficient from 1 m/s on."""
PROXIMAL = {"daqp": {"eps_prox": 1e-4}}
"""Most states have no weight, so DAQP needs proximal iterations. Of the powers of ten, this one is
fast and always correct."""
QUIET = {"osqp": {"verbose": False}}


def augmented_model(v_x: float) -> tuple[Array, Array]:
    """Return A~ (5, 5) and B~ (5,) of Eq. (9), computed with NumPy and SciPy."""
    A_c, B_c, block = np.zeros((4, 4)), np.zeros(4), np.zeros((5, 5))
    lateral_dynamics(VEHICLE, v_x, A_c, B_c)
    block[:4, :4], block[:4, 4] = A_c, B_c
    Phi = expm(LIMITS.T * block)
    A, B = np.zeros((5, 5)), np.empty(5)
    A[:4, :4], A[4, :4], A[4, 4] = Phi[:4, :4], Phi[3, :4], 1.0
    B[:4], B[4] = Phi[:4, 4], Phi[3, 4]
    return A, B


def numpy_daqp() -> Answer:
    """Build the controller from a prediction in NumPy and DAQP."""
    L = laguerre(GAINS)
    rows = np.vstack((L, np.cumsum(L, axis=0)))
    weight = 2 * R * L.T @ L
    later = np.arange(N_P)[:, None] - np.arange(N_C)
    before = later < 0

    def answer(tick: StepInput) -> float | None:
        A, B = augmented_model(tick.v_x)
        F, response, row = np.empty((N_P, 5)), np.empty(N_P), np.eye(5)[4]
        for i in range(N_P):
            response[i] = row @ B
            row = row @ A
            F[i] = row
        Phi = np.where(before, 0.0, response[later]) @ L
        E = 2 * Q * Phi.T @ Phi + weight
        K = -2 * Q * Phi.T @ (tick.r - F @ tick.x)
        high, low = bounds(tick.u)
        x, _, flag, _ = daqp.solve(E, K, rows, high, low)
        return float(L[0] @ x) if flag > 0 else None

    return answer


def bounds(u: float) -> tuple[Array, Array]:
    """Return upper and lower bounds of the increments and of the angles (2 N_c,)."""
    held = min(max(u, -LIMITS.u_max), LIMITS.u_max)
    step, turn = np.full(N_C, LIMITS.Delta_u_max), np.ones(N_C)
    high = np.concatenate((step, (LIMITS.u_max - held) * turn))
    low = np.concatenate((-step, (-LIMITS.u_max - held) * turn))
    return high, low


def casadi_qp(plugin: str, options: dict[str, Any]) -> Answer:
    """Build the condensed problem in CasADi with parameters v_x, x, u, r; `qpsol` is built once."""
    import casadi as ca

    eta, p = ca.SX.sym("eta", N), ca.SX.sym("p", 8)
    v_x, x, r = ca.fmax(p[0], 1.0), p[1:6], p[7]
    A, B = symbolic_model(v_x)
    L = laguerre(GAINS)
    moves = ca.DM(L) @ eta
    cost = R * ca.sumsqr(moves)
    for i in range(N_P):
        x = A @ x + (B * moves[i] if i < N_C else 0)
        cost += Q * (x[4] - r) ** 2
    problem = {"x": eta, "p": p, "f": cost, "g": ca.vertcat(moves, ca.cumsum(moves))}
    solver = ca.qpsol("S", plugin, problem, options)

    def answer(tick: StepInput) -> float | None:
        high, low = bounds(tick.u)
        values = np.concatenate(((tick.v_x,), tick.x, (tick.u, tick.r)))
        try:
            return float(solver(p=values, lbg=low, ubg=high)["g"][0])
        except RuntimeError:  # not solved
            return None

    return answer


def symbolic_model(v_x: Any) -> tuple[Any, Any]:
    """Return A~ (5, 5) and B~ (5, 1) of Eq. (9) in CasADi symbols."""
    import casadi as ca

    m, I_z, l_f, l_r, C_f, C_r = VEHICLE
    block = ca.SX(5, 5)
    block[0, 0] = -2 * (C_f + C_r) / (m * v_x)
    block[0, 2] = -v_x - 2 * (C_f * l_f - C_r * l_r) / (m * v_x)
    block[2, 0] = -2 * (C_f * l_f - C_r * l_r) / (I_z * v_x)
    block[2, 2] = -2 * (C_f * l_f**2 + C_r * l_r**2) / (I_z * v_x)
    block[0, 4], block[2, 4] = 2 * C_f / m, 2 * C_f * l_f / I_z
    block[1, 2], block[3, 0], block[3, 1] = 1, 1, v_x
    Phi = symbolic_exponential(LIMITS.T * block)
    A = ca.vertcat(ca.horzcat(Phi[:4, :4], ca.SX(4, 1)), ca.horzcat(Phi[3, :4], 1))
    return A, ca.vertcat(Phi[:4, 4], Phi[3, 4])


def symbolic_exponential(A: Any) -> Any:
    """Return e^A in CasADi symbols by a scaled Taylor series and squaring."""
    import casadi as ca

    result = term = ca.SX.eye(5)
    for k in range(1, 9):
        term = term @ A / (k * 2.0**SQUARINGS)
        result = result + term
    for _ in range(SQUARINGS):
        result = result @ result
    return result


def do_mpc_controller() -> Answer:
    """Build the controller with do-mpc and IPOPT, default settings, 45 free increments."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about features that are not installed
        import do_mpc

        mpc = do_mpc.controller.MPC(do_mpc_model(do_mpc))
        mpc.settings.n_horizon, mpc.settings.t_step = N_P, LIMITS.T
        mpc.settings.store_full_solution = False
        mpc.settings.supress_ipopt_output()
        error = Q * (mpc.model.x["x"][4] - mpc.model.p["r"]) ** 2
        mpc.set_objective(mterm=error, lterm=error + R * mpc.model.u["Delta_u"] ** 2)
        mpc.set_rterm(Delta_u=0.0)
        for side, sign in (("lower", -1), ("upper", 1)):
            mpc.bounds[side, "_u", "Delta_u"] = sign * LIMITS.Delta_u_max
            mpc.bounds[side, "_x", "u"] = sign * LIMITS.u_max
        values = mpc.get_p_template(1)
        mpc.set_p_fun(lambda _: values)
        mpc.setup()
    mpc.set_initial_guess()
    return lambda tick: ask_do_mpc(mpc, values, tick)


def do_mpc_model(do_mpc: Any) -> Any:
    """Build the do-mpc model: state x~ and angle u, input Delta u, matrices as parameters."""
    model = do_mpc.model.Model("discrete", "SX")
    x, u = model.set_variable("_x", "x", (5, 1)), model.set_variable("_x", "u")
    Delta_u = model.set_variable("_u", "Delta_u")
    A, B = model.set_variable("_p", "A", (5, 5)), model.set_variable("_p", "B", (5, 1))
    model.set_variable("_p", "r")
    model.set_rhs("x", A @ x + B @ Delta_u)
    model.set_rhs("u", u + Delta_u)
    model.setup()
    return model


def ask_do_mpc(mpc: Any, values: Any, tick: StepInput) -> float | None:
    """Return the first move of one tick; do-mpc starts from its last solution."""
    A, B = augmented_model(tick.v_x)
    values["_p", 0, "A"], values["_p", 0, "B"], values["_p", 0, "r"] = A, B, tick.r
    held = min(max(tick.u, -LIMITS.u_max), LIMITS.u_max)
    move = float(mpc.make_step(np.append(tick.x, held))[0, 0])
    return move if mpc.solver_stats["success"] else None


def multiple_shooting(plugin: str, options: dict[str, Any]) -> Answer:
    """Build the sparse problem: 15 free increments, bounds on them and on the angles."""
    import casadi as ca

    states, moves, p = ca.SX.sym("x", 6, N_P + 1), ca.SX.sym("Delta_u", N_C), ca.SX.sym("p", 8)
    problem = {
        "x": ca.vertcat(moves, ca.vec(states)),
        "p": p,
        "f": shooting_cost(states, moves, p[7]),
        "g": dynamics_residuals(states, moves, p),
    }
    solver = ca.qpsol("S", plugin, problem, options)
    bounds = dict(zip(("lbx", "ubx"), variable_bounds(), strict=True))

    def answer(tick: StepInput) -> float | None:
        held = min(max(tick.u, -LIMITS.u_max), LIMITS.u_max)
        values = np.concatenate(((tick.v_x,), tick.x, (held, tick.r)))
        try:
            return float(solver(p=values, lbg=0, ubg=0, **bounds)["x"][0])
        except RuntimeError:  # not solved
            return None

    return answer


def shooting_cost(states: Any, moves: Any, r: Any) -> Any:
    """Return the weighted squares of the predicted errors and of the increments."""
    import casadi as ca

    return Q * ca.sumsqr(states[4, 1:] - r) + R * ca.sumsqr(moves)


def dynamics_residuals(states: Any, moves: Any, p: Any) -> Any:
    """Return each state minus its prediction from the previous state; zero at a solution."""
    import casadi as ca

    A, B = symbolic_model(ca.fmax(p[0], 1.0))
    residuals = [states[:, 0] - p[1:7]]
    for k in range(N_P):
        Delta_u = moves[k] if k < N_C else 0
        x, u = A @ states[:5, k] + B * Delta_u, states[5, k] + Delta_u
        residuals.append(states[:, k + 1] - ca.vertcat(x, u))
    return ca.vertcat(*residuals)


def variable_bounds() -> tuple[Array, Array]:
    """Return the bounds of the increments and of the states; only the angle is bounded."""
    states = np.full((N_P + 1, 6), math.inf)
    states[1 : N_C + 1, 5] = LIMITS.u_max
    high = np.append(np.full(N_C, LIMITS.Delta_u_max), states)
    return -high, high
