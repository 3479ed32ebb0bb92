"""Kills the recorder at random moments of a run, and measures what is lost and what recover makes.

``python tests/workshop/proofs/prove_recording.py [--kills 20] [--seed 1]`` plays a car that
publishes the topics of a control loop in real time, kills the recorder with SIGKILL, recovers the
bag and opens the result with `mcap`, `rosbags` and our reader. Every other run is in simulated
time, and a part of those dies before the simulated clock starts. Exit code 1 where a second or
more is lost, a message is missing before the end, or a result does not open.
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
from launch_scripts.run.environment import ros_environment
from tests.bag_samples import read
from tests.workshop.proofs.killed_recorder import RATE, car, drive, recorder, wait_until

LONGEST = 6.0
"""Wall time after which the recorder is killed at the latest [s]."""
CLOCK_STARTS = 2.0
"""Wall time after which simulated time starts, where it does [s]."""
TRANSFORMS = (ros.TF, ros.TF_STATIC)
BOUND = 1.0
"""More must not be lost [s]."""


class Kill(NamedTuple):
    """What one kill has left."""

    after: float
    """Wall time from the recorder's start to its end [s]."""
    simulated: bool
    """Whether log times were simulated."""
    published: int
    """Messages that the car had sent to the recorder."""
    recorded: int
    """Those that are in the recovered bag."""
    loss: float
    """From the last recorded message to the last published one [s]."""
    gaps: int
    """Messages that are missing before the last recorded one."""
    said: str
    """First words of recover."""
    opened: bool
    """Whether mcap, rosbags and we read the same number of messages from the recovered bag."""

    @property
    def is_good(self) -> bool:
        """Whether the promise holds."""
        return self.loss < BOUND and not self.gaps and self.opened


def main(arguments: Sequence[str] | None = None) -> int:
    """Kills as often as wanted, prints a table and gives the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the bags (a temporary one)")
    chosen = parser.parse_args(arguments)
    if chosen.kills < 1:
        parser.error(f"--kills {chosen.kills}: must be at least 1")
    os.environ.update(ros_environment())
    with tempfile.TemporaryDirectory() as temporary:
        kills = list(prove(chosen.keep or Path(temporary), chosen.kills, chosen.seed))
    Console(width=120).print(table(kills))
    return 0 if all(kill.is_good for kill in kills) else 1


def prove(folder: Path, count: int, seed: int) -> Iterator[Kill]:
    """Kills recorders, one after the other.

    Args:
        folder: For the bags.
        count: How many kills.
        seed: Of their moments.

    Raises:
        TimeoutError: A recorder does not start.
    """
    moments = random.Random(seed)
    for number in range(count):
        simulated = bool(number % 2)
        with car() as played, recorder(folder / f"kill_{number}", simulated) as process:
            wait_until(played.is_heard)
            first = played.number + 1
            after = moments.uniform(0.0, LONGEST)
            last_ns = drive(played, after, CLOCK_STARTS if simulated else 0.0)
            process.kill()
        yield judge(folder / f"kill_{number}", after, simulated, first, last_ns, played.number)


def judge(bag: Path, after: float, simulated: bool, first: int, last_ns: int, last: int) -> Kill:
    """Recovers a bag, and compares what is in it with what was published.

    Args:
        bag: What the killed recorder has left.
        after: Wall time of its life [s].
        simulated: Whether log times were simulated.
        first: Number of the first message that the recorder had to hear.
        last_ns: Wall time of the last message [ns].
        last: Its number.
    """
    output = bag.with_name(f"{bag.name}_recovered")
    said = recover(bag, output)
    found = [entry for entry in read(output) if entry.topic.endswith(ros.ODOM)]
    stamps = {ros.nanoseconds(entry.message.header.stamp) for entry in found}
    numbers = sorted(stamp_ns * RATE // NANOSECONDS for stamp_ns in stamps)
    newest = max((entry.publish_time_ns for entry in found), default=0)
    begin_ns = last_ns - int(after * NANOSECONDS)
    expected = range(min(numbers, default=first), max(numbers, default=first - 1) + 1)
    return Kill(
        after,
        simulated,
        last - first + 1,
        len(found),
        max(0, last_ns - max(newest, begin_ns)) / NANOSECONDS,
        len(set(expected) - set(numbers)),
        said[0].partition(": ")[2],
        opens(output),
    )


def opens(bag: Path) -> bool:
    """Tells whether mcap, rosbags and our reader understand all of a bag."""
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
    placed = sum(topic in TRANSFORMS for topic in topics)  # a type that may not be installed
    in_index = summary.statistics.message_count
    return in_index == len(topics) == len(messages) == ours + placed


def table(kills: Sequence[Kill]) -> Table:
    """Lays the kills out for the terminal."""
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
            kill.said,
            "opens" if kill.opened else "DOES NOT OPEN",
        )
    worst = max((kill.loss for kill in kills), default=0.0)
    result.caption = f"largest loss {worst:.3f} s of {BOUND:g} s allowed"
    return result


if __name__ == "__main__":
    sys.exit(main())
