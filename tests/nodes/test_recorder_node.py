"""The recorder: no loss, correct times, orderly shutdown."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from ampc_msgs_config import ros
from ampc_msgs_config.nodes import recorder_node
from ampc_msgs_config.nodes.message_loop import take_message
from ampc_msgs_config.nodes.recorder_node import (
    CONTRACT,
    EVERYTHING,
    LATCHED_TOPICS,
    TRANSFORMS,
    Recorder,
    plain_qos,
)
from ampc_msgs_config.recording.arrivals import Arrival, Arrivals
from ampc_msgs_config.types import NANOSECONDS
from tests.bag_samples import (
    TICK_NS,
    contents,
    full,
    read,
    read_with_rosbags,
    sample,
    write_bag,
)
from tests.ros_nodes import add, ros_context
from tests.waiting import TIMEOUT, wait_for


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
        arrivals.waiting.append(Arrival(publish_ns, 99, topic, data.get(tick, b"")))
    expected = ["/path 7", "/clock 7", "/command 7", "/slack 7", "/clock 8", "/slack 7", "/odom 8"]
    taken = arrivals.take_before(100)
    assert [f"{arrival.topic} {time_ns // TICK_NS}" for arrival, time_ns in taken] == expected
    assert not list(arrivals.take_before(100))
    arrivals.waiting.append(Arrival(8, 100, "/odom", b""))
    assert not list(arrivals.take_before(100))
    assert len(list(arrivals.take_before(101))) == 1


def test_a_message_received_during_a_look_at_the_queues_keeps_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting: dict[str, list[Any]] = {ros.CLOCK: [], full(ros.ODOM): []}
    looks: list[str] = []

    def receive(topic: str, tick: int) -> None:
        info = {"source_timestamp": tick, "received_timestamp": time.time_ns()}
        data = serialize_message(sample(topic if topic == ros.CLOCK else ros.ODOM, tick * TICK_NS))
        waiting[topic].append((data, info | {"publication_sequence_number": 1}))

    def take(subscription: Any) -> Any:
        topic = subscription.topic_name
        taken = waiting[topic].pop(0) if waiting.get(topic) else None
        looks.extend([topic] * (topic == ros.CLOCK and taken is None))
        if looks == [ros.CLOCK]:  # a clock comes right after the first look that finds none
            looks.append("again")
            receive(ros.CLOCK, 8)
            receive(full(ros.ODOM), 9)
        return taken

    monkeypatch.setattr(recorder_node, "take_message", take)
    monkeypatch.setattr(recorder_node, "HOLD", 0.0)
    receive(ros.CLOCK, 7)
    with ros_context(output=tmp_path / "bag", use_sim_time=True) as executor:
        recorder = Recorder()
        add(executor, recorder)
        for _ in range(3):
            recorder.take_arrived()
            recorder.write_waiting()
        recorder.close()
    (odometry,) = read(tmp_path / "bag", [full(ros.ODOM)])
    assert odometry.log_time_ns == 8 * TICK_NS


def test_messages_without_a_clock_are_kept_until_the_end() -> None:
    arrivals = Arrivals(simulated=True, clock="/clock", command="/command", quantities=())
    arrivals.waiting.append(Arrival(1, 2, "/path", b""))
    assert not list(arrivals.take_before(3))
    assert [time_ns for _, time_ns in arrivals.take_all_before(3)] == [0]


def test_take_message_returns_waiting_messages_then_none() -> None:
    with ros_context() as executor:
        node = rclpy.create_node("reader")
        add(executor, node)
        publisher = node.create_publisher(String, "words", EVERYTHING)
        subscription = node.create_subscription(String, "words", print, EVERYTHING, raw=True)
        wait_for(lambda: publisher.get_subscription_count() > 0)
        assert take_message(subscription) is None
        publisher.publish(String(data="first"))
        taken = None
        while taken is None:
            taken = take_message(subscription)
        data, info = taken
        assert deserialize_message(data, String).data == "first"
        assert {"source_timestamp", "received_timestamp", "publication_sequence_number"} <= {*info}
        assert take_message(subscription) is None


def test_plain_qos_is_what_rosbag2_writes() -> None:
    profile = QoSProfile(
        depth=7,
        reliability=ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
        deadline=Duration(seconds=3, nanoseconds=5),
    )
    (qos,) = dump_qos_v9([plain_qos(profile)])
    assert qos == {
        "history": "keep_last",
        "depth": 7,
        "reliability": "best_effort",
        "durability": "transient_local",
        "deadline": {"sec": 3, "nsec": 5},
        "lifespan": {"sec": 0, "nsec": 0},
        "liveliness": "system_default",
        "liveliness_lease_duration": {"sec": 0, "nsec": 0},
        "avoid_ros_namespace_conventions": False,
    }
    plain: Any
    for policy, plain in {
        HistoryPolicy: QosHistory,
        ReliabilityPolicy: QosReliability,
        DurabilityPolicy: QosDurability,
        LivelinessPolicy: QosLiveliness,
    }.items():
        assert all(plain(each).name == each.name for each in policy)


@pytest.mark.parametrize(("after_ns", "prolongs"), [(-1, True), (0, False), (1, False)])
def test_only_messages_from_before_the_end_prolong_the_recording(
    after_ns: int, prolongs: bool, tmp_path: Path
) -> None:
    with ros_context(output=tmp_path / "bag") as executor:
        recorder = Recorder()
        add(executor, recorder)
        recorder.end_ns, recorder.last_arrival = 1000, 0.0
        info = {
            "source_timestamp": recorder.end_ns + after_ns,
            "received_timestamp": recorder.end_ns + 2,
            "publication_sequence_number": 1,
        }
        recorder.on_message(full(ros.ODOM), serialize_message(sample(ros.ODOM, TICK_NS)), info)
        assert len(recorder.arrivals.waiting) == 1
        assert (recorder.last_arrival > 0.0) is prolongs


@contextmanager
def talker() -> Iterator[Node]:
    """Create a node that publishes, in a ROS context of its own."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node: Any = rclpy.create_node("talker", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def popen_recorder(*parameters: str) -> subprocess.Popen[str]:
    """Start the recorder."""
    command = [sys.executable, "-m", "ampc_msgs_config.nodes.recorder_node", "--ros-args"]
    for parameter in parameters:
        command += ["-p", parameter]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def start_recorder(bag: Path, *parameters: str) -> subprocess.Popen[str]:
    """Start the recorder, wait until it is ready, return its process."""
    process = popen_recorder(f"output:={bag}", *parameters)
    wait_for((bag / "metadata.yaml").exists)
    return process


