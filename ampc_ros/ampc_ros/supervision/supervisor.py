"""From inputs to a safe steering command: input checks, timeouts, fallback chain, guard.

The same object is used over ROS, in the offline loop and in a replay: all times are arguments.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import understeer_gradient
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import (
    LIMITS,
    NANOSECONDS,
    OPTIMAL,
    SHIFTED_PLAN,
    STOP,
    Array,
    Command,
    TickRecord,
    VehicleState,
)
from ampc_ros.assumed_car import AssumedCar
from ampc_ros.configuration import Configuration
from ampc_ros.controller import build_controller
from ampc_ros.controller_interface import Controller
from ampc_ros.estimation.adaptation import Adaptation
from ampc_ros.estimation.present_state import PresentState
from ampc_ros.supervision.checks import StateFilter, check_path
from ampc_ros.supervision.fallback import (
    CONTROLLER_FAULT,
    NO_REASON,
    OFF_PATH,
    PATH_ENDS,
    PATH_LOST,
    STATE_LATE,
    STATE_LOST,
    FallbackChain,
)
from ampc_ros.supervision.guard import Guard
from ampc_ros.supervision.monitors import (
    DeviationMonitor,
    Motion,
    PathEndMonitor,
    StopRequest,
)
from ampc_ros.supervision.odometry import OdometryMonitor
from ampc_ros.supervision.progress import Location, PathProgress
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.stopping_plan import PlanStart, StoppingPlan, stopping_plan


class Supervisor:
    """A controller with input checks, fallbacks and a guard."""

    def __init__(
        self, config: Configuration, source: object = "gain table", number: int = 1, resets: int = 0
    ) -> None:
        """Create controller, fallback chain and guard, at rest.

        Args:
            config: Configuration of the controller.
            source: Origin of the gains, for the error message.
            number: Number of this configuration; later configurations count on from it.
            resets: Number of restarts before, in a replay that begins in the middle of a run.

        Raises:
            ValueError: The gains make the controller's problem numerically singular.
        """
        self._filter, self.odometry = StateFilter(), OdometryMonitor()
        self._progress = PathProgress()
        self._number, self._resets = number - 1, resets
        self._stop = StopRequest()
        self._deviation, self._path_end = DeviationMonitor(), PathEndMonitor()
        self._state: Received[VehicleState] | None = None
        self._path: Received[Path] | None = None
        self._points: Array | None = None
        self._measured = self._yaw_rate = self._started_from = math.nan
        self._plan_start: PlanStart | None = None
        self._commanded_ns: int | None = None
        self._fault = ""
        self._clips = dict.fromkeys(LIMITS[1:], 0)
        controller = build_controller(config, source)
        self._present = PresentState(config, controller)
        self._install(config, controller, 0.0)

    def reconfigure(self, config: Configuration, source: object = "gain table") -> None:
        """Switch to another configuration at the angle in force; an error changes nothing.

        Raises:
            ValueError: The gains make the controller's problem numerically singular, or the new
                controller cannot follow the path in use.
        """
        controller = build_controller(config, source)
        if self._path:
            controller.check(self._path.value)
        before, fault = self._chain.controller, self.qp_fault
        self._install(config, controller, self.steering)
        controller.inherit(before)
        self._chain.qp_fault = fault

    def _install(self, config: Configuration, controller: Controller, steering: float) -> None:
        self._config, self._number = config, self._number + 1
        self._guard = Guard(config.guard, config.chassis, controller.period)
        self._guard.steering, self._guard.count = steering, self._clips
        self._chain = FallbackChain(config, controller)
        self._present.install(config, controller)
        self._chain.restart(steering + self._offset)

    @property
    def config(self) -> Configuration:
        """Configuration in use."""
        return self._config

    @property
    def number(self) -> int:
        """Number of the configuration in use."""
        return self._number

    @property
    def controller(self) -> Controller:
        """Controller in use."""
        return self._chain.controller

    @property
    def period(self) -> float:
        """Time from one tick to the next [s]."""
        return self.controller.period

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""
        return self._guard.steering

    @property
    def _offset(self) -> float:
        """Estimated offset between the commanded and the road-wheel angle [rad]."""
        return self._present.car.offset

    @property
    def adaptation(self) -> Adaptation | None:
        """Estimation of what differs from the configured car; None: it is switched off."""
        return self._present.adaptation

    @property
    def assumed_car(self) -> AssumedCar:
        """The car that prediction and controller assume at present."""
        return self._present.car

    @property
    def state(self) -> Received[VehicleState] | None:
        """Newest accepted state."""
        return self._state

    @property
    def path(self) -> Received[Path] | None:
        """Path in use."""
        return self._path

    @property
    def is_ready(self) -> bool:
        """Whether a state and a path have been accepted."""
        return self._state is not None and self._path is not None

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest accepted state; -1: there is none [ns]."""
        return self._state.stamp_ns if self._state else -1

    @property
    def stop_requested(self) -> bool:
        """Whether a stop is requested."""
        return self._stop.requested

    @property
    def path_end(self) -> PathEndMonitor:
        """Monitor of the end of the path."""
        return self._path_end

    @property
    def no_path(self) -> bool:
        """Whether the newest path is empty: a stop is requested until the next valid one."""
        return self._stop.no_path

    @property
    def failure(self) -> str:
        """Reason why the newest tick has no result of the controller; empty: it has one."""
        return self._fault or self._chain.fault or self.controller.failure

    @property
    def qp_fault(self) -> bool:
        """Whether fault injection makes every solution fail."""
        return self._chain.qp_fault

    @property
    def resets(self) -> int:
        """Number of restarts of the controller."""
        return self._resets

    @property
    def clips(self) -> Mapping[str, int]:
        """Number of commands clipped by the guard under all configurations, by limit."""
        return self._clips

    @property
    def rejected(self) -> Mapping[str, int]:
        """Number of rejected states, by cause."""
        return self._filter.rejected

    def restart(self, steering: float | None = None) -> None:
        """Restart the controller, from the angle in force or from another angle [rad]."""
        self._resets += 1
        self._restart(steering)

    def start_from(self, steering: float) -> None:
        """Start to steer from an angle [rad]; the next tick records it.

        The first command may differ from it by what the guard allows in one period.
        """
        self._restart(steering)
        self._started_from = steering

    def _restart(self, steering: float | None) -> None:
        self._measured = math.nan
        self._deviation.approach()
        if steering is not None:
            self._guard.reset(steering)
            self._present.commands.reset(steering)
            self._commanded_ns = None
        self._present.freeze()
        self._chain.restart(self.steering + self._offset)

    def forget(self) -> None:
        """Restart and wait for new inputs: the earlier ones belong to another drive."""
        self._filter.reset()
        self.odometry.reset()
        self._progress.forget()
        self._state = self._path = self._points = None
        self._stop.no_path = False
        self.clear_stop()
        self.restart()

    def clear_stop(self) -> None:
        """Take back the request to stop; a car that is off its path may approach it again."""
        if self._stop.requested:
            self._deviation.approach()
        self._stop.clear()

    def stopping_plan(self, now_ns: int) -> StoppingPlan | None:
        """Return how to steer from the tick of this time on until the car stands.

        None: the tick has not located the car on the path.
        """
        if self._plan_start is None:
            return None
        angles = self._chain.planned_from(now_ns)
        angles[0] = self.steering + self._offset
        car, braking = self.assumed_car, self.config.settings.end_deceleration
        return stopping_plan(self._plan_start, angles, self.period, car, braking)

    def inject_qp_fault(self, on: bool) -> None:
        """Make every solution fail, or end this fault."""
        self._chain.qp_fault = on

    def take_state(self, state: VehicleState, now_ns: int) -> bool:
        """Use a state as the newest one; restart the controller where time or position jump.

        Returns:
            Whether the controller was restarted.

        Raises:
            ValueError: The state contradicts the earlier ones; the last valid one is kept.
        """
        if self._path is None:  # a car may wait at its start, with the speed that it will have
            self._filter.reset()
            self.odometry.reset()
        verdict = self._filter.accept(state, now_ns)
        if not verdict.accepted:
            raise ValueError(verdict.reason)
        if verdict.reset:
            self.odometry.reset()
            self._restart_at(state)
            if self._path:  # after a clock that went back, the path must still grow old
                arrival_ns = min(self._path.arrival_ns, now_ns)
                self._path = self._path._replace(arrival_ns=arrival_ns)
        corrected = self.odometry.correct(state)
        self._yaw_rate = math.nan if corrected is state else corrected.yaw_rate
        self._state = Received(corrected, state.stamp_ns, now_ns)
        return verdict.reset

    def replay_state(
        self, state: Received[VehicleState], resets: int, yaw_rate: float = math.nan
    ) -> None:
        """Use a state that was accepted in a recorded run, without checks.

        Args:
            state: Accepted state with its arrival time.
            resets: Recorded number of restarts; where it has increased, the controller restarts.
            yaw_rate: Recorded `corrected_yaw_rate`; nan: that of the state is used [rad/s].
        """
        self._yaw_rate = yaw_rate
        if not math.isnan(yaw_rate):
            state = state._replace(value=state.value._replace(yaw_rate=yaw_rate))
        if resets > self._resets:
            self._restart_at(state.value)
            self._resets = resets
        self._state = state

    def _restart_at(self, state: VehicleState) -> None:
        """Restart after a jump; a simulated car whose time goes back has straight wheels."""
        goes_back = self._state is not None and state.stamp_ns < self._state.stamp_ns
        self.restart(0.0 if goes_back and self.config.simulated_time else None)
        if goes_back:
            self._present.commands.reset(self.steering)
            self._progress.forget()
        else:
            self._progress.relocate(self._centre(state))

    def take_path(
        self, points: ArrayLike, stamp_ns: int, now_ns: int, checked: Path | None = None
    ) -> None:
        """Use a path through points (n, 2) [m]; the points in use only renew its times.

        An empty path means that there is none: a stop is requested until the next valid path, and
        the car steers along the last one meanwhile.

        Args:
            points: (n, 2) positions in driving order [m].
            stamp_ns: Stamp of the message [ns].
            now_ns: Time of its arrival [ns].
            checked: Result of `check_path` for these points; None: it is checked here.

        Raises:
            ValueError: The path cannot be driven; the last valid path is kept.
        """
        points = np.asarray(points, dtype=float)
        if points.size == 0:
            self._stop.no_path = True
            if self._path:
                self._path = Received(self._path.value, stamp_ns, now_ns)
            return
        if self._path and self._points is not None and np.array_equal(points, self._points):
            self._path = Received(self._path.value, stamp_ns, now_ns)
            self._stop.no_path = False
            return
        if checked is None:
            noise = self.config.settings.known_path_noise
            chassis, angle = self.config.chassis, self.config.max_angle
            checked = check_path(points, chassis, angle, path_noise=noise)
        path = checked
        self.follow(path, stamp_ns, now_ns)
        self._points = points

    def follow(self, path: Path, stamp_ns: int, now_ns: int) -> None:
        """Use a path that was already built from points.

        Raises:
            ValueError: The controller cannot follow it; the last valid path is kept.
        """
        self.controller.check(path)
        self._path, self._points = Received(path, stamp_ns, now_ns), None
        self._stop.no_path = False

    def correct(self, steering: float) -> None:
        """Continue from another angle than the one commanded last [rad]."""
        if steering != self.steering:
            self._guard.reset(steering)
            self._present.commands.correct(steering)
            self.controller.take_over(self.steering + self._offset, stepped=True)

    def take_steering(self, angle: float) -> None:
        """Use an angle measured like the command, without the estimated offset [rad]."""
        self._measured = angle

    def step(self, state: VehicleState, path: Path) -> Command:
        """Answer a state at once, as in lock-step: no input is late.

        Raises:
            ValueError: See `take_state` and `follow`.
        """
        now_ns = state.stamp_ns
        if self._path is None or self._path.value is not path:
            self.follow(path, now_ns, now_ns)
        self._path = Received(path, now_ns, now_ns)
        self.take_state(state, now_ns)
        record = self.tick(now_ns, self.period)
        assert record is not None
        return record.command

    def tick(self, now_ns: int, elapsed: float | None = None) -> TickRecord | None:
        """Decide the command of this tick; None before the first valid state and path.

        Args:
            now_ns: Time of the node's clock [ns].
            elapsed: Time since the last command for the guard; None: that of the clock [s].
        """
        state, path = self._state, self._path
        if state is None or path is None:
            return None
        controller, settings = self.controller, self.config.settings
        is_path_lost = self.is_path_lost(now_ns)

        # A request to stop remains until `clear_stop`, or until its cause has ended.
        complete = not (is_path_lost or self.is_state_late(now_ns))
        if self._stop.resumes(now_ns, complete=complete) and settings.resume:
            self.clear_stop()

        # Each measured angle is used once, by the controller and by the guard. The level of the
        # fallback chain follows from the ages of state and path. After an exception, which is a
        # fault of the program, the last plan is used and a stop requested.
        measured, self._measured = self._measured, math.nan
        self._plan_start = None
        try:
            if not math.isnan(measured):
                controller.observe_steering(measured + self._offset)
            command, stepped = self._answer(state.value, path.value, now_ns, is_path_lost)
            self._fault = ""
        except Exception as error:
            self._fault = f"the controller failed: {type(error).__name__}: {error}"
            in_force, stepped = self.steering + self._offset, False
            command = self._chain.advance(CONTROLLER_FAULT, in_force, now_ns)

        # The estimated offset is taken off: from the road wheel's angle to the command.
        offset = self._offset
        angle, planned = command.steering - offset, command.planned_steering - offset
        command = command._replace(steering=angle, planned_steering=planned)

        # The guard clips the command, whatever its source, by the time since the last one.
        if elapsed is None:
            elapsed = self._time_since_command(now_ns)
        guarded = self._guard.step(
            command.steering,
            command.steering_rate,
            state.value.v_x,
            None if math.isnan(measured) else measured,
            elapsed,
        )
        self._commanded_ns = now_ns

        # The controller continues from the commanded angle where that is not its own.
        if not stepped or guarded.steering != controller.steering - offset:
            self._take_over(guarded.steering + offset, stepped=stepped)
        self._present.commands.store(guarded.steering, now_ns)
        if guarded.limit or command.rung != OPTIMAL:
            self._present.freeze()

        self._stop.inputs |= is_path_lost or (
            command.reason in (STATE_LATE, STATE_LOST) and (command.rung == STOP)
        )
        self._stop.drive |= command.reason in (OFF_PATH, PATH_ENDS) or (
            command.rung == STOP and command.reason not in (STATE_LATE, STATE_LOST)
        )
        self._stop.drive |= bool(self._fault or self._chain.fault)
        started_from, self._started_from = self._started_from, math.nan
        return TickRecord(
            command._replace(
                stamp_ns=state.stamp_ns,
                steering=guarded.steering,
                steering_rate=guarded.steering_rate,
                clipped=guarded.limit,
            ),
            *state.ages(now_ns),
            *path.ages(now_ns),
            measured,
            float(self.stop_requested),
            self._resets,
            self._number,
            float(self.qp_fault),
            self._yaw_rate,
            sum(self.assumed_car.response),
            understeer_gradient(self.assumed_car.vehicle),
            offset,
            self.assumed_car.vehicle[-1],
            elapsed,
            started_from,
        )

    def _answer(
        self, state: VehicleState, path: Path, now_ns: int, is_path_lost: bool
    ) -> tuple[Command, bool]:
        """Return the command before the guard, and whether the controller stepped.

        A late state is continued by the model; beyond that the last plan is used.
        """
        missing, in_force = NO_REASON, self.steering + self._offset
        if self.is_state_late(now_ns):
            assert self._state
            is_lost = self._state.is_older(now_ns, self.config.settings.state_lost)
            missing = STATE_LOST if is_lost else STATE_LATE
        if missing and not self.can_predict(now_ns):
            follow = self._chain.stop if missing == STATE_LOST else self._chain.advance
            return follow(missing, in_force, now_ns), False
        is_measured = math.isnan(self._yaw_rate)
        present = self._present.at(state, now_ns, is_measured=is_measured)
        location = self._progress.locate(
            self._centre(present), path, self.controller.check, renew=self._chain.is_new_on_path
        )
        self._chain.feed_forward.progress = self._progress.tracker
        seen, in_force = location.seen(present), self.steering + self._offset
        command = self._chain.answer(seen, location.path, in_force, now_ns)
        reason = self._monitor(present, location)
        if command.reason == NO_REASON and (is_path_lost or self.no_path):
            reason = reason or PATH_LOST
        to_cg = self.config.base_link_to_cg
        self._plan_start = PlanStart(location.path, location.s, present.v_x, to_cg)
        return with_reason(command, reason, missing), True

    def _time_since_command(self, now_ns: int) -> float:
        """Return the time since the last command [s].

        One period before the first one, and where the clock went back: the time is not known.
        """
        if self._commanded_ns is None or now_ns < self._commanded_ns:
            return self.period
        elapsed = (now_ns - self._commanded_ns) / NANOSECONDS
        return self.period if abs(elapsed - self.period) < 1.0 / NANOSECONDS else elapsed

    def _take_over(self, steering: float, *, stepped: bool) -> None:
        """Continue the controller from another angle in force [rad]; after a fault, restart it."""
        try:
            self.controller.take_over(steering, stepped=stepped)
            if self._fault:
                self.controller.reset(steering)
                self._chain.is_new_on_path = True
        except Exception as error:
            self._fault = f"the controller failed: {type(error).__name__}: {error}"

    def _monitor(self, state: VehicleState, location: Location) -> int:
        """Return the reason for a stop that state and path give, or NO_REASON."""
        settings, path = self.config.settings, location.path
        motion = Motion(state.stamp_ns, state.v_x)
        self._path_end.observe(
            motion,
            math.inf if path.closed else path.length - location.s,
            settings.end_deceleration,
        )
        if self._deviation.observe(motion, location, settings.max_deviation):
            return OFF_PATH
        return PATH_ENDS if self._path_end.is_due else NO_REASON

    def _centre(self, state: VehicleState) -> VehicleState:
        """Return the state at the centre of gravity, which is projected onto the path."""
        return at_distance(state, self.config.base_link_to_cg)

    def is_state_late(self, now_ns: int) -> bool:
        """Return whether the newest state is too old to wait for another one."""
        return self._state is not None and self._state.is_older(
            now_ns, self.config.settings.state_late
        )

    def can_predict(self, now_ns: int) -> bool:
        """Return whether the newest state can be predicted to this time."""
        prediction = self.config.settings.state_prediction
        return self._state is not None and 0.0 < self._state.ages(now_ns).age <= prediction

    def is_path_lost(self, now_ns: int) -> bool:
        """Return whether the path is too old to be followed without a stop."""
        if self._path is None or self.config.static_path:
            return False
        return self._path.is_older(now_ns, self.config.settings.path_lost)


def with_reason(command: Command, reason: int, missing: int) -> Command:
    """Return a command with the reason that matters most.

    A lost state comes first. A refusal of the controller and a stop that the drive needs come
    before a late state: they are requested however long states are late.

    Args:
        command: Command of the fallback chain.
        reason: Reason of the monitors or of the path, or NO_REASON.
        missing: STATE_LATE, STATE_LOST, or NO_REASON.
    """
    if missing == STATE_LOST:
        return command._replace(rung=STOP, reason=STATE_LOST)
    if command.rung == STOP:
        return command
    if missing == STATE_LATE:
        command = command._replace(rung=max(command.rung, SHIFTED_PLAN))
        reason = reason if reason in (OFF_PATH, PATH_ENDS) else STATE_LATE
    return command._replace(reason=reason) if reason else command
