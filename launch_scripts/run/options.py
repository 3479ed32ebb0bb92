"""Options of a run, and a check of all names and files before any node starts.

Functions import what loads compiled code, so that help and wrong options are answered without it.
"""

import argparse
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.parameters import ControllerSettings, GuardLimits
from ampc_ros.configuration import CONTROLLERS, Choices, check_controller, is_custom

if TYPE_CHECKING:
    from rich.console import Console

    from ampc_msgs_config.scenarios.scenario import Scenario
    from sim_vehicle.parameters import Vehicle

IDENTIFICATION = "identification"
"""Name of the manoeuvre, and of the settings that drive it."""
MANOEUVRE_FILE = "manoeuvre.csv"
"""Path of the manoeuvre, in the folder of the run."""

NAMESPACE = re.compile(r"/?[A-Za-z_]\w*(?:/[A-Za-z_]\w*)*", re.ASCII)


class Run(NamedTuple):
    """One run of the start script."""

    folder: Path
    scenario: "Scenario"
    options: dict[str, Any]
    """Options of the command line."""

    @property
    def bag(self) -> Path:
        """Folder of the recording."""
        return self.folder / "bag"

    @property
    def title(self) -> str:
        """Scenario, controller and car."""
        controller = controller_label(self.options["controller"])
        return f"{self.scenario.name}, {controller}, {Path(self.options['vehicle']).stem} car"


def read_run_options(arguments: Sequence[str] | None, about: str | None) -> argparse.Namespace:
    """Return the options of the command line.

    Args:
        arguments: Words of the command line; None: those of this process.
        about: First text of `--help`.
    """
    parser = argparse.ArgumentParser(description=about)

    def add(name: str, value: Any, text: str, folder: str = "", **how: Any) -> None:
        names = f"YAML file, or {', '.join(shipped(folder))}; " if folder else ""
        shown = "; default: %(default)s" if value not in (None, "") else ""
        parser.add_argument(name, default=value, help=f"{names}{text}{shown}".lstrip(), **how)

    default = Choices()
    names = f"{', '.join(CONTROLLERS)}, or a class of yours: my_file.py:MyController"
    add("--scenario", "sc1", "scenario to drive", "scenarios")
    add("--path", "", "CSV file of x_m,y_m[,v_mps] or t_s,x_m,y_m, instead of a scenario")
    text = "drive the manoeuvre for identify.py, scaled to the car, instead of a scenario; default "
    text += "controller and settings are then pure_pursuit and identification"
    add("--manoeuvre", "", text, choices=(IDENTIFICATION,))
    text = "write the path of the manoeuvre to this CSV file, for a real car, and end"
    add("--write-path", None, text, type=Path)
    add_speed_options(parser)
    text = "columns of the CSV file by number or name, such as x=3,y=4; default: by its header"
    add("--columns", "", text)
    add("--vehicle", default.vehicle, "the car", "vehicles")
    add("--controller", default.controller, f"{names}; steers the car")
    add("--settings", default.settings, "limits of the controller", "controllers")
    add("--gain-table", default.gain_table, "gains of the controller", "gains")
    add("--guard", "track", "limits of every command", "guards")
    add("--friction", -1.0, "friction of the road, 0.01 to 3; -1: that of the tyres", type=float)
    add("--noise", "", "measurement noise; default: none", "noise")
    add("--seed", 0, "seed of the noise", type=int)
    text = "fault injection between simulator and controller, in real time; default: none"
    add("--faults", "", text, "faults")
    text = "vehicle of the simulated car, where it differs from that of the controller"
    add("--true-vehicle", "", text)
    text = "reject a gain table without a valid certificate"
    add("--require-certificate", False, text, action="store_true")
    add("--real-time", False, "run freely instead of in lock-step", action="store_true")
    text = "connect the car directly to controller and planner, without the gate"
    add("--no-gate", False, text, action="store_true")
    text = "namespace of nodes, topics, clock and frames, such as car1; default: none"
    add("--namespace", "", text)
    add("--time-out", 10.0, "longest time to wait for the answer of a node [s]", type=float)
    add("--output", None, "new folder of the run; default: runs/<time>_<name>", type=Path)
    options = parser.parse_args(arguments)
    if options.manoeuvre:
        if options.controller == default.controller:
            options.controller = "pure_pursuit"
        if options.controller == "pure_pursuit" and options.settings == default.settings:
            options.settings = IDENTIFICATION
    return options


