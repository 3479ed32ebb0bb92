"""Signals that end a node, in every phase of its life.

SIGHUP arrives when a terminal or an ssh connection is closed, SIGQUIT is sent by a key, too. Both
end a node as SIGINT and SIGTERM do: with its final messages, and exit code 0.
"""

import os
import re
import signal
import sys
from collections.abc import Callable
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a node."""
NODE_PROGRAM = re.compile(
    r"^(ampc_msgs_config|ampc_ros|sim_vehicle|launch_scripts)\.nodes\.\w+$"
    r"|/lib/(ampc_msgs_config|ampc_ros|sim_vehicle|launch_scripts)/\w+$"
    r"|/nodes/\w+_node\.py$"
)
"""Arguments of an interpreter that runs a node: module, entry point or file."""


def handle_ending_signals(handler: Callable[[int, Any], object]) -> None:
    """Install a handler for all signals that end a node; `nohup` keeps its effect."""
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


def end_while_importing() -> None:
    """Exit at once and without a traceback if a signal arrives while a node is being imported.

    Does nothing in a process that only imports the module of a node.
    """
    if any(NODE_PROGRAM.search(argument) for argument in sys.orig_argv[1:4]):
        handle_ending_signals(lambda *_: os._exit(0))
