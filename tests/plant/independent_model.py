"""The vehicle model written down a second time, from its equations and in plain NumPy.

Sources: dual-track model with quasi-static load transfer, Magic Formula and transient slip as in
H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., chapters 1, 4, 7 and 8. It shares only the
parameter classes with `sim_vehicle`. Wheels: front left, front right, rear left, rear right.
"""

import numpy as np

from ampc_msgs_config.types import Array
from sim_vehicle.parameters import Vehicle

G = 9.81


def stands(v_x: float, v_y: float, target: float) -> bool:
    """Return whether the parking brake is on: standstill is requested and reached."""
    return target < 0.05 and abs(v_x) < 0.05 and abs(v_y) < 0.5


def rates(z: Array, delta: float, wind: Array, target: float, mu: float, h: float, car: Vehicle):  # type: ignore[no-untyped-def]
    """Return dz/dt (13,) for z = x, y, yaw, v_x, v_y, r, lagged a_x, a_y, cornering drag, 4 slips.

    Args:
        z: State.
        delta: Road-wheel angle [rad].
        wind: (2,) velocity of the air in `map` [m/s].
        target: Target speed of the driver [m/s].
        mu: Friction coefficient.
        h: Integration step, which bounds the relaxation time from below [s].
        car: Parameters.
    """
    c, t, b, air, p = car.chassis, car.tyre, car.body, car.aerodynamics, car.powertrain
    m, l_f, l_r, yaw = c.mass, c.cg_to_front_axle, c.cg_to_rear_axle, z[2]
    v, r, (a_x, a_y), felt, s = z[3:5], z[5], z[6:8], z[8], z[9:]
    body_to_map = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    # air: each force is quadratic in its own component of the relative velocity
    w = body_to_map.T @ wind - v
    X_air, Y_air = 0.5 * air.air_density * np.array([air.drag_area, air.side_area]) * w * np.abs(w)
    # driver: proportional speed control plus the resistances, within power and force limits
    rolling = p.rolling_resistance * m * G * v[0] / np.hypot(v[0], 0.1)
    demand = m * (target - v[0]) / p.driver_time_constant + rolling - X_air + felt
    engine = np.clip(demand, 0, min(p.max_drive_force, p.max_power / max(abs(v[0]), 1.0)))
    brake = np.clip(-demand if v[0] > 0 else demand, 0, p.max_brake_force)
    # wheel loads: moments about the lateral and the longitudinal axis
    front = np.clip((m * G * l_r - m * a_x * b.cg_height) / (l_f + l_r), 0, m * G)
    axle = np.array([front, m * G - front])
    shift = m * a_y * b.cg_height / b.track * np.array([b.front_roll_share, 1 - b.front_roll_share])
    shift = np.clip(shift, -axle / 2, axle / 2)
    load = np.repeat(axle / 2, 2) + np.repeat(shift, 2) * [-1, 1, -1, 1]
    static = np.repeat([l_r, l_f], 2) * m * G / (2 * (l_f + l_r))
    # wheel velocities, along and across each wheel
    place = np.array([[l_f, l_f, -l_r, -l_r], b.track / 2 * np.array([1, -1, 1, -1])])
    wheel_v = v[:, None] + r * np.array([-place[1], place[0]])
    turn = np.array([delta, delta, 0.0, 0.0])
    along = np.cos(turn) * wheel_v[0] + np.sin(turn) * wheel_v[1]
    across = np.cos(turn) * wheel_v[1] - np.sin(turn) * wheel_v[0]
    # transient slip, with damping at parking speed
    speed = np.hypot(along, across)
    s_rate = -(across + speed * s) / np.maximum(t.relaxation_length, h * speed / 2)
    damping = t.parking_damping * np.clip(1 - speed / 2.0, 0, None) ** 2
    slip = np.arcsin(np.clip(s, -1, 1)) + damping * s_rate
    # Magic Formula with load sensitivity, then the friction circle
    C_alpha = np.repeat([c.front_cornering_stiffness, c.rear_cornering_stiffness], 2)
    n = load / static
    D = mu * load * np.maximum(1 - t.load_sensitivity * (n - 1), 0.1)
    stiffness = C_alpha * (t.stiffest_load**2 + 1) * n / (t.stiffest_load**2 + n**2)
    B = stiffness / (t.shape * D + 1e-9)
    bent = B * slip - t.curvature * (B * slip - np.arctan(B * slip))
    F_y0 = D * np.sin(t.shape * np.arctan(bent))
    if t.model == "linear":
        F_y0 = np.clip(C_alpha * slip, -D, D)
    drive_share = np.repeat([p.front_drive_share, 1 - p.front_drive_share], 2) / 2
    brake_share = np.repeat([p.front_brake_share, 1 - p.front_brake_share], 2) / 2
    F_x = engine * drive_share - brake * brake_share * np.clip(along / 0.05, -1, 1)
    F_x = np.clip(F_x, -0.98 * D, 0.98 * D)
    F_y = F_y0 * np.sqrt(1 - (F_x / (D + 1e-9)) ** 2)
    # equations of motion
    X = np.cos(turn) * F_x - np.sin(turn) * F_y
    Y = np.sin(turn) * F_x + np.cos(turn) * F_y
    N = np.sum(place[0] * Y - place[1] * X) + air.side_force_arm * Y_air
    a = np.array([X.sum() + X_air - rolling, Y.sum() + Y_air]) / m
    v_rate = a + r * np.array([v[1], -v[0]])
    v_rate[0] *= not stands(v[0], v[1], target)
    felt_rate = (F_x.sum() - X.sum() - m * r * v[1] - felt) / 0.2
    a_rate = (a - [a_x, a_y]) / b.load_lag
    return np.concatenate(
        (body_to_map @ v, [r], v_rate, [N / c.yaw_inertia], a_rate, [felt_rate], s_rate)
    )


