"""Bags of other recorders: split, compressed, out of order, or with unusual content."""

import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from nav_msgs.msg import Path as PathMessage
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from ampc_msgs_config import topics
from ampc_msgs_config.recording.bag_writer import Recording
from launch_scripts.bags.bag import open_bag
from launch_scripts.bags.bag_columns import namespace_of, namespaces_with, read_columns
from launch_scripts.bags.resync import MAGIC
from tests.bag_samples import is_complete, read
from tests.foreign_bags import Sent, write_file

DRIVE = [Sent(1000 + number, 0.1 * number, number=number) for number in range(60)]
LONG_DRIVE = [Sent(1000 + number, 0.1 * number, number=number) for number in range(1000)]


def read_back(bag: Path) -> list[Sent]:
    """Read a bag of odometry."""
    return [
        Sent(
            entry.log_time_ns,
            entry.message.pose.pose.position.x,
            entry.topic,
            entry.publish_time_ns,
            round(10 * entry.message.pose.pose.position.x),
        )
        for entry in read(bag)
    ]


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_bags_with_the_presets_of_rosbag2_are_read(
    tmp_path: Path, compression: CompressionType, use_chunking: bool
) -> None:
    options: dict[str, Any] = {
        "compression": compression,
        "use_chunking": use_chunking,
        "chunk_size": 4000,
    }
    write_file(tmp_path / "bag_0.mcap", DRIVE, **options)
    assert read_back(tmp_path) == DRIVE


@pytest.mark.parametrize("use_chunking", [True, False])
def test_bags_without_an_index_are_read(tmp_path: Path, use_chunking: bool) -> None:
    without = dict.fromkeys(("repeat_channels", "repeat_schemas", "use_statistics"), False)
    for number, index_types in enumerate((IndexType.ALL, IndexType.NONE)):
        options: dict[str, Any] = {
            **without,
            "index_types": index_types,
            "use_chunking": use_chunking,
        }
        write_file(tmp_path / f"bag_{number}.mcap", DRIVE[::-1], chunk_size=4000, **options)
        assert read_back(tmp_path / f"bag_{number}.mcap") == DRIVE


