"""QP of one tick in the preview formulation: path ahead, actuator, bound of the tyre."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.constraints import output_rows, output_steps, running_sum
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.internal_model import InternalModel
from ampc_ros.mpc.laguerre import laguerre_sequence
from ampc_ros.mpc.model import STATES, V_Y
from ampc_ros.mpc.prediction import advance_state, quadratic_cost
from ampc_ros.mpc.qp import SOLVED, Qp
from ampc_ros.mpc.qp_solver import blank_qp, count_active, solve_qp
from ampc_ros.mpc.small_matrices import Scratch, dot, matrix, vector
from ampc_ros.mpc.tick_result import QpResult
from ampc_ros.preview.model import E_PSI, E_Y, blank_model, sample_model
from ampc_ros.preview.nominal_steering import Road, nominal_steering

SPEED_STEP = 0.02
"""Relative change of speed along the horizon below which the sampled model is reused."""
HEAD_START = 0.1
"""Cross-track error that is to vanish within the horizon; only more is returned gently [m]."""
RETURN_RATE = 1.0
"""Largest lateral speed of a return to the path [m/s]."""
RETURN_SLOPE = 0.25
"""Largest lateral speed of a return as a share of the speed."""
RETURN_ACCELERATION = 1.5
"""Lateral acceleration of a return [m/s^2]."""


class Past(NamedTuple):
    """State and history at the start of the horizon."""

    x: Array
    """(5,) state relative to the path."""
    sent: Array
    """(n + 1,) commands still in the delay, the newest last [rad]."""
    disturbance: Array
    """(5,) estimated change of the state per tick that the model does not explain."""


@in_place
def predict_on_road(
    model: InternalModel,
    past: Past,
    road: Road,
    nominal: Array,
    S: Array,
    free: Array,
    Phi: Array,
    scratch: Scratch,
) -> None:
    """Fill the cross-track error without correction (H,), and its response to eta, transposed.

    Args:
        model: Vehicle, actuator and period.
        past: State, commands in the delay, disturbance.
        road: Speed and curvature along the horizon.
        nominal: Angles without correction (H,) [rad].
        S: Running sum of the Laguerre functions (N_c, N): the correction at step i is S(i) eta.
        free: Receives the error (H,) [m].
        Phi: Receives the response (N, H).
        scratch: Auxiliary memory.
    """
    begin, n, v = scratch.used[0], model.actuator.ticks, -1.0
    x, response = vector(scratch, STATES), matrix(scratch, len(Phi), STATES)
    sampled, following = blank_model(scratch), vector(scratch, STATES)
    for i in range(STATES):
        x[i] = past.x[i]
    for j in range(len(free)):
        if abs(road.speed[j + 1] - v) > SPEED_STEP * abs(v):
            v = road.speed[j + 1]
            sample_model(model.vehicle, v, model.limits.T, model.actuator, sampled, scratch)
        old, new = input_at(j - n - 1, past.sent, nominal), input_at(j - n, past.sent, nominal)
        advance_state(sampled.A, x, following)
        for i in range(STATES):
            x[i] += sampled.B_old[i] * old + sampled.B_new[i] * new
            x[i] += sampled.D[i] * road.curvature[j + 1] + past.disturbance[i]
        free[j] = x[E_Y]
        for k in range(len(Phi)):
            advance_state(sampled.A, response[k], following)
            old, new = correction(S, j - n - 1, k), correction(S, j - n, k)
            for i in range(STATES):
                response[k, i] += sampled.B_old[i] * old + sampled.B_new[i] * new
            Phi[k, j] = response[k, E_Y]
    scratch.used[0] = begin


@in_place
def input_at(i: int, sent: Array, nominal: Array) -> float:
    """Return the angle commanded at step i of the horizon; negative steps lie in the past [rad]."""
    if i >= 0:
        return float(nominal[i])
    return float(sent[max(len(sent) + i, 0)])


@in_place
def correction(S: Array, i: int, k: int) -> float:
    """Return the correction at step i by the k-th Laguerre function.

    It is zero in the past and constant after the control horizon.
    """
    return float(S[min(i, len(S) - 1), k]) if i >= 0 else 0.0


@in_place
def return_path(past: Past, v_x: float, T: float, aim: Array) -> None:
    """Fill the desired cross-track error (H,) [m]: zero, or a gentle return from a large error.

    Without it a car that joins from metres away is steered at the limit of its tyres. With it the
    lateral acceleration does not depend on the friction of the road.

    Args:
        past: State relative to the path.
        v_x: Speed [m/s].
        T: Step [s].
        aim: Receives the errors.
    """
    side = 1.0 if past.x[E_Y] > 0.0 else -1.0
    rest = max(side * past.x[E_Y] - HEAD_START, 0.0)
    rate = side * (past.x[V_Y] + v_x * past.x[E_PSI])
    fastest = min(RETURN_RATE, RETURN_SLOPE * v_x)
    for j in range(len(aim)):
        wanted = -min(fastest, math.sqrt(2.0 * RETURN_ACCELERATION * rest))
        rate = min(max(wanted, rate - RETURN_ACCELERATION * T), rate + RETURN_ACCELERATION * T)
        rest = max(rest + rate * T, 0.0)
        aim[j] = side * rest


@in_place
def steering_rows(
    qp: Qp, L: Array, S: Array, nominal: Array, bounds: Array, u: float, step: float
) -> None:
    """Fill the bounds of increment and angle on nominal + correction, Eqs. (13), (14): 2 N_c rows.

    Args:
        qp: Its first rows are filled.
        L: Laguerre functions (N_c, N).
        S: Their running sum (N_c, N).
        nominal: Angles without correction (H,), feasible [rad].
        bounds: Bound of the angle at each step (H,) [rad].
        u: Angle in force [rad].
        step: Largest increment per tick [rad].
    """
    for i in range(len(L)):
        increment = nominal[i] - (nominal[i - 1] if i > 0 else u)
        bound = max(bounds[i], abs(nominal[i]))
        for j in range(L.shape[1]):
            qp.M[2 * i, j], qp.M[2 * i + 1, j] = L[i, j], S[i, j]
        qp.low[2 * i], qp.high[2 * i] = -step - increment, step - increment
        qp.low[2 * i + 1], qp.high[2 * i + 1] = -bound - nominal[i], bound - nominal[i]


@inlined
def preview_plan(
    model: InternalModel,
    gains: Gains,
    past: Past,
    road: Road,
    lateral: Array,
    angles: Array,
    scratch: Scratch,
) -> QpResult:
    """Compute the angle to command now: nominal steering plus the optimal Laguerre correction.

    If the solver fails, the correction is zero.

    Args:
        model: Vehicle, limits, actuator.
        gains: N_p, N_c, N, alpha, Q, R; R weights the increments of the CORRECTION.
        past: State, commands in the delay, disturbance.
        road: Speed and curvature along the horizon of H = N_p + delay steps.
        lateral: Receives the predicted cross-track error (H,) [m].
        angles: Receives the angles to command at this and the following ticks (H,) [rad].
        scratch: Memory for the QP.
    """
    _, N_c, N, alpha, Q, R = gains
    limits, H, u = model.limits, len(lateral), past.sent[len(past.sent) - 1]
    # Angles without correction: they follow the curvature of the path within all bounds
    bounds, aim = vector(scratch, H), vector(scratch, H)
    nominal_steering(model, road, u, angles, bounds, scratch)
    # Increments of the correction, Eq. (24), and the angles that they add up to
    L, S, Phi = matrix(scratch, N_c, N), matrix(scratch, N_c, N), matrix(scratch, N, H)
    laguerre_sequence(alpha, L)
    running_sum(L, S)
    # Predicted cross-track error without correction, and its response to the correction
    predict_on_road(model, past, road, angles, S, lateral, Phi, scratch)
    # Cost of the remaining error and of the increments, Eqs. (11), (17)
    return_path(past, road.speed[1], limits.T, aim)
    for j in range(H):
        aim[j] -= lateral[j]
    qp = blank_qp(gains, output_steps(H, H, limits.half_width), scratch)
    quadratic_cost(Phi, aim, L, (Q, R), qp.E, qp.K)
    # Bounds of increment and angle, Eqs. (13), (14), and the soft lane about the path, Eq. (15)
    steering_rows(qp, L, S, angles, bounds, u, limits.Delta_u_max)
    if len(qp.K) > N:
        for j in range(H):
            aim[j] = -lateral[j]
        qp.E[N, N] = 2 * limits.slack_weight
        output_rows(qp, 2 * N_c, Phi, aim, limits.half_width)
    # Solution
    eta, multipliers = vector(scratch, len(qp.K)), vector(scratch, len(qp.low))
    iterations, status = solve_qp(qp, limits, eta, multipliers, scratch)
    if status != SOLVED:
        for j in range(N):
            eta[j] = 0.0
    # Prediction and plan with the correction
    for k in range(N):
        for j in range(H):
            lateral[j] += eta[k] * Phi[k, j]
    slack = eta[N] if len(eta) > N else 0.0
    for i in range(H):
        angles[i] += dot(S[min(i, N_c - 1)], eta[:N])
    return QpResult(angles[0], count_active(multipliers), slack, iterations, status)
