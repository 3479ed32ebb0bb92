"""When a controller ticks: on a timer in real time, or once per state in lock-step; without ROS."""

from collections import deque
from enum import Enum

from ampc_msgs_config.types import NANOSECONDS, TickRecord, VehicleState
from ampc_ros.supervision.supervisor import Supervisor

IN_STEP = (0.9, 1.2)
"""Mean time between states that come at the rate of the controller [periods]; some may be lost."""
LONGEST_WAIT = 1.5
"""Age of the last command up to which such a state may be late [periods]. It may come just before
and just after the calls of the timer in turn."""
CLOSEST_STATES = 0.4
"""Shortest time between two such states [periods]; faster states after a silence come closer."""
INTERVALS = 8
"""Number of the times between states that are averaged."""


class Action(Enum):
    """What an input or the timer calls for."""

    WAIT = 0
    TICK = 1
    REPEAT = 2
    """Publish the newest command once more."""


class TickPolicy:
    """Decides when a supervisor ticks, and counts missed ticks.

    In real time, states at the rate of the controller are answered when they arrive, whatever their
    phase and the drift of their clock. Other states are answered by the next call of the timer.

    A tick without a new state is deferred: the next state is answered at once. A tick is missed
    where that state does not come before the next tick either, or where the timer left the tick
    out. At the rate of the controller, the last command must be older than LONGEST_WAIT, too. The
    last state is then continued by the model, where it can be predicted; with odometry slower than
    the controller, all ticks between two states are. A state that is late is answered without a new
    one.

    In lock-step every state is answered once; the same state again repeats the same command.
    """

    def __init__(self, supervisor: Supervisor, *, lock_step: bool = False) -> None:
        """Wait for the first state."""
        self.supervisor, self.lock_step = supervisor, lock_step
        self.record: TickRecord | None = None
        """Newest tick since the last restart."""
        self.missed = 0
        """Number of missed ticks."""
        self.left_out = 0
        """Ticks that the timer left out before the newest one."""
        self.lateness_ns = 0
        """Delay of the newest tick [ns]."""
        self._period_ns = round(supervisor.period * NANOSECONDS)
        self._is_deferred = self._is_continued = self._is_slow = False
        self._due_ns: int | None = None
        self._ticked_ns = 0
        self._stamps: deque[int] = deque(maxlen=INTERVALS + 1)

    def restart_timer(self) -> None:
        """Start a new timer: no tick is deferred, none was left out."""
        self._is_deferred = self._is_continued = self._is_slow = False
        self._due_ns = None

    @property
    def is_answered(self) -> bool:
        """Whether the newest state has its command."""
        answered_ns = self.record.command.stamp_ns if self.record else None
        return answered_ns == self.supervisor.newest_ns

    @property
    def is_in_step(self) -> bool:
        """Whether states come at the rate of the controller."""
        count = len(self._stamps) - 1
        if count < 1:
            return False
        if self._stamps[-1] - self._stamps[-2] < CLOSEST_STATES * self._period_ns:
            return False
        interval_ns = (self._stamps[-1] - self._stamps[0]) / count
        low, high = IN_STEP
        return low * self._period_ns <= interval_ns <= high * self._period_ns

    def take_state(self, state: VehicleState, now_ns: int) -> bool:
        """Pass a state to the supervisor; a restart of the controller restarts the policy, too.

        Returns:
            Whether the controller was restarted.

        Raises:
            ValueError: The state is rejected.
        """
        if self.lock_step and state.stamp_ns == self.supervisor.newest_ns:
            return False
        restarted = self.supervisor.take_state(state, state.stamp_ns if self.lock_step else now_ns)
        if restarted:
            self.restart_timer()
            self.record = None
            self._stamps.clear()
        if self.supervisor.newest_ns not in self._stamps:
            self._stamps.append(self.supervisor.newest_ns)
        return restarted

    def on_input(self) -> Action:
        """Return what to do after a state; in lock-step also after a path."""
        if self.lock_step:
            return Action.REPEAT if self.is_answered else Action.TICK
        is_due = self._is_deferred or (self.is_in_step and not self.is_answered)
        return Action.TICK if is_due else Action.WAIT

    def on_timer(self, now_ns: int, left_ns: int) -> Action:
        """Return what to do at a call of the timer.

        Args:
            now_ns: Time of the node's clock [ns].
            left_ns: Time to the next call, in (0, period] [ns].
        """
        self._count_left_out(now_ns, left_ns)
        if not self.is_answered or self.supervisor.is_state_late(now_ns):
            return Action.TICK
        is_recent = 0 < now_ns - self._ticked_ns <= LONGEST_WAIT * self._period_ns
        is_overdue = self._is_deferred and not (is_recent and self.is_in_step)
        is_continued = is_overdue or self._is_continued or self._is_slow
        self.missed += is_continued
        if is_continued and self.supervisor.can_predict(now_ns):
            self._is_continued = True
            return Action.TICK
        self._is_deferred = True
        return Action.WAIT

    def _count_left_out(self, now_ns: int, left_ns: int) -> None:
        self.lateness_ns = self._period_ns - left_ns
        before, self._due_ns = self._due_ns, now_ns - self.lateness_ns
        self.left_out = 0
        if before is not None and self._due_ns >= before:
            self.left_out = max(round((self._due_ns - before) / self._period_ns) - 1, 0)
        self.missed += self.left_out

    def tick(self, now_ns: int) -> TickRecord | None:
        """Tick the supervisor; None before the first valid state and path.

        Args:
            now_ns: Time of the node's clock; in lock-step the stamp of the state is used [ns].
        """
        if not self.supervisor.is_ready:
            return None
        self._is_deferred, self._ticked_ns = False, now_ns
        if not self.is_answered:
            self._is_slow = self._is_continued and not self.is_in_step
            self._is_continued = False
        if self.lock_step:
            self.record = self.supervisor.tick(self.supervisor.newest_ns, self.supervisor.period)
        else:
            self.record = self.supervisor.tick(now_ns)
        return self.record
