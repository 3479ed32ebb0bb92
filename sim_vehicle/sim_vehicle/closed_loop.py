"""Simulation of a car in its scenario, and the offline closed loop."""

import time
from typing import Any, Protocol

import numpy as np

from ampc_msgs_config.frames import as_received
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedPlanner, speed_at
from ampc_msgs_config.scenarios.wind import wind_of_steps
from ampc_msgs_config.types import NANOSECONDS, Command, Plan, VehicleState
from sim_vehicle.car import Car
from sim_vehicle.parameters import Vehicle
from sim_vehicle.vehicle import CAR_V_X

STEP_NS = 5_000_000
"""Default integration step [ns]."""


class Steering(Protocol):
    """Interface of a controller that steers the car."""

    @property
    def period(self) -> float:
        """Time from one step to the next [s]."""

    def step(self, state: VehicleState, path: Path) -> Plan | Command:
        """Answer a state at `base_link`."""


class Simulation:
    """Car that drives through a scenario; its time is an integer [ns], which does not drift."""

    def __init__(
        self, vehicle: Vehicle, scenario: Scenario, step_ns: int = STEP_NS, **options: Any
    ) -> None:
        """Place the car at the start of the scenario, at the target speed there.

        Args:
            vehicle: The car.
            scenario: Path, speed profile and wind.
            step_ns: Integration step [ns].
            options: Friction, noise and rng of the `Car`.
        """
        self.start_speed = speed_at(scenario.speed, 0.0)
        self.car = Car(
            vehicle, scenario.start, self.start_speed, step=step_ns / NANOSECONDS, **options
        )
        self.vehicle, self.scenario, self.step_ns = vehicle, scenario, step_ns
        self.elapsed_ns = 0

    @property
    def finished(self) -> bool:
        """Whether the duration of the scenario has elapsed."""
        return self.elapsed_ns >= round(self.scenario.duration * NANOSECONDS)

    def set_speed(self, speed: float) -> None:
        """Let the car stand at its start, or roll, with another speed than the scenario's [m/s]."""
        self.car.state[CAR_V_X] = speed

    def wind(self) -> tuple[float, float]:
        """Return the present wind in `map` [m/s]."""
        x, y = wind_of_steps(self.scenario.wind, self.elapsed_ns, self.step_ns, 1)[0, 0]
        return float(x), float(y)

    def advance(self, steering: float, target_speed: float, period_ns: int) -> None:
        """Integrate a multiple of the step [ns] with a steering command [rad]."""
        steps = round(period_ns / self.step_ns)
        wind = wind_of_steps(self.scenario.wind, self.elapsed_ns, self.step_ns, steps)
        self.car.advance(steering, target_speed, wind)
        self.elapsed_ns += steps * self.step_ns


def drive(simulation: Simulation, controller: Steering, start_ns: int = NANOSECONDS) -> Drive:
    """Drive a scenario to its end in lock-step: state, target speed, command, motion.

    Args:
        simulation: Car at its start.
        controller: Controller of the steering.
        start_ns: Stamp of the first state [ns].

    Returns:
        States and commands, bit for bit those of the ROS nodes in lock-step.
    """
    path = simulation.scenario.path
    planner = SpeedPlanner(simulation.scenario)
    period_ns = round(controller.period * NANOSECONDS)
    states, steering, solve_time = [], [], []
    while not simulation.finished:
        state = as_received(simulation.car.measure(start_ns + simulation.elapsed_ns))
        begin = time.perf_counter()
        command = controller.step(state, path)
        solve_time.append(time.perf_counter() - begin)
        states.append(state)
        steering.append(command.steering)
        simulation.advance(command.steering, planner.target_speed(state), period_ns)
    return Drive(states, np.array(steering), np.array(solve_time))
