"""QP of one tick in the paper's formulation, Eq. (17), and the plan read off its solution."""

from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.constraints import input_rows, output_rows, output_steps, row_count, running_sum
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.internal_model import Limits
from ampc_ros.mpc.laguerre import laguerre_sequence
from ampc_ros.mpc.model import STATES, BicycleParameters, augment, zero_order_hold
from ampc_ros.mpc.prediction import predict, quadratic_cost
from ampc_ros.mpc.qp import SOLVED, Qp
from ampc_ros.mpc.qp_solver import blank_qp, count_active, scratch_numbers, solve_qp
from ampc_ros.mpc.small_matrices import Scratch, dot, make_scratch, matrix, vector
from ampc_ros.mpc.tick_result import QpResult

MAX_CONDITION = 1e12
"""Largest accepted condition number of E; beyond it the solver would lose its digits."""
CHECKED_SPEEDS = (3.0, 27.0)
"""Speeds at which the conditioning is checked: the ends of the paper's range [m/s]."""


class StepInput(NamedTuple):
    """Inputs of the QP of one tick."""

    v_x: float
    """Speed of the model [m/s]."""
    x: Array
    """(5,) augmented state of Eq. (9)."""
    u: float
    """Angle in force, u(k - 1) [rad]."""
    r: float
    """Set-point of the lateral position [m]."""


@in_place
def build_qp(
    vehicle: BicycleParameters,
    gains: Gains,
    limits: Limits,
    step: StepInput,
    qp: Qp,
    scratch: Scratch,
) -> None:
    """Fill the QP of Eq. (17) in eta, and in the slack if outputs are bounded."""
    N_p, N_c, N, alpha, Q, R = gains
    # Model, Eqs. (7)-(9)
    A_k, B_k = matrix(scratch, STATES, STATES), vector(scratch, STATES)
    A, B = matrix(scratch, STATES, STATES), vector(scratch, STATES)
    zero_order_hold(vehicle, step.v_x, 0.0, limits.T, A_k, B_k, scratch)
    augment(A_k, B_k, A, B)
    # Increments, Eq. (24), and the angles that they add up to
    L, S = matrix(scratch, N_c, N), matrix(scratch, N_c, N)
    laguerre_sequence(alpha, L)
    running_sum(L, S)
    # Prediction, Eq. (10), and cost, Eq. (11)
    error, Phi = vector(scratch, N_p), matrix(scratch, N, N_p)
    predict(A, B, L, step.x, error, Phi, scratch)
    for i in range(N_p):
        error[i] = step.r - error[i]
    quadratic_cost(Phi, error, L, (Q, R), qp.E, qp.K)
    # Bounds, Eqs. (13)-(16)
    input_rows(qp, L, S, step.u, (limits.Delta_u_max, limits.u_max))
    if len(qp.K) > N:
        qp.E[N, N] = 2 * limits.slack_weight
        output_rows(qp, 2 * N_c, Phi, error, limits.half_width)


@inlined
def paper_plan(
    vehicle: BicycleParameters,
    gains: Gains,
    limits: Limits,
    step: StepInput,
    angles: Array,
    scratch: Scratch,
) -> QpResult:
    """Build and solve the QP of one tick, and apply its first increment.

    If the solver fails, the angle in force is held.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r of the internal model.
        gains: N_p, N_c, N, alpha, Q, R.
        limits: Bounds and solver.
        step: Inputs of the tick.
        angles: Receives the planned angles of this and the following ticks, (<= N_c,) [rad].
        scratch: Memory for the QP.
    """
    N_p, N_c, N, _, _, _ = gains
    # QP
    qp = blank_qp(gains, output_steps(N_p, N_c, limits.half_width), scratch)
    build_qp(vehicle, gains, limits, step, qp, scratch)
    eta, multipliers = vector(scratch, len(qp.K)), vector(scratch, len(qp.low))
    iterations, status = solve_qp(qp, limits, eta, multipliers, scratch)
    # QpResult: rows 0, 2, .. of M are the Laguerre functions, rows 1, 3, .. their running sum
    for i in range(min(N_c, len(angles))):
        angles[i] = step.u + dot(qp.M[2 * i + 1][:N], eta[:N])
    # First move, clipped because the solver keeps bounds only within its tolerance
    first = min(max(dot(qp.M[0][:N], eta[:N]), -limits.Delta_u_max), limits.Delta_u_max)
    Delta_u = first if status == SOLVED else 0.0
    steering = min(max(step.u + Delta_u, -limits.u_max), limits.u_max)
    slack = eta[N] if len(eta) > N else 0.0
    return QpResult(steering, count_active(multipliers), slack, iterations, status)


def new_qp(vehicle: BicycleParameters, gains: Gains, limits: Limits, step: StepInput) -> Qp:
    """Return the QP of one tick in newly allocated memory; see `build_qp`."""
    N_p, N_c, N, _, _, _ = gains
    outputs = output_steps(N_p, N_c, limits.half_width)
    m, n = row_count(N_c, outputs), N + (outputs > 0)
    qp = Qp(np.zeros((n, n)), np.zeros(n), np.zeros((m, n)), np.zeros(m), np.zeros(m))
    build_qp(vehicle, gains, limits, step, qp, make_scratch(scratch_numbers(N_p, N_c, N)))
    return qp


def check_conditioning(vehicle: BicycleParameters, gains: Gains, limits: Limits) -> None:
    """Check that gains do not make E of Eq. (17) numerically singular.

    Raises:
        ValueError: Names the Laguerre terms and pole, the condition number and its bound.
    """
    N = gains.laguerre_terms
    for v_x in CHECKED_SPEEDS:
        E = new_qp(vehicle, gains, limits, StepInput(v_x, np.zeros(STATES), 0.0, 0.0)).E
        condition = float(np.linalg.cond(E[:N, :N]))
        if not condition <= MAX_CONDITION:
            raise ValueError(
                f"gains: laguerre_terms = {N} with laguerre_pole = {gains.laguerre_pole:g} give "
                f"cond(E) = {condition:.1e} at {v_x:g} m/s, must be at most {MAX_CONDITION:.0e}"
            )
