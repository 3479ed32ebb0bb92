"""Report of one or several bags: a page that shows and plays the drive, and its metrics as JSON.

`python launch_scripts/report.py runs/a/bag`; several bags are compared side by side. Bags of other
controllers work, too. With `--thresholds my_limits.yaml`, the exit code is 0 if all thresholds
pass and 1 if one fails. The exit code is 2 if an argument or a bag is invalid.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.text import Text

from ampc_msgs_config.config import find, load
from launch_scripts.reporting.pages import add_format_option, terminal_table

if TYPE_CHECKING:
    from launch_scripts.reporting.drive import JudgedDrive

FAILED, WRONG = 1, 2
"""Exit codes."""
TABLE_WIDTH = 100
"""Smallest width of the printed tables [characters]."""


def read_report_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("bags", nargs="+", type=Path, metavar="BAG", help="folder, or file of a bag")
    text = "page (.html), or folder for report.html; default: next to the first bag"
    add("--output", type=Path, help=text)
    add("--thresholds", type=Path, help="YAML file of limits; see the docs")
    add("--namespace", help="of the topics, as /car1; default: the first steered")
    add("--odom", metavar="TOPIC", help="odometry to evaluate; default: odom in the namespace")
    add("--vehicle", help="name or YAML file, for a bag without configuration")
    text = "also write the drive of one bag for the viewer Rerun; needs rerun-sdk"
    add("--rerun", type=Path, metavar="FILE.rrd", help=text)
    add_format_option(parser, "time series, charts, or charts on the pages of one file")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read the bags, write page and JSON, print the tables, and return the exit code."""
    options, console = read_report_options(arguments), Console(highlight=False, soft_wrap=True)
    # These modules load compiled code and plotly.
    from launch_scripts.reporting.page import all_passed, summary_rows, verdict_rows, write_report

    console.width = max(console.width, TABLE_WIDTH)
    command = f"report {shlex.join(sys.argv[1:] if arguments is None else arguments)}"
    thresholds = options.thresholds.name if options.thresholds else ""
    try:
        if options.rerun and len(options.bags) > 1:
            raise ValueError(f"--rerun takes one bag, not {len(options.bags)}")
        drives = judge_bags(options)
        files = [page_file(options.output, options.bags[0])]
        write_report(files[0], drives, thresholds, f"Written by {command}")
        files.append(files[0].with_suffix(".json"))
        if options.format:
            from launch_scripts.reporting.export import export_report  # loads matplotlib

            files += export_report(files[0], drives, options.format)
        if options.rerun:
            from launch_scripts.reporting.rerun_file import write_rerun  # few reports need it

            write_rerun(options.rerun, drives[0])
    except (ValueError, OSError) as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    names = [drive.name for drive in drives]
    rows = [[title, *cells] for (title, _), *cells in summary_rows(drives)]
    align = f"l{'r' * len(names)}l"
    console.print(terminal_table(["quantity", *names, "unit"], rows, align))
    for drive in drives:
        for note in drive.notes:
            console.print(f"note: {drive.name}: {note}", markup=False)
    if thresholds:
        heads = ["threshold", "bound", *names]
        console.print(terminal_table(heads, verdict_rows(drives), "lr", thresholds))
    console.print(f"{', '.join(file.name for file in files)}: {files[0].parent}", markup=False)
    if options.rerun:
        console.print(f"{options.rerun}: open it with `rerun {options.rerun}`", markup=False)
    return FAILED if all_passed(drives) is False else 0


def judge_bags(options: argparse.Namespace) -> list["JudgedDrive"]:
    """Read all bags.

    Raises:
        ValueError: A bag, the vehicle or the thresholds are invalid.
    """
    from launch_scripts.reporting.drive import Thresholds, judge_bag, load_car

    vehicle = thresholds = None
    if options.thresholds:
        thresholds = load(Thresholds, options.thresholds)
        if thresholds == Thresholds():
            raise ValueError(f"{options.thresholds}: contains no threshold")
    if options.vehicle:
        vehicle = load_car(find("vehicles", options.vehicle))
    return [
        judge_bag(bag, name, options.namespace, vehicle, thresholds, options.odom)
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


if __name__ == "__main__":
    sys.exit(main())
