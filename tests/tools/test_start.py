"""Start script: drive, files of the run, exit codes, and end of all processes."""

import json
import os
import re
import signal
import subprocess
import sys
import uuid
from pathlib import Path
from typing import NamedTuple

import pytest
from rich.console import Console

from ampc_msgs_config.config import find
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from launch_scripts import start
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.bags.drive_log import drive_log
from launch_scripts.run.processes import Processes
from launch_scripts.start import print_stop_request
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file
from tests.bag_samples import is_complete, read
from tests.tools.test_python_api import blocks
from tests.waiting import TIMEOUT, wait_for

ENOUGH = 6
"""States in the bag of a drive that a test interrupts."""
MARK = "AMPC_TEST_RUN"
MODULES = {
    "recorder": "ampc_msgs_config.nodes.recorder_node",
    "planner": "ampc_ros.nodes.planner_node",
    "controller": "ampc_ros.nodes.controller_node",
    "simulator": "sim_vehicle.nodes.simulator_node",
    "gate": "ampc_ros.nodes.gate_node",
    "markers": "ampc_msgs_config.nodes.marker_node",
}
NEEDED = [name for name in MODULES if name != "markers"]


class Started(NamedTuple):
    """A running start script."""

    process: subprocess.Popen[str]
    folder: Path
    mark: str
    """In the environment of the script and of all that it starts."""


