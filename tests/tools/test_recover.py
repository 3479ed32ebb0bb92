"""Recovery of bags: the result is complete and contains all that is undamaged."""

import io
import random
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import yaml
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.highlevel import AnyReader

from launch_scripts.bags import bag, inflate, recovery
from launch_scripts.bags.bag import open_bag
from launch_scripts.bags.resync import Scanner
from launch_scripts.bags.salvage import salvage
from launch_scripts.recover import main
from tests.bag_samples import contents, is_complete, read, read_with_rosbags, write_bag
from tests.foreign_bags import Sent, write_file
from tests.workshop.proofs.damaged_bags import KINDS, PLACES
from tests.workshop.proofs.prove_recovery import prove

DRIVE = [Sent(1000 + number, 0.1 * number, number=number) for number in range(400)]


def opened(file: Path) -> tuple[list[Any], Any]:
    """Return all messages that `mcap` reads through the index of a file, and its summary."""
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return list(reader.iter_messages()), reader.get_summary()


def snapshot(folder: Path) -> dict[str, bytes]:
    """Return the content of all files in a folder."""
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def recovered(bag: Path, output: Path) -> list[Sent]:
    """Recover a bag of odometry, check its index, and return its messages."""
    assert main([str(bag), "--output", str(output)]) == 0
    found = []
    for file in sorted(output.glob("*.mcap")):
        messages, summary = opened(file)
        assert summary.statistics.message_count == len(messages)
        found += [
            Sent(m.log_time, 0.0, c.topic, m.publish_time, m.sequence) for _, c, m in messages
        ]
    metadata = yaml.safe_load((output / "metadata.yaml").read_text())
    assert metadata["rosbag2_bagfile_information"]["message_count"] == len(found)
    assert is_complete(output)
    with AnyReader([output]) as reader:
        assert len(list(reader.messages())) == len(found)
    return found


def without_content(messages: list[Sent]) -> list[Sent]:
    """Return messages without their content."""
    return [sent._replace(x=0.0) for sent in messages]


def test_a_cut_bag_of_ours_gives_all_of_its_complete_chunks(tmp_path: Path) -> None:
    entries, _ = write_bag(tmp_path / "bag", ticks=3)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    _, summary = opened(tmp_path / "bag" / "bag_0.mcap")
    assert len(summary.chunk_indexes) == 3
    ends = [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]
    for number, cut in enumerate([20, *(end - 1 for end in ends), *ends, len(whole) - 1]):
        file = tmp_path / "cut_0.mcap"
        file.write_bytes(whole[:cut])
        output = tmp_path / f"recovered_{number}"
        assert main([str(file), "--output", str(output)]) == 0
        kept = entries[: len(entries) // 3 * sum(end <= cut for end in ends)]
        assert list(read(output)) == kept
        assert read_with_rosbags(output) == contents(kept)
        assert file.read_bytes() == whole[:cut]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_messages_before_the_cut_of_the_last_chunk_are_kept(
    tmp_path: Path, compression: CompressionType, capsys: pytest.CaptureFixture[str]
) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE, compression=compression)
    _, summary = opened(tmp_path / "bag_0.mcap")
    (chunk,) = summary.chunk_indexes
    whole = (tmp_path / "bag_0.mcap").read_bytes()
    cut = chunk.chunk_start_offset + chunk.chunk_length * 9 // 10
    (tmp_path / "bag_0.mcap").write_bytes(whole[:cut])
    found = recovered(tmp_path, tmp_path / "new")
    assert found == without_content(DRIVE[: len(found)])
    if compression is CompressionType.NONE:
        assert len(found) in (358, 359, 360)
    said = capsys.readouterr().out
    tail = cut - chunk.chunk_start_offset
    kept = f", of which {len(found)} messages are kept" if found else ""
    assert f"bag_0.mcap: the last {tail} bytes are a cut record{kept}\n" in said
    assert f"recovered: {len(found)} messages on 1 topics, " in said
    assert said.endswith(", 1 attachments, 1 metadata records\n")


