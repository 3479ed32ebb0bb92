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
from sim_vehicle.driver import FEELING_LAG, longitudinal_demand, pedals, rolling_resistance, stands
from sim_vehicle.pacejka import transient_slip, tyre_forces
from sim_vehicle.parameters import GRAVITY, Numbers

Array = NDArray[np.float64]

X, Y, YAW, V_X, V_Y, YAW_RATE = range(6)
A_X, A_Y = 6, 7
"""Accelerations as the wheel loads know them, lagged [m/s^2]."""
CORNERING = 8
"""What cornering takes from the drive, as the driver feels it [N]."""
SLIP = 9
"""Transient slip of the first of the four wheels."""
STEERING = 13
"""Real road-wheel angle [rad]."""
SIZE = 14
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
    pedal_forces: tuple[float, float],
    load: float,
    road: tuple[float, float],
    tyre: tuple[float, ...],
) -> tuple[float, float, float, float]:
    """Give the slip's rate [1/s], the force along body x and y, and along the wheel [N].

    Args:
        s: Transient slip.
        velocity: Of the wheel centre in the body frame [m/s].
        direction: Cosine and sine of the wheel's angle.
        pedal_forces: Of engine and brake on this wheel [N].
        load: Wheel load [N].
        road: Friction coefficient, and the step of the integration [s].
        tyre: Numbers of the axle's tyre.
    """
    (v_x, v_y), (cos, sin), (friction, step) = velocity, direction, road
    rolling, sliding = cos * v_x + sin * v_y, cos * v_y - sin * v_x
    demand = longitudinal_demand(rolling, pedal_forces[0], pedal_forces[1])
    s_rate, slip = transient_slip(s, rolling, sliding, step, tyre)
    F_x, F_y = tyre_forces(slip, demand, load, friction, tyre)
    return s_rate, cos * F_x - sin * F_y, sin * F_x + cos * F_y, F_x


@compiled
def wheel_forces(
    state: Array,
    pedal_forces: tuple[float, float],
    road: tuple[float, float],
    vehicle: Numbers,
    rate: Array,
) -> tuple[float, float, float, float]:
    """Sum up the tyre forces along body x, y [N], their moments [N m], and along the wheels [N].

    Args:
        state: (SIZE,) state.
        pedal_forces: What the driver asks of engine and brakes [N].
        road: Friction coefficient, and the step of the integration [s].
        vehicle: Numbers of the car.
        rate: (SIZE,) receives the rates of the transient slips.
    """
    (_, _, l_f, l_r, _, _), (track, _, _, _) = vehicle.chassis, vehicle.body
    loads = wheel_loads(state[A_X], state[A_Y], vehicle.chassis, vehicle.body)
    engine, brake = 0.5 * pedal_forces[0], 0.5 * pedal_forces[1]  # per side
    _, _, _, f_drive, f_brake, _, _ = vehicle.powertrain
    steered = math.cos(state[STEERING]), math.sin(state[STEERING])
    rear_pedals = (1.0 - f_drive) * engine, (1.0 - f_brake) * brake
    front = l_f, steered, (f_drive * engine, f_brake * brake), vehicle.front_tyre
    rear = -l_r, (1.0, 0.0), rear_pedals, vehicle.rear_tyre
    X_sum, Y_sum, N_sum, rolling_sum = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        x, direction, pedals_here, tyre = (front, rear)[i // 2]
        y = track * (0.5 - i % 2)
        velocity = state[V_X] - y * state[YAW_RATE], state[V_Y] + x * state[YAW_RATE]
        rate[SLIP + i], F_x, F_y, F_rolling = wheel(
            state[SLIP + i], velocity, direction, pedals_here, loads[i], road, tyre
        )
        X_sum, Y_sum, N_sum = X_sum + F_x, Y_sum + F_y, N_sum + x * F_y - y * F_x
        rolling_sum += F_rolling
    return X_sum, Y_sum, N_sum, rolling_sum


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

    The wheel loads follow the accelerations through a first-order lag (the time that roll and
    pitch take): forces then depend on the state alone, and no algebraic loop has to be solved.
    """
    m, I_z, _, _, _, _ = vehicle.chassis
    _, _, _, load_lag = vehicle.body
    yaw, v_x, v_y, r = state[YAW], state[V_X], state[V_Y], state[YAW_RATE]
    cos, sin = math.cos(yaw), math.sin(yaw)
    X_air, Y_air, N_air = air_forces((v_x, v_y), (cos, sin), wind, vehicle.air)
    rolling = rolling_resistance(v_x, m, vehicle.powertrain)
    resistance = rolling - X_air + state[CORNERING]
    pedal_forces = pedals(v_x, target_speed, resistance, m, vehicle.powertrain)
    X_tyre, Y_tyre, N_tyre, F_wheels = wheel_forces(state, pedal_forces, road, vehicle, rate)
    a_x, a_y = (X_tyre + X_air - rolling) / m, (Y_tyre + Y_air) / m
    rate[X], rate[Y], rate[YAW] = cos * v_x - sin * v_y, sin * v_x + cos * v_y, r
    rate[V_X], rate[V_Y], rate[YAW_RATE] = a_x + r * v_y, a_y - r * v_x, (N_tyre + N_air) / I_z
    rate[A_X], rate[A_Y] = (a_x - state[A_X]) / load_lag, (a_y - state[A_Y]) / load_lag
    rate[CORNERING] = (F_wheels - X_tyre - m * r * v_y - state[CORNERING]) / FEELING_LAG
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
        state[STEERING] = turned(state[STEERING], delayed, step, vehicle.steering)
        rk4_step(state, target_speed, (wind[i, 0], wind[i, 1]), road, vehicle, work)
        if stands(state[V_X], state[V_Y], target_speed):
            state[V_X] = 0.0
    queue_up(waiting, command, len(wind))
    return state
