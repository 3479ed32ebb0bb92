"""Throw hostile inputs at checks and guard: no exception, no command outside the limits.

`python launch_scripts/fuzz.py`, or `ros2 run launch_scripts fuzz`; `--inputs 1000000 --seed 1`.
The same seed gives the same inputs. The exit code is 1 where a promise is broken; the seed and the
number of the input are told.
"""

import argparse
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from rich.console import Console
from rich.progress import Progress

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters, GuardLimits, SteeringParameters
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.checks import StateFilter, check_path
from ampc_ros.guard import LONGEST_PAUSE, Guard

PERIOD = 0.1
SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e308, -1e308, 1e9)
SHARES = {"state": 0.45, "tick": 0.448, "steering": 0.1, "path": 0.002}
"""Of the inputs; a path takes a thousand times as long as the others."""
HOSTILE = 0.1
"""Share of the numbers that are not what a car would report."""
MAX_POINTS = 60


class Violation(Exception):
    """A promise that was not kept."""


class Answer(NamedTuple):
    """A command that would be published."""

    steering: float
    """[rad]."""
    steering_rate: float
    """[rad/s]."""


class Subject(Protocol):
    """What inputs are thrown at. Whatever is refused raises ValueError or changes nothing."""

    def take_state(self, state: VehicleState, now_ns: int) -> None:
        """Take a state that has arrived."""

    def take_path(self, points: list[tuple[float, float]], now_ns: int) -> None:
        """Take a path that has arrived."""

    def take_steering(self, angle: float, now_ns: int) -> None:
        """Take a measured road-wheel angle [rad]."""

    def tick(self, now_ns: int) -> Answer | None:
        """Give the command to publish, where there is one."""


class ChecksAndGuard:
    """Checks and guard around a controller that asks for anything."""

    def __init__(self, ask: Callable[[float, float], float], limits: str) -> None:
        """Make both for the ordinary car.

        Args:
            ask: Gives a number that the controller asks for, mostly near one, with a spread.
            limits: Shipped limits of the guard, or file.
        """
        vehicle = find("vehicles", "ordinary")
        self.chassis = load(ChassisParameters, vehicle, "chassis")
        self.max_angle = load(SteeringParameters, vehicle, "steering").max_angle
        self.filter = StateFilter()
        self.guard = Guard(load(GuardLimits, find("guards", limits)), self.chassis, PERIOD)
        self.ask, self.measured, self.last_ns = ask, math.nan, 0

    def take_state(self, state: VehicleState, now_ns: int) -> None:
        """Filter a state; wherever the car is placed anew, its wheel stays where it is."""
        if self.filter.accept(state, now_ns).accepted and not all(map(math.isfinite, state)):
            raise Violation(f"{state} was accepted")

    def take_path(self, points: list[tuple[float, float]], now_ns: int) -> None:
        """Check a path."""
        path = check_path(points, self.chassis, self.max_angle)
        if not all(np.isfinite(row).all() for row in path[1:5]):
            raise Violation("a path that is not finite was accepted")

    def take_steering(self, angle: float, now_ns: int) -> None:
        """Remember a measured angle, whatever it is."""
        self.measured = angle

    def tick(self, now_ns: int) -> Answer:
        """Guard what the controller asks for, at the speed of the newest valid state."""
        track, elapsed = self.filter.track, (now_ns - self.last_ns) / NANOSECONDS
        v_x = track.last.v_x if track else self.ask(9.0, 5.0)
        angle, rate = self.ask(self.guard.steering, 0.03), self.ask(0.0, 0.3)
        self.last_ns = now_ns
        return Answer(*self.guard.step(angle, rate, v_x, self.measured, elapsed)[:2])


