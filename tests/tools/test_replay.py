"""A recorded run goes through the controller again: the same bits, or the difference is told."""

import math
import subprocess
import sys
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
import yaml
from std_msgs.msg import String

from ampc_msgs_config import ros
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import SpeedPlanner
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import Choices, configuration, from_yaml, to_yaml
from ampc_ros.supervision.supervisor import Supervisor
from launch_scripts.replay import main
from launch_scripts.replaying.recorded_run import read_run
from launch_scripts.replaying.repetition import (
    differences,
    is_same,
    replay_ticks,
    with_value,
)
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.configuration import SimulatorConfiguration, simulator_text
from tests.recorded_drives import VEHICLE, Bag, Disturb, drive_in_real_time, scenario_of

TICK_NS = NANOSECONDS // 10
JITTER_NS = 19_000_000
"""Longest delay of a jittering tick [ns]."""
SCENARIOS = (
    "sc1", "sc1_falcone", "sc2", "sc3_constant", "sc3_varying", "sc3_wind", "sine", "circle",
    "straight", "iso3888_2",
)  # fmt: skip


def drive_in_lock_step(folder: Path, name: str, controller: str = "preview") -> None:
    """Record a drive in which every state is answered at once."""
    scenario = scenario_of(name)
    supervisor = Supervisor(configuration(Choices(controller=controller, static_path=True)))
    simulation, planner = Simulation(VEHICLE, scenario), SpeedPlanner(scenario)
    path = make_path(scenario.points)
    with Bag(folder) as bag:
        bag.configuration(supervisor)
        bag.path(scenario.points, NANOSECONDS)
        supervisor.follow(path, NANOSECONDS, NANOSECONDS)
        for tick in range(1, 10**6):
            if simulation.finished:
                return
            state = bag.state(simulation.car.measure(NANOSECONDS + simulation.elapsed_ns))
            supervisor.take_state(state, state.stamp_ns)
            decision = supervisor.tick(state.stamp_ns)
            assert decision
            bag.decision(decision, tick)
            speed = planner.target_speed(state)
            simulation.advance(decision.command.steering, speed, TICK_NS)


def drive_with_a_simulator(folder: Path, *, faulty: bool) -> None:
    """Record a drive whose car is in the bag, and whose state may be wrong where it is heard."""
    car = SimulatorConfiguration(VEHICLE, scenario_of("sc1"))
    supervisor = Supervisor(configuration(Choices(static_path=True)))
    simulation, planner = car.simulation(), SpeedPlanner(car.scenario)
    with Bag(folder) as bag:
        bag.configuration(supervisor)
        bag.add(f"/simulator/{ros.CONFIGURATION}", String(data=simulator_text(car)))
        bag.path(car.scenario.points, NANOSECONDS)
        supervisor.take_path(car.scenario.points, NANOSECONDS, NANOSECONDS)
        for tick in range(1, 61):
            state = bag.state(simulation.car.measure(NANOSECONDS + simulation.elapsed_ns))
            speed = planner.target_speed(state)
            if faulty:
                message = ros.odometry_message(state._replace(y=state.y + 0.1))
                bag.add(f"/{ros.FAULTY}{ros.ODOM}", message)
                state = ros.vehicle_state(message)
            supervisor.take_state(state, state.stamp_ns)
            decision = supervisor.tick(state.stamp_ns)
            assert decision
            bag.decision(decision, tick)
            simulation.advance(decision.command.steering, speed, TICK_NS)


def nothing(_: Supervisor, __: int) -> None:
    """Disturb nobody."""


def qp_fails(supervisor: Supervisor, step: int) -> None:
    """Let the solver fail for a second."""
    supervisor.inject_qp_fault(100 <= step < 150)


def gains_change(supervisor: Supervisor, step: int) -> None:
    """Change the limits during the drive."""
    if step == 90:
        settings = replace(supervisor.config.settings, max_increment=0.02)
        supervisor.reconfigure(supervisor.config._replace(settings=settings))


