"""Drive of a bag, and the result of a run."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rich.console import Console
from std_msgs.msg import Float64

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import type_name_of
from ampc_msgs_config.types import NANOSECONDS, Array, Diagnosis, Plan, VehicleState
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.bags.drive_log import drive_log
from launch_scripts.run.options import Run, read_run_options
from launch_scripts.run.result import write_result
from sim_vehicle.parameters import load_vehicle_file

TICK_NS = NANOSECONDS // 10
ANGLE = np.linspace(0.0, 6.0, 200)
STRAIGHT = np.column_stack((100.0 * ANGLE, 0.2 * np.sin(ANGLE)))
CIRCLE = np.column_stack((50.0 * np.sin(ANGLE), 50.0 - 50.0 * np.cos(ANGLE)))


def drive_messages(points: Array) -> dict[str, list[Any]]:
    """Return the messages of a drive along points, one per tick, 0.1 m beside them."""
    messages: dict[str, list[Any]] = {ros.REFERENCE_PATH: [ros.path_message(points, 0)]}
    for tick, (x, y) in enumerate(points[::10]):
        stamp_ns = NANOSECONDS + tick * TICK_NS
        state = VehicleState(stamp_ns, x, y + 0.1, yaw=0.0, v_x=8.0, v_y=0.0, yaw_rate=0.0)
        command = Plan(stamp_ns, 0.01 * tick, 0.1, Diagnosis())
        for topic, message in {
            ros.ODOM: ros.odometry_message(state),
            ros.STEERING_COMMAND: ros.steering_message(command),
            ros.TARGET_SPEED: ros.speed_message(ros.Stamped(stamp_ns, 8.0)),
            "controller/debug/solve_time": Float64(data=1.0e-4),
        }.items():
            messages.setdefault(topic, []).append(message)
    return messages


def write_bag(bag: Path, drives: dict[str, dict[str, list[Any]]]) -> Path:
    """Write the messages of drives, each in its namespace."""
    with Recording(bag) as recording:
        for namespace, topics in drives.items():
            for name, messages in topics.items():
                topic = f"{namespace}/{name}"
                recording.add_topic(topic, type_name_of(type(messages[0])))
                for time_ns, message in enumerate(messages):
                    recording.write(topic, serialize_message(message), time_ns, time_ns)
    return bag


def test_a_drive_is_read_from_any_namespace_and_never_mixed_with_another(tmp_path: Path) -> None:
    drives = {"/car1": drive_messages(STRAIGHT), "/fleet/car2": drive_messages(CIRCLE)}
    bag = write_bag(tmp_path / "bag", drives)
    first, second = drive_log(read_columns(bag)), drive_log(read_columns(bag, "/fleet/car2/"))
    assert first.drive.states[-1].x > 500.0
    assert second.drive.states[-1].x < 50.0
    assert len(first.drive.states) == len(first.target_speed) == len(first.drive.steering) == 20
    assert first.target_speed[[0, -1], 0] == pytest.approx([0.0, 1.9])


def test_a_bag_without_a_drive_is_refused_by_name(tmp_path: Path) -> None:
    nothing = write_bag(tmp_path / "nothing", {})
    with pytest.raises(ValueError, match="nothing: holds no message on steering_command"):
        drive_log(read_columns(nothing))
    topics = drive_messages(STRAIGHT)
    del topics[ros.TARGET_SPEED]
    with pytest.raises(ValueError, match="half: holds no message on /car1/target_speed"):
        drive_log(read_columns(write_bag(tmp_path / "half", {"/car1": topics})))
    topics = drive_messages(STRAIGHT)
    topics[ros.ODOM] = topics[ros.ODOM][:1]
    with pytest.raises(ValueError, match="short: 1 commands answer a recorded state, 2 are needed"):
        drive_log(read_columns(write_bag(tmp_path / "short", {"": topics})))


def test_what_is_not_defined_on_a_path_is_null_in_the_file_and_not_in_the_table(
    tmp_path: Path,
) -> None:
    chosen = vars(read_run_options(["--scenario", "circle"], None))
    del chosen["output"]
    size = load_vehicle_file(find("vehicles", "paper")).size
    run = Run(tmp_path, choose_scenario(Route("circle"), size), chosen)
    write_bag(run.bag, {"": drive_messages(CIRCLE)})
    table, incomplete = write_result(run, "interrupted by [SIGINT]")
    assert incomplete == ""
    result = json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8"))
    assert result["ended"] == "interrupted by [SIGINT]"
    assert result["run"]["controller"] == "preview"
    assert result["metrics"]["mse_lateral_m2"] is None
    assert result["metrics"]["missed_ticks"] == 0
    with Console(width=100) as console, console.capture() as shown:
        console.print(table)
    assert "Largest cross-track error" in shown.get()
    assert "Y_ref" not in shown.get()
    assert (tmp_path / "report.html").exists()
