"""Environments and command lines in which a node cannot work as usual."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from launch_scripts.run.processes import PROFILES, ros_environment
from tests.workshop.attacks.attempts import Attempt, Choice

NODES = {
    "controller": "ampc_ros.nodes.controller_node",
    "gate": "ampc_ros.nodes.gate_node",
    "planner": "ampc_ros.nodes.planner_node",
    "simulator": "sim_vehicle.nodes.simulator_node",
    "recorder": "ampc_msgs_config.nodes.recorder_node",
    "markers": "ampc_msgs_config.nodes.marker_node",
}
PATIENCE = 240.0
"""Longest time until a node is ready or has ended, with compilation [s]."""
WRONG_MIDDLEWARE = 102
"""Exit code of rcl, before any code of the product runs."""


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Start nodes in hostile environments: each is ready, or ends with one line."""
    attacks: dict[str, Callable[[], str]] = {}
    for node in NODES:
        attacks[f"ROS_DOMAIN_ID=abc, {node}"] = starting(choice, node, ROS_DOMAIN_ID="abc")
        attacks[f"malformed -p, {node}"] = starting(choice, node, options=["-p", "x:=[1"])
    for text in ("vehicle:=" + "x" * 300, "guard:=nowhere", "settings:=7", "lock_step:=maybe"):
        attacks[f"-p {text[:20]}, controller"] = starting(
            choice, "controller", options=["-p", text]
        )
    attacks["no HOME, controller"] = starting(choice, "controller", HOME=None)
    attacks["HOME is a file, controller"] = starting(choice, "controller", HOME="/dev/null")
    attacks["cache cannot be written, planner"] = starting(
        choice, "planner", NUMBA_CACHE_DIR="/proc/nowhere"
    )
    attacks["XDG_CACHE_HOME cannot be written, controller"] = starting(
        choice, "controller", XDG_CACHE_HOME="/proc/nowhere"
    )
    attacks["no PATH, gate"] = starting(choice, "gate", PATH=None)
    attacks["LANG=xx, gate"] = starting(choice, "gate", LANG="xx", LC_ALL="xx_YY.UTF-99")
    attacks["PYTHONIOENCODING=ascii, gate"] = starting(choice, "gate", PYTHONIOENCODING="ascii")
    attacks["unknown middleware, gate"] = starting(choice, "gate", RMW_IMPLEMENTATION="rmw_none")
    attacks["ROS_LOG_DIR cannot be written, gate"] = starting(
        choice, "gate", ROS_LOG_DIR="/proc/nowhere"
    )
    attacks["closed stdin, controller"] = starting(choice, "controller", prefix="exec <&-")
    attacks["closed stdin, gate"] = starting(choice, "gate", prefix="exec <&-")
    attacks["closed stdout, gate"] = starting(choice, "gate", prefix="exec >&-")
    for size in (400_000, 600_000):
        attacks[f"ulimit -v {size}, gate"] = starting(choice, "gate", prefix=f"ulimit -v {size}")
    attacks["ulimit -v 600000, controller"] = starting(
        choice, "controller", prefix="ulimit -v 600000"
    )
    attacks["ulimit -n 20, gate"] = starting(choice, "gate", prefix="ulimit -n 20")
    for number in (signal.SIGINT, signal.SIGTERM):
        for delay in (0.3, 1.0, 3.0):
            name = f"{number.name} after {delay:g} s, controller"
            attacks[name] = partial(interrupted, number, delay)
    return choice.attempts(attacks)


def starting(
    choice: Choice,
    node: str,
    options: Sequence[str] = (),
    prefix: str = "true",
    **variables: str | None,
) -> Callable[[], str]:
    """Return an attack that starts a node; None removes a variable of the environment."""

    def attack() -> str:
        environment = changed(variables)
        extra = (
            ["-p", f"output:={choice.folder}/bag_{time.time_ns()}"] if node == "recorder" else []
        )
        words = [sys.executable, "-m", NODES[node], "--ros-args", *extra, *options]
        log = choice.folder / "node.log"
        with log.open("wb") as stream:
            process = subprocess.Popen(
                ["/bin/bash", "-c", f'{prefix}; exec "$@"', "bash", *words],
                stdout=stream,
                stderr=stream,
                env=environment,
                start_new_session=True,
            )
        until = time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < until:
            if "ready" in log.read_text("utf-8", "replace") or "stdout" in prefix:
                break
            time.sleep(0.1)
        ended = process.poll()
        if ended is None:
            process.send_signal(signal.SIGINT)
        try:
            code = process.wait(60.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return "does not end after SIGINT"
        return judge(log.read_text("utf-8", "replace"), code, has_ended=ended is not None)

    return attack


def changed(variables: Mapping[str, str | None]) -> dict[str, str]:
    """Return the environment of nodes with some variables changed or removed."""
    environment = ros_environment() | {"FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILES)}
    for name, value in variables.items():
        environment.pop(name, None)
        if value is not None:
            environment[name] = value
    environment.setdefault("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    return environment


def judge(text: str, code: int, *, has_ended: bool) -> str:
    """Return what is wrong with the output and the end of a node; empty: nothing."""
    if "Traceback" in text:
        return f"traceback, exit code {code}: {text[-300:]}"
    if has_ended and code not in (1, 2, WRONG_MIDDLEWARE):
        return f"exit code {code}: {text[-300:]}"
    errors = [line for line in text.splitlines() if line.startswith("error: ")]
    if has_ended and len(errors) != 1 and code != WRONG_MIDDLEWARE:
        return f"{len(errors)} error lines: {text[-300:]}"
    return ""


def interrupted(number: int, delay: float) -> str:
    """Interrupt a node while it starts; return what is wrong with its end."""
    words = [sys.executable, "-m", NODES["controller"], "--ros-args"]
    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=ros_environment()
    )
    time.sleep(delay)
    process.send_signal(number)
    try:
        text, _ = process.communicate(timeout=60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        return "does not end"
    is_ours = "_node" in text  # before that, the interpreter itself is starting
    return f"traceback: {text[-300:]}" if "Traceback" in text and is_ours else ""