def start_script(folder: Path, *options: str) -> Started:
    """Start the script."""
    mark = uuid.uuid4().hex
    process = subprocess.Popen(
        [sys.executable, start.__file__, "--output", str(folder), *options],
        env={**os.environ, MARK: mark},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    return Started(process, folder, mark)


def run(folder: Path, *options: str) -> tuple[int, str]:
    """Run the script to its end; return exit code and output."""
    started = start_script(folder, *options)
    said, _ = started.process.communicate(timeout=TIMEOUT)
    assert processes(started.mark) == {}
    return started.process.returncode, said


def processes(mark: str) -> dict[int, str]:
    """Return the command lines of the living processes that carry a mark, by their id."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (entry / "environ").read_bytes():
                found[int(entry.name)] = (entry / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue  # it has just ended, or belongs to another user
    return found


def pid_of(node: str, started: Started) -> int:
    """Return the id of a node's process."""
    found = [pid for pid, line in processes(started.mark).items() if MODULES[node] in line]
    assert len(found) == 1
    return found[0]


def recorded_states(started: Started) -> int:
    """Count the answered states in the bag of a drive; 0 where the bag cannot be read yet."""
    try:
        return len(drive_log(read_columns(started.folder / "bag")).drive.states)
    except ValueError:
        return 0


def start_and_drive(folder: Path) -> Started:
    """Start a long drive in real time, and wait until its beginning is on disk."""
    started = start_script(folder, "--real-time", "--controller", "pure_pursuit")
    log = folder / "log" / "planner.log"
    wait_for(lambda: log.exists() and "the drive starts" in log.read_text())
    wait_for(lambda: recorded_states(started) >= ENOUGH, period=0.3)
    return started


def drive_offline(scenario: str, controller: str) -> tuple[list[object], list[float]]:
    """Return states and commands of the same drive without ROS."""
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    car = Simulation(vehicle, load_scenario(scenario, vehicle.size))
    offline = drive(car, make_controller(Choices(controller=controller)))
    return list(offline.states), offline.steering.tolist()


@pytest.mark.parametrize(("settings", "rate"), [("table3", 50), ("50hz", 50), ("100hz", 100)])
def test_the_simulated_car_sends_states_at_the_rate_of_a_fast_controller(
    settings: str, rate: float
) -> None:
    assert start.state_rate(settings) == pytest.approx(rate)


def test_a_path_of_a_user_is_driven_in_real_time(tmp_path: Path) -> None:
    road = tmp_path / "road.csv"
    rows = "".join(f"{0.6 * x},{0.8 * x},7.0,ignored\n" for x in range(23))
    road.write_text("x_m,y_m,v_mps,note\n" + rows, encoding="utf-8")
    code, said = run(tmp_path / "run", "--path", str(road), "--real-time")
    assert code == 0, said
    result = json.loads((tmp_path / "run" / "metrics.json").read_text())["metrics"]
    assert 25 <= result["ticks"] <= 60  # more where the car waits for its first command
    assert result["max_error_m"] < 0.05
    odom = [entry for entry in read(tmp_path / "run" / "bag") if entry.topic == "/odom"]
    assert len(odom) > 100
    assert not [entry for entry in read(tmp_path / "run" / "bag") if entry.topic == "/clock"]


def test_a_controller_of_a_user_drives_as_in_the_offline_loop_to_the_last_bit(
    tmp_path: Path,
) -> None:
    file = tmp_path / "my_file.py"
    file.write_text(blocks("my_controller.md")[0], encoding="utf-8")
    controller = f"{file}:Stanley"
    code, said = run(tmp_path / "run", "--controller", controller)
    assert code == 0, said
    assert "sc1, Stanley, paper car" in said
    assert "MSE of the cross-track error" in said
    log = drive_log(read_columns(tmp_path / "run" / "bag"))
    states, steering = drive_offline("sc1", controller)
    assert log.drive.states == states
    assert log.drive.steering.tolist() == steering
    assert is_complete(tmp_path / "run" / "bag")
    assert 1_000_000 < (tmp_path / "run" / "report.html").stat().st_size < 3_000_000
    result = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert result["run"]["controller"] == controller
    assert result["ended"] == "completed"
    assert result["metrics"]["ticks"] == len(steering)
    assert result["metrics"]["missed_ticks"] == 0
    assert 0.01 < result["metrics"]["rms_error_m"] < 0.5
    report = json.loads((tmp_path / "run" / "report.json").read_text())["drives"][0]
    assert report["controller"] == controller
    assert report["summary"]["unsolved_ticks"] == 0


MISSED = {
    "recorder": [],
    "planner": ["gate: stopping: no target_speed for"],
    "controller": ["gate: stopping: no sound steering_command for"],
    "gate": ["simulator: no steering_command for"],
    "simulator": [
        "controller: fallback: steering by shifted_plan, reason: state_late",
        "controller: a stop is requested, reason: state_lost",
        "planner: a stop is requested: braking",
    ],
}
"""What the others say when a node is lost."""


@pytest.mark.parametrize("node", NEEDED)
def test_when_a_node_is_killed_all_end_and_the_killed_one_is_named(
    node: str, tmp_path: Path
) -> None:
    started = start_and_drive(tmp_path / "run")
    os.kill(pid_of(node, started), signal.SIGKILL)
    said, _ = started.process.communicate(timeout=TIMEOUT)
    assert started.process.returncode == 1
    assert f"error: {node} was killed by SIGKILL" in said
    assert "continue for 1.5 s" in said
    assert [sentence for sentence in MISSED[node] if sentence not in said] == []
    assert f"logs: {started.folder}" in said
    assert processes(started.mark) == {}
    assert len(drive_log(read_columns(started.folder / "bag")).drive.states) >= ENOUGH
    assert is_complete(started.folder / "bag") == (node != "recorder")
    if node == "recorder":
        assert f": {started.folder}/bag_recovered" in said
        assert is_complete(started.folder / "bag_recovered")
        recovered = drive_log(read_columns(started.folder / "bag_recovered")).drive
        assert recovered.states == drive_log(read_columns(started.folder / "bag")).drive.states
    assert "was killed" in json.loads((started.folder / "metrics.json").read_text())["ended"]


def interrupt(started: Started, number: signal.Signals) -> str:
    """Interrupt a run twice, as an impatient user does; check what is left, return the output."""
    started.process.send_signal(number)
    started.process.send_signal(number)
    said, _ = started.process.communicate(timeout=TIMEOUT)
    assert started.process.returncode == 128 + number
    assert f"interrupted by {number.name}" in said
    assert processes(started.mark) == {}
    assert is_complete(started.folder / "bag")
    assert json.loads((started.folder / "metrics.json").read_text())["metrics"]["ticks"] >= ENOUGH
    return said


def test_the_drive_goes_on_without_markers_until_an_interrupt_ends_all(tmp_path: Path) -> None:
    started = start_and_drive(tmp_path / "run")
    os.kill(pid_of("markers", started), signal.SIGKILL)
    before = recorded_states(started)
    wait_for(lambda: recorded_states(started) > before + 2 * ENOUGH, period=0.3)
    assert started.process.poll() is None
    assert "killed" not in interrupt(started, signal.SIGINT)


def test_a_terminated_run_ends_all_closes_the_bag_and_evaluates_the_drive(tmp_path: Path) -> None:
    interrupt(start_and_drive(tmp_path / "run"), signal.SIGTERM)


def test_the_nodes_end_with_a_killed_start_script_and_the_bag_is_closed(tmp_path: Path) -> None:
    started = start_and_drive(tmp_path / "run")
    started.process.kill()
    started.process.communicate()
    wait_for(lambda: processes(started.mark) == {})
    assert is_complete(started.folder / "bag")


def test_what_only_a_node_can_refuse_is_said_in_one_line_and_nothing_is_left(
    tmp_path: Path,
) -> None:
    code, said = run(tmp_path / "run", "--scenario", "circle", "--controller", "paper")
    assert code == 2
    errors = re.findall(r"^error: .*$", said, re.MULTILINE)
    assert len(errors) == 1
    assert "controller ended with exit code 2: reference_path: turns by" in errors[0]
    assert not (tmp_path / "run").exists()


WRONG_OPTIONS = {
    "--controller=absent.py:Stanley": "absent.py",
    "--controller=bad.csv:Stanley": "'bad.csv:Stanley' must be one of preview, ",
    "--controller=bad.py:Absent": "bad.py:Absent': the file has no class Absent",
    "--controller=magic": "'magic' must be one of preview, ",
    "--scenario=sc99": "'sc99' is neither a file nor one of the shipped scenarios: circle, ",
    "--vehicle=tank": "'tank' is neither a file nor one of the shipped vehicles: autoware_",
    "--settings=x": "'x' is neither a file nor one of the shipped controllers: ",
    "--guard=x": "'x' is neither a file nor one of the shipped guards: road, track",
    "--gain-table=x": "'x' is neither a file nor one of the shipped gains: ",
    "--noise=loud": "'loud' is neither a file nor one of the shipped noise: x1",
    "--path=none.csv": "none.csv: cannot be read: ",
    "--path=bad.csv": "bad.csv: line 3: 'nan' must be finite",
    "--speed=nan": "speed[0][1] = nan must lie in [0, 100] m/s",
    "--output=.": ".: cannot create this folder: File exists",
}


@pytest.mark.parametrize("option", WRONG_OPTIONS)
def test_a_wrong_name_or_file_is_said_in_one_line_before_any_process_starts(
    option: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "bad.csv").write_text("x_m,y_m\n0,0\nnan,1\n", encoding="utf-8")
    (tmp_path / "bad.py").write_text("class Present:\n    period = 0.1\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delattr(Processes, "start")
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # this process keeps its own
    assert start.main([option]) == 2
    said = capsys.readouterr().out
    assert said.startswith("error: ")
    assert WRONG_OPTIONS[option] in said
    assert said.count("\n") == 1
    assert {file.name for file in tmp_path.iterdir()} - {"__pycache__"} == {"bad.csv", "bad.py"}


def test_what_a_node_says_about_compiling_is_shown_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = "[INFO] [1795466263.678345902] [controller]: compiling the controller (once ...) ...\n"
    with Processes(tmp_path) as nodes:
        nodes.start("controller", "this_module_is_not_there", {})
        nodes.running["controller"].wait()
        nodes.log("controller").write_text("[INFO] [1.0] [x]: ready\n" + said, encoding="utf-8")
        told: set[str] = set()
        for _ in range(3):
            start.print_compilation(nodes, Console(), told)
    assert capsys.readouterr().out == "compiling the controller (once ...) ...\n"


def test_a_stop_request_is_printed_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "controller.log"
    print_stop_request(log, Console())
    log.write_text(
        "[INFO] [1.5] [controller]: ready\n"
        "[WARN] [2.5] [controller]: a stop is requested, reason: off_path\n"
        "[WARN] [3.5] [controller]: a stop is requested, reason: state_lost\n"
    )
    print_stop_request(log, Console())
    said = capsys.readouterr().out
    assert said == "warning: controller: a stop is requested, reason: off_path\n"
