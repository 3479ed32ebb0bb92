"""Steering without a solver: the road's own angle, and a damped return to the path.

The rung of the ladder below the last plan. It shares the equations of the road with the
controller, but no programme, no table and no memory beyond the place on the path.
"""

import math
from dataclasses import astuple

from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.path import Path, Progress, curvature_between, point_at
from ampc_msgs_config.types import VehicleState, at_distance
from ampc_ros.model import MIN_SPEED
from ampc_ros.preview_model import road_steering, understeer_gradient

FREQUENCY = 1.0
"""Natural frequency of the return to the path, critically damped: slow enough for a steering that
is half a second late [rad/s]."""
MAX_RETURN = 1.0
"""Cross-track error from which on the pull does not grow [m]."""
STEP = 0.1
"""Time over which the change of the road's curvature is read [s]."""


class FeedForward:
    """Steady-state angle of the path with feedback of cross-track and heading error."""

    def __init__(self, chassis: ChassisParameters, base_link_to_cg: float) -> None:
        """Know the car.

        Args:
            chassis: As it is believed to be.
            base_link_to_cg: From the point that `odom` describes forward to the centre of gravity
                [m].
        """
        self.vehicle, self.to_cg = astuple(chassis), base_link_to_cg
        self.wheelbase = chassis.wheelbase
        self.progress: Progress | None = None

    def steering(self, state: VehicleState, path: Path) -> float:
        """Give the angle for a state at `base_link` [rad].

        The errors obey e_y'' = v^2 (kappa - kappa_path) where the slip angles are steady, so
        kappa = kappa_path - (omega^2 e_y + 2 omega v sin(e_psi)) / v^2 brings them to rest.
        """
        car = at_distance(state, self.to_cg)
        if self.progress is None or self.progress.path is not path:
            self.progress = Progress(path)
        s = self.progress.advance(car.x, car.y, car.yaw)
        point = point_at(path, s)
        e_y = (car.y - point.y) * math.cos(point.heading) - (car.x - point.x) * math.sin(
            point.heading
        )
        v = max(car.v_x, MIN_SPEED)
        ahead = (
            curvature_between(path, s, s + v * STEP),
            curvature_between(path, s + v * STEP, s + 2 * v * STEP),
        )
        road = road_steering(self.vehicle, v, ahead[0], (ahead[1] - ahead[0]) / STEP)
        pull = FREQUENCY**2 * min(max(e_y, -MAX_RETURN), MAX_RETURN)
        damping = 2 * FREQUENCY * v * math.sin(car.yaw - point.heading)
        curvature = -(pull + damping) / v**2
        return road + curvature * (self.wheelbase + understeer_gradient(self.vehicle) * v**2)
