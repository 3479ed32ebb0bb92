"""Progress of compilations: what is compiled now, and how long that still takes."""

import gc
import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib.resources import files
from typing import Any

from numba.core import event

from ampc_msgs_config.checked_cache import is_stored

INTERVAL_OF_LINES = 10.0
"""Time between two lines about the progress [s]."""
TIMES = files("ampc_msgs_config") / "config" / "compile_times.json"
"""Time that each function takes to compile on one machine, by what is compiled and by function."""

RARE_COLLECTION = 50_000, 10, 10
"""Thresholds of Python's garbage collector while a function is compiled."""
LASTING = ExitStack()
"""Contexts that last until the process ends."""


@contextmanager
def on_compilation(
    started: Callable[[], object], ended: Callable[[str, float], object] = lambda *_: None
) -> Iterator[None]:
    """Call back at the start and the end of each compilation inside the block.

    Args:
        started: Is called at the start.
        ended: Receives module and name of the function, and the processor time of its compilation
            without that of the functions that it calls [s].

    Note:
        `numba.core.event` is a private interface of numba: this is the only place that uses it.
    """
    inner = [0.0]  # processor times of the compilations inside each open one
    begins: list[float] = []

    class Listener(event.Listener):
        def on_start(self, _: Any) -> None:
            begins.append(time.thread_time())
            inner.append(0.0)
            started()

        def on_end(self, now: Any) -> None:
            duration = time.thread_time() - begins.pop()
            own = duration - inner.pop()
            inner[-1] += duration
            function = now.data["dispatcher"].py_func
            ended(f"{function.__module__}.{function.__qualname__}", own)

    with event.install_listener("numba:compile", Listener()):
        yield


def collect_rarely() -> None:
    """Let Python collect garbage rarely during each compilation of this process, from now on.

    A compiler creates millions of objects that stay. With its default thresholds, Python looks for
    garbage among them again and again.
    """
    depth, usual = 0, gc.get_threshold()

    def started() -> None:
        nonlocal depth, usual
        if depth == 0:
            usual = gc.get_threshold()
            gc.set_threshold(*RARE_COLLECTION)
        depth += 1

    def ended(*_: object) -> None:
        nonlocal depth
        depth -= 1
        if depth == 0:
            gc.set_threshold(*usual)

    LASTING.enter_context(on_compilation(started, ended))


class Estimate:
    """Remaining time of a compilation, from the times of its functions on another machine."""

    def __init__(self, times: Mapping[str, float]) -> None:
        """Start with nothing compiled.

        Args:
            times: Time of each function there, by its name [s].
        """
        self.open = dict(times)
        self.total = sum(times.values())
        self.done = 0.0

    def take(self, function: str) -> None:
        """Note that a function is compiled; one that is compiled again counts once."""
        self.done += self.open.pop(function, 0.0)

    def text(self, elapsed: float) -> str:
        """Return share and remaining time after a time of compiling [s]; empty: unknown."""
        if not self.done:
            return ""
        left = elapsed / self.done * (self.total - self.done)
        return f"{self.done / self.total:.0%}, about {left:.0f} s left"


def compile_times(what: str) -> dict[str, float]:
    """Return the time of each function of a compilation on one machine [s]; empty: unknown."""
    times: dict[str, dict[str, float]] = json.loads(TIMES.read_text(encoding="utf-8"))
    return times.get(what, {})


@contextmanager
def log_compilation(what: str, log: Callable[[str], object]) -> Iterator[None]:
    """Log start, progress and duration of a compilation inside the block; nothing without one.

    Args:
        what: Name of what is compiled, for the user.
        log: Receives the lines.
    """
    begin: list[float] = []
    shown: list[float] = []
    estimate = Estimate({})

    def start() -> None:
        nonlocal estimate
        if begin:
            return
        times = compile_times(what).items()
        estimate = Estimate({name: each for name, each in times if not is_stored(name)})
        begin.append(time.monotonic())
        shown.append(begin[0])
        about = f", about {estimate.total:.0f} s" if estimate.total else ""
        log(f"compiling the {what} (once after an update{about}) ...")

    def advance(function: str, _: float) -> None:
        estimate.take(function)
        now = time.monotonic()
        if now - shown[-1] >= INTERVAL_OF_LINES:
            shown.append(now)
            for name in filter(is_stored, tuple(estimate.open)):  # by another process
                estimate.take(name)
            text = estimate.text(now - begin[0]) or f"{now - begin[0]:.0f} s"
            log(f"compiling the {what}: {text}")

    with on_compilation(start, advance):
        yield
    if begin:
        log(f"compiled the {what} in {time.monotonic() - begin[0]:.0f} s")


collect_rarely()
