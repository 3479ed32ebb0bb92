"""Signals, kills and second nodes: what the car receives when a process goes, and comes back."""

import os
import signal
import time
from collections.abc import Callable, Iterator

from tests.workshop.attacks.attempts import Attempt, Choice
from tests.workshop.attacks.live import Session, attacks_on, parameters_of

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals after which a node leaves a stop request."""
READY = 60.0
"""Longest time until a node that was started again is ready [s]."""
NOTICED = 1.5
"""Longest time from a fault to a stop request, beyond twice the auditor's own delay [s]."""
START_TOLERANCE = 0.01
"""Movement of the wheel between the start of a controller and its first command [rad]."""
SETTINGS = {0.1: "table3", 0.02: "50hz", 0.01: "100hz"}


def attempts(choice: Choice) -> Iterator[Attempt]:
    """End, stop and double the nodes at 10 Hz; kill controllers in a bend at 50 and 100 Hz."""
    attacks: dict[str, Callable[[Session], object]] = {
        f"{number.name} to the controller": restarting("controller", number) for number in SIGNALS
    }
    attacks |= {f"{number.name} to the gate": restarting("gate", number) for number in SIGNALS}
    attacks["SIGSTOP, SIGCONT to the controller"] = freezing("controller")
    attacks["SIGSTOP, SIGCONT to the gate"] = freezing("gate")
    attacks["two controllers"] = lambda live: doubling(live, "controller")
    attacks["two gates"] = lambda live: doubling(live, "gate")
    attacks["SIGKILL to the controller"] = restarting("controller", signal.SIGKILL)
    attacks["SIGKILL to the gate"] = restarting("gate", signal.SIGKILL)
    yield from attacks_on(choice, attacks, parameters_of())
    for period in (0.02, 0.01):
        name = f"SIGKILL in a bend at {1.0 / period:.0f} Hz"
        kill = {name: restarting("controller", signal.SIGKILL)}
        parameters = parameters_of(settings=SETTINGS[period])
        yield from attacks_on(choice, kill, parameters, period)


def restarting(name: str, number: int) -> Callable[[Session], object]:
    """Return an attack that ends a node and starts it again; the audit goes on all the time."""

    def attack(live: Session) -> str:
        code = live.kill(name, number)
        stopped = live.auditor.run(NOTICED + 2.0 * live.auditor.lag, lambda: has_stop(live))
        live.auditor.awaits_start = name == "controller"
        live.start(name)
        live.auditor.run(READY, lambda: is_ready(live, name))
        live.auditor.run(2.0, lambda: not live.auditor.awaits_start)
        most = live.auditor.limits.rate(0.0) * live.auditor.period + START_TOLERANCE
        if live.auditor.start_step > most:
            return f"the first command is {live.auditor.start_step:.3f} rad from the wheel"
        if number != signal.SIGKILL and code not in (0, 128 + number):
            return f"exit code {code}: {live.nodes.last_line(name)}"
        if name == "controller" or number != signal.SIGKILL:
            return "" if stopped else "nobody requests a stop"
        return ""  # the vehicle notices the end of a killed gate, by deadline or lease

    return attack


def has_stop(live: Session) -> bool:
    """Return whether a stop was requested."""
    return live.auditor.is_stopping


def is_ready(live: Session, name: str) -> bool:
    """Return whether a node has logged that it is ready, or has ended."""
    log = live.nodes.log(name).read_text("utf-8", "replace")
    return ": ready\n" in log or live.nodes.running[name].poll() is not None


def freezing(name: str) -> Callable[[Session], object]:
    """Return an attack that stops a process for two seconds and continues it."""

    def attack(live: Session) -> str:
        process = live.nodes.running[name]
        os.killpg(process.pid, signal.SIGSTOP)
        live.auditor.run(2.0)
        noticed = has_stop(live)
        os.killpg(process.pid, signal.SIGCONT)
        live.auditor.run(1.0)
        return "" if noticed or name == "gate" else "nobody requests a stop"

    return attack


def doubling(live: Session, name: str) -> str:
    """Run a second node of a kind; with a second controller, a stop must be requested."""
    live.auditor.audits_commands = False
    second = f"second_{name}"
    parameters = dict(live.parameters[name])
    live.parameters = {**live.parameters, second: parameters}
    module = {"controller": "ampc_ros.nodes.controller_node", "gate": "ampc_ros.nodes.gate_node"}
    live.nodes.start(second, module[name], parameters)
    live.auditor.run(READY, lambda: is_ready(live, second))
    begin = time.monotonic()
    noticed = live.auditor.run(NOTICED + 2.0 * live.auditor.lag + 1.0, lambda: has_stop(live))
    took = time.monotonic() - begin
    live.kill(second, signal.SIGINT)
    del live.nodes.running[second]
    live.auditor.last.clear()
    live.auditor.audits_commands = True
    return "" if noticed or name == "gate" else f"nobody requests a stop within {took:.1f} s"
