"""Ticks that are missing in a bag, and from which tick on a replay is exact.

A controller remembers: a tick can be repeated bit for bit only from the memory after the tick
before. It is known after the first tick of a process, and after each `controller/memory`.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ampc_msgs_config.topics import MEMORY
from ampc_ros.configuration import Configuration
from ampc_ros.supervision.memory import restore
from launch_scripts.replaying.recorded_run import RecordedRun, RecordedTick, StoredMemory

MOST_GAPS = 5
"""Most gaps that are described."""
NO_MEMORY = f"no {MEMORY} follows, so no tick behind them can be repeated exactly"


class Gap(NamedTuple):
    """Ticks that are missing."""

    first: int
    """Number of the first of them."""
    last: int
    exact_from: int | None
    """Number of the first tick behind it that can be repeated exactly; None: there is none."""


class History(NamedTuple):
    """Ticks with what is known about the memory of the controller."""

    ticks: list[RecordedTick]
    gaps: list[Gap]

    @property
    def missing(self) -> int:
        """Number of missing ticks."""
        return sum(gap.last - gap.first + 1 for gap in self.gaps)

    def all_compared(self) -> "History":
        """Return the same history with all ticks counted as exact."""
        return self._replace(ticks=[tick._replace(is_exact=True) for tick in self.ticks])


def history_of(run: RecordedRun, config: Mapping[int, Configuration]) -> History:
    """Return the ticks of a run with what is known about the memory of the controller.

    Args:
        run: Recorded run.
        config: Configurations by the number that a tick refers to.
    """
    by_number = defaultdict[int, list[StoredMemory]](list)
    for memory in run.memories:
        by_number[memory.commands].append(memory)
    history, before, is_exact = History([], []), 0, True
    for tick in run.ticks:
        number, data = int(tick.values.get("commands", before + 1)), b""
        if number not in (1, before + 1):
            first = before + 1 if number > before else 1
            history.gaps.append(Gap(first, number - 1, None))
            is_exact = False
        elif number == 1:  # a process begins
            is_exact = True
        if not is_exact:
            data = usable_memory(by_number.get(number - 1, []), tick, config)
            is_exact = bool(data)
        if data:
            history.gaps[-1] = history.gaps[-1]._replace(exact_from=number)
        history.ticks.append(tick._replace(is_exact=is_exact, memory=data))
        before = number
    return history


def usable_memory(
    memories: Sequence[StoredMemory], tick: RecordedTick, config: Mapping[int, Configuration]
) -> bytes:
    """Return the memory before a tick, of several that nearest in the bag; empty: there is none."""
    for memory in sorted(memories, key=lambda each: abs(each.position - tick.position)):
        try:
            restore(memory.data, config)
            return memory.data
        except ValueError:
            continue
    return b""


def describe_gaps(history: History) -> list[str]:
    """Return one sentence for each gap, and one for those that are too many to describe."""
    lines = []
    for number, gap in enumerate(history.gaps[:MOST_GAPS], 1):
        count = gap.last - gap.first + 1
        ticks = f"{count} ticks are missing from tick {gap.first} on" if count > 1 else ""
        ticks = ticks or f"tick {gap.first} is missing"
        exact = f"exact from tick {gap.exact_from} on" if gap.exact_from else NO_MEMORY
        if not gap.exact_from and number < len(history.gaps):
            exact = "no tick before the next gap can be repeated exactly"
        lines.append(f"{ticks}: {exact}")
    if len(history.gaps) > MOST_GAPS:
        lines.append(f"{len(history.gaps) - MOST_GAPS} further gaps")
    return lines