def stop(process: subprocess.Popen[str], number: signal.Signals) -> tuple[int, str]:
    """End a process by a signal; return its exit code and output."""
    process.send_signal(number)
    said, _ = process.communicate(timeout=TIMEOUT)
    return process.returncode, said


def advertise(node: Node) -> dict[str, Publisher]:
    """Create a publisher for each topic of the contract."""
    return {
        name: node.create_publisher(
            message_type, name, ros.LATCHED if name in LATCHED_TOPICS else EVERYTHING
        )
        for name, message_type in CONTRACT.items()
    }


def publish_fast(publishers: dict[str, Publisher], ticks: int) -> None:
    """Publish 500 ticks a second, 50 times as fast as the clock that is published with them."""
    wait_for(lambda: all(p.get_subscription_count() for p in publishers.values()))
    due = time.monotonic()
    for stamp_ns in range(TICK_NS, (ticks + 1) * TICK_NS, TICK_NS):
        for name, publisher in publishers.items():
            if name not in LATCHED_TOPICS:
                publisher.publish(sample(name, stamp_ns))
        due += 0.002
        time.sleep(max(0.0, due - time.monotonic()))


@pytest.mark.parametrize(
    ("number", "ticks"),
    [(signal.SIGINT, 100), (signal.SIGTERM, 5), (signal.SIGHUP, 5), (signal.SIGQUIT, 5)],
)
def test_the_recorder_loses_nothing_and_ends_cleanly(
    tmp_path: Path, number: signal.Signals, ticks: int
) -> None:
    with talker() as node:
        publishers = advertise(node)
        for name in LATCHED_TOPICS & publishers.keys():
            publishers[name].publish(sample(name, TICK_NS))
        recorder = start_recorder(tmp_path / "bag", "use_sim_time:=true")
        publish_fast(publishers, ticks)
        for name in LATCHED_TOPICS & publishers.keys():  # the middleware decides when they come
            publishers[name].wait_for_all_acked(Duration(seconds=TIMEOUT))
        code, said = stop(recorder, number)
    derived = {*TRANSFORMS, full(ros.MARKERS)}
    found = [each for each in contents(read(tmp_path / "bag")) if each[0] not in derived]
    everything = read_with_rosbags(tmp_path / "bag")
    assert [each for each in everything if each[0] not in derived] == found
    latched = {full(name): name for name in LATCHED_TOPICS & CONTRACT.keys()}
    for topic, name in latched.items():  # when they come, the middleware decides
        expected = [(topic, TICK_NS, sample(name, TICK_NS))]
        assert [entry for entry in found if entry[0] == topic] == expected
    order = {full(name): number for number, name in enumerate(CONTRACT)}
    others = [entry for entry in found if entry[0] not in latched]
    # A machine without time for the recorder changes the order of topics, never their content.
    assert sorted(others, key=lambda entry: (entry[1], order[entry[0]])) == [
        (full(name), stamp_ns, sample(name, stamp_ns))
        for stamp_ns in range(TICK_NS, (ticks + 1) * TICK_NS, TICK_NS)
        for name in CONTRACT
        if name not in LATCHED_TOPICS
    ]
    assert code == 0
    assert said.count("recording to") == 1
    pictures = (ticks + 1) // 2  # five a second of ten states
    recorded = len(found) + ticks + 1 + pictures, len(CONTRACT) + len(derived)
    assert "recorded {} messages on {} topics".format(*recorded) in said
    assert ", 0 missed at the start, 0 lost:" in said


