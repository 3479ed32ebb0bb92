"""Report of one or several bags: a page that shows and plays the drive, and its metrics as JSON.

`python launch_scripts/report.py runs/a/bag`; several bags are compared side by side. Bags of other
controllers work, too. With `--thresholds my_limits.yaml`, the exit code is 0 if all thresholds
pass and 1 if one fails. The exit code is 2 if an argument or a bag is invalid.
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
from ampc_msgs_config.metrics import METRICS
from launch_scripts.reporting.drive import JudgedDrive, judge_bag
from launch_scripts.reporting.page import NO_DATA, report_page, visible_metrics
from launch_scripts.reporting.summary import Thresholds
from launch_scripts.run.json_values import to_json

FAILED, WRONG = 1, 2
"""Exit codes."""
TABLE_WIDTH = 100
"""Smallest width of the printed tables [characters]."""
FORMATS = ("csv", "svg", "pdf")


def read_report_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="folder, or MCAP file")
    parser.add_argument(
        "--output",
        type=Path,
        help="page (.html), or folder for report.html; default: next to the first bag",
    )
    parser.add_argument("--thresholds", type=Path, help="YAML file of limits; see the docs")
    parser.add_argument("--namespace", help="of the topics, as /car1; default: the first steered")
    parser.add_argument("--vehicle", help="name or YAML file, for a bag without configuration")
    add_format_option(parser, "time series, charts, or charts on the pages of one file")
    return parser.parse_args(arguments)


def add_format_option(parser: argparse.ArgumentParser, content: str) -> None:
    """Add the option for further output files."""
    text = f"further output files ({content}); default: none"
    parser.add_argument("--format", nargs="+", choices=FORMATS, default=[], help=text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the bags, write page and JSON, print the tables, and return the exit code."""
    options, console = read_report_options(arguments), Console(highlight=False, soft_wrap=True)
    console.width = max(console.width, TABLE_WIDTH)
    command = f"report {shlex.join(sys.argv[1:] if arguments is None else arguments)}"
    try:
        drives = judge_bags(options)
        file = page_file(options.output, options.bags[0])
        thresholds = options.thresholds.name if options.thresholds else ""
        write_report(file, drives, thresholds, f"Written by {command}")
        files = write_formats(file, drives, options.format)
    except (ValueError, OSError) as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    print_tables(console, drives, thresholds)
    names = [each.name for each in (file, file.with_suffix(".json"), *files)]
    console.print(f"{', '.join(names)}: {file.parent}", markup=False)
    return FAILED if passed(drives) is False else 0


def judge_bags(options: argparse.Namespace) -> list[JudgedDrive]:
    """Read all bags.

    Raises:
        ValueError: A bag, the vehicle or the thresholds are invalid.
    """
    vehicle = thresholds = None
    if options.thresholds:
        thresholds = load(Thresholds, options.thresholds)
        if thresholds == Thresholds():
            raise ValueError(f"{options.thresholds}: contains no threshold")
    if options.vehicle:
        from sim_vehicle.parameters import load_vehicle  # loads scenarios and wind

        vehicle = load_vehicle(find("vehicles", options.vehicle))
    return [
        judge_bag(bag, name, options.namespace, vehicle, thresholds)
        for bag, name in zip(options.bags, names_of(options.bags), strict=True)
    ]


def names_of(bags: Sequence[Path]) -> list[str]:
    """Return different names for the bags, as short as possible."""
    parts = [bag.resolve().with_suffix("").parts for bag in bags]
    parts = [each[:-1] if each[-1] == "bag" and len(each) > 1 else each for each in parts]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(each[-depth:]) for each in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{each[-1]} ({k})" for k, each in enumerate(parts, 1)]


def page_file(output: Path | None, first: Path) -> Path:
    """Return the file of the page."""
    if output is None:
        folder = first.resolve().parent
        return folder / ("report.html" if first.name == "bag" else f"{first.stem}_report.html")
    return output if output.suffix in (".html", ".htm") else output / "report.html"


def write_report(file: Path, drives: Sequence[JudgedDrive], thresholds: str, command: str) -> None:
    """Write the page, and next to it the metrics as JSON.

    Args:
        file: HTML file to write.
        drives: Content.
        thresholds: Name of the file of thresholds, or nothing.
        command: Text that names the command.

    Raises:
        OSError: The file cannot be written.
        ValueError: The page would be too large.
    """
    now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    page = report_page(drives, thresholds, f"{command}, {now}")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(page, encoding="utf-8")
    content = to_json(report_json(drives, thresholds))
    text = json.dumps(content, indent=2, allow_nan=False, default=str)
    file.with_suffix(".json").write_text(text + "\n", encoding="utf-8")


def write_formats(file: Path, drives: Sequence[JudgedDrive], formats: Sequence[str]) -> list[Path]:
    """Write the further output files next to the page and return their names."""
    if not formats:
        return []
    from launch_scripts.reporting.export import export_report  # loads matplotlib

    return export_report(file, drives, formats)


def passed(drives: Sequence[JudgedDrive]) -> bool | None:
    """Return whether all thresholds pass; None without thresholds."""
    verdicts = [verdict for drive in drives for verdict in drive.verdicts]
    return all(verdict.passed for verdict in verdicts) if verdicts else None


def report_json(drives: Sequence[JudgedDrive], thresholds: str) -> dict[str, Any]:
    """Return all numbers of the page, in SI units."""
    return {
        "version": __version__,
        "passed": passed(drives),
        "thresholds": thresholds or None,
        "drives": [
            {
                "name": drive.name,
                "bag": str(drive.columns.bag),
                "namespace": drive.columns.namespace,
                "start_ns": drive.columns.start_ns,
                "controller": drive.context.controller or None,
                "period": drive.record.period,
                "summary": drive.metrics,
                "verdicts": [each._asdict() | {"passed": each.passed} for each in drive.verdicts],
                "notes": drive.notes,
                "configuration": drive.columns.configuration,
            }
            for drive in drives
        ],
    }


def print_tables(console: Console, drives: Sequence[JudgedDrive], thresholds: str) -> None:
    """Print metrics, notes and verdicts."""
    summary = Table()
    summary.add_column("quantity")
    for drive in drives:
        summary.add_column(Text(drive.name), justify="right")
    summary.add_column("unit")
    for key, values in visible_metrics(drives):
        metric = METRICS[key]
        cells = [format_value(value, metric.scale) for value in values]
        summary.add_row(metric.title, *cells, metric.unit)
    console.print(summary)
    for drive in drives:
        for note in drive.notes:
            console.print(f"note: {drive.name}: {note}", markup=False)
    if passed(drives) is not None:
        console.print(verdict_table(drives, thresholds))


def format_value(value: float | None, scale: float) -> str:
    """Return the displayed number of a metric."""
    if value is None:
        return NO_DATA
    return f"{value:,}" if isinstance(value, int) else f"{value * scale:#.3g}".rstrip(".")


def verdict_table(drives: Sequence[JudgedDrive], thresholds: str) -> Table:
    """Return the verdicts as a table for the terminal."""
    result = Table(title=Text(thresholds), title_justify="left")
    for heading in ("drive", "threshold", "measured", "bound", "verdict"):
        result.add_column(heading)
    for drive in drives:
        for each in drive.verdicts:
            verdict = Text("pass", "green") if each.passed else Text("FAIL", "bold red")
            result.add_row(Text(drive.name), each.threshold, each.measured, each.bound, verdict)
    return result


if __name__ == "__main__":
    sys.exit(main())
