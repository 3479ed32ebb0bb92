"""Independent plant: the single-track drift model of `commonroad-vehicle-models`.

Althoff and Wuersching, "CommonRoad: Vehicle Models", 2020: full Magic Formula with combined slip,
wheel dynamics, steering-rate limit. A development dependency. This file adds only the steering
servo, the speed control and the force of a gust.
"""

import math
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.scenarios.scenario import Scenario, speed_at
from ampc_msgs_config.types import NANOSECONDS, VehicleState

STEP = 0.001
"""Step of the Runge-Kutta integration, small because the wheel dynamics are stiff [s]."""
SERVO_LAG = 0.1
"""Time constant of the steering servo [s]."""
SPEED_GAIN = 2.0
"""Gain of the speed control [1/s]."""
GRAVITY = 9.81
"""[m/s^2]"""


class Disturbance(NamedTuple):
    """Disturbances that the controller does not know."""

    delay: float = 0.0
    """Delay of the steering command [s]."""
    friction: float = 1.0
    """Factor on the friction of the tyres."""
    gust: tuple[float, float] = (0.0, 0.0)
    """Side force [N] and yaw moment [N m] of a gust from 4 s to 6 s, 1-cos."""
    servo_lag: float = SERVO_LAG
    """Time constant of the steering servo [s]."""


def parameters(vehicle: int, friction: float = 1.0) -> Any:
    """Return the parameters of a CommonRoad vehicle with scaled tyre friction."""
    from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

    p = _namespace(setup_vehicle_parameters(vehicle_id=vehicle))
    p.tire.p_dx1 *= friction
    p.tire.p_dy1 *= friction
    return p


def _namespace(node: Any) -> Any:
    """Convert a tree of configuration into namespaces, which are much faster to read."""
    if not hasattr(node, "items"):
        return node
    return SimpleNamespace(**{key: _namespace(value) for key, value in node.items()})


def assumed_parameters(vehicle: int) -> tuple[ChassisParameters, SteeringParameters]:
    """Return the parameters of a CommonRoad vehicle for the controller.

    The cornering stiffness of an axle is -p_ky1 times its load, half of it for one tyre.
    """
    p = parameters(vehicle)
    share = -p.tire.p_ky1 * p.m * GRAVITY / (p.a + p.b) / 2
    chassis = ChassisParameters(
        mass=p.m,
        yaw_inertia=p.I_z,
        cg_to_front_axle=p.a,
        cg_to_rear_axle=p.b,
        front_cornering_stiffness=share * p.b,
        rear_cornering_stiffness=share * p.a,
    )
    steering = SteeringParameters(max_angle=0.6, max_rate=p.steering.v_max, lag=SERVO_LAG)
    return chassis, steering


class IndependentSimulation:
    """Simulation of the plant in a scenario, with the interface of `closed_loop.Simulation`."""

    def __init__(
        self, scenario: Scenario, vehicle: int = 2, disturbance: Disturbance | None = None
    ) -> None:
        """Place the car at the start of the scenario, at its target speed."""
        from vehiclemodels.init_std import init_std

        self.disturbance = disturbance or Disturbance()
        self.p = parameters(vehicle, self.disturbance.friction)
        self.scenario, self.elapsed_ns = scenario, 0
        x, y, yaw = scenario.start
        speed = speed_at(scenario.speed, 0.0)
        self.state = np.array(init_std([x, y, 0.0, speed, yaw, 0.0, 0.0], self.p))
        self.waiting = [0.0] * round(self.disturbance.delay / STEP)
        self.car = self

    @property
    def finished(self) -> bool:
        """True if the duration of the scenario is over."""
        return self.elapsed_ns >= round(self.scenario.duration * NANOSECONDS)

    def measure(self, stamp_ns: int) -> VehicleState:
        """Return the motion at the rear axle."""
        x, y, _, v, yaw, r, beta = (float(value) for value in self.state[:7])
        centre = VehicleState(
            stamp_ns, x, y, wrap_angle(yaw), v * math.cos(beta), v * math.sin(beta), r
        )
        return at_distance(centre, -self.p.b)

    def advance(self, steering: float, target_speed: float, period_ns: int) -> None:
        """Integrate over a period [ns] with a steering angle [rad] and a target speed [m/s]."""
        for _ in range(round(period_ns / NANOSECONDS / STEP)):
            self.waiting.append(steering)
            self._step(self.waiting.pop(0), target_speed)

    def _step(self, angle: float, target_speed: float) -> None:
        """Integrate one Runge-Kutta step."""
        time = self.elapsed_ns / NANOSECONDS
        k1 = self._rate(self.state, angle, target_speed, time)
        k2 = self._rate(self.state + STEP / 2 * k1, angle, target_speed, time)
        k3 = self._rate(self.state + STEP / 2 * k2, angle, target_speed, time)
        k4 = self._rate(self.state + STEP * k3, angle, target_speed, time)
        self.state = self.state + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.elapsed_ns += round(STEP * NANOSECONDS)

    def _rate(self, state: Any, angle: float, target_speed: float, time: float) -> Any:
        from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

        x = [float(value) for value in state]
        servo = (angle - x[2]) / self.disturbance.servo_lag  # the model limits the rate
        drive = SPEED_GAIN * (target_speed - x[3])
        rate = np.array(vehicle_dynamics_std(x, [servo, drive], self.p))
        z = min(max((time - 4.0) / 2.0, 0.0), 1.0)
        force, moment = (g * (1 - math.cos(math.tau * z)) / 2 for g in self.disturbance.gust)
        rate[3] += force * math.sin(x[6]) / self.p.m
        rate[6] += force * math.cos(x[6]) / (self.p.m * max(x[3], 1.0))
        rate[5] += moment / self.p.I_z
        return rate
