"""Messages that arrive under each kind of fault."""

import math
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.frames import wrap_angle
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from launch_scripts.faults.kinds import FAULT_KINDS
from launch_scripts.faults.messages import NODE, ODOM_INPUT, PATH, STEERING_INPUT, Message
from launch_scripts.faults.schedule import Fault, FaultSchedule, Injector

MS = 1_000_000
PERIOD_NS = 20 * MS
CLOCK_NS = 1000 * NANOSECONDS
START, DURATION = 1.0, 0.5
WINDOW = range(50, 75)
"""Indices of the messages sent during the fault."""
POINTS = np.column_stack((np.arange(0.0, 20.0), np.zeros(20)))


def state(i: int) -> VehicleState:
    """Return the i-th state of a car with heading 0.5 rad."""
    return VehicleState(0, 9.0 * 0.02 * i, 0.1 * i, 0.5, 9.0, 0.1, 0.02)


def sent(topic: str, i: int) -> Message:
    """Return the i-th message of a topic."""
    value: Any = {ODOM_INPUT: state(i), STEERING_INPUT: 0.001 * i, PATH: POINTS}[topic]
    return Message(topic, i * PERIOD_NS, CLOCK_NS + i * PERIOD_NS, value)


def arrived(kind: str, topic: str = ODOM_INPUT, seed: int = 3, **options: Any) -> list[Message]:
    """Send 100 messages in 2 s, with a fault from 1 s to 1.5 s; return the arrivals until 10 s."""
    fault = Fault(kind=kind, start=START, **({"duration": DURATION} | options))
    line = Injector(FaultSchedule((fault,), seed))
    for i in range(100):
        line.put(sent(topic, i))
    return line.due(10 * NANOSECONDS)


