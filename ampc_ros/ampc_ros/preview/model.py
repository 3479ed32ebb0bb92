"""Model of the preview formulation: the car relative to its path, with its steering actuator.

State [v_y, e_psi, r, e_y, delta]: lateral velocity, heading error, yaw rate, cross-track error and
road-wheel angle. The first four obey A_c and B_c of Eq. (7), with the path's curvature kappa as a
known disturbance: e_psi' = r - v kappa, e_y' = v_y + v e_psi.
"""

from typing import NamedTuple

from ampc_msgs_config import parameters
from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.parameters import MIN_SPEED
from ampc_msgs_config.types import Array
from ampc_ros.mpc.internal_model import Actuator
from ampc_ros.mpc.model import (
    STATES,
    V_Y,
    YAW_RATE,
    BicycleParameters,
    exponential_integrals,
    lateral_dynamics,
    zero_order_hold,
)
from ampc_ros.mpc.small_matrices import Scratch, matrix, vector

E_PSI, E_Y = 1, 3
"""Positions of heading error and cross-track error: those of yaw and Y in `mpc.model`."""


class SampledModel(NamedTuple):
    """Sampled model x(k+1) = A x(k) + B_old u(k-n-1) + B_new u(k-n) + D kappa, delay of n ticks."""

    A: Array
    """(5, 5)."""
    B_old: Array
    """(5,) for the input that still acts at the start of the step."""
    B_new: Array
    """(5,) for the input that replaces it within the step."""
    D: Array
    """(5,) for the curvature of the path."""


@inlined
def blank_model(scratch: Scratch) -> SampledModel:
    """Allocate a model in scratch memory."""
    A, B_old = matrix(scratch, STATES, STATES), vector(scratch, STATES)
    return SampledModel(A, B_old, vector(scratch, STATES), vector(scratch, STATES))


@in_place
def sample_model(
    vehicle: BicycleParameters,
    v_x: float,
    T: float,
    actuator: Actuator,
    model: SampledModel,
    scratch: Scratch,
) -> None:
    """Fill the model of one step of T [s].

    The input is held. It changes within the step if the delay is no multiple of T.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        v_x: Longitudinal speed [m/s].
        T: Step [s].
        actuator: Its `share` is the part of the step for which the older input still acts.
        model: Filled.
        scratch: Auxiliary memory.
    """
    begin, (_, share, lag) = scratch.used[0], actuator
    old, new = share * T, (1.0 - share) * T
    A_old, A_new = matrix(scratch, STATES, STATES), matrix(scratch, STATES, STATES)
    B_old, B_new = vector(scratch, STATES), vector(scratch, STATES)
    zero_order_hold(vehicle, v_x, lag, new, A_new, B_new, scratch)
    if old > 0.0:
        zero_order_hold(vehicle, v_x, lag, old, A_old, B_old, scratch)
    else:
        for i in range(STATES):
            A_old[i, i] = 1.0
    v = max(v_x, MIN_SPEED)
    for i in range(STATES):
        model.B_old[i], model.B_new[i] = 0.0, B_new[i]
        for k in range(STATES):
            model.B_old[i] += A_new[i, k] * B_old[k]
            model.A[i, k] = 0.0
            for j in range(STATES):
                model.A[i, k] += A_new[i, j] * A_old[j, k]
    model.D[E_PSI], model.D[E_Y] = -v * T, -0.5 * (v * T) ** 2
    scratch.used[0] = begin


@in_place
def unmodelled_accelerations(
    vehicle: BicycleParameters, v_x: float, T: float, change: Array, scratch: Scratch
) -> tuple[float, float]:
    """Return the accelerations that explain an unmodelled change of v_y and r [m/s^2, rad/s^2].

    A constant side force and yaw moment act against the damping of the tyres: they change the state
    by the integral of e^(A t) over the step, not by T.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        v_x: Longitudinal speed [m/s].
        T: Step [s].
        change: Unmodelled change of the state in a step (5,).
        scratch: Auxiliary memory.
    """
    begin = scratch.used[0]
    A_c, D, G = matrix(scratch, 4, 4), matrix(scratch, 2, 2), matrix(scratch, 8, 2).reshape(4, 2, 2)
    lateral_dynamics(vehicle, v_x, A_c, vector(scratch, 4))
    D[0, 0], D[0, 1] = A_c[V_Y, V_Y], A_c[V_Y, YAW_RATE]
    D[1, 0], D[1, 1] = A_c[YAW_RATE, V_Y], A_c[YAW_RATE, YAW_RATE]
    exponential_integrals(D, T, G, scratch)
    scratch.used[0] = begin
    determinant = G[1, 0, 0] * G[1, 1, 1] - G[1, 0, 1] * G[1, 1, 0]
    lateral = (G[1, 1, 1] * change[V_Y] - G[1, 0, 1] * change[YAW_RATE]) / determinant
    yaw = (G[1, 0, 0] * change[YAW_RATE] - G[1, 1, 0] * change[V_Y]) / determinant
    return lateral, yaw


understeer_gradient = in_place(parameters.understeer_gradient)
"""`parameters.understeer_gradient`, compiled."""
cornering_angle = in_place(parameters.cornering_angle)
"""`parameters.cornering_angle`, compiled."""


@in_place
def steady_steering(vehicle: BicycleParameters, v_x: float, curvature: float) -> float:
    """Return the angle of steady-state cornering, kappa (L + K_us v^2) [rad]."""
    return curvature * (vehicle[2] + vehicle[3] + understeer_gradient(vehicle) * v_x**2)


@in_place
def road_steering(vehicle: BicycleParameters, v_x: float, curvature: float, change: float) -> float:
    """Return the angle that keeps the centre of gravity on a path of changing curvature [rad].

    Eq. (7) solved for delta with e_y = 0: a_y = v^2 kappa fixes the sum of the axle forces and
    I_z r' their moment, with sideslip b kappa and yaw rate v kappa - b kappa' to first order.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        v_x: Speed [m/s].
        curvature: kappa [1/m].
        change: kappa' [1/(m s)].
    """
    m, I_z, l_f, l_r, C_f, C_r = vehicle
    L, v = l_f + l_r, max(v_x, MIN_SPEED)
    b = l_r - l_f * m * v**2 / (2 * C_r * L)
    inertia = I_z * v / L * (1 / (2 * C_f) + 1 / (2 * C_r))
    return steady_steering(vehicle, v_x, curvature) + (inertia - L * b / v) * change


@in_place
def angle_bound(vehicle: BicycleParameters, v_x: float, u_max: float, a_y_max: float) -> float:
    """Return the angle bound that the tyre sets: min(u_max, a_y_max (L / v^2 + K_us)) [rad]."""
    L = vehicle[2] + vehicle[3]
    return min(u_max, cornering_angle(L, understeer_gradient(vehicle), v_x, a_y_max))
