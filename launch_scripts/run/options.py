"""The options of a run, and a check of all that they name before any node starts."""

import argparse
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.parameters import ControllerSettings, GuardLimits
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_ros.configuration import CONTROLLERS, Choices
from ampc_ros.mpc.gain_table import load_gain_table
from launch_scripts.faults.schedule import load_plan
from launch_scripts.run.result import Run
from sim_vehicle.parameters import MeasurementNoise, load_vehicle


def options(arguments: Sequence[str] | None, about: str | None) -> argparse.Namespace:
    """Read the command line.

    Args:
        arguments: Its words; None: those of this process.
        about: What `--help` says first.
    """
    parser = argparse.ArgumentParser(description=about)

    def add(name: str, value: Any, text: str, folder: str = "", **how: Any) -> None:
        names = f"YAML file, or {', '.join(shipped(folder))}; " if folder else ""
        shown = "; default: %(default)s" if value not in (None, "") else ""
        parser.add_argument(name, default=value, help=f"{names}{text}{shown}".lstrip(), **how)

    add_route(add)
    add_car(add)
    add("--real-time", False, "run free instead of in lock-step", action="store_true")
    add("--time-out", 10.0, "longest wait for a node's answer [s]", type=float)
    add("--output", None, "new folder of the run; default: runs/<time>_<name>", type=Path)
    return parser.parse_args(arguments)


def add_route(add: Callable[..., None]) -> None:
    """Offer the options that choose what to drive."""
    add("--scenario", "sc1", "what to drive", "scenarios")
    add("--path", "", "CSV of x_m,y_m[,v_mps] or t_s,x_m,y_m to drive instead of a scenario")
    add("--speed", -1.0, "constant speed [m/s]; -1: as given", type=float)
    text = "largest along the CSV's path [m/s^2]; -1: speed as given"
    add("--lateral-acceleration", -1.0, text, type=float)
    add("--laps", 1, "of a CSV's closed path", type=int)


def add_car(add: Callable[..., None]) -> None:
    """Offer the options that choose the car, who steers it, and what makes that hard."""
    default = Choices()
    add("--vehicle", default.vehicle, "the car", "vehicles")
    add("--controller", default.controller, "who steers", choices=CONTROLLERS)
    add("--settings", default.settings, "limits of the controller", "controllers")
    add("--gain-table", default.gain_table, "gains of the controller", "gains")
    add("--guard", "track", "limits of every command", "guards")
    add("--friction", -1.0, "of the road, 0.01 to 3; -1: that of the tyres", type=float)
    add("--noise", "", "of the measurement; default: none", "noise")
    add("--seed", 0, "of the noise", type=int)
    text = "between simulator and controller, in real time; default: none"
    add("--faults", "", text, "faults")


def prepare(chosen: argparse.Namespace) -> Run:
    """Load all that was named, so that what is wrong is said before any node starts.

    Raises:
        ValueError: Names what is wrong, in one sentence.
    """
    size = load_vehicle(find("vehicles", chosen.vehicle)).size
    load(ControllerSettings, find("controllers", chosen.settings))
    if chosen.gain_table:
        load_gain_table(chosen.gain_table)
    load(GuardLimits, find("guards", chosen.guard))
    if chosen.noise:
        load(MeasurementNoise, find("noise", chosen.noise))
    if chosen.faults:
        load_plan(chosen.faults)
    scenario = choose_scenario(Route(*(getattr(chosen, key) for key in Route._fields)), size)
    given = {key: value for key, value in vars(chosen).items() if key != "output"}
    name = f"{datetime.now():%Y%m%d_%H%M%S}_{scenario.name}_{chosen.controller}"
    return Run(new_folder(chosen.output or Path("runs") / name), scenario, given)


def new_folder(folder: Path) -> Path:
    """Make the folder of a run; one that exists is never written into."""
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ValueError(f"{folder}: cannot make this folder: {error.strerror}") from error
    return folder
