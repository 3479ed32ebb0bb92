"""When a tick happens: deferred, left out, missed, after a restart, and in lock-step."""

from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.tick_policy import INTERVALS, LONGEST_WAIT, Action, TickPolicy
from tests.supervised import made_for

MS = 1_000_000
PERIOD_NS = 10 * MS
LATE_NS = 25 * MS
ROAD = np.array([(x, 0.0) for x in np.arange(0.0, 400.0, 5.0)])


class Stub:
    """A supervisor that accepts all states; a stamp that goes back restarts it."""

    period = 0.01

    def __init__(self, longest_ns: int = 0) -> None:
        """Wait for the first state; `longest_ns` is the longest prediction."""
        self.longest_ns = longest_ns
        self.newest_ns, self.has_path = -1, True
        self.ticks: list[tuple[int, int]] = []
        """Stamp of the state and time of each tick."""

    @property
    def is_ready(self) -> bool:
        """Whether there are a state and a path."""
        return self.newest_ns >= 0 and self.has_path

    def take_state(self, state: VehicleState, now_ns: int) -> bool:
        """Accept a state."""
        goes_back = state.stamp_ns < self.newest_ns
        self.newest_ns = state.stamp_ns
        return goes_back

    def is_state_late(self, now_ns: int) -> bool:
        """Whether the state is older than LATE_NS."""
        return self.newest_ns >= 0 and now_ns - self.newest_ns > LATE_NS

    def can_predict(self, now_ns: int) -> bool:
        """Whether the state can be predicted."""
        return 0 < now_ns - self.newest_ns <= self.longest_ns

    def tick(self, now_ns: int, elapsed: float | None = None) -> Any:
        """Record a tick."""
        self.ticks.append((self.newest_ns, now_ns))
        command = type("Command", (), {"stamp_ns": self.newest_ns})
        return type("Record", (), {"command": command})


def policy_of(stub: Stub, *, lock_step: bool = False) -> TickPolicy:
    """Return the policy of a stub."""
    return TickPolicy(cast(Supervisor, stub), lock_step=lock_step)


def state(stamp_ns: int) -> VehicleState:
    """Return a state with a stamp."""
    return VehicleState(stamp_ns, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0)


def answered(longest_ns: int = 0) -> tuple[Stub, TickPolicy]:
    """Return a policy whose newest state, of time 0, has its command."""
    stub = Stub(longest_ns)
    policy = policy_of(stub)
    policy.take_state(state(0), 0)
    policy.tick(0)
    return stub, policy


@pytest.mark.parametrize("late_ns", [0, 1, 4 * MS, PERIOD_NS - 1])
def test_lateness_is_the_time_since_the_tick_was_due(late_ns: int) -> None:
    policy = policy_of(Stub())
    assert policy.lateness_ns == 0
    for tick in range(1, 5):
        policy.on_timer(tick * PERIOD_NS + late_ns, PERIOD_NS - late_ns)
        assert (policy.left_out, policy.lateness_ns) == (0, late_ns)
    assert policy.missed == 0


@pytest.mark.parametrize("left_out", [1, 2, 7])
def test_ticks_that_the_timer_leaves_out_are_missed(left_out: int) -> None:
    policy = policy_of(Stub())
    policy.on_timer(PERIOD_NS, PERIOD_NS)
    late_ns = 3 * MS
    policy.on_timer((2 + left_out) * PERIOD_NS + late_ns, PERIOD_NS - late_ns)
    assert policy.left_out == policy.missed == left_out
    policy.on_timer((3 + left_out) * PERIOD_NS, PERIOD_NS)
    assert (policy.left_out, policy.missed) == (0, left_out)


def test_time_that_goes_back_or_a_new_timer_leaves_no_tick_out() -> None:
    policy = policy_of(Stub())
    policy.on_timer(100 * PERIOD_NS, PERIOD_NS)
    policy.on_timer(PERIOD_NS, PERIOD_NS)
    policy.restart_timer()
    policy.on_timer(500 * PERIOD_NS, PERIOD_NS)
    assert (policy.left_out, policy.missed) == (0, 0)


