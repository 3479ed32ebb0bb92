"""Comparison from options to files: contenders, roads, drives, table and page."""

import argparse
from collections.abc import Sequence

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.validation import check_range, number
from ampc_ros.configuration import DEFAULT_TABLES, check_controller, default_table
from launch_scripts.comparing.cells import Contender, build_simulation, controller_of, drive_cell
from launch_scripts.comparing.conditions import COMPARED_METRICS, Conditions
from launch_scripts.comparing.results import Comparison, comparison_table, write_comparison
from launch_scripts.run.options import (
    check_files,
    controller_label,
    create_folder,
    naming,
    print_vehicle_warnings,
)
from sim_vehicle.car import CAR_RANGES
from sim_vehicle.parameters import load_vehicle_file

TABLE_WIDTH = 120
"""Smallest width of the printed table [characters]."""
OPTION_BOUNDS = {
    "laps": number(1, 1000),
    "seed": number(0, 2**31 - 1),
    "friction": CAR_RANGES["friction"],
}


def compare_chosen(options: argparse.Namespace, command: str, console: Console) -> None:
    """Drive all cells, print and write the result.

    Args:
        options: Options of the command line.
        command: Command that repeats the comparison.
        console: Where progress and results appear.

    Raises:
        ValueError: Names option, value and bound.
    """
    conditions = conditions_of(options)
    print_vehicle_warnings(options.vehicle, console)
    contenders = contenders_of(options.controllers, conditions)
    scenarios = scenarios_of(options, conditions)
    with naming("output"):
        create_folder(options.output, exist_ok=True)
    # One after the other, so that solve times stay comparable.
    pairs = [(contender, scenario) for scenario in scenarios for contender in contenders]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console) as bar:
        cells = [drive_cell(*pair, conditions) for pair in bar.track(pairs, description="drives")]
    comparison = Comparison(command, conditions, contenders, scenarios, cells)
    key = COMPARED_METRICS[options.quantity]
    console.width = max(console.width, TABLE_WIDTH)
    console.print(comparison_table(comparison, key))
    files = write_comparison(comparison, key, options.output, options.format)
    console.print(f"{', '.join(files)}: {options.output}", markup=False)


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
