"""Bags of others: split, compressed, out of order, or not what they should be."""

import re
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType, IndexType
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from ampc_msgs_config.recording.bag_writer import Recording
from launch_scripts.bags.bag import is_complete, read
from launch_scripts.bags.drive_log import read_drive
from tests.foreign_bags import Sent, write_file

DRIVE = [Sent(1000 + number, 0.1 * number, number=number) for number in range(60)]
LONG_DRIVE = [Sent(1000 + number, 0.1 * number, number=number) for number in range(1000)]


def read_back(bag: Path) -> list[Sent]:
    """Reads a bag of odometry."""
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
    options = {"compression": compression, "use_chunking": use_chunking, "chunk_size": 4000}
    write_file(tmp_path / "bag_0.mcap", DRIVE, **options)
    assert read_back(tmp_path) == DRIVE


@pytest.mark.parametrize("use_chunking", [True, False])
def test_bags_without_an_index_are_read(tmp_path: Path, use_chunking: bool) -> None:
    without = dict.fromkeys(("repeat_channels", "repeat_schemas", "use_statistics"), False)
    for number, index_types in enumerate((IndexType.ALL, IndexType.NONE)):
        options = {**without, "index_types": index_types, "use_chunking": use_chunking}
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


def test_a_contract_topic_of_another_type_is_refused_in_one_line(tmp_path: Path) -> None:
    with Recording(tmp_path / "bag") as recording:
        recording.add_topic("/car/odom", "std_msgs/msg/Float64", [])
        recording.write("/car/odom", serialize_message(Float64()), 1, 1)
    complaint = (
        "bag_0.mcap: topic /car/odom is of type std_msgs/msg/Float64, "
        "nav_msgs/msg/Odometry is needed"
    )
    with pytest.raises(ValueError, match=rf"^\S*{re.escape(complaint)}$"):
        list(read(tmp_path / "bag", ["/car/odom"]))
    shorter = "bag: /car/odom holds std_msgs/msg/Float64, not nav_msgs/msg/Odometry"
    with pytest.raises(ValueError, match=rf"^\S*{re.escape(shorter)}$"):
        read_drive(tmp_path / "bag", "/car")
    assert len(list(read(tmp_path / "bag"))) == 1


def test_bags_in_sqlite_are_refused_with_the_way_out(tmp_path: Path) -> None:
    (tmp_path / "bag_0.db3").write_bytes(b"SQLite format 3\0" + bytes(100))
    for given in (tmp_path, tmp_path / "bag_0.db3"):
        with pytest.raises(ValueError, match=r"SQLite.*: `ros2 bag convert` makes MCAP of it$"):
            list(read(given))
