"""Processes that outlive their test: found by a variable of the environment that all inherit.

A process may start a session of its own, and its parent may have ended: neither its group nor its
parent identifies it. Its environment does.
"""

import os
import signal
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

MOST_ROUNDS = 100
"""Rounds in which processes are killed that may start others meanwhile."""
ROUND = 0.02
"""Wall time between two rounds [s]."""


def processes_with(variable: str) -> dict[int, str]:
    """Return the command lines of the processes that were started with a variable, by number."""
    entry, found = f"{variable}=".encode(), {}
    for folder in Path("/proc").iterdir():
        with suppress(OSError):  # it may end meanwhile, or belong to another user
            if folder.name.isdigit() and entry in (folder / "environ").read_bytes():
                command = (folder / "cmdline").read_bytes().decode(errors="replace")
                found[int(folder.name)] = command.replace("\0", " ").strip()
    return found


def parent_of(number: int) -> int:
    """Return the number of the parent of a process; 0 where the process has ended."""
    with suppress(OSError):
        status = Path(f"/proc/{number}/stat").read_text(encoding="utf-8", errors="replace")
        return int(status.rpartition(")")[2].split()[1])
    return 0


def kill_processes_with(variable: str) -> None:
    """Kill all processes that were started with a variable, and wait for their end."""
    for _ in range(MOST_ROUNDS):
        left = processes_with(variable)
        if not left:
            return
        kill_processes(left)
        time.sleep(ROUND)


def kill_processes(numbers: Iterable[int]) -> None:
    """Kill processes; some may have ended."""
    for number in numbers:
        with suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)
