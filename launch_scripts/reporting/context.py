"""Who drove which car with which settings, as far as a bag or its user tells."""

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ampc_msgs_config.config import build
from ampc_msgs_config.parameters import (
    ChassisParameters,
    ControllerSettings,
    GuardLimits,
    SizeParameters,
    SteeringParameters,
)
from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import Checked
from ampc_ros.mpc.internal_model import limits_of
from ampc_ros.preview.model import angle_bound
from ampc_ros.preview.qp_assembly import FRICTION_SHARE
from ampc_ros.supervision.guard import bounds
from launch_scripts.bags.bag_columns import BagColumns
from sim_vehicle.parameters import Vehicle

T = TypeVar("T", bound=Checked)
OUTLINE = SizeParameters(width=1.8, front_overhang=0.9, rear_overhang=1.0)
"""Of a car whose size nobody tells."""
WHEELBASE = 2.7
"""Of a car that nobody describes [m]."""


class ReportInputs(NamedTuple):
    """What the user says about a drive whose bag does not."""

    vehicle: Vehicle | None = None
    settings: ControllerSettings | None = None
    controller: str = ""


class RunContext(NamedTuple):
    """What is known about controller and car; None where nothing is."""

    controller: str
    version: str
    chassis: ChassisParameters | None
    steering: SteeringParameters | None
    settings: ControllerSettings | None
    size: SizeParameters | None
    guard: GuardLimits | None
    to_cg: float
    """From the point that `odom` describes forward to the centre of gravity [m]."""
    notes: tuple[str, ...]

    @property
    def outline(self) -> Array:
        """Corners (n, 2) of the car, from above, about the point that `odom` describes [m]."""
        size, wheelbase, rear_axle = self.size or OUTLINE, WHEELBASE, 0.0
        if self.chassis is not None:
            wheelbase = self.chassis.wheelbase
            rear_axle = self.to_cg - self.chassis.cg_to_rear_axle
        rear, half = rear_axle - size.rear_overhang, size.width / 2
        front = rear_axle + wheelbase + size.front_overhang
        nose = front - 0.35 * size.width  # narrower in front, so that it is seen where it heads
        right = [(rear, -half), (nose, -half), (front, -0.6 * half)]
        return np.array([*right, *((x, -y) for x, y in reversed(right)), right[0]])

    def angle_bound(self, speed: Array) -> Array | None:
        """Give the controller's bound of the angle at speeds (n,) [m/s], in [rad]."""
        if self.settings is None:
            return None
        limits = limits_of(self.settings, self.steering)
        if self.chassis is None or self.controller != "preview":
            return np.full(len(speed), limits.u_max)
        row = (*vars(self.chassis).values(),)
        most = FRICTION_SHARE * limits.mu_g
        return np.array([angle_bound(row, v, limits.u_max, most) for v in speed.tolist()])

    def guard_bound(self, speed: Array) -> Array | None:
        """Give the guard's bound of the angle at speeds (n,) [m/s], in [rad]."""
        if self.guard is None or self.chassis is None:
            return None
        found = (bounds(self.guard, self.chassis, v) for v in speed.tolist())
        return np.array([min(each.angle, each.acceleration) for each in found])


def run_context_of(columns: BagColumns, given: ReportInputs) -> RunContext:
    """Give what a bag's configuration tells, completed by what the user says."""
    control = columns.configuration.get("controller", {})
    vehicle = columns.configuration.get("simulator", {}).get("vehicle", {})
    car, notes = given.vehicle, [] if control else [untold(given)]
    chassis = section(ChassisParameters, control, "chassis", notes) or (car and car.chassis)
    size = section(SizeParameters, vehicle, "size", notes) or (car and car.size)
    if size is None:
        notes.append("The size of the car is not in the bag: its outline on the map is assumed.")
    numbers = np.unique(columns.tick.get("configuration", np.zeros((1, 2)))[:, 1])
    if len(numbers) > 1:
        notes.append(f"The configuration was changed {len(numbers) - 1} times: the last is shown.")
    return RunContext(
        str(control.get("controller", given.controller)),
        str(control.get("version", "")),
        chassis,
        section(SteeringParameters, control, "steering", notes) or (car and car.steering),
        section(ControllerSettings, control, "settings", notes) or given.settings,
        size,
        section(GuardLimits, control, "guard", notes),
        distance_to_cg(control.get("base_link_to_cg"), chassis, notes),
        tuple(notes),
    )


def section(cls: type[T], content: Any, name: str, notes: list[str]) -> T | None:
    """Build one section of a configuration; notes why it cannot be used."""
    if not isinstance(content, Mapping) or name not in content:
        return None
    try:
        return build(cls, content[name], f"configuration: {name}")
    except ValueError as error:
        notes.append(f"Left out: {error}.")
        return None


def untold(given: ReportInputs) -> str:
    """Say what follows where the bag holds no configuration of the controller."""
    missing = "The bag holds no controller/configuration"
    if given.vehicle is None:
        return f"{missing}: vehicle, settings and bounds of the steering are unknown."
    return f"{missing}: vehicle and settings are those named when this page was made."


def distance_to_cg(told: Any, chassis: ChassisParameters | None, notes: list[str]) -> float:
    """Give how far the centre of gravity is ahead of what `odom` describes [m]."""
    if isinstance(told, (int, float)) and told >= 0:
        return float(told)
    if chassis is None:
        notes.append(
            "Errors are those of the point that odom describes (centre of gravity unknown)."
        )
        return 0.0
    return chassis.cg_to_rear_axle
