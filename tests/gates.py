"""A gate in a test: its limits, plans, and a drive in steps of its timer."""

import math
from collections.abc import Sequence

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.gate.core import Gate, GateOutput
from ampc_ros.gate.following import MeasuredPose
from ampc_ros.gate.plan import PlanPoint, SteeringPlan, make_plan
from ampc_ros.gate.settings import GateSettings, GateState

ROAD = load(GuardLimits, find("guards", "road"))
CHASSIS = load_section(ChassisParameters, find("vehicles", "ordinary"), "chassis")
PERIOD = 0.125
"""Period of the commands, exact as a binary number [s]."""


def new_gate(**settings: float) -> Gate:
    """Return a waiting gate for the ordinary car."""
    return Gate(ROAD, CHASSIS, GateSettings(period=PERIOD, **settings))


def at_speed(v_x: float) -> MeasuredPose:
    """Return a measurement of the speed alone [m/s]."""
    return MeasuredPose(math.nan, math.nan, math.nan, v_x, 0.0)


def plan_of(angles: Sequence[float], speed: float = 8.0, dt: float = 0.25) -> SteeringPlan:
    """Return a plan at constant speed, without places.

    Args:
        angles: Angle of each point [rad].
        speed: Speed [m/s].
        dt: Time between two points [s].
    """
    points = [
        PlanPoint(i * dt, angle, i * dt * speed, speed, 0.0) for i, angle in enumerate(angles)
    ]
    return make_plan(points, has_places=False)


def driving_gate(
    angle: float = 0.01, speed: float = 8.0, plan: SteeringPlan | None = None, **settings: float
) -> Gate:
    """Return a gate that has passed its first command on at time 0, with a plan."""
    gate = new_gate(**settings)
    gate.take_plan(plan or plan_of([angle] * 8), 0.0)
    assert not gate.take_speed(speed, 0.0)
    assert not gate.take_command(angle, 0.0, 0.0)
    assert gate.step(0.0) is not None
    return gate


def output_at(gate: Gate, now: float) -> GateOutput:
    """Return the output of a gate that does not wait."""
    output = gate.step(now)
    assert output
    assert all(map(math.isfinite, output[:3]))
    return output


def state_of(gate: Gate) -> GateState:
    """Return the present state, which type checkers would otherwise take for that of before."""
    return gate.state
