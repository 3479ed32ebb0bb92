"""Closed loop without ROS: drive a scenario and return NumPy arrays."""

from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import errors, ticks
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import Array
from ampc_ros.configuration import Choices
from ampc_ros.controller import CustomController, make_controller
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file


class SimulationResult(NamedTuple):
    """A simulated drive, one element per control tick."""

    time: Array
    """Time since the start (n,) [s]."""
    x: Array
    """Position of the rear axle (n,) [m]."""
    y: Array
    """Position of the rear axle (n,) [m]."""
    yaw: Array
    """Heading (n,) [rad]."""
    speed: Array
    """Longitudinal speed (n,) [m/s]."""
    steering: Array
    """Commanded road-wheel angle (n,) [rad]."""
    cross_track_error: Array
    """Cross-track error of the centre of gravity, positive to the left (n,) [m]."""


def simulate(
    controller: object,
    scenario: str = "sc1",
    vehicle: str = "ordinary",
    *,
    noise: str = "",
    seed: int = 0,
) -> SimulationResult:
    """Drive a scenario to its end, in lock-step.

    Args:
        controller: Object with `period` and `step(state, path)`, name of a controller, or
            `FILE.py:CLASS`.
        scenario: Shipped scenario, or YAML file.
        vehicle: Shipped vehicle, or YAML file.
        noise: Shipped noise of the measurement, or YAML file; empty: none.
        seed: Seed of the noise.

    Returns:
        The measured states; without noise these are the true ones.

    Raises:
        ValueError: A name is unknown, a file is wrong, or the controller is unsuitable.
    """
    car = load_vehicle_file(find("vehicles", vehicle))
    road, to_cg = load_scenario(scenario, car.size), car.chassis.cg_to_rear_axle
    if isinstance(controller, str):
        controller = make_controller(Choices(controller, vehicle))
    elif not hasattr(controller, "formulation"):
        controller = CustomController(type(controller).__name__, controller, to_cg)
    simulation = Simulation(
        car,
        road,
        noise=load(MeasurementNoise, find("noise", noise)) if noise else None,
        rng=np.random.default_rng(seed),
    )
    driven = drive(simulation, controller)  # type: ignore[arg-type]
    x, y, yaw, speed = np.array([state[1:5] for state in driven.states]).T
    error = errors(driven, make_path(road.points), to_cg)[:, 0]
    return SimulationResult(ticks(driven), x, y, yaw, speed, driven.steering, error)
