"""The car relative to its path, with its steering actuator: the model of the `preview` formulation.

State [v_y, e_psi, r, e_y, delta]: lateral velocity, heading error, yaw rate, cross-track error and
road-wheel angle. The first four obey A_c and B_c of Eq. (7), with the path's curvature kappa as a
known disturbance: e_psi' = r - v kappa, e_y' = v_y + v e_psi.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.parameters import SteeringParameters
from ampc_ros.model import MIN_SPEED, Vehicle, lateral_dynamics, matrix_exponential
from ampc_ros.small_matrices import apply, product, put

Array = NDArray[np.float64]

V_Y, E_PSI, R, E_Y, DELTA = range(5)
STATES = 5
GONE = 100.0
"""Rate at which a steering angle that is not used fades from the state [1/s]."""


class Actuator(NamedTuple):
    """Steering actuator as the controller believes it to be: delay = (ticks + share) T."""

    ticks: int
    share: float
    lag: float
    """Time constant; 0: the angle follows at once [s]."""


def actuator_of(steering: SteeringParameters, T: float) -> Actuator:
    """Give an actuator as whole ticks and a share of a tick of T [s] of delay, and its lag."""
    ticks, share = divmod(steering.delay / T, 1.0)
    if share > 1.0 - 1e-6:
        ticks, share = ticks + 1.0, 0.0
    return Actuator(int(ticks), share if share > 1e-6 else 0.0, steering.lag)


@compiled
def continuous_model(vehicle: Vehicle, v_x: float, lag: float) -> Array:
    """[[A, B, D], [0, 0, 0]] (7, 7): Eq. (7) on the path, input u, disturbance kappa.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r; stiffness of ONE tyre.
        v_x: Longitudinal speed, held at 1 m/s from below [m/s].
        lag: Time constant of the steering, 0: the angle follows at once and delta is not used [s].
    """
    A_c, B_c = lateral_dynamics(vehicle, v_x)
    block = np.zeros((STATES + 2, STATES + 2))
    for i in range(4):
        put(block[i], A_c[i])
        block[i, DELTA if lag > 0.0 else STATES] = B_c[i]
    block[E_PSI, STATES + 1] = -max(v_x, MIN_SPEED)
    if lag > 0.0:
        block[DELTA, DELTA], block[DELTA, STATES] = -1.0 / lag, 1.0 / lag
    else:
        block[DELTA, DELTA] = -GONE
    return block


@compiled
def sampled_model(
    vehicle: Vehicle, v_x: float, T: float, actuator: Actuator
) -> tuple[Array, Array, Array, Array]:
    """A (5, 5), B_old (5,), B_new (5,), D (5,) of one step of T [s].

    The input is held; it changes within the step where the delay is no multiple of T:
    x(k+1) = A x(k) + B_old u(k-n-1) + B_new u(k-n) + D kappa, with n = `actuator.ticks`.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        v_x: Longitudinal speed [m/s].
        T: Step [s].
        actuator: Its `share` is the part of the step for which the older input still acts.
    """
    _, share, lag = actuator
    block = continuous_model(vehicle, v_x, lag)
    new = matrix_exponential(block * ((1.0 - share) * T))
    A_new = new[:STATES, :STATES].copy()
    if share == 0.0:
        return A_new, np.zeros(STATES), new[:STATES, STATES].copy(), new[:STATES, STATES + 1].copy()
    old = matrix_exponential(block * (share * T))
    A = product(A_new, old[:STATES, :STATES])
    B_old = apply(A_new, old[:STATES, STATES])
    D = apply(A_new, old[:STATES, STATES + 1]) + new[:STATES, STATES + 1]
    return A, B_old, new[:STATES, STATES].copy(), D


@compiled
def side_acceleration(vehicle: Vehicle, v_x: float, T: float, change: Array) -> float:
    """Lateral acceleration that explains an unmodelled change of v_y and r in a step [m/s^2].

    A side force and a yaw moment that are held act through the tyres' damping: their share of the
    change is the integral of e^(A t) over the step, not T.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        v_x: Longitudinal speed [m/s].
        T: Step [s].
        change: (5,) of the state in a step.
    """
    A_c, _ = lateral_dynamics(vehicle, v_x)
    block = np.zeros((4, 4))
    block[0, 0], block[0, 1] = A_c[V_Y, V_Y], A_c[V_Y, R]
    block[1, 0], block[1, 1] = A_c[R, V_Y], A_c[R, R]
    block[0, 2] = block[1, 3] = 1.0
    G = matrix_exponential(block * T)[:2, 2:]
    determinant = G[0, 0] * G[1, 1] - G[0, 1] * G[1, 0]
    return float((G[1, 1] * change[V_Y] - G[0, 1] * change[R]) / determinant)


@compiled
def understeer_gradient(vehicle: Vehicle) -> float:
    """K_us = m/L (l_r / 2 C_f - l_f / 2 C_r) [rad s^2/m]."""
    m, _, l_f, l_r, C_f, C_r = vehicle
    return m / (l_f + l_r) * (l_r / (2 * C_f) - l_f / (2 * C_r))


@compiled
def steady_steering(vehicle: Vehicle, v_x: float, curvature: float) -> float:
    """Angle that holds a curvature in steady state, kappa (L + K_us v^2) [rad]."""
    return curvature * (vehicle[2] + vehicle[3] + understeer_gradient(vehicle) * v_x**2)


@compiled
def road_steering(vehicle: Vehicle, v_x: float, curvature: float, change: float) -> float:
    """Angle that keeps the centre of gravity on a bend that opens or closes [rad].

    Eq. (7) solved for delta with e_y = 0: a_y = v^2 kappa fixes the sum of the axle forces and
    I_z r' their moment, with side-slip b kappa and yaw rate v kappa - b kappa' to first order.

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


@compiled
def angle_bound(vehicle: Vehicle, v_x: float, u_max: float, a_y_max: float) -> float:
    """Bound of the angle that follows the tyre: min(u_max, a_y_max (L / v^2 + K_us)) [rad]."""
    v = max(v_x, MIN_SPEED)
    L = vehicle[2] + vehicle[3]
    tyre = a_y_max * (L / v**2 + max(understeer_gradient(vehicle), 0.0))
    return min(u_max, tyre)
