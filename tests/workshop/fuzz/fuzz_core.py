"""Fuzzing of the node's core: supervisor and tick policy under changing configurations."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from ampc_msgs_config.types import (
    LIMITS,
    NANOSECONDS,
    OPTIMAL,
    REASONS,
    RUNGS,
    SLACK,
    Command,
    TickRecord,
    VehicleState,
)
from ampc_ros.configuration import CONTROLLERS, Choices, Configuration, configuration
from ampc_ros.supervision.guard import LONGEST_PAUSE, bounds
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.tick_policy import Action, TickPolicy
from tests.workshop.fuzz.fuzz_guard import Violation
from tests.workshop.fuzz.fuzz_road import CALM, STAMPS, Road

KINDS = {
    "state": 0.44,
    "tick": 0.34,
    "timer": 0.10,
    "steering": 0.08,
    "path": 0.035,
    "fault": 0.004,
    "configuration": 0.001,
}
"""Shares of the inputs; `tick` is a tick whenever, `timer` one by the tick policy."""
CALM_AFTER = 1000
"""Number of inputs between checks of the recovery."""
ROUNDING = 1e-12
"""Relative rounding error of a step's bound."""
ENOUGH_SWEEPS = 38
"""With fewer, or with a soft lane, Hildreth's method may not converge for any input."""


@cache
def shipped(controller: str, vehicle: str, guard: str) -> Configuration:
    """Load a configuration once."""
    return configuration(Choices(controller, vehicle, guard=guard))


def any_configuration(rng: np.random.Generator) -> Configuration:
    """Return a random combination of controllers, vehicles, guards, solvers, actuators."""
    config = shipped(
        str(rng.choice(list(CONTROLLERS))),
        str(rng.choice(["paper", "ordinary"])),
        str(rng.choice(["road", "track"])),
    )
    settings = replace(
        config.settings,
        max_output_error=float(rng.choice([math.inf, math.inf, 0.3, 0.05, 0.0])),
        solver=str(rng.choice(["active_set", "active_set", "hildreth"])),
        hildreth_sweeps=int(rng.choice([1, 3, 38, 200])),
        friction=float(rng.choice([0.9, 0.9, 0.2])),
    )
    steering = replace(
        config.steering,
        delay=float(rng.choice([0.0, 0.1, 0.25])),
        lag=float(rng.choice([0.0, 0.1, 0.5])),
        max_rate=float(rng.choice([math.inf, 0.5])),
    )
    return config._replace(
        settings=settings,
        steering=steering,
        base_link_to_cg=config.base_link_to_cg + float(rng.choice([0.0, 0.0, 1.0, -20.0])) / 2,
        static_path=bool(rng.random() < 0.2),
        simulated_time=bool(rng.random() < 0.5),
    )


