"""Forces of the air on the car."""

import math

from ampc_msgs_config.compiled import compiled


@compiled
def air_forces(
    yaw: float, v_x: float, v_y: float, wind: tuple[float, float], air: tuple[float, ...]
) -> tuple[float, float, float]:
    """Give drag, side force [N] and yaw moment [N m] in the body frame.

    Each force is 1/2 rho A w |w| with its own component w of the air's velocity past the car: odd
    in the wind, 0 in still air at rest. The air changes no wheel load.

    Args:
        yaw: Heading in `map` [rad].
        v_x: Longitudinal velocity of the car [m/s].
        v_y: Lateral velocity of the car [m/s].
        wind: Velocity of the air in `map` [m/s].
        air: `astuple` of AerodynamicsParameters.
    """
    rho, A_x, A_y, arm = air
    cos, sin = math.cos(yaw), math.sin(yaw)
    ahead = cos * wind[0] + sin * wind[1] - v_x
    left = cos * wind[1] - sin * wind[0] - v_y
    side = 0.5 * rho * A_y * left * abs(left)
    return 0.5 * rho * A_x * ahead * abs(ahead), side, arm * side
