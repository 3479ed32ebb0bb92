"""Convert a bag file in SQLite, of any version of rosbag2, to MCAP, as far as it is undamaged."""

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import IO, Any

from mcap.writer import CompressionType, Writer

from ampc_msgs_config.recording.message_types import define

JOURNALS = ("-wal", "-journal")
"""Endings of the files beside a database in which a killed recorder leaves messages."""
ROWS = "SELECT rowid, topic_id, timestamp, data FROM messages"


def to_mcap(content: IO[bytes], file: Path, target: IO[bytes]) -> str:
    """Write the messages of a database into an MCAP file, in the order of recording.

    Args:
        content: The database, decompressed.
        file: Its file; journals are read that lie beside it. Nothing there is changed.
        target: Receives a complete MCAP file.

    Returns:
        Why it is not all of the file; empty: it is.

    Raises:
        ValueError: It is no database of rosbag2, or too damaged to be opened.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "bag.db3"
        with copy.open("wb") as stream:
            shutil.copyfileobj(content, stream)
        for ending in JOURNALS:
            if (journal := file.with_name(file.name + ending)).is_file():
                shutil.copyfile(journal, copy.with_name(copy.name + ending))
        try:
            with closing(sqlite3.connect(copy)) as database:
                database.execute("PRAGMA writable_schema = ON")  # a cut file can be opened
                return copy_messages(database, target)
        except sqlite3.Error as error:
            raise ValueError(f"the SQLite database cannot be read: {error}") from error


def copy_messages(database: sqlite3.Connection, target: IO[bytes]) -> str:
    """Write all topics and messages; return why it is not all of the database, or ''."""
    writer: Any = Writer(target, compression=CompressionType.NONE)
    writer.start("ros2", "")
    channels = add_channels(database, writer)
    faults, numbers = list[str](), dict.fromkeys(channels, 0)
    for row, topic, time_ns, data in rows_around_damage(database, faults):
        if topic in channels and isinstance(data, bytes) and isinstance(time_ns, int):
            numbers[topic] += 1
            writer.add_message(channels[topic], time_ns, data, time_ns, numbers[topic])
        else:
            faults.append(f"message {row} is damaged")
    writer.finish()
    target.seek(0)
    return faults[0] if faults else ""


def add_channels(database: sqlite3.Connection, writer: Any) -> dict[int, int]:
    """Register all topics; return the number of each channel by that of the topic."""
    database.row_factory = sqlite3.Row
    texts = dict[str, str]()
    with suppress(sqlite3.Error):  # rosbag2 before Iron does not write definitions
        for row in database.execute("SELECT * FROM message_definitions"):
            texts[row["topic_type"]] = row["encoded_message_definition"]
    channels, schemas = {}, dict[str, int]()
    for row in database.execute("SELECT * FROM topics ORDER BY id"):
        topic = dict(row)
        name = str(topic["type"])
        if name not in schemas:
            with suppress(ValueError):  # not installed: a reader cannot decode it
                texts[name] = texts.get(name) or define(name).text
            text = texts.get(name, "").encode()
            schemas[name] = writer.register_schema(name, "ros2msg", text)
        metadata = {
            "offered_qos_profiles": str(topic.get("offered_qos_profiles") or ""),
            "topic_type_hash": str(topic.get("type_description_hash") or ""),
        }
        encoding = str(topic["serialization_format"])
        number = writer.register_channel(topic["name"], encoding, schemas[name], metadata)
        channels[int(topic["id"])] = number
    database.row_factory = None
    return channels


def rows_around_damage(database: sqlite3.Connection, faults: list[str]) -> Iterator[Any]:
    """Return the rows of all messages; around a damage those before it and those behind it.

    Args:
        database: Open database.
        faults: Receives one line if there is damage.
    """
    last = -1
    try:
        for row in database.execute(f"{ROWS} ORDER BY rowid"):
            last = row[0]
            yield row
    except sqlite3.Error as error:
        faults.append(f"the SQLite database is damaged behind message {max(last, 0)}: {error}")
        behind = []
        with suppress(sqlite3.Error):
            for row in database.execute(f"{ROWS} WHERE rowid > ? ORDER BY rowid DESC", (last,)):
                behind.append(row)
        yield from reversed(behind)
