"""The last check of a steering command before it is published, whatever its source.

It shares nothing with the controllers. Its only inputs are limits by speed, wheelbase and
understeer gradient of the car, and the angle published last.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_msgs_config.types import LIMITS

NO_LIMIT, NOT_FINITE, ANGLE, LATERAL_ACCELERATION, RATE, LATERAL_JERK, MEASURED_STEP = range(
    len(LIMITS)
)
MAX_GUARD_SPEED = 100.0
"""A larger speed is a broken measurement [m/s]."""
MIN_LIMITED_SPEED = 0.1
"""Below this speed no angle causes a lateral acceleration worth a limit [m/s]."""
MAX_MEASURED = math.pi / 2
"""A larger measured road-wheel angle is a broken measurement [rad]."""
LONGEST_PAUSE = 2.0
"""The wheel may catch up after a missed tick, not after a longer pause [periods]."""
SHORTEST = 0.5
"""Smallest effective length L + K_us v^2 of an oversteering car [wheelbases]."""


class GuardResult(NamedTuple):
    """Angle and rate inside the limits."""

    steering: float
    """Road-wheel angle [rad]."""
    steering_rate: float
    """Rate at which the angle is to be reached [rad/s]."""
    limit: int
    """Index in LIMITS of the first limit that clipped the command."""


class GuardBounds(NamedTuple):
    """Limits at one speed, as angles and rates of the road wheel."""

    angle: float
    """Largest angle [rad]."""
    acceleration: float
    """Angle of the steady circle with the largest lateral acceleration [rad]."""
    rate: float
    """Largest rate [rad/s]."""
    jerk: float
    """Rate that causes the largest lateral jerk [rad/s]."""
    measured_step: float
    """Largest distance from the measured angle [rad]."""


def bounds(limits: GuardLimits, chassis: ChassisParameters, v_x: float) -> GuardBounds:
    """Return the limits at a speed [m/s]; for an impossible speed the strictest of all speeds.

    On a steady circle a_y = v^2 kappa = v^2 delta / (L + K_us v^2).

    Note:
        The kinematic v^2 delta / L would be larger and so safer, but an understeering car needs
        more angle than that: at 30 m/s the paper's car needs five times as much for the same
        circle, and a limit of 5 m/s^2 would end ordinary driving at 1 m/s^2. For an oversteering
        car, L + K_us v^2 vanishes at its critical speed; it must still be able to counter-steer
        there, so at least half its wheelbase is used.
    """
    v = abs(v_x)
    if v <= MAX_GUARD_SPEED:
        v = max(v, MIN_LIMITED_SPEED)
        angle, rate, acceleration, jerk, step = (
            interpolate_linear(limits.speed, row, v) for row in rows(limits)
        )
    else:
        v = MAX_GUARD_SPEED
        angle, rate, acceleration, jerk, step = (min(row) for row in rows(limits))
    L, K_us = chassis.wheelbase, chassis.understeer_gradient
    per_acceleration = max(L + K_us * v * v, SHORTEST * L) / (v * v)  # rad per m/s^2
    return GuardBounds(angle, acceleration * per_acceleration, rate, jerk * per_acceleration, step)


def rows(limits: GuardLimits) -> tuple[tuple[float, ...], ...]:
    """Return the limits that depend on speed: angle, rate, acceleration, jerk, measured step."""
    return (
        limits.max_angle,
        limits.max_rate,
        limits.lateral_acceleration,
        limits.lateral_jerk,
        limits.measured_step,
    )


def interpolate_linear(at: Sequence[float], values: Sequence[float], x: float) -> float:
    """Interpolate values at increasing points `at` linearly; the end values are held."""
    i = bisect_right(at, x)
    if i == 0 or i == len(at):
        return values[min(i, len(at) - 1)]
    share = (x - at[i - 1]) / (at[i] - at[i - 1])
    return values[i - 1] + share * (values[i] - values[i - 1])


class Guard:
    """Clips commands to the limits, one after the other, and counts.

    Its only state is the angle published last. The published angle never moves faster than the
    rate and jerk limits allow: where the speed rises and the wheel is outside the limits of the new
    speed, it returns at that rate, without a jump. The jerk limit is a limit of the rate, never
    zero, so it delays a counter-steer but cannot prevent one.
    """

    def __init__(self, limits: GuardLimits, chassis: ChassisParameters, period: float) -> None:
        """Create a guard at rest.

        Args:
            limits: Limits by speed.
            chassis: Parameters of the car.
            period: Time between commands [s].
        """
        self.limits, self.chassis, self.period = limits, chassis, period
        self.steering = 0.0
        self.count = dict.fromkeys(LIMITS[1:], 0)

    def reset(self, angle: float) -> None:
        """Restart from an angle [rad], clipped to the largest one; the counts continue."""
        if math.isfinite(angle):
            most = max(self.limits.max_angle)
            self.steering = min(max(angle, -most), most)

    def step(
        self,
        angle: float,
        rate: float,
        v_x: float,
        measured: float | None = None,
        elapsed: float | None = None,
    ) -> GuardResult:
        """Return the command to publish; finite and inside the limits for any input.

        Args:
            angle: Planned road-wheel angle; if not finite, the last one is held [rad].
            rate: Planned rate [rad/s].
            v_x: Measured speed [m/s].
            measured: Measured road-wheel angle; None: not measured [rad].
            elapsed: Time since the last command; None: one period [s].
        """
        bound, last = bounds(self.limits, self.chassis, v_x), self.steering

        # A broken clock gives the wheel no time to move; a long pause gives two periods at most.
        elapsed = self.period if elapsed is None else elapsed
        time = min(max(0.0, elapsed), LONGEST_PAUSE * self.period)

        # An angle that is not finite holds the last one.
        clipped = [] if math.isfinite(angle) and math.isfinite(rate) else [NOT_FINITE]
        allowed = angle if math.isfinite(angle) else last

        # Each limit clips the result of those before; rate and jerk come last and always hold.
        turn, jerky_turn = bound.rate * time, bound.jerk * time
        for limit, low, high in (
            (MEASURED_STEP, *measured_range(measured, bound.measured_step, last)),
            (ANGLE, -bound.angle, bound.angle),
            (LATERAL_ACCELERATION, -bound.acceleration, bound.acceleration),
            (RATE, last - turn, last + turn),
            (LATERAL_JERK, last - jerky_turn, last + jerky_turn),
        ):
            inside = min(max(allowed, low), high)
            if inside != allowed:
                clipped.append(limit)
            allowed = inside
        self.steering = allowed
        for limit in clipped:
            self.count[LIMITS[limit]] += 1

        # The rate follows from the clipped angle, and has its own limits.
        rate = (allowed - last) / self.period if clipped else rate
        most = min(bound.rate, bound.jerk)
        return GuardResult(allowed, min(max(rate, -most), most), min(clipped, default=NO_LIMIT))


def measured_range(measured: float | None, step: float, last: float) -> tuple[float, float]:
    """Return the range of commands [rad] around a measured angle.

    The range reaches to the angle published last: a wheel at another angle holds the command back
    but never pulls it along, so a broken sensor cannot steer the car.
    """
    if measured is None or not abs(measured) <= MAX_MEASURED:
        return -math.inf, math.inf
    return min(measured - step, last), max(measured + step, last)
