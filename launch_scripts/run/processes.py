"""Node processes that are started and ended together."""

import ctypes
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType

PATIENCE = 10.0
"""Wall time to wait for the end of a process after SIGINT, and again after SIGTERM [s]."""
SET_PARENT_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG of <linux/prctl.h>."""
LIBC = ctypes.CDLL(None)
PROFILES = Path(__file__).with_name("fastdds.xml")
"""Settings of the middleware for one computer."""
COMPLETED = "completed"
"""Reason of a run that the simulator has ended."""
OWN_CLOCK = "/clock:=clock"
"""Remapping of the clock into the namespace of a node."""
NODE_DIED, WRONG_SET_UP = 1, 2
"""Exit codes of the scripts that start nodes; a node with invalid options also ends with 2."""
LOG_PREFIX = re.compile(r"^\[\w+\] \[[\d.]+\] \[[\w./]+\]: |^error: ")


class Processes:
    """Node processes with one log file each; leaving the context ends all that still run.

    Note:
        Each node has its own process group, so that Ctrl-C reaches only this process, which ends
        the nodes in order, the recorder last. If this process is killed, the Linux kernel sends
        SIGTERM to the nodes.
    """

    def __init__(self, logs: Path, namespace: str = "") -> None:
        """Create the folder of the logs.

        Args:
            logs: The folder.
            namespace: Namespace of all nodes and of their clock; empty: none.
        """
        self.logs, self.namespace = logs, namespace.strip("/")
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        logs.mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> "Processes":
        """Return this object; no node runs yet."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        """End all nodes at once, except the first one (the recorder), which ends after them."""
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
        """Start `python -m module` as a node.

        Args:
            name: Name of the node here and of its log file.
            module: Python module.
            parameters: ROS parameters.
            renamed: New name of each remapped topic.
        """
        command = [sys.executable, "-m", module, "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={yaml_text(value)}"]
        if self.namespace:
            command += ["-r", f"__ns:=/{self.namespace}", "-r", OWN_CLOCK]
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
        """Return the exit codes of the nodes that have ended."""
        codes = {name: process.poll() for name, process in self.running.items()}
        return {name: code for name, code in codes.items() if code is not None}

    def log(self, name: str) -> Path:
        """Return the log file of a node."""
        return self.logs / f"{name}.log"

    def last_line(self, name: str) -> str:
        """Return the last line of a node's log, without the time."""
        return (self.lines(name) or ["no output"])[-1]

    def lines(self, name: str) -> list[str]:
        """Return the non-empty lines of a node's log, without the time."""
        lines = self.log(name).read_text(encoding="utf-8", errors="replace").split("\n")
        return [LOG_PREFIX.sub("", line.strip()) for line in lines if line.strip()]


def end(processes: list[subprocess.Popen[bytes]]) -> None:
    """End processes with SIGINT, then SIGTERM, then SIGKILL."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        for process in processes:
            process.send_signal(number)
        until = time.monotonic() + PATIENCE
        for process in processes:
            with suppress(subprocess.TimeoutExpired):
                process.wait(max(until - time.monotonic(), 0.0))


def end_with_parent() -> None:
    """Request SIGTERM for this new process when its parent ends."""
    if sys.platform == "linux":
        LIBC.prctl(SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)


def yaml_text(value: object) -> str:
    """Return the YAML text of a parameter value that keeps type and text in ROS."""
    if isinstance(value, bool):
        return str(value).lower()
    return "'" + value.replace("'", "''") + "'" if isinstance(value, str) else repr(value)


def ros_environment() -> dict[str, str]:
    """Return the environment of this process with the variables that its nodes need.

    Topics stay on this computer, unless the environment selects another discovery range. The ROS
    wheels contain only one middleware, which gets a profile for one computer; where ROS 2 itself
    is sourced, its middleware is not changed.
    """
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "ROS_DISTRO" not in environment:
        environment["RMW_IMPLEMENTATION"] = "rmw_fastrtps_cpp"
        environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(PROFILES))
    return environment
