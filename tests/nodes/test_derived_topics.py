"""Transforms and pictures that a recorder derives from odometry."""

import math
from itertools import pairwise
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Bool, Float64
from visualization_msgs.msg import MarkerArray

from ampc_msgs_config import ros
from ampc_msgs_config.nodes.derived_topics import Derived, DerivedTopics
from ampc_msgs_config.nodes.other_cars import is_of_another_car
from ampc_msgs_config.nodes.scene import CAR_COLOUR, STOP_COLOUR
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from tests.bag_samples import sample

STATE = VehicleState(0, 3.0, 4.0, 0.5, 9.0, 0.0, 0.0)


def derived_topics(**changes: Any) -> DerivedTopics:
    """Return the topics of the paper's car."""
    return DerivedTopics("paper", -1.0, "", **{"transforms": True, "pictures": True, **changes})


def odometry(milliseconds: int, **changes: Any) -> bytes:
    """Return a serialised odometry at a time."""
    state = STATE._replace(stamp_ns=milliseconds * NANOSECONDS // 1000, **changes)
    return bytes(serialize_message(ros.odometry_message(state)))


def names(topics: DerivedTopics, data: bytes) -> list[str]:
    """Return the topics that follow from an odometry."""
    return [each.topic for each in topics.of(ros.ODOM, data)]


def picture(topics: DerivedTopics, milliseconds: int, **changes: Any) -> MarkerArray:
    """Return the picture that follows from an odometry."""
    data = topics.picture(odometry(milliseconds, **changes))
    assert data
    return deserialize_message(data, MarkerArray)


@pytest.mark.parametrize("period", [10, 37, 100, 250])
def test_pictures_are_at_least_a_fifth_of_a_second_apart(period: int) -> None:
    topics = derived_topics()
    times = [t for t in range(1000, 9000, period) if ros.MARKERS in names(topics, odometry(t))]
    gaps = [b - a for a, b in pairwise(times)]
    assert min(gaps) >= 200
    assert max(gaps) < 200 + max(period, 51)


def test_a_clock_that_goes_back_gives_a_picture_at_once() -> None:
    topics = derived_topics()
    assert ros.MARKERS in names(topics, odometry(9000))
    assert ros.MARKERS in names(topics, odometry(1000))


def test_the_static_transform_comes_once_and_again_in_a_recording_that_begins_anew() -> None:
    topics = derived_topics()
    first = [ros.TF_STATIC, ros.TF, ros.MARKERS]
    assert names(topics, odometry(1000)) == first
    assert names(topics, odometry(1100)) == [ros.TF]
    topics.begin()
    assert names(topics, odometry(1000)) == first


def test_what_is_recorded_is_not_derived() -> None:
    assert names(derived_topics(transforms=False), odometry(1)) == [ros.MARKERS]
    assert names(derived_topics(pictures=False), odometry(1)) == [ros.TF_STATIC, ros.TF]


def test_the_quantities_of_a_tick_are_its_debug_topics() -> None:
    values = [0.5 * i for i in range(len(ros.TICK_QUANTITIES))]
    tick = bytes(serialize_message(ros.tick_message(NANOSECONDS, values)))
    derived = list(derived_topics().of(ros.TICK, tick))
    assert {each.topic: deserialize_message(each.data, Float64).data for each in derived} == {
        topic: values[ros.TICK_QUANTITIES.index(name)]
        for topic, name in zip(ros.QUANTITIES, ros.DEBUG_QUANTITIES, strict=True)
    }
    assert derived[0].data == bytes(serialize_message(Float64(data=derived_value(derived[0]))))
    subscribed = derived_topics(recorded=ros.QUANTITIES[1:])
    assert [each.topic for each in subscribed.of(ros.TICK, tick)] == [ros.QUANTITIES[0]]
    assert list(derived_topics().of(ros.TICK, tick[:20])) == []


def derived_value(message: Derived) -> float:
    """Return the number of a message."""
    return float(deserialize_message(message.data, Float64).data)


def test_the_measured_angle_turns_the_front_wheels_and_the_commanded_one_without_it() -> None:
    topics = derived_topics()

    def angle() -> float:
        wheels = {(each.ns, each.id): each for each in picture(topics, angles.pop()).markers}
        left, right = (wheels["car", i].pose.orientation for i in (1, 2))
        return sum(2 * math.atan2(each.z, each.w) for each in (left, right)) / 2

    angles = [3000, 2000, 1000]
    assert angle() == 0.0
    for topic, value in ((ros.STEERING_COMMAND, 0.2), (ros.STEERING_STATE, -0.1)):
        list(topics.of(topic, bytes(serialize_message(ros.joint_message(0, value, 0.0)))))
        assert angle() == pytest.approx(value, abs=0.01)


def test_a_stop_request_turns_the_car_red() -> None:
    topics = derived_topics()
    for time, stop, colour in ((1000, False, CAR_COLOUR), (2000, True, STOP_COLOUR)):
        list(topics.of(ros.STOP_REQUEST, bytes(serialize_message(Bool(data=stop)))))
        body = picture(topics, time).markers[0].color
        assert (body.r, body.g, body.b) == pytest.approx(colour[:3])


def test_damaged_messages_give_no_picture_and_no_error() -> None:
    topics = derived_topics()
    for topic in (ros.STEERING_STATE, ros.STOP_REQUEST):
        list(topics.of(topic, b"\x00\x01\x00\x00\xff\xff"))
    assert picture(topics, 1000)
    assert topics.picture(odometry(5000, v_x=math.inf)) is None
    assert topics.picture(odometry(6000)[:40]) is None


def test_only_messages_about_nodes_of_other_namespaces_are_left_out() -> None:
    for topic, full in ((ros.DIAGNOSTICS, True), (ros.PARAMETER_EVENTS, True), (ros.ROSOUT, False)):
        for name, other in (("car2/gate", True), ("car1/gate", False), ("car10/gate", True)):
            message = sample(topic, NANOSECONDS)
            if topic == ros.DIAGNOSTICS:
                message.status = message.status[:1]
                message.status[0].name = f"/{name}"
            elif full:
                message.node = f"/{name}"
            else:
                message.name = name.replace("/", ".")
            data = bytes(serialize_message(message))
            assert is_of_another_car(topic, data, "/car1") is other
            assert not is_of_another_car(topic, data, "/")
    hardware = bytes(serialize_message(sample(ros.DIAGNOSTICS, 0)))
    assert not is_of_another_car(ros.DIAGNOSTICS, hardware, "/car1")
    assert not is_of_another_car("/odom", b"", "/car1")
