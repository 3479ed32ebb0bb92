"""The values at the border: the same in compiled code as in Python, stamps to the nanosecond."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.frames import (
    as_received,
    at_distance,
    quaternion_from_yaw,
    wrap_angle,
    yaw_from_quaternion,
)
from ampc_msgs_config.quaternions import quaternion_of, yaw_of
from ampc_msgs_config.types import VehicleState

many = settings(max_examples=200, deadline=None, derandomize=True)
STAMP_NS = 1_700_000_000_123_456_789


@many
@given(angle=st.floats(-3 * math.pi, 3 * math.pi))
def test_wrapped_angle_is_the_exact_remainder_up_to_three_half_turns(angle: float) -> None:
    assert wrap_angle(angle) == math.remainder(angle, math.tau)


@many
@given(angle=st.floats(-1e4, 1e4))
def test_wrapped_angle_is_the_same_direction_within_half_a_turn(angle: float) -> None:
    assert abs(wrap_angle(angle)) <= math.pi + 1e-11
    assert math.cos(wrap_angle(angle)) == pytest.approx(math.cos(angle), abs=1e-11)
    assert math.sin(wrap_angle(angle)) == pytest.approx(math.sin(angle), abs=1e-11)


@many
@given(yaw=st.floats(-math.pi, math.pi), distance=st.floats(-5.0, 5.0))
def test_moving_the_point_turns_with_the_car_and_keeps_the_stamp(
    yaw: float, distance: float
) -> None:
    state = VehicleState(STAMP_NS, 3.0, -2.0, yaw, 9.0, 0.5, 0.3)
    there = at_distance(state, distance)
    x, y = 3.0 + distance * math.cos(yaw), -2.0 + distance * math.sin(yaw)
    assert there == VehicleState(STAMP_NS, x, y, yaw, 9.0, 0.5 + distance * 0.3, 0.3)
    assert at_distance(there, -distance) == pytest.approx(state, abs=1e-12)


@many
@given(yaw=st.floats(-math.pi, math.pi))
def test_received_heading_has_been_a_quaternion_and_nothing_else_changes(yaw: float) -> None:
    state = VehicleState(STAMP_NS, 3.0, -2.0, yaw, 9.0, 0.5, 0.3)
    z, w = math.sin(yaw / 2), math.cos(yaw / 2)
    assert quaternion_from_yaw(yaw) == quaternion_of(yaw) == (z, w)
    assert yaw_from_quaternion(0.0, 0.0, z, w) == yaw_of(0.0, 0.0, z, w)  # bit for bit
    assert as_received(state) == state._replace(yaw=yaw_from_quaternion(0.0, 0.0, z, w))
    assert as_received(state).yaw == pytest.approx(yaw, abs=1e-15)
    assert isinstance(as_received(state).stamp_ns, int)
