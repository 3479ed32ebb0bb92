"""Parameters of car and controller: frozen dataclasses that check themselves at construction.

`dataclasses.astuple` of these is what compiled code receives and unpacks in the same order.
"""

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from itertools import pairwise
from typing import Annotated, ClassVar

from ampc_msgs_config.validation import Checked, choice, described, number

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2]."""
REAR_AXLE = -1.0
"""Value of `base_link_to_cg` for odometry of the rear axle; any other value is a distance [m]."""
MIN_SPEED = 1.0
"""Smallest speed of the model, which divides by the speed [m/s]."""
FRICTION_SHARE = 1.3
"""Bound of the angle: that of a linear tyre at this multiple of the friction limit. The curve of a
real tyre flattens and reaches its peak at about this multiple of the linear angle."""


@dataclass(frozen=True, kw_only=True)
class ChassisParameters(Checked):
    """Single-track model of a car, Table 3 of the paper: m, I_z, l_f, l_r, C_f, C_r."""

    ELSEWHERE: ClassVar[Mapping[str, str]] = {
        "wheelbase": "; it is cg_to_front_axle + cg_to_rear_axle, which launch_scripts/new_car.py "
        "computes from wheelbase and front share"
    }
    mass: Annotated[float, number(1.0, 1.0e5, "kg", "Mass, m.")]
    yaw_inertia: Annotated[float, number(0.001, 1.0e6, "kg m^2", "Yaw inertia, I_z.")]
    cg_to_front_axle: Annotated[
        float, number(0.05, 20.0, "m", "Centre of gravity to front axle, l_f.")
    ]
    cg_to_rear_axle: Annotated[
        float, number(0.05, 20.0, "m", "Centre of gravity to rear axle, l_r.")
    ]
    front_cornering_stiffness: Annotated[
        float, number(1.0, 1.0e7, "N/rad", "Stiffness of ONE front tyre, C_f.")
    ]
    rear_cornering_stiffness: Annotated[
        float, number(1.0, 1.0e7, "N/rad", "Stiffness of ONE rear tyre, C_r.")
    ]

    @property
    def wheelbase(self) -> float:
        """Wheelbase L = l_f + l_r [m]."""
        return self.cg_to_front_axle + self.cg_to_rear_axle

    @property
    def understeer_gradient(self) -> float:
        """Understeer gradient K_us [rad s^2/m]; positive: the car understeers."""
        return understeer_gradient(astuple(self))


def understeer_gradient(vehicle: tuple[float, ...]) -> float:
    """Return K_us = m/L (l_r / 2 C_f - l_f / 2 C_r) of m, I_z, l_f, l_r, C_f, C_r [rad s^2/m]."""
    m, _, l_f, l_r, C_f, C_r = vehicle
    return m / (l_f + l_r) * (l_r / (2 * C_f) - l_f / (2 * C_r))


def cornering_angle(wheelbase: float, gradient: float, v_x: float, a_y: float) -> float:
    """Return the angle of a steady circle, a_y (L / v^2 + max(K_us, 0)), v >= MIN_SPEED [rad]."""
    v = max(v_x, MIN_SPEED)
    return a_y * (wheelbase / v**2 + max(gradient, 0.0))


ASSUMED_LAG = 0.08
"""Lag of a steering whose lag is not configured. Nearly every servo is slower than zero; this value
is good for cars with 0 to 0.2 s of delay and lag in total [s]."""


@dataclass(frozen=True, kw_only=True)
class SteeringParameters(Checked):
    """Steering actuator between the commanded and the real road-wheel angle, and its interface.

    `ratio` and `offset` belong to the topics `steering_command` and `steering_state` only: see
    `position` and `angle`. Everything else is a road-wheel angle.
    """

    max_angle: Annotated[float, number(0.0, 1.5, "rad", "Largest road-wheel angle.")]
    max_rate: Annotated[
        float, number(0.0, math.inf, "rad/s", "Largest rate of that angle; .inf: none.")
    ] = math.inf
    lag: Annotated[
        float,
        number(-1.0, 5.0, "s", "Time constant of the first-order lag; -1: unknown, 0.08 s."),
    ] = -1.0
    delay: Annotated[float, number(0.0, 2.0, "s", "Pure delay.")] = 0.0
    ratio: Annotated[
        float,
        number(0.1, 100.0, "", "Position on the steering topics per road-wheel angle."),
    ] = 1.0
    offset: Annotated[
        float, number(-0.2, 0.2, "rad", "Road-wheel angle at position 0 on the steering topics.")
    ] = 0.0

    def __post_init__(self) -> None:
        """Check all fields; a negative lag is the mark of an unknown one."""
        super().__post_init__()
        if -1.0 < self.lag < 0.0:
            raise ValueError(f"lag = {self.lag:g} must be 0 or more, or -1 if it is unknown")

    @property
    def is_lag_configured(self) -> bool:
        """Whether the lag is stated."""
        return self.lag >= 0.0

    @property
    def time_constant(self) -> float:
        """Lag, or the assumed one where it is not stated [s]."""
        return self.lag if self.is_lag_configured else ASSUMED_LAG

    def position(self, angle: float) -> float:
        """Return the position on the steering topics of a road-wheel angle [rad]."""
        return self.ratio * (angle - self.offset)

    def angle(self, position: float) -> float:
        """Return the road-wheel angle of a position on the steering topics [rad]."""
        return position / self.ratio - (0.0 - self.offset)  # keeps the sign of -0.0


@dataclass(frozen=True, kw_only=True)
class ControllerSettings(Checked):
    """Limits and solver of the controller; its gains are in the gain table."""

    sample_time: Annotated[float, number(0.001, 1.0, "s", "Period of the control loop, T.")] = 0.1
    max_increment: Annotated[float, number(0.0, 3.0, "rad per tick", "Largest increment.")] = (
        math.pi / 12
    )
    max_angle: Annotated[float, number(0.0, 1.5, "rad", "Largest commanded angle.")] = math.pi / 6
    max_output_error: Annotated[
        float, number(0.0, math.inf, "m", "Half-width of the soft lane, Eq. (15); .inf: none.")
    ] = math.inf
    friction: Annotated[
        float, number(0.05, 2.0, "", "Friction of the road in the controller's model.")
    ] = 0.9
    slack_weight: Annotated[float, number(1.0e-3, 1.0e9, "1/m^2", "Weight of the slack.")] = 1.0e4
    nominal_speed: Annotated[
        float, number(0.0, 100.0, "m/s", "Speed of a model that does not adapt; 0: adaptive.")
    ] = 0.0
    solver: Annotated[
        str, choice(("active_set", "hildreth"), "Solver of the QP; the paper's is hildreth.")
    ] = "active_set"
    hildreth_sweeps: Annotated[
        float, number(1, 1_000_000, "", "Largest number of Hildreth sweeps.")
    ] = 38
    hildreth_tolerance: Annotated[
        float, number(0.0, 1.0, "", "Change of multipliers that ends Hildreth.")
    ] = 1.0e-7
    state_late: Annotated[
        float,
        number(0.0, 10.0, "s", "Age from which the model, or the last plan, continues a state."),
    ] = 0.2
    state_lost: Annotated[
        float, number(0.0, 10.0, "s", "Age of the state that requests a stop.")
    ] = 0.5
    state_prediction: Annotated[
        float,
        number(0.0, 10.0, "s", "Longest prediction of a late state with the model; 0: none."),
    ] = 3.0
    path_late: Annotated[
        float, number(0.0, 3600.0, "s", "Age of the path that raises a warning.")
    ] = 0.9
    path_lost: Annotated[
        float, number(0.0, 3600.0, "s", "Age of the path that requests a stop.")
    ] = 2.0
    resume: Annotated[
        bool, described("Withdraw a stop request 2 s after missing inputs have returned.")
    ] = False
    max_deviation: Annotated[
        float,
        number(0.1, math.inf, "m", "Cross-track error that requests a stop; .inf: none does."),
    ] = 1.0
    end_deceleration: Annotated[
        float,
        number(
            0.1,
            math.inf,
            "m/s^2",
            "Braking on a stop request, made in time for the path's end; .inf: no request there.",
        ),
    ] = 2.0
    path_noise: Annotated[
        float,
        number(-1.0, 10.0, "m", "Noise of the path's points; 0: none; -1: estimated from them."),
    ] = -1.0
    adaptation: Annotated[
        bool,
        described("Estimate and use what differs from the configured car; formulation `preview`."),
    ] = True
    position_noise: Annotated[
        float, number(0.0, 10.0, "m", "Noise of odometry's position, for the state filter.")
    ] = 0.05
    heading_noise: Annotated[float, number(0.0, 1.0, "rad", "Noise of its heading.")] = 0.0087
    yaw_rate_noise: Annotated[float, number(0.0, 1.0, "rad/s", "Noise of its yaw rate.")] = 0.0087
    lateral_velocity_noise: Annotated[
        float, number(0.0, 10.0, "m/s", "Noise of its lateral velocity.")
    ] = 0.1
    look_ahead_time: Annotated[float, number(0.0, 10.0, "s", "Pure pursuit: look-ahead time.")] = (
        0.6
    )
    min_look_ahead: Annotated[float, number(0.1, 100.0, "m", "Pure pursuit: least look-ahead.")] = (
        4.0
    )

    @property
    def known_path_noise(self) -> float | None:
        """Standard deviation of the points of a path [m]; None: estimated from them."""
        return self.path_noise if self.path_noise >= 0.0 else None


@dataclass(frozen=True, kw_only=True)
class SizeParameters(Checked):
    """Outline of the car, for lanes and cones."""

    width: Annotated[float, number(0.1, 10.0, "m", "Width of the body.")]
    front_overhang: Annotated[float, number(0.0, 10.0, "m", "Front axle to front bumper.")]
    rear_overhang: Annotated[float, number(0.0, 10.0, "m", "Rear axle to rear bumper.")]


@dataclass(frozen=True, kw_only=True)
class GuardLimits(Checked):
    """Limits of the steering command by speed, whichever controller computed it.

    Each row has one value for each speed. Values are linear between the speeds and constant beyond
    them.
    """

    speed: tuple[Annotated[float, number(0.0, 100.0, "m/s", "Speeds, increasing.")], ...]
    max_angle: tuple[Annotated[float, number(0.01, 1.5, "rad", "Largest road-wheel angle.")], ...]
    max_rate: tuple[
        Annotated[float, number(0.01, 20.0, "rad/s", "Largest rate of the road-wheel angle.")], ...
    ]
    lateral_acceleration: tuple[
        Annotated[
            float, number(0.1, 50.0, "m/s^2", "Acceleration of the steady circle of the angle.")
        ],
        ...,
    ]
    lateral_jerk: tuple[
        Annotated[float, number(0.1, 1000.0, "m/s^3", "Change of that acceleration by steering.")],
        ...,
    ]
    measured_step: tuple[
        Annotated[float, number(0.01, 3.0, "rad", "Distance from the measured angle.")], ...
    ]

    def __post_init__(self) -> None:
        """Check each row, and its length and order against the speeds."""
        super().__post_init__()
        if not self.speed:
            raise ValueError("speed = [] must be a list of 1 or more entries")
        for item in fields(self):
            values = getattr(self, item.name)
            if len(values) != len(self.speed):
                raise ValueError(
                    f"{item.name} = {list(values)} must have {len(self.speed)} values, as speed has"
                )
        for i, (slow, fast) in enumerate(pairwise(self.speed), start=1):
            if fast <= slow:
                raise ValueError(f"speed[{i}] = {fast:g} must be greater than {slow:g} before it")
