"""Powertrain, resistances and the driver at the pedals."""

import math

from ampc_msgs_config.compiled import compiled
from sim_vehicle.parameters import GRAVITY

WALKING_SPEED = 1.0
"""Below this speed the engine's power is no limit [m/s]."""
ROLLING_SPEED = 0.1
"""Speed at which brakes are fully, and rolling resistance 71 % there [m/s]."""
STANDSTILL = 0.02
"""Speed below which a driver who wants to stand pulls the parking brake [m/s]."""
SIDEWAYS = 0.5
"""Lateral speed up to which a parking brake holds [m/s]."""
FEELING_LAG = 0.2
"""Time constant with which the driver feels what cornering takes [s]."""


@compiled
def rolling_resistance(v_x: float, mass: float, powertrain: tuple[float, ...]) -> float:
    """Give the rolling resistance against the motion, smooth through 0 [N]."""
    _, _, _, _, _, f_r, _ = powertrain
    return f_r * mass * GRAVITY * v_x / math.sqrt(v_x**2 + ROLLING_SPEED**2)


@compiled
def pedal_force(
    v_x: float, target: float, resistance: float, mass: float, powertrain: tuple[float, ...]
) -> float:
    """Give the force that the driver asks of the wheels, brakes negative [N].

    The gap closes with the time constant tau, dv/dt = (v_target - v) / tau, because what the
    resistances take is added. A target read tau ahead of a ramp is therefore followed without lag. Brakes
    only push against forward motion.

    Args:
        v_x: Longitudinal speed [m/s].
        target: Target speed [m/s].
        resistance: What rolling, air and cornering take [N].
        mass: [kg].
        powertrain: `astuple` of PowertrainParameters.
    """
    F_drive, P, F_brake, _, _, _, tau = powertrain
    wanted = mass * (target - v_x) / tau + resistance
    brake = F_brake * min(max(v_x / ROLLING_SPEED, 0.0), 1.0)
    return max(-brake, min(wanted, F_drive, P / max(abs(v_x), WALKING_SPEED)))


@compiled
def wheel_demands(force: float, powertrain: tuple[float, ...]) -> tuple[float, float]:
    """Split a force into those of one front wheel and one rear wheel [N]."""
    _, _, _, front_drive, front_brake, _, _ = powertrain
    front = front_drive if force > 0.0 else front_brake
    return 0.5 * front * force, 0.5 * (1.0 - front) * force


@compiled
def stands(v_x: float, v_y: float, target: float) -> bool:
    """Tell whether the parking brake holds the car: it wants to stand, and it does."""
    return target < STANDSTILL and abs(v_x) < STANDSTILL and abs(v_y) < SIDEWAYS
