"""Drive once over ROS 2: simulator, planner, controller and recorder, then the result.

`python launch_scripts/start.py --scenario sc2`, or `--path my_road.csv --speed 9`.
"""

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.drive_log import read_drive
from ampc_msgs_config.metrics import evaluate
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SizeParameters
from ampc_msgs_config.path_file import choose_scenario
from ampc_msgs_config.scenario import Scenario
from launch_scripts.environment import ros_environment
from launch_scripts.figure import draw
from launch_scripts.processes import Processes

READY_WITHIN = 120.0
"""Wall time for the first state, which includes compiling after an update [s]."""
LABELS = {
    "mse_m2": ("MSE of the cross-track error", "m2"),
    "mse_lateral_m2": ("MSE of Y - Y_ref(X), the paper's", "m2"),
    "rms_error_m": ("RMS cross-track error", "m"),
    "max_error_m": ("largest cross-track error", "m"),
    "steering_rms_increment_deg": ("steering effort, RMS increment", "deg/tick"),
    "steering_max_deg": ("largest steering angle", "deg"),
    "solve_time_p50_us": ("solve time, median", "us"),
    "solve_time_p99_us": ("solve time, 99 %", "us"),
    "solve_time_max_us": ("solve time, largest", "us"),
    "ticks": ("ticks", ""),
    "missed_ticks": ("missed ticks", ""),
}


