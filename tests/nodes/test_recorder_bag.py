"""Bags of the recorder: log times, transforms, and content after a kill or with a full disk."""

import math
import random
import resource
import signal
import time
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from std_msgs.msg import String

from ampc_msgs_config import ros
from ampc_msgs_config.nodes import recorder_node
from ampc_msgs_config.nodes.recorder_node import CONTRACT, EVERYTHING
from ampc_msgs_config.recording.arrivals import Arrival, Arrivals
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.transforms import TF_MESSAGE, footprint_transform, pose_transform
from ampc_msgs_config.types import NANOSECONDS
from launch_scripts.recover import main
from tests.bag_samples import TICK_NS, read, sample
from tests.nodes.test_recorder_node import popen_recorder, start_recorder, stop, talker
from tests.ros_nodes import add, ros_context, spin_until
from tests.waiting import TIMEOUT, wait_for

LARGEST_FILE = 2_000_000
"""File size limit that still lets the middleware create its shared memory [bytes]."""


def dated(arrivals: Arrivals) -> dict[str, int]:
    """Take all waiting messages; return the log time of each topic's last message [ns]."""
    return {arrival.topic: time_ns for arrival, time_ns in arrivals.take_all_before(2**63)}


def test_a_latched_message_that_comes_late_has_the_simulated_time_of_its_publishing() -> None:
    arrivals = Arrivals(
        simulated=True, clock="/clock", command="/command", quantities=(), latched=("/path",)
    )
    for tick in (5, 6, 7):
        data = serialize_message(sample(ros.CLOCK, tick * TICK_NS))
        arrivals.waiting.append(Arrival(10 * tick, 0, "/clock", data))
        dated(arrivals)
    for publish_ns, tick in ((1, 5), (50, 5), (69, 6), (70, 7), (1000, 7)):
        arrivals.waiting.append(Arrival(publish_ns, 0, "/path", b""))
        arrivals.waiting.append(Arrival(publish_ns, 0, "/odom", b""))
        assert dated(arrivals) == {"/odom": 7 * TICK_NS, "/path": tick * TICK_NS}


def test_a_latched_message_precedes_its_first_use_in_real_time() -> None:
    arrivals = Arrivals(
        simulated=False, clock="/clock", command="/command", quantities=(), latched=("/path",)
    )
    start_ns = arrivals.start_ns
    for publish_ns, receive_ns, expected_ns in (
        (start_ns - 9, start_ns + 7, start_ns),
        (start_ns + 3, start_ns + 7, start_ns + 3),
        (start_ns + 9, start_ns + 7, start_ns + 7),
    ):
        arrivals.waiting.append(Arrival(publish_ns, receive_ns, "/path", b""))
        arrivals.waiting.append(Arrival(publish_ns, receive_ns, "/odom", b""))
        assert dated(arrivals) == {"/path": expected_ns, "/odom": start_ns + 7}


def test_messages_that_wait_for_the_clock_are_returned_again_when_it_starts() -> None:
    arrivals = Arrivals(simulated=True, clock="/clock", command="/command", quantities=())
    arrivals.waiting.append(Arrival(1, 2, "/path", b""))
    assert [arrival.topic for arrival in arrivals.take_undated()] == ["/path"]
    assert not list(arrivals.take_undated())
    arrivals.waiting.append(Arrival(3, 4, "/clock", serialize_message(sample(ros.CLOCK, TICK_NS))))
    assert dated(arrivals) == {"/path": TICK_NS, "/clock": TICK_NS}
    assert not list(arrivals.take_undated())


def test_a_recording_that_begins_anew_replaces_what_was_written_at_once(tmp_path: Path) -> None:
    with Recording(tmp_path) as recording:
        for log_time_ns in (0, 8):
            recording.begin_anew()
            recording.add_topic("/path", "std_msgs/msg/String", [])
            recording.write("/path", serialize_message(String(data="path")), log_time_ns, 1)
            if log_time_ns:
                assert [entry.log_time_ns for entry in read(tmp_path)] == [0]
            recording.flush()
    assert [entry.log_time_ns for entry in read(tmp_path)] == [8]
    assert len(list(tmp_path.iterdir())) == 2


