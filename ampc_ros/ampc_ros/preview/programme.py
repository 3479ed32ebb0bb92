"""The programme of the `preview` formulation: the road ahead, the actuator, the tyre."""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from ampc_ros.mpc.constraints import output_rows, output_steps, running_sum
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.mpc.internal_model import InternalModel
from ampc_ros.mpc.laguerre import laguerre_sequence
from ampc_ros.mpc.model import STATES, V_Y, Vehicle
from ampc_ros.mpc.prediction import advance, quadratic_cost
from ampc_ros.mpc.programme import blank_programme, count_active, solve
from ampc_ros.mpc.qp import SOLVED, Qp
from ampc_ros.mpc.small_matrices import Scratch, dot, matrix, vector
from ampc_ros.preview.model import (
    E_PSI,
    E_Y,
    angle_bound,
    blank_model,
    road_steering,
    sample,
)

SPEED_STEP = 0.02
"""Relative change of speed along the horizon for which the model is not rebuilt."""
FRICTION_SHARE = 1.3
"""The angle of a linear tyre at this share of the friction is the bound: the real tyre's curve
flattens towards its peak, which lies at about this multiple of the linear angle."""
HEAD_START = 0.1
"""Cross-track error that is to vanish within the horizon [m]."""
RETURN_RATE = 1.0
"""Lateral speed of a return from farther away [m/s]."""
RETURN_SLOPE = 0.25
"""Largest share of the speed in it."""
RETURN_ACCELERATION = 1.5
"""Lateral acceleration of it [m/s^2]."""


class Road(NamedTuple):
    """The horizon as path and speed give it; entry 0 lies one tick back."""

    speed: Array
    """(H + 1,) [m/s]."""
    curvature: Array
    """(H + 1,) mean over each step [1/m]."""


class Past(NamedTuple):
    """What one step knows."""

    x: Array
    """(5,) state relative to the path."""
    sent: Array
    """(n + 1,) commands, the newest last [rad]."""
    disturbance: Array
    """(5,) change of the state per tick that the model does not explain."""


class Plan(NamedTuple):
    """What one step decides."""

    steering: float
    """Angle to command now [rad]."""
    active: int
    """Rows that hold with equality."""
    slack: float
    """[m]."""
    iterations: int
    status: int


@in_place
def nominal_steering(
    belief: InternalModel, road: Road, u: float, nominal: Array, bounds: Array
) -> None:
    """Fill the angles without a correction: the angle in force, on with the road's bends.

    Follows the changes of the angle that the road asks for, within the bounds and within
    the largest increment. A bound that is left already is approached as fast as that allows, so
    the sequence is feasible by construction.

    Args:
        belief: Vehicle and limits.
        road: The horizon.
        u: Angle in force [rad].
        nominal: Receives the angles (H,) [rad].
        bounds: Receives the bound of the angle at each step (H,) [rad].
    """
    vehicle, limits = belief.vehicle, belief.limits
    step, a_y_max = limits.Delta_u_max, FRICTION_SHARE * limits.mu_g
    before, offset = u, u - road_angle(vehicle, road, 0, limits.T)
    for i in range(len(bounds)):
        bound = angle_bound(vehicle, road.speed[i + 1], limits.u_max, a_y_max)
        wanted = offset + road_angle(vehicle, road, i + 1, limits.T)
        wanted = min(max(wanted, -bound), bound)
        before = min(max(wanted, before - step), before + step)
        nominal[i], bounds[i] = before, bound


@in_place
def road_angle(vehicle: Vehicle, road: Road, i: int, T: float) -> float:
    """Angle that the road asks for at entry i of the horizon [rad]."""
    before, after = max(i - 1, 0), min(i + 1, len(road.curvature) - 1)
    change = (road.curvature[after] - road.curvature[before]) / ((after - before) * T)
    return road_steering(vehicle, road.speed[i], road.curvature[i], change)


