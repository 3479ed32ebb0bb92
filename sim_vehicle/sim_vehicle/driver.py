"""Powertrain, resistances and the longitudinal driver."""

import math

from ampc_msgs_config.compiled import inlined
from ampc_msgs_config.parameters import GRAVITY

WALKING_SPEED = 1.0
"""Speed below which the power of the engine is no limit [m/s]."""
ROLLING_SPEED = 0.1
"""Speed at which the rolling resistance has risen to 71 % [m/s]."""
REST_SPEED = 0.05
"""Speed below which the brakes fade out, and the parking brake acts after a stop [m/s]."""
SIDEWAYS = 0.5
"""Largest lateral speed at which the parking brake holds the car [m/s]."""
CORNERING_LAG = 0.2
"""Time constant with which the driver compensates the cornering drag [s]."""


@inlined
def rolling_resistance(v_x: float, mass: float, powertrain: tuple[float, ...]) -> float:
    """Return the rolling resistance, positive against forward motion and smooth through 0 [N]."""
    _, _, _, _, _, f_r, _ = powertrain
    return f_r * mass * GRAVITY * v_x / math.sqrt(v_x**2 + ROLLING_SPEED**2)


@inlined
def pedal_forces(
    v_x: float, target: float, resistance: float, mass: float, powertrain: tuple[float, ...]
) -> tuple[float, float]:
    """Return the forces demanded from engine and brakes, neither negative [N].

    The speed error decays with the time constant tau, dv/dt = (v_target - v) / tau, because the
    resistances are compensated. A target speed previewed by tau is therefore tracked without lag.

    Args:
        v_x: Longitudinal speed [m/s].
        target: Target speed [m/s].
        resistance: Sum of rolling resistance, air and cornering drag [N].
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
    """Return the force that engine and brake demand from a wheel rolling at this velocity [N]."""
    return engine - brake * min(max(rolling * (1.0 / REST_SPEED), -1.0), 1.0)


@inlined
def stands(v_x: float, v_y: float, target: float) -> bool:
    """Return whether the parking brake holds the car: standstill is requested and reached."""
    return target < REST_SPEED and abs(v_x) < REST_SPEED and abs(v_y) < SIDEWAYS