def stop_is_taken_back(supervisor: Supervisor, step: int) -> None:
    """Request a stop by a path that grows too old, then take the request back."""
    if step in (150, 300):
        supervisor.reconfigure(supervisor.config._replace(static_path=step == 300))
    if step == 300:
        supervisor.clear_stop()


def starts_in_a_bend(supervisor: Supervisor, step: int) -> None:
    """Start from a measured angle, and again after a driver's intervention, on jittering ticks."""
    if step in (0, 250):
        supervisor.start_from(0.1 if step == 0 else -0.3)


def assert_same_bits(folder: Path) -> None:
    """Replay, and find no difference."""
    run = read_run(folder)
    decisions = list(replay_ticks(run.ticks, run.config))
    for tick, decision in zip(run.ticks, decisions, strict=True):
        assert differences(tick, decision, 0.0) == []


@pytest.mark.parametrize("name", SCENARIOS)
def test_ten_scenarios_replay_bit_for_bit(name: str, tmp_path: Path) -> None:
    drive_in_lock_step(tmp_path / "bag", name)
    assert len(read_run(tmp_path / "bag").ticks) == 60
    assert_same_bits(tmp_path / "bag")


@pytest.mark.parametrize("controller", ["paper", "classic", "pure_pursuit"])
def test_every_controller_replays_bit_for_bit(controller: str, tmp_path: Path) -> None:
    drive_in_lock_step(tmp_path / "bag", "sc1", controller)
    assert_same_bits(tmp_path / "bag")


@pytest.mark.parametrize(
    "disturb", [nothing, qp_fails, gains_change, stop_is_taken_back, starts_in_a_bend]
)
def test_a_run_with_late_states_and_faults_replays_bit_for_bit(
    disturb: Disturb, tmp_path: Path
) -> None:
    jitter_ns = JITTER_NS if disturb is starts_in_a_bend else 0
    rungs = drive_in_real_time(tmp_path / "bag", disturb, jitter_ns=jitter_ns)
    assert max(rungs) > 0  # states were lost
    assert_same_bits(tmp_path / "bag")
    stops = [tick.values["stop_requested"] for tick in read_run(tmp_path / "bag").ticks]
    changes = [stop for stop, _ in groupby(stops)]
    assert changes == ([0.0, 1.0, 0.0] if disturb is stop_is_taken_back else [0.0])


@pytest.mark.parametrize(
    ("a", "b", "tolerance", "same"),
    [
        (math.nan, math.nan, 0.0, True),
        (math.nan, 1.0, 0.0, False),
        (1.0, math.nan, 0.0, False),
        (math.nan, 1.0, 1e9, False),
        (1.0, np.nextafter(1.0, 2.0), 0.0, False),
        (1.0, np.nextafter(1.0, 2.0), 1e-9, True),
        (1.0, 1.1, 1e-9, False),
        (math.inf, math.inf, 0.0, True),
    ],
)
def test_numbers_are_the_same_within_the_tolerance_and_nan_only_as_nan(
    a: float, b: float, tolerance: float, same: bool
) -> None:
    assert bool(is_same(a, b, tolerance)) is same
    assert bool(is_same(b, a, tolerance)) is same


def test_a_record_without_command_intervals_replays_with_one_period(tmp_path: Path) -> None:
    drive_in_lock_step(tmp_path / "bag", "sc2")
    run = read_run(tmp_path / "bag")
    for tick in run.ticks:
        assert tick.values.pop("command_interval") == 0.1
        assert math.isnan(tick.values.pop("started_from"))
    for tick, decision in zip(run.ticks, replay_ticks(run.ticks, run.config), strict=True):
        assert differences(tick, decision, 0.0) == []


