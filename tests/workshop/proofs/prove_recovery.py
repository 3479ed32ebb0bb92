"""Damage bags, recover them, and compare the result with an oracle.

`python -m tests.workshop.proofs.prove_recovery [--damages 1000] [--seed 1]` damages files with
all compressions at every kind of place, and checks that `recover` keeps every message whose bytes
are intact, as `damaged_bags` defines it. The exit code is 1 if one is lost or an exception is
raised.
Altered messages that are kept, and damage that is not noticed, are counted, too: a message has no
checksum of its own that could show that its values are wrong.
"""

import argparse
import io
import random
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from mcap.reader import make_reader
from rich.console import Console
from rich.table import Table

from launch_scripts.bags.salvage import salvage
from tests.workshop.proofs.damaged_bags import (
    KINDS,
    PLACES,
    Key,
    all_messages,
    damage,
    intact_messages,
    make_sample,
)


class Outcome(NamedTuple):
    """Result of one damage."""

    seed: int
    kind: str
    place: str
    intact: int
    """Messages that the oracle finds intact."""
    lost: int
    """Intact messages that are not in the recovered file."""
    altered: int
    """Messages of the recovered file that the undamaged file does not contain."""
    doubtful: int
    """Messages that are counted as doubtful."""
    is_noticed: bool
    """Whether the damage is reported."""
    error: str
    """Exception, if one was raised."""

    @property
    def is_good(self) -> bool:
        """Whether every intact message is recovered, without an exception."""
        return not self.lost and not self.error


def main(arguments: Sequence[str] | None = None) -> int:
    """Damage, recover, print a table; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--damages", type=int, default=1000, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="of the first; default: %(default)s")
    chosen = parser.parse_args(arguments)
    outcomes = list(prove(chosen.damages, chosen.seed))
    console = Console(width=120)
    console.print(table(outcomes))
    for each in outcomes:
        if not each.is_good:
            console.print(f"{each}", markup=False)
    return 0 if all(each.is_good for each in outcomes) else 1


def prove(count: int, seed: int) -> Iterator[Outcome]:
    """Damage files with consecutive seeds, kinds and places in turn."""
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        place = PLACES[number // len(KINDS) % len(PLACES)]
        yield one_damage(seed + number, kind, place)


def one_damage(seed: int, kind: str, place: str) -> Outcome:
    """Damage one file, recover it, and compare the messages."""
    rng = random.Random(seed)
    sample = make_sample(rng)
    content, origin = damage(sample, kind, place, rng)
    expected, target = Counter(intact_messages(sample, origin)), io.BytesIO()
    try:
        result = salvage(io.BytesIO(content), target)
        found = Counter(recovered(target))
    except Exception as error:
        total = expected.total()
        return Outcome(seed, kind, place, total, total, 0, 0, False, repr(error))
    return Outcome(
        seed,
        kind,
        place,
        expected.total(),
        len(expected.keys() - found.keys()),
        len(found.keys() - set(all_messages(sample))),
        result.doubtful,
        not result.is_undamaged or result.tail_bytes > 0,
        "",
    )


def recovered(target: io.BytesIO) -> Iterator[Key]:
    """Return the messages of a recovered file."""
    target.seek(0)
    for schema, channel, message in make_reader(target, validate_crcs=True).iter_messages():
        name = schema.name if schema else ""
        times = message.log_time, message.publish_time
        yield Key(channel.topic, name, message.sequence, *times, message.data)


def table(outcomes: Sequence[Outcome]) -> Table:
    """Return the table of the outcomes for the terminal."""
    result = Table(title=f"{len(outcomes)} damages", title_justify="left")
    heads = (
        "damages",
        "intact messages",
        "lost",
        "altered, kept",
        "doubtful",
        "not noticed",
        "errors",
    )
    result.add_column("damage")
    for heading in heads:
        result.add_column(heading, justify="right")
    for kind in (*KINDS, *PLACES, "all"):
        chosen = [each for each in outcomes if kind in (each.kind, each.place, "all")]
        result.add_row(
            kind,
            str(len(chosen)),
            str(sum(each.intact for each in chosen)),
            str(sum(each.lost for each in chosen)),
            str(sum(each.altered for each in chosen)),
            str(sum(each.doubtful for each in chosen)),
            str(sum(not each.is_noticed for each in chosen)),
            str(sum(bool(each.error) for each in chosen)),
        )
    return result


if __name__ == "__main__":
    sys.exit(main())