def add_speed_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the speed along a path, and of its laps."""
    add = parser.add_argument
    text = "constant speed [m/s]; -1: that of the scenario or file"
    add("--speed", type=float, default=-1.0, help=text)
    text = "largest lateral acceleration along the path of a CSV file [m/s^2]; -1: its own speed"
    add("--lateral-acceleration", type=float, default=-1.0, help=text)
    add("--laps", type=int, default=1, help="number of laps on the closed path of a CSV file")


def controller_label(name: str) -> str:
    """Return the display name of a controller: the shipped name, or the name of the class."""
    return name.rpartition(":")[2]


def check_files(options: argparse.Namespace) -> None:
    """Read the files that the options name.

    Raises:
        ValueError: Names the option, the file and the cause.
    """
    from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

    files: dict[str, tuple[str, Callable[[Path], Any]]] = {
        "vehicle": ("vehicles", load_vehicle_file),
        "settings": ("controllers", partial(load, ControllerSettings)),
        "guard": ("guards", partial(load, GuardLimits)),
        "noise": ("noise", partial(load, MeasurementNoise)),
    }
    for option, (folder, read) in files.items():
        if getattr(options, option, ""):
            with naming(option):
                read(find(folder, getattr(options, option)))


def print_vehicle_warnings(vehicle: str, console: "Console") -> None:
    """Print a line for each implausible value of a vehicle.

    Args:
        vehicle: Shipped name, or file.
        console: Output.

    Raises:
        ValueError: The file is missing or wrong.
    """
    from rich.text import Text

    from ampc_msgs_config.vehicle_warnings import file_warnings

    for sentence in file_warnings(find("vehicles", vehicle)):
        console.print(Text.assemble(("warning:", "yellow"), f" {sentence}"))


@contextmanager
def naming(option: str) -> Iterator[None]:
    """Prefix the message of a ValueError with the invalid option."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"--{option}: {error}") from error


def prepare_run(options: argparse.Namespace) -> Run:
    """Load everything that the options name, and create the folder of the run.

    Raises:
        ValueError: Names the invalid option or file in one sentence.
    """
    from ampc_msgs_config.paths.path_file import Route, choose_scenario
    from ampc_ros.mpc.gain_table import load_gain_table
    from sim_vehicle.parameters import load_vehicle_file

    check_files(options)
    check_namespace(options.namespace)
    options.controller = check_controller(options.controller)
    if is_custom(options.controller):
        from ampc_ros.controller import make_controller  # loads all controllers

        make_controller(Choices(options.controller, options.vehicle, options.settings))
    if options.gain_table:
        load_gain_table(options.gain_table)
    if options.faults:
        from launch_scripts.faults.schedule import load_faults

        load_faults(options.faults)
    vehicle = load_vehicle_file(find("vehicles", options.vehicle))
    label = controller_label(options.controller)
    if options.true_vehicle:
        load_vehicle_file(find("vehicles", options.true_vehicle))
    if options.manoeuvre:
        default = Route()
        for key in Route._fields:
            if getattr(options, key) != getattr(default, key):
                name = key.replace("_", "-")
                raise ValueError(f"--{name}: the manoeuvre has its own path and speed")
        folder = options.output or Path("runs") / run_name(options.manoeuvre, label)
        create_folder(folder, exist_ok=False)
        options.path = str(folder / MANOEUVRE_FILE)
        write_path(folder / MANOEUVRE_FILE, vehicle)
    route = Route(*(getattr(options, key) for key in Route._fields))
    scenario = choose_scenario(route, vehicle.size)
    if not options.manoeuvre:
        folder = options.output or Path("runs") / run_name(scenario.name, label)
        create_folder(folder, exist_ok=False)
    values = {k: v for k, v in vars(options).items() if k not in ("output", "write_path")}
    return Run(folder, scenario, values)


def check_namespace(namespace: str) -> None:
    """Raise a ValueError unless a text is empty or a namespace of ROS, with or without `/`."""
    if namespace and not NAMESPACE.fullmatch(namespace):
        raise ValueError(
            f"--namespace: {namespace!r} must consist of letters, digits and _, such as car1"
        )


def run_name(scenario: str, controller: str) -> str:
    """Return the name of the folder of a run."""
    return f"{datetime.now():%Y%m%d_%H%M%S}_{scenario}_{controller}"


def write_path(file: Path, vehicle: "Vehicle") -> None:
    """Write the manoeuvre of the identification for a car.

    Raises:
        ValueError: The file cannot be written.
    """
    from ampc_msgs_config.paths.manoeuvre import write_manoeuvre

    try:
        write_manoeuvre(file, vehicle.chassis.wheelbase, vehicle.steering.max_angle)
    except OSError as error:
        raise ValueError(f"{file}: cannot be written: {error.strerror}") from error


def create_folder(folder: Path, *, exist_ok: bool) -> None:
    """Create a folder.

    Raises:
        ValueError: The folder cannot be created, or exists and `exist_ok` is False.
    """
    try:
        folder.mkdir(parents=True, exist_ok=exist_ok)
    except OSError as error:
        raise ValueError(f"{folder}: cannot create this folder: {error.strerror}") from error
