"""The steering that brings a car back to its path, for feed-forward and gate; not compiled."""


def return_angle(
    errors: tuple[float, float], frequency: float, v: float, car: tuple[float, float]
) -> float:
    """Return the change of the angle with which a cross-track error comes to rest [rad].

    The error obeys e'' = v^2 kappa where the slip angles are steady, so
    kappa = -(omega^2 e + 2 omega e') / v^2 damps it critically.

    Args:
        errors: Cross-track error [m] and its rate [m/s].
        frequency: omega [rad/s].
        v: Speed, above zero [m/s].
        car: Wheelbase [m] and understeer gradient, not negative [rad s^2/m].
    """
    (error, rate), (wheelbase, gradient) = errors, car
    pull = frequency**2 * error + 2 * frequency * rate
    return -pull * (wheelbase / v**2 + gradient)