def test_every_cut_of_an_unchunked_file_gives_the_messages_before_it(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE[:5], use_chunking=False)
    whole = (tmp_path / "bag_0.mcap").read_bytes()
    before = 0
    for cut in range(200, len(whole), 97):
        bag = tmp_path / f"cut_{cut}.mcap"
        bag.write_bytes(whole[:cut])
        found = recovered(bag, tmp_path / f"new_{cut}")
        assert found == without_content(DRIVE[: len(found)])
        assert len(found) >= before
        before = len(found)
    assert before == 5


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_damaged_chunk_takes_no_message_of_another_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], number: int
) -> None:
    entries, _ = write_bag(tmp_path / "bag", ticks=3)
    file = tmp_path / "bag" / "bag_0.mcap"
    _, summary = opened(file)
    content = bytearray(file.read_bytes())
    damaged = summary.chunk_indexes[number]
    content[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 1
    file.write_bytes(content)
    assert main([str(tmp_path / "bag")]) == 0
    lost_ns = (number + 1) * entries[0].log_time_ns
    kept = [entry for entry in entries if entry.log_time_ns != lost_ns]
    messages, _ = opened(tmp_path / "bag_recovered" / "bag_recovered_0.mcap")
    assert len([m for _, _, m in messages if m.log_time != lost_ns]) == len(kept)
    with open_bag(tmp_path / "bag_recovered") as bag:
        found = [each for each in bag.messages(bag.topics) if each.log_time_ns != lost_ns]
        assert [bag.decode(each) for each in found] == [entry.message for entry in kept]
    # How many records of the damaged chunk are lost depends on its compressed content.
    report = rf"[1-9]\d* damaged chunks or records, {damaged.chunk_length} bytes\n"
    assert re.search(report, capsys.readouterr().out)


@pytest.mark.parametrize("bit", [3, 17, 30])
@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("part", ["chunk", "message", "footer"])
def test_one_wrong_bit_in_a_head_loses_at_most_that_record(
    tmp_path: Path, part: str, compression: CompressionType, bit: int
) -> None:
    options: dict[str, Any] = {"chunk_size": 3000, "compression": compression}
    write_file(tmp_path / "bag.mcap", DRIVE, enable_crcs=True, **options)
    content = bytearray((tmp_path / "bag.mcap").read_bytes())
    _, summary = opened(tmp_path / "bag.mcap")
    message = content.find(struct.pack("<HIQQ", 1, 200, 1200, 7)) - 9
    if part == "message" and message < 0:
        pytest.skip("the heads of messages are compressed")
    chunk, footer = summary.chunk_indexes[5].chunk_start_offset, len(content) - 37
    places = {"chunk": chunk, "message": message, "footer": footer}
    content[places[part] + bit // 8] ^= 1 << bit % 8
    result = salvage(io.BytesIO(content), io.BytesIO())
    assert result.index.statistics is not None
    assert result.index.statistics.message_count >= len(DRIVE) - (part == "message")
    assert not result.is_undamaged


def test_a_second_frame_is_read_and_a_cut_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_file(tmp_path / "plain.mcap", DRIVE, chunk_size=4000)
    whole = (tmp_path / "plain.mcap").read_bytes()
    half = len(whole) // 2
    first, second = zstandard.compress(whole[:half]), zstandard.compress(whole[half:])
    file = tmp_path / "bag_0.mcap.zstd"
    file.write_bytes(first + second)
    assert recovered(file, tmp_path / "all") == without_content(DRIVE)
    capsys.readouterr()
    file.write_bytes(first + second[:-20])
    assert len(recovered(file, tmp_path / "part")) >= len(DRIVE) // 3
    assert f"{file}: cut off in compressed frame 2\n" in capsys.readouterr().out
    file.write_bytes(first[:10])
    assert main([str(file), "--output", str(tmp_path / "nothing")]) == 2
    assert re.fullmatch(r"error: .*cut off in compressed frame 1; .*\n", capsys.readouterr().err)
    assert not (tmp_path / "nothing").exists()


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_decompresses_without_end_is_left_out(
    tmp_path: Path, compression: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inflate.inflated, "__defaults__", (2**22,))
    write_file(tmp_path / "bag.mcap", DRIVE, chunk_size=4000)
    whole = (tmp_path / "bag.mcap").read_bytes()
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression]
    data, name = pack(bytes(2**26)), compression.encode()
    body = struct.pack("<QQQII", 0, 1, 2**26, 0, len(name)) + name
    body += struct.pack("<Q", len(data)) + data
    end = whole.rindex(struct.pack("<BQ", 15, 4))
    bomb = whole[:end] + struct.pack("<BQ", 6, len(body)) + body + whole[end:]
    (tmp_path / "bag.mcap").write_bytes(bomb)
    found = recovered(tmp_path / "bag.mcap", tmp_path / "new")
    assert found == without_content(DRIVE)


def test_a_file_that_decompresses_without_end_is_read_up_to_the_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag, "MAX_RATIO", 10)
    write_file(tmp_path / "plain.mcap", DRIVE, chunk_size=4000)
    frames = zstandard.compress((tmp_path / "plain.mcap").read_bytes() + bytes(2**23))
    file = tmp_path / "bag_0.mcap.zstd"
    file.write_bytes(frames)
    assert recovered(file, tmp_path / "new") == without_content(DRIVE)
    assert "more than the limit of 2621440 bytes in compressed frame 1" in capsys.readouterr().out


