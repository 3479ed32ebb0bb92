"""Compare controllers: drive each of them on each road, with the same car and noise.

`python launch_scripts/compare.py --controllers preview preview=mine.yaml --scenarios sc1 road.csv`
writes a table, a heat map and a page to `runs/compare`. A controller is NAME, NAME=GAINS with a
YAML file or a shipped table, or `my_file.py:MyController` (a class with `period` and
`step(state, path)`). The exit code is 0, even if a controller loses the car, and 2 if an option is
invalid.
"""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.validation import check_range, number
from ampc_ros.configuration import CONTROLLERS, DEFAULT_TABLES, check_controller, default_table
from launch_scripts.comparing.cells import (
    COMPARED_METRICS,
    Conditions,
    Contender,
    build_simulation,
    controller_of,
    drive_cell,
)
from launch_scripts.comparing.results import Comparison, comparison_table, write_comparison
from launch_scripts.reporting.pages import add_format_option
from launch_scripts.run.options import (
    add_speed_options,
    check_files,
    controller_label,
    create_folder,
    naming,
    print_vehicle_warnings,
)
from sim_vehicle.car import CAR_RANGES
from sim_vehicle.parameters import load_vehicle_file

PAPERS = ("sc1", "sc2", "sc3_constant", "sc3_varying", "sc3_wind", "sc3_fast_wind", "sc1_falcone")
"""Roads of the paper and those derived from them, which are driven first."""
TABLE_WIDTH = 120
"""Smallest width of the printed table [characters]."""
WRONG = 2
"""Exit code for an invalid option."""
OPTION_BOUNDS = {
    "laps": number(1, 1000),
    "seed": number(0, 2**31 - 1),
    "friction": CAR_RANGES["friction"],
}


def read_compare_options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    roads = [*PAPERS, *(name for name in shipped("scenarios") if name not in PAPERS)]
    default = Conditions()._asdict()

    def add(name: str, text: str, **how: Any) -> None:
        value = how.setdefault("default", default.get(name))
        shown = "; default: %(default)s" if value and not isinstance(value, list) else ""
        parser.add_argument(f"--{name}", help=text + shown, **how)

    text = f"{', '.join(CONTROLLERS)}, each also as NAME=GAINS, or FILE.py:CLASS; default: all"
    add("controllers", text, nargs="+", metavar="NAME[=GAINS]", default=list(CONTROLLERS))
    text = f"{', '.join(roads)}, YAML or CSV files; default: all of these"
    add("scenarios", text, nargs="+", metavar="ROAD", default=roads)
    add_speed_options(parser)
    add("vehicle", "the car")
    add("settings", "settings of all controllers")
    text = "friction of the road, unknown to the controllers; default: that of the tyres"
    add("friction", text, type=float)
    text = "additional steering delay, unknown to the controllers [s]; default: 0"
    add("delay", text, type=float)
    add("noise", "measurement noise, such as x1; default: none")
    add("seed", "seed of the noise, equal in all cells; default: 0", type=int)
    text = "metric of table and heat map; the page shows all"
    add("quantity", text, choices=COMPARED_METRICS, default="rms")
    add("output", "folder", type=Path, default=Path("runs/compare"))
    add_format_option(parser, "table, figures, or figures on the pages of one file")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive all cells, print and write the result, and return the exit code."""
    options, console = read_compare_options(arguments), Console(highlight=False, soft_wrap=True)
    words = shlex.join(sys.argv[1:] if arguments is None else arguments)
    try:
        conditions = conditions_of(options)
        print_vehicle_warnings(options.vehicle, console)
        contenders = contenders_of(options.controllers, conditions)
        scenarios = scenarios_of(options, conditions)
        with naming("output"):
            create_folder(options.output, exist_ok=True)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    # One after the other, so that solve times stay comparable.
    pairs = [(contender, scenario) for scenario in scenarios for contender in contenders]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as bar:
        cells = [drive_cell(*pair, conditions) for pair in bar.track(pairs, description="drives")]
    command = f"python launch_scripts/compare.py {words}".strip()
    comparison = Comparison(command, conditions, contenders, scenarios, cells)
    key = COMPARED_METRICS[options.quantity]
    console.width = max(console.width, TABLE_WIDTH)
    console.print(comparison_table(comparison, key))
    files = write_comparison(comparison, key, options.output, options.format)
    console.print(f"{', '.join(files)}: {options.output}", markup=False)
    return 0


def conditions_of(options: argparse.Namespace) -> Conditions:
    """Return the checked conditions of all cells.

    Raises:
        ValueError: Names option, value and bound.
    """
    check_files(options)
    with naming("delay"):
        SteeringParameters(max_angle=1.0, lag=0.0, delay=options.delay)
    for name, bounds in OPTION_BOUNDS.items():
        if getattr(options, name) is not None:
            check_range(f"--{name}", getattr(options, name), bounds)
    return Conditions(*(getattr(options, field) for field in Conditions._fields))


def contenders_of(texts: Sequence[str], conditions: Conditions) -> list[Contender]:
    """Return a checked contender for each NAME[=GAINS].

    Raises:
        ValueError: Names the invalid or repeated entry.
    """
    contenders = []
    for text in texts:
        with naming(f"controllers {text}"):
            contenders.append(read_contender(text, conditions.vehicle))
            controller_of(contenders[-1], conditions)
    check_unique("controllers", [contender.label for contender in contenders])
    return contenders


def read_contender(text: str, vehicle: str) -> Contender:
    """Return one contender; its label is the entry without folders and suffixes of files."""
    name, equals, gains = text.partition("=")
    label, controller = controller_label(name), check_controller(name)
    if not equals:
        table = default_table(name, vehicle) if name in DEFAULT_TABLES else ""
        return Contender(label, controller, table)
    if name not in DEFAULT_TABLES:
        raise ValueError(f"{label} has no gains")
    return Contender(f"{label}={find('gains', gains).stem}", controller, gains)


def scenarios_of(options: argparse.Namespace, conditions: Conditions) -> list[Scenario]:
    """Return the checked roads.

    Raises:
        ValueError: Names the invalid or repeated entry.
    """
    size, scenarios = load_vehicle_file(find("vehicles", conditions.vehicle)).size, []
    for text in options.scenarios:
        scenario, path = ("", text) if text.endswith(".csv") else (text, "")
        with naming(f"scenarios {text}"):
            route = Route(scenario, path, options.speed, options.lateral_acceleration, options.laps)
            scenarios.append(choose_scenario(route, size))
            build_simulation(conditions, scenarios[-1])
    check_unique("scenarios", [scenario.name for scenario in scenarios])
    return scenarios


def check_unique(option: str, labels: Sequence[str]) -> None:
    """Raise a ValueError for the first label that occurs twice."""
    for i, label in enumerate(labels):
        if label in labels[:i]:
            raise ValueError(f"--{option}: {label!r} occurs twice; rename one of the files")


if __name__ == "__main__":
    sys.exit(main())
