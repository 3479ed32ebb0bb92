"""Bags: written as rosbag2 does, read by others, never overwritten, and they survive a kill."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from mcap.reader import make_reader
from mcap.writer import Writer
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64

from ampc_msgs_config import ros
from ampc_msgs_config.arrivals import Arrival, Arrivals
from ampc_msgs_config.bag import Entry, is_complete, read
from ampc_msgs_config.message_types import define, message_class, type_name_of
from ampc_msgs_config.recorder_node import CONTRACT
from ampc_msgs_config.recording import Recording
from ampc_msgs_config.types import NANOSECONDS, Command, Diagnosis, VehicleState

TICK_NS = NANOSECONDS // 10
TICKS = 200
WRITER = """
import sys, time
from pathlib import Path
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64
from ampc_msgs_config.recording import Recording

recording = Recording(Path(sys.argv[1]))
recording.add_topic("/count", "std_msgs/msg/Float64", [])
for number in range(10**9):
    data = serialize_message(Float64(data=float(number)))
    recording.write("/count", data, time.time_ns(), time.time_ns())
    time.sleep(0.001)
"""


def sample(name: str, stamp_ns: int) -> Any:
    """Gives a message for a topic of the contract, with content in every kind of field."""
    if name == ros.ODOM:
        state = VehicleState(stamp_ns, x=1.5, y=-0.1, yaw=0.3, v_x=9.0, v_y=0.01, yaw_rate=-0.2)
        return ros.odometry_message(state)
    if name == ros.REFERENCE_PATH:
        return ros.path_message(np.outer(np.arange(300), (0.1, -0.2)), stamp_ns)
    if name == ros.TARGET_SPEED:
        return ros.speed_message(ros.Stamped(stamp_ns, 8.333))
    if name == ros.STEERING_COMMAND:
        command = ros.steering_message(Command(stamp_ns, 0.1 + 1e-17, -0.5, Diagnosis()))
        command.effort = [0.0]
        return command
    if name == ros.STEERING_STATE:
        joint = ros.joint_message(stamp_ns, 0.05, float("inf"))
        joint.effort = [-0.0]
        return joint
    if name == ros.WIND:
        return ros.wind_message(stamp_ns, (-0.0, 5e-324))
    if name == ros.CLOCK:
        return Clock(clock=ros.time_message(stamp_ns))
    if name == ros.DIAGNOSTICS:
        values = [KeyValue(key="Größe", value="µ = 0.9"), KeyValue()]
        status = DiagnosticStatus(level=b"\x01", name="controller", values=values)
        diagnostics = DiagnosticArray(status=[status, DiagnosticStatus()])
        diagnostics.header.stamp = ros.time_message(stamp_ns)
        return diagnostics
    return Float64(data=stamp_ns / TICK_NS)


def write_bag(folder: Path, ticks: int) -> tuple[list[Entry], list[bytes]]:
    """Writes samples of all topics, a chunk a tick; gives them and their bytes."""
    entries, data = [], []
    with Recording(folder) as recording:
        for name, message_type in CONTRACT.items():
            qos = ros.LATCHED if name == ros.REFERENCE_PATH else ros.RELIABLE
            recording.add_topic(full(name), type_name_of(message_type), [qos])
        for stamp_ns in range(TICK_NS, (ticks + 1) * TICK_NS, TICK_NS):
            for name in CONTRACT:
                entries.append(Entry(full(name), stamp_ns, sample(name, stamp_ns)))
                data.append(serialize_message(entries[-1].message))
                recording.write(full(name), data[-1], stamp_ns, stamp_ns)
            recording.flush()
    return entries, data


def full(name: str) -> str:
    """Gives the full name of a topic in the root namespace."""
    return "/" + name.lstrip("/")


def test_every_message_of_the_contract_comes_back(tmp_path: Path) -> None:
    entries, _ = write_bag(tmp_path / "bag", ticks=3)
    assert list(read(tmp_path / "bag")) == entries
    assert list(read(tmp_path / "bag" / "bag_0.mcap")) == entries
    assert is_complete(tmp_path / "bag")


def test_only_the_wanted_topics_are_read(tmp_path: Path) -> None:
    write_bag(tmp_path, ticks=3)
    assert [entry.topic for entry in read(tmp_path, ["/odom"])] == ["/odom"] * 3


def test_mcap_finds_the_same_bytes_through_its_index(tmp_path: Path) -> None:
    entries, data = write_bag(tmp_path, ticks=3)
    with next(tmp_path.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        records = list(reader.iter_messages())
    assert {schema.encoding for schema, _, _ in records if schema} == {"ros2msg"}
    assert {channel.message_encoding for _, channel, _ in records} == {"cdr"}
    assert [channel.topic for _, channel, _ in records] == [entry.topic for entry in entries]
    assert [message.log_time for _, _, message in records] == [e.log_time_ns for e in entries]
    assert [message.data for _, _, message in records] == data


def read_with_rosbags(bag: Path) -> list[Entry]:
    """Reads a bag with the library rosbags and the definitions in the bag."""
    found = []
    with AnyReader([bag]) as reader:
        for link, time_ns, data in reader.messages():
            message = reader.deserialize(data, link.msgtype)
            again = bytes(reader.typestore.serialize_cdr(message, link.msgtype))
            ros_message = deserialize_message(again, message_class(link.msgtype))
            found.append(Entry(link.topic, time_ns, ros_message))
    return found


def test_rosbags_reads_the_same_content(tmp_path: Path) -> None:
    entries, _ = write_bag(tmp_path, ticks=3)
    assert read_with_rosbags(tmp_path) == entries


def test_type_hashes_are_those_of_the_definitions_in_the_bag(tmp_path: Path) -> None:
    write_bag(tmp_path, ticks=1)
    with AnyReader([tmp_path]) as reader:
        for link in reader.connections:
            assert reader.typestore.hash_rihs01(link.msgtype) == define(link.msgtype).type_hash


def test_metadata_tells_rosbags_counts_times_types_and_quality_of_service(tmp_path: Path) -> None:
    write_bag(tmp_path, ticks=3)
    with Reader(tmp_path) as reader:
        assert reader.message_count == 3 * len(CONTRACT)
        assert (reader.start_time, reader.duration) == (TICK_NS, 2 * TICK_NS + 1)
        links = {link.topic: link for link in reader.connections}
    assert {topic: link.msgtype for topic, link in links.items()} == {
        full(name): type_name_of(message_type) for name, message_type in CONTRACT.items()
    }
    offers: Any = links["/reference_path"].ext
    assert offers.offered_qos_profiles[0].durability is QosDurability.TRANSIENT_LOCAL


def test_a_bag_is_never_overwritten(tmp_path: Path) -> None:
    write_bag(tmp_path, ticks=1)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(ValueError, match=f"{re.escape(str(tmp_path))}: holds a bag already"):
        Recording(tmp_path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_killed_writer_loses_less_than_a_second(tmp_path: Path) -> None:
    moments = {tmp_path / str(moment): moment for moment in (0.3, 0.71, 1.13, 1.9)}
    writers = {bag: subprocess.Popen([sys.executable, "-c", WRITER, bag]) for bag in moments}
    started = {bag: wait_for((bag / "metadata.yaml").exists) for bag in moments}
    for bag, moment in moments.items():
        time.sleep(max(0.0, started[bag] + moment - time.time()))
        killed_ns = time.time_ns()
        writers[bag].kill()
        writers[bag].wait()
        found = list(read(bag))
        assert [entry.message.data for entry in found] == list(range(len(found)))
        last_ns = found[-1].log_time_ns if found else int(started[bag] * NANOSECONDS)
        assert killed_ns - last_ns < NANOSECONDS
        assert not is_complete(bag)


def test_a_truncated_file_gives_all_of_its_complete_chunks(tmp_path: Path) -> None:
    entries, _ = write_bag(tmp_path / "bag", ticks=3)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        summary: Any = make_reader(stream).get_summary()
    ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in summary.chunk_indexes]
    assert len(ends) == 3
    around_ends = {end + shift for end in ends for shift in (-9, -8, -1, 0, 1, 8, 9)}
    for cut in {8, *around_ends, *range(9, ends[-1], 997), len(whole) - 1}:
        file = tmp_path / "cut.mcap"
        file.write_bytes(whole[:cut])
        assert list(read(file)) == entries[: len(CONTRACT) * sum(end <= cut for end in ends)]
        assert not is_complete(file)


def ros1_file(file: Path) -> None:
    """Writes an MCAP file of ROS 1."""
    with file.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="ros1")
        writer.finish()


def damaged_file(file: Path) -> None:
    """Writes a bag and changes one byte in its only chunk."""
    write_bag(file.parent / "bag", ticks=1)
    content = bytearray((file.parent / "bag" / "bag_0.mcap").read_bytes())
    content[1000] ^= 1
    file.write_bytes(content)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda file: None, "there is no such file or folder"),
        (lambda file: file.mkdir(), "no bag: the folder holds no .mcap file"),
        (lambda file: file.touch(), "no bag: the file is empty"),
        (lambda file: file.write_text("x_m,y_m\n"), "no bag: the file does not begin as MCAP"),
        (ros1_file, "damaged or foreign: its profile is 'ros1', not 'ros2'"),
        (damaged_file, "damaged or foreign: "),
    ],
)
def test_what_is_no_bag_gives_one_line_that_names_the_file(
    tmp_path: Path, make: Callable[[Path], None], complaint: str
) -> None:
    file = tmp_path / "drive.mcap"
    make(file)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(file))}: {complaint}.*$") as error:
        list(read(file))
    assert "\n" not in str(error.value)


def test_topics_of_types_that_are_not_installed_are_skipped(tmp_path: Path) -> None:
    with (tmp_path / "drive_0.mcap").open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="ros2")
        for name in ("radar_msgs/msg/RadarScan", "nav_msgs/msg/Odometry", "no type"):
            schema = writer.register_schema(name, "ros2msg", b"")
            channel = writer.register_channel(f"/{name[:5]}", "cdr", schema)
            writer.add_message(channel, 1, serialize_message(Odometry()), 1)
        writer.finish()
    assert list(read(tmp_path)) == [Entry("/nav_m", 1, Odometry())]


def test_messages_are_written_in_the_order_of_publishing_and_at_simulated_times() -> None:
    arrivals = Arrivals(simulated=True, clock="/clock", command="/command", quantities={"/slack"})
    data = {tick: serialize_message(sample(ros.CLOCK, tick * TICK_NS)) for tick in (7, 8)}
    for publish_ns, topic, tick in [
        (5, "/clock", 8),
        (4, "/slack", 0),
        (3, "/command", 7),
        (2, "/clock", 7),
        (1, "/path", 0),
        (7, "/odom", 0),
        (6, "/slack", 0),
    ]:
        assert not list(arrivals.take_before(99))
        arrivals.add(Arrival(publish_ns, 99, topic, data.get(tick, b"")))
    expected = ["/path 7", "/clock 7", "/command 7", "/slack 7", "/clock 8", "/slack 7", "/odom 8"]
    taken = arrivals.take_before(100)
    assert [f"{arrival.topic} {time_ns // TICK_NS}" for arrival, time_ns in taken] == expected
    assert not list(arrivals.take_before(100))


def test_messages_without_a_clock_are_kept_until_the_end() -> None:
    arrivals = Arrivals(simulated=True, clock="/clock", command="/command", quantities=())
    arrivals.add(Arrival(1, 2, "/path", b""))
    assert not list(arrivals.take_before(3))
    assert [time_ns for _, time_ns in arrivals.take_all_before(3)] == [0]


@contextmanager
def talker() -> Iterator[Node]:
    """Gives a node of this process that publishes."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node: Any = rclpy.create_node("talker", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def popen_recorder(*parameters: str) -> subprocess.Popen[str]:
    """Starts the recorder."""
    command = [sys.executable, "-m", "ampc_msgs_config.recorder_node", "--ros-args"]
    for parameter in parameters:
        command += ["-p", parameter]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def start_recorder(bag: Path, *parameters: str) -> subprocess.Popen[str]:
    """Starts the recorder; gives its process once it is ready."""
    process = popen_recorder(f"output:={bag}", *parameters)
    wait_for((bag / "metadata.yaml").exists)
    return process


