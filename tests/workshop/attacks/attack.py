"""Run every attack of the review, and count what survived.

`python -m tests.workshop.attacks.attack [--only AREA[/NAME]] [--seed N] [--update PAGE]` attacks
running nodes, their files and their bags. One process per node runs as a user starts it; an
auditor plays car and sensors and checks every command by limits of its own. The same seed gives
the same attacks. Exit code 1: an attempt failed; it is named so that `--only` repeats it.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

from rich.console import Console

from launch_scripts.reporting.pages import markdown_table
from tests.workshop.attacks.attempts import Attempt, Choice, one_line

AREAS = {
    "odometry": "hostile odometry, to controller and gate",
    "parameter": "parameters, services and life cycle",
    "path": "hostile paths",
    "process": "signals, kills and second nodes",
    "clock": "clocks",
    "graph": "whole graph with gate: kill and stop each node",
    "file": "YAML mutants of eight kinds of files, path files",
    "bag": "damaged and special bags",
    "recorder": "recorder: kills, files and disks that vanish",
    "environment": "environment",
}
"""Modules `<area>_attacks` and their titles."""
BEGIN, END = "<!-- table of attack.py -->", "<!-- end of the table -->"
OUTCOMES = ("survived", "failed", "inconclusive")
Area = Callable[[Choice], Iterator[Attempt]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the attacks and return the exit code."""
    chosen, console = read_options(arguments), Console(highlight=False, soft_wrap=True)
    area, _, name = chosen.only.partition("/")
    attempts = list[Attempt]()
    for each in [area] if area else AREAS:
        begin = time.monotonic()
        choice = Choice(chosen.seed, chosen.output / each, each, name)
        found = list(printed(run(choice), console))
        attempts += found
        counts = Counter(attempt.outcome for attempt in found)
        seconds = time.monotonic() - begin
        console.print(f"{each}: {len(found)} attempts, {dict(counts)}, {seconds:.0f} s")
    report(attempts, chosen, console)
    return int(any(attempt.failure for attempt in attempts))


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line; an unknown area ends the process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help=f"area, or area/attack: {', '.join(AREAS)}")
    parser.add_argument("--seed", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--update", type=Path, help="page whose table is replaced")
    text = "folder of results and logs; default: %(default)s"
    parser.add_argument("--output", type=Path, default=Path("runs/attack"), help=text)
    chosen = parser.parse_args(arguments)
    if chosen.only and chosen.only.partition("/")[0] not in AREAS:
        parser.error(f"--only {chosen.only}: must begin with one of {', '.join(AREAS)}")
    chosen.output = chosen.output.absolute()
    return chosen


def run(choice: Choice) -> Iterator[Attempt]:
    """Run an area; what ends it early is a failure of its own."""
    choice.folder.mkdir(parents=True, exist_ok=True)
    area: Area = import_module(f"tests.workshop.attacks.{choice.area}_attacks").attempts
    try:
        yield from area(choice)
    except Exception as error:
        yield Attempt(choice.area, "", one_line(f"the area ended early: {error!r}"))


def printed(attempts: Iterator[Attempt], console: Console) -> Iterator[Attempt]:
    """Print every attempt that did not survive, as the option that repeats it."""
    for attempt in attempts:
        if attempt.outcome != "survived":
            text = attempt.failure or attempt.doubt
            only = f"--only '{attempt.area}/{attempt.name}'"
            console.print(f"{attempt.outcome}: {only}: {text}", markup=False)
        yield attempt


def table(attempts: Sequence[Attempt]) -> str:
    """Return the counts as a Markdown table."""
    rows = []
    for area, title in AREAS.items():
        found = Counter(attempt.outcome for attempt in attempts if attempt.area == area)
        if found:
            rows.append((title, found.total(), *(found[outcome] for outcome in OUTCOMES)))
    total = [sum(row[i] for row in rows) for i in range(1, 5)]
    lines = markdown_table(("area", "attempts", *OUTCOMES), [*rows, ("all", *total)], "r")
    return "\n".join(lines) + "\n"


def report(attempts: Sequence[Attempt], chosen: argparse.Namespace, console: Console) -> None:
    """Write the results, print the table, and put it into a page."""
    chosen.output.mkdir(parents=True, exist_ok=True)
    notable = [attempt._asdict() for attempt in attempts if attempt.outcome != "survived"]
    counts = {area: Counter(a.outcome for a in attempts if a.area == area) for area in AREAS}
    content = {"seed": chosen.seed, "counts": counts, "not survived": notable}
    text = table(attempts)
    (chosen.output / "attack.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (chosen.output / "attack.md").write_text(text, "utf-8")
    console.print(text, markup=False)
    console.print(f"written to {chosen.output}", markup=False)
    if chosen.update:
        update(chosen.update, text)


def update(page: Path, text: str) -> None:
    """Replace the table of a page.

    Raises:
        ValueError: The page does not contain the marks of the table.
    """
    content = page.read_text(encoding="utf-8")
    if BEGIN not in content or END not in content:
        raise ValueError(f"{page}: must contain {BEGIN!r} and {END!r}")
    before, after = content.split(BEGIN)[0], content.split(END)[1]
    page.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
