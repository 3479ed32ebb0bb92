"""Pure pursuit, the geometric baseline: steer the rear axle through a point ahead on the path."""

import math

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.paths.path import Path, Progress, point_at
from ampc_msgs_config.types import Diagnosis, Plan, VehicleState
from ampc_ros.controller_interface import Controller


class PurePursuit(Controller):
    """Pure pursuit (Coulter 1992) with a look-ahead distance proportional to speed."""

    formulation = "pure_pursuit"
    steering = 0.0

    def __init__(
        self,
        chassis: ChassisParameters,
        settings: ControllerSettings,
        base_link_to_cg: float | None = None,
    ) -> None:
        """Create a controller at rest; see `LateralMpc` for the arguments."""
        self.chassis, self.settings = chassis, settings
        self.period = settings.sample_time
        self.to_cg = chassis.cg_to_rear_axle if base_link_to_cg is None else base_link_to_cg
        self.reset()

    def reset(self, steering: float = 0.0) -> None:
        """Forget the path; `steering` is the angle in force [rad]."""
        self.steering = steering
        self.path: Path | None = None

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Compute the angle for a state at `base_link`."""
        if path is not self.path:
            self.path, self.rear, self.centre = path, Progress(path), Progress(path)
        centre = at_distance(state, self.to_cg)
        rear = at_distance(centre, -self.chassis.cg_to_rear_axle)
        before, bound = self.steering, self.settings.max_angle
        self.steering = min(max(self._aim(rear), -bound), bound)
        rate = (self.steering - before) / self.period
        return Plan(state.stamp_ns, self.steering, rate, Diagnosis(*self.centre.errors(centre)))

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Continue from another angle in force; see `Controller`."""
        self.steering = steering

    def _aim(self, rear: VehicleState) -> float:
        """atan(2 L sin(eta) / l_d): the circle through the rear axle, tangent to the car [rad]."""
        look_ahead = max(self.settings.look_ahead_time * rear.v_x, self.settings.min_look_ahead)
        s = self.rear.advance(rear.x, rear.y, rear.yaw)
        goal = point_at(self.rear.path, s + look_ahead)
        distance = max(math.hypot(goal.x - rear.x, goal.y - rear.y), 1e-6)
        eta = math.atan2(goal.y - rear.y, goal.x - rear.x) - rear.yaw
        return math.atan(2 * self.chassis.wheelbase * math.sin(eta) / distance)
