"""Model of the prediction-error method: steering actuator and single-track car, simulated.

Compiled; see ampc_ros/doc/compiled_code.md.
"""

import math
from typing import NamedTuple

from ampc_msgs_config.compiled import compiled, inlined
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.types import Array

SHORTEST_SLIP = 1.5
"""Least relaxation length in steps of the integration, for stability."""
LOWEST_SPEED = 0.5
"""Speed by which the slip angles are divided at least [m/s]."""
LEAST_LOAD = 0.1
"""Least load of a tyre, as a share of its static load."""


class ModelActuator(NamedTuple):
    """Steering actuator: delay, first-order lag, rate limit, in this order."""

    delay: float
    """[s]"""
    lag: float
    """[s]"""
    max_rate: float
    """[rad/s]"""
    gain: float
    """Road-wheel angle per unit of the command: 1 / ratio."""
    offset: float
    """Road-wheel angle at the command 0 [rad]."""


class ModelCar(NamedTuple):
    """Single-track car with two tyres on each axle."""

    mass: float
    l_f: float
    l_r: float
    I_z: float
    C_f: float
    """Both tyres of the front axle [N/rad]."""
    C_r: float
    """Both tyres of the rear axle [N/rad]."""
    relaxation: float
    """Relaxation length [m]."""
    curvature: float
    """Share `q` by which the tyre's curve bends, see `tyre_force`."""
    front_drive: float
    """Front share of the drive force."""
    front_brake: float
    """Front share of the brake force."""
    rolling: float
    """Rolling resistance divided by the weight."""
    friction: float
    """mu"""
    parallel: float
    """1 - A with the Ackermann share A of the steering."""
    half_track: float
    """[m]"""
    height: float
    """Height of the centre of gravity [m]."""
    front_roll: float
    """Relative change of the load of a front tyre per lateral acceleration [s^2/m]."""
    rear_roll: float
    """The same of a rear tyre."""
    stiffest_load: float
    """Load of the largest stiffness of a tyre in static loads, p."""


@compiled
def actuator_angles(time: Array, command: Array, grid: Array, actuator: ModelActuator) -> Array:
    """Return the road-wheel angle at the times of a grid (n,) [rad].

    The delayed command is averaged over each step of the grid, so that the angle is a continuous
    function of the delay.

    Args:
        time: (m,) times of the commands, increasing [s]; each holds until the next.
        command: (m,) commands in units of the topic.
        grid: (n,) times at equal distances [s].
        actuator: Parameters.
    """
    n, step = len(grid), grid[1] - grid[0]
    share = 1.0 - math.exp(-step / actuator.lag) if actuator.lag > 1e-6 else 1.0
    turn = actuator.max_rate * step
    angles, k = grid * 0.0, 0
    begin = grid[0] - actuator.delay
    while k + 1 < len(time) and time[k + 1] <= begin:
        k += 1
    angle = actuator.gain * command[k] + actuator.offset
    angles[0] = angle
    for i in range(1, n):
        end, at, mean = grid[i] - actuator.delay, begin, 0.0
        while k + 1 < len(time) and time[k + 1] < end:
            mean += command[k] * (max(time[k + 1], at) - at)
            at = max(time[k + 1], at)
            k += 1
        mean = (mean + command[k] * (end - at)) / step
        target = actuator.gain * mean + actuator.offset
        angle += min(max(share * (target - angle), -turn), turn)
        angles[i] = angle
        begin = end
    return angles


@inlined
def tyre_force(slip: float, u: float, stiffness: float, load: float, car: ModelCar) -> float:
    """Return the lateral force of a tyre: C alpha / sqrt(1 + q (C alpha / F_z)^2) [N].

    Its linear and cubic terms are those of the Magic Formula with q = (0.48 to 0.7) / mu^2 for
    shape factors of 1.35 to 1.5. C is proportional to u / (p^2 + u^2). H. B. Pacejka, Tire and
    Vehicle Dynamics, 3rd ed., section 4.3.

    Args:
        slip: Slip angle alpha [rad].
        u: Load divided by the static load.
        stiffness: C at u = 1 [N/rad].
        load: Static load [N].
        car: Parameters.
    """
    p2 = car.stiffest_load**2
    linear = stiffness * slip * u * (p2 + 1.0) / (p2 + u**2)
    return float(linear / math.sqrt(1.0 + car.curvature * (linear / (load * u)) ** 2))