def test_a_kill_before_the_simulated_clock_starts_loses_less_than_a_second(tmp_path: Path) -> None:
    with talker() as node:
        settings = node.create_publisher(String, ros.CONFIGURATIONS[0], ros.LATCHED)
        odom = node.create_publisher(Odometry, ros.ODOM, EVERYTHING)
        settings.publish(String(data="number: 1"))
        recorder = start_recorder(tmp_path / "bag", "use_sim_time:=true")
        wait_for(lambda: odom.get_subscription_count() > 0)
        begin, published = time.monotonic(), 0
        while published < 100 or time.monotonic() < begin + 2.0:
            odom.publish(sample(ros.ODOM, time.time_ns()))
            published += 1
            time.sleep(0.01)
        killed_ns = time.time_ns()
        recorder.kill()
        recorder.communicate()
    found = list(read(tmp_path / "bag"))
    assert {entry.log_time_ns for entry in found} == {0}
    assert [entry.message.data for entry in found if "configuration" in entry.topic] == [
        "number: 1"
    ]
    assert killed_ns - found[-1].publish_time_ns < NANOSECONDS
    assert len(found) > 50


def test_messages_before_the_simulated_clock_get_the_time_of_its_start(tmp_path: Path) -> None:
    with talker() as node:
        odom = node.create_publisher(Odometry, ros.ODOM, EVERYTHING)
        clock = node.create_publisher(CONTRACT[ros.CLOCK], ros.CLOCK, EVERYTHING)
        recorder = start_recorder(tmp_path / "bag", "use_sim_time:=true")
        wait_for(lambda: all(p.get_subscription_count() for p in (odom, clock)))
        publish_until_recorded(odom, sample(ros.ODOM, TICK_NS), tmp_path / "bag")
        while not any(entry.topic == "/clock" for entry in read(tmp_path / "bag")):
            clock.publish(sample(ros.CLOCK, 9 * TICK_NS))
            time.sleep(0.1)
        odom.publish(sample(ros.ODOM, 9 * TICK_NS))
        stop(recorder, signal.SIGINT)
    found = [(entry.topic, entry.log_time_ns) for entry in read(tmp_path / "bag")]
    assert {topic for topic, _ in found} == {"/odom", "/clock", "/markers"}
    received = [topic for topic, _ in found if topic != "/markers"]
    assert (received[0], received[-1]) == ("/odom", "/odom")
    assert {time_ns for _, time_ns in found} == {9 * TICK_NS}


def publish_until_recorded(publisher: Publisher, message: Any, bag: Path) -> None:
    """Publish a message repeatedly until the bag contains it: both ends are matched."""
    while not list(read(bag)):
        publisher.publish(message)
        time.sleep(0.1)


def transforms(bag: Path) -> dict[str, list[Any]]:
    """Return the transforms of a bag by topic."""
    found: dict[str, list[Any]] = {"/tf": [], "/tf_static": []}
    with AnyReader([bag]) as reader:
        for link in reader.connections:
            assert reader.typestore.hash_rihs01(link.msgtype) == link.digest
        links = [link for link in reader.connections if link.msgtype == TF_MESSAGE]
        for link, time_ns, data in reader.messages(links):
            message: Any = reader.deserialize(data, link.msgtype)
            (transform,) = message.transforms
            found[link.topic].append((time_ns, transform))
        qualities: dict[str, Any] = {link.topic: link.ext for link in links}
    durability = qualities["/tf_static"].offered_qos_profiles[0].durability
    assert durability is QosDurability.TRANSIENT_LOCAL
    return found


