"""The values that cross the border between car and controller, without ROS.

Frames and signs follow REP-103 and REP-105: x forward, y left, yaw and steering positive to the
left; `map` is fixed, `base_link` is the centre of the rear axle unless a parameter moves it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled

Array = NDArray[np.float64]
NANOSECONDS = 1_000_000_000


class VehicleState(NamedTuple):
    """Measured motion of the car at one instant, as `odom` carries it."""

    stamp_ns: int
    """Time of the measurement [ns]."""
    x: float
    """Position in `map` [m]."""
    y: float
    """Position in `map` [m]."""
    yaw: float
    """Heading in `map`, in [-pi, pi] [rad]."""
    v_x: float
    """Longitudinal velocity in the body frame [m/s]."""
    v_y: float
    """Lateral velocity in the body frame, at the point that x and y describe [m/s]."""
    yaw_rate: float
    """Yaw rate [rad/s]."""


MODES = (
    "tracking",
    "standstill: the steering holds",
    "beyond the end of the path: straight on",
    "driving backwards is not supported: the steering holds",
    "the path leads the other way: the steering holds",
)
"""What `Diagnosis.mode` counts; only the first two are in order."""
TRACKING, STANDSTILL, PATH_END, REVERSE, WRONG_WAY = range(len(MODES))

RUNGS = ("optimal", "slack", "shifted_plan", "feed_forward", "stop")
"""The ladder of fall-backs, from the exact solution down to the request to stop."""
OPTIMAL, SLACK, SHIFTED_PLAN, FEED_FORWARD, STOP = range(len(RUNGS))

REASONS = (
    "none",
    "slack_in_use",
    "qp_not_solved",
    "plan_used_up",
    "state_late",
    "state_lost",
    "path_lost",
    "off_path",
    "wrong_way",
    "driving_backwards",
)
"""Why a command does not come from the top of the ladder."""

LIMITS = (
    "none",
    "not_finite",
    "angle",
    "lateral_acceleration",
    "rate",
    "lateral_jerk",
    "measured_step",
)
"""What the guard has clipped a command to."""

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""


class Diagnosis(NamedTuple):
    """What a controller can say about one step; each field is one debug topic."""

    cross_track_error: float = math.nan
    """Signed distance of the centre of gravity from the path, positive to its left [m]."""
    heading_error: float = math.nan
    """Heading minus the path's heading [rad]."""
    curvature: float = math.nan
    """Of the path at the car [1/m]."""
    feed_forward: float = math.nan
    """Steady-state angle of that curvature [rad]."""
    disturbance: float = 0.0
    """Lateral acceleration that the model does not explain: wind, bank, its own errors [m/s^2]."""
    mode: float = TRACKING
    """Index in MODES."""
    active_constraints: float = 0.0
    """Number of constraint rows that hold with equality in the solution."""
    slack: float = 0.0
    """Violation of the softened output rows [m]."""
    solver_iterations: float = 0.0
    """Steps of the active-set method, or sweeps of Hildreth's."""
    converged: float = 1.0
    """1 where the QP was solved, 0 where the controller fell back on its last angle."""
    prediction_horizon: float = math.nan
    """N_p in use [ticks]."""
    control_horizon: float = math.nan
    """N_c in use [ticks]."""
    laguerre_terms: float = math.nan
    """N in use."""
    laguerre_pole: float = math.nan
    """alpha in use."""
    output_weight: float = math.nan
    """Q in use."""
    increment_weight: float = math.nan
    """R in use."""
    outside_table: float = 0.0
    """1 where the speed or reference lies outside the gain table's grid and was clamped."""


class Command(NamedTuple):
    """Answer of a controller to one state."""

    stamp_ns: int
    """Stamp of the state that it answers [ns]."""
    steering: float
    """Road-wheel angle of the equivalent single front wheel [rad]."""
    steering_rate: float
    """Rate at which the angle is to be reached [rad/s]."""
    diagnosis: Diagnosis
    prediction: NDArray[np.float64] | None = None
    """(H, 2) points in `map` where the controller expects the centre of gravity [m]."""
    plan: NDArray[np.float64] | None = None
    """(n,) angles that it means to command at this and the following ticks [rad]."""


class Supervision(NamedTuple):
    """What became of a controller's answer on its way to the steering, and by which inputs.

    With the state that the command's stamp names, and the path in force, these are all inputs of a
    tick: a recording of them can be repeated bit for bit.
    """

    steering: float
    """Angle that was commanded [rad]."""
    planned_steering: float
    """Angle that the ladder asked for, before the guard [rad]."""
    rung: float
    """Index in RUNGS."""
    reason: float
    """Index in REASONS."""
    clipped: float
    """Index in LIMITS."""
    state_age: float
    """Since the stamp of the state [s]."""
    state_silence: float
    """Since the state has come in [s]."""
    path_age: float
    """Since the stamp of the path [s]."""
    path_silence: float
    """Since the path has come in [s]."""
    measured_steering: float
    """Road-wheel angle that came in since the last tick; nan: none [rad]."""
    stop_requested: float
    """1 once a stop has been asked for."""
    resets: float
    """How often the controller has started anew, because time or the car's place jumped."""
    configuration: float
    """Number of the configuration in force."""
    qp_fault: float
    """1 where the solver was made to fail, for a test."""


@compiled
def wrap_angle(angle: float) -> float:
    """Give the same direction in [-pi, pi] [rad].

    Note:
        math.remainder does not exist in compiled code. Up to 3 pi this gives the same number;
        beyond it is exact to the rounding of the whole turns, as the angle itself is.
    """
    turns: float = np.rint(angle / math.tau)
    return angle - math.tau * turns


@compiled
def quaternion_from_yaw(yaw: float) -> tuple[float, float]:
    """Give the z and w components of the unit quaternion of a rotation about z."""
    return math.sin(yaw / 2), math.cos(yaw / 2)


@compiled
def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Give the yaw of a quaternion in the z-y-x convention, in [-pi, pi] [rad]."""
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


@compiled
def as_received(state: VehicleState) -> VehicleState:
    """Give the state as a subscriber reads it: the heading has been a quaternion on the wire."""
    stamp_ns, x, y, yaw, v_x, v_y, yaw_rate = state
    z, w = quaternion_from_yaw(yaw)
    yaw = yaw_from_quaternion(0.0, 0.0, z, w)
    return VehicleState(stamp_ns, x, y, yaw, v_x, v_y, yaw_rate)


@compiled
def at_distance(state: VehicleState, distance: float) -> VehicleState:
    """Move the point that a state describes forward along the body's x axis by `distance` [m]."""
    stamp_ns, x, y, yaw, v_x, v_y, yaw_rate = state
    x += distance * math.cos(yaw)
    y += distance * math.sin(yaw)
    return VehicleState(stamp_ns, x, y, yaw, v_x, v_y + distance * yaw_rate, yaw_rate)