def of_window(messages: list[Message]) -> list[Message]:
    """Return the messages that arrived during the fault."""
    return [each for each in messages if each.arrival_ns // PERIOD_NS in WINDOW]


def others(messages: list[Message]) -> list[Message]:
    """Return the messages that arrived before or after the fault."""
    return [each for each in messages if each.arrival_ns // PERIOD_NS not in WINDOW]


UNTOUCHED = [sent(ODOM_INPUT, i) for i in range(100) if i not in WINDOW]
CHANGING = ("nan", "noise", "bias_position", "bias_heading", "bias_speed", "drift", "pose_jump",
            "freeze", "wrong_frame", "zero_quaternion", "stamp_jump", "clock_jump")  # fmt: skip


@pytest.mark.parametrize("kind", CHANGING)
def test_a_fault_changes_numbers_only_during_its_interval(kind: str) -> None:
    messages = arrived(kind)
    assert others(messages) == UNTOUCHED
    assert [each.arrival_ns for each in messages] == [i * PERIOD_NS for i in range(100)]
    for i, message in zip(WINDOW, of_window(messages), strict=True):
        same = message == sent(ODOM_INPUT, i)
        assert not same or (kind == "drift" and i == WINDOW[0])  # a drift starts at zero


def test_every_kind_has_valid_topics_and_an_amount_within_its_bounds() -> None:
    for name, kind in FAULT_KINDS.items():
        assert set(kind.topics) <= {ODOM_INPUT, STEERING_INPUT, PATH, NODE}, name
        assert (kind.change is None) == (kind.topics == (NODE,)), name
        if kind.amount:
            assert kind.amount.low <= kind.amount.default <= kind.amount.high, name
        assert not kind.sided or kind.amount, name


@pytest.mark.parametrize("topic", [ODOM_INPUT, STEERING_INPUT, PATH])
def test_a_seed_reproduces_the_messages_and_other_topics_are_unchanged(topic: str) -> None:
    for name, kind in FAULT_KINDS.items():
        once, again = arrived(name, topic), arrived(name, topic)
        assert repr(once) == repr(again), name
        if topic not in kind.topics:
            arrivals = [each.arrival_ns for each in once]
            assert arrivals == [i * PERIOD_NS for i in range(100)], name
            assert all(each.stamp_ns - each.arrival_ns == CLOCK_NS for each in once), name


@pytest.mark.parametrize("kind", ["drop", "silence"])
def test_dropped_messages_do_not_arrive(kind: str) -> None:
    assert arrived(kind) == UNTOUCHED


def test_half_of_the_messages_are_dropped_at_random() -> None:
    kept = {len(of_window(arrived("drop", seed=seed, amount=0.5))) for seed in range(20)}
    assert len(kept) > 3
    assert all(3 < n < 22 for n in kept)


def test_a_restarted_sender_is_silent_then_counts_stamps_from_zero_then_recovers() -> None:
    messages = arrived("restart", amount=0.1)
    assert others(messages) == UNTOUCHED
    assert [each.stamp_ns // MS for each in of_window(messages)] == [0, 20, 40, 60, 80]


def test_late_messages_keep_their_stamps() -> None:
    messages = arrived("delay", amount=0.15)
    late = [each for each in messages if each.arrival_ns + CLOCK_NS != each.stamp_ns]
    assert [each.arrival_ns + CLOCK_NS - each.stamp_ns for each in late] == [150 * MS] * len(WINDOW)
    assert [each.value for each in late] == [state(i) for i in WINDOW]


def test_jitter_keeps_the_order_and_reordering_does_not() -> None:
    def stamps(kind: str) -> list[int]:
        late = [each for each in arrived(kind) if each.value in [state(i) for i in WINDOW]]
        assert len(late) == len(WINDOW)
        most = 200 * MS + len(WINDOW) * MS
        assert all(0 <= each.arrival_ns + CLOCK_NS - each.stamp_ns <= most for each in late)
        return [each.stamp_ns for each in late]

    assert stamps("jitter") == sorted(stamps("jitter"))
    assert stamps("reorder") != sorted(stamps("reorder"))


def test_a_duplicate_follows_its_original() -> None:
    messages = arrived("duplicate", amount=0.005)
    assert len(messages) == 100 + len(WINDOW)
    twice = [each.stamp_ns for each in messages if each.value == state(60)]
    assert twice == [CLOCK_NS + 60 * PERIOD_NS] * 2


def test_held_messages_are_delivered_at_once_and_in_order() -> None:
    messages = arrived("hold")
    queue = [each for each in messages if each.value in [state(i) for i in WINDOW]]
    assert {each.arrival_ns for each in queue} == {1500 * MS}
    assert [each.value for each in queue] == [state(i) for i in WINDOW]


def test_a_burst_delivers_old_messages_at_once_before_a_new_one() -> None:
    messages = arrived("burst", amount=1000)
    assert len(messages) == 1100
    at_once = [each for each in messages if each.arrival_ns == 1000 * MS]
    assert len(at_once) == 1001
    assert at_once[-1] == sent(ODOM_INPUT, 50)
    assert [each.value for each in at_once[:51]] == [state(i % 50) for i in range(51)]


def test_a_repeated_message_keeps_its_stamp_and_a_frozen_pose_does_not() -> None:
    repeated, frozen = of_window(arrived("repeat")), of_window(arrived("freeze"))
    assert {each.stamp_ns for each in repeated} == {CLOCK_NS + 49 * PERIOD_NS}
    assert {each.value for each in repeated} == {state(49)}
    assert len({each.stamp_ns for each in frozen}) == len(WINDOW)
    assert {each.value[1:4] for each in frozen} == {state(49)[1:4]}


@pytest.mark.parametrize("field", VehicleState._fields[1:])
def test_every_field_can_become_nan(field: str) -> None:
    for message in of_window(arrived("nan", field=field)):
        broken = [name for name, value in message.value._asdict().items() if math.isnan(value)]
        assert broken == [field]


def test_a_bias_moves_the_pose_to_the_left_or_turns_it_or_adds_speed() -> None:
    for kind in ("bias_position", "pose_jump"):
        for i, message in zip(WINDOW, of_window(arrived(kind, amount=0.3)), strict=True):
            there, here = message.value, state(i)
            left = -(there.x - here.x) * math.sin(0.5) + (there.y - here.y) * math.cos(0.5)
            ahead = (there.x - here.x) * math.cos(0.5) + (there.y - here.y) * math.sin(0.5)
            assert (left, ahead) == pytest.approx((0.3, 0.0), abs=1e-12)
    turned = of_window(arrived("bias_heading", amount=3.0))[0].value
    assert turned.yaw == wrap_angle(3.5)
    assert of_window(arrived("bias_speed", amount=2.0))[0].value.v_x == 11.0


def test_a_drift_grows_steadily_and_jumps_back() -> None:
    messages = arrived("drift", amount=1.0)
    off = [math.hypot(m.value.x - state(i).x, m.value.y - state(i).y)
           for i, m in zip(WINDOW, of_window(messages), strict=True)]  # fmt: skip
    assert off == pytest.approx(np.arange(25) / 25, abs=1e-12)
    assert messages[75] == sent(ODOM_INPUT, 75)


def test_noise_has_the_requested_size_and_a_mirror_image() -> None:
    left = of_window(arrived("noise", amount=0.1, duration=0.5))
    right = of_window(arrived("noise", amount=-0.1, duration=0.5))
    for i, a, b in zip(WINDOW, left, right, strict=True):
        assert a.value.x == b.value.x
        assert a.value.y - state(i).y == pytest.approx(state(i).y - b.value.y)
        assert a.value.yaw - 0.5 == pytest.approx(0.5 - b.value.yaw)
    assert np.std([m.value.x - state(i).x for i, m in zip(WINDOW, left, strict=True)]) < 0.2


def test_frames_and_quaternions_can_be_invalid() -> None:
    assert {each.frame_id for each in of_window(arrived("wrong_frame"))} == {"odom"}
    assert {each.length for each in of_window(arrived("zero_quaternion"))} == {0.0}


@pytest.mark.parametrize("amount", [1.0, -1.0])
def test_stamps_jump_and_the_controllers_clock_only_where_all_clocks_do(amount: float) -> None:
    for kind, moves in (("stamp_jump", False), ("clock_jump", True)):
        for message in of_window(arrived(kind, amount=amount)):
            off = message.stamp_ns - message.arrival_ns - CLOCK_NS
            assert off == amount * NANOSECONDS
        line = Injector(FaultSchedule((Fault(kind=kind, start=1.0, duration=0.5, amount=amount),)))
        shown = [line.clock_ns(now_ns) - now_ns for now_ns in (0, 1000 * MS, 1499 * MS, 1500 * MS)]
        assert shown == [0, *([round(amount * NANOSECONDS) if moves else 0] * 2), 0]


def test_the_steering_sensor_can_have_a_bias_or_freeze() -> None:
    off = of_window(arrived("bias_steering", STEERING_INPUT, amount=0.05))
    assert [m.value for m in off] == pytest.approx([0.001 * i + 0.05 for i in WINDOW])
    assert {m.value for m in of_window(arrived("freeze_steering", STEERING_INPUT))} == {0.049}


def test_a_qp_fault_is_active_in_its_interval_without_any_message() -> None:
    line = Injector(FaultSchedule((Fault(kind="qp_fault", start=1.0, duration=0.5),)))
    there = [line.is_on("qp_fault", ms * MS) for ms in (999, 1000, 1499, 1500)]
    assert there == [False, True, True, False]


def path_under(kind: str, **options: Any) -> Any:
    """Return the first path that arrives during a fault."""
    return of_window(arrived(kind, PATH, **options))[0].value


def test_paths_can_be_moved_or_invalid() -> None:
    assert path_under("path_shift", amount=2.0) == pytest.approx(POINTS + np.array([0.0, 2.0]))
    assert np.ptp(path_under("path_step", amount=2.0)[:, 1]) == pytest.approx(2.0)
    zigzag = path_under("path_zigzag", amount=-1.0)
    assert zigzag[:, 1] == pytest.approx([0.0, -1.0] * 10)
    assert np.isnan(path_under("path_nan")).sum() == 1
    assert path_under("path_point").shape == (1, 2)
    assert path_under("path_empty").shape == (0, 2)
    assert not of_window(arrived("path_gone", PATH))
    assert not np.isnan(POINTS).any()


def test_another_fault_does_not_change_the_random_numbers_of_the_first() -> None:
    one = Fault(kind="noise", start=1.0, duration=0.5)
    other = Fault(kind="noise", start=1.6, duration=0.2)
    alone, both = Injector(FaultSchedule((one,), 3)), Injector(FaultSchedule((one, other), 3))
    for i in range(100):
        alone.put(sent(ODOM_INPUT, i))
        both.put(sent(ODOM_INPUT, i))
    assert of_window(alone.due(10**12)) == of_window(both.due(10**12))


def test_faults_at_the_same_time_act_one_after_the_other() -> None:
    faults = tuple(
        Fault(kind=kind, start=1.0, duration=0.5) for kind in ("bias_speed", "duplicate")
    )
    line = Injector(FaultSchedule(faults))
    for i in range(100):
        line.put(sent(ODOM_INPUT, i))
    messages = [each for each in line.due(10**12) if each.value.v_x == 11.0]
    assert len(messages) == 2 * len(WINDOW)


def test_no_message_arrives_before_its_time() -> None:
    line = Injector(FaultSchedule((Fault(kind="delay", start=0.0, duration=5.0, amount=0.1),)))
    line.put(sent(ODOM_INPUT, 1))
    assert line.due(120 * MS - 1) == []
    assert line.next_ns == 120 * MS
    assert len(line.due(120 * MS)) == 1
    assert line.next_ns == math.inf
