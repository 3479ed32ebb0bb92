"""Steering without a solver: the road's own angle, and a damped return to the path.

The rung of the ladder below the last plan. It shares the equations of the road with the
controller, but no programme, no table and no memory beyond the place on the path.
"""

import math
from dataclasses import astuple

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.paths.path import Path, Progress, curvature_between, errors_at, point_at
from ampc_msgs_config.types import VehicleState
from ampc_ros.mpc.model import MIN_SPEED
from ampc_ros.preview.model import road_steering

FREQUENCY = 0.8
"""Natural frequency of the return to the path, critically damped: slow enough for a steering that
is 0.3 s late [rad/s]."""
SHORTEST_RETURN = 4.0
"""Speed over frequency where the car is slow: a return takes a way, however long that lasts [m]."""
MAX_RETURN = 1.0
"""Cross-track error from which on the pull does not grow [m]."""
STEP = 0.1
"""Time over which the change of the road's curvature is read [s]."""


class FeedForward:
    """Steady-state angle of the path with feedback of cross-track error and its rate."""

    def __init__(self, chassis: ChassisParameters, base_link_to_cg: float) -> None:
        """Know the car.

        Args:
            chassis: As it is believed to be.
            base_link_to_cg: From the point that `odom` describes forward to the centre of gravity
                [m].
        """
        self.chassis, self.to_cg = chassis, base_link_to_cg
        self.vehicle = astuple(chassis)
        self.reset()

    def reset(self) -> None:
        """Forget where on the path the car was."""
        self.progress: Progress | None = None

    def steering(self, state: VehicleState, path: Path) -> float:
        """Give the angle for a state at `base_link` [rad].

        The error obeys e_y'' = v^2 (kappa - kappa_path) where the slip angles are steady, so
        kappa = kappa_path - (omega^2 e_y + 2 omega e_y') / v^2 brings it to rest.

        Note:
            e_y' is that of the rear axle. At the centre of gravity it would answer the wheel at
            once, by l_r r: a loop without delay, unstable below 3 m/s. The heading alone would
            leave out the slip of the tyres: off by metres in a fast bend, and an understeering car
            swings at 40 m/s.
        """
        car, v = at_distance(state, self.to_cg), max(state.v_x, MIN_SPEED)
        if self.progress is None or self.progress.path is not path:
            self.progress = Progress(path)
        s = self.progress.advance(car.x, car.y, car.yaw)
        omega = min(FREQUENCY, v / SHORTEST_RETURN)
        error, _ = errors_at(path, s, car.x, car.y, car.yaw)
        error = min(max(error, -MAX_RETURN), MAX_RETURN)
        pull = omega**2 * error + 2 * omega * self._rear_rate(car, v, path, s)
        gradient = max(self.chassis.understeer_gradient, 0.0)
        return self._road(v, path, s) - pull * (self.chassis.wheelbase / v**2 + gradient)

    def _rear_rate(self, car: VehicleState, v: float, path: Path, s: float) -> float:
        """Rate at which the rear axle leaves the path [m/s]."""
        l_r = self.chassis.cg_to_rear_axle
        course = car.yaw - point_at(path, s - l_r).heading
        return v * math.sin(course) + car.v_y - l_r * car.yaw_rate

    def _road(self, v: float, path: Path, s: float) -> float:
        """Angle that the path asks for [rad]."""
        now = curvature_between(path, s, s + v * STEP)
        soon = curvature_between(path, s + v * STEP, s + 2 * v * STEP)
        return road_steering(self.vehicle, v, now, (soon - now) / STEP)