def road_wheel_angle(angle: float, command: float, time: Array, car: Vehicle) -> Array:
    """Return the angles [rad] at times (n,) [s] under a constant command.

    While the distance to the target is greater than rate times lag, it falls with the rate. At
    times after that it falls exponentially.
    """
    target = np.clip(command, -car.steering.max_angle, car.steering.max_angle)
    lag, rate, gap = car.steering.time_constant, car.steering.max_rate, abs(target - angle)
    turning = 0.0 if np.isinf(rate) else max(gap / rate - lag, 0.0)
    ramp = gap - np.minimum(time, turning) * (rate if turning else 0.0)
    left = ramp * np.exp(-np.maximum(time - turning, 0.0) / (lag or 1.0))
    left = np.where(time >= turning, 0.0, left) if lag == 0.0 else left
    return np.asarray(target - np.sign(target - angle) * left)


def simulate(
    z: Array, commands: Array, wind: Array, targets: Array, mu: float, h: float, car: Vehicle
) -> Array:
    """Integrate by the classical Runge-Kutta method; return state and road-wheel angle (n, 14).

    Args:
        z: (13,) initial state; the wheels stand straight ahead.
        commands: (n,) steering command during each step [rad].
        wind: (n, 3, 2) at begin, middle and end of each step [m/s].
        targets: (n,) target speeds [m/s].
        mu: Friction coefficient.
        h: Step [s].
        car: Parameters.
    """
    delta, late, rows = 0.0, round(car.steering.delay / h), []
    delayed = np.concatenate((np.zeros(late), commands))
    for command, air, target in zip(delayed, wind, targets, strict=False):
        angle = road_wheel_angle(delta, command, np.array([0.0, h / 2, h]), car)
        delta, inputs = float(angle[2]), (target, mu, h, car)
        k_1 = rates(z, angle[0], air[0], *inputs)
        k_2 = rates(z + h / 2 * k_1, angle[1], air[1], *inputs)
        k_3 = rates(z + h / 2 * k_2, angle[1], air[1], *inputs)
        k_4 = rates(z + h * k_3, angle[2], air[2], *inputs)
        z = z + h / 6 * (k_1 + 2 * k_2 + 2 * k_3 + k_4)
        z[3] *= not stands(z[3], z[4], target)
        rows.append(np.append(z, delta))
    return np.array(rows)
