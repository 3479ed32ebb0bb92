"""The fallback chain: exact solution, slack, last plan, feed-forward, stop.

The controller, which solves a QP, is the first level. Each further level needs fewer inputs: a plan
that is at most half a second old, then a state and a path, then only the angle in force.
"""

import math

import numpy as np

from ampc_msgs_config.paths.path import MAX_PROJECTION_DISTANCE, Path
from ampc_msgs_config.types import (
    FEED_FORWARD,
    LIMITS,
    NANOSECONDS,
    OPTIMAL,
    REASONS,
    SHIFTED_PLAN,
    SLACK,
    STOP,
    Array,
    Command,
    Diagnosis,
    Plan,
    VehicleState,
)
from ampc_ros.configuration import Configuration
from ampc_ros.controller_interface import Controller
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
    PATH_ENDS,
    CONTROLLER_FAULT,
) = range(len(REASONS))

PLAN_TIME = 0.5
"""Longest use of a plan after its solution [s]."""
STOP_RATE = 0.1
"""Rate at which the wheel moves to its last planned angle while a stop is requested [rad/s]."""
NO_PLAN_NS = -(10**18)
"""Stamp that stands for 'no plan' [ns]."""
MIN_SLACK = 1e-6
"""Smallest violation of the soft lane that counts as slack [m]."""


class FallbackChain:
    """A controller and its fallbacks."""

    def __init__(self, config: Configuration, controller: Controller) -> None:
        """Create a chain at rest.

        Args:
            config: Configuration of the controller.
            controller: First level of the chain.
        """
        self.controller = controller
        self.feed_forward = FeedForward(config.chassis, config.base_link_to_cg)
        self.period_ns = round(controller.period * NANOSECONDS)
        self.plan_ticks = round(PLAN_TIME / controller.period)
        self.is_new_on_path = True
        """Whether the controller has no memory of its place on the path."""
        self.qp_fault = False
        """Fault injection: every solution counts as failed."""
        self.fault = ""
        """Exception of the controller in the newest step, in one line; empty: there was none."""
        self.restart(0.0)

    def restart(self, steering: float) -> None:
        """Forget all earlier steps; `steering` is the angle in force [rad]."""
        self.controller.reset(steering)
        self.is_new_on_path = True
        self.feed_forward.reset()
        self.plan = Plan(0, steering, 0.0, Diagnosis())
        self.angles: Array = np.array([steering])
        self.planned_ns = NO_PLAN_NS

    def answer(self, state: VehicleState, path: Path, in_force: float, now_ns: int) -> Command:
        """Return the command for a new state from the first level that is available.

        Args:
            state: State at `base_link`.
            path: Reference path.
            in_force: Angle commanded last [rad].
            now_ns: Time of the command [ns].
        """
        plan = self.plan = self._step(state, path, in_force)
        reasons = (CONTROLLER_FAULT,) * 2 if self.fault else (QP_NOT_SOLVED, PLAN_USED_UP)
        if reason := refusal(state, plan.diagnosis):
            return self.stop(reason, in_force, now_ns)
        if plan.diagnosis.converged:
            self.angles = np.array([plan.steering]) if plan.angles is None else plan.angles
            self.planned_ns = now_ns
            if plan.diagnosis.slack > MIN_SLACK:
                return self._command(SLACK, SLACK_IN_USE, plan.steering, in_force)
            return self._command(OPTIMAL, NO_REASON, plan.steering, in_force)
        if self._is_plan_usable(now_ns):
            return self._command(SHIFTED_PLAN, reasons[0], self.planned(now_ns), in_force)
        is_standing = state.v_x < HOLD_BELOW
        steering = in_force if is_standing else self.feed_forward.steering(state, path)
        self.angles = np.array([steering])
        return self._command(FEED_FORWARD, reasons[1], steering, in_force)

    def _step(self, state: VehicleState, path: Path, in_force: float) -> Plan:
        """Step the controller; an exception or a non-finite plan counts as not solved.

        The controller is then reset.
        """
        self.fault = ""
        try:
            plan, self.is_new_on_path = self.controller.step(state, path), False
            is_valid = is_finite(plan)
        except Exception as error:  # a controller of a user may raise anything
            self.fault = f"the controller raised {type(error).__name__}: {error}"
            plan, is_valid = Plan(state.stamp_ns, in_force, 0.0, Diagnosis()), False
        if not is_valid:
            self.controller.reset(in_force)
            self.is_new_on_path = True
            plan = plan._replace(prediction=None, angles=None)
        elif not self.qp_fault:
            return plan
        return plan._replace(diagnosis=plan.diagnosis._replace(converged=0.0))

    def _command(self, rung: int, reason: int, steering: float, in_force: float) -> Command:
        rate = (steering - in_force) / self.controller.period
        none = LIMITS.index("none")
        return Command(self.plan.stamp_ns, steering, rate, steering, rung, reason, none, self.plan)

    def advance(self, reason: int, in_force: float, now_ns: int) -> Command:
        """Return the command without a new state: from the last plan while usable, else a stop."""
        if self._is_plan_usable(now_ns):
            return self._command(SHIFTED_PLAN, reason, self.planned(now_ns), in_force)
        return self.stop(reason, in_force, now_ns)

    def stop(self, reason: int, in_force: float, now_ns: int) -> Command:
        """Return the command for a stop: turn slowly to the last planned angle.

        Note:
            The planned angle advances along the plan. Holding the last command instead, in the
            middle of a lane change, leaves the lane: 2 s without a state at 9 m/s cost 3.2 m,
            along the plan 0.4 m.
        """
        step = STOP_RATE * self.controller.period
        steering = min(max(self.planned(now_ns), in_force - step), in_force + step)
        return self._command(STOP, reason, steering, in_force)

    def planned(self, now_ns: int) -> float:
        """Return the planned angle of this time; the last angle of the plan is held [rad]."""
        return float(self.angles[min(self._ticks_since_plan(now_ns), len(self.angles) - 1)])

    def planned_from(self, now_ns: int) -> list[float]:
        """Return the planned angles from this time on, at least one [rad]."""
        first = min(self._ticks_since_plan(now_ns), len(self.angles) - 1)
        return [float(angle) for angle in self.angles[first:]]

    def _is_plan_usable(self, now_ns: int) -> bool:
        return self._ticks_since_plan(now_ns) <= self.plan_ticks

    def _ticks_since_plan(self, now_ns: int) -> int:
        """Return the ticks since the last solution by time: not every tick gives a command."""
        return max(round((now_ns - self.planned_ns) / self.period_ns), 0)


def is_finite(plan: Plan) -> bool:
    """Return whether angle, planned angles and prediction are finite."""
    arrays = (each for each in (plan.angles, plan.prediction) if each is not None)
    return math.isfinite(plan.steering) and all(np.isfinite(each).all() for each in arrays)


def refusal(state: VehicleState, diagnosis: Diagnosis) -> int:
    """Return the reason why no steering can follow the path, or NO_REASON."""
    if state.v_x < REVERSE_BELOW:
        return BACKWARDS
    if state.v_x >= HOLD_BELOW and abs(diagnosis.heading_error) > math.pi / 2:
        return AGAINST_PATH
    return OFF_PATH if abs(diagnosis.cross_track_error) > MAX_PROJECTION_DISTANCE else NO_REASON
