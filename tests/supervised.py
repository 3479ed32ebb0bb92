"""Drives under supervision, with faults by time: the loop of the node, without ROS."""

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.scenarios.scenario import SpeedPlanner
from ampc_msgs_config.types import (
    NANOSECONDS,
    Supervision,
    as_received,
)
from ampc_ros.configuration import Choices, Configuration, configuration
from ampc_ros.supervision.supervisor import Decision, Supervisor
from launch_scripts.run.simulated import SimulatedDrive
from tests.workshop.acceptance.trials import Trial, assumed_vehicle, plant, scenario_of, with_errors

Fault = Callable[[float], bool]
"""Whether there is one at a time [s]."""


def never(_: float) -> bool:
    """No fault."""
    return False


def between(begin: float, end: float) -> Fault:
    """A fault from one time until before another [s]; half a nanosecond does not matter."""
    return lambda t: begin - 1e-9 <= t < end - 1e-9


class Run(NamedTuple):
    """A finished drive, and what was decided in it."""

    driven: SimulatedDrive
    decisions: list[Decision]
    times: list[float]
    """Of the decisions [s]."""

    @property
    def told(self) -> list[Supervision]:
        """What became of each answer."""
        return [decision.supervision for decision in self.decisions]

    @property
    def rungs(self) -> list[int]:
        """Rung of each decision."""
        return [int(each.rung) for each in self.told]


def made_for(car: str = "paper", controller: str = "preview", **choices: object) -> Configuration:
    """Give a configuration with the path declared static and the guard of test tracks."""
    free = {"guard": "track", "static_path": True, **choices}
    return configuration(Choices(controller, car, **free))  # type: ignore[arg-type]


def supervised(
    trial: Trial,
    config: Configuration,
    blind: Fault = never,
    unsolved: Fault = never,
    supervisor: Supervisor | None = None,
) -> Run:
    """Drive a trial as the node does: tick after tick, a command for a new state or a late one.

    Args:
        trial: Car and road.
        config: What the controller is made of.
        blind: When no state arrives.
        unsolved: When every solution fails.
        supervisor: In place of a new one.
    """
    steers = supervisor or Supervisor(config)
    vehicle = assumed_vehicle(trial)
    scenario = scenario_of(trial, vehicle)
    simulation, planner = plant(trial, vehicle, scenario), SpeedPlanner(scenario)
    steers.take_path(scenario.points, NANOSECONDS, NANOSECONDS)
    period_ns, states, steering = round(steers.period * NANOSECONDS), [], []
    decisions, times, answered = [], [], -1
    while not simulation.finished:
        t, now_ns = simulation.elapsed_ns / NANOSECONDS, NANOSECONDS + simulation.elapsed_ns
        state = as_received(simulation.car.measure(now_ns))
        if not blind(t):
            with suppress(ValueError):  # refused after a long gap, until others confirm it
                steers.take_state(state, now_ns)
        steers.ladder.qp_fault = unsolved(t)
        if steers.newest_ns != answered or steers.is_state_late(now_ns):
            decision = steers.tick(now_ns)
            if decision:
                answered = steers.newest_ns
                decisions.append(decision)
                times.append(t)
        states.append(state)
        steering.append(steers.steering)
        simulation.advance(steers.steering, planner.target_speed(state), period_ns)
    done = Drive(states, np.array(steering), np.zeros(len(states)))
    return Run(with_errors(done, scenario, vehicle), decisions, times)
