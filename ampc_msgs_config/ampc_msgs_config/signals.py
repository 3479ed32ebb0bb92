"""Signals that end a node, in every phase of its life.

SIGHUP arrives when a terminal or an ssh connection is closed, SIGQUIT is sent by a key, too. Both
end a node as SIGINT and SIGTERM do: with its final messages, and exit code 0.
"""

import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that end a node."""
RETRY = 0.01
"""Time until an interruption is tried again [s]."""


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
