"""Aerodynamic forces on the car."""

from ampc_msgs_config.compiled import inlined


@inlined
def air_forces(
    velocity: tuple[float, float],
    heading: tuple[float, float],
    wind: tuple[float, float],
    air: tuple[float, ...],
) -> tuple[float, float, float]:
    """Return drag, side force [N] and yaw moment [N m] in the body frame.

    Each force is 1/2 rho A w |w| with the corresponding component w of the relative air velocity.
    It is odd in the wind, and 0 at rest in still air. Wheel loads are not affected.

    Args:
        velocity: Velocity of the car in the body frame [m/s].
        heading: Cosine and sine of the yaw angle.
        wind: Velocity of the air in `map` [m/s].
        air: `astuple` of AerodynamicsParameters.
    """
    rho, A_x, A_y, arm = air
    (v_x, v_y), (cos, sin), (w_x, w_y) = velocity, heading, wind
    ahead = cos * w_x + sin * w_y - v_x
    left = cos * w_y - sin * w_x - v_y
    side_force = 0.5 * rho * A_y * left * abs(left)
    return 0.5 * rho * A_x * ahead * abs(ahead), side_force, arm * side_force
