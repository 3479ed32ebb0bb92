"""Values exchanged between car and controller, without ROS and without compiled code.

Frames and signs follow REP-103 and REP-105: x forward, y left, yaw and steering positive to the
left. `map` is fixed; `base_link` is the centre of the rear axle unless a parameter moves it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""


QUATERNION_LENGTH = (0.9, 1.1)
"""Allowed length of a received quaternion, which is ideally 1."""

Array = NDArray[np.float64]
"""Array of real numbers; its shape is stated where it is used."""


class VehicleState(NamedTuple):
    """Measured motion of the car at one instant, as in `odom`."""

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
"""Meaning of `Diagnosis.mode`; only the first two are normal operation."""
TRACKING, STANDSTILL, PATH_END, REVERSE, WRONG_WAY = range(len(MODES))

RUNGS = ("optimal", "slack", "shifted_plan", "feed_forward", "stop")
"""The fallback chain, from the exact solution down to a request to stop."""
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
    "path_end",
    "controller_fault",
)
"""Why a command is not the optimal solution, or why a stop is requested. Recordings hold the index:
new reasons are appended."""

LIMITS = (
    "none",
    "not_finite",
    "angle",
    "lateral_acceleration",
    "rate",
    "lateral_jerk",
    "measured_step",
)
"""Limits to which the guard clips a command."""

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""


class Diagnosis(NamedTuple):
    """Diagnosis of one control step; each field is one debug topic."""

    cross_track_error: float = math.nan
    """Signed distance of the centre of gravity from the path, positive to its left [m]."""
    heading_error: float = math.nan
    """Heading minus the path's heading [rad]."""
    curvature: float = math.nan
    """Curvature of the path at the car [1/m]."""
    feed_forward: float = math.nan
    """Steady-state steering angle of that curvature [rad]."""
    disturbance: float = 0.0
    """Lateral acceleration beyond the model: wind, bank, model errors [m/s^2]."""
    mode: float = TRACKING
    """Index in MODES."""
    active_constraints: float = 0.0
    """Number of constraint rows that hold with equality in the solution."""
    slack: float = 0.0
    """Violation of the softened output rows [m]."""
    solver_iterations: float = 0.0
    """Steps of the active-set method, or sweeps of Hildreth's."""
    converged: float = 1.0
    """1: the QP was solved; 0: the controller used its last angle."""
    prediction_horizon: float = math.nan
    """Prediction horizon N_p in use [ticks]."""
    control_horizon: float = math.nan
    """Control horizon N_c in use [ticks]."""
    laguerre_terms: float = math.nan
    """Number of Laguerre functions N in use."""
    laguerre_pole: float = math.nan
    """Laguerre pole alpha in use."""
    output_weight: float = math.nan
    """Output weight Q in use."""
    increment_weight: float = math.nan
    """Increment weight R in use."""
    outside_table: float = 0.0
    """1: speed or reference lies outside the grid of the gain table and is clamped."""


class Plan(NamedTuple):
    """Result of one step of a controller."""

    stamp_ns: int
    """Stamp of that state [ns]."""
    steering: float
    """Road-wheel angle of the equivalent single front wheel [rad]."""
    steering_rate: float
    """Rate at which the angle is to be reached [rad/s]."""
    diagnosis: Diagnosis
    prediction: Array | None = None
    """(H, 2) predicted positions of the centre of gravity in `map` [m]."""
    angles: Array | None = None
    """(n,) planned angles of this and the following ticks [rad]."""

    @property
    def cross_track_error(self) -> float:
        """Signed distance of the centre of gravity from the path, positive to its left [m]."""
        return self.diagnosis.cross_track_error

    @property
    def status(self) -> str:
        """Mode of the controller, or that the QP was not solved."""
        return MODES[int(self.diagnosis.mode)] if self.diagnosis.converged else "QP not solved"


class Command(NamedTuple):
    """Steering command after fallback chain and guard, with its reasons."""

    stamp_ns: int
    """Stamp of the newest accepted state [ns]."""
    steering: float
    """Commanded road-wheel angle [rad]."""
    steering_rate: float
    """Rate at which the angle is to be reached [rad/s]."""
    planned_steering: float
    """Angle chosen by the fallback chain, before the guard [rad]."""
    rung: int
    """Index in RUNGS."""
    reason: int
    """Index in REASONS."""
    clipped: int
    """Index in LIMITS."""
    plan: Plan
    """Newest result of the controller."""

    @property
    def diagnosis(self) -> Diagnosis:
        """Diagnosis of the controller."""
        return self.plan.diagnosis


class TickRecord(NamedTuple):
    """A command and the inputs of its tick, as published on `controller/tick`.

    Together with the state named by the command's stamp, and the path in use, these are all inputs
    of a tick: a recording of them can be replayed bit for bit.
    """

    command: Command
    state_age: float
    """Time since the stamp of the state [s]."""
    state_silence: float
    """Time since the arrival of the state [s]."""
    path_age: float
    """Time since the stamp of the path [s]."""
    path_silence: float
    """Time since the arrival of the path [s]."""
    measured_steering: float
    """Road-wheel angle measured since the last tick; nan: none [rad]."""
    stop_requested: float
    """1 once a stop has been requested."""
    resets: float
    """Number of restarts of the controller after a jump of time or position."""
    configuration: float
    """Number of the configuration in use."""
    qp_fault: float
    """1 while the solver is made to fail by fault injection."""
    corrected_yaw_rate: float = math.nan
    """Yaw rate used instead of one that contradicts the heading; nan: the measured one [rad/s]."""
    steering_latency: float = math.nan
    """Delay and lag of the steering that the controller assumes, in total [s]."""
    understeer_gradient: float = math.nan
    """Understeer gradient that it assumes [rad s^2/m]."""
    steering_offset: float = math.nan
    """Estimated road-wheel angle at a commanded angle of zero [rad]."""
    rear_cornering_stiffness: float = math.nan
    """Cornering stiffness of one rear tyre that the controller assumes [N/rad]."""
    command_interval: float = math.nan
    """Time since the last command, which bounds the step of the command [s]."""
    started_from: float = math.nan
    """Angle in force from which the controller started with this tick; nan: it goes on [rad]."""

    @property
    def quantities(self) -> tuple[float, ...]:
        """Published numbers, in the order of RECORD_QUANTITIES."""
        command = self.command
        chosen = command.steering, command.planned_steering, command.rung
        return (*chosen, command.reason, command.clipped, *self[1:])


RECORD_QUANTITIES = (
    "steering",
    "planned_steering",
    "rung",
    "reason",
    "clipped",
    *TickRecord._fields[1:],
)
"""Names of `TickRecord.quantities` in `controller/tick`."""
