"""Drive every controller on every road, in one run with the same car and noise; who is how good?

`python launch_scripts/compare.py --controllers preview preview=mine.yaml --scenarios sc1 road.csv`
leaves a table, a heat map and a page in `runs/compare`. A controller is NAME or NAME=GAINS, where
GAINS is a YAML file or a shipped table, so that one controller is compared with several of them.
The exit code is 0, also where a controller loses the car, and 2 where an option is wrong.
"""

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.parameters import ControllerSettings, SteeringParameters
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.validation import check_range, number
from ampc_ros.configuration import CONTROLLERS, default_table
from launch_scripts.comparing.cells import (
    QUANTITIES,
    Cell,
    Conditions,
    Contender,
    controller_of,
    drive_cell,
    plant,
)
from launch_scripts.comparing.page import write
from launch_scripts.comparing.table import Comparison, table_of
from sim_vehicle.car import RANGES
from sim_vehicle.parameters import MeasurementNoise, load_vehicle

PAPERS = ("sc1", "sc2", "sc3_constant", "sc3_varying", "sc3_wind", "sc3_fast_wind", "sc1_falcone")
"""Roads of the paper, and those derived from them; they come first."""
WIDTH = 120
"""Of the printed table, at least [characters]."""
WRONG = 2
"""Exit code where an option is wrong."""
SEEDS = number(0, 2**31 - 1)
LAPS = number(1, 1000)


def roads() -> list[str]:
    """Name the shipped scenarios, the paper's first."""
    return [*PAPERS, *(name for name in shipped("scenarios") if name not in PAPERS)]


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    names = f"{', '.join(CONTROLLERS)}, each with =GAINS or without; default: all"
    add("--controllers", nargs="+", metavar="NAME[=GAINS]", default=list(CONTROLLERS), help=names)
    names = f"{', '.join(roads())}, YAML or CSV files; default: all of these"
    add("--scenarios", nargs="+", metavar="ROAD", default=roads(), help=names)
    add("--speed", type=float, default=-1.0, help="constant, on all roads [m/s]; -1: as given")
    text = "largest along CSV files' paths [m/s^2]; -1: speed as given"
    add("--lateral-acceleration", type=float, default=-1.0, help=text)
    add("--laps", type=int, default=1, help="of CSV files' closed paths")
    add_conditions(parser, Conditions())
    text = "of table and heat map; the page shows all; default: %(default)s"
    add("--quantity", choices=QUANTITIES, default="rms", help=text)
    add("--output", type=Path, default=Path("runs/compare"), help="folder; default: %(default)s")
    return parser.parse_args(arguments)


def add_conditions(parser: argparse.ArgumentParser, default: Conditions) -> None:
    """Add the options of what all cells share."""
    add, unknown = parser.add_argument, "unknown to the controllers"
    add("--vehicle", default=default.vehicle, help="the car; default: %(default)s")
    add("--settings", default=default.settings, help="of the controllers; default: %(default)s")
    text = f"of the road, {unknown}; default: that of the tyres"
    add("--friction", type=float, default=default.friction, help=text)
    text = f"of the steering, on top of the car's own and {unknown} [s]; default: 0"
    add("--delay", type=float, default=default.delay, help=text)
    add("--noise", default=default.noise, help="of the measurement, such as x1; default: none")
    text = "of the noise, the same in every cell; default: 0"
    add("--seed", type=int, default=default.seed, help=text)


