"""Nodes as a user starts them, which are attacked one attack after the other."""

import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from ampc_msgs_config.types import NANOSECONDS
from launch_scripts.run.processes import Processes, ros_environment
from tests.workshop.attacks.attempts import Attempt, Choice, one_line
from tests.workshop.attacks.auditor import RADIUS, SILENCE, Auditor, new_context

MODULES = {
    "controller": "ampc_ros.nodes.controller_node",
    "gate": "ampc_ros.nodes.gate_node",
    "planner": "ampc_ros.nodes.planner_node",
}
START = 240.0
"""Longest time until the car drives, with compilation [s]."""
RECOVERY = 25.0
"""Longest time until the car drives again; a killed node stays visible for 20 s [s]."""
WATCHED = 0.8
"""Time for which the commands are watched after an attack [s]."""
RESET_PERIOD = 1.0
LARGEST_ERROR = 1.5
"""Distance from the circle beyond which the car is placed on it again [m]."""
REPEATED = 2
"""Repetitions of an inconclusive attempt."""
STARVED = 0.3
"""Delay of the auditor's own timer that makes an attempt inconclusive [s]."""


class Session:
    """Controller and gate, and the auditor as their car."""

    def __init__(
        self, nodes: Processes, auditor: Auditor, parameters: Mapping[str, Mapping[str, object]]
    ) -> None:
        """Start the nodes.

        Args:
            nodes: Processes.
            auditor: Car and sensors.
            parameters: Parameters of each node that takes part.
        """
        self.nodes, self.auditor, self.parameters = nodes, auditor, parameters
        self.tracebacks, self.waited_before = 0, 0.0
        for name in parameters:
            self.start(name)
        auditor.publish_path()

    def start(self, name: str) -> None:
        """Start a node in the place of an earlier one; the state of a gate is forgotten."""
        if name == "gate":
            self.auditor.state = ""
        self.nodes.start(name, MODULES[name], self.parameters[name])

    def kill(self, name: str, number: int = signal.SIGKILL) -> int:
        """Send a signal to a node and wait for its end; return its exit code."""
        process = self.nodes.running[name]
        os.killpg(process.pid, number)
        self.auditor.run(15.0, lambda: process.poll() is not None)
        if process.poll() is None:
            process.kill()
        return process.wait()

    def is_driving(self) -> bool:
        """Return whether the gate passes commands on, and the car is near its circle."""
        auditor = self.auditor
        error = abs(((auditor.x**2 + (auditor.y - RADIUS) ** 2) ** 0.5) - RADIUS)
        moves = auditor.state == "driving" and auditor.v > 1.0
        return moves and error < LARGEST_ERROR and auditor.age() < SILENCE

    def recover(self, limit: float = RECOVERY) -> bool:
        """Take back stops until the car drives for half a second; return whether it does."""
        auditor, steps = self.auditor, int(limit / RESET_PERIOD)
        for _ in range(steps):
            if auditor.run(RESET_PERIOD, self.is_driving):
                auditor.run(0.5)
                if self.is_driving():
                    return True
            error = abs(((auditor.x**2 + (auditor.y - RADIUS) ** 2) ** 0.5) - RADIUS)
            if error > LARGEST_ERROR:
                auditor.home()
            auditor.reset()
        return False

    def ended(self) -> str:
        """Return which node has ended or written a traceback since the last call."""
        for name, code in self.nodes.ended().items():
            return f"{name} ended with {code}: {self.nodes.last_line(name)}"
        lines = {name: self.nodes.lines(name) for name in self.nodes.running}
        found = {n: sum(line.startswith("Traceback") for line in each) for n, each in lines.items()}
        before, self.tracebacks = self.tracebacks, sum(found.values())
        return f"traceback: {found}" if self.tracebacks > before else ""

    def waited(self) -> float:
        """Return how long the nodes have waited for a processor since their start [s]."""
        waits = [0]
        for process in self.nodes.running.values():
            with suppress(OSError):  # it has ended
                text = Path(f"/proc/{process.pid}/schedstat").read_text("ascii")
                waits.append(int(text.split()[1]))
        return sum(waits) / NANOSECONDS

    def audit(self) -> tuple[str, str]:
        """Return failure and doubt of an attack from what the auditor has heard."""
        auditor = self.auditor
        failure, doubt = self.ended(), ""
        if not failure and auditor.violations:
            failure = f"{len(auditor.violations)} unsafe: {auditor.violations[0]}"
        if not failure and auditor.doubts:
            doubt = auditor.doubts[0]
        silence = auditor.silence()
        if not failure and silence > SILENCE + 2.0 * auditor.lag and not auditor.is_stopping:
            failure = f"no command for {silence:.2f} s, and no stop is requested"
            waited = self.waited() - self.waited_before
            if silence < SILENCE + 2.0 * auditor.lag + waited:
                failure, doubt = "", f"nodes waited {waited:.2f} s for a processor: {failure}"
        if failure and auditor.lag > STARVED and "ended" not in failure:
            failure, doubt = "", f"auditor {auditor.lag:.2f} s late: {failure}"
        return one_line(failure), one_line(doubt)

    def attack(self, area: str, name: str, attack: Callable[[], object]) -> Attempt:
        """Run one attack on a driving car, and watch the commands.

        Args:
            area: Name of the area.
            name: Name of the attack.
            attack: Runs the auditor while it attacks; returns a failure of its own, if a text.
        """
        self.auditor.forget()
        self.waited_before = self.waited()
        answer = attack()
        own = answer if isinstance(answer, str) else ""
        self.auditor.faulty = None
        self.auditor.run(WATCHED)
        failure, doubt = self.audit()
        failure = failure or one_line(own)
        if not failure and not doubt and not self.recover():
            failure = f"does not drive again: {self.auditor.state}, v = {self.auditor.v:.1f} m/s"
        return Attempt(area, name, failure, doubt)


