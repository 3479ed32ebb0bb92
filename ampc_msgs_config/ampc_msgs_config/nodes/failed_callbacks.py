"""Callbacks of a node that raise: each cause is logged once, all are counted, the node continues.

This holds for every callback, those of rclpy's own services included. SystemExit and
KeyboardInterrupt are no failures. A service whose callback fails sends no response.
"""

import time
import traceback
from pathlib import Path
from typing import Any

from rclpy.client import Client
from rclpy.executors import (
    ConditionReachedException,
    Executor,
    ExternalShutdownException,
    ShutdownException,
    TimeoutException,
)
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.service import Service

LONGEST_WORD, LONGEST_TEXT = 300, 2000
"""Longest word and text that are logged or published [characters]."""
PAUSE = 0.001
"""Wall time after a failure of the executor itself, which would use a whole core [s]."""


class FailedCallbacks:
    """Runs callbacks, and counts and logs those that raise."""

    def __init__(self, logger: RcutilsLogger, *, ends_stream: bool = False) -> None:
        """Start without a failure.

        Args:
            logger: Logger of the node.
            ends_stream: Whether a failure is raised, except that of a service: in lock-step all
                other nodes would wait for ever.
        """
        self.logger, self.ends_stream = logger, ends_stream
        self.count = 0
        """Number of failures."""
        self.newest = ""
        """Newest cause that was not reported before, in one sentence."""
        self._causes: set[tuple[str, str]] = set()

    def run_next(self, executor: Executor, timeout: float) -> bool:
        """Run the next callback, or wait for one; return whether there was one.

        Args:
            executor: Executor with the node.
            timeout: Longest wait [s].

        Raises:
            ExternalShutdownException: The context has been shut down.
            Exception: The callback raised it, see `ends_stream`.
        """
        entity, error = run_callback(executor, timeout)
        if error is not None:
            self.handle(entity, error)
        return entity is not None

    def handle(self, entity: Any, error: Exception) -> None:
        """Store a failure of a callback, or raise it.

        Args:
            entity: Owner of the callback; None: the executor itself has failed.
            error: The failure.

        Raises:
            ExternalShutdownException: The context has been shut down.
            Exception: The callback raised it, see `ends_stream`.
        """
        if isinstance(error, ExternalShutdownException):
            raise error
        if self.ends_stream and not isinstance(entity, Service | Client):
            raise error
        self.store(error)
        if entity is None:
            time.sleep(PAUSE)

    def store(self, error: Exception) -> None:
        """Count a failure, and log a new cause."""
        self.count += 1
        cause = type(error).__name__, place_of(error)
        if cause not in self._causes:
            self._causes.add(cause)
            self.newest = f"a callback failed: {describe_error(error)}"
            self.logger.error(f"{self.newest}; the node continues")

    def take_newest(self) -> str:
        """Return the newest cause that was not reported before; empty: there is none."""
        newest, self.newest = self.newest, ""
        return newest


def run_callback(executor: Executor, timeout: float) -> tuple[Any, Exception | None]:
    """Run the next callback; return its entity and its exception, each None where there is none.

    Note:
        This is `spin_once`, which does not name the entity.
    """
    entity: Any = None
    try:
        task, entity, _ = executor.wait_for_ready_callbacks(timeout_sec=timeout)
        task()
        error = task.exception()
    except (TimeoutException, ShutdownException, ConditionReachedException):
        return None, None
    except Exception as failure:
        error = failure
    if error is not None:
        release(entity)
    return entity, error


def release(entity: Any) -> None:
    """Let an entity whose callback has failed be waited for again.

    Note:
        Where its message could not be taken, rclpy goes on marking it as being executed.
    """
    if getattr(entity, "_executor_event", False):
        entity._executor_event = False
        entity.callback_group.ending_execution(entity)


def place_of(error: BaseException) -> str:
    """Return file, line and function that raised an error."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return "unknown place"
    frame = frames[-1]
    return f"{Path(frame.filename).name}:{frame.lineno}, {frame.name}"


def describe_error(error: BaseException) -> str:
    """Return type, text and place of an error in one line."""
    return f"{type(error).__name__}: {shortened(str(error))} ({place_of(error)})"


def shortened(text: str) -> str:
    """Return a text in one line, with long words and a long end left out."""
    words = (
        word if len(word) <= LONGEST_WORD else f"{word[: LONGEST_WORD - 3]}..."
        for word in text[: 100 * LONGEST_TEXT].split()
    )
    line = " ".join(words)
    return line if len(line) <= LONGEST_TEXT else f"{line[: LONGEST_TEXT - 3]}..."
