"""Ratio and offset of the steering topics: applied at the interface, and only there."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ampc_msgs_config import ros
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import Diagnosis, Plan

ANGLES = st.floats(-1.5, 1.5)
GEARED = st.builds(
    SteeringParameters,
    max_angle=st.just(0.6),
    ratio=st.floats(0.1, 100.0),
    offset=st.floats(-0.2, 0.2),
)


@given(GEARED, ANGLES)
def test_position_and_angle_are_inverse(steering: SteeringParameters, angle: float) -> None:
    assert steering.angle(steering.position(angle)) == pytest.approx(angle, abs=1e-14)
    assert steering.angle(0.0) == pytest.approx(steering.offset, abs=1e-15)


@given(ANGLES)
def test_without_ratio_and_offset_not_a_bit_changes(angle: float) -> None:
    steering = SteeringParameters(max_angle=0.6)
    for value in (angle, 0.0, -0.0):
        for same in (steering.position(value), steering.angle(value)):
            assert math.copysign(1.0, same) == math.copysign(1.0, value)
            assert same == value


@given(GEARED, ANGLES, st.floats(-5.0, 5.0))
def test_a_command_carries_units_of_the_topic(
    steering: SteeringParameters, angle: float, rate: float
) -> None:
    message = ros.steering_message(Plan(7, angle, rate, Diagnosis()), steering)
    assert message.position[0] == pytest.approx(steering.ratio * (angle - steering.offset))
    assert message.velocity[0] == pytest.approx(steering.ratio * rate)
    back = ros.steering_angle(message, steering)
    assert back.stamp_ns == 7
    assert back.value == pytest.approx(angle, abs=1e-14)


def test_a_steering_wheel_may_turn_as_far_as_its_ratio_allows() -> None:
    steering = SteeringParameters(max_angle=0.6, ratio=15.0, offset=0.1)
    far = ros.joint_message(0, 0.6, 0.0, steering)
    assert far.position[0] == pytest.approx(7.5)
    assert ros.steering_angle(far, steering).value == pytest.approx(0.6)
    for position in (22.1, -25.1):
        far.position = [position]
        with pytest.raises(ValueError, match=r"must lie in \[-25\.06, 22\.06\] rad"):
            ros.steering_angle(far, steering)
