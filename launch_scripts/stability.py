"""Closed-loop eigenvalues of the preview controller: spectral radius over speed and delay.

Car and controller together are one map from tick to tick; near the straight path it is linear, and
its Jacobian is taken by differences of the very `step()` that drives.
"""

import copy
import math
from dataclasses import replace

import numpy as np

from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.path import Array
from ampc_msgs_config.path_making import make_path
from ampc_msgs_config.types import NANOSECONDS, VehicleState, at_distance
from ampc_ros.preview import PreviewMpc
from ampc_ros.preview_model import STATES, actuator_of, sampled_model

SIZE = 1e-6
"""Of the differences: small enough that no bound is active."""
PATH = make_path([(0.0, 0.0), (400.0, 0.0)])


def spectral_radius(
    controller: PreviewMpc, chassis: ChassisParameters, steering: SteeringParameters, v_x: float
) -> float:
    """Largest magnitude of the eigenvalues of car and controller at a speed.

    Args:
        controller: What steers, with its own belief.
        chassis: Of the car.
        steering: Of the car; its delay and lag may differ from the controller's belief.
        v_x: Speed [m/s].
    """
    T = controller.period
    actuator = actuator_of(steering, T)
    vehicle = tuple(vars(chassis).values())
    A, B_old, B_new, _ = sampled_model(vehicle, v_x, T, actuator)
    queue = actuator.ticks + 1
    rest = memory_of(controller)

    def tick(z: Array) -> Array:
        x, sent, memory = np.split(z, [STATES, STATES + queue])
        steered = copy.copy(controller)
        recall(steered, memory, v_x, T)
        state = VehicleState(NANOSECONDS, 100.0, x[3], x[1], v_x, x[0], x[2])
        u = steered.step(at_distance(state, -steered.to_cg), PATH).steering
        inputs = np.append(sent, u)
        x = A @ x + B_old * inputs[0] + B_new * inputs[1]
        return np.concatenate((x, inputs[1:], memory_of(steered)))

    n = STATES + queue + len(rest)
    origin = tick(np.zeros(n))
    J = np.array([(tick(SIZE * row) - origin) / SIZE for row in np.eye(n)]).T
    return float(np.abs(np.linalg.eigvals(J)).max())


def memory_of(controller: PreviewMpc) -> Array:
    """What the controller carries from tick to tick."""
    expected = np.zeros(STATES) if controller.expected is None else controller.expected
    return np.concatenate((controller.sent, [controller.before], controller.disturbance, expected))


def recall(controller: PreviewMpc, memory: Array, v_x: float, T: float) -> None:
    """Put a controller into the middle of a drive with this memory."""
    n = len(controller.sent)
    controller.sent, controller.before = memory[:n].copy(), float(memory[n])
    controller.disturbance = memory[n + 1 : n + 1 + STATES].copy()
    controller.expected = memory[n + 1 + STATES :].copy()
    controller.delta = float(controller.expected[4])
    last_ns = NANOSECONDS - round(T * NANOSECONDS)
    controller.last = VehicleState(last_ns, 100.0, 0.0, 0.0, v_x, 0.0, 0.0)
    controller.path = None


def delay_margin(
    controller: PreviewMpc, chassis: ChassisParameters, steering: SteeringParameters, v_x: float
) -> float:
    """Delay beyond the configured one at which the loop is just stable, up to 0.3 s [s]."""
    low, high = 0.0, 0.3
    while high - low > 0.0005:
        middle = (low + high) / 2
        plant = replace(steering, delay=steering.delay + middle)
        stable = spectral_radius(controller, chassis, plant, v_x) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return low if not math.isclose(high, 0.3) else 0.3