class StartError(Exception):
    """What ended the run early, in one sentence, and the exit code."""

    def __init__(self, sentence: str, code: int = 1) -> None:
        super().__init__(sentence)
        self.code = code


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--scenario", default="sc1", help=f"YAML file, or {', '.join(shipped('scenarios'))}")
    add("--path", default="", help="CSV of x_m,y_m[,v_mps] or t_s,x_m,y_m instead of a scenario")
    add("--speed", type=float, help="constant speed instead of the given one [m/s]")
    add("--vehicle", default="paper", help=f"YAML file, or {', '.join(shipped('vehicles'))}")
    add("--controller", default="paper", help="paper, classic or pure_pursuit")
    add("--settings", default="table3", help="limits: YAML file, or shipped name")
    add("--gain-table", default="table3", help="YAML file, or shipped name")
    add("--friction", type=float, default=-1.0, help="of the road; default: the tyre's")
    add("--noise", default="", help="measurement noise: YAML file, or x1")
    add("--seed", type=int, default=0, help="of the noise")
    add("--real-time", action="store_true", help="run free instead of in lock-step")
    add("--time-out", type=float, default=10.0, help="for an answer in lock-step [s]")
    add("--output", type=Path, help="folder of the run; default: runs/<time>_<name>")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, judge, show; gives the exit code."""
    chosen, console = options(arguments), Console()
    signal.signal(signal.SIGTERM, lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    os.environ.update(ros_environment())
    try:
        size = load(SizeParameters, find("vehicles", chosen.vehicle), "size")
        scenario = choose_scenario(chosen.scenario, chosen.path, chosen.speed, size)
        folder = new_folder(chosen.output, f"{scenario.name}_{chosen.controller}")
        run(chosen, scenario, folder, console)
        show(chosen, scenario, folder, console)
    except (ValueError, StartError) as error:
        console.print(f"[red]error:[/] {error}", highlight=False, soft_wrap=True)
        return error.code if isinstance(error, StartError) else 2
    except KeyboardInterrupt:
        console.print("interrupted: all nodes are ended, the bag is closed")
        return 130
    return 0


def new_folder(wanted: Path | None, name: str) -> Path:
    """Make the folder of a run; one that exists is never written into."""
    folder = wanted or Path("runs") / f"{datetime.now():%Y%m%d_%H%M%S}_{name}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ValueError(f"{folder}: cannot make this folder: {error.strerror}") from error
    return folder


def run(chosen: argparse.Namespace, scenario: Scenario, folder: Path, console: Console) -> None:
    """Start the nodes, follow the drive, end the nodes."""
    lock_step = not chosen.real_time
    mode: dict[str, Any] = {"lock_step": lock_step}
    clock = {"use_sim_time": lock_step}
    drive = {
        "vehicle": chosen.vehicle,
        "scenario": chosen.scenario,
        "path": chosen.path,
        "speed": -1.0 if chosen.speed is None else chosen.speed,
    }
    control = {
        "vehicle": chosen.vehicle,
        "controller": chosen.controller,
        "settings": chosen.settings,
        "gain_table": chosen.gain_table,
    }
    plant = {
        "friction": chosen.friction,
        "noise": chosen.noise,
        "seed": chosen.seed,
        "time_out": chosen.time_out,
    }
    with Processes(folder / "log") as nodes:
        bag = folder / "bag"
        nodes.start("recorder", "ampc_msgs_config.recorder_node", clock | {"output": str(bag)})
        nodes.start("planner", "ampc_ros.planner_node", mode | clock | drive)
        nodes.start("controller", "ampc_ros.controller_node", mode | clock | control)
        with console.status("starting (an update compiles once, up to a minute)"):
            await_ready(nodes, bag / "metadata.yaml")
        nodes.start("simulator", "sim_vehicle.simulator_node", mode | drive | plant)
        follow(nodes, scenario, console)


def await_ready(nodes: Processes, bag: Path) -> None:
    """Wait until the recorder has its subscriptions and the controller is compiled."""
    until = time.monotonic() + READY_WITHIN
    while not (bag.exists() and "ready" in nodes.last_words("controller")):
        check(nodes)
        if time.monotonic() > until:
            raise StartError(f"not ready within {READY_WITHIN:g} s; logs: {nodes.logs}")
        time.sleep(0.05)


def check(nodes: Processes) -> None:
    """Raise if a node has ended that should not have."""
    for name, code in nodes.ended().items():
        if name == "simulator" and code == 0:
            continue
        how = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        raise StartError(f"{name} ended early ({how}): {nodes.last_words(name)}")


def follow(nodes: Processes, scenario: Scenario, console: Console) -> None:
    """Show the progress until the simulator has ended the drive."""
    from launch_scripts.drive_watch import DriveWatch  # needs the environment that main() set

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[at]}"))
    with DriveWatch() as watch, Progress(*columns, TimeElapsedColumn(), console=console) as bar:
        task = bar.add_task(scenario.name, total=scenario.duration, at="")
        while "simulator" not in nodes.ended():
            check(nodes)
            watch.spin(0.1)
            at = f"{watch.elapsed:.1f} of {scenario.duration:.1f} s driven, {watch.speed:.1f} m/s"
            bar.update(task, completed=watch.elapsed, at=at)
        check(nodes)
        bar.update(task, completed=scenario.duration, at=f"{scenario.duration:.1f} s driven")


def show(chosen: argparse.Namespace, scenario: Scenario, folder: Path, console: Console) -> None:
    """Judge the bag; write metrics and picture, print the table."""
    chassis = load(ChassisParameters, find("vehicles", chosen.vehicle), "chassis")
    period = load(ControllerSettings, find("controllers", chosen.settings)).sample_time
    log = read_drive(folder / "bag")
    metrics = evaluate(log.drive, log.path, chassis.cg_to_rear_axle, period)
    title = f"{scenario.name}, {chosen.controller}, {chosen.vehicle} car"
    facts = {key: value for key, value in vars(chosen).items() if key != "output"}
    content = {"run": facts, "version": __version__, "metrics": metrics}
    (folder / "metrics.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    draw(log, chassis.cg_to_rear_axle, title, folder / "drive.png")
    table = Table(title=title, title_justify="left")
    for heading in ("quantity", "value", "unit"):
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for key, (label, unit) in LABELS.items():
        table.add_row(label, f"{metrics[key]:.4g}", unit)
    console.print(table)
    console.print(f"bag, metrics.json, drive.png and logs: {folder}", highlight=False)


if __name__ == "__main__":
    sys.exit(main())
