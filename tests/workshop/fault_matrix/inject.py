"""Inject faults between car and controller: what does each of them cost, and does the car recover?

`python tests/workshop/fault_matrix/inject.py` drives every fault on every road, in real time but
computed, and leaves a table, JSON, Markdown and a heat map in `runs/faults`. Nobody obeys the
request to stop, so the car drives on at full speed: the harder case; `--obey` brakes. The exit
code is 0, 1 where a car is lost or does not recover though it could have, and 2 where an option is
wrong.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from ampc_msgs_config.parameters import check_range
from ampc_ros.configuration import CONTROLLERS
from launch_scripts.compare import naming
from launch_scripts.faults.schedule import SEEDS
from launch_scripts.run.options import create_folder
from tests.workshop.acceptance.trials import DATA
from tests.workshop.fault_matrix.inject_cases import CASES, CIRCUIT, SCENARIOS, Case, load_course
from tests.workshop.fault_matrix.inject_cells import Bench, Cell, Conditions, Course
from tests.workshop.fault_matrix.inject_report import Report, table_of, write

WIDTH = 160
"""Of the printed table, at least [characters]."""
FAILED, WRONG = 1, 2
"""Exit codes."""


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add, default = parser.add_argument, Conditions()
    names = ", ".join(f"'{case.name}'" for case in CASES)
    add("--faults", nargs="+", metavar="FAULT", default=[], help=f"{names}; default: all")
    names = (
        f"{', '.join(SCENARIOS)}, a shipped scenario, YAML or CSV; default: these {len(roads())}"
    )
    add("--scenarios", nargs="+", metavar="ROAD", default=roads(), help=names)
    text = "who steers; default: %(default)s"
    add("--controller", choices=CONTROLLERS, default=default.controller, help=text)
    add("--vehicle", default=default.vehicle, help="the car; default: %(default)s")
    text = "limits of the guard: the default clips only what no car can do; default: %(default)s"
    add("--guard", default=default.guard, help=text)
    add("--seed", type=int, default=default.seed, help="of all chance; default: %(default)s")
    add("--obey", action="store_true", help="the driver brakes when a stop is requested")
    add("--output", type=Path, default=Path("runs/faults"), help="folder; default: %(default)s")
    return parser.parse_args(arguments)


def roads() -> list[str]:
    """Name the roads that are there: the circuit is no part of this repository."""
    there = (DATA / "tracks" / f"{CIRCUIT}.csv").is_file()
    return [name for name in SCENARIOS if name != CIRCUIT or there]


def cases_of(names: Sequence[str]) -> list[Case]:
    """Choose faults by name.

    Raises:
        ValueError: One is unknown.
    """
    known = {case.name: case for case in CASES}
    for name in names:
        if name not in known:
            raise ValueError(f"--faults: {name!r} must be one of {', '.join(known)}")
    return [known[name] for name in names] or list(CASES)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, show, write; gives the exit code."""
    chosen, console = options(arguments), Console(highlight=False, soft_wrap=True)
    given = list(sys.argv[1:] if arguments is None else arguments)
    command = f"python tests/workshop/fault_matrix/inject.py {shlex.join(given)}".strip()
    try:
        report = run(chosen, command, console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    failed = sum(cell.fails for cell in report.cells)
    return FAILED if failed else 0


def run(chosen: argparse.Namespace, command: str, console: Console) -> Report:
    """Do what is asked for.

    Raises:
        ValueError: In one sentence what is wrong.
    """
    check_range("--seed", chosen.seed, SEEDS)
    conditions = Conditions(*(getattr(chosen, field) for field in Conditions._fields))
    bench, cases = Bench(conditions), cases_of(chosen.faults)
    scenarios = []
    for name in chosen.scenarios:
        with naming(f"scenarios {name}"):
            scenarios.append(load_course(name, bench.vehicle.size))
    with naming("output"):
        create_folder(chosen.output, exist_ok=True)
    courses = [bench.course(scenario) for scenario in scenarios]
    cells = drive_all(bench, cases, courses, console)
    report = Report(command, conditions, courses, [case.name for case in cases], cells)
    console.width = max(console.width, WIDTH)
    console.print(table_of(report))
    write(report, chosen.output)
    console.print(f"faults.json, .md and .png: {chosen.output}", markup=False)
    return report


def drive_all(
    bench: Bench, cases: Sequence[Case], courses: Sequence[Course], console: Console
) -> list[Cell]:
    """Drive all cells."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    pairs = [(case, course) for case in cases for course in courses]
    with Progress(*columns, TimeElapsedColumn(), console=console) as bar:
        return [bench.cell(*pair) for pair in bar.track(pairs, description="drives")]


if __name__ == "__main__":
    sys.exit(main())
