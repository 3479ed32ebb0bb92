"""Fuzzing of the gate: no exception, and nothing outside its limits, whatever arrives and when."""

import math
from collections import Counter

import numpy as np

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.gate.core import Gate, GateOutput
from ampc_ros.gate.following import MeasuredPose
from ampc_ros.gate.plan import PlanPoint, make_plan
from ampc_ros.gate.settings import STOPS, GateSettings, GateState
from ampc_ros.supervision.guard import LONGEST_PAUSE, bounds
from tests.workshop.fuzz.fuzz_guard import Inputs, Violation

KINDS = {
    "step": 0.4, "command": 0.25, "speed": 0.08, "odometry": 0.1, "measured": 0.08,
    "plan": 0.05, "event": 0.01, "intruders": 0.01, "reset": 0.02,
}  # fmt: skip
"""Shares of the inputs."""
PAUSES = (0.0, 0.001, 0.02, 0.1, 0.3, 1.5, 40.0, -0.1)
"""Times between two inputs; the clock of a node never goes back, this one does [s]."""
PAUSE_SHARES = (0.3, 0.3, 0.34, 0.03, 0.01, 0.01, 0.005, 0.005)
ACCURACY = 1e-9


class WatchedGate:
    """A gate with random inputs, whose outputs are checked by the limits alone."""

    def __init__(self, inputs: Inputs, limits: str, period: float) -> None:
        """Create a gate of the ordinary car.

        Args:
            inputs: Random numbers.
            limits: Shipped limits of the guard.
            period: Period of the commands [s].
        """
        self.limits = load(GuardLimits, find("guards", limits))
        vehicle = find("vehicles", "ordinary")
        self.chassis = load_section(ChassisParameters, vehicle, "chassis")
        self.gate = Gate(self.limits, self.chassis, GateSettings(period=period))
        self.inputs, self.now, self.period = inputs, 100.0, period
        self.last: GateOutput | None = None
        self.angle, self.last_at = 0.0, 0.0

    def send(self, kind: str) -> str:
        """Send one input and return what has become of it."""
        rng, number = self.inputs.rng, self.inputs.number
        self.now += float(rng.choice(PAUSES, p=PAUSE_SHARES))
        gate, now = self.gate, self.now
        if kind == "step":
            speed = gate.speed_at(now)
            self.check(gate.step(now), speed)
            self.last_at = now
            return f"state {gate.state.value}"
        if kind == "command":
            self.angle = number(0.9 * self.angle, 0.02)
            refused = bool(gate.take_command(self.angle, number(0.0, 0.2), now))
            self.angle = self.angle if abs(self.angle) < 1.0 else 0.0
        elif kind == "speed":
            refused = bool(gate.take_speed(number(12.0, 4.0), now))
        elif kind == "plan":
            refused = not self.send_plan()
        elif kind == "reset":
            refused = bool(gate.reset(now))
        else:
            refused = False
            if kind == "odometry":
                pose = MeasuredPose(
                    number(0.0, 5.0), number(0.0, 5.0), number(0.0, 1.0), number(12.0, 4.0), 0.0
                )
                gate.take_odometry(pose, now)
            elif kind == "measured":
                gate.take_measured(number(self.angle, 0.05), now)
            elif kind == "event":
                gate.suspect("event")
            else:
                gate.intruders = "two" if rng.random() < 0.2 else ""
        return f"{kind} {'refused' if refused else 'used'}"

    def send_plan(self) -> bool:
        """Send a plan, and return whether it is valid."""
        number, count = self.inputs.number, int(self.inputs.rng.integers(1, 20))
        hostile = self.inputs.rng.random() < 0.3
        pick = number if hostile else (lambda usual, _: usual)
        points = [
            PlanPoint(
                pick(0.1 * i, 0.0),
                pick(0.01 * i, 0.1),
                pick(float(i), 0.1),
                9.0,
                0.0,
                pick(float(i), 1.0),
                pick(0.0, 1.0),
            )
            for i in range(count)
        ]
        try:
            self.gate.take_plan(make_plan(points), self.now)
        except ValueError:
            return False
        return True

    def check(self, output: GateOutput | None, speed: float) -> None:
        """Raise a Violation unless an output lies inside the limits of a speed [m/s]."""
        gate, last, self.last = self.gate, self.last, output
        if (output is None) != (gate.state is GateState.WAITING):
            raise Violation(f"{output} in state {gate.state.value}")
        if output is None:
            return
        if not all(map(math.isfinite, output[:3])):
            raise Violation(f"{output} is not finite")
        if abs(output.angle) > max(self.limits.max_angle) + ACCURACY:
            raise Violation(f"{output} is beyond the largest angle")
        if not 0.0 <= output.speed <= 100.0:
            raise Violation(f"{output} has an impossible speed")
        bound = bounds(self.limits, self.chassis, speed)
        rate = min(bound.rate, bound.jerk)
        if abs(output.rate) > rate + ACCURACY:
            raise Violation(f"{output} turns faster than {rate}")
        if last is None:
            return
        step = abs(output.angle - last.angle)
        reach = rate * LONGEST_PAUSE * self.period
        if step > reach + ACCURACY:
            raise Violation(f"the angle jumps from {last.angle!r} to {output.angle!r}")
        beyond = max(abs(output.angle) - bound.angle, 0.0)
        if beyond > ACCURACY and abs(output.angle) > abs(last.angle) + ACCURACY:
            raise Violation(f"{output} moves away from the limits")
        if gate.state in STOPS and last.speed < output.speed and self.now >= self.last_at:
            raise Violation(f"the speed of a stop rises from {last.speed} to {output.speed}")


def gate_drive(seed: int, drive: int, count: int) -> Counter[str]:
    """Send inputs to a gate in one drive; limits and period alternate between drives.

    Args:
        seed: Seed of all drives.
        drive: Number of this drive; seed and number determine the inputs.
        count: Number of inputs.

    Returns:
        Number of inputs used and refused, of steps in each state, and of clipped outputs.

    Raises:
        Violation: Names the number of the input.
    """
    limits = sorted(shipped("guards"))[drive % len(shipped("guards"))]
    inputs = Inputs([seed, drive])
    watched = WatchedGate(inputs, limits, (0.1, 0.02, 0.01)[drive % 3])
    done: Counter[str] = Counter()
    kinds = inputs.rng.choice(list(KINDS), p=list(KINDS.values()), size=count)
    with np.errstate(all="ignore"):
        for number, kind in enumerate(kinds):
            try:
                outcome = watched.send(str(kind))
            except Violation as violation:
                raise Violation(f"input {number}, {kind}: {violation}") from None
            except Exception as error:
                raise Violation(f"input {number}, {kind}: {error!r}") from error
            done[outcome] += 1
    done.update({f"clipped {limit}": n for limit, n in watched.gate.guard.count.items()})
    return done
