"""Attempts to break the product: their results, and which of them run."""

import random
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple


class Attempt(NamedTuple):
    """Result of one attempt; it survived if there is neither a failure nor a doubt."""

    area: str
    name: str
    failure: str = ""
    """What the product did wrong, in one line."""
    doubt: str = ""
    """Why the attempt shows nothing, in one line; mostly a machine without CPU time."""

    @property
    def outcome(self) -> str:
        """Return the column of the table in which the attempt counts."""
        return "failed" if self.failure else "inconclusive" if self.doubt else "survived"


class Choice(NamedTuple):
    """Which attacks run, and with which random numbers."""

    seed: int
    folder: Path
    """Folder for logs and files."""
    area: str
    name: str = ""
    """Only attacks whose names begin with this one."""

    def has(self, name: str) -> bool:
        """Return whether an attack runs."""
        return name.startswith(self.name)

    def rng(self, name: str) -> random.Random:
        """Return random numbers that depend on seed, area and attack only."""
        return random.Random(f"{self.seed} {self.area} {name}")

    def attempts(self, attacks: dict[str, Callable[[], str]]) -> Iterator[Attempt]:
        """Run attacks that return their failure, empty if the product survived."""
        for name, attack in attacks.items():
            if self.has(name):
                yield Attempt(self.area, name, outcome_of(attack))


def outcome_of(attack: Callable[[], str]) -> str:
    """Return the failure of an attack; an exception is one, with its place."""
    try:
        return attack()
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return one_line(f"{error!r} in {Path(place.filename).name}:{place.lineno}")


def one_line(text: str, most: int = 300) -> str:
    """Return a text in one line of bounded length."""
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[:most]}..."
