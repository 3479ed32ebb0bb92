"""Signals that end a node, in every phase of its life.

SIGHUP arrives when a terminal or an ssh connection is closed, SIGQUIT is sent by a key, too. Both
end a node as SIGINT and SIGTERM do: with its final messages, and exit code 0.
"""

import os
import re
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a node."""
SYSTEM_ERRORS = (ImportError, MemoryError, OSError, SystemError)
"""Exceptions that a lack of memory, threads or files causes, also while modules are imported."""
RETRY = 0.01
"""Time until an interruption is tried again [s]."""
NODE_PROGRAM = re.compile(
    r"^(ampc_msgs_config|ampc_ros|sim_vehicle|launch_scripts)\.nodes\.\w+_node$"
    r"|/lib/(ampc_msgs_config|ampc_ros|sim_vehicle|launch_scripts)/\w+$"
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


def end_while_importing() -> None:
    """Exit at once and without a traceback if a signal arrives while a node is being imported.

    A lack of memory or threads ends it with one line. Does nothing in a process that only imports
    the module of a node.
    """
    if any(NODE_PROGRAM.search(argument) for argument in sys.orig_argv[1:4]):
        handle_ending_signals(lambda *_: os._exit(0))
        sys.excepthook = report_in_one_line


def report_in_one_line(kind: type[BaseException], error: BaseException, trace: Any) -> None:
    """Print an exception in one line where it is one of the system, not of the code."""
    if issubclass(kind, SYSTEM_ERRORS) or kind.__name__ == "RCLError":
        line = " ".join(f"{kind.__name__}: {error}".split())
        print(f"error: {line}", file=sys.stderr, flush=True)
    else:
        sys.__excepthook__(kind, error, trace)