def test_transforms_have_the_pose_of_the_odometry(tmp_path: Path) -> None:
    lost = sample(ros.ODOM, 2 * TICK_NS)
    lost.pose.pose.position.x = math.nan
    with talker() as node:
        odom = node.create_publisher(Odometry, ros.ODOM, EVERYTHING)
        recorder = start_recorder(tmp_path / "bag")
        wait_for(lambda: odom.get_subscription_count() > 0)
        publish_until_recorded(odom, sample(ros.ODOM, 0), tmp_path / "bag")
        for message in (sample(ros.ODOM, TICK_NS), lost, sample(ros.ODOM, 3 * TICK_NS)):
            odom.publish(message)
        stop(recorder, signal.SIGINT)
    log_times = [entry.log_time_ns for entry in read(tmp_path / "bag", ["/odom"])]
    found = transforms(tmp_path / "bag")
    assert [time_ns for time_ns, _ in found["/tf"]] == log_times[:-2] + log_times[-1:]
    for tick, (_, transform) in zip((1, 3), found["/tf"][-2:], strict=True):
        expected = sample(ros.ODOM, tick * TICK_NS)
        pose, place = expected.pose.pose, transform.transform
        assert ros.nanoseconds(expected.header.stamp) == tick * TICK_NS
        assert (transform.header.stamp.sec, transform.header.stamp.nanosec) == (0, tick * TICK_NS)
        assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
        assert (place.translation.x, place.translation.y) == (pose.position.x, pose.position.y)
        assert (place.rotation.z, place.rotation.w) == (pose.orientation.z, pose.orientation.w)
    ((time_ns, transform),) = found["/tf_static"]
    assert time_ns == log_times[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "base_footprint")
    assert transform.transform.rotation.w == 1.0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda odom: setattr(odom.pose.pose.position, "z", math.inf),
        lambda odom: setattr(
            odom.pose.pose, "orientation", type(odom.pose.pose.orientation)(w=0.0)
        ),
        lambda odom: setattr(odom, "child_frame_id", ""),
    ],
)
def test_odometry_without_a_valid_pose_gives_no_transform(spoil: Any) -> None:
    message = sample(ros.ODOM, TICK_NS)
    assert pose_transform(serialize_message(message))
    assert len(footprint_transform(serialize_message(message))) > 100
    spoil(message)
    assert pose_transform(serialize_message(message)) is None


def test_a_full_disk_ends_the_recorder_in_one_line_and_what_was_recorded_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limit = (LARGEST_FILE, LARGEST_FILE)
    with talker() as node:
        settings = node.create_publisher(String, ros.CONFIGURATIONS[0], ros.RELIABLE)
        recorder = start_recorder(tmp_path / "bag")
        resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, limit)
        wait_for(lambda: settings.get_subscription_count() > 0)
        number = 0
        while recorder.poll() is None:
            settings.publish(String(data=random.randbytes(4000).hex()))
            number += 1
            time.sleep(0.001)
        said, _ = recorder.communicate()
    complaint = f"error: {tmp_path / 'bag'}: recording ends: File too large; what was written"
    assert recorder.returncode == 1
    assert said.splitlines()[-1].startswith(complaint)
    found = list(read(tmp_path / "bag"))
    assert 100 < len(found) < number
    text = (tmp_path / "bag" / "metadata.yaml").read_text()
    assert yaml.safe_load(text)["rosbag2_bagfile_information"]["message_count"] <= len(found)
    assert main([str(tmp_path / "bag")]) == 0
    assert list(read(tmp_path / "bag_recovered")) == found
    assert "are a cut record" in capsys.readouterr().out


@pytest.mark.parametrize("asked", [False, True])
def test_transforms_of_others_take_the_place_of_those_from_odometry(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: bool
) -> None:
    """Another type replaces tf2_msgs, which is not installed everywhere."""
    if not asked:
        others = {"/tf": Vector3Stamped, "/tf_static": Vector3Stamped}
        monkeypatch.setattr(recorder_node, "installed_transforms", lambda: others)
    topics = ["imu:sensor_msgs/msg/Imu"] + ["tf:geometry_msgs/msg/Vector3Stamped"] * asked
    with ros_context(output=tmp_path / "bag", topics=topics) as executor:
        recorder = recorder_node.Recorder()
        add(executor, recorder)
        assert recorder.derived.has_transforms is not asked
        other = rclpy.create_node("other")
        add(executor, other)
        other.create_publisher(Vector3Stamped, "/tf", ros.RELIABLE)
        spin_until(executor, lambda: not recorder.derived.has_transforms)
        arrival = Arrival(1, 2, "/odom", serialize_message(sample(ros.ODOM, TICK_NS)))
        recorder.write(arrival, 3)
        recorder.close()
    with AnyReader([tmp_path / "bag"]) as reader:
        assert "/odom" in reader.topics
        assert not reader.topics.keys() & set(recorder_node.TRANSFORMS)


def test_a_second_recorder_in_the_same_folder_overwrites_nothing(tmp_path: Path) -> None:
    recorder = start_recorder(tmp_path / "bag")
    second = popen_recorder(f"output:={tmp_path / 'bag'}")
    said, _ = second.communicate(timeout=TIMEOUT)
    complaint = f"{tmp_path / 'bag'}: holds a bag already, and bags are never overwritten"
    assert (second.returncode, said) == (2, f"error: {complaint}\n")
    assert stop(recorder, signal.SIGINT)[0] == 0
    # the first one may hear the parameters of the second one
    assert {entry.topic for entry in read(tmp_path / "bag")} <= {"/parameter_events"}
