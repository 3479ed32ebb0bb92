"""Files of a tuning: each is whole or not there, and a checkpoint belongs to one task only."""

import contextlib
import json
import os
from pathlib import Path
from typing import Any

from ampc_msgs_config.config import read_text
from ampc_ros.pso.swarm import Swarm, swarm_from_json, swarm_to_json

TASK = "task.json"
MAX_BYTES = 1_000_000_000
"""Of a checkpoint."""


def write_whole(file: Path, text: str) -> None:
    """Write a file so that it holds either its old or its new content, whatever happens.

    Raises:
        ValueError: It cannot be written; what was there before is untouched.
    """
    half = file.with_name(f".{file.name}.half")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with half.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(half, file)
        folder = os.open(file.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        with contextlib.suppress(OSError):
            half.unlink(missing_ok=True)
        raise ValueError(
            f"{file}: cannot be written: {error.strerror}; what was saved before is whole, "
            "--resume goes on from it"
        ) from error


class Checkpoints:
    """The last generation of every search of a task, in a folder."""

    def __init__(self, folder: Path) -> None:
        """Keep them in a folder, which need not exist yet."""
        self.folder = folder

    def begin(self, task: dict[str, Any]) -> None:
        """Begin anew.

        Raises:
            ValueError: Somebody's search is in the folder already.
        """
        if (self.folder / TASK).exists():
            raise ValueError(
                f"{self.folder}: holds a search that was interrupted: --resume goes on with it, "
                "another --output begins anew"
            )
        write_whole(self.folder / TASK, json.dumps(task, indent=1) + "\n")

    def resume(self, task: dict[str, Any]) -> None:
        """Go on with what is in the folder.

        Raises:
            ValueError: There is nothing, or it is of another task; names the field that differs.
        """
        found = self._read(TASK)
        if found is None:
            raise ValueError(f"{self.folder}: nothing to resume there")
        for key in {**found, **task}:
            old, new = found.get(key), json.loads(json.dumps(task.get(key)))
            if old != new:
                raise ValueError(
                    f"{self.folder / TASK}: a checkpoint of another task: {key} = {old!r}, "
                    f"now {new!r}"
                )

    def save(self, name: str, swarm: Swarm) -> None:
        """Keep the last generation of a search."""
        write_whole(self.folder / f"{name}.json", json.dumps(swarm_to_json(swarm)) + "\n")

    def load(self, name: str) -> Swarm | None:
        """Give the last generation of a search that was kept."""
        found = self._read(f"{name}.json")
        if found is None:
            return None
        try:
            return swarm_from_json(found)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{self.folder / name}.json: no checkpoint: {error}") from error

    def clear(self) -> None:
        """Throw all away: the outcome is written."""
        for file in self.folder.glob("*.json"):
            file.unlink()
        self.folder.rmdir()

    def _read(self, name: str) -> dict[str, Any] | None:
        file = self.folder / name
        if not file.exists():
            return None
        try:
            content = json.loads(read_text(file, MAX_BYTES))
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"{file}: cannot be read: {error}") from error
        if not isinstance(content, dict):
            raise ValueError(f"{file}: must hold a mapping, not {type(content).__name__}")
        return content
