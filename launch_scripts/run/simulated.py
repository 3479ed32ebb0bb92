"""A drive of the simulated car together with the road, the scenario and the car."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.metrics import LOST, Drive
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import Array, Diagnosis
from sim_vehicle.parameters import Vehicle


class SimulatedDrive(NamedTuple):
    """A finished drive of the simulated car."""

    drive: Drive
    path: Path
    scenario: Scenario
    vehicle: Vehicle
    error: Array
    """Cross-track error at each tick (n,) [m]."""
    diagnosis: Sequence[Diagnosis] = ()
    """Diagnosis of the controller at each tick; empty if not recorded."""


def ticks_until_lost(driven: SimulatedDrive) -> int:
    """Return the number of ticks until the car is more than LOST from its path."""
    gone = np.abs(driven.error) > LOST
    return int(np.argmax(gone)) if gone.any() else len(driven.error)


def centre_of_gravity(driven: SimulatedDrive) -> Array:
    """Return x and y of the centre of gravity (2, n) [m]."""
    to_cg = driven.vehicle.chassis.cg_to_rear_axle
    return np.array([at_distance(state, to_cg)[1:3] for state in driven.drive.states]).T
