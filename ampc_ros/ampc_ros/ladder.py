"""The ladder of fall-backs: exact solution, slack, last plan, feed-forward, stop.

A controller that solves its programme stands on top. Each rung below needs less: a plan that is
half a second old at most, then a state and a path, then nothing but the angle in force.
"""

import math
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.path import LOST, Array, Path
from ampc_msgs_config.types import (
    FEED_FORWARD,
    OPTIMAL,
    REASONS,
    REVERSE,
    SHIFTED_PLAN,
    SLACK,
    STOP,
    WRONG_WAY,
    Command,
    Diagnosis,
    VehicleState,
)
from ampc_ros.configuration import Configuration
from ampc_ros.controller import Controller
from ampc_ros.feed_forward import FeedForward

(
    NO_REASON,
    SLACK_IN_USE,
    QP_NOT_SOLVED,
    PLAN_USED_UP,
    STATE_LATE,
    STATE_LOST,
    PATH_LOST,
    OFF_PATH,
    AGAINST_PATH,
    BACKWARDS,
) = range(len(REASONS))

PLAN_TIME = 0.5
"""How long the last plan is good enough [s]."""
STOP_RATE = 0.1
"""Rate at which the wheel goes to its last safe angle while the car is to stop [rad/s]."""
MIN_SLACK = 1e-6
"""Violation of the soft lane that counts as one [m]."""


class Answer(NamedTuple):
    """What a rung says."""

    rung: int
    """Index in RUNGS."""
    reason: int
    """Index in REASONS."""
    steering: float
    """[rad]."""
    command: Command
    """What the controller said last."""
    stepped: bool = True
    """Whether it said so in this tick."""


class Ladder:
    """A controller with what stands below it."""

    def __init__(self, made: Configuration, controller: Controller) -> None:
        """Stand at the top, at rest.

        Args:
            made: What the controller is made of.
            controller: On top.
        """
        self.controller = controller
        self.feed_forward = FeedForward(made.chassis, made.base_link_to_cg)
        self.plan_ticks = round(PLAN_TIME / controller.period)
        self.qp_fault = False
        """Makes every solution a failed one: a fault to be injected."""
        self.restart(0.0)

    def restart(self, steering: float) -> None:
        """Forget all earlier steps; the angle in force is given [rad]."""
        self.controller.reset(steering)
        self.command = Command(0, steering, 0.0, Diagnosis())
        self.plan: Array = np.array([steering])
        self.shifted = self.plan_ticks  # there is no plan yet
        self.safe_steering = steering

    def answer(self, state: VehicleState, path: Path, in_force: float) -> Answer:
        """Answer a new state from the highest rung that holds.

        Args:
            state: At `base_link`.
            path: The reference.
            in_force: Angle commanded last [rad].
        """
        command = self.controller.step(state, path)
        if not math.isfinite(command.steering):
            self.controller.reset(in_force)
        if self.qp_fault or not math.isfinite(command.steering):
            diagnosis = command.diagnosis._replace(converged=0.0)
            command = command._replace(diagnosis=diagnosis)
        self.command = command
        if reason := refusal(command.diagnosis):
            return self.stop(reason, in_force)._replace(stepped=True)
        if command.diagnosis.converged:
            return self._solved(command)
        if self.shifted < self.plan_ticks:
            return self.shift(QP_NOT_SOLVED)._replace(stepped=True)
        self.safe_steering = self.feed_forward.steering(state, path)
        return Answer(FEED_FORWARD, PLAN_USED_UP, self.safe_steering, command)

    def _solved(self, command: Command) -> Answer:
        """Take the solution, and keep its plan."""
        self.plan = np.array([command.steering]) if command.plan is None else command.plan
        self.shifted, self.safe_steering = 0, command.steering
        if command.diagnosis.slack > MIN_SLACK:
            return Answer(SLACK, SLACK_IN_USE, command.steering, command)
        return Answer(OPTIMAL, NO_REASON, command.steering, command)

    def shift(self, reason: int) -> Answer:
        """Go on by the last plan, a tick later; its end is held."""
        self.shifted += 1
        steering = float(self.plan[min(self.shifted, len(self.plan) - 1)])
        return Answer(SHIFTED_PLAN, reason, steering, self.command, stepped=False)

    def stop(self, reason: int, in_force: float) -> Answer:
        """Turn the wheel slowly to the last angle that came from a state and a path."""
        step = STOP_RATE * self.controller.period
        steering = min(max(self.safe_steering, in_force - step), in_force + step)
        return Answer(STOP, reason, steering, self.command, stepped=False)


def refusal(diagnosis: Diagnosis) -> int:
    """Give the reason for which no steering can follow the path, or NO_REASON."""
    if diagnosis.mode == REVERSE:
        return BACKWARDS
    if diagnosis.mode == WRONG_WAY:
        return AGAINST_PATH
    return OFF_PATH if abs(diagnosis.cross_track_error) > LOST else NO_REASON
