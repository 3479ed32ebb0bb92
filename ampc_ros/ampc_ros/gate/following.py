"""How the gate follows a plan: by the distance travelled, and back to its places where it can.

A car that brakes reaches each place later than planned, and at a lower speed. The angle is
therefore that of the place, for the same curvature at the actual speed. Where the pose of the car
is measured, the distance is that of its projection, and its error decays as that of a critically
damped spring.
"""

import math
from bisect import bisect_left, bisect_right
from typing import NamedTuple

from ampc_msgs_config.parameters import MIN_SPEED, ChassisParameters
from ampc_ros.gate.plan import SteeringPlan
from ampc_ros.path_return import return_angle
from ampc_ros.supervision.guard import interpolate_linear

RETURN_FREQUENCY = 1.2
"""Natural frequency of the return to the planned places: slow enough for a steering with 0.3 s of
delay [rad/s]."""
LEAST_RETURN = 1.5
"""Smallest ratio of speed to frequency: a slow car returns over a distance [wheelbases]."""
MOST_ERROR = 1.0
"""Error at which the correction saturates [m]."""
CREDIBLE_ERROR, CREDIBLE_HEADING = 3.0, math.pi / 3
"""A pose that differs more from the plan is not used [m, rad]."""
PROJECTION_REACH, PROJECTION_TIME = 2.0, 0.5
"""Range of the projection, ahead and behind: distance [m], and time at the planned speed [s]."""


class MeasuredPose(NamedTuple):
    """Pose and velocity of `base_link`."""

    x: float
    """[m]."""
    y: float
    """[m]."""
    yaw: float
    """[rad]."""
    v_x: float
    """[m/s]."""
    v_y: float
    """[m/s]."""

    def after(self, time: float) -> "MeasuredPose":
        """Return the pose after a short time of straight motion [s]."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        x = self.x + (self.v_x * cosine - self.v_y * sine) * time
        y = self.y + (self.v_x * sine + self.v_y * cosine) * time
        return self._replace(x=x, y=y)


class PlanPlace(NamedTuple):
    """Where a car is relative to a plan."""

    distance: float
    """Distance since the start of the plan [m]."""
    error: float
    """Distance to the left of the planned places [m]."""
    heading_error: float
    """[rad]."""


def followed_angle(
    plan: SteeringPlan, chassis: ChassisParameters, distance: float, speed: float
) -> float:
    """Return the angle of a plan at a distance, for the actual speed [rad].

    The curvature of a steady circle is delta / (L + K_us v^2).

    Args:
        plan: The plan.
        chassis: Parameters of the car.
        distance: Distance travelled since the start of the plan [m].
        speed: Speed of the car [m/s].
    """
    L, K_us = chassis.wheelbase, max(chassis.understeer_gradient, 0.0)
    planned = interpolate_linear(plan.distances, plan.speeds, distance)
    angle = interpolate_linear(plan.distances, plan.angles, distance)
    return angle * (L + K_us * speed * speed) / (L + K_us * planned * planned)


def pose_correction(place: PlanPlace, chassis: ChassisParameters, pose: MeasuredPose) -> float:
    """Return the change of the angle that brings a car back to the planned places [rad].

    Args:
        place: Where the car is.
        chassis: Parameters of the car.
        pose: Its pose and velocity.
    """
    v, L = max(pose.v_x, MIN_SPEED), chassis.wheelbase
    omega = min(RETURN_FREQUENCY, v / (LEAST_RETURN * L))
    error = min(max(place.error, -MOST_ERROR), MOST_ERROR)
    sine, cosine = math.sin(place.heading_error), math.cos(place.heading_error)
    errors = error, v * sine + pose.v_y * cosine
    return return_angle(errors, omega, v, (L, max(chassis.understeer_gradient, 0.0)))


def place_on(plan: SteeringPlan, pose: MeasuredPose, distance: float) -> PlanPlace | None:
    """Return where a car is on a plan; None: that is not known, or not credible.

    Args:
        plan: The plan.
        pose: Pose of the car.
        distance: Distance that it has travelled since the start of the plan, about [m].
    """
    if not plan.places:
        return None
    reach = PROJECTION_REACH + PROJECTION_TIME * interpolate_linear(
        plan.distances, plan.speeds, distance
    )
    first = max(bisect_left(plan.distances, distance - reach) - 1, 0)
    last = min(bisect_right(plan.distances, distance + reach), len(plan.places) - 1)
    nearest, at, share = math.inf, first, 0.0
    for i in range(first, last):
        (x, y), (x_next, y_next) = plan.places[i], plan.places[i + 1]
        dx, dy = x_next - x, y_next - y
        squared = dx * dx + dy * dy
        along = ((pose.x - x) * dx + (pose.y - y) * dy) / squared if squared else 0.0
        along = min(max(along, 0.0), 1.0)
        away = math.hypot(pose.x - x - along * dx, pose.y - y - along * dy)
        if away < nearest:
            nearest, at, share = away, i, along
    before, after = heading_at(plan, at), heading_at(plan, min(at + 1, len(plan.places) - 1))
    heading = before + share * difference(after, before)
    (x, y), (x_next, y_next) = plan.places[at], plan.places[min(at + 1, len(plan.places) - 1)]
    x, y = x + share * (x_next - x), y + share * (y_next - y)
    error = (pose.y - y) * math.cos(heading) - (pose.x - x) * math.sin(heading)
    turned = difference(pose.yaw, heading)
    if not (nearest <= CREDIBLE_ERROR and abs(turned) <= CREDIBLE_HEADING):
        return None
    start, end = plan.distances[at], plan.distances[min(at + 1, len(plan.places) - 1)]
    return PlanPlace(start + share * (end - start), error, turned)


def heading_at(plan: SteeringPlan, i: int) -> float:
    """Return the direction from the place before place i to the one after it [rad]."""
    (x, y), (x_next, y_next) = (
        plan.places[max(i - 1, 0)],
        plan.places[min(i + 1, len(plan.places) - 1)],
    )
    return math.atan2(y_next - y, x_next - x)


def difference(a: float, b: float) -> float:
    """Return a - b in [-pi, pi) [rad]."""
    return (a - b + math.pi) % math.tau - math.pi