def test_a_tick_is_missed_only_where_the_next_one_has_no_new_state_either() -> None:
    stub, policy = answered()
    for tick, missed in ((1, 0), (2, 1)):
        assert policy.on_timer(tick * PERIOD_NS, PERIOD_NS) is Action.WAIT
        assert policy.missed == missed
    policy.take_state(state(2 * PERIOD_NS), 2 * PERIOD_NS)
    assert policy.on_input() is Action.TICK
    policy.tick(2 * PERIOD_NS)
    assert policy.on_timer(3 * PERIOD_NS, PERIOD_NS) is Action.WAIT
    assert policy.missed == 1
    assert stub.ticks[-1] == (2 * PERIOD_NS, 2 * PERIOD_NS)


def test_a_new_timer_has_no_deferred_tick() -> None:
    _, policy = answered()
    policy.on_timer(PERIOD_NS, PERIOD_NS)
    policy.restart_timer()
    assert policy.on_input() is Action.WAIT
    assert policy.on_timer(2 * PERIOD_NS, PERIOD_NS) is Action.WAIT
    assert policy.missed == 0


def test_a_late_state_is_answered_without_a_new_one() -> None:
    _, policy = answered()
    actions = [policy.on_timer(tick * PERIOD_NS, PERIOD_NS) for tick in (1, 2, 3)]
    assert actions == [Action.WAIT, Action.WAIT, Action.TICK]