@pytest.mark.parametrize("length", [2**20, 2**32 - 1, 2**63, 2**64 - 1])
@pytest.mark.parametrize("opcode", [1, 4, 5, 6, 9, 12, 200])
def test_a_record_that_claims_more_than_the_file_has_loses_no_other(
    tmp_path: Path, opcode: int, length: int
) -> None:
    write_file(tmp_path / "bag.mcap", DRIVE[:20], use_chunking=False)
    whole = (tmp_path / "bag.mcap").read_bytes()
    head = whole.index(struct.pack("<HIQQ", 1, 10, 1010, 7)) - 9
    claimed = whole[:head] + struct.pack("<BQ", opcode, length) + whole[head:]
    result = salvage(io.BytesIO(claimed), io.BytesIO())
    assert result.index.statistics is not None
    assert result.index.statistics.message_count == 20


@pytest.mark.parametrize("text", ["[" * 20_000, "- " * 100_000, "{a: " * 20_000])
def test_deeply_nested_metadata_are_ignored(tmp_path: Path, text: str) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text(text)
    with (bag / "bag_0.mcap").open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Bool", "ros2msg", b"bool data\n")
        metadata = {"offered_qos_profiles": text}
        channel = writer.register_channel("/flag", "cdr", schema, metadata)
        writer.add_message(channel, 1, b"\0\1\0\0\1", 1)
        writer.finish()
    assert main([str(bag)]) == 0
    assert len(list(read(tmp_path / "bag_recovered"))) == 1