@inlined
def rates(
    z: tuple[float, float, float, float],
    delta: float,
    v_x: float,
    a_x: float,
    relaxation: float,
    car: ModelCar,
) -> tuple[float, float, float, float]:
    """Return the time derivative of v_y, r and both transient slip angles.

    * Each axle has two tyres, whose loads change with the acceleration in both directions.
    * Drive and brake force follow from the measured acceleration. At the front wheels they pull the
      car into the bend, and reduce the lateral force (friction circle).
    * Front wheels that are not steered as Ackermann did (A = 1) have different slip angles. The
      outer one has the larger slip and the larger load. The difference of their forces turns the
      car out of the bend. That moment is multiplied by 1 - A, although the part of the loads
      remains with A = 1: 0.15 % of the yaw rate at a steering angle of 0.2 rad.
    """
    v_y, r, slip_f, slip_r = z
    L = car.l_f + car.l_r
    weight = car.mass * GRAVITY
    W_f, W_r = weight * car.l_r / L, weight * car.l_f / L
    v = max(v_x, LOWEST_SPEED)
    # Slip angles of left and right wheels differ: their speeds do
    beta, spread = math.atan((v_y + car.l_f * r) / v), car.half_track * r / v
    cosine = math.cos(beta)
    lead = car.parallel * spread * math.sin(beta) * cosine
    # Tyres: load of the axle, shifted to the outer side
    pitch = a_x * car.height / GRAVITY
    u_f, u_r = max(1.0 - pitch / car.l_r, LEAST_LOAD), max(1.0 + pitch / car.l_f, LEAST_LOAD)
    x_f = min(max(car.front_roll * v * r, LEAST_LOAD - u_f), u_f - LEAST_LOAD)
    x_r = min(max(car.rear_roll * v * r, LEAST_LOAD - u_r), u_r - LEAST_LOAD)
    left = tyre_force(slip_f - lead, u_f - x_f, car.C_f / 2, W_f / 2, car)
    right = tyre_force(slip_f + lead, u_f + x_f, car.C_f / 2, W_f / 2, car)
    F_r = tyre_force(slip_r * (1.0 + spread), u_r - x_r, car.C_r / 2, W_r / 2, car)
    F_r += tyre_force(slip_r * (1.0 - spread), u_r + x_r, car.C_r / 2, W_r / 2, car)
    # Force along the front wheels
    F_f, sin, cos = left + right, math.sin(delta), math.cos(delta)
    F_x = car.mass * (a_x - v_y * r) + car.rolling * weight + F_f * sin
    F_x *= car.front_drive if F_x > 0.0 else car.front_brake
    F_f *= math.sqrt(max(1.0 - (F_x / (car.friction * W_f)) ** 2, 0.0))
    Y_f = F_f * cos + F_x * sin
    moment = car.parallel * car.half_track * (right - left) * sin
    toward = v / relaxation
    return (
        (Y_f + F_r) / car.mass - v_x * r,
        (car.l_f * Y_f - car.l_r * F_r - moment) / car.I_z,
        toward * (delta - beta - lead * spread * cosine**2 - slip_f),
        toward * (-math.atan((v_y - car.l_r * r) / v) - slip_r),
    )


@compiled
def car_motion(
    angles: Array, speed: Array, acceleration: Array, restart: Array, step: float, car: ModelCar
) -> Array:
    """Return lateral velocity at the centre of gravity and yaw rate (n, 2), by Runge-Kutta.

    Args:
        angles: (n,) road-wheel angle at each time of the grid [rad].
        speed: (n,) longitudinal speed [m/s].
        acceleration: (n,) its derivative [m/s^2].
        restart: (n,) yaw rate with which the motion begins anew [rad/s]; nan: it continues.
        step: Step of the grid [s].
        car: Parameters.
    """
    n = len(angles)
    L = car.l_f + car.l_r
    motion = angles.repeat(2).reshape((n, 2)) * 0.0
    v_y, r, slip_f, slip_r = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        if i == 0 or not math.isnan(restart[i]):
            # steady circle of this yaw rate
            r = 0.0 if math.isnan(restart[i]) else restart[i]
            F = car.mass * speed[i] * r / L
            slip_f, slip_r = F * car.l_r / car.C_f, F * car.l_f / car.C_r
            v_y = car.l_r * r - slip_r * max(speed[i], LOWEST_SPEED)
        motion[i, 0], motion[i, 1] = v_y, r
        if i + 1 == n:
            break
        v_0, v_1, a = speed[i], speed[i + 1], acceleration[i]
        d_0, d_1 = angles[i], angles[i + 1]
        sigma = max(car.relaxation, max(v_0, v_1) * step / SHORTEST_SLIP)
        d_m, v_m = (d_0 + d_1) / 2, (v_0 + v_1) / 2
        z = v_y, r, slip_f, slip_r
        k_1 = rates(z, d_0, v_0, a, sigma, car)
        z_2 = moved(z, k_1, step / 2)
        k_2 = rates(z_2, d_m, v_m, a, sigma, car)
        z_3 = moved(z, k_2, step / 2)
        k_3 = rates(z_3, d_m, v_m, a, sigma, car)
        z_4 = moved(z, k_3, step)
        k_4 = rates(z_4, d_1, v_1, a, sigma, car)
        v_y += step / 6 * (k_1[0] + 2 * k_2[0] + 2 * k_3[0] + k_4[0])
        r += step / 6 * (k_1[1] + 2 * k_2[1] + 2 * k_3[1] + k_4[1])
        slip_f += step / 6 * (k_1[2] + 2 * k_2[2] + 2 * k_3[2] + k_4[2])
        slip_r += step / 6 * (k_1[3] + 2 * k_2[3] + 2 * k_3[3] + k_4[3])
    return motion


@inlined
def moved(
    z: tuple[float, float, float, float], rate: tuple[float, float, float, float], step: float
) -> tuple[float, float, float, float]:
    """Return z + step * rate."""
    return (
        z[0] + step * rate[0],
        z[1] + step * rate[1],
        z[2] + step * rate[2],
        z[3] + step * rate[3],
    )
