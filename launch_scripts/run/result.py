"""Result of a run: metrics as JSON, report, and a table for the terminal."""

import json
import math

from rich.table import Table

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import METRICS, RESULT, evaluate_drive
from ampc_msgs_config.parameters import ControllerSettings
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.bags.drive_log import drive_log
from launch_scripts.reporting.drive import judge_columns, load_car, run_context_of
from launch_scripts.reporting.page import write_report
from launch_scripts.reporting.pages import terminal_table, to_json
from launch_scripts.run.options import Run
from launch_scripts.run.processes import COMPLETED


def write_result(run: Run, ended: str) -> tuple[Table, str]:
    """Write `metrics.json` and `report.html` of a run.

    Args:
        run: Its folder contains the bag.
        ended: Reason why the run ended.

    Returns:
        Table of its metrics, and why the drive did not reach its end; empty: it did.

    Raises:
        ValueError: The bag contains no drive.
    """
    options = run.options
    vehicle = load_car(find("vehicles", options["vehicle"]))
    settings = load(ControllerSettings, find("controllers", options["settings"]))
    columns = read_columns(run.bag, steering=vehicle.steering)
    log = drive_log(columns)
    to_cg = vehicle.chassis.cg_to_rear_axle
    metrics = evaluate_drive(log.drive, log.path, to_cg, settings.sample_time)
    context = run_context_of(columns, vehicle, settings, options["controller"])
    drive = judge_columns(columns, run.folder.resolve().name, context)
    if ended == COMPLETED and drive.incomplete:
        ended = f"not completed: {drive.incomplete}"
    content = {"run": options, "ended": ended, "version": __version__, "metrics": metrics}
    text = json.dumps(to_json(content), indent=2, allow_nan=False) + "\n"
    (run.folder / "metrics.json").write_text(text, encoding="utf-8")
    write_report(run.folder / "report.html", [drive], "", f"Written after a run of {run.title}")
    rows = [
        (METRICS[key].title, f"{metrics[key] * METRICS[key].scale:.4g}", METRICS[key].unit)
        for key in RESULT
        if math.isfinite(metrics[key])
    ]
    for key in ("distance", "fall_backs", "unsolved_ticks", "stop_requests"):
        if count := drive.metrics[key]:
            rows.append((METRICS[key].title, f"{count:.4g}", METRICS[key].unit))
    table = terminal_table(("quantity", "value", "unit"), rows, "lrl", run.title)
    return table, drive.incomplete
