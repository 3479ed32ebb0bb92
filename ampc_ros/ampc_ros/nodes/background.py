"""Work in a process of its own, which never holds the interpreter of the control thread.

A thread is not enough: fitting a spline, or searching a text of megabytes, holds the interpreter
lock for tens of milliseconds in one call. The process ends with its owner, whose end of the pipe
closes. Large arrays are sent outside the pickled object, so that neither side copies them while it
holds the lock.
"""

import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import IO, Any, NamedTuple

NICENESS = 5
"""Niceness of a process that runs all the time, so that it cannot delay a command on one core."""


class Outcome(NamedTuple):
    """Result of a call, or the error that it raised."""

    value: Any = None
    error: ValueError | None = None

    def result(self) -> Any:
        """Return the value.

        Raises:
            ValueError: The call raised it.
        """
        if self.error:
            raise self.error
        return self.value


class Background:
    """Runs one call at a time in another process; a newer waiting call replaces an older one."""

    def __init__(self, notify: Callable[[], None], niceness: int = 0) -> None:
        """Start the process, from a thread, so that this does not wait for it.

        Args:
            notify: Called from the thread whenever `take` has a further outcome.
            niceness: Of the process.
        """
        self.notify, self.niceness = notify, niceness
        self.replaced = 0
        """Number of calls that were replaced before they began."""
        self._waiting: tuple[Any, Any] | None = None
        self._finished: list[tuple[Any, Outcome]] = []
        self._changed = threading.Condition()
        self._is_closed = False
        self._process: subprocess.Popen[bytes] | None = None
        self.is_alive = True
        """Whether the process had not ended at the newest outcome."""
        threading.Thread(target=self._run, name="background", daemon=True).start()

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Call a function of a module as soon as the process is free.

        Args:
            tag: Returned with the outcome; it stays in this process.
            function: Function at the top level of a module.
            arguments: Its arguments; wrap bytes in a `pickle.PickleBuffer`.
        """
        with self._changed:
            self.replaced += self._waiting is not None
            self._waiting = (tag, (function, arguments))
            self._changed.notify()

    def take(self) -> list[tuple[Any, Outcome]]:
        """Return tag and outcome of the calls that have finished since the last time."""
        with self._changed:
            finished, self._finished = self._finished, []
            return finished

    def close(self) -> None:
        """End the process; outcomes that are still to come are dropped."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()
            if self._process:
                self._process.kill()

    def _run(self) -> None:
        with self._changed:
            if self._is_closed:
                return
            self._process = process = start_process(self.niceness)
        assert process.stdin
        assert process.stdout
        with process:
            while call := self._next():
                tag, content = call
                try:
                    send(process.stdin, content)
                    outcome = receive(process.stdout)
                except (OSError, EOFError):
                    outcome = Outcome(error=ValueError("the background process has ended"))
                with self._changed:
                    if self._is_closed:
                        break
                    self._finished.append((tag, outcome))
                    self.is_alive = process.poll() is None
                    self.notify()
            process.kill()

    def _next(self) -> tuple[Any, Any] | None:
        """Wait for a call; None: the owner has closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_closed)
            call, self._waiting = self._waiting, None
            return None if self._is_closed else call


def start_process(niceness: int) -> subprocess.Popen[bytes]:
    """Start a process that runs `main` with the import path of this one."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [sys.executable, "-m", __name__, str(niceness)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
        env=environment,
        start_new_session=True,  # a Ctrl-C in the terminal is handled by the owner
    )


def send(stream: IO[bytes], content: Any) -> None:
    """Write an object; large arrays follow the pickled part without a copy."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(content, protocol=5, buffer_callback=buffers.append)
    parts = [memoryview(head), *(each.raw() for each in buffers)]
    sizes = struct.pack(f"<{len(parts) + 1}Q", len(parts), *(len(part) for part in parts))
    for part in (memoryview(sizes), *parts):
        done = 0
        while done < len(part):
            done += stream.write(part[done:])
    stream.flush()


def receive(stream: IO[bytes]) -> Any:
    """Read an object of `send`.

    Raises:
        EOFError: The other side has closed the stream.
    """
    (count,) = struct.unpack("<Q", _read(stream, 8))
    sizes = struct.unpack(f"<{count}Q", _read(stream, 8 * count))
    head, *buffers = (_read(stream, size) for size in sizes)
    return pickle.loads(head, buffers=buffers)  # noqa: S301 (written by `send` of the other side)


def _read(stream: IO[bytes], size: int) -> bytearray:
    data = bytearray(size)
    view, done = memoryview(data), 0
    while done < size:
        count = stream.readinto(view[done:])  # type: ignore[attr-defined]
        if not count:
            raise EOFError
        done += count
    return data


def main() -> None:
    """Answer calls from the standard input until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(int(sys.argv[1]))
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a print in a called function must not reach the pipe
    while True:
        try:
            function, arguments = receive(requests)
        except EOFError:
            return
        try:
            outcome = Outcome(function(*arguments))
        except ValueError as error:
            outcome = Outcome(error=ValueError(str(error)))
        except Exception as error:
            outcome = Outcome(error=ValueError(f"{type(error).__name__}: {error}"))
        try:
            send(answers, outcome)
        except BrokenPipeError:  # the owner has ended
            os._exit(0)


if __name__ == "__main__":
    # The class that is sent is that of the importable module, not of `__main__`.
    from ampc_ros.nodes import background

    background.main()
