"""The ladder of fall-backs: exact solution, slack, last plan, feed-forward, stop.

A controller that solves its programme stands on top. Each rung below needs less: a plan that is
half a second old at most, then a state and a path, then nothing but the angle in force.
"""

import math
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.paths.path import MAX_PROJECTION_DISTANCE, Path
from ampc_msgs_config.types import (
    FEED_FORWARD,
    NANOSECONDS,
    OPTIMAL,
    REASONS,
    SHIFTED_PLAN,
    SLACK,
    STOP,
    Array,
    Command,
    Diagnosis,
    VehicleState,
)
from ampc_ros.configuration import Configuration
from ampc_ros.controller import Controller
from ampc_ros.mpc.tick_result import HOLD_BELOW, REVERSE_BELOW
from ampc_ros.supervision.feed_forward import FeedForward

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
NO_PLAN_NS = -(10**18)
"""Time of a plan that there is not [ns]."""
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

    def __init__(self, config: Configuration, controller: Controller) -> None:
        """Stand at the top, at rest.

        Args:
            config: What the controller is made of.
            controller: On top.
        """
        self.controller = controller
        self.feed_forward = FeedForward(config.chassis, config.base_link_to_cg)
        self.period_ns = round(controller.period * NANOSECONDS)
        self.plan_ticks = round(PLAN_TIME / controller.period)
        self.qp_fault = False
        """Makes every solution a failed one: a fault to be injected."""
        self.restart(0.0)

    def restart(self, steering: float) -> None:
        """Forget all earlier steps; the angle in force is given [rad]."""
        self.controller.reset(steering)
        self.feed_forward.reset()
        self.command = Command(0, steering, 0.0, Diagnosis())
        self.plan: Array = np.array([steering])
        self.planned_ns = NO_PLAN_NS

    def answer(self, state: VehicleState, path: Path, in_force: float, now_ns: int) -> Answer:
        """Answer a new state from the highest rung that holds.

        Args:
            state: At `base_link`.
            path: The reference.
            in_force: Angle commanded last [rad].
            now_ns: Time of the command [ns].
        """
        command = self.command = self._step(state, path, in_force)
        if reason := refusal(state, command.diagnosis):
            return self.stop(reason, in_force, now_ns)._replace(stepped=True)
        if command.diagnosis.converged:
            return self._solved(command, now_ns)
        if self.is_plan_good(now_ns):
            return self._shift(QP_NOT_SOLVED, now_ns)._replace(stepped=True)
        stands = state.v_x < HOLD_BELOW
        steering = in_force if stands else self.feed_forward.steering(state, path)
        self.plan = np.array([steering])
        return Answer(FEED_FORWARD, PLAN_USED_UP, steering, command)

    def _step(self, state: VehicleState, path: Path, in_force: float) -> Command:
        """Ask the controller; what is no number counts as not solved, and is forgotten."""
        command = self.controller.step(state, path)
        if not is_finite(command):
            self.controller.reset(in_force)
            command = command._replace(prediction=None, plan=None)
        elif not self.qp_fault:
            return command
        return command._replace(diagnosis=command.diagnosis._replace(converged=0.0))

    def _solved(self, command: Command, now_ns: int) -> Answer:
        """Take the solution, and keep its plan."""
        self.plan = np.array([command.steering]) if command.plan is None else command.plan
        self.planned_ns = now_ns
        if command.diagnosis.slack > MIN_SLACK:
            return Answer(SLACK, SLACK_IN_USE, command.steering, command)
        return Answer(OPTIMAL, NO_REASON, command.steering, command)

    def go_on(self, reason: int, in_force: float, now_ns: int) -> Answer:
        """Command without a new state: by the last plan, or to a stop where that is used up."""
        if self.is_plan_good(now_ns):
            return self._shift(reason, now_ns)
        return self.stop(reason, in_force, now_ns)

    def is_plan_good(self, now_ns: int) -> bool:
        """Whether the last plan still holds."""
        return self._ticks_since_plan(now_ns) <= self.plan_ticks

    def planned(self, now_ns: int) -> float:
        """Angle that was planned last for now; the end of the plan is held [rad]."""
        return float(self.plan[min(self._ticks_since_plan(now_ns), len(self.plan) - 1)])

    def _ticks_since_plan(self, now_ns: int) -> int:
        """Ticks since the last solution, by time: not every tick without a state commands."""
        return max(round((now_ns - self.planned_ns) / self.period_ns), 0)

    def _shift(self, reason: int, now_ns: int) -> Answer:
        """Go on by the last plan."""
        return Answer(SHIFTED_PLAN, reason, self.planned(now_ns), self.command, stepped=False)

    def stop(self, reason: int, in_force: float, now_ns: int) -> Answer:
        """Turn the wheel slowly to the last angle that came from a state and a path.

        Note:
            That angle goes on along the plan, too. To stay where the last command was, in the
            middle of a lane change, leaves the lane: blind for 2 s at 9 m/s by 3.2 m, so by 0.4 m.
        """
        step = STOP_RATE * self.controller.period
        steering = min(max(self.planned(now_ns), in_force - step), in_force + step)
        return Answer(STOP, reason, steering, self.command, stepped=False)


def is_finite(command: Command) -> bool:
    """Whether angle, plan and prediction are numbers."""
    arrays = (each for each in (command.plan, command.prediction) if each is not None)
    return math.isfinite(command.steering) and all(np.isfinite(each).all() for each in arrays)


def refusal(state: VehicleState, diagnosis: Diagnosis) -> int:
    """Give the reason for which no steering can follow the path, or NO_REASON."""
    if state.v_x < REVERSE_BELOW:
        return BACKWARDS
    if state.v_x >= HOLD_BELOW and abs(diagnosis.heading_error) > math.pi / 2:
        return AGAINST_PATH
    return OFF_PATH if abs(diagnosis.cross_track_error) > MAX_PROJECTION_DISTANCE else NO_REASON
