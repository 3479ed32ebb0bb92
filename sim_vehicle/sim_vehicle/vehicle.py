"""The car that really drives: dual track, free to move along, sideways and in yaw.

`state` is a row of `SIZE` numbers, so that a swarm of cars is a matrix. Wheels are numbered front
left, front right, rear left, rear right. Position and velocity are those of the centre of gravity.
"""

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from sim_vehicle.actuator import approach, command_in_force, queue_up, turned
from sim_vehicle.aerodynamics import air_forces
from sim_vehicle.driver import FEELING_LAG, pedals, rolling_resistance, stands
from sim_vehicle.elementary import sine_and_cosine
from sim_vehicle.parameters import Numbers
from sim_vehicle.wheels import (
    LANES,
    S_RATE,
    S_TOTAL,
    WHEELS,
    S,
    fit_wheels,
    steer,
    turn_wheels,
    tyre_sums,
    wheel_loads,
)

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
BODY = SLIP
"""So many numbers of the state are the body's own."""
BODY_RATE, BODY_TOTAL, BODY_TRIAL = LANES, LANES + BODY, LANES + 2 * BODY
WORK_SIZE = LANES + 3 * BODY
"""Numbers of a work array; what it holds between two calls is nobody's business."""


@inlined
def derivative(
    work: Array,
    target_speed: float,
    wind: tuple[float, float],
    road: tuple[float, float],
    stage: tuple[float, float],
    vehicle: Numbers,
) -> None:
    """Write the time derivative of the body's trial state, and take the slips through a stage.

    The wheel loads follow the accelerations through a first-order lag (the time that roll and
    pitch take): forces then depend on the state alone, and no algebraic loop has to be solved.
    """
    m, I_z, _, _, _, _ = vehicle.chassis
    _, _, _, load_lag = vehicle.body
    now, rate = BODY_TRIAL, BODY_RATE
    v_x, v_y, r = work[now + V_X], work[now + V_Y], work[now + YAW_RATE]
    a_x, a_y, cornering = work[now + A_X], work[now + A_Y], work[now + CORNERING]
    sin, cos = sine_and_cosine(work[now + YAW])
    X_air, Y_air, N_air = air_forces((v_x, v_y), (cos, sin), wind, vehicle.air)
    rolling = rolling_resistance(v_x, m, vehicle.powertrain)
    resistance = rolling - X_air + cornering
    pedal_forces = pedals(v_x, target_speed, resistance, m, vehicle.powertrain)
    loads = wheel_loads(a_x, a_y, vehicle.chassis, vehicle.body)
    turn_wheels(work, (v_x, v_y, r), loads, pedal_forces, road, stage)
    X_tyre, Y_tyre, N_tyre, F_wheels = tyre_sums(work)
    a_x_now, a_y_now = (X_tyre + X_air - rolling) * (1.0 / m), (Y_tyre + Y_air) * (1.0 / m)
    work[rate + X], work[rate + Y] = cos * v_x - sin * v_y, sin * v_x + cos * v_y
    work[rate + YAW], work[rate + YAW_RATE] = r, (N_tyre + N_air) * (1.0 / I_z)
    held = stands(v_x, v_y, target_speed)
    work[rate + V_X] = 0.0 if held else a_x_now + r * v_y
    work[rate + V_Y] = a_y_now - r * v_x
    work[rate + A_X] = (a_x_now - a_x) * (1.0 / load_lag)
    work[rate + A_Y] = (a_y_now - a_y) * (1.0 / load_lag)
    taken = F_wheels - X_tyre - m * r * v_y
    work[rate + CORNERING] = (taken - cornering) * (1.0 / FEELING_LAG)


@inlined
def rk4_step(
    state: Array,
    target_speed: float,
    wind: tuple[float, float],
    road: tuple[float, float],
    vehicle: Numbers,
    work: Array,
) -> None:
    """Advance body and slips of the state in place by one step."""
    step = road[1]
    for i in range(BODY):
        work[BODY_RATE + i] = work[BODY_TOTAL + i] = 0.0
    for i in range(WHEELS):
        work[S_RATE + i] = work[S_TOTAL + i] = 0.0
    for ahead, weight in STAGES:
        reach = ahead * step
        for i in range(BODY):
            work[BODY_TRIAL + i] = state[i] + reach * work[BODY_RATE + i]
        derivative(work, target_speed, wind, road, (reach, weight), vehicle)
        for i in range(BODY):
            work[BODY_TOTAL + i] += weight * work[BODY_RATE + i]
    for i in range(BODY):
        state[i] += step / 6.0 * work[BODY_TOTAL + i]
    for i in range(WHEELS):
        work[S + i] += step / 6.0 * work[S_TOTAL + i]


@in_place
def drive(
    state: Array,
    waiting: Array,
    command: float,
    target_speed: float,
    wind: Array,
    first: int,
    steps: int,
    friction: float,
    step: float,
    vehicle: Numbers,
    work: Array,
) -> None:
    """Drive on, in place and without allocation, for some steps of the integration.

    Args:
        state: (SIZE,) state.
        waiting: (D,) steering angles on their way through the pure delay [rad].
        command: Steering angle commanded during these steps [rad].
        target_speed: For the driver [m/s].
        wind: (n, 2) velocity of the air in `map` during each step [m/s].
        first: Row of the wind for the first step.
        steps: How many.
        friction: Coefficient mu.
        step: Of the integration [s].
        vehicle: `parameters.numbers` of the car.
        work: (WORK_SIZE,) scratch.
    """
    fit_wheels(work, vehicle)
    for i in range(WHEELS):
        work[S + i] = state[SLIP + i]
    share, road = approach(step, vehicle.steering), (friction, step)
    for i in range(steps):
        delayed = command_in_force(waiting, command, i)
        state[STEERING] = turned(state[STEERING], delayed, share, step, vehicle.steering)
        steer(work, state[STEERING])
        air = wind[first + i, 0], wind[first + i, 1]
        rk4_step(state, target_speed, air, road, vehicle, work)
        if stands(state[V_X], state[V_Y], target_speed):
            state[V_X] = 0.0
    for i in range(WHEELS):
        state[SLIP + i] = work[S + i]
    queue_up(waiting, command, steps)
