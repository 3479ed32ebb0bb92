"""Kill recorders at random moments, recover their bags, and measure what is lost.

`python -m tests.workshop.proofs.prove_recording [--kills 20] [--seed 1]` publishes the topics of a
control loop in real time, kills the recorder with SIGKILL, recovers the bag and opens the result
with `mcap`, `rosbags` and our reader. Every other run is in simulated time; some of those end
before the simulated clock starts. The exit code is 1 where a second or more is lost, a message is
missing before the end, or a result cannot be opened.
"""

import argparse
import os
import random
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from mcap.reader import make_reader
from rich.console import Console
from rich.table import Table
from rosbags.highlevel import AnyReader

from ampc_msgs_config import ros
from ampc_msgs_config.types import NANOSECONDS
from launch_scripts.bags.recovery import recover
from launch_scripts.run.processes import ros_environment
from tests.bag_samples import read
from tests.waiting import wait_for
from tests.workshop.proofs.killed_recorder import (
    RATE,
    running_car,
    running_recorder,
)

LONGEST = 6.0
"""Longest wall time from the start of a recorder to its end [s]."""
CLOCK_STARTS = 2.0
"""Wall time at which simulated time starts [s]."""
TRANSFORMS = (ros.TF, ros.TF_STATIC)
BOUND = 1.0
"""Upper bound of the loss [s]."""


class Kill(NamedTuple):
    """Result of one kill."""

    after: float
    """Wall time from the recorder's start to its end [s]."""
    simulated: bool
    """Whether log times were simulated."""
    published: int
    """Messages that the car had sent to the recorder."""
    recorded: int
    """Messages in the recovered bag."""
    loss: float
    """Time from the last recorded message to the last published one [s]."""
    gaps: int
    """Messages that are missing before the last recorded one."""
    report: str
    """First line of the output of recover."""
    opened: bool
    """Whether mcap, rosbags and our reader find the same number of messages in the result."""

    @property
    def is_good(self) -> bool:
        """Whether the loss is below the bound, without gaps, and the result can be opened."""
        return self.loss < BOUND and not self.gaps and self.opened


def main(arguments: Sequence[str] | None = None) -> int:
    """Kill recorders, print a table, return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kills", type=int, default=20, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="of the moments; default: %(default)s")
    parser.add_argument("--keep", type=Path, help="folder for the bags; default: a temporary one")
    chosen = parser.parse_args(arguments)
    if chosen.kills < 1:
        parser.error(f"--kills {chosen.kills}: must be at least 1")
    os.environ.update(ros_environment())
    with tempfile.TemporaryDirectory() as temporary:
        kills = list(prove(chosen.keep or Path(temporary), chosen.kills, chosen.seed))
    Console(width=120).print(table(kills))
    return 0 if all(kill.is_good for kill in kills) else 1


def prove(folder: Path, count: int, seed: int) -> Iterator[Kill]:
    """Kill recorders, one after the other.

    Args:
        folder: Folder of the bags.
        count: Number of kills.
        seed: Seed of the moments.
    """
    moments = random.Random(seed)
    for number in range(count):
        simulated = bool(number % 2)
        bag = folder / f"kill_{number}"
        with running_car() as car, running_recorder(bag, simulated) as process:
            wait_for(car.is_matched)
            first = car.number + 1
            after = moments.uniform(0.0, LONGEST)
            last_ns = car.publish_for(after, CLOCK_STARTS if simulated else 0.0)
            process.kill()
        yield evaluate(bag, after, simulated, first, last_ns, car.number)


def evaluate(bag: Path, after: float, simulated: bool, first: int, last_ns: int, last: int) -> Kill:
    """Recover a bag and compare its content with the published messages.

    Args:
        bag: Bag of the killed recorder.
        after: Wall time from the recorder's start to its end [s].
        simulated: Whether log times were simulated.
        first: Number of the first message that the recorder must record.
        last_ns: Wall time of the last message [ns].
        last: Number of the last message.
    """
    output = bag.with_name(f"{bag.name}_recovered")
    report = recover(bag, output)
    entries = [entry for entry in read(output) if entry.topic.endswith(ros.ODOM)]
    stamps = {ros.nanoseconds(entry.message.header.stamp) for entry in entries}
    numbers = sorted(stamp_ns * RATE // NANOSECONDS for stamp_ns in stamps)
    newest = max((entry.publish_time_ns for entry in entries), default=0)
    begin_ns = last_ns - int(after * NANOSECONDS)
    expected = range(min(numbers, default=first), max(numbers, default=first - 1) + 1)
    return Kill(
        after,
        simulated,
        last - first + 1,
        len(entries),
        max(0, last_ns - max(newest, begin_ns)) / NANOSECONDS,
        len(set(expected) - set(numbers)),
        report[0].partition(": ")[2],
        opens(output),
    )


def opens(bag: Path) -> bool:
    """Check whether mcap, rosbags and our reader can read all of a bag."""
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        topics = [channel.topic for _, channel, _ in reader.iter_messages()]
        summary = reader.get_summary()
    assert summary
    assert summary.statistics
    with AnyReader([bag]) as others:
        messages = [others.deserialize(data, link.msgtype) for link, _, data in others.messages()]
    ours = sum(entry.topic not in TRANSFORMS for entry in read(bag))
    transforms = sum(topic in TRANSFORMS for topic in topics)  # the type may not be installed
    return summary.statistics.message_count == len(topics) == len(messages) == ours + transforms


def table(kills: Sequence[Kill]) -> Table:
    """Return the table of the kills for the terminal."""
    result = Table(title=f"{len(kills)} recorders killed", title_justify="left")
    for heading in ("kill at [s]", "time", "sent", "in the bag", "gaps", "lost [s]", "recover", ""):
        result.add_column(heading, justify="left" if heading in ("time", "recover") else "right")
    for kill in kills:
        result.add_row(
            f"{kill.after:.3f}",
            "simulated" if kill.simulated else "real",
            str(kill.published),
            str(kill.recorded),
            str(kill.gaps),
            f"{kill.loss:.3f}",
            kill.report,
            "opens" if kill.opened else "DOES NOT OPEN",
        )
    worst = max((kill.loss for kill in kills), default=0.0)
    result.caption = f"largest loss {worst:.3f} s of {BOUND:g} s allowed"
    return result


if __name__ == "__main__":
    sys.exit(main())
