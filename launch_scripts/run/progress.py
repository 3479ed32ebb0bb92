"""Progress of long work with an estimate of the remaining time, with and without a terminal."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

INTERVAL = 10.0
"""Time between two lines without a terminal [s]."""
Advance = Callable[[float, str], object]
"""Receives the amount of work that is done, and what is being done."""


@contextmanager
def show_progress(console: Console, what: str, total: float) -> Iterator[Advance]:
    """Show progress as a bar, or without a terminal as one line at most every INTERVAL.

    Args:
        console: Receives the output.
        what: Name of the work.
        total: Amount of work, in any unit.
    """
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn())
        clocks = TimeElapsedColumn(), TimeRemainingColumn(elapsed_when_finished=True)
        with Progress(*columns, *clocks, console=console) as bar:
            line = bar.add_task(what, total=total)
            yield lambda amount, stage: bar.update(
                line, advance=amount, description=f"{what}: {stage}"
            )
        return
    begin = shown = time.monotonic()
    done = 0.0

    def advance(amount: float, stage: str) -> None:
        nonlocal done, shown
        done, now = done + amount, time.monotonic()
        if now - shown >= INTERVAL and done > 0.0:
            left, shown = (now - begin) * max(total / done - 1.0, 0.0), now
            text = f"{what}: {min(done / total, 1.0):.0%}, {stage}, about {left:.0f} s left"
            console.print(text, markup=False)

    yield advance
