"""Bags of our recorder: as rosbag2 writes them, never overwritten, readable after a kill."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

from ampc_msgs_config.nodes.recorder_node import CONTRACT
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import define, type_name_of
from ampc_msgs_config.types import NANOSECONDS
from tests.bag_samples import (
    TICK_NS,
    Entry,
    contents,
    full,
    is_complete,
    read,
    read_with_rosbags,
    write_bag,
)
from tests.waiting import TIMEOUT, wait_for

WRITER = """
import sys, time
from pathlib import Path
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64
from ampc_msgs_config.recording.bag_writer import Recording

recording = Recording(Path(sys.argv[1]))
recording.add_topic("/count", "std_msgs/msg/Float64")
for number in range(10**9):
    data = serialize_message(Float64(data=float(number)))
    recording.write("/count", data, time.time_ns(), time.time_ns())
    time.sleep(0.001)
"""


def test_every_message_of_the_contract_comes_back(tmp_path: Path) -> None:
    entries, _ = write_bag(tmp_path / "bag", ticks=3)
    assert list(read(tmp_path / "bag")) == entries
    assert list(read(tmp_path / "bag" / "bag_0.mcap")) == entries
    assert is_complete(tmp_path / "bag")


def test_only_the_wanted_topics_are_read(tmp_path: Path) -> None:
    write_bag(tmp_path, ticks=3)
    assert [entry.topic for entry in read(tmp_path, ["/odom"])] == ["/odom"] * 3


def test_mcap_reads_the_same_bytes_through_its_index(tmp_path: Path) -> None:
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


def test_rosbags_reads_the_same_content(tmp_path: Path) -> None:
    entries, _ = write_bag(tmp_path, ticks=3)
    assert read_with_rosbags(tmp_path) == contents(entries)


def test_type_hashes_are_those_of_the_definitions_in_the_bag(tmp_path: Path) -> None:
    write_bag(tmp_path, ticks=1)
    with AnyReader([tmp_path]) as reader:
        for link in reader.connections:
            assert reader.typestore.hash_rihs01(link.msgtype) == define(link.msgtype).type_hash


def test_types_of_other_packages_are_defined_by_their_installed_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = tmp_path / "share" / "own_msgs" / "msg"
    for folder in (messages, tmp_path / "own_msgs"):
        folder.mkdir(parents=True)
    (tmp_path / "own_msgs" / "__init__.py").touch()
    (messages / "Wheel.msg").write_text("float64 speed  # [rad/s]\n")
    (messages / "Wheels.msg").write_text("std_msgs/Header header\nown_msgs/Wheel[] wheels\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    definition = define("own_msgs/msg/Wheels")
    assert re.search(
        r"own_msgs/Wheel\[\] wheels(.|\n)*MSG: own_msgs/Wheel\nfloat64 speed", definition.text
    )
    assert re.fullmatch("RIHS01_[0-9a-f]{64}", definition.type_hash)
    with pytest.raises(ValueError, match=r"^own_msgs/msg/Missing: .*not installed"):
        define("own_msgs/msg/Missing")


def test_type_hashes_are_those_of_the_installed_messages() -> None:
    for message_type in CONTRACT.values():
        type_name = type_name_of(message_type)
        package, _, name = type_name.split("/")
        prefix = Path(str(sys.modules[package].__file__)).parents
        file = next(
            path
            for p in prefix
            if (path := p / "share" / package / "msg" / f"{name}.json").exists()
        )
        hashes = {
            item["type_name"]: item["hash_string"]
            for item in json.loads(file.read_text())["type_hashes"]
        }
        assert define(type_name).type_hash == hashes[type_name]


def test_rosbags_reads_counts_times_types_and_quality_of_service_from_the_metadata(
    tmp_path: Path,
) -> None:
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


def test_a_folder_that_cannot_be_written_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    folder = tmp_path / "file" / "bag"
    with pytest.raises(ValueError, match=f"^{re.escape(str(folder))}: cannot record there: Not a"):
        Recording(folder)


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


def test_a_full_disk_ends_a_recording_in_one_line_and_what_was_written_stays(
    tmp_path: Path,
) -> None:
    limited = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))\n"
    script = limited + WRITER.replace("time.sleep(0.001)", "recording.flush()")
    writer = subprocess.run(
        [sys.executable, "-c", script, tmp_path], capture_output=True, text=True, timeout=TIMEOUT
    )
    assert writer.returncode == 1
    complaint = f"ValueError: {tmp_path}: recording ends: File too large; what was written before"
    assert writer.stderr.splitlines()[-1].startswith(complaint)
    numbers = [entry.message.data for entry in read(tmp_path)]
    assert numbers == list(range(len(numbers)))
    metadata = yaml.safe_load((tmp_path / "metadata.yaml").read_text())
    said = metadata["rosbag2_bagfile_information"]["message_count"]
    assert len(numbers) - 1 <= said <= len(numbers)
    assert sorted(file.suffix for file in tmp_path.iterdir()) == [".mcap", ".yaml"]


def remove(bag: Path) -> None:
    """Remove the file of a bag."""
    next(bag.glob("*.mcap")).unlink()


def replace(bag: Path) -> None:
    """Replace the file of a bag by a copy of itself, as an editor or `sed -i` does."""
    file = next(bag.glob("*.mcap"))
    copy = file.with_suffix(".copy")
    copy.write_bytes(file.read_bytes())
    copy.replace(file)


def truncate(bag: Path) -> None:
    """Truncate the file of a bag to half its length."""
    file = next(bag.glob("*.mcap"))
    os.truncate(file, file.stat().st_size // 2)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (remove, "it was removed: No such file or directory"),
        (replace, "it was replaced by another file"),
        (truncate, "it was changed: "),
        (lambda bag: shutil.rmtree(bag), "it was removed: No such file or directory"),
    ],
)
@pytest.mark.parametrize("written", [0, 3_000_000])
def test_a_file_that_is_taken_away_ends_the_recording_in_one_line(
    tmp_path: Path, change: Callable[[Path], object], fault: str, written: int
) -> None:
    recording = Recording(tmp_path / "bag")
    recording.add_topic("/count", "std_msgs/msg/Float64")
    recording.write("/count", bytes(12), 1, 1)
    recording.flush()
    change(tmp_path / "bag")
    for _ in range(written // 1000):  # chunks are written before the next flush
        recording.write("/count", os.urandom(1000), 2, 2)
    line = rf"^{tmp_path / 'bag' / 'bag_0.mcap'}: recording ends: {fault}"
    with pytest.raises(ValueError, match=line):
        recording.flush()
    recording.__exit__(None, None, None)  # has nothing to close


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
    """Write an MCAP file of ROS 1."""
    with file.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="ros1")
        writer.finish()


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda file: None, "there is no such file or folder"),
        (lambda file: file.mkdir(), "no bag: the folder holds no .mcap or .db3 file"),
        (lambda file: file.touch(), "no bag: the file is empty"),
        (lambda file: file.write_text("x_m,y_m\n"), "no bag: the file does not begin as MCAP"),
        (ros1_file, "damaged or foreign: its profile is 'ros1', not 'ros2'"),
    ],
)
def test_an_unreadable_file_gives_one_line_that_names_it(
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
    assert list(read(tmp_path)) == [Entry("/nav_m", 1, Odometry(), 1)]
