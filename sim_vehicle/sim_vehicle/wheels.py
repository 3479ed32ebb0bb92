"""Forces of the four wheels, in SIMD code: rows of the scratch array hold one number per wheel.

The loop over the wheels has neither branches nor calls, so that the compiler vectorises it. The
rows that it writes precede the rows that it only reads, which proves to the compiler that they do
not overlap.
"""

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.types import Array
from sim_vehicle.driver import longitudinal_demand
from sim_vehicle.elementary import sine_and_cosine
from sim_vehicle.pacejka import transient_slip, tyre_forces
from sim_vehicle.vehicle_row import VehicleNumbers

WHEELS = 4
"""Front left, front right, rear left, rear right."""
F_X, F_Y, F_WHEEL = 0, 4, 8
"""Forces along body x and y, and along the wheel [N]."""
S_RATE, S_TOTAL, S = 12, 16, 20
"""Transient slip: rate, weighted sum of the rates, and value at the start of the step."""
ARM_X, ARM_Y = 24, 28
"""Position of the wheel ahead and to the left of the centre of gravity [m]."""
COS, SIN = 32, 36
"""Cosine and sine of the wheel angle."""
DRIVE, BRAKE = 40, 44
"""Shares of the wheel in the forces of engine and brakes."""
TYRE = 48
"""The nine numbers of the tyre."""
TURNED = TYRE + 9 * WHEELS
"""Road-wheel angle of `COS` and `SIN` [rad]."""
LANES = TURNED + 1


@in_place
def initialise_wheels(work: Array, vehicle: VehicleNumbers) -> None:
    """Fill the constant rows of the scratch array."""
    (_, _, l_f, l_r, _, _), (track, _, _, _) = vehicle.chassis, vehicle.body
    _, _, _, f_drive, f_brake, _, _ = vehicle.powertrain
    for i in range(WHEELS):
        front = i < 2
        work[ARM_X + i] = l_f if front else -l_r
        work[ARM_Y + i] = track * (0.5 - i % 2)
        work[DRIVE + i] = 0.5 * (f_drive if front else 1.0 - f_drive)
        work[BRAKE + i] = 0.5 * (f_brake if front else 1.0 - f_brake)
        work[COS + i], work[SIN + i], work[TURNED] = 1.0, 0.0, 0.0
        for k in range(9):
            tyre = vehicle.front_tyre[k] if front else vehicle.rear_tyre[k]
            work[TYRE + WHEELS * k + i] = tyre


@inlined
def set_steering(work: Array, angle: float) -> None:
    """Fill cosine and sine of the front wheels for a road-wheel angle [rad], if it has changed."""
    if angle != work[TURNED]:
        sin, cos = sine_and_cosine(angle)
        work[TURNED] = angle
        for i in range(2):
            work[COS + i], work[SIN + i] = cos, sin


@inlined
def wheel_loads(
    a_x: float, a_y: float, chassis: tuple[float, ...], body: tuple[float, ...]
) -> tuple[float, float, float, float]:
    """Return the four wheel loads [N]; none is negative, and their sum is the weight.

    Args:
        a_x: Longitudinal acceleration [m/s^2].
        a_y: Lateral acceleration, positive to the left [m/s^2].
        chassis: `astuple` of ChassisParameters.
        body: `astuple` of BodyParameters.
    """
    m, _, l_f, l_r, _, _ = chassis
    track, h, front_share, _ = body
    weight = m * GRAVITY
    front = min(max((weight * l_r - m * a_x * h) * (1.0 / (l_f + l_r)), 0.0), weight) / 2.0
    rear = weight / 2.0 - front
    roll = m * h * (1.0 / track) * a_y
    shift_f = min(max(front_share * roll, -front), front)
    shift_r = min(max((1.0 - front_share) * roll, -rear), rear)
    return front - shift_f, front + shift_f, rear - shift_r, rear + shift_r


