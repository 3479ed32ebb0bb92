"""Powertrain, resistances and the driver at the pedals."""

import math

from ampc_msgs_config.compiled import inlined
from ampc_msgs_config.parameters import GRAVITY

WALKING_SPEED = 1.0
"""Below this speed the engine's power is no limit [m/s]."""
ROLLING_SPEED = 0.1
"""Speed at which the rolling resistance has risen to 71 % [m/s]."""
STANDSTILL = 0.05
"""Speed below which brakes fade out, and who wants to stand pulls the parking brake [m/s]."""
SIDEWAYS = 0.5
"""Lateral speed up to which a parking brake holds [m/s]."""
FEELING_LAG = 0.2
"""Time constant with which the driver feels what cornering takes [s]."""


@inlined
def rolling_resistance(v_x: float, mass: float, powertrain: tuple[float, ...]) -> float:
    """Give the rolling resistance against the motion, smooth through 0 [N]."""
    _, _, _, _, _, f_r, _ = powertrain
    return f_r * mass * GRAVITY * v_x / math.sqrt(v_x**2 + ROLLING_SPEED**2)


@inlined
def pedals(
    v_x: float, target: float, resistance: float, mass: float, powertrain: tuple[float, ...]
) -> tuple[float, float]:
    """Give the forces that the driver asks of engine and brakes, neither negative [N].

    The gap closes with the time constant tau, dv/dt = (v_target - v) / tau, because what the
    resistances take is added. A target read tau ahead of a ramp is therefore followed without lag.

    Args:
        v_x: Longitudinal speed [m/s].
        target: Target speed [m/s].
        resistance: What rolling, air and cornering take [N].
        mass: [kg].
        powertrain: `astuple` of PowertrainParameters.
    """
    F_drive, P, F_brake, _, _, _, tau = powertrain
    wanted = mass * (target - v_x) / tau + resistance
    against_motion = -wanted if v_x > 0.0 else wanted
    engine = min(max(wanted, 0.0), F_drive, P / max(abs(v_x), WALKING_SPEED))
    return engine, min(max(against_motion, 0.0), F_brake)


@inlined
def longitudinal_demand(rolling: float, engine: float, brake: float) -> float:
    """Give the force that engine and brake ask of a wheel that rolls with this velocity [N]."""
    return engine - brake * min(max(rolling * (1.0 / STANDSTILL), -1.0), 1.0)


@inlined
def stands(v_x: float, v_y: float, target: float) -> bool:
    """Tell whether the parking brake holds the car: it wants to stand, and it does."""
    return target < STANDSTILL and abs(v_x) < STANDSTILL and abs(v_y) < SIDEWAYS
