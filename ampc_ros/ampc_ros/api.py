"""Python interface of the controller without ROS; see `ampc_ros/doc/python_api.md`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import NANOSECONDS, Plan, VehicleState
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.configuration import default_table
from ampc_ros.mpc.gain_table import GainTable
from ampc_ros.mpc.gain_table import load_gain_table as load_gains
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.supervision.checks import check_path

__all__ = ["AdaptiveMpc", "VehicleModel", "load_gains", "load_vehicle", "make_state"]


class VehicleModel(NamedTuple):
    """Parameters of a vehicle that the controller uses."""

    name: str
    """Name of a shipped vehicle, or path of a file."""
    chassis: ChassisParameters
    steering: SteeringParameters


def load_vehicle(name: str) -> VehicleModel:
    """Load chassis and steering of a shipped vehicle or of a YAML file.

    Raises:
        ValueError: The file is missing or wrong.
    """
    vehicle, user = read_vehicle(find("vehicles", name)), "the controller"
    chassis = vehicle.section(ChassisParameters, "chassis", user)
    return VehicleModel(name, chassis, vehicle.section(SteeringParameters, "steering", user))


def make_state(
    x: float,
    y: float,
    yaw: float,
    v_x: float,
    v_y: float = 0.0,
    yaw_rate: float = 0.0,
    time: float = 0.0,
) -> VehicleState:
    """Return the state of the centre of the rear axle.

    Args:
        x: Position [m].
        y: Position [m].
        yaw: Heading [rad].
        v_x: Longitudinal speed [m/s].
        v_y: Lateral speed of the rear axle, positive to the left [m/s].
        yaw_rate: Yaw rate [rad/s].
        time: Time of the measurement [s].
    """
    return VehicleState(round(time * NANOSECONDS), x, y, yaw, v_x, v_y, yaw_rate)


class AdaptiveMpc(PreviewMpc):
    """Adaptive MPC for one vehicle: `AdaptiveMpc(load_vehicle("ordinary")).step(state, path)`.

    It has no input checks, fallbacks or guard: these are in `ampc_ros.supervision`.
    """

    def __init__(
        self, vehicle: VehicleModel, gains: GainTable | None = None, settings: str = "table3"
    ) -> None:
        """Create a controller at rest.

        Args:
            vehicle: Parameters of the vehicle.
            gains: Gain table; None: the shipped one of the vehicle, or that for any car.
            settings: Shipped limits and solver, or YAML file.

        Raises:
            ValueError: A file is missing or wrong.
        """
        limits = load(ControllerSettings, find("controllers", settings))
        table = gains or load_gains(default_table("preview", vehicle.name))
        super().__init__(vehicle.chassis, vehicle.steering, limits, table)
        self.vehicle, self.max_angle = vehicle, min(limits.max_angle, vehicle.steering.max_angle)
        self._points: ArrayLike | None = None

    def step(self, state: VehicleState, path: Path | ArrayLike) -> Plan:
        """Compute the plan for a state; call it once per `period`.

        Args:
            state: State of the centre of the rear axle.
            path: Path, or points (n, 2) in driving order [m]; equal points are the same path.

        Raises:
            ValueError: The points are no path that the vehicle can drive.
        """
        if not isinstance(path, Path):
            path = self._path_through(np.asarray(path, dtype=float))
        return super().step(state, path)

    def _path_through(self, points: ArrayLike) -> Path:
        if self._points is None or not np.array_equal(self._points, points):
            self._path = check_path(points, self.vehicle.chassis, self.max_angle)
            self._points = np.array(points)
        return self._path