@inlined
def wheel(
    s: float,
    velocity: tuple[float, float],
    direction: tuple[float, float],
    pedals: tuple[float, float],
    load: float,
    road: tuple[float, float],
    tyre: tuple[float, ...],
) -> tuple[float, float, float, float]:
    """Return the slip rate [1/s], the force along body x and y, and along the wheel [N].

    Args:
        s: Transient slip.
        velocity: Velocity of the wheel centre in the body frame [m/s].
        direction: Cosine and sine of the wheel angle.
        pedals: Forces of engine and brake on this wheel [N].
        load: Wheel load [N].
        road: Friction coefficient, and integration step [s].
        tyre: Numbers of the tyre.
    """
    (v_x, v_y), (cos, sin), (friction, step) = velocity, direction, road
    rolling, sliding = cos * v_x + sin * v_y, cos * v_y - sin * v_x
    demand = longitudinal_demand(rolling, pedals[0], pedals[1])
    s_rate, slip = transient_slip(s, rolling, sliding, step, tyre)
    F_x, F_y = tyre_forces(slip, demand, load, friction, tyre)
    return s_rate, cos * F_x - sin * F_y, sin * F_x + cos * F_y, F_x


@inlined
def tyre_of(work: Array, i: int) -> tuple[float, ...]:
    """Return the numbers of the tyre of wheel i."""
    a, b, c = work[TYRE + i], work[TYRE + 4 + i], work[TYRE + 8 + i]
    d, e, f = work[TYRE + 12 + i], work[TYRE + 16 + i], work[TYRE + 20 + i]
    g, h, j = work[TYRE + 24 + i], work[TYRE + 28 + i], work[TYRE + 32 + i]
    return a, b, c, d, e, f, g, h, j


@in_place
def wheel_forces(
    work: Array,
    motion: tuple[float, float, float],
    loads: tuple[float, float, float, float],
    pedals: tuple[float, float],
    road: tuple[float, float],
    stage: tuple[float, float],
) -> None:
    """Fill the wheel forces, and advance the transient slips by a Runge-Kutta stage.

    Args:
        work: Rows of the wheels.
        motion: v_x, v_y [m/s] and yaw rate [rad/s] of the body.
        loads: `wheel_loads` [N].
        pedals: Forces demanded from engine and brakes [N].
        road: Friction coefficient, and integration step [s].
        stage: Time of the stage from the start of the step [s], and its weight.
    """
    (v_x, v_y, r), (fl, fr, rl, rr) = motion, loads
    (engine, brake), (reach, weight) = pedals, stage
    for i in range(WHEELS):
        x, y = work[ARM_X + i], work[ARM_Y + i]
        load = (fl if y > 0.0 else fr) if x > 0.0 else (rl if y > 0.0 else rr)
        s_rate, F_x, F_y, F_wheel = wheel(
            work[S + i] + reach * work[S_RATE + i],
            (v_x - y * r, v_y + x * r),
            (work[COS + i], work[SIN + i]),
            (work[DRIVE + i] * engine, work[BRAKE + i] * brake),
            load,
            road,
            tyre_of(work, i),
        )
        work[F_X + i], work[F_Y + i], work[F_WHEEL + i] = F_x, F_y, F_wheel
        work[S_RATE + i] = s_rate
        work[S_TOTAL + i] = work[S_TOTAL + i] + weight * s_rate


@inlined
def tyre_sums(work: Array) -> tuple[float, float, float, float]:
    """Return the sums of force along x and y [N], moment [N m], and force along the wheels [N].

    The order of the additions makes the sums exactly symmetric in left and right.
    """
    left_x, right_x = work[F_X] + work[F_X + 2], work[F_X + 1] + work[F_X + 3]
    front_y, rear_y = work[F_Y] + work[F_Y + 1], work[F_Y + 2] + work[F_Y + 3]
    moment_y = work[ARM_X] * front_y + work[ARM_X + 2] * rear_y
    moment = moment_y + work[ARM_Y] * (right_x - left_x)
    along = (work[F_WHEEL] + work[F_WHEEL + 1]) + (work[F_WHEEL + 2] + work[F_WHEEL + 3])
    return left_x + right_x, front_y + rear_y, moment, along
