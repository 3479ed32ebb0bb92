"""What a run leaves behind: numbers, a picture, a table."""

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table
from rich.text import Text

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import evaluate
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.scenarios.scenario import Scenario
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.bags.drive_log import drive_log
from launch_scripts.report import write
from launch_scripts.reporting.context import ReportInputs
from launch_scripts.reporting.drive import judge_columns
from launch_scripts.run.figure import draw
from sim_vehicle.parameters import load_vehicle

LABELS = {
    "mse_m2": ("MSE of the cross-track error", "m2"),
    "mse_lateral_m2": ("MSE of Y - Y_ref(X), the paper's", "m2"),
    "rms_error_m": ("RMS cross-track error", "m"),
    "p95_error_m": ("95 % of the cross-track error below", "m"),
    "max_error_m": ("largest cross-track error", "m"),
    "rms_heading_error_deg": ("RMS heading error", "deg"),
    "steering_rms_increment_deg": ("steering effort, RMS increment", "deg/tick"),
    "steering_reversals": ("steering reversals", ""),
    "steering_max_deg": ("largest steering angle", "deg"),
    "solve_time_p50_us": ("solve time, median", "us"),
    "solve_time_p99_us": ("solve time, 99 %", "us"),
    "solve_time_max_us": ("solve time, largest", "us"),
    "ticks": ("ticks", ""),
    "missed_ticks": ("missed ticks", ""),
}


class Run(NamedTuple):
    """One run, as it was asked for."""

    folder: Path
    scenario: Scenario
    options: dict[str, Any]
    """Of the command line."""

    @property
    def bag(self) -> Path:
        """Folder of the recording."""
        return self.folder / "bag"

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return self.folder.resolve().name

    @property
    def title(self) -> str:
        """What was driven, by whom, with which car."""
        controller, vehicle = self.options["controller"], Path(self.options["vehicle"]).stem
        return f"{self.scenario.name}, {controller}, {vehicle} car"


def judge(run: Run, ended: str) -> Table:
    """Write `metrics.json`, `drive.png` and `report.html` of the bag; give the table to show.

    Args:
        run: Its folder holds the bag.
        ended: How the run ended, in words.

    Raises:
        ValueError: The bag holds no drive.
    """
    vehicle = load_vehicle(find("vehicles", run.options["vehicle"]))
    chassis = vehicle.chassis
    settings = load(ControllerSettings, find("controllers", run.options["settings"]))
    columns = read_columns(run.bag)
    log = drive_log(columns)
    metrics = evaluate(log.drive, log.path, chassis.cg_to_rear_axle, settings.sample_time)
    content = {
        "run": run.options,
        "ended": ended,
        "version": __version__,
        "metrics": {key: value if math.isfinite(value) else None for key, value in metrics.items()},
    }
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    (run.folder / "metrics.json").write_text(text, encoding="utf-8")
    draw(log, run.scenario.lanes, chassis.cg_to_rear_axle, run.title, run.folder / "drive.png")
    drive = judge_columns(
        columns, run.name, ReportInputs(vehicle, settings, run.options["controller"])
    )
    write(run.folder / "report.html", [drive], None, f"Made after a run of {run.title}")
    return table(run.title, metrics)


def table(title: str, metrics: dict[str, float]) -> Table:
    """Lay the numbers out for the terminal; what is not defined for a path is left out."""
    result = Table(title=Text(title), title_justify="left")
    for heading in ("quantity", "value", "unit"):
        result.add_column(heading, justify="right" if heading == "value" else "left")
    for key, (label, unit) in LABELS.items():
        if math.isfinite(metrics[key]):
            result.add_row(label, f"{metrics[key]:.4g}", unit)
    return result
