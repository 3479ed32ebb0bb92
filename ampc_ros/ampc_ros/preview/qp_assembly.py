"""QP of one tick in the preview formulation: path ahead, actuator, bound of the tyre."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.constraints import output_rows, output_steps, running_sum
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.internal_model import InternalModel
from ampc_ros.mpc.laguerre import laguerre_sequence
from ampc_ros.mpc.model import STATES, V_Y, Vehicle
from ampc_ros.mpc.prediction import advance_state, quadratic_cost
from ampc_ros.mpc.qp import SOLVED, Qp
from ampc_ros.mpc.qp_solver import blank_qp, count_active, solve_qp
from ampc_ros.mpc.small_matrices import Scratch, dot, matrix, vector
from ampc_ros.mpc.tick_result import QpResult
from ampc_ros.preview.model import (
    E_PSI,
    E_Y,
    angle_bound,
    blank_model,
    road_steering,
    sample_model,
)

SPEED_STEP = 0.02
"""Relative change of speed along the horizon below which the sampled model is reused."""
FRICTION_SHARE = 1.3
"""Bound of the angle: that of a linear tyre at this multiple of the friction limit. The curve of a
real tyre flattens and reaches its peak at about this multiple of the linear angle."""
HEAD_START = 0.1
"""Cross-track error that is to vanish within the horizon; only more is returned gently [m]."""
RETURN_RATE = 1.0
"""Largest lateral speed of a return to the path [m/s]."""
RETURN_SLOPE = 0.25
"""Largest lateral speed of a return as a share of the speed."""
RETURN_ACCELERATION = 1.5
"""Lateral acceleration of a return [m/s^2]."""
NOMINAL_SHARE = 0.7
"""Share of the largest increment that the angles without correction use. The rest is left to the
feedback in both directions, at every step."""
BEHIND = 16
"""Ticks of the driven road whose demand still shapes the angles without correction."""
SWEEPS = 40
"""Sweeps of `limit_rate`."""
OVER_RELAXATION = 1.7
"""Factor of its steps. A chain of 20 increments that exceed the limit converges to 1e-6 of it."""


class Road(NamedTuple):
    """Speed and curvature along the prediction horizon; entry 0 lies one tick back."""

    speed: Array
    """(H + 1,) [m/s]."""
    curvature: Array
    """(H + 1,) mean over each step [1/m]."""
    behind: Array
    """(BEHIND,) mean over the steps before entry 0, the latest first [1/m]."""


class Past(NamedTuple):
    """State and history at the start of the horizon."""

    x: Array
    """(5,) state relative to the path."""
    sent: Array
    """(n + 1,) commands still in the delay, the newest last [rad]."""
    disturbance: Array
    """(5,) estimated change of the state per tick that the model does not explain."""


@in_place
def nominal_steering(
    model: InternalModel, road: Road, u: float, nominal: Array, bounds: Array, scratch: Scratch
) -> None:
    """Fill the angles without correction: the angle in force plus the changes of the path's angle.

    Where the path demands more than `NOMINAL_SHARE` of the largest increment, its angle is replaced
    by the nearest sequence that does not, see `limit_rate`. The sequence respects angle bounds and
    the share. If the angle in force exceeds its bound, it returns at the share. The sequence is
    therefore feasible by construction and leaves the rest of the increment to the correction.

    Args:
        model: Vehicle and limits.
        road: Speed and curvature along the horizon.
        u: Angle in force [rad].
        nominal: Receives the angles (H,) [rad].
        bounds: Receives the bound of the angle at each step (H,) [rad].
        scratch: Auxiliary memory.
    """
    begin, vehicle, limits = scratch.used[0], model.vehicle, model.limits
    step, a_y_max = NOMINAL_SHARE * limits.Delta_u_max, FRICTION_SHARE * limits.mu_g
    now, angles = len(road.behind), vector(scratch, len(road.behind) + len(road.speed))
    demanded_angles(vehicle, road, limits.T, angles)
    limit_rate(angles, step, vector(scratch, len(angles)))
    before, offset = u, u - angles[now]
    for i in range(len(bounds)):
        bound = angle_bound(vehicle, road.speed[i + 1], limits.u_max, a_y_max)
        wanted = min(max(offset + angles[now + i + 1], -bound), bound)
        before = min(max(wanted, before - step), before + step)
        nominal[i], bounds[i] = before, bound
    scratch.used[0] = begin


@in_place
def demanded_angles(vehicle: Vehicle, road: Road, T: float, angles: Array) -> None:
    """Fill the angles that keep the car on the path, from the road behind to the horizon's end.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        road: Speed and curvature; the road behind is taken at the speed of entry 0.
        T: Step [s].
        angles: Receives the angles (BEHIND + H + 1,); entry BEHIND is entry 0 of the road [rad].
    """
    now, behind = len(road.behind), road.behind
    for j in range(now):
        after = behind[j - 1] if j > 0 else road.curvature[0]
        change = (after - behind[min(j + 1, now - 1)]) / ((2.0 if j + 1 < now else 1.0) * T)
        angles[now - 1 - j] = road_steering(vehicle, road.speed[0], behind[j], change)
    for i in range(len(road.speed)):
        angles[now + i] = road_angle(vehicle, road, i, T)


@in_place
def limit_rate(angles: Array, step: float, pressure: Array) -> None:
    """Replace angles by the nearest sequence in least squares whose increments are within +-step.

    Angles whose increments are within the bound are not changed. Elsewhere the sequence starts
    before the demand and ends after it: each correction adds to one angle what it takes from its
    neighbour, so the sum of the angles, and with it the change of heading, is preserved.

    Note:
        Hildreth's procedure on the increments, with over-relaxation (Cryer, 1971). Angles still
        exceed the bound by the remaining error; the caller limits the increments from step to step.

    Args:
        angles: Changed in place (n,) [rad].
        step: Largest increment [rad].
        pressure: Multipliers of the increments, zeros before (n,) [rad].
    """
    for _ in range(SWEEPS):
        largest = 0.0
        for i in range(len(angles) - 1):
            increment = angles[i + 1] - angles[i]
            # Positive: increment at its upper bound, negative: at its lower bound
            upper = pressure[i] + OVER_RELAXATION * (increment - step) / 2.0
            lower = pressure[i] + OVER_RELAXATION * (increment + step) / 2.0
            change = max(upper, 0.0) + min(lower, 0.0) - pressure[i]
            if change != 0.0:
                pressure[i] += change
                angles[i] += change
                angles[i + 1] -= change
                largest = max(largest, abs(change))
        if largest <= 1e-9:
            return


@in_place
def road_angle(vehicle: Vehicle, road: Road, i: int, T: float) -> float:
    """Return the angle that keeps the car on the path at entry i of the horizon [rad]."""
    before, after = max(i - 1, 0), min(i + 1, len(road.curvature) - 1)
    change = (road.curvature[after] - road.curvature[before]) / ((after - before) * T)
    return road_steering(vehicle, road.speed[i], road.curvature[i], change)


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