@contextmanager
def session(
    logs: Path,
    parameters: Mapping[str, Mapping[str, object]],
    period: float = 0.1,
    *,
    simulated: bool = False,
    limit: float = START,
) -> Iterator[Session]:
    """Start nodes and yield them when the car drives.

    Raises:
        ValueError: The car does not drive.
    """
    os.environ.update(ros_environment())
    context = new_context()
    auditor = Auditor(context, period, simulated=simulated)
    try:
        with Processes(logs) as nodes:
            live = Session(nodes, auditor, parameters)
            if not live.recover(limit):
                lines = {name: nodes.last_line(name) for name in nodes.running}
                raise ValueError(f"the car does not drive: {auditor.state}, {lines}")
            live.ended()
            yield live
    finally:
        auditor.destroy_node()  # type: ignore[no-untyped-call]
        context.try_shutdown()


def parameters_of(**more: object) -> dict[str, dict[str, object]]:
    """Return the parameters of controller and gate."""
    common: dict[str, object] = {"static_path": True, "store_estimates": False} | more
    gate = {key: value for key, value in more.items() if key in ("settings", "use_sim_time")}
    return {"gate": gate, "controller": common}


def attacks_on(
    choice: Choice,
    attacks: Mapping[str, Callable[[Session], object]],
    parameters: Mapping[str, Mapping[str, object]],
    period: float = 0.1,
    *,
    simulated: bool = False,
) -> Iterator[Attempt]:
    """Run attacks on one session; a failure is followed by another session."""
    left = [name for name in attacks if choice.has(name)]
    number, repeated = 0, 0
    while left:
        number += 1
        logs = choice.folder / f"{choice.area}_{period:g}_{number}"
        with session(logs, parameters, period, simulated=simulated) as live:
            while left:
                attempt = live.attack(choice.area, left[0], partial(attacks[left[0]], live))
                if attempt.outcome == "inconclusive" and repeated < REPEATED:
                    repeated += 1
                    continue
                yield attempt
                left.pop(0)
                repeated = 0
                if attempt.outcome == "failed":
                    break
