"""Execution of searches in threads, with checkpoints; workers evaluate the fitness.

A checkpoint holds the evaluations of a search. A resumed search begins anew and finds its first
evaluations there, so every method resumes bit for bit.
"""

import contextlib
import json
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from ampc_msgs_config.config import read_text
from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains
from launch_scripts.tuning.fitness import gains_of_row
from launch_scripts.tuning.methods import BudgetSpent, SearchRecord, polish, run_method
from launch_scripts.tuning.smoothness import jump_penalty
from launch_scripts.tuning.task import FIELDS, LOGARITHMIC, Search, SearchSpace
from launch_scripts.tuning.workers import Workers

TASK = "task.json"
MAX_CHECKPOINT_BYTES = 1_000_000_000
"""Largest size of a checkpoint."""
RESUME = "all earlier checkpoints are intact, continue with --resume"
SearchResult = list[tuple[Gains, float]]
"""Evaluated gains with their fitness, the best first; infinite if a car left the road."""


class SearchStopped(Exception):
    """Raised in a search after another search has failed."""


def write_atomically(file: Path, text: str, remedy: str = RESUME) -> None:
    """Write a file so that it holds either its old or its new content after any failure.

    Args:
        file: File to write; its folder is created.
        text: New content.
        remedy: What the user can do after a failure, for the message.

    Raises:
        ValueError: The file cannot be written; its previous content is unchanged.
    """
    part = file.with_name(f".{file.name}.half")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with part.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, file)
        folder = os.open(file.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise ValueError(f"{file}: cannot be written: {error.strerror}; {remedy}") from error


class Checkpoints:
    """Folder with the evaluations of every search of one task."""

    def __init__(self, folder: Path) -> None:
        """Use a folder, which need not exist yet."""
        self.folder = folder

    def begin(self, task: dict[str, Any], resume: bool) -> None:
        """Start a new task, or continue the task in the folder.

        Raises:
            ValueError: New: the folder already holds an interrupted task. Continued: the folder is
                empty or holds another task; names the field that differs.
        """
        saved = self._read(TASK)
        if not resume:
            if saved is not None:
                raise ValueError(
                    f"{self.folder}: holds an interrupted search: continue it with --resume, "
                    "choose another --output, or delete the folder"
                )
            text = json.dumps(task, indent=1) + "\n"
            write_atomically(self.folder / TASK, text, "nothing was searched")
            return
        if saved is None:
            raise ValueError(f"{self.folder}: nothing to resume")
        for key in {**saved, **task}:
            old, new = saved.get(key), json.loads(json.dumps(task.get(key)))
            if old != new:
                raise ValueError(
                    f"{self.folder / TASK}: checkpoint of another task: {key} = {old!r}, "
                    f"now {new!r}"
                )

    def save(self, name: str, record: SearchRecord) -> None:
        """Write the evaluations of a search."""
        fitness = [value if math.isfinite(value) else None for value in record.fitness.tolist()]
        content = {"positions": record.positions.tolist(), "fitness": fitness}
        write_atomically(self.folder / f"{name}.json", json.dumps(content) + "\n")

    def load(self, name: str) -> tuple[Array, Array] | None:
        """Read positions (n, d) and fitness (n,) of a search, None without a checkpoint.

        Raises:
            ValueError: The file is not a checkpoint; names the file.
        """
        saved = self._read(f"{name}.json")
        if saved is None:
            return None
        try:
            positions, fitness = np.array(saved["positions"], float), saved["fitness"]
            values = np.array([math.inf if value is None else value for value in fitness], float)
            if positions.ndim != 2 or len(positions) != len(values):
                raise ValueError(f"shapes {positions.shape} and {values.shape} differ")
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{self.folder / name}.json: not a checkpoint: {error}") from error
        return positions, values

    def clear(self) -> None:
        """Delete the checkpoints and their folder."""
        for file in self.folder.glob("*.json"):
            file.unlink()
        self.folder.rmdir()

    def _read(self, name: str) -> dict[str, Any] | None:
        file = self.folder / name
        if not file.exists():
            return None
        try:
            content = json.loads(read_text(file, MAX_CHECKPOINT_BYTES))
        except (json.JSONDecodeError, RecursionError) as error:
            raise ValueError(f"{file}: cannot be read: {error}") from error
        if not isinstance(content, dict):
            raise ValueError(f"{file}: must hold a mapping, not {type(content).__name__}")
        return content


def run_searches(
    searches: Sequence[Search],
    workers: Workers,
    checkpoints: Checkpoints,
    show: Callable[[Search, SearchRecord], None],
) -> dict[str, SearchResult]:
    """Run searches, several at a time, and return their results by name.

    Args:
        searches: Each one starts from its checkpoint if there is one.
        workers: Evaluate the fitness.
        checkpoints: Receive every evaluation before the next one starts.
        show: Called after evaluations, in any thread.

    Raises:
        ValueError: The workers are lost, or a checkpoint cannot be read or written.
    """
    stop = Event()

    def run(item: Search) -> tuple[str, SearchResult]:
        def cost(positions: Array) -> Array:
            parts = np.array_split(positions, min(workers.capacity, len(positions)))
            tasks = [workers.executor.submit(item.cost, part) for part in parts]
            return np.concatenate([task.result() for task in tasks])

        def save(record: SearchRecord) -> None:
            if len(record.fitness) > len(known[1]):
                checkpoints.save(item.name, record)
            show(item, record)
            if stop.is_set():
                raise SearchStopped

        dimensions = item.space.dimensions
        known = checkpoints.load(item.name) or (np.empty((0, len(dimensions))), np.empty(0))
        sizes = item.evaluations, item.generation
        record = SearchRecord(cost, dimensions, *sizes, known, save)
        return item.name, result_of(run_search(item, record), item.space)

    with ThreadPoolExecutor(min(len(searches), workers.capacity + 1)) as drivers:
        tasks = [drivers.submit(run, item) for item in searches]
        try:
            done, _ = wait(tasks, return_when=FIRST_EXCEPTION)
            failures = [e for task in done if (e := task.exception()) is not None]
            # The cause comes first: SearchStopped only follows from it.
            for failure in sorted(failures, key=lambda e: isinstance(e, SearchStopped)):
                raise failure
        except workers.losses as error:
            cause = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(
                f"workers: lost ({cause}); continue without them with --resume"
            ) from error
        finally:
            stop.set()
    return dict(task.result() for task in tasks)


def run_search(item: Search, record: SearchRecord) -> SearchRecord:
    """Run the method of a search, or the polish of a node, and return the record."""
    if item.neighbours is None:
        return run_method(item.method, record, item.rng)
    start, beside = item.neighbours

    def adjusted(unit: Array, fitness: float) -> float:
        gains = result_of(record, item.space, -1)[0][0]
        return fitness * math.exp(sum(jump_penalty(gains, other) for other in beside))

    with contextlib.suppress(BudgetSpent):
        polish(record, unit_position(start, item.space), item.evaluations, adjusted)
    return record


def result_of(record: SearchRecord, space: SearchSpace, only: int | None = None) -> SearchResult:
    """Return the evaluated gains with their fitness, the best first; or those of one index."""
    chosen = np.argsort(record.fitness, kind="stable") if only is None else [only]
    rows = space.gains_at(record.positions[chosen])
    return [
        (gains_of_row(row), float(record.fitness[i])) for row, i in zip(rows, chosen, strict=True)
    ]


def unit_position(gains: Gains, space: SearchSpace) -> Array:
    """Return the position (d,) of gains in the unit cube of a search space."""
    values = []
    for item in space.dimensions:
        value = float(getattr(gains, FIELDS[item.name]))
        value = math.log10(value) if item.name in LOGARITHMIC else value
        values.append((value - item.low) / (item.high - item.low))
    return np.clip(values, 0.0, 1.0)
