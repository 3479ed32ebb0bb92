"""Run every attack of the review, and count what survived.

`python -m tests.workshop.attacks.attack [--only AREA[/NAME]] [--seed N] [--update PAGE]` attacks
running nodes, their files and their bags. One process per node runs as a user starts it; an
auditor plays car and sensors and checks every command by limits of its own. The same seed gives
the same attacks. Exit code 1: an attempt failed; it is named so that `--only` repeats it.
"""

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from rich.console import Console

from launch_scripts.reporting.pages import markdown_table
from tests.default_signals import restore_signals
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
LIVE = ("graph", "process", "clock", "odometry", "parameter", "path")
"""Areas that attack running nodes."""
ASIDE = ("file", "bag", "recorder", "environment")
"""Areas that run in another process and ROS domain beside the others."""
DOMAINS = 200
OUTCOMES = ("survived", "failed", "inconclusive")
Area = Callable[[Choice], Iterator[Attempt]]
Counts = dict[str, dict[str, int]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the attacks and return the exit code."""
    restore_signals()
    chosen, console = read_options(arguments), Console(highlight=False, soft_wrap=True)
    begin = time.monotonic()
    if chosen.only:
        attempts = run_areas([chosen.only], chosen.seed, chosen.output)
    else:
        with ProcessPoolExecutor(1, get_context("spawn"), use_domain, (other_domain(),)) as pool:
            rest = pool.submit(run_areas, ASIDE, chosen.seed, chosen.output)
            attempts = run_areas(LIVE, chosen.seed, chosen.output) + rest.result()
    report(attempts, chosen, console)
    console.print(f"{time.monotonic() - begin:.0f} s")
    return int(any(attempt.outcome == "failed" for attempt in attempts))


def other_domain() -> str:
    """Return another ROS domain than that of this process."""
    return str((int(os.environ.get("ROS_DOMAIN_ID") or 0) + 1) % DOMAINS)


def use_domain(number: str) -> None:
    """Use a ROS domain in this process."""
    os.environ["ROS_DOMAIN_ID"] = number


def run_areas(names: Sequence[str], seed: int, output: Path) -> list[Attempt]:
    """Run areas one after the other, and print what did not survive.

    Args:
        names: Areas, or `area/attack`.
        seed: Seed of all attacks.
        output: Folder of results and logs.
    """
    console, attempts = Console(highlight=False, soft_wrap=True), list[Attempt]()
    for each in names:
        area, _, name = each.partition("/")
        begin = time.monotonic()
        found = list(printed(run(Choice(seed, output / area, area, name)), console))
        attempts += found
        counts = dict(Counter(attempt.outcome for attempt in found))
        seconds = time.monotonic() - begin
        console.print(f"{area}: {len(found)} attempts, {counts}, {seconds:.0f} s")
    return attempts


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


def count(attempts: Sequence[Attempt]) -> Counts:
    """Return the number of attempts by area and outcome."""
    return {
        area: dict(Counter(a.outcome for a in attempts if a.area == area))
        for area in AREAS
        if any(a.area == area for a in attempts)
    }


def table(counts: Counts) -> str:
    """Return the counts as a Markdown table."""
    rows = [
        (title, [counts[area].get(outcome, 0) for outcome in OUTCOMES])
        for area, title in AREAS.items()
        if area in counts
    ]
    rows.append(("all", np.sum([numbers for _, numbers in rows], axis=0).tolist()))
    cells = [(title, sum(numbers), *numbers) for title, numbers in rows]
    return "\n".join(markdown_table(("area", "attempts", *OUTCOMES), cells, "r")) + "\n"


def report(attempts: Sequence[Attempt], chosen: argparse.Namespace, console: Console) -> None:
    """Write the results, print the table, and put it into a page.

    A run of one area keeps the results of the others with the same seed.
    """
    chosen.output.mkdir(parents=True, exist_ok=True)
    file, counts = chosen.output / "attack.json", count(attempts)
    notable = [attempt._asdict() for attempt in attempts if attempt.outcome != "survived"]
    is_complete_area = chosen.only in AREAS
    if is_complete_area and file.is_file():
        before = json.loads(file.read_text("utf-8"))
        if before["seed"] == chosen.seed:
            counts = before["counts"] | counts
            notable += [each for each in before["not survived"] if each["area"] != chosen.only]
    text = table(counts)
    console.print(text, markup=False)
    if chosen.only and not is_complete_area:
        return
    content = {"seed": chosen.seed, "counts": counts, "not survived": notable}
    file.write_text(json.dumps(content, indent=1) + "\n", "utf-8")
    (chosen.output / "attack.md").write_text(text, "utf-8")
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
