"""Every kind of bag of `ros2 bag record`: report, replay and recovery of the same drive."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import CompressionMode

from launch_scripts.recover import main as recover
from launch_scripts.replay import main as replay
from launch_scripts.replaying.recorded_run import read_run
from launch_scripts.report import main as report
from launch_scripts.reporting.drive import judge_bag
from tests.recorded_drives import drive_in_real_time
from tests.rosbag2_bags import (
    Recorded,
    cut,
    joined_at,
    killed_sqlite,
    recorded_messages,
    without,
    write_mcap,
    write_sqlite,
)

TICKS = 80
"""Ticks of the drive."""
Messages = list[Recorded]
Write = Callable[[Path, Messages], object]


@pytest.fixture(scope="module")
def messages(tmp_path_factory: pytest.TempPathFactory) -> Messages:
    """Return the messages of a drive with late and lost states."""
    folder = tmp_path_factory.mktemp("drive") / "bag"
    drive_in_real_time(folder, lambda *_: None, seed=3)
    return recorded_messages(folder)


def empty_last_file(folder: Path, messages: Messages) -> None:
    """Write several files; the last one is empty, and there is no metadata."""
    write_mcap(folder, messages, files=3)
    (folder / f"{folder.name}_3.mcap").touch()
    (folder / "metadata.yaml").unlink()


def unreadable_files(folder: Path, messages: Messages) -> None:
    """Write a file between others that hold nothing, or nothing that is a bag."""
    write_mcap(folder, messages, ending=".zstd")
    for number, content in enumerate((b"", b"\0" * 100, zstandard.compress(b"")), 1):
        (folder / f"{folder.name}_{number}.mcap").write_bytes(content)
    (folder / f"{folder.name}_7.mcap.zstd").write_bytes(zstandard.compress(b"text"))


def one_database(mode: CompressionMode) -> Write:
    """Return a function that writes a bag in SQLite."""
    return lambda folder, messages: write_sqlite(folder, messages, mode)


def split_databases(folder: Path, messages: Messages) -> None:
    """Write two files in SQLite."""
    half = len(messages) // 2
    write_sqlite(folder, messages[:half])
    write_sqlite(folder.with_name("second"), messages[half:])
    (folder / f"{folder.name}.db3").rename(folder / f"{folder.name}_0.db3")
    shutil.move(folder.with_name("second") / "second.db3", folder / f"{folder.name}_1.db3")


COMPLETE: dict[str, Write] = {
    "mcap": write_mcap,
    "fastwrite": lambda folder, messages: write_mcap(folder, messages, preset="fastwrite"),
    "zstd_fast": lambda folder, messages: write_mcap(folder, messages, preset="zstd_fast"),
    "zstd_small": lambda folder, messages: write_mcap(folder, messages, preset="zstd_small"),
    "file": lambda folder, messages: write_mcap(folder, messages, ending=".zstd"),
    "message": lambda folder, messages: write_mcap(folder, messages, pack=zstandard.compress),
    "split": lambda folder, messages: write_mcap(folder, messages, files=5),
    "split, file": lambda folder, messages: write_mcap(folder, messages, files=4, ending=".zstd"),
    "sqlite3": write_sqlite,
    "sqlite3, file": one_database(CompressionMode.FILE),
    "sqlite3, message": one_database(CompressionMode.MESSAGE),
    "sqlite3, split": split_databases,
}
"""Bags that hold all messages, of a recorder that was closed."""
KILLED: dict[str, Write] = {
    "an empty last file": empty_last_file,
    "unreadable files": unreadable_files,
    "WAL": lambda folder, messages: killed_sqlite(folder, messages, "WAL"),
    "journal in memory": lambda folder, messages: killed_sqlite(folder, messages, "MEMORY"),
}
"""Bags that hold all messages, of a recorder that was killed."""


def ticks_of(bag: Path) -> list[float]:
    """Return the numbers of the ticks that can be replayed."""
    return [tick.values["commands"] for tick in read_run(bag).ticks]


def recovered(bag: Path) -> Path:
    """Recover a bag; return the new folder, or the bag where it is complete already."""
    new = bag.with_name("recovered")
    assert recover([str(bag), "--output", str(new)]) == 0
    return new if new.exists() else bag


@pytest.mark.parametrize("kind", [*COMPLETE, *KILLED])
def test_every_kind_of_bag_is_reported_replayed_and_recovered(
    kind: str, messages: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    (COMPLETE | KILLED)[kind](bag, messages)
    new = recovered(bag)
    assert (new == bag) == (kind in COMPLETE and not kind.startswith("sqlite3"))
    for each in {bag, new}:
        capsys.readouterr()
        assert len(judge_bag(each, "bag").columns.tick["commands"]) == TICKS
        assert replay([str(each)]) == 0
        assert "every command equals the recorded one, bit for bit" in capsys.readouterr().out
        assert len(ticks_of(each)) == TICKS
    files = sorted(file.name for file in bag.iterdir())
    assert not [name for name in files if name.endswith(("-shm", ".tmp"))]  # only read


def test_a_database_gives_a_page(messages: Messages, tmp_path: Path) -> None:
    bag = write_sqlite(tmp_path / "bag", messages)
    assert report([str(bag), "--output", str(tmp_path)]) == 0
    assert (tmp_path / "report.html").stat().st_size > 10_000


@pytest.mark.parametrize("storage", ["none", "fastwrite", ".zstd", "sqlite3"])
@pytest.mark.parametrize("share", [0.97, 0.6])
def test_a_cut_file_is_replayed_bit_for_bit_up_to_its_end(
    storage: str, share: float, messages: Messages, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    if storage == "sqlite3":
        write_sqlite(bag, messages)
    elif storage == ".zstd":
        write_mcap(bag, messages, ending=storage)
    else:
        write_mcap(bag, messages, preset=storage)
    (bag / "metadata.yaml").unlink()
    (file,) = bag.iterdir()
    cut(file, share)
    new = recovered(bag)
    assert new != bag
    for each in (bag, new):
        assert judge_bag(each, "bag").metrics["ticks"]
        assert replay([str(each)]) == 0
        ticks = ticks_of(each)
        assert len(ticks) > 10
        assert ticks == list(range(1, len(ticks) + 1))


@pytest.mark.parametrize("first", [40, 250, 450])
@pytest.mark.parametrize("files", [1, 4])
def test_a_bag_begun_in_mid_drive_is_exact_from_a_stated_tick_on(
    first: int,
    files: int,
    messages: Messages,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = write_mcap(tmp_path / "bag", joined_at(messages, first), files=files)
    assert replay([str(bag)]) == 0
    text = capsys.readouterr().out
    pattern = r"(\d+) ticks are missing from tick 1 on: exact from tick (\d+)"
    missing, exact = map(int, one_match(pattern, text))
    assert missing < exact <= missing + 12
    assert f"each of {TICKS + 1 - exact} commands equals the recorded one, bit for bit" in text
    drive = judge_bag(bag, "bag")
    begin = int(drive.columns.tick["commands"][0, 1])
    assert begin in (missing, missing + 1)  # the state of the first tick may be missing
    assert f"begins at tick {begin}" in " ".join(drive.notes)


def one_match(pattern: str, text: str) -> tuple[str, ...]:
    """Return the groups of the only match."""
    (found,) = re.finditer(pattern, text)
    return found.groups()


@pytest.mark.parametrize(("first", "last"), [(250, 400), (205, 230), (100, 500)])
def test_missing_ticks_are_no_difference(
    first: int,
    last: int,
    messages: Messages,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = write_mcap(tmp_path / "bag", without(messages, first, last))
    assert replay([str(bag)]) == 0
    text = capsys.readouterr().out
    missing, begin, exact = map(
        int, one_match(r"(\d+) ticks are missing from tick (\d+) on: exact from tick (\d+)", text)
    )
    assert len(ticks_of(bag)) == TICKS - missing
    assert begin + missing <= exact <= begin + missing + 11
    assert f"{missing} ticks are missing" in " ".join(judge_bag(bag, "bag").notes)


def test_a_real_difference_behind_missing_ticks_is_found(
    messages: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part = without(messages, 200, 350)
    wrong = [k for k, each in enumerate(part) if each.topic == "/controller/tick"][-3]
    data = bytearray(part[wrong].data)
    data[-1 - 8 * 12] ^= 1  # one of the last positions
    part[wrong] = part[wrong]._replace(data=bytes(data))
    bag = write_mcap(tmp_path / "bag", part)
    assert replay([str(bag)]) == 1
    assert "first difference" in capsys.readouterr().out


def test_without_memories_nothing_behind_missing_ticks_is_compared(
    messages: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old = [each for each in messages if each.topic != "/controller/memory"]
    assert replay([str(write_mcap(tmp_path / "whole", old))]) == 0
    bag = write_mcap(tmp_path / "gap", without(old, 200, 350))
    capsys.readouterr()
    assert replay([str(bag)]) == 0
    assert "no controller/memory follows" in capsys.readouterr().out
    late = write_mcap(tmp_path / "late", joined_at(old, 300))
    assert replay([str(late)]) == 3
    assert "no tick can be compared bit for bit" in capsys.readouterr().out
    assert replay([str(late), "--tolerance", "1e-12"]) == 1
    assert replay([str(late), "--tolerance", "1"]) == 0


def test_a_damaged_or_foreign_memory_is_not_used(messages: Messages, tmp_path: Path) -> None:
    late = joined_at(messages, 300)
    for k, each in enumerate(late):
        if each.topic == "/controller/memory":
            data = bytearray(each.data)
            data[len(data) // 2] ^= 4
            late[k] = each._replace(data=bytes(data))
    assert replay([str(write_mcap(tmp_path / "bag", late))]) == 3


def test_ticks_whose_path_was_not_recorded_are_missing(
    messages: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = next(each for each in messages if each.topic == "/reference_path")
    late = [each for each in joined_at(messages, 300) if each.topic != path.topic]
    bag = write_mcap(tmp_path / "none", late)
    assert replay([str(bag)]) == 2
    assert "holds no message on /reference_path" in capsys.readouterr().out


@pytest.mark.parametrize("seed", range(3))
def test_messages_that_are_lost_at_random_cause_no_difference(
    seed: int, messages: Messages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(seed)
    first = {each.topic: each for each in reversed(messages)}
    kept = [each for each in messages if rng.random() > 0.05 or each == first[each.topic]]
    assert replay([str(write_mcap(tmp_path / "bag", kept, files=3))]) == 0
    assert "missing" in capsys.readouterr().out
