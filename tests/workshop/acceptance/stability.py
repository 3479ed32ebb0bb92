"""Closed-loop eigenvalues of the preview controller: spectral radius over speed and delay.

Car and controller form one map from tick to tick, which is linear near a straight path. Its
Jacobian is computed by differences of the `step()` of the controller.
"""

import copy
import math
from dataclasses import replace

import numpy as np

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.internal_model import actuator_of
from ampc_ros.mpc.model import STATES
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.preview.model import SampledModel, sample_model
from ampc_ros.preview.tick import BEFORE, EXPECTS, LAST_SPEED

SIZE = 1e-6
"""Size of the differences, small enough that no bound is active."""
PATH = make_path([(0.0, 0.0), (400.0, 0.0)])


def spectral_radius(
    controller: PreviewMpc, chassis: ChassisParameters, steering: SteeringParameters, v_x: float
) -> float:
    """Return the largest magnitude of the eigenvalues of car and controller at a speed.

    Args:
        controller: Controller with its internal model.
        chassis: Chassis of the car.
        steering: Steering of the car; delay and lag may differ from the internal model.
        v_x: Speed [m/s].
    """
    T = controller.period
    actuator = actuator_of(steering, T)
    vehicle = tuple(vars(chassis).values())
    A, B_old, B_new, D = np.zeros((STATES, STATES)), *np.zeros((3, STATES))
    sample_model(vehicle, v_x, T, actuator, SampledModel(A, B_old, B_new, D), make_scratch(400))
    queue, rest = actuator.ticks + 1, len(controller.memory) - BEFORE

    def tick(z: Array) -> Array:
        x, sent, memory = np.split(z, [STATES, STATES + queue])
        steered = with_memory(controller, memory, v_x)
        state = VehicleState(NANOSECONDS, 100.0, x[3], x[1], v_x, x[0], x[2])
        u = steered.step(at_distance(state, -steered.model.to_cg), PATH).steering
        inputs = np.append(sent, u)
        x = A @ x + B_old * inputs[0] + B_new * inputs[1]
        return np.concatenate((x, inputs[1:], steered.memory[BEFORE:]))

    n = STATES + queue + rest
    origin = tick(np.zeros(n))
    J = np.array([(tick(SIZE * row) - origin) / SIZE for row in np.eye(n)]).T
    return float(np.abs(np.linalg.eigvals(J)).max())


def with_memory(controller: PreviewMpc, memory: Array, v_x: float) -> PreviewMpc:
    """Return a copy of a controller in the middle of a drive.

    Args:
        controller: Controller; it is not changed.
        memory: Its state from index BEFORE on.
        v_x: Speed at this and the last tick [m/s].
    """
    steered = copy.copy(controller)
    steered.memory, steered.path = controller.memory.copy(), None
    steered.memory[LAST_SPEED], steered.memory[EXPECTS] = v_x, 1.0
    steered.memory[BEFORE:] = memory
    steered.last_ns = NANOSECONDS - round(controller.period * NANOSECONDS)
    return steered


def delay_margin(
    controller: PreviewMpc, chassis: ChassisParameters, steering: SteeringParameters, v_x: float
) -> float:
    """Return the unknown delay at the stability limit, at most 0.3 s [s]."""
    low, high = 0.0, 0.3
    while high - low > 0.0005:
        middle = (low + high) / 2
        plant = replace(steering, delay=steering.delay + middle)
        stable = spectral_radius(controller, chassis, plant, v_x) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return low if not math.isclose(high, 0.3) else 0.3
