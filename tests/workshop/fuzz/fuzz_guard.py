"""Fuzzing of input checks and guard, the random inputs, and the guarantees for each command."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.parameters import ChassisParameters, GuardLimits, SteeringParameters
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.supervision.checks import StateFilter, check_path
from ampc_ros.supervision.guard import LONGEST_PAUSE, Guard

PERIOD = 0.1
"""Control period [s]."""
SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e308, -1e308, 1e9)
SHARES = {"state": 0.45, "tick": 0.448, "steering": 0.1, "path": 0.002}
"""Shares of the inputs; a path takes a thousand times as long as the others."""
HOSTILE = 0.1
"""Share of the numbers that no car would report."""
MAX_POINTS = 60
JUMPS = 0.01
"""Share of the inputs at which the clock jumps."""


class Violation(Exception):
    """A guarantee that was violated."""


class FuzzCommand(NamedTuple):
    """A command to publish."""

    steering: float
    """Steering angle [rad]."""
    steering_rate: float
    """Steering rate [rad/s]."""


class ChecksAndGuard:
    """Input checks and guard around a controller with random requests."""

    def __init__(self, request: Callable[[float, float], float], limits: str) -> None:
        """Create both for the ordinary car.

        Args:
            request: Returns a random number around a usual value with a spread.
            limits: Shipped limits of the guard, or file.
        """
        vehicle = find("vehicles", "ordinary")
        self.chassis = load_section(ChassisParameters, vehicle, "chassis")
        self.max_angle = load_section(SteeringParameters, vehicle, "steering").max_angle
        self.filter = StateFilter()
        self.guard = Guard(load(GuardLimits, find("guards", limits)), self.chassis, PERIOD)
        self.request, self.measured, self.last_ns = request, math.nan, 0

    def take_state(self, state: VehicleState, now_ns: int) -> None:
        """Check a state; an accepted state must be finite."""
        if self.filter.accept(state, now_ns).accepted and not all(map(math.isfinite, state)):
            raise Violation(f"{state} was accepted")

    def take_path(self, points: list[tuple[float, float]], now_ns: int) -> None:
        """Check a path; an accepted path must be finite."""
        path = check_path(points, self.chassis, self.max_angle)
        if not all(np.isfinite(row).all() for row in path[1:5]):
            raise Violation("a path that is not finite was accepted")

    def take_steering(self, angle: float, now_ns: int) -> None:
        """Store a measured angle without a check."""
        self.measured = angle

    def tick(self, now_ns: int) -> FuzzCommand:
        """Return the guarded request at the speed of the newest valid state."""
        track, elapsed = self.filter.track, (now_ns - self.last_ns) / NANOSECONDS
        v_x = track.last.v_x if track else self.request(9.0, 5.0)
        angle, rate = self.request(self.guard.steering, 0.03), self.request(0.0, 0.3)
        self.last_ns = now_ns
        return FuzzCommand(*self.guard.step(angle, rate, v_x, self.measured, elapsed)[:2])


class Inputs:
    """Seeded random inputs: a driving car with faults of all kinds."""

    def __init__(self, seed: int | Sequence[int], jumps: float = JUMPS) -> None:
        """Start a drive.

        Args:
            seed: Seed of all inputs.
            jumps: Share of the inputs at which the clock jumps.
        """
        self.rng, self.jumps = np.random.default_rng(seed), jumps
        self.now_ns = 1_000 * NANOSECONDS
        self.state = VehicleState(self.now_ns, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0)

    def number(self, usual: float, spread: float) -> float:
        """Return a number near the usual one, or an extreme one."""
        if self.rng.random() >= HOSTILE:
            return usual + spread * float(self.rng.standard_normal())
        if self.rng.random() < 0.5:
            return float(self.rng.choice(SPECIAL))
        return float(self.rng.uniform(-1.0, 1.0) * 10.0 ** self.rng.uniform(-10.0, 10.0))

    def time(self) -> int:
        """Advance the clock, or let it jump, and return its time [ns]."""
        step = (
            0.02
            if self.rng.random() >= self.jumps
            else self.rng.choice([0.0, -0.2, -3.0, 1.0, 1e4])
        )
        self.now_ns = max(self.now_ns + round(step * NANOSECONDS), 0)
        return self.now_ns

    def next_state(self) -> VehicleState:
        """Advance the car and return its state; half of the states are changed randomly."""
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
        """Return the points of a winding road; a third of the roads have extreme points."""
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


class Guarantees:
    """Guarantees for every command."""

    def __init__(self, limits: str) -> None:
        """Load the limits."""
        self.limits = load(GuardLimits, find("guards", limits))
        self.last = 0.0

    def check(self, command: FuzzCommand) -> None:
        """Raise a Violation unless a command is finite and within angle, rate and step limits."""
        most, rate = max(self.limits.max_angle), max(self.limits.max_rate)
        steering, last, self.last = command.steering, self.last, command.steering
        if not all(map(math.isfinite, command)):
            raise Violation(f"command {command} is not finite")
        if abs(steering) > most:
            raise Violation(f"angle {steering!r} is beyond {most}")
        if abs(command.steering_rate) > rate:
            raise Violation(f"rate {command.steering_rate!r} is beyond {rate}")
        if abs(steering - last) > rate * LONGEST_PAUSE * PERIOD * (1 + 1e-12):
            raise Violation(f"angle jumped from {last!r} to {steering!r}")


def fuzz_guard(
    subject: ChecksAndGuard, inputs: Inputs, guarantees: Guarantees, count: int
) -> Counter[str]:
    """Send inputs to a subject, which may reject them by ValueError or silently.

    Returns:
        Number of inputs of each kind, and number of those rejected by ValueError.

    Raises:
        Violation: Any other exception, or a violated guarantee; names the number of the input.
    """
    done: Counter[str] = Counter()
    for number in range(count):
        kind = str(inputs.rng.choice(list(SHARES), p=list(SHARES.values())))
        try:
            one_input(kind, subject, inputs, guarantees)
        except ValueError:
            done[f"{kind} rejected"] += 1
        except Exception as error:
            raise Violation(f"input {number}, {kind}: {error!r}") from error
        done[kind] += 1
    return done


def one_input(kind: str, subject: ChecksAndGuard, inputs: Inputs, guarantees: Guarantees) -> None:
    """Send one input."""
    now_ns = inputs.time()
    if kind == "state":
        subject.take_state(inputs.next_state(), now_ns)
    elif kind == "steering":
        subject.take_steering(inputs.number(guarantees.last, 0.05), now_ns)
    elif kind == "path":
        subject.take_path(inputs.path(), now_ns)
    else:
        answer = subject.tick(now_ns)
        if answer is not None:
            guarantees.check(answer)


def guard_drive(seed: int, drive: int, count: int) -> Counter[str]:
    """Send inputs to checks and guard in one drive; the shipped limits alternate between drives.

    Args:
        seed: Seed of all drives.
        drive: Number of this drive; seed and number determine the inputs.
        count: Number of inputs.

    Returns:
        Number of inputs of each kind, of rejections, and of clipped commands.

    Raises:
        Violation: Names the number of the input.
    """
    limits = sorted(shipped("guards"))[drive % len(shipped("guards"))]
    inputs = Inputs([seed, drive])
    subject = ChecksAndGuard(inputs.number, limits)
    with np.errstate(all="ignore"):
        done = fuzz_guard(subject, inputs, Guarantees(limits), count)
    done.update({f"state {cause}": n for cause, n in subject.filter.rejected.items()})
    done.update({f"clipped {limit}": n for limit, n in subject.guard.count.items()})
    return done