def test_any_error_of_a_library_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_file(tmp_path / "bag.mcap", DRIVE[:5])
    for error in (MemoryError(), RecursionError("too\ndeep"), KeyError("x")):
        with monkeypatch.context() as patch:
            patch.setattr(recovery, "salvage", raise_always(error))
            assert main([str(tmp_path / "bag.mcap")]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert f"{tmp_path / 'bag.mcap'}: nothing can be read: " in said
        assert not (tmp_path / "bag_recovered").exists()


def raise_always(error: Exception) -> Callable[..., Any]:
    """Return a function that raises an error."""

    def function(*_: object, **__: object) -> Any:
        raise error

    return function


def test_every_intact_message_of_seeded_damages_is_recovered() -> None:
    outcomes = list(prove(84, seed=20_000))
    assert [each for each in outcomes if not each.is_good] == []
    assert sum(each.intact for each in outcomes) > 5000
    assert {(each.kind, each.place) for each in outcomes} == {(k, p) for k in KINDS for p in PLACES}


def test_the_result_is_a_complete_file_for_any_damage(tmp_path: Path) -> None:
    chance = random.Random(1)
    write_file(tmp_path / "bag.mcap", DRIVE[:60], chunk_size=4000, enable_crcs=True)
    whole = (tmp_path / "bag.mcap").read_bytes()
    for _ in range(100):
        content = bytearray(whole[: chance.randrange(9, 2 * len(whole))])
        for place in chance.sample(range(8, len(content)), k=min(3, len(content) - 8)):
            content[place] = chance.randrange(256)
        target = io.BytesIO()
        found = salvage(io.BytesIO(content), target)
        target.seek(0)
        messages = list(make_reader(target, validate_crcs=True).iter_messages())
        assert found.index.statistics is not None
        assert len(messages) == found.index.statistics.message_count


def test_a_cut_chunk_is_not_counted_as_damage(tmp_path: Path) -> None:
    write_file(tmp_path / "bag.mcap", DRIVE, compression=CompressionType.ZSTD)
    whole = (tmp_path / "bag.mcap").read_bytes()
    _, summary = opened(tmp_path / "bag.mcap")
    (chunk,) = summary.chunk_indexes
    for share in (0.01, 0.5, 0.9):  # the first one is cut in the head of the chunk
        cut = chunk.chunk_start_offset + int(chunk.chunk_length * share)
        result = salvage(io.BytesIO(whole[:cut]), io.BytesIO())
        assert result.tail_bytes == cut - chunk.chunk_start_offset
        assert (result.damaged, result.damaged_bytes) == (0, 0)


def test_a_damaged_attachment_is_left_out(tmp_path: Path) -> None:
    write_file(tmp_path / "bag.mcap", DRIVE[:5], enable_crcs=True)
    whole = (tmp_path / "bag.mcap").read_bytes()
    assert len(salvage(io.BytesIO(whole), io.BytesIO()).index.attachment_indexes) == 1
    damaged = whole.replace(b"mass: 1500.0", b"mass: 1600.0", 1)
    result = salvage(io.BytesIO(damaged), io.BytesIO())
    assert (len(result.index.attachment_indexes), result.damaged) == (0, 1)
    assert result.index.statistics is not None
    assert result.index.statistics.message_count == 5


def test_messages_that_are_compressed_one_by_one_are_recovered_decompressed(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE[:50])
    plain, _ = opened(tmp_path / "bag_0.mcap")
    write_file(tmp_path / "bag_0.mcap", DRIVE[:50], pack=zstandard.compress)
    assert recovered(tmp_path, tmp_path / "new") == without_content(DRIVE[:50])
    copied, _ = opened(tmp_path / "new" / "new_0.mcap")
    assert [message.data for _, _, message in copied] == [message.data for _, _, message in plain]


def test_schemas_offers_attachments_and_metadata_stay(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE)
    before, _ = opened(tmp_path / "bag_0.mcap")
    whole = (tmp_path / "bag_0.mcap").read_bytes()
    (tmp_path / "bag_0.mcap").write_bytes(whole[:-20])
    assert recovered(tmp_path, tmp_path / "new") == without_content(DRIVE)
    after, _ = opened(tmp_path / "new" / "new_0.mcap")
    assert after == before
    with (tmp_path / "new" / "new_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert [(item.name, item.data) for item in reader.iter_attachments()] == [
            ("car.yaml", b"mass: 1500.0\n")
        ]
        assert [item.metadata for item in reader.iter_metadata()] == [{"ROS_DISTRO": "humble"}]
    text = (tmp_path / "new" / "metadata.yaml").read_text()
    (topic,) = yaml.safe_load(text)["rosbag2_bagfile_information"]["topics_with_message_count"]
    (offer,) = topic["topic_metadata"]["offered_qos_profiles"]
    assert (offer["history"], offer["reliability"]) == ("unknown", "reliable")


def test_all_files_of_a_split_bag_are_recovered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    write_file(bag / "bag_0.mcap", DRIVE[:100])
    write_file(bag / "bag_1.mcap", [sent._replace(topic="/car/odom") for sent in DRIVE[100:300]])
    (bag / "bag_2.mcap").touch()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {ros_distro: humble}\n")
    before = snapshot(bag)
    found = recovered(bag, tmp_path / "new")
    assert [sent.number for sent in found] == list(range(300))
    assert snapshot(bag) == before
    assert sorted(snapshot(tmp_path / "new")) == ["metadata.yaml", "new_0.mcap", "new_1.mcap"]
    assert "ros_distro: humble" in (tmp_path / "new" / "metadata.yaml").read_text()
    assert f"{bag / 'bag_2.mcap'}: no bag: the file is empty" in capsys.readouterr().out


def test_a_cut_file_that_is_compressed_as_a_whole_is_recovered(tmp_path: Path) -> None:
    write_file(tmp_path / "bag_0.mcap", DRIVE, chunk_size=4000)
    packed = zstandard.compress((tmp_path / "bag_0.mcap").read_bytes())
    (tmp_path / "bag_0.mcap").unlink()
    (tmp_path / "bag_0.mcap.zstd").write_bytes(packed)
    assert recovered(tmp_path, tmp_path / "all") == without_content(DRIVE)
    (tmp_path / "bag_0.mcap.zstd").write_bytes(packed[: len(packed) * 19 // 20])
    found = recovered(tmp_path, tmp_path / "new")
    assert found == without_content(DRIVE[: len(found)])


def test_a_complete_bag_is_reported_and_not_copied(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries, _ = write_bag(tmp_path / "bag", ticks=2)
    assert main([str(tmp_path / "bag")]) == 0
    assert f"bag: complete already: {len(entries)} messages on " in capsys.readouterr().out
    assert not (tmp_path / "bag_recovered").exists()


@pytest.mark.parametrize(
    "text", [None, "", "{", "rosbag2_bagfile_information:\n  message_count: 1"]
)
def test_metadata_that_is_missing_or_old_is_written_anew(tmp_path: Path, text: str | None) -> None:
    entries, _ = write_bag(tmp_path / "bag", ticks=2)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    if text is not None:
        (tmp_path / "bag" / "metadata.yaml").write_text(text)
    assert main([str(tmp_path / "bag")]) == 0
    assert list(read(tmp_path / "bag_recovered")) == entries


def test_topics_that_end_early_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    late = [Sent(3 * 10**9, 0.0, "/late"), Sent(4 * 10**9, 0.0, "/late")]
    write_file(tmp_path / "bag_0.mcap", [*DRIVE[:2], *late])
    recovered(tmp_path, tmp_path / "new")
    assert "/odom: last message 4.000 s before the end\n" in capsys.readouterr().out


def test_a_bag_without_messages_is_recovered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_file(tmp_path / "bag_0.mcap", [])
    assert recovered(tmp_path, tmp_path / "new") == []
    assert "recovered: 0 messages on 0 topics" in capsys.readouterr().out


def test_a_missing_bag_or_an_existing_output_gives_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_bag(tmp_path / "bag", ticks=1)
    (tmp_path / "empty.mcap").touch()
    for given, complaint in {
        ("nothing",): "nothing: there is no such file or folder",
        ("empty.mcap",): "empty.mcap: no bag: the file is empty",
        ("bag", "--output", "bag"): "bag: exists already, and nothing is overwritten",
    }.items():
        arguments = [part if part.startswith("--") else str(tmp_path / part) for part in given]
        assert main(arguments) == 2
        said = capsys.readouterr()
        assert re.fullmatch(rf"error: \S*{re.escape(complaint)}\n", said.err)
        assert not said.out


def test_several_bags_are_recovered_in_one_call_and_the_worst_decides(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ["one", "two"]
    for name in names:
        write_bag(tmp_path / name, ticks=1)
        (tmp_path / name / "metadata.yaml").unlink(missing_ok=True)
    bags = [str(tmp_path / name) for name in names]
    assert main(bags) == 0
    assert all((tmp_path / f"{name}_recovered" / "metadata.yaml").exists() for name in names)
    assert main([bags[0], str(tmp_path / "nothing"), "--"]) == 2
    with pytest.raises(SystemExit):
        main([*bags, "--output", str(tmp_path / "new")])
    assert "--output is for one bag, not for 2" in capsys.readouterr().err


def test_a_byte_inserted_in_the_head_of_a_chunk_costs_none_of_its_messages() -> None:
    for trial in range(200):  # until a record seems to begin at the last byte of the chunk
        sent = [b"\0\1\0\0" + random.Random(100 * trial + i).randbytes(9) for i in range(20)]
        content = one_chunk(sent)
        magic = content.index(b"\x28\xb5\x2f\xfd")
        (length,) = struct.unpack_from("<Q", content, magic - 8)
        shifted = content[:magic] + b"\0" + content[magic:]
        if Scanner(io.BytesIO(shifted), {}).can_continue(magic + length):
            break
    else:
        raise AssertionError("no such chunk")
    target = io.BytesIO()
    result = salvage(io.BytesIO(shifted), target)
    target.seek(0)
    assert not result.is_undamaged
    assert [message.data for _, _, message in make_reader(target).iter_messages()] == sent


def one_chunk(messages: list[bytes]) -> bytes:
    """Return a file with one compressed chunk, no index, and a summary of more than 1 kB."""
    stream = io.BytesIO()
    options: Any = {"compression": CompressionType.ZSTD, "index_types": IndexType.NONE}
    writer: Any = Writer(stream, chunk_size=2**20, **options)
    writer.start(profile="ros2", library="test")
    schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n" * 100)
    channel = writer.register_channel("/text", "cdr", schema)
    for number, data in enumerate(messages):
        writer.add_message(channel, number, data, number)
    writer.finish()
    return stream.getvalue()
