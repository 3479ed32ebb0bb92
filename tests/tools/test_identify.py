"""Command identify: files of a known car, foreign and unsuitable bags, and a drive over ROS."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from ampc_msgs_config import ros
from ampc_msgs_config.config import dump, find, read
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.identification.recording import RecordedDrive
from launch_scripts import start
from launch_scripts.identify import main
from launch_scripts.identifying.bag_recording import (
    check_consistency,
    is_opposite,
    time_to_answer,
)
from launch_scripts.run.options import prepare_run, read_run_options
from launch_scripts.run.processes import WRONG_SET_UP
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file
from tests.html_pages import Elements, check_that_no_request_leaves
from tests.report_bags import write_messages
from tests.tools.test_start import run
from tests.workshop.acceptance.identification_drives import (
    KnownCar,
    drive_manoeuvre,
    random_car,
)
from tests.workshop.acceptance.road_data import DATA

MOTORWAY = DATA / "real_drive" / "comma2k19_example1.csv"
AGE_NS = 30_000_000


def write_bag(bag: Path, recording: RecordedDrive) -> Path:
    """Write a recording as the bag of another controller; odometry arrives 30 ms late."""
    states = np.column_stack(recording[:7])

    def stamped(time: float) -> int:
        return round(time * NANOSECONDS)

    def joints(time: Array, position: Array) -> list[tuple[int, Any]]:
        return [
            (stamped(t), ros.joint_message(stamped(t), p, 0.0))
            for t, p in zip(time.tolist(), position.tolist(), strict=True)
        ]

    odom = [VehicleState(stamped(t), *state) for t, *state in states.tolist()]
    messages = {
        "/odom": [(s.stamp_ns + AGE_NS, ros.odometry_message(s)) for s in odom],
        "/steering_command": joints(recording.command_time, recording.command),
        "/steering_state": joints(recording.steering_time, recording.steering),
    }
    return write_messages(bag, {name: each for name, each in messages.items() if each})


def write_start(file: Path, car: KnownCar) -> Path:
    """Write the start vehicle of a car."""
    c, s = car.start.chassis, car.start.steering
    content = {
        "same_as": "ordinary",
        "chassis": {
            "front_cornering_stiffness": c.front_cornering_stiffness,
            "rear_cornering_stiffness": c.rear_cornering_stiffness,
            "yaw_inertia": c.yaw_inertia,
        },
        "steering": {"max_angle": s.max_angle, "max_rate": 10.0, "lag": -1.0, "ratio": s.ratio},
        "estimated": {
            "chassis.front_cornering_stiffness": 0.3,
            "chassis.yaw_inertia": 0.2,
            "steering.max_rate": 1.0,
        },
    }
    file.write_text(dump(content))
    return file


class Identified(NamedTuple):
    """A bag that was identified."""

    car: KnownCar
    bag: Path
    folder: Path
    printed: str


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Identified:
    """Return the results of the drive of a known car."""
    folder, rng = tmp_path_factory.mktemp("identified"), np.random.default_rng(7)
    car = random_car("ordinary", rng)
    bag = write_bag(folder / "bag", drive_manoeuvre(car, rng).recording)
    vehicle, output = write_start(folder / "start.yaml", car), folder / "out"
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr(
            "rich.console.Console.print", lambda _, text="", **__: lines.append(str(text))
        )
        assert main([str(bag), "--vehicle", str(vehicle), "--output", str(output)]) == 0
    return Identified(car, bag, output, "\n".join(lines))


def test_the_vehicle_file_holds_the_identified_values_and_loads(identified: Identified) -> None:
    car, vehicle = identified.car, load_vehicle_file(identified.folder / "identified.yaml")
    c, true = vehicle.chassis, car.vehicle
    stiffness = true.chassis.rear_cornering_stiffness
    assert c.rear_cornering_stiffness == pytest.approx(stiffness, rel=0.15)
    assert c.mass == true.chassis.mass
    assert vehicle.steering.delay == pytest.approx(true.steering.delay, abs=0.01)
    assert vehicle.steering.ratio == pytest.approx(car.ratio, rel=0.015)
    assert vehicle.steering.offset == pytest.approx(car.offset, abs=0.002)
    assert vehicle.size == true.size


def test_only_what_is_not_identifiable_stays_estimated(identified: Identified) -> None:
    content = read_vehicle(identified.folder / "identified.yaml")
    found = json.loads((identified.folder / "identified.json").read_text())["quantities"]
    rate = {} if found["max_rate"]["identified"] else {"steering.max_rate": 1.0}
    assert content.estimated == rate
    if rate:
        assert content.sections["steering"]["max_rate"] == 10.0


def test_json_and_terminal_hold_intervals_point_age_and_noise(identified: Identified) -> None:
    content = json.loads((identified.folder / "identified.json").read_text())
    point = content["quantities"]["measured_point"]
    assert point["interval"][0] < point["value"] < point["interval"][1]
    to_cg = identified.car.vehicle.chassis.cg_to_rear_axle - identified.car.x_P
    assert content["base_link_to_cg"] == pytest.approx(to_cg, abs=0.06)
    assert content["age"]["median"] == pytest.approx(AGE_NS / NANOSECONDS, abs=1e-3)
    assert content["noise"]["position_noise"] == pytest.approx(0.05, rel=0.1)
    for text in ("reading", "usable segments", "first estimate", "-p base_link_to_cg:="):
        assert text in identified.printed


def test_the_page_is_self_contained_and_shows_all_values(identified: Identified) -> None:
    page = (identified.folder / "identified.html").read_text()
    check_that_no_request_leaves(page)
    tags = [tag for tag, _ in Elements(page).found]
    assert tags.count("img") == 2
    assert tags.count("table") >= 3
    for text in ("steering delay", "understeer gradient", "yaw inertia", "chassis.mass"):
        assert text in page
    assert "nan" not in page.lower().replace("finance", "")


def message_of(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the last line that was printed."""
    return capsys.readouterr().out.strip().splitlines()[-1]