def test_a_run_with_a_custom_controller_needs_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "mine.py"
    text = "class Mine:\n    period = 0.1\n    def step(self, state, path): return -0.1 * state.y\n"
    file.write_text(text, encoding="utf-8")
    drive_in_lock_step(tmp_path / "bag", "straight", f"{file}:Mine")
    assert main([str(tmp_path / "bag")] * 2) == 0  # several bags in one call
    assert main([str(tmp_path / "bag"), "--controller", f"{file}:Mine"]) == 0
    file.unlink()
    capsys.readouterr()
    assert main([str(tmp_path / "bag")]) == 2
    line = capsys.readouterr().out.strip()
    assert line.startswith("error: ")
    assert str(file) in line
    assert "\n" not in line
    assert main([str(tmp_path / "bag"), "--controller", "pure_pursuit"]) == 0


def test_a_run_with_an_injector_replays_what_the_controller_heard(tmp_path: Path) -> None:
    drive_with_a_simulator(tmp_path / "bag", faulty=True)
    assert_same_bits(tmp_path / "bag")


def test_the_loop_is_closed_from_the_bag_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive_with_a_simulator(tmp_path / "bag", faulty=False)

    def errors(*arguments: str) -> list[str]:
        assert main([str(tmp_path / "bag"), "--close-loop", *arguments]) == 0
        lines = capsys.readouterr().out.splitlines()
        row = next(line for line in lines if "RMS cross-track" in line)
        return [cell.strip() for cell in row.split("│")[2:4]]

    recorded, same = errors()
    assert float(same) == pytest.approx(float(recorded), rel=1e-3)
    before, other = errors("--controller", "pure_pursuit")
    assert before == recorded
    assert float(other) > 10 * float(recorded)


