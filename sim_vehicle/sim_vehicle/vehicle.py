"""Dual-track vehicle model with longitudinal, lateral and yaw motion.

`state` is a row of `SIZE` numbers, so that a fleet of cars is a matrix. Wheels are numbered front
left, front right, rear left, rear right. Position and velocity are those of the centre of gravity.
"""

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array
from sim_vehicle.actuator import angle_after, delayed_command, lag_share, shift_queue
from sim_vehicle.aerodynamics import air_forces
from sim_vehicle.driver import CORNERING_LAG, pedal_forces, rolling_resistance, stands
from sim_vehicle.elementary import sine_and_cosine
from sim_vehicle.vehicle_row import VehicleNumbers
from sim_vehicle.wheels import (
    LANES,
    S_RATE,
    S_TOTAL,
    WHEELS,
    S,
    initialise_wheels,
    set_steering,
    tyre_sums,
    wheel_forces,
    wheel_loads,
)

CAR_X, CAR_Y, CAR_YAW, CAR_V_X, CAR_V_Y, CAR_YAW_RATE = range(6)
A_X, A_Y = 6, 7
"""Lagged accelerations, which determine the wheel loads [m/s^2]."""
CORNERING = 8
"""Lagged cornering drag, which the driver compensates [N]."""
SLIP = 9
"""Transient slip of the first of the four wheels."""
CAR_STEERING = 13
"""Road-wheel angle [rad]."""
SIZE = 14
STAGES = ((0, 1.0), (1, 2.0), (1, 2.0), (2, 1.0))
"""Classical Runge-Kutta method: time of each stage in half steps, and its weight in sixths."""
BODY_SIZE = SLIP
"""Number of states of the body, which come first."""
BODY_RATE, BODY_TOTAL, BODY_TRIAL = LANES, LANES + BODY_SIZE, LANES + 2 * BODY_SIZE
WORK_SIZE = LANES + 3 * BODY_SIZE
"""Size of the scratch array; its contents are undefined between calls."""


@inlined
def derivative(
    work: Array,
    target_speed: float,
    wind: tuple[float, float],
    road: tuple[float, float],
    stage: tuple[float, float],
    vehicle: VehicleNumbers,
) -> None:
    """Fill the time derivative of the trial state of the body; advance the slips by a stage.

    The wheel loads follow the accelerations with a first-order lag (the dynamics of roll and
    pitch). The forces then depend on the state alone, and there is no algebraic loop.

    Args:
        work: Scratch (WORK_SIZE,).
        target_speed: Target speed of the driver [m/s].
        wind: Velocity of the air in `map` [m/s].
        road: Friction coefficient, and integration step [s].
        stage: Time of the stage from the start of the step [s], and its weight.
        vehicle: Parameters.
    """
    m, I_z, _, _, _, _ = vehicle.chassis
    _, _, _, load_lag = vehicle.body
    now, rate = BODY_TRIAL, BODY_RATE
    v_x, v_y, r = work[now + CAR_V_X], work[now + CAR_V_Y], work[now + CAR_YAW_RATE]
    a_x, a_y, cornering = work[now + A_X], work[now + A_Y], work[now + CORNERING]
    sin, cos = sine_and_cosine(work[now + CAR_YAW])
    X_air, Y_air, N_air = air_forces((v_x, v_y), (cos, sin), wind, vehicle.air)
    rolling = rolling_resistance(v_x, m, vehicle.powertrain)
    resistance = rolling - X_air + cornering
    pedals = pedal_forces(v_x, target_speed, resistance, m, vehicle.powertrain)
    loads = wheel_loads(a_x, a_y, vehicle.chassis, vehicle.body)
    wheel_forces(work, (v_x, v_y, r), loads, pedals, road, stage)
    X_tyre, Y_tyre, N_tyre, F_wheels = tyre_sums(work)
    a_x_now, a_y_now = (X_tyre + X_air - rolling) * (1.0 / m), (Y_tyre + Y_air) * (1.0 / m)
    work[rate + CAR_X], work[rate + CAR_Y] = cos * v_x - sin * v_y, sin * v_x + cos * v_y
    work[rate + CAR_YAW], work[rate + CAR_YAW_RATE] = r, (N_tyre + N_air) * (1.0 / I_z)
    parked = stands(v_x, v_y, target_speed)
    work[rate + CAR_V_X] = 0.0 if parked else a_x_now + r * v_y
    work[rate + CAR_V_Y] = a_y_now - r * v_x
    work[rate + A_X] = (a_x_now - a_x) * (1.0 / load_lag)
    work[rate + A_Y] = (a_y_now - a_y) * (1.0 / load_lag)
    drag = F_wheels - X_tyre - m * r * v_y
    work[rate + CORNERING] = (drag - cornering) * (1.0 / CORNERING_LAG)


