"""Base class of the yardsticks: published controllers as classes of `doc/my_controller.md`.

Each knows the chassis and the limits of the car, but nothing of its actuator, as the shipped
controllers do by default.
"""

from typing import NamedTuple

import numpy as np

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import (
    GRAVITY,
    ChassisParameters,
    ControllerSettings,
    cornering_angle,
)
from ampc_msgs_config.paths.path import Path, Progress, errors_at, point_at
from ampc_msgs_config.types import Array, VehicleState

FRICTION_USED = 0.8
"""Share of the assumed friction that a steady circle of the largest angle uses."""


class Seen(NamedTuple):
    """The car relative to its path, at the point that the controller guides along it."""

    state: VehicleState
    s: float
    """Arc length [m]."""
    error: float
    """Cross-track error, positive to the left [m]."""
    heading: float
    """Heading error [rad]."""


class Yardstick:
    """A steering controller with `period` and `step(state, path)`; states are at the rear axle."""

    period = 0.05

    def __init__(self, chassis: ChassisParameters, settings: ControllerSettings) -> None:
        """Create a controller at rest."""
        self.chassis, self.settings = chassis, settings
        self.reset()

    @property
    def guided_point(self) -> float:
        """Distance of the point that is guided along the path from the rear axle forward [m]."""
        return self.chassis.cg_to_rear_axle

    def reset(self) -> None:
        """Forget path and earlier commands."""
        self.progress: Progress | None = None
        self.steering = 0.0

    def step(self, state: VehicleState, path: Path) -> float:
        """Return the road-wheel angle for a state of the rear axle, within the bounds [rad]."""
        if self.progress is None or self.progress.path is not path:
            self.progress = Progress(path)
        point = at_distance(state, self.guided_point)
        s = self.progress.advance(point.x, point.y, point.yaw)
        error, heading = errors_at(path, s, point.x, point.y, point.yaw)
        bound = self.bound(state.v_x)
        angle = self.angle(Seen(point, s, error, heading), path)
        self.steering = min(max(angle, -bound), bound)
        return self.steering

    def bound(self, v_x: float) -> float:
        """Return the largest angle, with which a steady circle uses most of the friction [rad]."""
        a_y = FRICTION_USED * self.settings.friction * GRAVITY
        chassis = self.chassis
        circle = cornering_angle(chassis.wheelbase, chassis.understeer_gradient, v_x, a_y)
        return min(self.settings.max_angle, circle)

    def angle(self, seen: Seen, path: Path) -> float:
        """Return the angle without bounds [rad]."""
        raise NotImplementedError


@compiled
def curvatures_ahead(path: Path, s: float, step: float, count: int) -> Array:
    """Return the curvature at `count` points ahead of arc length `s`, `step` [m] apart [1/m]."""
    values = np.empty(count)
    for i in range(count):
        values[i] = point_at(path, s + i * step).curvature
    return values
