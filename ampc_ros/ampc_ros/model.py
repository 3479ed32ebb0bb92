"""What the controller believes of the car: bicycle model, Eqs. (1)-(9)."""

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from ampc_ros.small_matrices import product, put

Array = NDArray[np.float64]
Vehicle = tuple[float, float, float, float, float, float]
"""`astuple(ChassisParameters)`: m, I_z, l_f, l_r, C_f, C_r."""

MIN_SPEED = 1.0
"""The model divides by the speed; below this it is held [m/s]."""


@compiled
def lateral_dynamics(vehicle: Vehicle, v_x: float) -> tuple[Array, Array]:
    """Continuous-time bicycle model, A_c (4, 4) and B_c (4,) of Eq. (7).

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r; stiffness of ONE tyre.
        v_x: Longitudinal speed, held at 1 m/s from below [m/s].

    Note:
        State [v_y, yaw, yaw rate, Y], input: front steering angle. Eq. (6) prints C_yr with
        delta_f in its yaw line; Eq. (7) has C_yf, which is used here.
    """
    m, I_z, l_f, l_r, C_f, C_r = vehicle
    v = max(v_x, MIN_SPEED)
    A = np.zeros((4, 4))
    A[0, 0] = -2 * (C_f + C_r) / (m * v)
    A[0, 2] = -v - 2 * (C_f * l_f - C_r * l_r) / (m * v)
    A[1, 2] = 1.0
    A[2, 0] = -2 * (C_f * l_f - C_r * l_r) / (I_z * v)
    A[2, 2] = -2 * (C_f * l_f**2 + C_r * l_r**2) / (I_z * v)
    A[3, 0] = 1.0
    A[3, 1] = v
    return A, np.array([2 * C_f / m, 0.0, 2 * C_f * l_f / I_z, 0.0])


@compiled
def matrix_exponential(A: Array) -> Array:
    """e^A of a small matrix (n, n): Taylor series of order 12 after scaling, then squaring."""
    n, halvings, norm = len(A), 0, 0.0
    for a in A.flat:
        norm += abs(a)
    while norm > 0.5:
        norm /= 2
        halvings += 1
    term, result = np.eye(n), np.eye(n)
    for k in range(1, 13):
        term = product(term, A)
        for i in range(n):
            for j in range(n):
                term[i, j] /= k * 2.0**halvings
                result[i, j] += term[i, j]
    for _ in range(halvings):
        result = product(result, result)
    return result


@compiled
def zero_order_hold(A_c: Array, B_c: Array, T: float) -> tuple[Array, Array]:
    """Discrete-time model of Eq. (8), A_k (n, n) and B (n,), for an input held over T [s].

    Note:
        The paper does not name its discretisation. Forward Euler at T = 0.1 s is unstable below
        4.6 m/s, so exp([[A_c, B_c], [0, 0]] T) is used.
    """
    n = len(A_c)
    block = np.zeros((n + 1, n + 1))
    for i in range(n):
        block[i, n] = B_c[i] * T
        for j in range(n):
            block[i, j] = A_c[i, j] * T
    exponential = matrix_exponential(block)
    return exponential[:n, :n].copy(), exponential[:n, n].copy()


@compiled
def augment(A_k: Array, B: Array) -> tuple[Array, Array]:
    """Model with embedded integrator, A~ (n+1, n+1) and B~ (n+1,) of Eq. (9).

    Note:
        State [Delta x, y], input Delta u; y is the last state of x, so C = [0 .. 0 1] both here
        and there.
    """
    n = len(A_k)
    A, B_augmented = np.zeros((n + 1, n + 1)), np.empty(n + 1)
    for i in range(n + 1):
        k = min(i, n - 1)
        put(A[i], A_k[k])
        B_augmented[i] = B[k]
    A[n, n] = 1.0
    return A, B_augmented