def test_another_process_replays_the_same_bits(tmp_path: Path) -> None:
    drive_in_real_time(tmp_path / "bag", qp_fails)
    command = [sys.executable, "-m", "launch_scripts.replay", str(tmp_path / "bag")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "every command equals the recorded one, bit for bit" in done.stdout


def test_the_first_difference_is_shown_with_its_inputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = scenario_of("sc1", 1.0)
    supervisor = Supervisor(configuration(Choices(static_path=True)))
    with Bag(tmp_path / "bag") as bag:
        bag.configuration(supervisor)
        bag.path(scenario.points, 0)
        supervisor.take_path(scenario.points, 0, 0)
        for tick in range(1, 6):
            state = bag.state(VehicleState(tick * TICK_NS, 0.9 * tick, 0.02, 0.0, 9.0, 0.0, 0.0))
            supervisor.take_state(state, state.stamp_ns)
            decision = supervisor.tick(state.stamp_ns)
            assert decision
            if tick == 3:  # a bit flips
                angle = float(np.nextafter(decision.command.steering, 1.0))
                wrong = decision.command._replace(steering=angle)
                decision = decision._replace(command=wrong)
            bag.decision(decision, tick)
    assert main([str(tmp_path / "bag")]) == 1
    said = capsys.readouterr().out
    assert "first difference" in said
    assert "at 0.200 s, stamp 300000000 ns" in said
    assert "x = 2.7" in said
    assert main([str(tmp_path / "bag"), "--tolerance", "1e-9"]) == 0


def test_a_bag_without_ticks_is_taken_as_lock_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = scenario_of("sc1", 1.0)
    supervisor = Supervisor(configuration(Choices(static_path=True)))
    with Bag(tmp_path / "bag") as bag:
        bag.path(scenario.points, 0)
        supervisor.take_path(scenario.points, 0, 0)
        for tick in range(1, 6):
            state = bag.state(VehicleState(tick * TICK_NS, 0.9 * tick, 0.02, 0.0, 9.0, 0.0, 0.0))
            supervisor.take_state(state, state.stamp_ns)
            decision = supervisor.tick(state.stamp_ns)
            assert decision
            bag.decision(decision, tick, tick=False)
    assert main([str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out
    assert "no controller/tick" in said
    assert "no controller/configuration" in said


@pytest.mark.parametrize("tick", [True, False])
@pytest.mark.parametrize("configured", [True, False])
def test_a_bag_of_steering_wheel_angles_replays(
    tick: bool, configured: bool, tmp_path: Path
) -> None:
    car, scenario = tmp_path / "geared.yaml", scenario_of("sc1", 1.0)
    car.write_text("same_as: paper\nsteering: {ratio: 14.7, offset: 0.02}\n", encoding="utf-8")
    choices = Choices(vehicle=str(car), static_path=True, simulated_time=True)
    supervisor = Supervisor(configuration(choices))
    steering = supervisor.config.steering
    with Bag(tmp_path / "bag") as bag:
        if configured:
            bag.configuration(supervisor)
        bag.path(scenario.points, 0)
        supervisor.take_path(scenario.points, 0, 0)
        for k in range(1, 6):
            state = bag.state(VehicleState(k * TICK_NS, 0.9 * k, 0.3, 0.0, 9.0, 0.0, 0.0))
            supervisor.take_state(state, state.stamp_ns)
            decision = supervisor.tick(state.stamp_ns)
            assert decision
            bag.decision(decision, k, tick=tick, steering=steering)
    vehicle = [] if configured else ["--vehicle", str(car)]
    assert main([str(tmp_path / "bag"), *vehicle]) == 0
    assert abs(supervisor.steering) > 0.01


def test_a_configuration_recorded_before_ratio_and_offset_has_neither() -> None:
    config = configuration(Choices())
    content = yaml.safe_load(to_yaml(config, 1))
    for key in ("ratio", "offset"):
        del content["steering"][key]
    read_back, _ = from_yaml(yaml.safe_dump(content), "an old bag")
    assert read_back.steering == config.steering
    assert (read_back.steering.ratio, read_back.steering.offset) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("option", "differs"),
    [
        (["--set", "settings.max_increment=0.001"], True),
        (["--controller", "pure_pursuit"], True),
        (["--gain-table", "preview_paper"], False),
    ],
)
def test_a_change_answers_the_recorded_situations(
    option: list[str], differs: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive_in_lock_step(tmp_path / "bag", "sc2")
    assert main([str(tmp_path / "bag"), *option]) == 0
    said = capsys.readouterr().out
    assert "open loop" in said
    row = next(line for line in said.splitlines() if "ticks that differ" in line)
    assert ("│     0 │" not in row) == differs


def test_a_changed_value_is_checked_like_that_of_a_file() -> None:
    config = configuration(Choices())
    assert with_value("chassis.mass=1800")(config).chassis.mass == 1800
    with pytest.raises(ValueError, match=r"--set chassis.mass=-1: mass = -1 must lie in \[1, 1"):
        with_value("chassis.mass=-1")(config)
    with pytest.raises(
        ValueError, match=r"--set chassis.mass=1:30: mass = '1:30' must be a number"
    ):
        with_value("chassis.mass=1:30")(config)
    with pytest.raises(ValueError, match=r"--set static_path=1: static_path = 1 must be true or"):
        with_value("static_path=1")(config)
    with pytest.raises(ValueError, match=r"--set weight=1: must be key=value; keys are chassis"):
        with_value("weight=1")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["none"], "none: there is no such file or folder"),
        (["empty"], "no bag: the folder holds no .mcap or .db3 file"),
        (["bag", "--gain-table", "heavy"], "'heavy' is neither a file nor one of the shipped"),
        (["bag", "--set", "mass=1"], "--set mass=1: must be key=value"),
        (["bag", "--close-loop"], "no simulator/configuration, so there is no car to drive"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    arguments: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    drive_in_lock_step(tmp_path / "bag", "straight")
    assert main(arguments) == 2
    said = capsys.readouterr().out.strip()
    assert sentence in said
    assert said.startswith("error: ")
    assert "\n" not in said


@pytest.mark.parametrize("tolerance", ["-1", "nan"])
def test_a_tolerance_that_is_no_angle_is_refused(
    tolerance: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["bag", "--tolerance", tolerance])
    assert f"--tolerance {tolerance} must be at least 0 rad" in capsys.readouterr().err