def stop(process: subprocess.Popen[str], number: signal.Signals) -> tuple[int, str]:
    """Ends a process by a signal; gives its exit code and all that it said."""
    process.send_signal(number)
    said, _ = process.communicate(timeout=10)
    return process.returncode, said


def wait_for(condition: Callable[[], bool], patience: float = 15.0) -> float:
    """Waits until a condition holds, and gives the time when it did [s]."""
    limit = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.01)
    return time.time()


def advertise(node: Node) -> dict[str, Publisher]:
    """Gives a publisher for each topic of the contract."""
    latched = {ros.REFERENCE_PATH: ros.LATCHED}
    return {
        name: node.create_publisher(message_type, name, latched.get(name, ros.EVERYTHING))
        for name, message_type in CONTRACT.items()
    }


def publish_fast(publishers: dict[str, Publisher]) -> None:
    """Publishes 500 ticks a second, 50 times as fast as the clock that is published with them."""
    wait_for(lambda: all(p.get_subscription_count() for p in publishers.values()))
    due = time.monotonic()
    for stamp_ns in range(TICK_NS, (TICKS + 1) * TICK_NS, TICK_NS):
        for name, publisher in publishers.items():
            if name != ros.REFERENCE_PATH:
                publisher.publish(sample(name, stamp_ns))
        due += 0.002
        time.sleep(max(0.0, due - time.monotonic()))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_recorder_loses_nothing_and_ends_cleanly(
    tmp_path: Path, number: signal.Signals
) -> None:
    with talker() as node:
        publishers = advertise(node)
        publishers[ros.REFERENCE_PATH].publish(sample(ros.REFERENCE_PATH, TICK_NS))
        recorder = start_recorder(tmp_path / "bag", "use_sim_time:=true")
        publish_fast(publishers)
        code, said = stop(recorder, number)
    found = list(read(tmp_path / "bag"))
    assert read_with_rosbags(tmp_path / "bag") == found
    path = Entry(full(ros.REFERENCE_PATH), TICK_NS, sample(ros.REFERENCE_PATH, TICK_NS))
    assert [entry for entry in found if entry.topic == path.topic] == [path]
    assert [entry for entry in found if entry.topic != path.topic] == [
        Entry(full(name), stamp_ns, sample(name, stamp_ns))
        for stamp_ns in range(TICK_NS, (TICKS + 1) * TICK_NS, TICK_NS)
        for name in CONTRACT
        if name != ros.REFERENCE_PATH
    ]
    assert code == 0
    assert said.count("recording to") == 1
    assert f"recorded {len(found)} messages on {len(CONTRACT)} topics" in said
    assert ", 0 missed at the start, 0 lost:" in said