@pytest.mark.parametrize("periods", [2, 3, 5])
def test_between_slow_states_every_tick_is_answered_with_the_model(periods: int) -> None:
    stub, policy = answered(10 * PERIOD_NS)
    for tick in range(1, 10 * periods):
        now_ns = tick * PERIOD_NS
        if tick % periods == 0:
            policy.take_state(state(now_ns), now_ns)
            if policy.on_input() is Action.TICK:
                policy.tick(now_ns)
                continue
        if policy.on_timer(now_ns, PERIOD_NS) is Action.TICK:
            policy.tick(now_ns)
    times = [now_ns // PERIOD_NS for _, now_ns in stub.ticks]
    if periods == 2:  # each state is waited for
        assert times == list(range(0, 20, 2))
    else:  # the first one only
        assert times == [0, *range(2, 10 * periods)]
    assert all(now_ns - stamp_ns < periods * PERIOD_NS for stamp_ns, now_ns in stub.ticks)


def test_a_prediction_that_is_too_long_waits_for_a_state() -> None:
    stub, policy = answered(2 * PERIOD_NS)
    assert policy.on_timer(PERIOD_NS, PERIOD_NS) is Action.WAIT
    assert policy.on_timer(2 * PERIOD_NS, PERIOD_NS) is Action.TICK
    policy.tick(2 * PERIOD_NS)
    assert policy.on_timer(2 * PERIOD_NS + 1, PERIOD_NS - 1) is Action.WAIT
    assert policy.missed == 2
    assert stub.ticks == [(0, 0), (0, 2 * PERIOD_NS)]


def test_after_one_lost_state_the_next_ones_are_waited_for_again() -> None:
    _, policy = answered(10 * PERIOD_NS)
    policy.on_timer(PERIOD_NS, PERIOD_NS)
    assert policy.on_timer(2 * PERIOD_NS, PERIOD_NS) is Action.TICK
    policy.tick(2 * PERIOD_NS)
    for tick in (3, 4):
        policy.take_state(state(tick * PERIOD_NS), tick * PERIOD_NS)
        assert policy.on_timer(tick * PERIOD_NS, PERIOD_NS) is Action.TICK
        policy.tick(tick * PERIOD_NS)
    assert policy.on_timer(5 * PERIOD_NS, PERIOD_NS) is Action.WAIT
    policy.take_state(state(5 * PERIOD_NS), 5 * PERIOD_NS + 1)
    assert policy.on_input() is Action.TICK


TICKS = 2000


def drive(
    drift: float, phase: float, jitter: float, rate: float = 1.0, lost: int = 10 * TICKS
) -> tuple[TickPolicy, list[int], list[int]]:
    """Drive for 20 s with states from a car with another clock.

    Args:
        drift: Of the period of the states.
        phase: Of the states against the timer [periods].
        jitter: Standard deviation of the delay of messages [s].
        rate: States per tick.
        lost: Every such state does not arrive.

    Returns:
        Policy, times of the ticks [ns], age of the state at each tick [ns].
    """
    rng, stub = np.random.default_rng(3), Stub(3 * NANOSECONDS)
    policy, ticks, ages = policy_of(stub), list[int](), list[int]()
    due = NANOSECONDS + np.arange(TICKS) * PERIOD_NS
    called = due + rng.integers(0, MS // 2, TICKS)
    numbers = np.arange(1, int((1.1 - min(drift, 0.0)) * rate * TICKS))
    sent = (NANOSECONDS + (numbers * (1.0 + drift) / rate + phase) * PERIOD_NS).astype(int)
    delays = (np.abs(rng.normal(0.0, jitter, len(sent))) * NANOSECONDS).astype(int)
    received = np.maximum.accumulate(sent + delays)
    events = [(*each, True) for each in zip(received.tolist(), sent.tolist(), strict=True)]
    del events[lost - 1 :: lost]
    events += [(*each, False) for each in zip(called.tolist(), due.tolist(), strict=True)]
    for now_ns, of_ns, is_state in sorted(each for each in events if each[0] <= called[-1]):
        if is_state:
            policy.take_state(state(of_ns), now_ns)
            action = policy.on_input()
        else:
            action = policy.on_timer(now_ns, PERIOD_NS - (now_ns - of_ns))
        if action is Action.TICK and policy.tick(now_ns):
            ticks.append(now_ns)
            ages.append(now_ns - stub.newest_ns)
    return policy, ticks, ages


@pytest.mark.parametrize("phase", [0.0, 0.02, 0.5, 0.98])
@pytest.mark.parametrize("drift", [0.0, 1e-4, 1e-2, -1e-2])
@pytest.mark.parametrize("jitter", [1e-4, 1e-3])
def test_no_tick_is_missed_and_no_state_waits_at_any_phase_and_drift(
    phase: float, drift: float, jitter: float
) -> None:
    policy, ticks, ages = drive(drift, phase, jitter)
    assert policy.missed == 0
    assert max(ages[1:]) < MS // 2 + 5.0 * jitter * NANOSECONDS
    assert max(np.diff(ticks[2:])) < LONGEST_WAIT * PERIOD_NS


@pytest.mark.parametrize("phase", [0.0, 0.02, 0.5, 0.98])
def test_a_lost_state_costs_one_tick_at_most(phase: float) -> None:
    policy, ticks, ages = drive(0.0, phase, 1e-4, lost=100)
    assert policy.missed <= TICKS / 100
    assert max(ages) <= 3 * PERIOD_NS
    assert max(np.diff(ticks[2:])) <= (1.0 + LONGEST_WAIT) * PERIOD_NS


@pytest.mark.parametrize(("rate", "drift"), [(2.0, 0.0), (5.0, 1e-3), (0.5, 0.0)])
def test_states_at_another_rate_leave_the_ticks_to_the_timer(rate: float, drift: float) -> None:
    policy, ticks, _ = drive(drift, 0.3, 1e-4, rate)
    assert not policy.is_in_step
    assert len(ticks) == pytest.approx(TICKS, abs=5)
    assert max(np.diff(ticks[5:])) < 1.1 * PERIOD_NS


@pytest.mark.parametrize("silence", [3, 5, 7, 9])
def test_fast_states_after_a_silence_are_not_answered_one_by_one(silence: int) -> None:
    stub, policy = answered()
    begin_ns = silence * PERIOD_NS
    policy.take_state(state(begin_ns), begin_ns)
    policy.on_input()
    policy.tick(begin_ns)
    for number in range(1, 20):
        now_ns = begin_ns + number * PERIOD_NS // 5
        policy.take_state(state(now_ns), now_ns)
        assert policy.on_input() is Action.WAIT
    assert len(stub.ticks) == 2


def test_a_restart_forgets_the_command_and_the_deferred_tick() -> None:
    _, policy = answered()
    policy.take_state(state(50), 50)
    policy.tick(50)
    policy.on_timer(PERIOD_NS, PERIOD_NS)
    assert policy.take_state(state(0), 2 * PERIOD_NS)
    assert policy.record is None
    assert policy.on_input() is Action.WAIT
    assert policy.on_timer(2 * PERIOD_NS, PERIOD_NS) is Action.TICK


def test_a_tick_that_is_not_possible_yet_stays_deferred() -> None:
    stub, policy = answered()
    policy.on_timer(PERIOD_NS, PERIOD_NS)
    stub.has_path = False
    policy.take_state(state(PERIOD_NS), PERIOD_NS)
    assert policy.on_input() is Action.TICK
    assert policy.tick(PERIOD_NS) is None
    assert policy.on_input() is Action.TICK


def test_in_lock_step_each_state_is_answered_once_and_then_repeated() -> None:
    stub = Stub()
    policy = policy_of(stub, lock_step=True)
    for stamp_ns in (0, 5, 5, 9):
        policy.take_state(state(stamp_ns), 10**9)
        if policy.on_input() is Action.TICK:
            policy.tick(10**9)
        assert policy.on_input() is Action.REPEAT
    assert stub.ticks == [(0, 0), (5, 5), (9, 9)]


events = st.lists(
    st.sampled_from(["state", "timer", "state", "timer", "old", "back", "path", "no path"]),
    max_size=60,
)


@given(sequence=events, pauses=st.lists(st.integers(0, 2 * PERIOD_NS), min_size=60, max_size=60))
@pytest.mark.parametrize("longest_ns", [0, 2 * PERIOD_NS, 20 * PERIOD_NS])
@settings(max_examples=200, deadline=None, derandomize=True)
def test_ticks_are_those_of_the_rules_of_the_node(
    longest_ns: int, sequence: list[str], pauses: list[int]
) -> None:
    stub, model = Stub(longest_ns), Stub(longest_ns)
    policy = policy_of(stub)
    answered_ns, is_deferred, missed, now_ns = None, False, 0, 0
    continued = {"this": False, "last": False}
    stamps: list[int] = []
    ticked_ns = 0

    def in_step() -> bool:
        newest = stamps[-INTERVALS - 1 :]
        if len(newest) > 1 and newest[-1] - newest[-2] < 0.4 * PERIOD_NS:
            return False
        span = (newest[-1] - newest[0]) / PERIOD_NS if newest else 0.0
        return 0.9 * (len(newest) - 1) <= span <= 1.2 * (len(newest) - 1) and len(newest) > 1

    def step() -> None:
        nonlocal answered_ns, is_deferred, ticked_ns
        if model.is_ready:
            is_deferred, ticked_ns = False, now_ns
            if answered_ns != model.newest_ns:
                continued.update(last=continued["this"] and not in_step(), this=False)
            model.tick(now_ns)
            answered_ns = model.newest_ns

    for event, pause in zip(sequence, pauses, strict=False):
        now_ns += pause
        if event in ("path", "no path"):
            stub.has_path = model.has_path = event == "path"
        elif event == "timer":
            missed_before = policy.missed
            if policy.on_timer(now_ns, PERIOD_NS) is Action.TICK:
                policy.tick(now_ns)
            if answered_ns != model.newest_ns or model.is_state_late(now_ns):
                step()
            elif (
                is_deferred and not (in_step() and 0 < now_ns - ticked_ns <= 1.5 * PERIOD_NS)
            ) or any(continued.values()):
                missed += 1
                if model.can_predict(now_ns):
                    continued["this"] = True
                    step()
                else:
                    is_deferred = True
            else:
                is_deferred = True
            missed += policy.left_out
            assert policy.missed >= missed_before
        else:
            stamp_ns = {"state": now_ns, "old": stub.newest_ns, "back": 0}[event]
            if stamp_ns < 0:
                continue
            policy.take_state(state(stamp_ns), now_ns)
            if policy.on_input() is Action.TICK:
                policy.tick(now_ns)
            if model.take_state(state(stamp_ns), now_ns):
                answered_ns, is_deferred = None, False
                continued.update(last=False, this=False)
                stamps.clear()
            if stamp_ns not in stamps[-INTERVALS - 1 :]:
                stamps.append(stamp_ns)
            if is_deferred or (in_step() and answered_ns != model.newest_ns):
                step()
        assert stub.ticks == model.ticks
    assert policy.missed == missed


def test_the_policy_drives_a_real_supervisor() -> None:
    supervisor = Supervisor(made_for())
    policy, period_ns = TickPolicy(supervisor), NANOSECONDS // 10
    supervisor.take_path(ROAD, NANOSECONDS, NANOSECONDS)
    assert policy.on_timer(NANOSECONDS, period_ns) is Action.TICK
    assert policy.tick(NANOSECONDS) is None
    for tick in range(1, 4):
        now_ns = NANOSECONDS + tick * period_ns
        new = VehicleState(now_ns, 20.0 + 0.9 * tick, 0.0, 0.0, 9.0, 0.0, 0.0)
        assert not policy.take_state(new, now_ns)
        assert policy.on_timer(now_ns, period_ns) is Action.TICK
        assert policy.tick(now_ns) is policy.record is not None
        assert policy.is_answered
