"""Powertrain, resistances and the driver at the pedals."""

import math

from ampc_msgs_config.compiled import compiled
from sim_vehicle.parameters import GRAVITY

WALKING_SPEED = 1.0
"""Below this speed the engine's power is no limit [m/s]."""
ROLLING_SPEED = 0.1
"""Speed at which the rolling resistance has risen to 76 % [m/s]."""
STANDSTILL = 0.02
"""Speed below which a driver who wants to stand pulls the parking brake [m/s]."""
SIDEWAYS = 0.5
"""Lateral speed up to which a parking brake holds [m/s]."""


@compiled
def rolling_resistance(v_x: float, mass: float, powertrain: tuple[float, ...]) -> float:
    """Give the rolling resistance against the motion, smooth through 0 [N]."""
    _, _, _, _, _, f_r, _ = powertrain
    return f_r * mass * GRAVITY * math.tanh(v_x / ROLLING_SPEED)


@compiled
def pedal_force(
    v_x: float, target: float, resistance: float, mass: float, powertrain: tuple[float, ...]
) -> float:
    """Give the force that the driver asks of the wheels, brakes negative [N].

    He closes the gap with the time constant tau, dv/dt = (v_target - v) / tau, and adds what the
    resistances take. A target read tau ahead of a ramp is therefore followed without lag.

    Args:
        v_x: Longitudinal speed [m/s].
        target: Target speed [m/s].
        resistance: Sum of rolling and air resistance [N].
        mass: [kg].
        powertrain: `astuple` of PowertrainParameters.
    """
    F_drive, P, F_brake, _, _, _, tau = powertrain
    wanted = mass * (target - v_x) / tau + resistance
    return max(-F_brake, min(wanted, F_drive, P / max(abs(v_x), WALKING_SPEED)))


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