@contextmanager
def naming(option: str) -> Iterator[None]:
    """Begin complaints with the option that is wrong."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"--{option}: {error}") from error


def conditions_of(chosen: argparse.Namespace) -> Conditions:
    """Check what all cells share.

    Raises:
        ValueError: Names option, value and bound.
    """
    with naming("vehicle"):
        load_vehicle(find("vehicles", chosen.vehicle))
    with naming("settings"):
        load(ControllerSettings, find("controllers", chosen.settings))
    if chosen.noise:
        with naming("noise"):
            load(MeasurementNoise, find("noise", chosen.noise))
    if chosen.friction is not None:
        check_range("--friction", chosen.friction, RANGES["friction"])
    with naming("delay"):
        SteeringParameters(max_angle=1.0, delay=chosen.delay)
    check_range("--seed", chosen.seed, SEEDS)
    return Conditions(*(getattr(chosen, field) for field in Conditions._fields))


def contenders_of(texts: Sequence[str], conditions: Conditions) -> list[Contender]:
    """Read NAME or NAME=GAINS of each.

    Raises:
        ValueError: Names the entry, and what is known; or one stands there twice.
    """
    found = []
    for text in texts:
        with naming(f"controllers {text}"):
            contender = read_contender(text, conditions.vehicle)
            controller_of(contender, conditions)
        found.append(contender)
    check_once("controllers", [contender.label for contender in found])
    return found


def read_contender(text: str, vehicle: str) -> Contender:
    """Read one entry; its label is what was typed, without the folder and ending of a file."""
    name, given, gains = text.partition("=")
    if name not in CONTROLLERS:
        raise ValueError(f"{name!r} must be one of {', '.join(CONTROLLERS)}")
    if not given:
        return Contender(name, name, "" if name == "pure_pursuit" else default_table(name, vehicle))
    if name == "pure_pursuit":
        raise ValueError("pure_pursuit has no gains")
    return Contender(f"{name}={find('gains', gains).stem}", name, gains)


def scenarios_of(chosen: argparse.Namespace, conditions: Conditions) -> list[Scenario]:
    """Load the roads.

    Raises:
        ValueError: Names the entry with file, key and value, or what is known, or is there twice.
    """
    check_range("--laps", chosen.laps, LAPS)
    size, found = load_vehicle(find("vehicles", conditions.vehicle)).size, []
    for text in chosen.scenarios:
        scenario, path = ("", text) if text.endswith(".csv") else (text, "")
        with naming(f"scenarios {text}"):
            route = Route(scenario, path, chosen.speed, chosen.lateral_acceleration, chosen.laps)
            found.append(choose_scenario(route, size))
            plant(conditions, found[-1])
    check_once("scenarios", [scenario.name for scenario in found])
    return found


def check_once(option: str, labels: Sequence[str]) -> None:
    """Complain of the first label that stands there twice."""
    for i, label in enumerate(labels):
        if label in labels[:i]:
            raise ValueError(f"--{option}: {label!r} is there twice; give one file another name")


def drive_all(
    contenders: Sequence[Contender],
    scenarios: Sequence[Scenario],
    conditions: Conditions,
    console: Console,
) -> list[Cell]:
    """Drive all cells, one after the other, so that no drive disturbs the time of another."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    pairs = [(contender, scenario) for scenario in scenarios for contender in contenders]
    with Progress(*columns, TimeElapsedColumn(), console=console) as bar:
        return [drive_cell(*pair, conditions) for pair in bar.track(pairs, description="drives")]


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, show, write; gives the exit code."""
    chosen, console = options(arguments), Console(highlight=False, soft_wrap=True)
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        run(chosen, f"python launch_scripts/compare.py {shlex.join(given)}".strip(), console)
    except ValueError as error:
        console.print(Text.assemble(("error:", "red"), f" {error}"))
        return WRONG
    return 0


def run(chosen: argparse.Namespace, command: str, console: Console) -> None:
    """Do what is asked for.

    Raises:
        ValueError: In one sentence what is wrong.
    """
    conditions = conditions_of(chosen)
    contenders = contenders_of(chosen.controllers, conditions)
    scenarios = scenarios_of(chosen, conditions)
    with naming("output"):
        make_folder(chosen.output)
    cells = drive_all(contenders, scenarios, conditions, console)
    comparison = Comparison(command, conditions, contenders, scenarios, cells)
    console.width = max(console.width, WIDTH)
    console.print(table_of(comparison, chosen.quantity))
    write(comparison, chosen.quantity, chosen.output)
    console.print(f"page.html, compare.json, .md and .png: {chosen.output}", markup=False)


def make_folder(folder: Path) -> None:
    """Make a folder; what an earlier comparison left in it is replaced."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"{folder}: cannot make this folder: {error.strerror}") from error


if __name__ == "__main__":
    sys.exit(main())
