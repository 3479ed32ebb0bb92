"""The last check of a steering command before it is published, whoever computed it.

It shares nothing with the controllers: limits by speed, the car's wheelbase and understeer, and the
angle published last are all that it knows.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_msgs_config.types import LIMITS

NONE, NOT_FINITE, ANGLE, LATERAL_ACCELERATION, RATE, LATERAL_JERK, MEASURED_STEP = range(
    len(LIMITS)
)
MAX_SPEED = 100.0
"""A larger speed is a broken measurement [m/s]."""
MIN_SPEED = 0.1
"""Slower, no angle gives a lateral acceleration worth a limit [m/s]."""
MAX_MEASURED = math.pi / 2
"""A larger measured road-wheel angle is a broken measurement [rad]."""
LONGEST_PAUSE = 2.0
"""The wheel may catch up after a missed tick, not after a longer pause [periods]."""
SHORTEST = 0.5
"""Least length that an oversteering car is credited with [wheelbases]."""


class Guarded(NamedTuple):
    """A command that keeps to the limits."""

    steering: float
    """Road-wheel angle [rad]."""
    steering_rate: float
    """Rate at which it is to be reached [rad/s]."""
    limit: int
    """Index in LIMITS of the first one that clipped the command."""


class Bounds(NamedTuple):
    """The limits of one speed, as angles and rates of the road wheel."""

    angle: float
    """[rad]."""
    acceleration: float
    """Angle of the steady circle with the largest lateral acceleration [rad]."""
    rate: float
    """[rad/s]."""
    jerk: float
    """Rate that gives the largest lateral jerk [rad/s]."""
    measured_step: float
    """[rad]."""


def bounds(limits: GuardLimits, chassis: ChassisParameters, v_x: float) -> Bounds:
    """Give the limits of a speed [m/s]; of one that cannot be, the strictest of all speeds.

    On a steady circle a_y = v^2 kappa = v^2 delta / (L + K_us v^2).

    Note:
        The kinematic v^2 delta / L would be larger and so safer, but an understeering car needs
        more angle than that: at 30 m/s the paper's car takes five times as much for the same
        circle, and a limit of 5 m/s^2 would end ordinary driving at 1 m/s^2. Where a car
        oversteers, L + K_us v^2 vanishes at its critical speed; there it must be able to
        counter-steer, so no less than half its wheelbase counts.
    """
    v = abs(v_x)
    if v <= MAX_SPEED:
        v = max(v, MIN_SPEED)
        angle, rate, acceleration, jerk, step = (
            joined(limits.speed, row, v) for row in rows(limits)
        )
    else:
        v = MAX_SPEED
        angle, rate, acceleration, jerk, step = (min(row) for row in rows(limits))
    L, K_us = chassis.wheelbase, chassis.understeer_gradient
    per_acceleration = max(L + K_us * v * v, SHORTEST * L) / (v * v)  # rad per m/s^2
    return Bounds(angle, acceleration * per_acceleration, rate, jerk * per_acceleration, step)


def rows(limits: GuardLimits) -> tuple[tuple[float, ...], ...]:
    """Give what depends on speed: angle, rate, acceleration, jerk, step from the measured angle."""
    return (
        limits.max_angle,
        limits.max_rate,
        limits.lateral_acceleration,
        limits.lateral_jerk,
        limits.measured_step,
    )


def joined(at: Sequence[float], values: Sequence[float], place: float) -> float:
    """Join values at increasing places by straight lines; the ends are held."""
    i = bisect_right(at, place)
    if i == 0 or i == len(at):
        return values[min(i, len(at) - 1)]
    share = (place - at[i - 1]) / (at[i] - at[i - 1])
    return values[i - 1] + share * (values[i] - values[i - 1])


class Guard:
    """Clips commands to the limits, one after the other, and counts.

    What it remembers is the angle published last. The published angle never moves faster than the
    rate and jerk limits allow: where the speed rises and the wheel is outside what the new speed
    allows, it goes back inside at that rate, it never jumps. The jerk limit is a limit of the rate,
    never zero, so it delays a counter-steer but cannot prevent one.
    """

    def __init__(self, limits: GuardLimits, chassis: ChassisParameters, period: float) -> None:
        """Make a guard at rest.

        Args:
            limits: By speed.
            chassis: The car.
            period: Of the commands [s].
        """
        self.limits, self.chassis, self.period = limits, chassis, period
        self.steering = 0.0
        self.count = dict.fromkeys(LIMITS[1:], 0)

    def reset(self, angle: float) -> None:
        """Start anew from an angle [rad], as far as it can be; the counts go on."""
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
    ) -> Guarded:
        """Give the command to publish; finite and inside the limits, whatever comes in.

        Args:
            angle: Planned road-wheel angle; one that is not finite: the last one is held [rad].
            rate: At which it is to be reached [rad/s].
            v_x: Measured speed [m/s].
            measured: Road-wheel angle, where it is measured [rad].
            elapsed: Time since the last command; by default one period [s].
        """
        bound, last = bounds(self.limits, self.chassis, v_x), self.steering
        time = self._time(elapsed)
        clipped = [] if math.isfinite(angle) and math.isfinite(rate) else [NOT_FINITE]
        asked = angle if math.isfinite(angle) else last
        turn, jerky_turn = bound.rate * time, bound.jerk * time
        for limit, low, high in (
            (MEASURED_STEP, *around(measured, bound.measured_step, last)),
            (ANGLE, -bound.angle, bound.angle),
            (LATERAL_ACCELERATION, -bound.acceleration, bound.acceleration),
            (RATE, last - turn, last + turn),
            (LATERAL_JERK, last - jerky_turn, last + jerky_turn),
        ):
            inside = min(max(asked, low), high)
            if inside != asked:
                clipped.append(limit)
            asked = inside
        self.steering = asked
        for limit in clipped:
            self.count[LIMITS[limit]] += 1
        rate = (asked - last) / self.period if clipped else rate
        most = min(bound.rate, bound.jerk)
        return Guarded(asked, min(max(rate, -most), most), min(clipped, default=NONE))

    def _time(self, elapsed: float | None) -> float:
        """Give the time that the wheel has had to move [s]; none where the clock is broken."""
        elapsed = self.period if elapsed is None else elapsed
        return min(max(0.0, elapsed), LONGEST_PAUSE * self.period)


def around(measured: float | None, step: float, last: float) -> tuple[float, float]:
    """Give the range of commands that a measured angle allows [rad].

    It reaches to the angle published last: a wheel that is elsewhere holds the command back, but
    never pulls it along, so a broken sensor cannot steer the car.
    """
    if measured is None or not abs(measured) <= MAX_MEASURED:
        return -math.inf, math.inf
    return min(measured - step, last), max(measured + step, last)
