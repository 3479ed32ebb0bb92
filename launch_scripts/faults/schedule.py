"""Fault schedule of a drive, and the stream of messages to which it is applied."""

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Annotated, NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_msgs_config.validation import Checked, check_range, choice, described, number
from launch_scripts.faults.kinds import FAULT_KINDS
from launch_scripts.faults.messages import KEPT, FaultState, Message, Window

SEED = number(0, 2**31 - 1, "", "Seed of the faults.")


@dataclass(frozen=True, kw_only=True)
class Fault(Checked):
    """One fault; times count from the start of the drive."""

    kind: Annotated[str, choice(tuple(FAULT_KINDS), "Kind of the fault.")]
    start: Annotated[float, number(0.0, 1.0e5, "s", "Time at which the fault begins.")]
    duration: Annotated[float, number(1.0e-3, 1.0e5, "s", "Duration of the fault.")]
    amount: (
        Annotated[
            float,
            number(
                -1.0e6, 1.0e6, "", "Size; meaning, unit, bounds and default depend on the kind."
            ),
        ]
        | None
    ) = None
    field: Annotated[
        str, choice(VehicleState._fields[1:], "Field of the state, for the kind nan.")
    ] = "x"

    def __post_init__(self) -> None:
        """Check the fields by the bounds of the kind, and set its default amount."""
        super().__post_init__()
        allowed = FAULT_KINDS[self.kind].amount
        if allowed is None:
            if self.amount is not None:
                raise ValueError(f"amount = {self.amount!r} is not allowed: {self.kind} has none")
        elif self.amount is None:
            object.__setattr__(self, "amount", allowed.default)
        else:
            check_range("amount", self.amount, number(allowed.low, allowed.high, allowed.unit))

    @property
    def window(self) -> Window:
        """Time window of the fault."""
        start_ns = round(self.start * NANOSECONDS)
        return Window(start_ns, start_ns + round(self.duration * NANOSECONDS))

    @property
    def mirrored(self) -> "Fault":
        """Fault with left and right exchanged."""
        if self.amount is None or not FAULT_KINDS[self.kind].sided:
            return self
        return replace(self, amount=-self.amount)


class FaultSchedule(NamedTuple):
    """Faults of a drive."""

    faults: Annotated[tuple[Fault, ...], described("Faults.", most=10_000)]
    seed: Annotated[int, SEED] = 0


def load_faults(name: str) -> FaultSchedule:
    """Load a fault file by shipped name or path.

    Raises:
        ValueError: File, key, value and bound.
    """
    return load(FaultSchedule, find("faults", name))


class Injector:
    """Queue of messages that applies a schedule of faults.

    The same schedule and the same messages give the same result. Each fault has its own random
    generator, so an additional fault does not change the others.
    """

    def __init__(self, schedule: FaultSchedule) -> None:
        """Start without messages at the start of a drive."""
        self.history: dict[str, deque[Message]] = {}
        faults = [
            FaultState(
                fault.kind,
                fault.window,
                fault.amount or 0.0,
                fault.field,
                np.random.default_rng([schedule.seed, i]),
                self.history,
            )
            for i, fault in enumerate(schedule.faults)
        ]
        self.later = sorted(faults, key=lambda each: each.window.start_ns, reverse=True)
        """Future faults, the next one last."""
        self.current: list[FaultState] = []
        self.waiting: list[tuple[int, int, Message]] = []
        """Heap of arrival [ns], order of insertion, and message."""
        self.order = count()

    def active(self, now_ns: int) -> list[FaultState]:
        """Return the active faults; time must not decrease between calls [ns]."""
        while self.later and self.later[-1].window.start_ns <= now_ns:
            self.current.append(self.later.pop())
        self.current = [each for each in self.current if now_ns < each.window.end_ns]
        return self.current

    def put(self, message: Message) -> None:
        """Apply the active faults to a message and queue the result."""
        messages: Sequence[Message] = [message]
        for fault in self.active(message.arrival_ns):
            kind = FAULT_KINDS[fault.kind]
            if kind.change and message.topic in kind.topics:
                messages = [out for each in messages for out in kind.change(each, fault)]
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
        return any(each.kind == kind for each in self.active(now_ns))

    def clock_ns(self, now_ns: int) -> int:
        """Return the time of the controller's own clock [ns]."""
        jumps = (each.amount for each in self.active(now_ns) if each.kind == "clock_jump")
        return now_ns + round(sum(jumps) * NANOSECONDS)
