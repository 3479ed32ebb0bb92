"""The car that really drives: dual track, free to move along, sideways and in yaw.

`state` is a row of `SIZE` numbers, so that a swarm of cars is a matrix. Wheels are numbered front
left, front right, rear left, rear right. Position and velocity are those of the centre of gravity.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled
from sim_vehicle.actuator import command_in_force, queue_up, turned
from sim_vehicle.aerodynamics import air_forces
from sim_vehicle.driver import pedal_force, rolling_resistance, stands, wheel_demands
from sim_vehicle.pacejka import transient_slip, tyre_forces
from sim_vehicle.parameters import GRAVITY, Numbers

Array = NDArray[np.float64]

X, Y, YAW, V_X, V_Y, YAW_RATE = range(6)
A_X, A_Y = 6, 7
"""Accelerations as the wheel loads know them, lagged [m/s^2]."""
SLIP = 8
"""Transient slip of the first of the four wheels."""
STEERING = 12
"""Real road-wheel angle [rad]."""
SIZE = 13
STAGES = ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))
"""Classical Runge-Kutta: where each stage looks, and its weight in sixths."""


@compiled
def wheel_loads(
    a_x: float, a_y: float, chassis: tuple[float, ...], body: tuple[float, ...]
) -> tuple[float, float, float, float]:
    """Give the four wheel loads [N]: none is negative, and their sum is the weight.

    Args:
        a_x: Acceleration forwards [m/s^2].
        a_y: Acceleration to the left [m/s^2].
        chassis: `astuple` of ChassisParameters.
        body: `astuple` of BodyParameters.
    """
    m, _, l_f, l_r, _, _ = chassis
    track, h, front_share, _ = body
    weight = m * GRAVITY
    front = min(max((weight * l_r - m * a_x * h) / (l_f + l_r), 0.0), weight) / 2.0
    rear = weight / 2.0 - front
    roll = m * a_y * h / track
    shift_f = min(max(front_share * roll, -front), front)
    shift_r = min(max((1.0 - front_share) * roll, -rear), rear)
    return front - shift_f, front + shift_f, rear - shift_r, rear + shift_r


@compiled
def wheel(
    s: float,
    velocity: tuple[float, float],
    direction: tuple[float, float],
    demand: float,
    load: float,
    road: tuple[float, float],
    tyre: tuple[float, ...],
) -> tuple[float, float, float]:
    """Give the rate of a wheel's transient slip [1/s] and its force along body x and y [N].

    Args:
        s: Transient slip.
        velocity: Of the wheel centre in the body frame [m/s].
        direction: Cosine and sine of the wheel's angle.
        demand: Longitudinal force asked for [N].
        load: Wheel load [N].
        road: Friction coefficient, and the step of the integration [s].
        tyre: Numbers of the axle's tyre.
    """
    (v_x, v_y), (cos, sin), (friction, step) = velocity, direction, road
    s_rate, slip = transient_slip(s, cos * v_x + sin * v_y, cos * v_y - sin * v_x, step, tyre)
    F_x, F_y = tyre_forces(slip, demand, load, friction, tyre)
    return s_rate, cos * F_x - sin * F_y, sin * F_x + cos * F_y


@compiled
def wheel_forces(
    state: Array, force: float, road: tuple[float, float], vehicle: Numbers, rate: Array
) -> tuple[float, float, float]:
    """Give the sums of the tyre forces [N] and of their moments about z [N m].

    Writes the rates of the transient slips into `rate`.
    """
    chassis, _, body, front_tyre, rear_tyre, _, powertrain = vehicle
    _, _, l_f, l_r, _, _ = chassis
    loads = wheel_loads(state[A_X], state[A_Y], chassis, body)
    front_demand, rear_demand = wheel_demands(force, powertrain)
    steered = math.cos(state[STEERING]), math.sin(state[STEERING])
    X_sum, Y_sum, N_sum = 0.0, 0.0, 0.0
    for i in range(4):
        front, side = i < 2, 0.5 * body[0] * (1.0 - 2.0 * (i % 2))
        x = l_f if front else -l_r
        velocity = state[V_X] - side * state[YAW_RATE], state[V_Y] + x * state[YAW_RATE]
        direction = steered if front else (1.0, 0.0)
        demand, tyre = (front_demand, front_tyre) if front else (rear_demand, rear_tyre)
        rate[SLIP + i], F_x, F_y = wheel(
            state[SLIP + i], velocity, direction, demand, loads[i], road, tyre
        )
        X_sum, Y_sum, N_sum = X_sum + F_x, Y_sum + F_y, N_sum + x * F_y - side * F_x
    return X_sum, Y_sum, N_sum


@compiled
def derivative(
    state: Array,
    target_speed: float,
    wind: tuple[float, float],
    road: tuple[float, float],
    vehicle: Numbers,
    rate: Array,
) -> None:
    """Write the time derivative of the state into `rate`.

    The wheel loads follow the accelerations through a first-order lag (the time that body roll and
    pitch take): forces then depend on the state alone, and no algebraic loop has to be solved.
    """
    chassis, _, body, _, _, air, powertrain = vehicle
    m, I_z = chassis[0], chassis[1]
    yaw, v_x, v_y, r = state[YAW], state[V_X], state[V_Y], state[YAW_RATE]
    X_air, Y_air, N_air = air_forces(yaw, v_x, v_y, wind, air)
    rolling = rolling_resistance(v_x, m, powertrain)
    force = pedal_force(v_x, target_speed, rolling - X_air, m, powertrain)
    X_tyre, Y_tyre, N_tyre = wheel_forces(state, force, road, vehicle, rate)
    a_x, a_y = (X_tyre + X_air - rolling) / m, (Y_tyre + Y_air) / m
    cos, sin = math.cos(yaw), math.sin(yaw)
    rate[X], rate[Y], rate[YAW] = cos * v_x - sin * v_y, sin * v_x + cos * v_y, r
    rate[V_X], rate[V_Y], rate[YAW_RATE] = a_x + r * v_y, a_y - r * v_x, (N_tyre + N_air) / I_z
    rate[A_X], rate[A_Y] = (a_x - state[A_X]) / body[3], (a_y - state[A_Y]) / body[3]
    rate[STEERING] = 0.0
    if stands(v_x, v_y, target_speed):
        rate[V_X] = 0.0


@compiled
def rk4_step(
    state: Array,
    target_speed: float,
    wind: tuple[float, float],
    road: tuple[float, float],
    vehicle: Numbers,
    work: Array,
) -> None:
    """Advance the state in place by one step; `work` is scratch of shape (3, SIZE)."""
    rate, trial, total = work[0], work[1], work[2]
    step = road[1]
    rate[:] = 0.0
    total[:] = 0.0
    for reach, weight in STAGES:
        for i in range(SIZE):
            trial[i] = state[i] + reach * step * rate[i]
        derivative(trial, target_speed, wind, road, vehicle, rate)
        for i in range(SIZE):
            total[i] += weight * rate[i]
    for i in range(SIZE):
        state[i] += step / 6.0 * total[i]


@compiled
def drive(
    state: Array,
    waiting: Array,
    command: float,
    target_speed: float,
    wind: Array,
    friction: float,
    step: float,
    vehicle: Numbers,
) -> Array:
    """Give the state after as many integration steps as there are samples of the wind.

    Args:
        state: (SIZE,) state at the start; it is not changed.
        waiting: (D,) steering angles on their way through the pure delay, changed in place [rad].
        command: Steering angle commanded during these steps [rad].
        target_speed: For the driver [m/s].
        wind: (n, 2) velocity of the air in `map` during each step [m/s].
        friction: Coefficient mu.
        step: Of the integration [s].
        vehicle: `parameters.numbers` of the car.
    """
    state, work, road = state.copy(), np.empty((3, SIZE)), (friction, step)
    for i in range(len(wind)):
        delayed = command_in_force(waiting, command, i)
        state[STEERING] = turned(state[STEERING], delayed, step, vehicle[1])
        rk4_step(state, target_speed, (wind[i, 0], wind[i, 1]), road, vehicle, work)
        if stands(state[V_X], state[V_Y], target_speed):
            state[V_X] = 0.0
    queue_up(waiting, command, len(wind))
    return state