def test_a_bag_without_commands_is_refused_in_one_line(
    tmp_path: Path, identified: Identified, capsys: pytest.CaptureFixture[str]
) -> None:
    states = [VehicleState(NANOSECONDS * k, 10.0 * k, 0, 0, 10, 0, 0) for k in range(1, 20)]
    bag = write_messages(
        tmp_path / "bag", {"/car1/odom": [(s.stamp_ns, ros.odometry_message(s)) for s in states]}
    )
    assert main([str(bag), "--vehicle", "ordinary"]) == 2
    assert "holds no message on /car1/steering_command" in message_of(capsys)
    assert main([str(identified.bag)]) == 2
    said = message_of(capsys)
    assert "--vehicle" in said
    assert "new_car.py" in said


def test_the_motorway_drive_says_nothing_about_tyres(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if not MOTORWAY.exists():
        pytest.skip(f"{MOTORWAY} is missing")
    t, x, y, course, _, rate, speed, wheel = np.loadtxt(MOTORWAY, delimiter=",", skiprows=1).T
    wheel, zero = np.radians(wheel), np.zeros(len(t))
    nothing = np.array([])
    recording = RecordedDrive(
        t + 1, x, y, course, speed, zero, rate, t + 1, wheel, t + 1, wheel, nothing
    )
    bag = write_bag(tmp_path / "bag", recording)
    vehicle = tmp_path / "start.yaml"
    vehicle.write_text("same_as: ordinary\nsteering: {max_angle: 0.6, ratio: 15.0}\n")
    assert main([str(bag), "--vehicle", str(vehicle), "--output", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    for name in ("understeer gradient", "cornering stiffness, one rear tyre", "yaw inertia"):
        assert f"{name}: not identifiable from this drive" in said
    before, after = (load_vehicle_file(f).chassis for f in (vehicle, tmp_path / "identified.yaml"))
    assert after == before


def test_the_manoeuvre_is_available_as_a_path_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "manoeuvre.csv"
    options = ["--manoeuvre", "identification", "--write-path", str(file)]
    assert start.main([*options, "--vehicle", "ordinary"]) == 0
    assert file.read_text().startswith("x_m,y_m,v_mps\n")
    assert 55.0 < from_csv(file).duration < 70.0
    assert start.main(["--write-path", str(file)]) == 2
    assert "--manoeuvre" in message_of(capsys)


def test_a_drive_over_ros_is_identified_and_its_vehicle_file_drives(tmp_path: Path) -> None:
    vehicle = tmp_path / "true.yaml"
    true = SteeringParameters(max_angle=0.6, max_rate=3.0, lag=0.05, delay=0.1, ratio=12.0)
    steering = {"max_angle": 0.6, "max_rate": 3.0, "lag": 0.05, "delay": 0.1, "ratio": 12.0}
    vehicle.write_text(dump({"same_as": "ordinary", "steering": steering}))
    options = ("--manoeuvre", "identification", "--vehicle", str(vehicle), "--noise", "x1")
    code, said = run(tmp_path / "run", *options)
    assert code == 0, said
    begin = tmp_path / "start.yaml"
    stiffness = {"front_cornering_stiffness": 70000.0, "rear_cornering_stiffness": 48000.0}
    wrong = {"max_angle": 0.6, "lag": -1.0, "delay": 0.0, "ratio": 13.0}
    begin.write_text(dump({"same_as": "ordinary", "chassis": stiffness, "steering": wrong}))
    bag = str(tmp_path / "run" / "bag")
    assert main([bag, "--vehicle", str(begin), "--output", str(tmp_path)]) == 0
    file = tmp_path / "identified.yaml"
    found = load_vehicle_file(file).steering
    assert found.delay + found.lag == pytest.approx(true.delay + true.lag, abs=0.02)
    assert found.ratio == pytest.approx(true.ratio, rel=0.02)
    assert read(file)["chassis"]["mass"] == 1500.0
    # The file drives the true car.
    car = load_vehicle_file(vehicle)
    road = from_csv(tmp_path / "run" / "manoeuvre.csv")
    driven = drive(Simulation(car, road), make_controller(Choices("preview", str(file))))
    end = np.array(driven.states[-1][1:3])
    assert np.hypot(*(end - road.points[-1])) < 5.0
    assert find("controllers", "identification").exists()


@pytest.mark.parametrize(
    ("ages", "expected"),
    [([0.02, 0.01, 0.03], 0.02), ([], 0.0), ([0.0, 0.0], 0.0), ([5e8], 0.0), ([-0.1, -0.2], 0.0)],
)
def test_commands_count_from_their_sending_where_the_clocks_agree(
    ages: list[float], expected: float
) -> None:
    assert time_to_answer(np.array(ages)) == expected


def test_a_response_with_the_other_sign_is_recognised_at_any_latency() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    command = 0.05 * np.sin(0.5 * t) + 0.03 * np.sin(3.0 * t) + 0.02 * np.sign(np.sin(0.2 * t))
    for delay in (0, 2, 4):
        response = np.roll(command, delay)
        assert not is_opposite(command, response)
        assert is_opposite(command, -response)
    assert not is_opposite(command, np.zeros(len(t)))
    assert not is_opposite(0.05 * np.sin(7.5 * t), 0.05 * np.sin(7.5 * (t - 0.42)))


@pytest.mark.parametrize(
    ("speed", "sign", "reason"),
    [(3.6, 1.0, "times the speed of the position"), (1.0, -1.0, "turns against steering_command")],
)
def test_odometry_that_contradicts_itself_or_the_commands_is_refused(
    speed: float, sign: float, reason: str
) -> None:
    t = np.arange(0.0, 40.0, 0.02)
    yaw = np.sin(0.7 * t)
    x, y = (np.cumsum(5.0 * 0.02 * f(yaw)) for f in (np.cos, np.sin))
    yaw_rate = 0.7 * np.cos(0.7 * t)
    states = np.column_stack((t, x, y, yaw, np.full(len(t), 5.0 * speed), 0.0 * t, yaw_rate))
    command = np.column_stack((t, sign * yaw_rate))
    nothing = np.empty((0, 2))
    with pytest.raises(ValueError, match=reason):
        check_consistency(Path("bag"), states, command, nothing)
    states[:, 4], command[:, 1] = 5.0, yaw_rate
    check_consistency(Path("bag"), states, command, nothing)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--manoeuvre", "identification", "--speed", "5"], "--speed: the manoeuvre has its own"),
        (["--manoeuvre", "identification", "--scenario", "sc2"], "--scenario: the manoeuvre has"),
        (["--true-vehicle", "ordinray"], "ordinray"),
    ],
)
def test_start_refuses_options_that_it_would_ignore(
    options: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert start.main([*options, "--output", str(tmp_path / "run")]) == WRONG_SET_UP
    assert text in capsys.readouterr().out


def test_the_true_vehicle_is_that_of_the_simulator_only(tmp_path: Path) -> None:
    arguments = [
        "--true-vehicle",
        "paper",
        "--vehicle",
        "ordinary",
        "--output",
        str(tmp_path / "a"),
    ]
    started: dict[str, Any] = {}

    class Recorded:
        def start(self, name: str, _: str, parameters: Any, renamed: Any = None) -> None:
            started[name] = parameters.get("vehicle")

    run = prepare_run(read_run_options(arguments, None))
    start.start_nodes(Recorded(), run)  # type: ignore[arg-type]
    assert started["simulator"] == "paper"
    assert {started[name] for name in ("controller", "planner", "markers")} == {"ordinary"}
