"""Compiled independent plant: `IndependentSimulation` with the same equations, ten times as fast.

The functions of `commonroad-vehicle-models` are compiled unchanged; only their parameters become
named tuples, which compiled code can read.
"""

import math
from collections import namedtuple
from functools import cache
from types import FunctionType, ModuleType
from typing import Any

import numba
import numpy as np

from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import NANOSECONDS, Array
from tests.workshop.acceptance.independent_plant import (
    SPEED_GAIN,
    STEP,
    Disturbance,
    IndependentSimulation,
)


def compiled_copy(function: Any, **replaced: Any) -> Any:
    """Compile a Python function with some of its globals replaced."""
    names = {**function.__globals__, **replaced}
    copy = FunctionType(function.__code__, names, function.__name__)
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    return numba.njit(error_model="numpy")(copy)


@cache
def compiled_rate() -> Any:
    """Return the compiled right-hand side of the single-track drift model."""
    from vehiclemodels import vehicle_dynamics_std as std
    from vehiclemodels.utils import acceleration_constraints as longitudinal
    from vehiclemodels.utils import steering_constraints as lateral
    from vehiclemodels.utils import tire_model
    from vehiclemodels.utils import vehicle_dynamics_ks_cog as kinematic

    tyre: Any = ModuleType("compiled_tire_model")
    sign = compiled_copy(tire_model.sign)
    for name in dir(tire_model):
        if name.startswith("formula"):
            setattr(tyre, name, compiled_copy(getattr(tire_model, name), sign=sign))
    limits = {
        "steering_constraints": compiled_copy(lateral.steering_constraints),
        "acceleration_constraints": compiled_copy(longitudinal.acceleration_constraints),
    }
    slow = compiled_copy(kinematic.vehicle_dynamics_ks_cog, **limits)
    return compiled_copy(
        std.vehicle_dynamics_std, tire_model=tyre, vehicle_dynamics_ks_cog=slow, **limits
    )


@cache
def compiled_steps() -> Any:
    """Return the compiled integration of several steps, see `IndependentSimulation._step`."""
    right_hand_side = compiled_rate()
    stages = np.array([[0.0, 1.0], [0.5, 2.0], [0.5, 2.0], [1.0, 1.0]])  # Runge-Kutta

    @numba.njit(error_model="numpy")
    def rate(state: Any, angle: Any, target: Any, time: Any, disturbance: Any, p: Any) -> Any:
        x, gust = state.copy(), disturbance.gust
        inputs = ((angle - x[2]) / disturbance.servo_lag, SPEED_GAIN * (target - x[3]))
        dx = np.array(right_hand_side(x, inputs, p))
        z = min(max((time - 4.0) / 2.0, 0.0), 1.0)
        shape = (1 - math.cos(math.tau * z)) / 2
        force, moment = gust[0] * shape, gust[1] * shape
        dx[3] += force * math.sin(x[6]) / p.m
        dx[6] += force * math.cos(x[6]) / (p.m * max(x[3], 1.0))
        dx[5] += moment / p.I_z
        return dx

    @numba.njit(error_model="numpy")
    def steps(state: Any, angles: Any, target: Any, begin: Any, disturbance: Any, p: Any) -> Any:
        for i, angle in enumerate(angles):
            time = begin + i * STEP
            total, k = np.zeros(len(state)), np.zeros(len(state))
            for share, weight in stages:
                k = rate(state + share * STEP * k, angle, target, time, disturbance, p)
                total = total + weight * k
            state = state + STEP / 6 * total
        return state

    return steps


def named(node: Any) -> Any:
    """Convert a tree of parameters into named tuples of numbers."""
    values = {key: value for key, value in vars(node).items() if value is not None}
    values = {key: named(v) if hasattr(v, "__dict__") else float(v) for key, v in values.items()}
    return _tuple_class(tuple(values))(**values)


@cache
def _tuple_class(fields: tuple[str, ...]) -> Any:
    """Return one class for equal fields, so that compiled code is compiled once."""
    return namedtuple("Parameters", fields)


class FastSimulation(IndependentSimulation):
    """The independent plant, compiled."""

    def __init__(
        self, scenario: Scenario, vehicle: int = 2, disturbance: Disturbance | None = None
    ) -> None:
        """Place the car at the start of the scenario, at its target speed."""
        super().__init__(scenario, vehicle, disturbance)
        self.state: Array = np.array(self.state, dtype=float)
        self.numbers, self.steps = named(self.p), compiled_steps()

    def advance(self, steering: float, target_speed: float, period_ns: int) -> None:
        """Integrate over a period [ns] with a steering angle [rad] and a target speed [m/s]."""
        count = round(period_ns / NANOSECONDS / STEP)
        self.waiting += [steering] * count
        angles, self.waiting = np.array(self.waiting[:count]), self.waiting[count:]
        begin, disturbance = self.elapsed_ns / NANOSECONDS, self.disturbance
        self.state = self.steps(self.state, angles, target_speed, begin, disturbance, self.numbers)
        self.elapsed_ns += round(STEP * NANOSECONDS) * count
