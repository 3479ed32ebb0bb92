"""How a process ends: by signals in every phase of its life, or for a lack of a package.

SIGHUP arrives when a terminal or an ssh connection is closed, SIGQUIT is sent by a key, too. Both
end a node as SIGINT and SIGTERM do: with its final messages, and exit code 0. Nodes call
`end_while_importing`, commands `guard_command`, before they import anything that is not of the
standard library.
"""

import os
import re
import signal
import sys
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from types import FrameType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a node."""
RETRY = 0.01
"""Time until an interruption is tried again [s]."""
MISSING_PACKAGE = 2
"""Exit code where a package cannot be imported."""
AFTER_SIGINT = 128 + signal.SIGINT
"""Exit code of a command that SIGINT ends."""
SYSTEM_ERRORS = (ImportError, MemoryError, OSError, SystemError)
"""Exceptions that a lack of memory, threads or files causes, also while modules are imported."""
OWN_PACKAGES = ("ampc_msgs_config", "ampc_ros", "sim_vehicle", "launch_scripts")
ROS_PACKAGE = re.compile(
    r"rclpy|rpyutils|tf2_\w+|launch\w*|(ament|rosidl|rmw)_\w+|\w+_(msgs|interfaces|srvs)"
)
"""Names of packages that belong to ROS 2."""
SET_UP = "run `make setup` in the workspace once, then `source setup.bash`"
NODE_PROGRAM = re.compile(
    r"^(ampc_msgs_config|ampc_ros|sim_vehicle|launch_scripts)\.nodes\.\w+_node$"
    r"|/lib/((ampc_msgs_config|ampc_ros|sim_vehicle)/\w+|launch_scripts/injector)$"
    r"|/nodes/\w+_node\.py$"
)
"""Arguments of an interpreter that runs a node: module, entry point or file."""


def handle_ending_signals(handler: Callable[[int, Any], object]) -> None:
    """Install a handler for all signals that end a node; `nohup` keeps its effect."""
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def interrupt(frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, at once or as soon as it reaches the caller of the current frame.

    Note:
        LLVM calls back into Python while it compiles, and an exception in there is printed and
        lost.
    """
    outer = frame
    while outer:
        if outer.f_code.co_name.startswith("_raw_object_cache"):  # of llvmlite
            signal.signal(signal.SIGALRM, lambda _, later: interrupt(later))
            signal.setitimer(signal.ITIMER_REAL, RETRY)
            return
        outer = outer.f_back
    raise KeyboardInterrupt


def cancel_interruption() -> None:
    """Cancel an interruption that has not reached its caller yet."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def end_while_importing(nodes: str) -> None:
    """Prepare the import of a node: print its help, or let signals and missing packages end it.

    A signal ends the process at once and without a traceback. A missing package, or a lack of
    memory or threads, ends it with one line. Does nothing in a process that only imports the module
    of a node.

    Args:
        nodes: File `__init__.py` of the folder with the nodes.
    """
    program = next(filter(NODE_PROGRAM.search, sys.orig_argv[1:4]), "")
    if not program:
        return
    handle_ending_signals(lambda *_: os._exit(0))
    sys.excepthook = report_in_one_line
    if {"-h", "--help"} & set(takewhile(lambda word: word != "--ros-args", sys.argv[1:])):
        print_help(Path(nodes).with_name("help"), program)


def print_help(folder: Path, program: str) -> None:
    """Print the help of the node that a program runs, and exit; nothing if it is not there."""
    name = re.split(r"[./]", program.removesuffix(".py"))[-1].removesuffix("_node")
    for file in folder.glob(f"{name}*.txt"):
        print(file.read_text(encoding="utf-8"), end="")
        raise SystemExit(0)


def guard_command() -> None:
    """End a command in one line where a package is missing, and without a traceback after SIGINT.

    Before `main` runs, SIGINT ends the process at once; later it raises KeyboardInterrupt.
    """
    sys.excepthook = report_of_command
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt_command)


def interrupt_command(_: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt inside `main`; before it, exit."""
    outer = frame
    while outer and outer.f_code.co_name != "main":
        outer = outer.f_back
    if outer is None:
        os._exit(AFTER_SIGINT)
    interrupt(frame)


def report_in_one_line(kind: type[BaseException], error: BaseException, trace: Any) -> None:
    """Print an exception of a node in one line where it is one of the system, not of the code."""
    end_without_package(error)
    if issubclass(kind, SYSTEM_ERRORS) or kind.__name__ == "RCLError":
        line = " ".join(f"{kind.__name__}: {error}".split())
        print(f"error: {line}", file=sys.stderr, flush=True)
    else:
        sys.__excepthook__(kind, error, trace)


def report_of_command(kind: type[BaseException], error: BaseException, trace: Any) -> None:
    """Print an exception that ends a command; an interruption ends it silently."""
    if issubclass(kind, KeyboardInterrupt):
        raise SystemExit(AFTER_SIGINT)
    end_without_package(error)
    sys.__excepthook__(kind, error, trace)


def end_without_package(error: BaseException) -> None:
    """Print one line and exit if the error is that of a package that is not installed."""
    if isinstance(error, ModuleNotFoundError) and error.name:
        print(f"error: {missing_package(error.name)}", file=sys.stderr, flush=True)
        raise SystemExit(MISSING_PACKAGE)


def missing_package(module: str) -> str:
    """Return which package is missing where, and how to install it, in one sentence."""
    package = module.partition(".")[0]
    if package in OWN_PACKAGES:
        return f"{sys.executable} does not find {module!r} of this workspace: {SET_UP}"
    if ROS_PACKAGE.fullmatch(package):
        remedy = f"source /opt/ros/jazzy/setup.bash, or without ROS 2 {SET_UP}"
        return f"the ROS package {package!r} is missing for {sys.executable}: {remedy}"
    remedy = f"{SET_UP}, or `pip install -r lock/requirements.txt`"
    return f"the Python package {package!r} is missing for {sys.executable}: {remedy}"