class Inputs:
    """A seeded source of inputs: a car that drives on, disturbed by all that can go wrong."""

    def __init__(self, seed: int) -> None:
        """Begin a drive."""
        self.rng = np.random.default_rng(seed)
        self.now_ns = 1_000 * NANOSECONDS
        self.state = VehicleState(self.now_ns, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0)

    def number(self, usual: float, spread: float) -> float:
        """Give a number near the usual one, or a hostile one."""
        if self.rng.random() >= HOSTILE:
            return usual + spread * float(self.rng.standard_normal())
        if self.rng.random() < 0.5:
            return float(self.rng.choice(SPECIAL))
        return float(self.rng.uniform(-1.0, 1.0) * 10.0 ** self.rng.uniform(-10.0, 10.0))

    def time(self) -> int:
        """Let the clock go on, jump ahead or jump back, and give its time [ns]."""
        step = 0.02 if self.rng.random() < 0.99 else self.rng.choice([0.0, -0.2, -3.0, 1.0, 1e4])
        self.now_ns = max(self.now_ns + round(step * NANOSECONDS), 0)
        return self.now_ns

    def next_state(self) -> VehicleState:
        """Drive on; half of the states are reported as they are."""
        dt = min(max((self.now_ns - self.state.stamp_ns) / NANOSECONDS, 0.0), 1.0)
        x, y, yaw, v, _, turn = self.state[1:]
        x, y, yaw = x + v * math.cos(yaw) * dt, y + v * math.sin(yaw) * dt, yaw + turn * dt
        v = min(max(v + float(self.rng.normal(0.0, 0.1)), 0.0), 40.0)
        turn = 0.9 * turn + float(self.rng.normal(0.0, 0.02))
        self.state = VehicleState(self.now_ns, x, y, math.remainder(yaw, math.tau), v, 0.0, turn)
        if self.rng.random() < 0.5:
            return self.state
        stamp_ns = self.state.stamp_ns + round(float(self.rng.normal(0.0, 0.3)) * NANOSECONDS)
        return VehicleState(stamp_ns, *(self.number(value, 0.1) for value in self.state[1:]))

    def path(self) -> list[tuple[float, float]]:
        """Give points of a winding road; a third of them hostile."""
        count = int(self.rng.integers(0, MAX_POINTS))
        spacing, bend = self.rng.uniform(0.05, 15.0), self.rng.normal(0.0, 0.02)
        s = spacing * np.arange(count)
        points = np.column_stack((s, 30.0 * np.sin(bend * s))).tolist()
        if count and self.rng.random() < 0.3:
            for _ in range(int(self.rng.integers(1, 4))):
                points[int(self.rng.integers(count))] = (
                    self.number(0.0, 50.0),
                    self.number(0.0, 10.0),
                )
        return [(x, y) for x, y in points]


class Promises:
    """What is expected of every command."""

    def __init__(self, limits: str) -> None:
        """Read the limits."""
        self.limits = load(GuardLimits, find("guards", limits))
        self.last = 0.0

    def check(self, answer: Answer) -> None:
        """Raise a Violation unless a command is finite, inside its limits, and moves slowly."""
        most, rate = max(self.limits.max_angle), max(self.limits.max_rate)
        steering, last, self.last = answer.steering, self.last, answer.steering
        if not all(map(math.isfinite, answer)):
            raise Violation(f"command {answer} is not finite")
        if abs(steering) > most:
            raise Violation(f"angle {steering!r} is beyond {most}")
        if abs(answer.steering_rate) > rate:
            raise Violation(f"rate {answer.steering_rate!r} is beyond {rate}")
        if abs(steering - last) > rate * LONGEST_PAUSE * PERIOD * (1 + 1e-12):
            raise Violation(f"angle jumped from {last!r} to {steering!r}")


def fuzz(
    subject: Subject, inputs: Inputs, promises: Promises, count: int, say: Any = None
) -> Counter[str]:
    """Throw inputs at a subject; a refusal is a ValueError or silent, all else is a failure.

    Returns:
        How many inputs of each kind, and how many of them were refused by ValueError.

    Raises:
        Violation: Tells the number of the input.
    """
    done: Counter[str] = Counter()
    for number in range(count):
        kind = str(inputs.rng.choice(list(SHARES), p=list(SHARES.values())))
        try:
            one_input(kind, subject, inputs, promises)
        except ValueError:
            done[f"{kind} refused"] += 1
        except Exception as error:
            raise Violation(f"input {number}, {kind}: {error!r}") from error
        done[kind] += 1
        if say and number % 1000 == 0:
            say(number)
    return done


def one_input(kind: str, subject: Subject, inputs: Inputs, promises: Promises) -> None:
    """Throw one input."""
    now_ns = inputs.time()
    if kind == "state":
        subject.take_state(inputs.next_state(), now_ns)
    elif kind == "steering":
        subject.take_steering(inputs.number(promises.last, 0.05), now_ns)
    elif kind == "path":
        subject.take_path(inputs.path(), now_ns)
    else:
        answer = subject.tick(now_ns)
        if answer is not None:
            promises.check(answer)


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--guard", default="road", help="limits; default: %(default)s")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz, tell what was thrown and refused; gives 1 where a promise is broken."""
    chosen, console = options(arguments), Console(highlight=False)
    inputs = Inputs(chosen.seed)
    subject = ChecksAndGuard(inputs.number, chosen.guard)
    try:
        with Progress(console=console) as progress, np.errstate(all="ignore"):
            task = progress.add_task("inputs", total=chosen.inputs)
            say = lambda done: progress.update(task, completed=done)  # noqa: E731
            counts = fuzz(subject, inputs, Promises(chosen.guard), chosen.inputs, say)
            progress.update(task, completed=chosen.inputs)
    except Violation as violation:
        console.print(f"seed {chosen.seed}: {violation}")
        return 1
    for title, table in (
        ("inputs", counts),
        ("states refused", subject.filter.rejected),
        ("commands clipped", subject.guard.count),
    ):
        console.print(f"{title}: " + ", ".join(f"{name} {n}" for name, n in sorted(table.items())))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
