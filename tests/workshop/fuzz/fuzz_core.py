"""The node's core as what inputs are thrown at: its supervisor, under changing configurations."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from ampc_msgs_config.types import LIMITS, OPTIMAL, REASONS, RUNGS, SLACK
from ampc_ros.configuration import CONTROLLERS, Choices, Configuration, configuration
from ampc_ros.supervision.guard import bounds
from ampc_ros.supervision.supervisor import Decision, Supervisor
from tests.workshop.fuzz.fuzz_guard import Violation
from tests.workshop.fuzz.fuzz_road import CALM, STAMPS, Road

KINDS = {
    "state": 0.44,
    "tick": 0.44,
    "steering": 0.08,
    "path": 0.035,
    "fault": 0.004,
    "configuration": 0.001,
}
"""Shares of the inputs."""
CALM_AFTER = 1000
"""Inputs from one check of the recovery to the next."""
ROUNDING = 1e-12
"""Share by which a step may be larger than its bound."""
ENOUGH_SWEEPS = 38
"""With fewer, or with a soft lane, Hildreth's method may give up whatever comes in."""


@cache
def shipped(controller: str, vehicle: str, guard: str) -> Configuration:
    """Read a configuration once."""
    return configuration(Choices(controller, vehicle, guard=guard))


def any_configuration(rng: np.random.Generator) -> Configuration:
    """Give one of all controllers, vehicles, guards, solvers, actuators."""
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
    """The supervisor under any configuration, and what is expected of each decision."""

    def __init__(self, road: Road) -> None:
        """Start with any configuration."""
        self.road = road
        self.supervisor = Supervisor(any_configuration(road.rng))
        self.was_requested = False
        self.done: Counter[str] = Counter()

    def throw(self, kind: str) -> None:
        """Throw one input of a kind.

        Raises:
            ValueError: It is refused.
        """
        road, supervisor, now_ns = self.road, self.supervisor, self.road.time()
        if kind == "state":
            supervisor.take_state(road.odom(), now_ns)
        elif kind == "steering":
            supervisor.take_steering(road.number(supervisor.steering, 0.05))
        elif kind == "path":
            stamp_ns = now_ns if road.rng.random() < 0.9 else int(road.rng.choice(STAMPS))
            supervisor.take_path(road.road(), stamp_ns, now_ns)
        elif kind == "fault":
            supervisor.ladder.qp_fault = road.rng.random() < 0.3
        elif kind == "configuration":
            supervisor.reconfigure(any_configuration(road.rng))
        else:
            self.tick(now_ns)

    def tick(self, now_ns: int) -> Decision | None:
        """Tick, and check what is decided; a ValueError is no refusal here."""
        last = self.supervisor.steering
        try:
            decision = self.supervisor.tick(now_ns)
        except ValueError as error:
            raise Violation(f"a tick raises {error!r}") from error
        if decision is None:
            if self.supervisor.is_ready:
                raise Violation("no command in spite of state and path")
            return None
        self.check(decision, last)
        self.road.steer(self.supervisor.steering, self.supervisor.config.chassis.wheelbase)
        return decision

    def check(self, decision: Decision, last: float) -> None:
        """Raise a Violation unless a decision keeps what is promised."""
        command, told = decision
        check_finite(decision)
        for name, value, names in (
            ("rung", told.rung, RUNGS),
            ("reason", told.reason, REASONS),
            ("clipped", told.clipped, LIMITS),
        ):
            if value not in range(len(names)):
                raise Violation(f"{name} = {value!r}")
            self.done[f"{name} {names[int(value)]}"] += 1
        if command.steering != told.steering or command.steering != self.supervisor.steering:
            raise Violation(f"{command.steering!r} is commanded, {told.steering!r} is told")
        self.check_limits(command.steering, command.steering_rate, last)
        if self.was_requested > self.supervisor.stop_requested:
            raise Violation("the request to stop is forgotten")
        self.was_requested = self.supervisor.stop_requested

    def check_limits(self, steering: float, rate: float, last: float) -> None:
        """Raise a Violation where a command is beyond the guard's limits at the speed."""
        supervisor = self.supervisor
        assert supervisor.state is not None
        v_x, guard = supervisor.state.value.v_x, supervisor.config.guard
        bound = bounds(guard, supervisor.config.chassis, v_x)
        most, fastest = min(bound.angle, bound.acceleration), min(bound.rate, bound.jerk)
        if abs(steering) > max(most, abs(last)):
            raise Violation(f"angle {steering!r} is beyond {most!r} at {v_x!r} m/s, from {last!r}")
        if abs(rate) > fastest:
            raise Violation(f"rate {rate!r} is beyond {fastest!r} at {v_x!r} m/s")
        step = fastest * supervisor.period
        if abs(steering - last) > step * (1 + ROUNDING) + math.ulp(last):
            raise Violation(f"step from {last!r} to {steering!r} is beyond {step!r}")

    def recover(self) -> None:
        """Raise a Violation unless calm inputs lead back to the controller's solution."""
        supervisor, decision, refused = self.supervisor, None, ""
        supervisor.ladder.qp_fault = False
        for state, points in self.road.calm(supervisor.period):
            try:
                supervisor.take_state(state, state.stamp_ns)
                supervisor.take_path(points, state.stamp_ns, state.stamp_ns)
            except ValueError as error:
                refused = str(error)
            decision = self.tick(state.stamp_ns)
        rung = decision.supervision.rung if decision else -1
        settings = supervisor.config.settings
        told = decision.supervision if decision else None
        few = settings.hildreth_sweeps < ENOUGH_SWEEPS
        lane = math.isfinite(settings.max_output_error)
        if 0 <= rung <= (SLACK if lane else OPTIMAL):
            self.done["recovered"] += 1
        elif rung >= 0 and settings.solver == "hildreth" and (lane or few):
            self.done["not recovered: too few sweeps"] += 1
        else:
            raise Violation(f"after {CALM:g} s without faults: {told}; refused last: {refused}")


def check_finite(decision: Decision) -> None:
    """Raise a Violation where what would be published is not finite."""
    command = decision.command
    if not (math.isfinite(command.steering) and math.isfinite(command.steering_rate)):
        raise Violation(f"command {command.steering!r}, {command.steering_rate!r} is not finite")
    if not math.isfinite(decision.supervision.planned_steering):
        raise Violation("the planned angle is not finite")
    for name, values in (("plan", command.plan), ("prediction", command.prediction)):
        if values is not None and not np.isfinite(values).all():
            raise Violation(f"the {name} is not finite")


def throw_all(core: Core, kinds: Sequence[str], throw: Callable[[str], None]) -> Counter[str]:
    """Throw inputs of these kinds, and see now and then whether the core recovers.

    Returns:
        How many inputs, refusals, rungs, reasons, and clipped commands of each kind.

    Raises:
        Violation: Tells the number of the input.
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
    refused = core.supervisor.filter.rejected.items()
    core.done.update({f"state {cause}": n for cause, n in refused if n})
    return core.done


def core_drive(seed: int, drive: int, count: int) -> Counter[str]:
    """Throw inputs at the core in one drive; see `throw_all`.

    Args:
        seed: Of all drives.
        drive: Number of this one; both together give its inputs.
        count: Of inputs.
    """
    core = Core(Road([seed, drive]))
    kinds = core.road.rng.choice(list(KINDS), p=list(KINDS.values()), size=count)
    return throw_all(core, kinds.tolist(), core.throw)