class Core:
    """The supervisor under any configuration, and the checks of each tick."""

    def __init__(self, road: Road) -> None:
        """Start with a random configuration."""
        self.road = road
        self.supervisor = Supervisor(any_configuration(road.rng))
        self.policy = TickPolicy(self.supervisor)
        self.was_requested = self.had_no_path = False
        self.done: Counter[str] = Counter()

    def throw(self, kind: str) -> None:
        """Pass one input of a kind to the core.

        Raises:
            ValueError: It is rejected.
        """
        road, supervisor, now_ns = self.road, self.supervisor, self.road.time()
        if kind == "state":
            self.take_state(road.odom(), now_ns)
        elif kind == "steering":
            supervisor.take_steering(road.number(supervisor.steering, 0.05))
        elif kind == "path":
            stamp_ns = now_ns if road.rng.random() < 0.9 else int(road.rng.choice(STAMPS))
            supervisor.take_path(road.road(), stamp_ns, now_ns)
        elif kind == "fault":
            supervisor.inject_qp_fault(bool(road.rng.random() < 0.3))
        elif kind == "configuration":
            supervisor.reconfigure(any_configuration(road.rng))
        elif kind == "timer":
            period_ns = round(supervisor.period * NANOSECONDS)
            if self.policy.on_timer(now_ns, period_ns) is Action.TICK:
                self.tick(now_ns)
        else:
            self.tick(now_ns)

    def take_state(self, state: VehicleState, now_ns: int) -> None:
        """Pass a state to the core, which may answer it at once.

        Raises:
            ValueError: It is rejected.
        """
        self.policy.take_state(state, now_ns)
        if self.policy.on_input() is Action.TICK:
            self.tick(now_ns)

    def tick(self, now_ns: int) -> TickRecord | None:
        """Tick, and check the result; a ValueError is a Violation here."""
        last = self.supervisor.steering
        try:
            record = self.policy.tick(now_ns)
        except ValueError as error:
            raise Violation(f"a tick raises {error!r}") from error
        for survived in ("the controller failed: ", "the controller raised "):
            if self.supervisor.failure.startswith(survived):
                raise Violation(f"a tick raises {self.supervisor.failure.removeprefix(survived)}")
        if record is None:
            if self.supervisor.is_ready:
                raise Violation("no command in spite of state and path")
            return None
        self.check(record, last)
        self.road.steer(self.supervisor.steering, self.supervisor.config.chassis.wheelbase)
        return record

    def check(self, record: TickRecord, last: float) -> None:
        """Raise a Violation unless a tick keeps its guarantees."""
        command = record.command
        check_finite(command)
        for name, value, names in (
            ("rung", command.rung, RUNGS),
            ("reason", command.reason, REASONS),
            ("clipped", command.clipped, LIMITS),
        ):
            if value not in range(len(names)):
                raise Violation(f"{name} = {value!r}")
            self.done[f"{name} {names[int(value)]}"] += 1
        if command.steering != self.supervisor.steering:
            raise Violation(f"{command.steering!r} is not {self.supervisor.steering!r}")
        elapsed = min(max(record.command_interval, 0.0), LONGEST_PAUSE * self.supervisor.period)
        self.check_limits(command.steering, command.steering_rate, last, elapsed)
        withdrawn = self.was_requested > self.supervisor.stop_requested
        if withdrawn and not self.had_no_path:  # a valid path withdraws the request of an empty one
            raise Violation("the request to stop was lost")
        self.was_requested = self.supervisor.stop_requested
        self.had_no_path = self.supervisor.no_path

    def check_limits(self, steering: float, rate: float, last: float, elapsed: float) -> None:
        """Raise a Violation where a command exceeds the limits of the guard at the speed.

        Args:
            steering: Commanded angle [rad].
            rate: Its rate [rad/s].
            last: Angle commanded before [rad].
            elapsed: Time since that, at most LONGEST_PAUSE periods [s].
        """
        supervisor = self.supervisor
        assert supervisor.state is not None
        v_x, guard = supervisor.state.value.v_x, supervisor.config.guard
        bound = bounds(guard, supervisor.config.chassis, v_x)
        most, fastest = min(bound.angle, bound.acceleration), min(bound.rate, bound.jerk)
        if abs(steering) > max(most, abs(last)):
            raise Violation(f"angle {steering!r} is beyond {most!r} at {v_x!r} m/s, from {last!r}")
        if abs(rate) > fastest:
            raise Violation(f"rate {rate!r} is beyond {fastest!r} at {v_x!r} m/s")
        step = fastest * elapsed
        if abs(steering - last) > step * (1 + ROUNDING) + math.ulp(last):
            raise Violation(f"step from {last!r} to {steering!r} is beyond {step!r}")

    def recover(self) -> None:
        """Raise a Violation unless inputs without faults lead back to the solution."""
        supervisor, record, rejected = self.supervisor, None, ""
        supervisor.inject_qp_fault(False)
        for state, points in self.road.calm(supervisor.period):
            try:
                self.policy.take_state(state, state.stamp_ns)
                supervisor.take_path(points, state.stamp_ns, state.stamp_ns)
            except ValueError as error:
                rejected = str(error)
            record = self.tick(state.stamp_ns)
        command = record.command if record else None
        rung = command.rung if command else -1
        settings = supervisor.config.settings
        few = settings.hildreth_sweeps < ENOUGH_SWEEPS
        lane = math.isfinite(settings.max_output_error)
        if 0 <= rung <= (SLACK if lane else OPTIMAL):
            self.done["recovered"] += 1
        elif rung >= 0 and settings.solver == "hildreth" and (lane or few):
            self.done["not recovered: too few sweeps"] += 1
        else:
            raise Violation(
                f"after {CALM:g} s without faults: {command}; rejected last: {rejected}"
            )


def check_finite(command: Command) -> None:
    """Raise a Violation where a published number is not finite."""
    if not (math.isfinite(command.steering) and math.isfinite(command.steering_rate)):
        raise Violation(f"command {command.steering!r}, {command.steering_rate!r} is not finite")
    if not math.isfinite(command.planned_steering):
        raise Violation("the planned angle is not finite")
    for name, values in (("plan", command.plan.angles), ("prediction", command.plan.prediction)):
        if values is not None and not np.isfinite(values).all():
            raise Violation(f"the {name} is not finite")


def throw_all(core: Core, kinds: Sequence[str], throw: Callable[[str], None]) -> Counter[str]:
    """Pass inputs of these kinds to the core, and check now and then whether it recovers.

    Returns:
        Numbers of inputs, rejections, rungs, reasons, and clipped commands of each kind.

    Raises:
        Violation: With the number of the input.
    """
    for number, kind in enumerate(kinds):
        try:
            with np.errstate(all="ignore"):
                throw(kind)
        except ValueError:
            core.done[f"{kind} refused"] += 1
        except Exception as error:
            raise Violation(f"input {number}, {kind}: {error!r}") from error
        core.done[kind] += 1
        if number % CALM_AFTER == CALM_AFTER - 1:
            try:
                core.recover()
            except Exception as error:
                raise Violation(f"after input {number}: {error!r}") from error
    rejected = core.supervisor.rejected.items()
    core.done.update({f"state {cause}": n for cause, n in rejected if n})
    return core.done


def core_drive(seed: int, drive: int, count: int) -> Counter[str]:
    """Pass inputs to the core in one drive; see `throw_all`.

    Args:
        seed: Seed of all drives.
        drive: Number of this drive; both determine its inputs.
        count: Number of inputs.
    """
    core = Core(Road([seed, drive]))
    kinds = core.road.rng.choice(list(KINDS), p=list(KINDS.values()), size=count)
    return throw_all(core, kinds.tolist(), core.throw)
