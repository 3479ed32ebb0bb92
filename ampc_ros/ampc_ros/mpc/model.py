"""Bicycle model of the controller, Eqs. (1)-(9).

State [v_y, yaw, yaw rate, Y, delta]: the four states of the paper and the road-wheel angle of a
steering with lag. Without a lag the fifth state is unused.
"""

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.parameters import MIN_SPEED as MIN_SPEED
from ampc_msgs_config.types import Array
from ampc_ros.mpc.small_matrices import Scratch, matrix

BicycleParameters = tuple[float, float, float, float, float, float]
"""`astuple(ChassisParameters)`: m, I_z, l_f, l_r, C_f, C_r."""

V_Y, YAW, YAW_RATE, Y, DELTA = range(5)
STATES = 5
TAYLOR_TERMS = 13


@in_place
def lateral_dynamics(vehicle: BicycleParameters, v_x: float, A: Array, B: Array) -> None:
    """Fill the continuous-time bicycle model A_c (4, 4) and B_c (4,) of Eq. (7).

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r; stiffness of ONE tyre.
        v_x: Longitudinal speed; below 1 m/s the model of 1 m/s is used [m/s].
        A: Receives A_c, zeros before.
        B: Receives B_c, zeros before.

    Note:
        State [v_y, yaw, yaw rate, Y], input: front steering angle. Eq. (6) prints C_yr with
        delta_f in its yaw line; Eq. (7) has C_yf, which is used here.
    """
    m, I_z, l_f, l_r, C_f, C_r = vehicle
    v = max(v_x, MIN_SPEED)
    A[0, 0] = -2 * (C_f + C_r) / (m * v)
    A[0, 2] = -v - 2 * (C_f * l_f - C_r * l_r) / (m * v)
    A[1, 2] = 1.0
    A[2, 0] = -2 * (C_f * l_f - C_r * l_r) / (I_z * v)
    A[2, 2] = -2 * (C_f * l_f**2 + C_r * l_r**2) / (I_z * v)
    A[3, 0] = 1.0
    A[3, 1] = v
    B[0], B[2] = 2 * C_f / m, 2 * C_f * l_f / I_z


@in_place
def exponential_integrals(D: Array, T: float, Phi: Array, scratch: Scratch) -> None:
    """Fill e^(D T) and its integrals: Phi_k = int_0^T (T - s)^(k-1) / (k-1)! e^(D s) ds.

    Taylor series over a step that is halved until D T is small. The step is then doubled again by
    Phi_k(2 T) = Phi_0 Phi_k + sum_j T^j / j! Phi_(k-j).

    Args:
        D: Small matrix (n, n).
        T: Time [s].
        Phi: Receives Phi_0 .. Phi_3, (4, n, n), zeros before.
        scratch: Auxiliary memory.
    """
    begin, n, norm, h, doublings = scratch.used[0], len(D), 0.0, T, 0
    for i in range(n):
        for j in range(n):
            norm += abs(D[i, j])
    while norm * h > 0.5:
        h /= 2
        doublings += 1
    term, product = matrix(scratch, n, n), matrix(scratch, n, n)
    for i in range(n):
        term[i, i] = 1.0
    for order in range(TAYLOR_TERMS):
        share = 1.0
        for k in range(4):
            for i in range(n):
                for j in range(n):
                    Phi[k, i, j] += share * term[i, j]
            share *= h / (order + k + 1)
        multiply(term, D, product)
        for i in range(n):
            for j in range(n):
                term[i, j] = product[i, j] * h / (order + 1)
    for _ in range(doublings):
        for k in range(3, -1, -1):
            multiply(Phi[0], Phi[k], product)
            for i in range(n):
                for j in range(n):
                    share, earlier = h, product[i, j]
                    for order in range(1, k):
                        earlier += share * Phi[k - order, i, j]
                        share *= h / (order + 1)
                    Phi[k, i, j] = earlier + (Phi[k, i, j] if k > 0 else 0.0)
        h *= 2
    scratch.used[0] = begin


@in_place
def multiply(A: Array, B: Array, C: Array) -> None:
    """Fill C = A B for square matrices (n, n)."""
    n = len(A)
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += A[i, k] * B[k, j]
            C[i, j] = total


@in_place
def zero_order_hold(
    vehicle: BicycleParameters,
    v_x: float,
    lag: float,
    T: float,
    A: Array,
    B: Array,
    scratch: Scratch,
) -> None:
    """Fill the discrete-time model of Eq. (8), A_k (5, 5) and B (5,), for an input held over T.

    Only v_y, yaw rate and delta have dynamics of their own. Yaw and Y are integrals of them. The
    result equals exp([[A_c, B_c], [0, 0]] T) to rounding, at a tenth of its cost.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        v_x: Longitudinal speed; below 1 m/s the model of 1 m/s is used [m/s].
        lag: Time constant of the steering; 0: the angle follows at once [s].
        T: Time [s].
        A: Receives A_k, zeros before.
        B: Receives B, zeros before.
        scratch: Auxiliary memory.

    Note:
        The paper does not name its discretisation. Forward Euler at T = 0.1 s is unstable below
        4.6 m/s.
    """
    begin, v, n = scratch.used[0], max(v_x, MIN_SPEED), 3 if lag > 0.0 else 2
    A_c, B_c = matrix(scratch, 4, 4), matrix(scratch, 1, 4)[0]
    lateral_dynamics(vehicle, v_x, A_c, B_c)
    D, b = matrix(scratch, n, n), matrix(scratch, 1, n)[0]  # of z = [v_y, r(, delta)]
    for i in range(2):
        for j in range(2):
            D[i, j] = A_c[2 * i, 2 * j]
        b[i] = B_c[2 * i]
    if lag > 0.0:
        D[0, 2], D[1, 2], D[2, 2] = b[0], b[1], -1.0 / lag
        b[0], b[1], b[2] = 0.0, 0.0, 1.0 / lag
    Phi = matrix(scratch, 4 * n, n).reshape(4, n, n)
    exponential_integrals(D, T, Phi, scratch)
    A[YAW, YAW] = A[Y, Y] = 1.0
    A[Y, YAW] = v * T
    for j in range(n):
        z = 2 * j  # position of z_j in the state
        for i in range(n):
            A[2 * i, z] = Phi[0, i, j]
            B[2 * i] += Phi[1, i, j] * b[j]
        A[YAW, z] = Phi[1, 1, j]
        A[Y, z] = Phi[1, 0, j] + v * Phi[2, 1, j]
        B[YAW] += Phi[2, 1, j] * b[j]
        B[Y] += (Phi[2, 0, j] + v * Phi[3, 1, j]) * b[j]
    scratch.used[0] = begin


@in_place
def augment(A_k: Array, B: Array, A_augmented: Array, B_augmented: Array) -> None:
    """Fill the model with embedded integrator, A~ (5, 5) and B~ (5,) of Eq. (9).

    Args:
        A_k: Matrix of Eq. (8); only its first four states are used.
        B: Input vector of Eq. (8).
        A_augmented: Receives A~, zeros before.
        B_augmented: Receives B~.

    Note:
        State [Delta x, y], input Delta u. The output y = Y is the last state of both models, so
        C = [0 .. 0 1] for both.
    """
    for i in range(5):
        k = min(i, 3)
        for j in range(4):
            A_augmented[i, j] = A_k[k, j]
        B_augmented[i] = B[k]
    A_augmented[4, 4] = 1.0
