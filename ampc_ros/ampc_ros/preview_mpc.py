"""The programme of the `preview` formulation: the road ahead, the actuator, the tyre."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.constraints import output_rows, output_steps, put_two_sided, running_sum, with_slack
from ampc_ros.gain_table import Gains
from ampc_ros.laguerre import laguerre_sequence
from ampc_ros.lateral_mpc import Limits, solve
from ampc_ros.model import Vehicle
from ampc_ros.prediction import add_outer, quadratic_cost
from ampc_ros.preview_model import (
    E_PSI,
    E_Y,
    STATES,
    V_Y,
    Actuator,
    angle_bound,
    road_steering,
    sampled_model,
)
from ampc_ros.qp import Qp, QpSolution
from ampc_ros.small_matrices import apply, dot, product, put

Array = NDArray[np.float64]

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
    lateral: Array
    """(H,) predicted cross-track error [m]."""


@compiled
def angle_bounds(vehicle: Vehicle, road: Road, u_max: float, a_y_max: float) -> Array:
    """Bound of the angle at each step, (H,) [rad]."""
    bounds = np.empty(len(road.speed) - 1)
    for i in range(len(bounds)):
        bounds[i] = angle_bound(vehicle, road.speed[i + 1], u_max, a_y_max)
    return bounds


@compiled
def nominal_steering(
    vehicle: Vehicle, road: Road, u: float, bounds: Array, limits: Limits
) -> Array:
    """Angles (H,) without a correction: the angle in force, on with the road's bends [rad].

    Follows the changes of the angle that the road asks for, within the bounds and within
    the largest increment. A bound that is left already is approached as fast as that allows, so
    the sequence is feasible by construction.
    """
    nominal, step = np.empty(len(bounds)), limits.Delta_u_max
    offset = u - road_angle(vehicle, road, 0, limits.T)
    before = u
    for i in range(len(bounds)):
        wanted = offset + road_angle(vehicle, road, i + 1, limits.T)
        wanted = min(max(wanted, -bounds[i]), bounds[i])
        before = min(max(wanted, before - step), before + step)
        nominal[i] = before
    return nominal


@compiled
def road_angle(vehicle: Vehicle, road: Road, i: int, T: float) -> float:
    """Angle that the road asks for at entry i of the horizon [rad]."""
    before, after = max(i - 1, 0), min(i + 1, len(road.curvature) - 1)
    change = (road.curvature[after] - road.curvature[before]) / ((after - before) * T)
    return road_steering(vehicle, road.speed[i], road.curvature[i], change)


@compiled
def predict_on_road(
    vehicle: Vehicle, actuator: Actuator, T: float, past: Past, road: Road, nominal: Array, S: Array
) -> tuple[Array, Array]:
    """Cross-track error without correction (H,), and its response to eta (H, N).

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        actuator: Delay and lag of the steering.
        T: Step [s].
        past: State, commands still on their way, disturbance.
        road: Speed and curvature along the horizon.
        nominal: Angles without correction (H,) [rad].
        S: Running sum of the Laguerre functions (N_c, N): the correction at step i is S(i) eta.
    """
    H, N, n = len(nominal), S.shape[1], actuator.ticks
    free, Phi = np.empty(H), np.empty((H, N))
    x: Array = past.x
    response: Array = np.zeros((STATES, N))
    v = -1.0
    for j in range(H):
        if abs(road.speed[j + 1] - v) > SPEED_STEP * abs(v):
            v = road.speed[j + 1]
            A, B_old, B_new, D = sampled_model(vehicle, v, T, actuator)
        old, new = input_at(j - n - 1, past.sent, nominal), input_at(j - n, past.sent, nominal)
        x = apply(A, x)
        response = product(A, response)
        for i in range(STATES):
            x[i] += B_old[i] * old + B_new[i] * new + D[i] * road.curvature[j + 1]
            x[i] += past.disturbance[i]
        if j > n:
            add_outer(response, B_old, S[min(j - n - 1, len(S) - 1)])
        if j >= n:
            add_outer(response, B_new, S[min(j - n, len(S) - 1)])
        free[j] = x[E_Y]
        put(Phi[j], response[E_Y])
    return free, Phi


@compiled
def input_at(i: int, sent: Array, nominal: Array) -> float:
    """Angle commanded at step i of the horizon; negative steps lie in the past [rad]."""
    if i >= 0:
        return float(nominal[i])
    return float(sent[max(len(sent) + i, 0)])


@compiled
def return_path(e_y: float, e_y_rate: float, v_x: float, H: int, T: float) -> Array:
    """Cross-track error to aim at, (H,) [m]: zero, or a gentle return from farther away.

    Without it a car that joins from metres away is pulled as hard as the tyres can; with it the
    pull does not depend on the friction that the road really has.

    Args:
        e_y: Cross-track error now [m].
        e_y_rate: Its rate now [m/s].
        v_x: Speed [m/s].
        H: Steps.
        T: Step [s].
    """
    side = 1.0 if e_y > 0.0 else -1.0
    rest, rate = max(side * e_y - HEAD_START, 0.0), side * e_y_rate
    fastest = min(RETURN_RATE, RETURN_SLOPE * v_x)
    aim = np.zeros(H)
    for j in range(H):
        wanted = -min(fastest, math.sqrt(2.0 * RETURN_ACCELERATION * rest))
        rate = min(max(wanted, rate - RETURN_ACCELERATION * T), rate + RETURN_ACCELERATION * T)
        rest = max(rest + rate * T, 0.0)
        aim[j] = side * rest
    return aim


@compiled
def steering_rows(
    M: Array, gamma: Array, L: Array, nominal: Array, bounds: Array, u: float, step: float
) -> None:
    """Fill increment and angle bounds on nominal + correction, Eqs. (13), (14): 4 N_c rows.

    Args:
        M: Rows to fill from the first on.
        gamma: Their bounds.
        L: Laguerre functions (N_c, N).
        nominal: Angles without correction (H,), feasible [rad].
        bounds: Of the angle at each step (H,) [rad].
        u: Angle in force [rad].
        step: Largest increment per tick [rad].
    """
    S = running_sum(L)
    for i in range(len(L)):
        increment = nominal[i] - (nominal[i - 1] if i > 0 else u)
        bound = max(bounds[i], abs(nominal[i]))
        put_two_sided(M, gamma, 4 * i, L[i], -step - increment, step - increment)
        put_two_sided(M, gamma, 4 * i + 2, S[i], -bound - nominal[i], bound - nominal[i])


@compiled
def preview_plan(
    vehicle: Vehicle, actuator: Actuator, gains: Gains, limits: Limits, past: Past, road: Road
) -> Plan:
    """Angle to command now: nominal steering plus the Laguerre correction of least cost.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        actuator: Delay and lag of the steering.
        gains: N_p, N_c, N, alpha, Q, R; the increments of the CORRECTION are weighted with R.
        limits: Bounds and solver.
        past: State, commands on their way, disturbance.
        road: Speed and curvature along the horizon of H = N_p + delay steps.
    """
    _, N_c, N, alpha, Q, R = gains
    u, H = past.sent[len(past.sent) - 1], len(road.speed) - 1
    bounds = angle_bounds(vehicle, road, limits.u_max, FRICTION_SHARE * limits.mu_g)
    nominal = nominal_steering(vehicle, road, u, bounds, limits)
    L = laguerre_sequence(alpha, N, N_c)
    free, Phi = predict_on_road(vehicle, actuator, limits.T, past, road, nominal, running_sum(L))
    v, e_y_rate = road.speed[1], past.x[V_Y] + road.speed[1] * past.x[E_PSI]
    aim = return_path(past.x[E_Y], e_y_rate, v, H, limits.T)
    E, K = quadratic_cost(Phi, aim - free, L, Q, R)
    h, s = 4 * N_c, output_steps(H, H, limits.half_width)
    if s > 0:
        E, K = with_slack(E, K, limits.slack_weight)
    m = h + 2 * s + 1 if s > 0 else h
    M, gamma = np.zeros((m, len(K))), np.zeros(m)
    steering_rows(M, gamma, L, nominal, bounds, u, limits.Delta_u_max)
    if s > 0:
        output_rows(M[h:], gamma[h:], Phi, -free, limits.half_width)
    solution = solve(Qp(E, K, M, gamma), limits)
    return decide(solution, L, nominal, free, Phi)


@compiled
def decide(solution: QpSolution, L: Array, nominal: Array, free: Array, Phi: Array) -> Plan:
    """Read the plan off a solution; without one, the nominal steering is the plan."""
    eta = solution.x[: L.shape[1]].copy()
    if solution.status != 0:
        eta[:] = 0.0
    active = 0
    for multiplier in solution.multipliers:
        active += multiplier > 0.0
    slack = solution.x[len(eta)] if len(solution.x) > len(eta) else 0.0
    steering = nominal[0] + dot(L[0], eta)
    lateral = free + apply(Phi, eta)
    return Plan(steering, active, slack, solution.iterations, solution.status, lateral)
