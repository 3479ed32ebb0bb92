"""The ticks of a controller in real time: how late each one is, and which never came."""

from ampc_msgs_config.types import NANOSECONDS


class Ticks:
    """Keeps account of a timer's calls and of the answers given.

    A tick that finds no new state is owed: the state that comes next is answered at once, so that
    car and controller at the same rate need not be in step. A tick is missed where that state did
    not come before the next tick either, or where the timer had to leave the tick out.
    """

    def __init__(self, period: float) -> None:
        """Begin an account of ticks every `period` [s]."""
        self.period_ns = round(period * NANOSECONDS)
        self.missed = 0
        self.lateness_ns = 0
        """Of the newest tick [ns]."""
        self.is_deferred = False
        self.due_ns: int | None = None

    def restart(self) -> None:
        """Go on from a new time: nothing is owed, nothing was left out."""
        self.is_deferred, self.due_ns = False, None

    def begin(self, now_ns: int, left_ns: int) -> int:
        """Note a tick; gives how many the timer has left out before it.

        Args:
            now_ns: Time now [ns].
            left_ns: Time to the next tick, in (0, period] [ns].
        """
        self.lateness_ns = self.period_ns - left_ns
        before, self.due_ns = self.due_ns, now_ns - self.lateness_ns
        if before is None or self.due_ns < before:
            return 0
        left_out = max(round((self.due_ns - before) / self.period_ns) - 1, 0)
        self.missed += left_out
        return left_out

    def defer_to_next_state(self) -> bool:
        """Note that there was no new state; tells whether the tick before is missed for good."""
        missed, self.is_deferred = self.is_deferred, True
        self.missed += missed
        return missed