def test_a_killed_recorder_loses_less_than_a_second(tmp_path: Path) -> None:
    with talker() as node:
        publisher = node.create_publisher(Odometry, ros.ODOM, EVERYTHING)
        recorder = start_recorder(tmp_path / "bag")
        wait_for(lambda: publisher.get_subscription_count() > 0)

        def is_recorded() -> bool:
            publisher.publish(sample(ros.ODOM, time.time_ns()))
            return bool(list(read(tmp_path / "bag")))

        limit = wait_for(is_recorded, period=0.01) + 1.5
        while time.time() < limit:
            publisher.publish(sample(ros.ODOM, time.time_ns()))
            time.sleep(0.002)
        killed_ns = time.time_ns()
        recorder.kill()
        recorder.communicate()
    found = list(read(tmp_path / "bag"))
    assert 0 < killed_ns - found[-1].log_time_ns < NANOSECONDS
    assert found[0].log_time_ns < killed_ns - NANOSECONDS


def test_the_recorder_keeps_receive_times_and_offers_of_a_car(tmp_path: Path) -> None:
    with talker() as node:
        odom = node.create_publisher(Odometry, ros.ODOM, ros.NEWEST)
        path = node.create_publisher(PathMessage, ros.REFERENCE_PATH, ros.RELIABLE)
        imu = node.create_publisher(Imu, "imu", ros.NEWEST)
        recorder = start_recorder(tmp_path / "bag", "topics:=['imu:sensor_msgs/msg/Imu']")
        wait_for(lambda: all(p.get_subscription_count() for p in (odom, path, imu)))
        before_ns = time.time_ns()
        for _ in range(10):  # best effort: the first may come before the recorder knows of us
            odom.publish(sample(ros.ODOM, TICK_NS))
            path.publish(sample(ros.REFERENCE_PATH, TICK_NS))
            imu.publish(Imu())
            time.sleep(0.1)
        code, _ = stop(recorder, signal.SIGINT)
    found = {entry.topic: entry.log_time_ns for entry in read(tmp_path / "bag")}
    assert code == 0
    assert found.keys() == {"/odom", "/reference_path", "/imu", "/markers"}
    assert all(before_ns < time_ns < time.time_ns() for time_ns in found.values())
    with Reader(tmp_path / "bag") as reader:
        offers: dict[str, Any] = {link.topic: link.ext for link in reader.connections}
    assert offers["/odom"].offered_qos_profiles[0].reliability is QosReliability.BEST_EFFORT
    assert offers["/reference_path"].offered_qos_profiles[0].durability is QosDurability.VOLATILE


@pytest.mark.parametrize("change", ["removed", "replaced", "changed"])
def test_a_file_that_is_taken_away_is_reported_within_a_second(tmp_path: Path, change: str) -> None:
    bag, reports = tmp_path / "bag", list[DiagnosticArray]()
    with talker() as node:
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        publisher = node.create_publisher(Odometry, ros.ODOM, EVERYTHING)
        node.create_subscription(DiagnosticArray, ros.DIAGNOSTICS, reports.append, 10)
        recorder = start_recorder(bag)
        wait_for(lambda: publisher.get_subscription_count() > 0)
        wait_for(lambda: node.count_publishers(ros.DIAGNOSTICS) > 0)
        file = bag / "bag_0.mcap"
        until = time.monotonic() + 1.0
        while time.monotonic() < until or file.stat().st_size < 1000:
            publisher.publish(sample(ros.ODOM, time.time_ns()))
            executor.spin_once(timeout_sec=0.01)
        if change == "changed":
            os.truncate(file, 10)
        else:
            file.unlink()
        if change == "replaced":
            file.touch()
        begin = time.monotonic()
        while not reports:
            publisher.publish(sample(ros.ODOM, time.time_ns()))
            executor.spin_once(timeout_sec=0.01)
            assert time.monotonic() < begin + 10.0
        took = time.monotonic() - begin
        said, _ = recorder.communicate(timeout=TIMEOUT)
    (status,) = reports[0].status
    assert status.level == DiagnosticStatus.ERROR
    assert status.message.startswith(f"{file}: recording ends: it was {change}")
    assert f"error: {status.message}\n" in said
    assert recorder.returncode == 1
    assert took < 1.0


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
        said, _ = recorders[parameter].communicate(timeout=TIMEOUT)
        assert recorders[parameter].returncode == 2
        assert said == f"error: {complaint}\n"
