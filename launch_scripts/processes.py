"""Node processes that live and end together."""

import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

from launch_scripts.environment import ros_environment

PATIENCE = 10.0
"""Wall time that a process gets to end after SIGINT, and again after SIGTERM [s]."""


class Processes:
    """Starts nodes, each with its log file; on leaving, ends whatever still runs.

    Note:
        Each node gets a process group of its own, so that Ctrl-C reaches only this process, which
        ends the nodes in order, the recorder last.
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
        """End all, the last started first; the recorder was started first."""
        for name in reversed(list(self.running)):
            self.end(name)

    def start(self, name: str, module: str, parameters: Mapping[str, object]) -> None:
        """Start a node: `python -m module` with ROS parameters."""
        command = [sys.executable, "-m", module, "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={yaml_text(value)}"]
        with self.log(name).open("wb") as log:
            self.running[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=ros_environment(),
                start_new_session=True,
            )

    def ended(self) -> dict[str, int]:
        """Give the exit codes of the nodes that have ended."""
        codes = {name: process.poll() for name, process in self.running.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def end(self, name: str) -> int:
        """End a node: SIGINT, then SIGTERM, then SIGKILL; gives its exit code."""
        process = self.running.pop(name)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if process.poll() is None:
                process.send_signal(number)
            try:
                return process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                continue
        return process.wait()

    def log(self, name: str) -> Path:
        """Give the log file of a node."""
        return self.logs / f"{name}.log"

    def last_words(self, name: str) -> str:
        """Give the last line of a node's log."""
        lines = self.log(name).read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "no output")


def yaml_text(value: object) -> str:
    """Write a parameter value so that ROS reads the same type and text."""
    if isinstance(value, bool):
        return str(value).lower()
    return "'" + value.replace("'", "''") + "'" if isinstance(value, str) else repr(value)
