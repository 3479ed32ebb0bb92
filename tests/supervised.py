"""Supervised drives with faults by time: the loop of the node, without ROS."""

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.frames import as_received
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedPlanner
from ampc_msgs_config.types import NANOSECONDS, TickRecord, VehicleState
from ampc_ros.configuration import Choices, Configuration, configuration
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.tick_policy import Action, TickPolicy
from launch_scripts.run.simulated import SimulatedDrive
from sim_vehicle.parameters import Vehicle
from tests.workshop.acceptance.trials import Trial, assumed_vehicle, plant, scenario_of, with_errors

Distortion = Callable[[VehicleState, float], VehicleState]
"""A state as odometry reports it at a time [s]."""
Fault = Callable[[float], bool]
"""Whether a fault is active at a time [s]."""


def never(_: float) -> bool:
    """No fault."""
    return False


def undistorted(state: VehicleState, _: float) -> VehicleState:
    """Return the state as it was measured."""
    return state


def between(begin: float, end: float) -> Fault:
    """Return a fault from one time until before another [s], to half a nanosecond."""
    return lambda t: begin - 1e-9 <= t < end - 1e-9


class Run(NamedTuple):
    """A finished drive and its tick records."""

    driven: SimulatedDrive
    records: list[TickRecord]
    times: list[float]
    """Times of the records [s]."""

    @property
    def rungs(self) -> list[int]:
        """Rung of each tick."""
        return [each.command.rung for each in self.records]


@cache
def made_for(car: str = "paper", controller: str = "preview", **choices: object) -> Configuration:
    """Return a configuration with a static path and the guard of test tracks."""
    free = {"guard": "track", "static_path": True, **choices}
    return configuration(Choices(controller, car, **free))  # type: ignore[arg-type]


@cache
def road_of(trial: Trial) -> tuple[Vehicle, Scenario]:
    """Return the vehicle that the controller assumes, and the scenario."""
    vehicle = assumed_vehicle(trial)
    return vehicle, scenario_of(trial, vehicle)


def supervised(
    trial: Trial,
    config: Configuration,
    blind: Fault = never,
    unsolved: Fault = never,
    supervisor: Supervisor | None = None,
    distort: Distortion = undistorted,
) -> Run:
    """Drive a trial by the tick policy of the node.

    Args:
        trial: Car and road.
        config: Configuration of the controller.
        blind: When no state arrives.
        unsolved: When every solution fails.
        supervisor: Supervisor to use; None: a new one.
        distort: What odometry makes of a measured state.
    """
    steers = supervisor or Supervisor(config)
    policy = TickPolicy(steers)
    vehicle, scenario = road_of(trial)
    simulation, planner = plant(trial, vehicle, scenario), SpeedPlanner(scenario)
    steers.take_path(scenario.points, NANOSECONDS, NANOSECONDS)
    period_ns, states, steering = round(steers.period * NANOSECONDS), [], []
    records, times = list[TickRecord](), list[float]()
    while not simulation.finished:
        t, now_ns = simulation.elapsed_ns / NANOSECONDS, NANOSECONDS + simulation.elapsed_ns
        state = as_received(simulation.car.measure(now_ns))
        if not blind(t):
            with suppress(ValueError):  # rejected after a long gap, until others confirm it
                policy.take_state(distort(state, t), now_ns)
        steers.inject_qp_fault(unsolved(t))
        if policy.on_timer(now_ns, period_ns) is Action.TICK and (record := policy.tick(now_ns)):
            records.append(record)
            times.append(t)
        states.append(state)
        steering.append(steers.steering)
        simulation.advance(steers.steering, planner.target_speed(state), period_ns)
    done = Drive(states, np.array(steering), np.zeros(len(states)))
    return Run(with_errors(done, scenario, vehicle), records, times)
