"""Three cars drive at once in one graph, two of them in lock-step: no clock or frame is shared."""

import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from rosbags.highlevel import AnyReader

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.nodes.derived_topics import PICTURE_PERIOD_NS
from ampc_msgs_config.paths.path_file import Route, choose_scenario
from ampc_msgs_config.recording.transforms import TF_MESSAGE
from ampc_ros.configuration import Choices, configuration
from ampc_ros.supervision.supervisor import Supervisor
from launch_scripts import replay, watch
from launch_scripts.bags.bag_columns import read_columns
from launch_scripts.bags.drive_log import drive_log
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file
from tests.bag_samples import is_complete, read
from tests.layouts import split_path, values_at
from tests.tools.test_start import start_script
from tests.waiting import TIMEOUT

SPEEDS = {"car1": 8.0, "car2": 5.0, "car3": 6.0}
LOCK_STEP = ("car1", "car2")
CONTROLLERS = {"car1": "preview", "car2": "pure_pursuit", "car3": "pure_pursuit"}
SHARED = {"/clock", "/diagnostics", "/parameter_events", "/rosout", "/tf", "/tf_static"}
PAGE = Path(__file__).resolve().parents[2] / "ampc_ros" / "doc" / "topics.md"
VIEWERS = Path(__file__).resolve().parents[2] / "ampc_ros" / "viewers"


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a short road into a bend."""
    file = tmp_path_factory.mktemp("road") / "road.csv"
    rows = (f"{x},{0.01 * max(x - 5, 0) ** 2}\n" for x in range(21))
    file.write_text("x_m,y_m\n" + "".join(rows), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def bags(road: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Drive all cars at once; return their bags."""
    folder = tmp_path_factory.mktemp("cars")
    started = {}
    with ExitStack() as stack:
        for name, speed in SPEEDS.items():
            options = ["--namespace", name, "--path", str(road), "--speed", str(speed)]
            options += ["--controller", CONTROLLERS[name], "--time-out", "60"]
            options += [] if name in LOCK_STEP else ["--real-time"]
            started[name] = start_script(folder / name, *options)
            stack.callback(started[name].process.terminate)
        command = [sys.executable, watch.__file__, "--namespace", "car3"]
        watching = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        stack.callback(watching.kill)
        for name, each in started.items():
            said, _ = each.process.communicate(timeout=TIMEOUT)
            slow = () if name in LOCK_STEP else (1,)  # a slow machine may stop it in real time
            assert each.process.returncode in (0, *slow), said
        watching.send_signal(signal.SIGINT)
        lines, _ = watching.communicate(timeout=TIMEOUT)
        assert watching.returncode == 0
        (folder / "watch.log").write_text(lines, encoding="utf-8")
    return {name: folder / name / "bag" for name in SPEEDS}


def senders(bag: Path) -> Iterator[str]:
    """Return the full names of the nodes that the shared topics of a bag name."""
    for entry in read(bag, ["/diagnostics"]):
        yield from (status.name for status in entry.message.status)
    for entry in read(bag, ["/parameter_events"]):
        yield entry.message.node
    for entry in read(bag, ["/rosout"]):
        yield "/" + entry.message.name.replace(".", "/")


@pytest.mark.parametrize("name", SPEEDS)
def test_each_bag_is_complete_and_has_messages_of_its_own_car_only(
    name: str, bags: dict[str, Path]
) -> None:
    assert is_complete(bags[name])
    with AnyReader([bags[name]]) as reader:
        topics = set(reader.topics)
    own = {topic for topic in topics if topic.startswith(f"/{name}/")}
    assert topics - own <= SHARED
    assert ("/clock" in topics) == (name in LOCK_STEP)  # its own one, under its usual name
    named = set(senders(bags[name]))
    assert {f"/{name}/controller", f"/{name}/planner", f"/{name}/simulator"} <= named
    assert all(each.startswith(f"/{name}/") for each in named)


@pytest.mark.parametrize("name", LOCK_STEP)
def test_a_car_in_lock_step_drives_as_it_drives_alone_bit_for_bit(
    name: str, bags: dict[str, Path], road: Path
) -> None:
    vehicle = load_vehicle_file(find("vehicles", "paper"))
    scenario = choose_scenario(Route(path=str(road), speed=SPEEDS[name]), vehicle.size)
    choices = Choices(controller=CONTROLLERS[name], guard="track", static_path=True)
    alone = drive(Simulation(vehicle, scenario), Supervisor(configuration(choices)))
    log = drive_log(read_columns(bags[name]))
    assert log.drive.states == list(alone.states)
    assert log.drive.steering.tolist() == alone.steering.tolist()