@in_place
def predict_on_road(
    belief: InternalModel,
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
        belief: Vehicle, steering and step.
        past: State, commands still on their way, disturbance.
        road: Speed and curvature along the horizon.
        nominal: Angles without correction (H,) [rad].
        S: Running sum of the Laguerre functions (N_c, N): the correction at step i is S(i) eta.
        free: Receives the error (H,) [m].
        Phi: Receives the response (N, H).
        scratch: Auxiliary memory.
    """
    begin, n, v = scratch.used[0], belief.actuator.ticks, -1.0
    x, response = vector(scratch, STATES), matrix(scratch, len(Phi), STATES)
    model, following = blank_model(scratch), vector(scratch, STATES)
    for i in range(STATES):
        x[i] = past.x[i]
    for j in range(len(free)):
        if abs(road.speed[j + 1] - v) > SPEED_STEP * abs(v):
            v = road.speed[j + 1]
            sample(belief.vehicle, v, belief.limits.T, belief.actuator, model, scratch)
        old, new = input_at(j - n - 1, past.sent, nominal), input_at(j - n, past.sent, nominal)
        advance(model.A, x, following)
        for i in range(STATES):
            x[i] += model.B_old[i] * old + model.B_new[i] * new
            x[i] += model.D[i] * road.curvature[j + 1] + past.disturbance[i]
        free[j] = x[E_Y]
        for k in range(len(Phi)):
            advance(model.A, response[k], following)
            old, new = correction(S, j - n - 1, k), correction(S, j - n, k)
            for i in range(STATES):
                response[k, i] += model.B_old[i] * old + model.B_new[i] * new
            Phi[k, j] = response[k, E_Y]
    scratch.used[0] = begin


@in_place
def input_at(i: int, sent: Array, nominal: Array) -> float:
    """Angle commanded at step i of the horizon; negative steps lie in the past [rad]."""
    if i >= 0:
        return float(nominal[i])
    return float(sent[max(len(sent) + i, 0)])


@in_place
def correction(S: Array, i: int, k: int) -> float:
    """Correction at step i under the k-th Laguerre function: none in the past, held in the end."""
    return float(S[min(i, len(S) - 1), k]) if i >= 0 else 0.0


@in_place
def return_path(past: Past, v_x: float, T: float, aim: Array) -> None:
    """Fill the cross-track error to aim at, (H,) [m]: zero, or a gentle return from farther away.

    Without it a car that joins from metres away is pulled as hard as the tyres can; with it the
    pull does not depend on the friction that the road really has.

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
    """Fill increment and angle bounds on nominal + correction, Eqs. (13), (14): 2 N_c rows.

    Args:
        qp: Its first rows are filled.
        L: Laguerre functions (N_c, N).
        S: Their running sum (N_c, N).
        nominal: Angles without correction (H,), feasible [rad].
        bounds: Of the angle at each step (H,) [rad].
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
    belief: InternalModel,
    gains: Gains,
    past: Past,
    road: Road,
    lateral: Array,
    angles: Array,
    scratch: Scratch,
) -> Plan:
    """Angle to command now: nominal steering plus the Laguerre correction of least cost.

    Args:
        belief: Vehicle, steering, limits.
        gains: N_p, N_c, N, alpha, Q, R; the increments of the CORRECTION are weighted with R.
        past: State, commands on their way, disturbance.
        road: Speed and curvature along the horizon of H = N_p + delay steps.
        lateral: Receives the predicted cross-track error (H,) [m].
        angles: Receives the angles to command at this and the following ticks (H,) [rad].
        scratch: Memory for the programme.
    """
    _, N_c, N, alpha, Q, R = gains
    limits, H, u = belief.limits, len(lateral), past.sent[len(past.sent) - 1]
    bounds, aim = vector(scratch, H), vector(scratch, H)
    L, S, Phi = matrix(scratch, N_c, N), matrix(scratch, N_c, N), matrix(scratch, N, H)
    nominal_steering(belief, road, u, angles, bounds)
    laguerre_sequence(alpha, L)
    running_sum(L, S)
    predict_on_road(belief, past, road, angles, S, lateral, Phi, scratch)
    return_path(past, road.speed[1], limits.T, aim)
    for j in range(H):
        aim[j] -= lateral[j]
    qp = blank_programme(gains, output_steps(H, H, limits.half_width), scratch)
    quadratic_cost(Phi, aim, L, (Q, R), qp.E, qp.K)
    steering_rows(qp, L, S, angles, bounds, u, limits.Delta_u_max)
    if len(qp.K) > N:
        for j in range(H):
            aim[j] = -lateral[j]
        qp.E[N, N] = 2 * limits.slack_weight
        output_rows(qp, 2 * N_c, Phi, aim, limits.half_width)
    eta, multipliers = vector(scratch, len(qp.K)), vector(scratch, len(qp.low))
    iterations, status = solve(qp, limits, eta, multipliers, scratch)
    if status != SOLVED:
        for j in range(N):
            eta[j] = 0.0
    for k in range(N):
        for j in range(H):
            lateral[j] += eta[k] * Phi[k, j]
    slack = eta[N] if len(eta) > N else 0.0
    for i in range(H):
        angles[i] += dot(S[min(i, N_c - 1)], eta[:N])
    return Plan(angles[0], count_active(multipliers), slack, iterations, status)