@inlined
def rk4_step(
    state: Array,
    target_speed: float,
    angles: tuple[float, float, float],
    wind: Array,
    row: int,
    road: tuple[float, float],
    vehicle: VehicleNumbers,
    work: Array,
) -> None:
    """Advance the state of body and slips in place by one step; see `derivative`.

    Road-wheel angle [rad] and row of the wind state three values: at begin, middle and end of the
    step.
    """
    step = road[1]
    for i in range(BODY_SIZE):
        work[BODY_RATE + i] = work[BODY_TOTAL + i] = 0.0
    for i in range(WHEELS):
        work[S_RATE + i] = work[S_TOTAL + i] = 0.0
    for half, weight in STAGES:
        reach = 0.5 * half * step
        set_steering(work, angles[half])
        air = wind[row, half, 0], wind[row, half, 1]
        for i in range(BODY_SIZE):
            work[BODY_TRIAL + i] = state[i] + reach * work[BODY_RATE + i]
        derivative(work, target_speed, air, road, (reach, weight), vehicle)
        for i in range(BODY_SIZE):
            work[BODY_TOTAL + i] += weight * work[BODY_RATE + i]
    for i in range(BODY_SIZE):
        state[i] += step / 6.0 * work[BODY_TOTAL + i]
    for i in range(WHEELS):
        work[S + i] += step / 6.0 * work[S_TOTAL + i]


@in_place
def drive_steps(
    state: Array,
    waiting: Array,
    command: float,
    target_speed: float,
    wind: Array,
    first: int,
    steps: int,
    friction: float,
    step: float,
    vehicle: VehicleNumbers,
    work: Array,
) -> None:
    """Integrate a number of steps, in place and without allocation.

    Args:
        state: (SIZE,) state.
        waiting: (D,) steering commands in the pure delay [rad].
        command: Steering angle commanded during these steps [rad].
        target_speed: Target speed of the driver [m/s].
        wind: (n, 3, 2) velocity of the air in `map` at begin, middle and end of each step [m/s].
        first: Row of `wind` for the first step.
        steps: Number of steps.
        friction: Coefficient mu.
        step: Integration step [s].
        vehicle: `vehicle_numbers` of the car.
        work: Scratch (WORK_SIZE,).
    """
    initialise_wheels(work, vehicle)
    for i in range(WHEELS):
        work[S + i] = state[SLIP + i]
    servo, half, road = vehicle.steering, 0.5 * step, (friction, step)
    half_share, share = lag_share(half, servo), lag_share(step, servo)
    for i in range(steps):
        delayed, angle = delayed_command(waiting, command, i), state[CAR_STEERING]
        angles = (
            angle_after(0.0, angle, delayed, 0.0, servo),
            angle_after(half, angle, delayed, half_share, servo),
            angle_after(step, angle, delayed, share, servo),
        )
        rk4_step(state, target_speed, angles, wind, first + i, road, vehicle, work)
        state[CAR_STEERING] = angles[2]
        if stands(state[CAR_V_X], state[CAR_V_Y], target_speed):
            state[CAR_V_X] = 0.0
    for i in range(WHEELS):
        state[SLIP + i] = work[S + i]
    shift_queue(waiting, command, steps)