def test_a_drive_in_real_time_is_as_fast_as_asked_beside_simulated_clocks(
    bags: dict[str, Path],
) -> None:
    log = drive_log(read_columns(bags["car3"]))
    assert max(state.v_x for state in log.drive.states) == pytest.approx(6.0, abs=0.5)


def test_watch_shows_the_drive_of_its_namespace(bags: dict[str, Path]) -> None:
    first, *lines = (bags["car3"].parents[1] / "watch.log").read_text().splitlines()
    assert "waiting for a drive in /car3: no publisher of /car3/odom" in first
    assert any("speed " in line and "gate driving" in line for line in lines), lines


@pytest.mark.parametrize("name", SPEEDS)
def test_the_frames_and_markers_of_a_car_carry_its_namespace(
    name: str, bags: dict[str, Path]
) -> None:
    with AnyReader([bags[name]]) as reader:
        links = [link for link in reader.connections if link.msgtype == TF_MESSAGE]
        found: Any = [reader.deserialize(d, link.msgtype) for link, _, d in reader.messages(links)]
    frames = {(t.header.frame_id, t.child_frame_id) for each in found for t in each.transforms}
    base = f"{name}/base_link"
    assert frames == {(ros.MAP, base), (base, f"{name}/base_footprint")}
    pictures = [entry.message for entry in read(bags[name], [f"/{name}/markers"])]
    states = list(read(bags[name], [f"/{name}/odom"]))
    stamps = [ros.nanoseconds(each.markers[0].header.stamp) for each in pictures]
    assert 3 < len(pictures) < len(states)
    assert min(b - a for a, b in pairwise(stamps)) >= PICTURE_PERIOD_NS
    markers = [each for picture in pictures for each in picture.markers]
    assert {each.header.frame_id for each in markers} == {base}
    assert all(each.frame_locked for each in markers)
    assert {(each.ns, each.id) for each in markers} == {
        *(("car", i) for i in range(5)),
        ("text", 0),
    }
    turned = {each.pose.orientation.z for each in markers if (each.ns, each.id) == ("car", 1)}
    assert len(turned) > 3  # the front wheels


def test_the_bag_of_a_car_in_a_namespace_replays_bit_for_bit(bags: dict[str, Path]) -> None:
    assert replay.main([str(bags["car1"])]) == 0


def layout_of_car1(file: str) -> str:
    """Return a layout for car1, changed by the command of the documentation."""
    text = PAGE.read_text(encoding="utf-8")
    match = re.search(r"^sed (.*) foxglove.json", text, re.MULTILINE)
    assert match
    command = ["sed", *shlex.split(match[1]), str(VIEWERS / file)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_foxglove_s_layout_names_quantities_that_the_bag_has(bags: dict[str, Path]) -> None:
    layout = layout_of_car1("foxglove.json")
    paths = [each.replace('\\"', '"') for each in re.findall(r'"value": "(.*)"', layout)]
    assert len(paths) > 10
    for path in paths:
        topic, fields = split_path(path)
        assert any(values_at(fields, entry.message) for entry in read(bags["car1"], [topic])), path
    with AnyReader([bags["car1"]]) as reader:
        scene = re.findall(r'"(/car1/[a-z_]+)": {', layout)
        assert {"/car1/markers", "/car1/reference_path"} <= set(scene) <= set(reader.topics)
    assert '"followTf": "car1/base_link"' in layout


def test_plotjuggler_s_layout_names_quantities_that_the_bag_has(bags: dict[str, Path]) -> None:
    root = ElementTree.fromstring(layout_of_car1("plotjuggler.xml"))
    curves = [each.attrib["name"] for each in root.iter("curve")]
    with AnyReader([bags["car1"]]) as reader:
        topics = sorted(reader.topics, key=len)
    for curve in curves:
        topic = [each for each in topics if curve.startswith(f"{each}/")][-1]
        message = next(read(bags["car1"], [topic])).message
        words = curve.removeprefix(f"{topic}/").split("/")
        if type(message).__name__ == "JointState":
            assert words[0] in message.name
            assert words[1] == "position"
        else:
            assert values_at("." + ".".join(words), message)


def test_rviz_follows_the_frame_of_the_car() -> None:
    assert "Target Frame: car1/base_link" in layout_of_car1("ampc.rviz")
