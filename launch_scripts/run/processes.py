"""Node processes that live and end together."""

import ctypes
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from launch_scripts.run.environment import ros_environment

PATIENCE = 10.0
"""Wall time that a process gets to end after SIGINT, and again after SIGTERM [s]."""
SET_PARENT_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG of <linux/prctl.h>."""
LIBC = ctypes.CDLL(None)
LOG_PREFIX = re.compile(r"^\[\w+\] \[[\d.]+\] \[[\w./]+\]: |^error: ")


class Processes:
    """Starts nodes, each with its log file; on leaving, ends whatever still runs.

    Note:
        Each node gets a process group of its own, so that Ctrl-C reaches only this process, which
        ends the nodes in order, the recorder last. Where this process is killed itself, the
        kernel (of Linux) sends SIGTERM to the nodes.
    """

    def __init__(self, logs: Path) -> None:
        """Write the logs into a folder."""
        self.logs = logs
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        logs.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> "Processes":
        """Nothing runs yet."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        """End all at once, and the one that was started first, the recorder, after them."""
        nodes = list(self.running.values())
        end(nodes[1:])
        end(nodes[:1])

    def start(
        self,
        name: str,
        module: str,
        parameters: Mapping[str, object],
        renamed: Mapping[str, str] | None = None,
    ) -> None:
        """Start a node: `python -m module` with ROS parameters, some of its topics renamed."""
        command = [sys.executable, "-m", module, "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={yaml_text(value)}"]
        for topic, other in (renamed or {}).items():
            command += ["-r", f"{topic}:={other}"]
        with self.log(name).open("wb") as log:
            self.running[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=ros_environment(),
                start_new_session=True,
                preexec_fn=end_with_parent,
            )

    def ended(self) -> dict[str, int]:
        """Give the exit codes of the nodes that have ended."""
        codes = {name: process.poll() for name, process in self.running.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def log(self, name: str) -> Path:
        """Give the log file of a node."""
        return self.logs / f"{name}.log"

    def last_line(self, name: str) -> str:
        """Give the last line of a node's log, without the time."""
        return (self.words(name) or ["no output"])[-1]

    def words(self, name: str) -> list[str]:
        """Give the lines of a node's log that say something, without the time."""
        lines = self.log(name).read_text(encoding="utf-8", errors="replace").split("\n")
        return [LOG_PREFIX.sub("", line.strip()) for line in lines if line.strip()]


def end(processes: list[subprocess.Popen[bytes]]) -> None:
    """End processes: SIGINT, then SIGTERM, then SIGKILL."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for process in processes:
            process.send_signal(number)
        until = time.monotonic() + PATIENCE
        for process in processes:
            with suppress(subprocess.TimeoutExpired):
                process.wait(max(until - time.monotonic(), 0.0))


def end_with_parent() -> None:
    """In a new process: ask for SIGTERM at the end of the process that has started it."""
    if sys.platform == "linux":
        LIBC.prctl(SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)


def yaml_text(value: object) -> str:
    """Write a parameter value so that ROS reads the same type and text."""
    if isinstance(value, bool):
        return str(value).lower()
    return "'" + value.replace("'", "''") + "'" if isinstance(value, str) else repr(value)
