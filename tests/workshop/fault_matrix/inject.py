"""Fault matrix: drive every fault on every road, and measure error and recovery.

`python -m tests.workshop.fault_matrix.inject` simulates the timing of the nodes and writes a table,
JSON, Markdown and a heat map to `runs/faults`. By default the driver ignores the stop request and
keeps the full speed, which is the harder case; with `--obey` he brakes. Exit code 0: every car
recovers or may be lost for a stated reason; 1: one does not; 2: wrong option.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from ampc_msgs_config.validation import check_range
from ampc_ros.configuration import CONTROLLERS
from launch_scripts.faults.schedule import SEED
from launch_scripts.run.options import create_folder, naming
from tests.workshop.acceptance.road_data import DATA
from tests.workshop.fault_matrix.inject_cases import CASES, CIRCUIT, SCENARIOS, Case, load_course
from tests.workshop.fault_matrix.inject_cells import Bench, Cell, Conditions, Course
from tests.workshop.fault_matrix.inject_report import FaultReport, screen_table, write_report

WIDTH = 160
"""Minimum width of the printed table [characters]."""
FAILED, WRONG = 1, 2
"""Exit codes."""


def read_options(arguments: Sequence[str] | None) -> argparse.Namespace:
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
    text = "controller; default: %(default)s"
    add("--controller", choices=CONTROLLERS, default=default.controller, help=text)
    add("--vehicle", default=default.vehicle, help="vehicle; default: %(default)s")
    text = "limits of the guard; default: %(default)s, which clips only what no car can do"
    add("--guard", default=default.guard, help=text)
    add(
        "--seed",
        type=int,
        default=default.seed,
        help="seed of all random numbers; default: %(default)s",
    )
    add("--obey", action="store_true", help="the driver brakes when a stop is requested")
    text = "the car receives the controller's own commands"
    add("--no-gate", dest="gated", action="store_false", help=text)
    add("--output", type=Path, default=Path("runs/faults"), help="folder; default: %(default)s")
    return parser.parse_args(arguments)


def roads() -> list[str]:
    """Return the available roads; `make data` writes a circuit where none is recorded."""
    there = (DATA / "tracks" / f"{CIRCUIT}.csv").is_file()
    return [name for name in SCENARIOS if name != CIRCUIT or there]


def cases_of(names: Sequence[str]) -> list[Case]:
    """Return the faults of these names; all faults without names.

    Raises:
        ValueError: A name is unknown.
    """
    by_name = {case.name: case for case in CASES}
    for name in names:
        if name not in by_name:
            raise ValueError(f"--faults: {name!r} must be one of {', '.join(by_name)}")
    return [by_name[name] for name in names] or list(CASES)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    chosen, console = read_options(arguments), Console(highlight=False, soft_wrap=True)
    words = list(sys.argv[1:] if arguments is None else arguments)
    command = f"python -m tests.workshop.fault_matrix.inject {shlex.join(words)}".strip()
    try:
        report = run_matrix(chosen, command, console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    failed = sum(cell.fails for cell in report.cells)
    return FAILED if failed else 0


def run_matrix(chosen: argparse.Namespace, command: str, console: Console) -> FaultReport:
    """Drive all cells, print and write the report.

    Raises:
        ValueError: Names option, value and bound.
    """
    check_range("--seed", chosen.seed, SEED)
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
    report = FaultReport(command, conditions, courses, [case.name for case in cases], cells)
    console.width = max(console.width, WIDTH)
    console.print(screen_table(report))
    write_report(report, chosen.output)
    console.print(f"faults.json, .md and .png: {chosen.output}", markup=False)
    return report


def drive_all(
    bench: Bench, cases: Sequence[Case], courses: Sequence[Course], console: Console
) -> list[Cell]:
    """Drive all cells with a progress bar."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    pairs = [(case, course) for case in cases for course in courses]
    with Progress(*columns, TimeElapsedColumn(), console=console) as bar:
        return [bench.cell(*pair) for pair in bar.track(pairs, description="drives")]


if __name__ == "__main__":
    sys.exit(main())
