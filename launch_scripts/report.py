"""Report bags: one page that shows the drive and plays it, and its numbers as JSON.

`python launch_scripts/report.py runs/a/bag`, or several bags for a comparison side by side, of
this controller or of any other. `--thresholds my_limits.yaml` makes it a test: the exit code is 0
where all are held, 1 where one is not, 2 where something given is wrong.
"""

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find, load
from launch_scripts.reporting.context import ReportInputs
from launch_scripts.reporting.drive import Judged, judge_bag
from launch_scripts.reporting.page import Judgement, page
from launch_scripts.reporting.summary import QUANTITIES, Thresholds, verdicts
from launch_scripts.reporting.tables import bound, measured, shown
from launch_scripts.run.json_values import to_json
from sim_vehicle.parameters import load_vehicle

FAILED, WRONG = 1, 2
"""Exit codes."""
WIDTH = 100
"""Of the printed tables, at least [characters]."""


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="folder, or MCAP file")
    parser.add_argument(
        "--output",
        type=Path,
        help="page to write (.html), or folder for report.html; default: beside the first bag",
    )
    parser.add_argument("--thresholds", type=Path, help="YAML of what must be held; see the docs")
    parser.add_argument("--namespace", help="of the topics, as /car1; default: the first steered")
    parser.add_argument("--vehicle", help="the car, name or YAML, of a bag that does not tell")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read, judge, write, show; gives the exit code."""
    chosen, console = options(arguments), Console(highlight=False, soft_wrap=True)
    console.width = max(console.width, WIDTH)
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        limits = load(Thresholds, chosen.thresholds) if chosen.thresholds else None
        vehicle = load_vehicle(find("vehicles", chosen.vehicle)) if chosen.vehicle else None
        names = names_of(chosen.bags)
        drives = [
            judge_bag(bag, name, chosen.namespace, ReportInputs(vehicle))
            for bag, name in zip(chosen.bags, names, strict=True)
        ]
        judgement = judge(drives, limits, chosen.thresholds)
        file = page_file(chosen.output, chosen.bags[0])
        write(file, drives, judgement, f"Made by report {shlex.join(given)}")
    except (ValueError, OSError) as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    show(console, drives, judgement)
    console.print(f"page and JSON: {file}, {file.with_suffix('.json')}", markup=False)
    return FAILED if judgement is not None and not judgement.passed else 0


def judge(
    drives: Sequence[Judged], limits: Thresholds | None, file: Path | None
) -> Judgement | None:
    """Hold all drives against the thresholds, where there are some.

    Raises:
        ValueError: The file sets none.
    """
    if limits is None or file is None:
        return None
    found = [verdicts(limits, drive.summary) for drive in drives]
    if not found[0]:
        raise ValueError(f"{file}: sets no threshold")
    return Judgement(file.name, found)


def names_of(bags: Sequence[Path]) -> list[str]:
    """Give bags names that tell them apart, as short as that allows."""
    parts = [bag.resolve().with_suffix("").parts for bag in bags]
    parts = [each[:-1] if each[-1] == "bag" and len(each) > 1 else each for each in parts]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-depth:]) for each in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{each[-1]} ({k})" for k, each in enumerate(parts, 1)]


def page_file(output: Path | None, first: Path) -> Path:
    """Give the file of the page."""
    if output is None:
        folder = first.resolve().parent
        return folder / ("report.html" if first.name == "bag" else f"{first.stem}_report.html")
    return output if output.suffix in (".html", ".htm") else output / "report.html"


def write(
    file: Path, drives: Sequence[Judged], judgement: Judgement | None, generated: str
) -> None:
    """Write the page, and beside it its numbers.

    Raises:
        OSError: The file cannot be written.
        ValueError: The page becomes too large.
    """
    now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    text = page(drives, judgement, f"{generated}, {now}")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")
    content = json.dumps(
        to_json(numbers(drives, judgement)), indent=2, allow_nan=False, default=str
    )
    file.with_suffix(".json").write_text(content + "\n", encoding="utf-8")


def numbers(drives: Sequence[Judged], judgement: Judgement | None) -> dict[str, Any]:
    """Give all that the page says in numbers, SI."""
    found = judgement.verdicts if judgement else [[] for _ in drives]
    return {
        "version": __version__,
        "passed": judgement.passed if judgement else None,
        "thresholds": judgement.file if judgement else None,
        "drives": [
            {
                "name": drive.name,
                "bag": str(drive.columns.bag),
                "namespace": drive.columns.namespace,
                "start_ns": drive.columns.start_ns,
                "controller": drive.known.controller or None,
                "period": drive.period,
                "summary": drive.summary,
                "verdicts": [each._asdict() | {"passed": each.passed} for each in verdict],
                "notes": drive.notes,
                "configuration": drive.columns.configuration,
            }
            for drive, verdict in zip(drives, found, strict=True)
        ],
    }


def show(console: Console, drives: Sequence[Judged], judgement: Judgement | None) -> None:
    """Print summary, verdicts, and what is missing or odd."""
    summary = Table(title="summary", title_justify="left")
    summary.add_column("quantity")
    for drive in drives:
        summary.add_column(Text(drive.name), justify="right")
    summary.add_column("unit")
    for name, quantity in QUANTITIES.items():
        values = [drive.summary[name] for drive in drives]
        if any(value is not None for value in values):
            cells = [shown(name, value) for value in values]
            summary.add_row(quantity.label, *cells, quantity.unit)
    console.print(summary)
    for drive in drives:
        for note in drive.notes:
            console.print(f"note: {drive.name}: {note}", markup=False)
    if judgement is not None:
        console.print(verdict_table(drives, judgement))


def verdict_table(drives: Sequence[Judged], judgement: Judgement) -> Table:
    """Lay the verdicts out for the terminal."""
    result = Table(title=Text(judgement.file), title_justify="left")
    for heading in ("drive", "threshold", "measured", "bound", "verdict"):
        result.add_column(heading)
    for drive, found in zip(drives, judgement.verdicts, strict=True):
        for each in found:
            verdict = Text("pass", "green") if each.passed else Text("FAIL", "bold red")
            cells = Text(drive.name), each.threshold, measured(each), bound(each)
            result.add_row(*cells, verdict)
    return result


if __name__ == "__main__":
    sys.exit(main())
