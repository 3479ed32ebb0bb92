"""The paper's controller as CasADi's examples write a linear MPC: direct multiple shooting.

Unknown are the states of all 45 steps and the 15 increments, every step of the model is an
equation, the programme is sparse. `qpsol` is built once; speed, state, angle in force and
set-point are its parameters.
"""

import math
from typing import Any

import numpy as np

from ampc_msgs_config.types import Array
from ampc_ros.paper.qp_assembly import StepInput
from tests.workshop.bench.bench_mpc import LIMITS, N_C, N_P, Answer, Q, R, symbolic_model

PROXIMAL = {"daqp": {"eps_prox": 1e-4}}
"""DAQP solves none of these with its default settings, as most states have no weight: it needs
its proximal iterations. Of the powers of ten this one is fast and always right."""
QUIET = {"osqp": {"verbose": False}}


def multiple_shooting(plugin: str, options: dict[str, Any]) -> Answer:
    """Build the programme; 15 free increments, bounds on them and on the angles."""
    import casadi as ca

    states, moves, p = ca.SX.sym("x", 6, N_P + 1), ca.SX.sym("Delta_u", N_C), ca.SX.sym("p", 8)
    programme = {
        "x": ca.vertcat(moves, ca.vec(states)),
        "p": p,
        "f": cost(states, moves, p[7]),
        "g": gaps(states, moves, p),
    }
    solver = ca.qpsol("S", plugin, programme, options)
    bounds = dict(zip(("lbx", "ubx"), unknowns_between(), strict=True))

    def answer(tick: StepInput) -> float | None:
        held = min(max(tick.u, -LIMITS.u_max), LIMITS.u_max)
        given = np.concatenate(((tick.v_x,), tick.x, (held, tick.r)))
        try:
            return float(solver(p=given, lbg=0, ubg=0, **bounds)["x"][0])
        except RuntimeError:  # not solved
            return None

    return answer


def cost(states: Any, moves: Any, r: Any) -> Any:
    """Weighted squares of the predicted errors and of the increments."""
    import casadi as ca

    return Q * ca.sumsqr(states[4, 1:] - r) + R * ca.sumsqr(moves)


def gaps(states: Any, moves: Any, p: Any) -> Any:
    """What must be zero: each state less what the model makes of the one before."""
    import casadi as ca

    A, B = symbolic_model(ca.fmax(p[0], 1.0))
    found = [states[:, 0] - p[1:7]]
    for k in range(N_P):
        Delta_u = moves[k] if k < N_C else 0
        x, u = A @ states[:5, k] + B * Delta_u, states[5, k] + Delta_u
        found.append(states[:, k + 1] - ca.vertcat(x, u))
    return ca.vertcat(*found)


def unknowns_between() -> tuple[Array, Array]:
    """Bounds of the increments, then of the states, of which only the angle has any."""
    states = np.full((N_P + 1, 6), math.inf)
    states[1 : N_C + 1, 5] = LIMITS.u_max
    high = np.append(np.full(N_C, LIMITS.Delta_u_max), states)
    return -high, high
