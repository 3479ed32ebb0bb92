"""Simulated clocks that stop, jump, go back, or are not there."""

import time
from collections.abc import Callable, Iterator
from functools import partial

from ampc_msgs_config.types import NANOSECONDS
from tests.workshop.attacks.attempts import Attempt, Choice
from tests.workshop.attacks.live import Session, attacks_on, parameters_of, session

PAUSE = 2.0
"""Time for which a clock stands [s]."""
LIMIT = 0.5
"""Longest time without a command, or a stop request, in wall time [s]."""


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Attack a controller with `use_sim_time` by its clock; the gate has a steady one."""
    attacks: dict[str, Callable[[Session], object]] = {
        "stops while odometry goes on": stopping,
        "stops, starts again": stopping_twice,
        "half as fast": partial(running, 0.5),
        "twice as fast": partial(running, 2.0),
    }
    for seconds in (0.2, 3.0, 1000.0, -0.2, -3.0):
        attacks[f"jumps by {seconds:+g} s"] = partial(jumping, seconds)
    yield from attacks_on(choice, attacks, parameters_of(use_sim_time=True), simulated=True)
    if choice.has("none"):
        yield without_clock(choice)


def running(rate: float, live: Session) -> None:
    """Run the clock at another rate for a time."""
    live.auditor.clock_rate = rate
    live.auditor.run(PAUSE)
    live.auditor.clock_rate = 1.0


def stopping(live: Session) -> str:
    """Stop the clock for a time; a stop request must follow within the limit.

    Time in which the nodes wait for a processor is added to the limit.
    """
    live.auditor.clock_rate = 0.0
    begin, waited = time.monotonic(), live.waited()
    live.auditor.run(PAUSE, lambda: live.auditor.is_stopping)
    took, waited = time.monotonic() - begin, live.waited() - waited
    allowed = LIMIT + 2.0 * live.auditor.lag + waited
    live.auditor.run(max(PAUSE - took, 0.0))
    live.auditor.clock_rate = 1.0
    return "" if took <= allowed else f"no stop request within {allowed:.2f} s: {took:.2f} s"


def stopping_twice(live: Session) -> str:
    """Stop the clock, let it run for a second, and stop it again."""
    failure = stopping(live)
    live.auditor.run(1.0)
    return failure or stopping(live)


def jumping(seconds: float, live: Session) -> None:
    """Let the clock jump once."""
    assert live.auditor.simulated_ns is not None
    jump_ns = int(seconds * NANOSECONDS)
    live.auditor.simulated_ns = max(live.auditor.simulated_ns + jump_ns, NANOSECONDS)
    live.auditor.run(1.0)


def without_clock(choice: Choice) -> Attempt:
    """Start with `use_sim_time` where nobody publishes a clock: no command, and a diagnosis."""
    name = "none"
    try:
        with session(choice.folder / "none", parameters_of(use_sim_time=True), limit=15.0):
            return Attempt(choice.area, name, "the car drives without a clock")
    except ValueError as error:
        text = str(error)
    failure = "" if "clock" in text else f"the clock is not named: {text}"
    return Attempt(choice.area, name, failure)