def test_bags_that_are_compressed_as_a_whole_are_read(tmp_path: Path) -> None:
    write_file(tmp_path / "plain.mcap", LONG_DRIVE, chunk_size=4000)
    packed = zstandard.compress((tmp_path / "plain.mcap").read_bytes())
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap.zstd").write_bytes(packed)
    assert read_back(tmp_path / "bag") == LONG_DRIVE
    assert is_complete(tmp_path / "bag")
    (tmp_path / "bag" / "bag_0.mcap.zstd").write_bytes(packed[: len(packed) * 3 // 4])
    assert not is_complete(tmp_path / "bag")
    found = read_back(tmp_path / "bag")
    assert len(found) > 500
    assert found == LONG_DRIVE[: len(found)]


def test_a_file_that_was_being_compressed_is_read_once(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE)
    (tmp_path / "bag_0.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd")
    assert read_back(tmp_path) == DRIVE


def test_messages_come_in_the_order_of_log_times_over_chunks_and_files(tmp_path: Path) -> None:
    late = [Sent(5, 1.0, number=10), *DRIVE[40:], *DRIVE[:20]]
    write_file(tmp_path / "bag_2.mcap", late, chunk_size=4000)
    write_file(tmp_path / "bag_10.mcap", DRIVE[39:19:-1], chunk_size=4000)
    assert read_back(tmp_path) == [Sent(5, 1.0, number=10), *DRIVE]


def test_messages_come_in_order_from_a_cut_file_too(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE[::-1], chunk_size=4000)
    whole = (tmp_path / "bag_0.mcap").read_bytes()
    (tmp_path / "bag_0.mcap").write_bytes(whole[: len(whole) // 2])
    found = read_back(tmp_path)
    assert 10 < len(found) < 60
    assert found == DRIVE[-len(found) :]


def test_messages_of_one_log_time_keep_the_order_of_recording(tmp_path: Path) -> None:
    drive = [sent._replace(log_time_ns=1) for sent in DRIVE]
    write_file(tmp_path / "bag_0.mcap", drive[:30], chunk_size=4000)
    write_file(tmp_path / "bag_1.mcap", drive[30:], chunk_size=4000)
    assert [sent.number for sent in read_back(tmp_path)] == list(range(60))


@pytest.mark.parametrize("seed", range(5))
def test_messages_of_overlapping_chunks_come_in_the_order_of_the_library(
    tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    times = np.repeat(np.arange(60), 5) + rng.integers(0, 40, 300)  # equal ones, too
    drive = [Sent(int(t), 0.1 * n, number=n) for n, t in enumerate(times)]
    write_file(tmp_path / "bag_0.mcap", drive, chunk_size=4000)
    with (tmp_path / "bag_0.mcap").open("rb") as stream:
        expected = [message.data for _, _, message in make_reader(stream).iter_messages()]
    with open_bag(tmp_path) as bag:
        assert [message.data for message in bag.messages(bag.topics)] == expected
        assert list(bag.messages({"/no_such_topic"})) == []


def test_a_contract_topic_of_another_type_is_refused_in_one_line(tmp_path: Path) -> None:
    with Recording(tmp_path / "bag") as recording:
        recording.add_topic("/car/odom", "std_msgs/msg/Float64")
        recording.write("/car/odom", serialize_message(Float64()), 1, 1)
    fault = r"bag: /car/odom holds std_msgs/msg/Float64, not nav_msgs/msg/Odometry$"
    with pytest.raises(ValueError, match=rf"^\S*{fault}"):
        list(read(tmp_path / "bag", ["/car/odom"]))
    with pytest.raises(ValueError, match=rf"^\S*{fault}"):
        read_columns(tmp_path / "bag", "/car")


def test_debug_topics_are_not_read_where_the_bag_has_ticks(tmp_path: Path) -> None:
    write_file(tmp_path / "odom_0.mcap", DRIVE)
    with Recording(tmp_path / "bag") as recording:
        recording.add_topic("/controller/debug/solve_time", "std_msgs/msg/Float64")
        recording.write("/controller/debug/solve_time", serialize_message(Float64(data=2.0)), 1, 1)
        recording.add_topic("/controller/tick", "sensor_msgs/msg/JointState")
        tick = JointState(name=["solve_time"], position=[3.0])
        recording.write("/controller/tick", serialize_message(tick), 1, 1)
    (tmp_path / "bag" / "bag_0.mcap").rename(tmp_path / "odom_1.mcap")
    columns = read_columns(tmp_path)
    assert "controller/debug/solve_time" not in columns.values
    assert columns.tick["solve_time"][:, 1].tolist() == [3.0]


def test_a_damaged_database_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "bag_0.db3").write_bytes(b"SQLite format 3\0" + bytes(100))
    for path in (tmp_path, tmp_path / "bag_0.db3"):
        with pytest.raises(ValueError, match=r"^\S*bag_0.db3: .*SQLite database cannot be read"):
            list(read(path))


def test_split_files_are_read_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    drive = [sent._replace(log_time_ns=1) for sent in DRIVE[:12]]
    for sent in drive:
        write_file(tmp_path / f"bag_{sent.number}.mcap", [sent])
    assert [sent.number for sent in read_back(tmp_path)] == list(range(12))


def test_messages_that_are_compressed_one_by_one_are_read(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE, pack=zstandard.compress)
    assert read_back(tmp_path) == DRIVE


def test_another_serialisation_format_is_refused_in_one_line(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE, encoding="json")
    with pytest.raises(
        ValueError, match=r"^\S*bag_0.mcap: /odom is serialised as 'json', not CDR$"
    ):
        read_columns(tmp_path)


def test_a_file_of_nothing_but_the_magic_number_was_not_closed(tmp_path: Path) -> None:
    (tmp_path / "bag_0.mcap").write_bytes(MAGIC)
    assert not is_complete(tmp_path)


def test_an_empty_last_file_of_a_killed_recorder_hides_no_other(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE)
    (tmp_path / "bag_1.mcap").touch()
    assert read_back(tmp_path) == DRIVE
    assert not is_complete(tmp_path)
    (tmp_path / "bag_0.mcap").write_bytes(b"")
    with pytest.raises(ValueError, match=r"^\S*bag_0.mcap: no bag: the file is empty$"):
        list(read(tmp_path))


@pytest.mark.parametrize("missing", ["repeat_schemas", "repeat_channels", "use_statistics"])
def test_a_summary_may_lack_any_of_its_parts(tmp_path: Path, missing: str) -> None:
    options: dict[str, Any] = {missing: False, "chunk_size": 4000}
    write_file(tmp_path / "bag_0.mcap", DRIVE, **options)
    assert read_back(tmp_path) == DRIVE
    with open_bag(tmp_path) as bag:
        assert bag.topics == {"/odom": "nav_msgs/msg/Odometry"}


def test_a_message_that_cannot_be_decoded_is_left_out_with_a_note(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE, pack=without_tenth())
    columns = read_columns(tmp_path)
    assert len(columns.values["odom"]) == len(DRIVE) - 1
    assert re.search(r"/odom: 1 of 60 .*0 bytes", "".join(columns.notes))


def test_a_damaged_chunk_hides_no_other_one_and_is_named(tmp_path: Path) -> None:
    for compression in CompressionType:
        file = tmp_path / f"{compression.name}.mcap"
        options: dict[str, Any] = {"compression": compression, "chunk_size": 4000}
        write_file(file, LONG_DRIVE, enable_crcs=True, **options)
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary
        chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
        content = bytearray(file.read_bytes())
        content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
        file.write_bytes(content)
        columns = read_columns(file)
        assert len(columns.values["odom"]) > len(LONG_DRIVE) - 10
        notes = "".join(columns.notes)
        assert "was not closed or is damaged" in notes
        assert re.search(r"[1-9]\d* damaged chunks or records, \d+ bytes", notes)


def test_a_damaged_message_of_those_that_are_compressed_one_by_one_is_left_out(
    tmp_path: Path,
) -> None:
    count = itertools.count(1)

    def pack(data: bytes) -> bytes:
        packed = zstandard.compress(data)
        return packed if next(count) != 10 else packed[: len(packed) // 2]

    write_file(tmp_path / "bag_0.mcap", DRIVE, pack=pack)
    columns = read_columns(tmp_path)
    assert len(columns.values["odom"]) == len(DRIVE) - 1
    assert re.search(r"/odom: 1 of 60 .*cut off in compressed frame 1", "".join(columns.notes))


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e200])
def test_a_message_with_values_that_no_car_has_is_left_out(tmp_path: Path, value: float) -> None:
    drive = [sent._replace(x=value if sent.number == 7 else sent.x) for sent in DRIVE]
    write_file(tmp_path / "bag_0.mcap", drive)
    columns = read_columns(tmp_path)
    assert len(columns.values["odom"]) == len(DRIVE) - 1
    assert re.search(r"/odom: 1 of 60 messages rejected: .*(finite|beyond)", "".join(columns.notes))


def test_a_predicted_path_that_cannot_be_decoded_is_left_out(tmp_path: Path) -> None:
    write_file(tmp_path / "odom_0.mcap", DRIVE)
    with Recording(tmp_path / "bag") as recording:
        recording.add_topic("/predicted_path", "nav_msgs/msg/Path")
        path = PathMessage()
        path.header.frame_id = "map"
        for data in (serialize_message(path), b"\0\1\0\0\1"):
            recording.write("/predicted_path", data, 1, 1)
    (tmp_path / "bag" / "bag_0.mcap").rename(tmp_path / "odom_1.mcap")
    columns = read_columns(tmp_path)
    assert len(columns.predictions) == 1
    assert re.search(r"Left out: 1 of 2 predicted paths", "".join(columns.notes))


def test_other_odometry_is_listed_and_can_be_selected(tmp_path: Path) -> None:
    file, names = tmp_path / "bag_0.mcap", ("/ekf/state", "/wheels/odometry")
    drive = [sent._replace(topic=names[sent.number % 2]) for sent in DRIVE]
    write_file(file, drive)
    listed = "it has /ekf/state, /wheels/odometry: select with --odom"
    for arguments in ((None, None), ("", None), ("", "/odom"), (None, "/nothing")):
        with pytest.raises(ValueError, match=rf"^{file}: holds no .*; {listed}$"):
            read_columns(file, *arguments)
    for odom in ("/wheels/odometry", "wheels/odometry"):
        columns = read_columns(file, odom=odom)
        assert len(columns.values["odom"]) == len(DRIVE) // 2
        assert (columns.namespace, columns.notes) == ("", [])


def without_tenth() -> Callable[[bytes], bytes]:
    """Return a function that removes the content of the tenth message."""
    count = itertools.count(1)
    return lambda data: b"" if next(count) == 10 else data


def test_states_whose_stamp_was_never_set_are_left_out_with_a_note(tmp_path: Path) -> None:
    late = [sent._replace(log_time_ns=sent.log_time_ns + 10**18) for sent in DRIVE]
    unset = [sent._replace(log_time_ns=0) for sent in DRIVE[:5]]
    write_file(tmp_path / "bag_0.mcap", [*unset, *late])
    columns = read_columns(tmp_path)
    assert len(columns.values["odom"]) == len(DRIVE)
    assert columns.start_ns == late[0].log_time_ns
    assert re.search(r"/odom: 5 of 65 .*stamp is 0", "".join(columns.notes))


def test_a_clock_that_starts_at_zero_loses_no_state(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", [sent._replace(log_time_ns=sent.number) for sent in DRIVE])
    columns = read_columns(tmp_path)
    assert len(columns.values["odom"]) == len(DRIVE)
    assert not columns.notes


def test_odometry_of_several_namespaces_is_named_in_a_note(tmp_path: Path) -> None:
    faulty = [sent._replace(topic="/ekf/faulty/odom") for sent in DRIVE]
    write_file(tmp_path / "bag_0.mcap", [sent._replace(topic="/ekf/odom") for sent in DRIVE])
    write_file(tmp_path / "bag_1.mcap", [*DRIVE, *faulty])
    (note,) = read_columns(tmp_path).notes
    assert re.search(r"/ekf/odom is evaluated, not /odom; --namespace", note)
    assert read_columns(tmp_path, "").namespace == ""
    assert not read_columns(tmp_path, "").notes


@pytest.mark.parametrize("namespace", ["", "/car1", "/fleet/car2"])
def test_the_copy_of_a_command_by_the_gate_names_no_namespace(namespace: str) -> None:
    names = [topics.GATE_STEERING, topics.STEERING_COMMAND, topics.ODOM]
    bag: Any = SimpleNamespace(path="bag", topics=[f"{namespace}/{name}" for name in names])
    assert namespace_of(bag) == namespace
    assert list(namespaces_with(bag, topics.STEERING_COMMAND)) == [namespace]
