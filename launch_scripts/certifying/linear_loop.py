"""Closed-loop eigenvalues near a straight path: spectral radius over speed and delay.

Car and controller form one map from tick to tick, which is linear for small deviations. Its
Jacobian is computed by differences of the `step()` of the controller.
"""

import copy
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.internal_model import actuator_of
from ampc_ros.mpc.model import STATES
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.paper import tick as paper
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview import tick as preview
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.preview.model import SampledModel, sample_model

DIFFERENCE_SIZE = 1e-6
"""Size of the differences, small enough that no bound is active."""
STRAIGHT_PATH = make_path([(0.0, 0.0), (400.0, 0.0)])
BEGIN = 100.0
"""Position of the car on the path [m]."""
LARGEST_DELAY = 0.3
"""Largest unknown delay that is tried [s]."""
CertifiedController = PreviewMpc | LateralMpc
Places = NDArray[np.int64]


def memory_places(controller: CertifiedController) -> Places:
    """Return the positions in the memory of a controller that are states of the loop."""
    if isinstance(controller, PreviewMpc):
        return np.arange(preview.BEFORE, len(controller.memory))
    return np.array([paper.STEERING, *range(paper.LAST, paper.INDEX)])


def estimator_places(controller: CertifiedController) -> Places:
    """Return the positions of the disturbance estimate in the memory of a controller."""
    if isinstance(controller, PreviewMpc):
        return np.arange(preview.DISTURBANCE, preview.EXPECTED)
    return np.zeros(0, dtype=int)


def loop_matrix(
    controller: CertifiedController,
    chassis: ChassisParameters,
    steering: SteeringParameters,
    v_x: float,
    *,
    estimator: bool = True,
) -> Array:
    """Return the Jacobian (n, n) of the map of car and controller from tick to tick.

    The state consists of [v_y, e_psi, r, e_y, delta] of the car, the commands in the delay of its
    steering, and the memory of the controller.

    Args:
        controller: Controller with its internal model.
        chassis: Chassis of the car.
        steering: Steering of the car; delay and lag may differ from the internal model.
        v_x: Speed [m/s].
        estimator: Whether the controller updates its disturbance estimate. Otherwise the estimate
            is held at zero, and its rows and columns are removed.
    """
    T = controller.period
    actuator = actuator_of(steering, T)
    vehicle = tuple(vars(chassis).values())
    A, B_old, B_new, D = np.zeros((STATES, STATES)), *np.zeros((3, STATES))
    sample_model(vehicle, v_x, T, actuator, SampledModel(A, B_old, B_new, D), make_scratch(400))
    places, queue = memory_places(controller), actuator.ticks + 1
    on_path = copy.copy(controller)
    on_path.memory = controller.memory.copy()
    on_path.step(VehicleState(NANOSECONDS, BEGIN, 0.0, 0.0, v_x, 0.0, 0.0), STRAIGHT_PATH)

    def tick(z: Array) -> Array:
        x, sent, memory = np.split(z, [STATES, STATES + queue])
        steered = with_memory(on_path, places, memory, v_x)
        state = VehicleState(2 * NANOSECONDS, BEGIN, x[3], x[1], v_x, x[0], x[2])
        u = steered.step(at_distance(state, -steered.model.to_cg), STRAIGHT_PATH).steering
        inputs = np.append(sent, u)
        x = A @ x + B_old * inputs[0] + B_new * inputs[1]
        return np.concatenate((x, inputs[1:], steered.memory[places]))

    n = STATES + queue + len(places)
    origin = tick(np.zeros(n))
    J: Array = np.array(
        [(tick(DIFFERENCE_SIZE * row) - origin) / DIFFERENCE_SIZE for row in np.eye(n)]
    ).T
    if estimator:
        return J
    held = STATES + queue + np.flatnonzero(np.isin(places, estimator_places(controller)))
    kept = np.setdiff1d(np.arange(n), held)
    return np.asarray(J[np.ix_(kept, kept)])


def with_memory(
    controller: CertifiedController, places: Places, values: Array, v_x: float
) -> CertifiedController:
    """Return a copy of a controller in the middle of a drive.

    Args:
        controller: Controller on the path; it is not changed.
        places: Positions in its memory.
        values: Values at these positions.
        v_x: Speed at this and the last tick [m/s].
    """
    steered = copy.copy(controller)
    steered.memory = controller.memory.copy()
    if isinstance(steered, PreviewMpc):
        steered.memory[preview.LAST_SPEED], steered.memory[preview.ACCELERATION] = v_x, 0.0
        steered.memory[preview.EXPECTS] = 1.0
        steered.last_ns = 2 * NANOSECONDS - round(controller.period * NANOSECONDS)
    else:
        steered.memory[paper.HAS_LAST] = 1.0
    steered.memory[places] = values
    return steered


def spectral_radius(
    controller: CertifiedController,
    chassis: ChassisParameters,
    steering: SteeringParameters,
    v_x: float,
    *,
    estimator: bool = True,
) -> float:
    """Return the largest magnitude of the eigenvalues of `loop_matrix`."""
    J = loop_matrix(controller, chassis, steering, v_x, estimator=estimator)
    return float(np.abs(np.linalg.eigvals(J)).max())


def time_constant(radius: float, T: float) -> float:
    """Return the time constant of a mode with this magnitude per tick T; infinite from 1 on [s]."""
    if radius >= 1.0:
        return math.inf
    return -T / math.log(radius) if radius > 0.0 else 0.0


def delay_margin(
    controller: CertifiedController,
    chassis: ChassisParameters,
    steering: SteeringParameters,
    v_x: float,
) -> float:
    """Return the unknown delay at the stability limit, at most LARGEST_DELAY [s]."""
    low, high = 0.0, LARGEST_DELAY
    while high - low > 0.0005:
        middle = (low + high) / 2
        plant = replace(steering, delay=steering.delay + middle)
        stable = spectral_radius(controller, chassis, plant, v_x) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return low if not math.isclose(high, LARGEST_DELAY) else LARGEST_DELAY
