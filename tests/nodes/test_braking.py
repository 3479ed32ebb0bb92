"""A requested stop: braking gently from the speed of the car, and going on gently."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.nodes.braking import COMFORTABLE, OLD, Braking, StopRequests

TICK_NS = NANOSECONDS // 50


def state(tick: int, v_x: float = 12.0) -> VehicleState:
    """Return a state."""
    return VehicleState(tick * TICK_NS, 0.0, 0.0, 0.0, v_x, 0.0, 0.0)


def test_without_a_request_the_plan_holds() -> None:
    braking = Braking()
    assert [braking.limited(v, state(int(v)), stop=False) for v in (9.0, 30.0, 0.0)] == [9, 30, 0]


def test_a_requested_stop_brakes_from_the_speed_of_the_car_to_a_standstill() -> None:
    braking = Braking()
    speeds = [braking.limited(20.0, state(k), stop=True) for k in range(400)]
    assert speeds[0] == 12.0
    steps = [COMFORTABLE * TICK_NS / NANOSECONDS] * 299
    assert [a - b for a, b in pairwise(speeds[:300])] == pytest.approx(steps)
    assert set(speeds[301:]) == {0.0}


def test_a_plan_that_is_slower_anyway_holds_while_braking() -> None:
    braking = Braking()
    braking.limited(20.0, state(0), stop=True)
    assert braking.limited(3.0, state(1), stop=True) == 3.0


def test_when_the_request_is_taken_back_the_speed_rises_to_the_plan_and_is_free_again() -> None:
    braking = Braking()
    for tick in range(101):
        low = braking.limited(20.0, state(tick), stop=True)
    speeds = [braking.limited(20.0, state(101 + k), stop=False) for k in range(400)]
    step = COMFORTABLE * TICK_NS / NANOSECONDS
    assert speeds[0] == pytest.approx(low + step)
    assert max(b - a for a, b in pairwise(speeds)) == pytest.approx(step)
    assert speeds[-1] == 20.0
    assert braking.most == math.inf


def test_a_standing_or_rolling_back_car_is_asked_to_stand() -> None:
    assert Braking().limited(20.0, state(0, v_x=-0.3), stop=True) == 0.0


def test_a_clock_that_goes_back_does_not_speed_up() -> None:
    braking = Braking()
    braking.limited(20.0, state(100), stop=True)
    assert braking.limited(20.0, state(50), stop=True) == 12.0


@given(st.lists(st.integers(0, 3), max_size=40))
def test_a_stop_is_in_force_while_the_latest_message_of_any_publisher_requests_it(
    turns: list[int],
) -> None:
    requests, published = StopRequests(), dict.fromkeys(range(4), 0)
    for publisher in turns:  # each publishes changes only, and begins with False
        published[publisher] += 1
        number = published[publisher]
        requests.receive(number % 2 == 0, number, 0.001)
        latest = [each > 0 and each % 2 == 0 for each in published.values()]
        assert requests.in_force == any(latest)


@pytest.mark.parametrize("later", [(1, 0.0), (2, 0.0), (5, 2 * OLD), (9, 0.0)])
def test_a_stop_is_not_taken_back_by_another_or_an_old_message(later: tuple[int, float]) -> None:
    requests = StopRequests()
    requests.receive(False, 3, 0.0)
    requests.receive(True, 4, 0.0)
    requests.receive(False, *later)
    assert requests.in_force
    requests.receive(False, 5, 0.0)
    assert not requests.in_force


def test_a_stop_remains_where_it_is_ambiguous_whose_message_takes_it_back() -> None:
    requests = StopRequests()
    for requested, number in ((True, 2), (False, 2), (False, 3)):  # the second one repeats itself
        requests.receive(requested, number, 0.0)
    assert requests.in_force


def test_a_repeated_request_is_taken_back_at_once() -> None:
    requests = StopRequests()
    for number in range(7, 12):
        requests.receive(True, number, 0.0)
    requests.receive(False, 12, 0.0)
    assert not requests.in_force
