"""Faults as data: what goes wrong, when, for how long; and the stream of messages under them."""

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import build, find, read
from ampc_msgs_config.parameters import Checked, check_range, choice, number
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from launch_scripts.faults.kinds import KINDS
from launch_scripts.faults.messages import KEPT, Memory, Message, Window

SEEDS = {"low": 0, "high": 2**31 - 1, "unit": ""}
MOST = 10_000
"""Faults in a file."""


@dataclass(frozen=True, kw_only=True)
class Fault(Checked):
    """One fault; times count from the start of the drive."""

    kind: str = choice(*KINDS)
    start: float = number(0.0, 1.0e5, "s")
    duration: float = number(1.0e-3, 1.0e5, "s")
    amount: float | None = None
    """How much; each kind has its own meaning, unit and default."""
    field: str = choice(*VehicleState._fields[1:], default="x")
    """Of the state, for `nan`."""

    def __post_init__(self) -> None:
        """Check, with the bounds of the kind; an amount that is left out is the kind's own."""
        super().__post_init__()
        allowed = KINDS[self.kind].amount
        if allowed is None:
            if self.amount is not None:
                raise ValueError(f"amount = {self.amount!r}: {self.kind} has none")
        elif self.amount is None:
            object.__setattr__(self, "amount", allowed.default)
        else:
            check_range("amount", self.amount, allowed._asdict())

    @property
    def window(self) -> Window:
        """When it is there."""
        start_ns = round(self.start * NANOSECONDS)
        return Window(start_ns, start_ns + round(self.duration * NANOSECONDS))

    @property
    def mirrored(self) -> "Fault":
        """The same fault with left and right exchanged."""
        if self.amount is None or not KINDS[self.kind].sided:
            return self
        return replace(self, amount=-self.amount)


class Plan(NamedTuple):
    """All that is to go wrong in a drive."""

    faults: tuple[Fault, ...]
    seed: int = 0


def load_plan(name: str) -> Plan:
    """Read a file of faults, or a shipped one.

    Raises:
        ValueError: Names file, key, value and bound.
    """
    file = find("faults", name)
    content = read(file)
    for key in content:
        if key not in ("seed", "faults"):
            raise ValueError(f"{file}: unknown key {key!r}; known are seed, faults")
    entries, seed = content.get("faults"), content.get("seed", 0)
    if not isinstance(entries, list) or not 0 < len(entries) <= MOST:
        raise ValueError(f"{file}: faults must be a list of 1 to {MOST} faults")
    return Plan(
        tuple(build(Fault, each, f"{file}: faults[{i}]") for i, each in enumerate(entries)),
        checked_seed(file, seed),
    )


def checked_seed(file: Path, seed: object) -> int:
    """Give a seed back, if it is one."""
    try:
        check_range("seed", seed, SEEDS)
        if not isinstance(seed, int):
            raise ValueError(f"seed = {seed!r} must be a whole number")
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error
    return seed


class Active(NamedTuple):
    """A fault with its state."""

    fault: Fault
    memory: Memory


class Injector:
    """Queue of messages that applies a plan of faults.

    The same plan and the same messages give the same result. Each fault has its own random
    generator, so an additional fault does not change the others.
    """

    def __init__(self, plan: Plan) -> None:
        """Start without messages at the start of a drive."""
        faults = []
        for i, fault in enumerate(plan.faults):
            rng = np.random.default_rng([plan.seed, i])
            memory = Memory(fault.window, fault.amount or 0.0, fault.field, rng)
            faults.append(Active(fault, memory))
        self.later = sorted(faults, key=lambda each: each.fault.start, reverse=True)
        """Future faults, the next one last."""
        self.current: list[Active] = []
        self.history: dict[str, deque[Message]] = {}
        self.waiting: list[tuple[int, int, Message]] = []
        """Heap of arrival [ns], order of insertion, and message."""
        self.order = count()

    def faults(self, now_ns: int) -> list[Active]:
        """Return the active faults; time must not decrease between calls [ns]."""
        while self.later and self.later[-1].memory.window.start_ns <= now_ns:
            self.current.append(self.later.pop())
        self.current = [each for each in self.current if each.memory.window.holds(now_ns)]
        return self.current

    def put(self, message: Message) -> None:
        """Apply the active faults to a message and queue the result."""
        messages: Sequence[Message] = [message]
        for fault, memory in self.faults(message.arrival_ns):
            kind = KINDS[fault.kind]
            if kind.change and message.topic in kind.topics:
                memory.history = self.history
                messages = [out for each in messages for out in kind.change(each, memory)]
        for each in messages:
            heapq.heappush(self.waiting, (each.arrival_ns, next(self.order), each))
        self.history.setdefault(message.topic, deque(maxlen=KEPT)).append(message)

    def due(self, now_ns: int) -> list[Message]:
        """Remove and return the messages that have arrived, in the order of arrival [ns]."""
        messages = []
        while self.waiting and self.waiting[0][0] <= now_ns:
            messages.append(heapq.heappop(self.waiting)[2])
        return messages

    @property
    def next_ns(self) -> float:
        """Arrival of the next message; infinite without messages [ns]."""
        return self.waiting[0][0] if self.waiting else float("inf")

    def is_on(self, kind: str, now_ns: int) -> bool:
        """Check whether a fault of a kind is active [ns]."""
        return any(each.fault.kind == kind for each in self.faults(now_ns))

    def clock_ns(self, now_ns: int) -> int:
        """Return the time of the controller's own clock [ns]."""
        faults = (each.fault for each in self.faults(now_ns))
        jumps = (fault.amount or 0.0 for fault in faults if fault.kind == "clock_jump")
        return now_ns + round(sum(jumps) * NANOSECONDS)
