"""Steering without a solver: the road's own angle, and a damped return to the path.

The level of the fallback chain below the last plan. It shares the equations of the road with the
controller, but no QP, no gain table and no memory except the position on the path.
"""

import math
from dataclasses import astuple

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import MIN_SPEED, ChassisParameters
from ampc_msgs_config.paths.path import Path, Progress, curvature_between, errors_at, point_at
from ampc_msgs_config.types import VehicleState
from ampc_ros.path_return import return_angle
from ampc_ros.preview.model import road_steering

FREQUENCY = 0.8
"""Natural frequency of the critically damped return to the path: slow enough for a steering with
0.3 s of delay [rad/s]."""
SHORTEST_RETURN = 4.0
"""Smallest ratio of speed to frequency: a slow car returns over a distance, not in a time [m]."""
MAX_RETURN = 1.0
"""Cross-track error at which the feedback saturates [m]."""
STEP = 0.1
"""Time over which the change of the path's curvature is computed [s]."""


class FeedForward:
    """Steady-state angle of the path with feedback of cross-track error and its rate."""

    def __init__(self, chassis: ChassisParameters, base_link_to_cg: float) -> None:
        """Create the control law for a car.

        Args:
            chassis: Assumed parameters of the car.
            base_link_to_cg: From the point that `odom` describes forward to the centre of gravity
                [m].
        """
        self.chassis, self.to_cg = chassis, base_link_to_cg
        self.vehicle = astuple(chassis)
        self.reset()

    def reset(self) -> None:
        """Forget the position on the path."""
        self.progress: Progress | None = None

    def steering(self, state: VehicleState, path: Path) -> float:
        """Return the angle for a state at `base_link` [rad]: the road's, and `return_angle`.

        Note:
            e_y' is taken at the rear axle. At the centre of gravity it would respond to the wheel
            immediately, by l_r r: a loop without delay, unstable below 3 m/s. The heading alone
            would ignore the slip angles: an error of metres in a fast bend, and an understeering
            car oscillates at 40 m/s.
        """
        car, v = at_distance(state, self.to_cg), max(state.v_x, MIN_SPEED)
        if self.progress is None or self.progress.path is not path:
            self.progress = Progress(path)
        s = self.progress.advance(car.x, car.y, car.yaw)
        omega = min(FREQUENCY, v / SHORTEST_RETURN)
        error, _ = errors_at(path, s, car.x, car.y, car.yaw)
        error = min(max(error, -MAX_RETURN), MAX_RETURN)
        chassis = self.chassis.wheelbase, max(self.chassis.understeer_gradient, 0.0)
        errors = error, self._rear_rate(car, v, path, s)
        return self._road(v, path, s) + return_angle(errors, omega, v, chassis)

    def _rear_rate(self, car: VehicleState, v: float, path: Path, s: float) -> float:
        """Return the lateral rate of the rear axle relative to the path [m/s]."""
        l_r = self.chassis.cg_to_rear_axle
        course = car.yaw - point_at(path, s - l_r).heading
        return v * math.sin(course) + car.v_y - l_r * car.yaw_rate

    def _road(self, v: float, path: Path, s: float) -> float:
        """Return the steady-state angle of the path [rad]."""
        now = curvature_between(path, s, s + v * STEP)
        soon = curvature_between(path, s + v * STEP, s + 2 * v * STEP)
        return road_steering(self.vehicle, v, now, (soon - now) / STEP)
