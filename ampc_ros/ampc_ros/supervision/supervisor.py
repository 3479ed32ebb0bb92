"""From inputs as they come to a command that may be sent: checks, time-outs, ladder, guard.

The same object steers over ROS, in the offline loop and in a replay: all times are arguments.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import LIMITS, STOP, Array, Command, Supervision, VehicleState
from ampc_ros.configuration import Configuration
from ampc_ros.controller import Controller, build_controller
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.supervision.checks import StateFilter, check_path
from ampc_ros.supervision.guard import Guard, Guarded
from ampc_ros.supervision.ladder import NO_REASON, PATH_LOST, STATE_LATE, STATE_LOST, Answer, Ladder
from ampc_ros.supervision.received import Received


class Decision(NamedTuple):
    """One tick: what to command, and how that came about."""

    command: Command
    supervision: Supervision


class Supervisor:
    """A controller between its inputs and the steering."""

    def __init__(
        self, config: Configuration, source: object = "gain table", number: int = 1
    ) -> None:
        """Make controller, ladder and guard, at rest.

        Args:
            config: What all is made of.
            source: Of the gains, for the message.
            number: Of this configuration; each further one counts on.

        Raises:
            ValueError: The gains make the controller's problem numerically singular.
        """
        self.filter = StateFilter()
        self.number, self.resets = number - 1, 0
        self.stop_requested = False
        self.state: Received[VehicleState] | None = None
        self.path: Received[Path] | None = None
        self.points: Array | None = None
        self.measured = math.nan
        self.clips = dict.fromkeys(LIMITS[1:], 0)
        """How often the guard clipped, under all configurations."""
        self._install(config, build_controller(config, source), 0.0)

    def reconfigure(self, config: Configuration, source: object = "gain table") -> None:
        """Go on with another configuration from the angle in force; a wrong one changes nothing.

        Raises:
            ValueError: The gains make the controller's problem numerically singular, or it cannot
                take the path in use.
        """
        controller = build_controller(config, source)
        if self.path:
            controller.check(self.path.value)
        before, fault = self.ladder.controller, self.ladder.qp_fault
        self._install(config, controller, self.steering)
        if isinstance(controller, PreviewMpc) and isinstance(before, PreviewMpc):
            controller.inherit(before)
        self.ladder.qp_fault = fault

    def _install(self, config: Configuration, controller: Controller, steering: float) -> None:
        self.config, self.number = config, self.number + 1
        self.period = controller.period
        self.guard = Guard(config.guard, config.chassis, controller.period)
        self.guard.steering, self.guard.count = steering, self.clips
        self.ladder = Ladder(config, controller)
        self.ladder.restart(steering)

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""
        return self.guard.steering

    @property
    def is_ready(self) -> bool:
        """Whether there are a state and a path to steer by."""
        return self.state is not None and self.path is not None

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest state; -1: there is none [ns]."""
        return self.state.stamp_ns if self.state else -1

    def restart(self, steering: float | None = None) -> None:
        """Let the controller start anew, from the angle in force or from another one [rad]."""
        self.resets += 1
        self.measured = math.nan
        if steering is not None:
            self.guard.reset(steering)
        self.ladder.restart(self.steering)

    def take_state(self, state: VehicleState, now_ns: int) -> None:
        """Take a state as the newest one; it starts the controller anew where time or place jump.

        Raises:
            ValueError: The state contradicts those before it; the last valid one is kept.
        """
        verdict = self.filter.accept(state, now_ns)
        if not verdict.accepted:
            raise ValueError(verdict.reason)
        if verdict.reset:
            self.start_anew_at(state)
            if self.path:  # one from before the clock went back grows old from now on
                self.path = self.path._replace(arrival_ns=min(self.path.arrival_ns, now_ns))
        self.state = Received(state, state.stamp_ns, now_ns)

    def start_anew_at(self, state: VehicleState) -> None:
        """Start the controller anew where the car or its clock has jumped to.

        Where simulated time goes back, the simulated car is at its start again: wheels straight.
        """
        goes_back = self.state is not None and state.stamp_ns < self.state.stamp_ns
        self.restart(0.0 if goes_back and self.config.simulated_time else None)

    def take_path(self, points: ArrayLike, stamp_ns: int, now_ns: int) -> None:
        """Take a path (n, 2) [m]; one that is in use already is only renewed.

        Raises:
            ValueError: It cannot be driven; the last valid path is kept.
        """
        points = np.asarray(points, dtype=float)
        if self.path and self.points is not None and np.array_equal(points, self.points):
            self.path = Received(self.path.value, stamp_ns, now_ns)
            return
        path = check_path(points, self.config.chassis, self.config.max_angle)
        self.follow(path, stamp_ns, now_ns)
        self.points = points

    def follow(self, path: Path, stamp_ns: int, now_ns: int) -> None:
        """Take a path that has been made of points already.

        Raises:
            ValueError: The controller cannot follow it; the last valid path is kept.
        """
        self.ladder.controller.check(path)
        self.path, self.points = Received(path, stamp_ns, now_ns), None

    def correct(self, steering: float) -> None:
        """Go on from another angle than the one commanded last [rad]."""
        if steering != self.steering:
            self.guard.reset(steering)
            self.ladder.controller.take_over(self.steering, stepped=True)

    def take_steering(self, angle: float) -> None:
        """Take a measured road-wheel angle, which the next tick uses [rad]."""
        self.measured = angle

    def step(self, state: VehicleState, path: Path) -> Command:
        """Answer a state at once, as controllers do: nothing is late in lock-step.

        Raises:
            ValueError: See `take_state` and `follow`.
        """
        now_ns = state.stamp_ns
        if self.path is None or self.path.value is not path:
            self.follow(path, now_ns, now_ns)
        self.path = Received(path, now_ns, now_ns)
        self.take_state(state, now_ns)
        decision = self.tick(now_ns)
        assert decision is not None
        return decision.command

    def tick(self, now_ns: int) -> Decision | None:
        """Decide what to command now; nothing before the first valid state and path.

        Args:
            now_ns: Time of the node's clock [ns].
        """
        state, path = self.state, self.path
        if state is None or path is None:
            return None
        measured = self._use_measured()
        answer = self._answer(state, path.value, now_ns)
        guarded = self._guard(answer, state.value.v_x, measured)
        self.stop_requested |= answer.rung == STOP or self.is_path_lost(now_ns)
        command = answer.command._replace(
            stamp_ns=state.stamp_ns,
            steering=guarded.steering,
            steering_rate=guarded.steering_rate,
        )
        ages = (*state.ages(now_ns), *path.ages(now_ns))
        return Decision(command, self._told(answer, guarded, ages, measured))

    def _use_measured(self) -> float:
        """Tell the controller where the steering is, once for each measurement."""
        measured, self.measured = self.measured, math.nan
        controller = self.ladder.controller
        if isinstance(controller, PreviewMpc) and not math.isnan(measured):
            controller.observe_steering(measured)
        return measured

    def _answer(self, state: Received[VehicleState], path: Path, now_ns: int) -> Answer:
        """Choose the rung by the age of state and path."""
        if state.is_older(now_ns, self.config.settings.state_lost):
            return self.ladder.stop(STATE_LOST, self.steering, now_ns)
        if self.is_state_late(now_ns):
            return self.ladder.go_on(STATE_LATE, self.steering, now_ns)
        answer = self.ladder.answer(state.value, path, self.steering, now_ns)
        if answer.reason == NO_REASON and self.is_path_lost(now_ns):
            return answer._replace(reason=PATH_LOST)
        return answer

    def _guard(self, answer: Answer, v_x: float, measured: float) -> Guarded:
        """Keep an answer to the limits, and tell the controller what is commanded instead."""
        rate = (answer.steering - self.steering) / self.period
        known = None if math.isnan(measured) else measured
        guarded = self.guard.step(answer.steering, rate, v_x, known)
        controller = self.ladder.controller
        if not answer.stepped or guarded.steering != controller.steering:
            controller.take_over(guarded.steering, stepped=answer.stepped)
        return guarded

    def is_state_late(self, now_ns: int) -> bool:
        """Whether the newest state is too old to wait for another one."""
        return self.state is not None and self.state.is_older(
            now_ns, self.config.settings.state_late
        )

    def is_path_lost(self, now_ns: int) -> bool:
        """Whether the path is too old to be followed without a stop."""
        if self.path is None or self.config.static_path:
            return False
        return self.path.is_older(now_ns, self.config.settings.path_lost)

    def _told(
        self,
        answer: Answer,
        guarded: Guarded,
        ages: tuple[float, float, float, float],
        measured: float,
    ) -> Supervision:
        """Say what became of an answer."""
        return Supervision(
            guarded.steering,
            answer.steering,
            answer.rung,
            answer.reason,
            guarded.limit,
            *ages,
            measured,
            float(self.stop_requested),
            self.resets,
            self.number,
            float(self.ladder.qp_fault),
        )
