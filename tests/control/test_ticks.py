"""The account of ticks: late ones, those that were left out, and states that are owed an answer."""

import pytest

from ampc_ros.supervision.ticks import Ticks

MS = 1_000_000
PERIOD_NS = 10 * MS


@pytest.mark.parametrize("late_ns", [0, 1, 4 * MS, PERIOD_NS - 1])
def test_lateness_is_the_time_since_the_tick_was_due(late_ns: int) -> None:
    ticks = Ticks(0.01)
    for tick in range(1, 5):
        assert ticks.begin(tick * PERIOD_NS + late_ns, PERIOD_NS - late_ns) == 0
        assert ticks.lateness_ns == late_ns
    assert ticks.missed == 0


@pytest.mark.parametrize("left_out", [1, 2, 7])
def test_ticks_that_the_timer_leaves_out_are_missed(left_out: int) -> None:
    ticks = Ticks(0.01)
    ticks.begin(PERIOD_NS, PERIOD_NS)
    late_ns = 3 * MS
    now_ns = (2 + left_out) * PERIOD_NS + late_ns
    assert ticks.begin(now_ns, PERIOD_NS - late_ns) == left_out
    assert ticks.missed == left_out


def test_time_that_goes_back_or_starts_anew_leaves_no_tick_out() -> None:
    ticks = Ticks(0.01)
    ticks.begin(100 * PERIOD_NS, PERIOD_NS)
    assert ticks.begin(PERIOD_NS, PERIOD_NS) == 0
    ticks.restart()
    assert ticks.begin(500 * PERIOD_NS, PERIOD_NS) == 0
    assert ticks.missed == 0


def test_a_tick_is_missed_only_where_the_next_one_finds_nothing_either() -> None:
    ticks = Ticks(0.01)
    assert not ticks.defer_to_next_state()
    assert ticks.missed == 0
    assert ticks.defer_to_next_state()
    assert ticks.defer_to_next_state()
    assert ticks.missed == 2
    ticks.is_deferred = False
    assert not ticks.defer_to_next_state()
    assert ticks.missed == 2


def test_a_new_start_owes_nothing() -> None:
    ticks = Ticks(0.01)
    ticks.defer_to_next_state()
    ticks.restart()
    assert not ticks.defer_to_next_state()
    assert ticks.missed == 0
