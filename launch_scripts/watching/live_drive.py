"""State of a running drive as text: a picture for a terminal, one line elsewhere."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from rich.console import Group
from rich.table import Table
from rich.text import Text

from ampc_msgs_config.types import REASONS, RUNGS
from launch_scripts.reporting.pages import NO_NUMBER, duration_text, length_text

HISTORY = 60
"""Values of a sparkline."""
BLOCKS = "\u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"
LATE_AGE = 1.0
"""Wall time without a message after which the age of a topic is marked [s]."""


class TopicState(NamedTuple):
    """Rate and age of a topic, in wall time."""

    name: str
    publishers: int
    rate: float
    """Messages a second; nan: fewer than three in the last seconds [1/s]."""
    age: float
    """Time since the last message; nan: none [s]."""


class LiveDrive(NamedTuple):
    """Present state of a drive."""

    namespace: str
    values: dict[str, float]
    """Quantities of `controller/tick` by name, `speed` and `target_speed` [m/s]."""
    gate: str
    """State of the gate; empty: unknown."""
    stop: bool | None
    """Whether a stop is requested; None: unknown."""
    topics: list[TopicState]
    histories: dict[str, list[float]]
    """Last values, oldest first, by quantity."""
    mismatches: list[str]
    """One sentence for each publisher whose messages cannot arrive."""

    def value(self, name: str) -> float:
        """Return a quantity; nan: unknown."""
        return self.values.get(name, math.nan)

    @property
    def has_begun(self) -> bool:
        """Whether a state or a tick has arrived."""
        return math.isfinite(self.value("speed")) or "rung" in self.values


def waits_for(drive: LiveDrive) -> str:
    """Return what a drive that has not begun lacks, in one sentence."""
    silent = [each.name for each in drive.topics if each.publishers and math.isnan(each.age)]
    absent = [each.name for each in drive.topics if not each.publishers]
    parts = [f"no publisher of {', '.join(absent)}"] if absent else []
    parts += [f"no message yet on {', '.join(silent)}"] if silent else []
    return f"waiting for a drive in {drive.namespace}: {'; '.join(parts) or 'no state'}"


def number_text(value: float, unit: str, digits: int = 2) -> str:
    """Return a number with its sign and unit."""
    return f"{value:+.{digits}f} {unit}" if math.isfinite(value) else NO_NUMBER


def fallback_text(drive: LiveDrive) -> str:
    """Return the rung of the fallback chain and its reason."""
    rung, reason = drive.value("rung"), drive.value("reason")
    if not math.isfinite(rung):
        return NO_NUMBER
    text = word(RUNGS, rung)
    return text if not reason or math.isnan(reason) else f"{text} ({word(REASONS, reason)})"


def word(words: Sequence[str], index: float) -> str:
    """Return the word of an index, or the number where there is none."""
    known = 0 <= index < len(words)
    return words[int(index)].replace("_", " ") if known else f"{index:g}"


def rows_of_drive(drive: LiveDrive) -> list[tuple[str, str, str]]:
    """Return title, value and history (key) of each quantity."""
    error, degrees = drive.value("cross_track_error"), 180.0 / math.pi
    stop = {None: NO_NUMBER, False: "no", True: "STOP REQUESTED"}[drive.stop]
    sign = "+" if error > 0 else ""
    return [
        ("cross-track error", f"{sign}{length_text(error)}", "cross_track_error"),
        ("heading error", number_text(degrees * drive.value("heading_error"), "deg"), ""),
        ("steering", number_text(degrees * drive.value("steering"), "deg"), "steering"),
        ("speed", speed_text(drive), "speed"),
        ("fallback", fallback_text(drive), ""),
        ("gate", drive.gate or NO_NUMBER, ""),
        ("stop request", stop, ""),
        ("solve time", duration_text(drive.value("solve_time")), ""),
    ]


def speed_text(drive: LiveDrive) -> str:
    """Return the driven and the target speed."""
    speed, target = drive.value("speed"), drive.value("target_speed")
    driven = f"{speed:.2f}" if math.isfinite(speed) else NO_NUMBER
    return f"{driven} of {target:.2f} m/s" if math.isfinite(target) else f"{driven} m/s"


def line_of_drive(drive: LiveDrive) -> str:
    """Return the state in one line, for a log."""
    if not drive.has_begun:
        return waits_for(drive)
    cells = [f"{title} {text}" for title, text, _ in rows_of_drive(drive)]
    rates = [f"{each.name} {rate_text(each)}" for each in drive.topics if each.rate == each.rate]
    return ", ".join([*cells, *rates, *drive.mismatches])


def rate_text(topic: TopicState) -> str:
    """Return the rate of a topic."""
    return f"{topic.rate:.0f} Hz" if math.isfinite(topic.rate) else NO_NUMBER


def sparkline(values: Sequence[float]) -> str:
    """Return a line of blocks, from the smallest to the largest value."""
    if not values:
        return ""
    low, span = min(values), max(values) - min(values)
    last = len(BLOCKS) - 1
    return "".join(BLOCKS[round(last * (v - low) / span) if span else 0] for v in values)


def picture_of_drive(drive: LiveDrive) -> Group:
    """Return the state as tables for a terminal."""
    if not drive.has_begun:
        return Group(Text(waits_for(drive), style="yellow"), *problems(drive))
    table = Table(box=None, show_header=False, pad_edge=False)
    for title, text, history in rows_of_drive(drive):
        line = sparkline(drive.histories.get(history, ()))
        table.add_row(Text(title), Text(text, style=style_of(title, text)), Text(line, "cyan"))
    traffic = Table(box=None, pad_edge=False, header_style="bold")
    for head in ("topic", "rate", "age"):
        traffic.add_column(head, justify="left" if head == "topic" else "right")
    for topic in drive.topics:
        is_old = topic.age > LATE_AGE and math.isfinite(topic.rate)
        age = duration_text(topic.age) if topic.publishers else "no publisher"
        traffic.add_row(topic.name, rate_text(topic), Text(age, "yellow" if is_old else ""))
    return Group(table, Text(), traffic, *problems(drive))


def style_of(title: str, text: str) -> str:
    """Return the style of a value: red where the drive is not normal."""
    normal = {
        "fallback": ("optimal", "slack", NO_NUMBER),
        "gate": ("driving", "waiting", NO_NUMBER),
        "stop request": ("no", NO_NUMBER),
    }
    if title not in normal:
        return "bold"
    return "green" if text.startswith(normal[title]) else "bold red"


def problems(drive: LiveDrive) -> list[Text]:
    """Return one line for each publisher whose messages cannot arrive."""
    return [Text(sentence, style="red") for sentence in drive.mismatches]
