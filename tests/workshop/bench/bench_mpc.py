"""The same controller as users build it with other tools: one function from tick to first move.

Model, horizons, weights and bounds are ours. What does not change from tick to tick is built
beforehand: Laguerre functions, rows of the bounds, symbolic problems.
"""

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
"""Of the symbolic matrix exponential: enough for 1 m/s and more."""


def augmented_model(v_x: float) -> tuple[Array, Array]:
    """A~ (5, 5) and B~ (5,) of Eq. (9) with NumPy and SciPy."""
    A_c, B_c, block = np.zeros((4, 4)), np.zeros(4), np.zeros((5, 5))
    lateral_dynamics(VEHICLE, v_x, A_c, B_c)
    block[:4, :4], block[:4, 4] = A_c, B_c
    Phi = expm(LIMITS.T * block)
    A, B = np.zeros((5, 5)), np.empty(5)
    A[:4, :4], A[4, :4], A[4, 4] = Phi[:4, :4], Phi[3, :4], 1.0
    B[:4], B[4] = Phi[:4, 4], Phi[3, 4]
    return A, B


def numpy_daqp() -> Answer:
    """Prediction with NumPy, then DAQP."""
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
    """Upper and lower bounds of the increments and of the angles (2 N_c,)."""
    held = min(max(u, -LIMITS.u_max), LIMITS.u_max)
    step, turn = np.full(N_C, LIMITS.Delta_u_max), np.ones(N_C)
    high = np.concatenate((step, (LIMITS.u_max - held) * turn))
    low = np.concatenate((-step, (-LIMITS.u_max - held) * turn))
    return high, low


def casadi_qp(plugin: str, options: dict[str, Any]) -> Answer:
    """Whole problem in CasADi's symbols, parameters v_x, x, u, r; `qpsol` built once."""
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
    programme = {"x": eta, "p": p, "f": cost, "g": ca.vertcat(moves, ca.cumsum(moves))}
    solver = ca.qpsol("S", plugin, programme, options)

    def answer(tick: StepInput) -> float | None:
        high, low = bounds(tick.u)
        given = np.concatenate(((tick.v_x,), tick.x, (tick.u, tick.r)))
        try:
            return float(solver(p=given, lbg=low, ubg=high)["g"][0])
        except RuntimeError:  # not solved
            return None

    return answer


def symbolic_model(v_x: Any) -> tuple[Any, Any]:
    """A~ (5, 5) and B~ (5, 1) of Eq. (9) in CasADi's symbols."""
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
    """e^A of CasADi's symbols: Taylor series after scaling, then squaring."""
    import casadi as ca

    result = term = ca.SX.eye(5)
    for k in range(1, 9):
        term = term @ A / (k * 2.0**SQUARINGS)
        result = result + term
    for _ in range(SQUARINGS):
        result = result @ result
    return result


def do_mpc_controller() -> Answer:
    """do-mpc with IPOPT as it comes: one free increment for each of the 45 steps."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on features that are not installed
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
        known = mpc.get_p_template(1)
        mpc.set_p_fun(lambda _: known)
        mpc.setup()
    mpc.set_initial_guess()
    return lambda tick: ask_do_mpc(mpc, known, tick)


def do_mpc_model(do_mpc: Any) -> Any:
    """Model in do-mpc's words: state x~ and angle u, input Delta u, matrices as parameters."""
    model = do_mpc.model.Model("discrete", "SX")
    x, u = model.set_variable("_x", "x", (5, 1)), model.set_variable("_x", "u")
    Delta_u = model.set_variable("_u", "Delta_u")
    A, B = model.set_variable("_p", "A", (5, 5)), model.set_variable("_p", "B", (5, 1))
    model.set_variable("_p", "r")
    model.set_rhs("x", A @ x + B @ Delta_u)
    model.set_rhs("u", u + Delta_u)
    model.setup()
    return model


def ask_do_mpc(mpc: Any, known: Any, tick: StepInput) -> float | None:
    """Answer one tick; its first guess is its last solution."""
    A, B = augmented_model(tick.v_x)
    known["_p", 0, "A"], known["_p", 0, "B"], known["_p", 0, "r"] = A, B, tick.r
    held = min(max(tick.u, -LIMITS.u_max), LIMITS.u_max)
    move = float(mpc.make_step(np.append(tick.x, held))[0, 0])
    return move if mpc.solver_stats["success"] else None