def test_the_recorder_keeps_receive_times_and_offers_of_a_car(tmp_path: Path) -> None:
    with talker() as node:
        odom = node.create_publisher(Odometry, ros.ODOM, ros.NEWEST)
        path = node.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.RELIABLE)
        imu = node.create_publisher(Imu, "imu", ros.NEWEST)
        recorder = start_recorder(tmp_path / "bag", "topics:=['imu:sensor_msgs/msg/Imu']")
        wait_for(lambda: all(p.get_subscription_count() for p in (odom, path, imu)))
        before_ns = time.time_ns()
        odom.publish(sample(ros.ODOM, TICK_NS))
        path.publish(sample(ros.REFERENCE_PATH, TICK_NS))
        imu.publish(Imu())
        code, _ = stop(recorder, signal.SIGINT)
    found = {entry.topic: entry.log_time_ns for entry in read(tmp_path / "bag")}
    assert code == 0
    assert found.keys() == {"/odom", "/reference_path", "/imu"}
    assert all(before_ns < time_ns < time.time_ns() for time_ns in found.values())
    with Reader(tmp_path / "bag") as reader:
        offers: dict[str, Any] = {link.topic: link.ext for link in reader.connections}
    assert offers["/odom"].offered_qos_profiles[0].reliability is QosReliability.BEST_EFFORT
    assert offers["/reference_path"].offered_qos_profiles[0].durability is QosDurability.VOLATILE


def test_the_recorder_refuses_a_wrong_start_in_one_line(tmp_path: Path) -> None:
    write_bag(tmp_path, ticks=1)
    complaints = {
        "output:=''": "parameter 'output' must name the folder of the bag",
        f"output:={tmp_path}": f"{tmp_path}: holds a bag already, and bags are never overwritten",
        "topics:=['imu:x/msg/Imu']": "x/msg/Imu: this message type is not installed",
    }
    recorders = {
        parameter: popen_recorder("output:=elsewhere", parameter) for parameter in complaints
    }
    for parameter, complaint in complaints.items():
        said, _ = recorders[parameter].communicate(timeout=20)
        assert recorders[parameter].returncode == 1
        assert said == f"recorder: {complaint}\n"
