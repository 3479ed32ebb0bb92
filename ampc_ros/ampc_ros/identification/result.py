"""Identified quantities with 95 % intervals, and the rules for calling them identifiable."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.parameters import ChassisParameters
from ampc_msgs_config.types import Array
from ampc_ros.identification.estimate import (
    C_F,
    C_R,
    DELAY,
    I_Z,
    LAG,
    LATENCY,
    LOG_RATE,
    OFFSET,
    RATIO,
    X_P,
    ComparedOutputs,
    LeastSquaresFit,
    Start,
    estimate,
    high_frequency_noise,
    joined,
    measured_outputs,
    output_times,
    predicted_outputs,
)
from ampc_ros.identification.recording import RecordedDrive, Segment, segments_of

QUANTILE = 2.0
"""Half-width of a 95 % interval in standard deviations."""
LEAST_ACCELERATION = 1.0
"""Lateral acceleration that a drive must exceed for 5 % of its time to show anything about tyres;
below it, the cross slope of the road has the same effect as their slip [m/s^2]."""
ONE_DEGREE_PER_G = math.radians(1.0) / 9.81
"""Understeer gradient below which its error is judged absolutely [rad s^2/m]."""
TURNS = "bends to both sides at 2 to 3 m/s^2 and at two speeds that differ by a factor of 1.5"
SLALOM = "a slalom whose frequency rises to 1 Hz"
MANOEUVRE = "; contained in: start.py --manoeuvre identification"


class Rule(NamedTuple):
    """Largest useful half-width of an interval, and what is added to it for errors of the model."""

    limit: float
    allowance: float
    """Standard deviation."""
    help: str
    """Manoeuvre that determines the quantity."""


RULES = {
    "delay": Rule(0.03, 0.0015, SLALOM),
    "lag": Rule(0.04, 0.0015, SLALOM),
    "total_latency": Rule(0.03, 0.0015, SLALOM),
    "max_rate": Rule(0.2, 0.02, "a quick change from lock to lock at walking speed"),
    "ratio": Rule(0.02, 0.0025, "bends to both sides at low speed"),
    "offset": Rule(math.radians(0.3), 2.0e-4, "bends to both sides, and straight parts"),
    "understeer_gradient": Rule(0.3, 0.03, TURNS),
    "front_cornering_stiffness": Rule(0.25, 0.02, TURNS),
    "rear_cornering_stiffness": Rule(0.25, 0.02, TURNS),
    "yaw_inertia": Rule(0.3, 0.04, f"{SLALOM}, at more than 5 m/s"),
    "measured_point": Rule(0.06, 0.005, "tight bends at low speed"),
    "latency": Rule(0.03, 0.002, f"{SLALOM}, with measured steering"),
}
"""Absolute, but relative for `max_rate`, `ratio`, inertia and stiffness, relative to the gradient
or to ONE_DEGREE_PER_G, whichever is larger, and to the wheelbase for `measured_point`."""
ACTUATOR = ("delay", "lag", "total_latency")
WITHOUT_STEERING = 2.0
"""Factor on the allowances of ACTUATOR where the steering is not measured: errors of the tyre model
then act on them."""
SIGNED = ("offset", "understeer_gradient", "measured_point")
"""Quantities that may be negative."""
TYRES = (
    "understeer_gradient",
    "front_cornering_stiffness",
    "rear_cornering_stiffness",
    "yaw_inertia",
)
"""Quantities that need LEAST_ACCELERATION."""


class Quantity(NamedTuple):
    """One identified quantity, in SI units."""

    value: float
    half_width: float
    """Half of the 95 % interval."""
    reason: str = ""
    """Why the quantity is not identifiable from this drive; empty: it is."""
    help: str = ""
    """Manoeuvre that would determine it."""
    least: float = -math.inf
    """Physical bound of the value."""

    @property
    def is_identified(self) -> bool:
        """Whether the drive determines the quantity."""
        return not self.reason

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return max(self.value - self.half_width, self.least), self.value + self.half_width


class Excitation(NamedTuple):
    """What a drive contains."""

    duration: float
    """Usable time [s]."""
    lateral_acceleration: float
    """95 % quantile of its absolute value [m/s^2]."""
    speed: tuple[float, float]
    """5 % and 95 % quantile [m/s]."""
    left: float
    """Share of the usable time with more than 0.3 m/s^2 to the left."""
    right: float
    left_out: dict[str, float]
    """Shares of the recorded time that were not used, by reason."""


class OdometryNoise(NamedTuple):
    """Standard deviations of the odometry, as in the settings of the controller."""

    position_noise: float
    """[m]"""
    heading_noise: float
    """[rad]"""
    yaw_rate_noise: float
    """[rad/s]"""
    lateral_velocity_noise: float
    """[m/s]"""


class Age(NamedTuple):
    """Arrival minus stamp of the odometry [s]."""

    median: float
    spread: float
    """Standard deviation, robust."""
    most: float
    """99 % quantile."""


class Identification(NamedTuple):
    """Result."""

    quantities: dict[str, Quantity]
    """By the names of RULES."""
    chassis: ChassisParameters
    """Start chassis with the identified values."""
    noise: OdometryNoise
    age: Age | None
    """None: arrival times are not known, or not on the clock of the stamps."""
    excitation: Excitation
    time: ComparedOutputs
    """Times of the compared values [s]."""
    measured: ComparedOutputs
    predicted: ComparedOutputs
    has_lateral_velocity: bool
    """Whether the odometry measures a lateral velocity."""


def identify(
    recording: RecordedDrive, start: Start, log: Callable[[str], object] = lambda _: None
) -> Identification:
    """Identify a car from a recorded drive.

    Args:
        recording: The drive.
        start: Vehicle to start from.
        log: Receives a line on each stage.

    Raises:
        ValueError: No part of the drive can be used; the message states why.
    """
    if len(recording.time) < 10:
        raise ValueError(f"{len(recording.time)} states are too few")
    segments, left_out = segments_of(recording, start.friction)
    if not segments:
        shares = ", ".join(f"{reason} {100 * share:.0f} %" for reason, share in left_out.items())
        raise ValueError(f"no part of at least 3 s can be used; left out: {shares or 'all'}")
    excitation = excitation_of(recording, segments, left_out)
    log(f"{len(segments)} usable segments, {excitation.duration:.0f} s")
    fit = estimate(recording, segments, start, log)
    values = joined([measured_outputs(recording, s) for s in segments])
    result = quantities_of(fit, start, excitation)
    has_lateral_velocity = float(np.std(values.lateral_velocity)) > 1e-6
    if not has_lateral_velocity:
        for name in ("measured_point", "front_cornering_stiffness", "rear_cornering_stiffness"):
            reason = "the odometry states a constant lateral velocity"
            better = "odometry that measures the lateral velocity, from GNSS/INS or a scan matcher"
            result[name] = result[name]._replace(reason=reason, help=better)
    return Identification(
        result,
        identified_chassis(start.chassis, result),
        odometry_noise(recording, fit),
        age_of(recording.age),
        excitation,
        joined([output_times(recording, s) for s in segments]),
        values,
        joined([predicted_outputs(fit.theta, recording, s, start) for s in segments]),
        has_lateral_velocity,
    )


def excitation_of(
    recording: RecordedDrive, segments: list[Segment], left_out: dict[str, float]
) -> Excitation:
    """Return what the usable part of a drive contains."""
    rows = np.concatenate([segment.rows for segment in segments])
    speed, yaw = recording.v_x[rows], recording.yaw_rate[rows]
    smooth = np.convolve(speed * yaw, np.ones(5) / 5, "same")
    return Excitation(
        sum(float(s.grid[-1] - s.grid[0]) for s in segments),
        float(np.quantile(np.abs(smooth), 0.95)),
        (float(np.quantile(speed, 0.05)), float(np.quantile(speed, 0.95))),
        float(np.mean(smooth > 0.3)),
        float(np.mean(smooth < -0.3)),
        left_out,
    )


def quantities_of(
    fit: LeastSquaresFit, start: Start, excitation: Excitation
) -> dict[str, Quantity]:
    """Return all quantities with their intervals, judged by RULES."""
    theta, c = fit.theta, start.chassis

    def deviation(direction: Array) -> float:
        both = (fit.covariance, fit.classical)
        return math.sqrt(max(0.0, *(float(direction @ each @ direction) for each in both)))

    def unit(*parameters: int) -> Array:
        return np.isin(np.arange(len(theta)), parameters).astype(float)

    def chassis(at: Array) -> ChassisParameters:
        return replace(
            c,
            yaw_inertia=c.yaw_inertia * math.exp(at[I_Z]),
            front_cornering_stiffness=c.front_cornering_stiffness * math.exp(at[C_F]),
            rear_cornering_stiffness=c.rear_cornering_stiffness * math.exp(at[C_R]),
        )

    car, gradient = chassis(theta), chassis(theta).understeer_gradient
    slope = np.zeros(len(theta))
    for i in (C_F, C_R):
        slope[i] = (chassis(theta + 1e-4 * unit(i)).understeer_gradient - gradient) / 1e-4
    rate = math.exp(float(theta[LOG_RATE])) if fit.free[LOG_RATE] else fit.largest_rate
    scale = max(abs(gradient), ONE_DEGREE_PER_G)
    rows: dict[str, tuple[float, float, float]] = {  # value, deviation, unit of the rule
        "delay": (theta[DELAY], deviation(unit(DELAY)), 1.0),
        "lag": (theta[LAG], deviation(unit(LAG)), 1.0),
        "total_latency": (theta[DELAY] + theta[LAG], deviation(unit(DELAY, LAG)), 1.0),
        "max_rate": (rate, rate * deviation(unit(LOG_RATE)), rate),
        "ratio": (start.ratio * math.exp(theta[RATIO]), 0.0, start.ratio * math.exp(theta[RATIO])),
        "offset": (theta[OFFSET], deviation(unit(OFFSET)), 1.0),
        "understeer_gradient": (gradient, deviation(slope), scale),
        "front_cornering_stiffness": (car.front_cornering_stiffness, 0.0, 0.0),
        "rear_cornering_stiffness": (car.rear_cornering_stiffness, 0.0, 0.0),
        "yaw_inertia": (car.yaw_inertia, 0.0, 0.0),
        "measured_point": (theta[X_P], deviation(unit(X_P)), c.wheelbase),
        "latency": (max(theta[LATENCY], 0.0), deviation(unit(LATENCY)), 1.0),
    }
    for name, parameter in (
        ("ratio", RATIO),
        ("front_cornering_stiffness", C_F),
        ("rear_cornering_stiffness", C_R),
        ("yaw_inertia", I_Z),
    ):
        value = rows[name][0]
        rows[name] = (value, value * deviation(unit(parameter)), value)
    result = {}
    for name, (value, sigma, scale) in rows.items():
        rule = RULES[name]
        allowance = rule.allowance * scale
        if name in ACTUATOR and not fit.free[LATENCY]:
            allowance *= WITHOUT_STEERING
        half = QUANTILE * math.hypot(sigma, allowance)
        limit = rule.limit * scale
        least = -math.inf if name in SIGNED else 0.0
        verdict = judge(name, half / scale, rule, excitation)
        result[name] = Quantity(float(value), half, *verdict, least)
        if half <= limit and name == "max_rate" and not fit.free[LOG_RATE]:
            text = f"the limit was not reached; the wheels turned at up to {rate:.2g} rad/s"
            result[name] = result[name]._replace(reason=text, help=rule.help)
    if not fit.free[LATENCY]:
        reason = "without measured steering it is part of the delay"
        result["latency"] = Quantity(0.0, math.inf, reason, RULES["latency"].help)
    return result


def judge(name: str, half: float, rule: Rule, excitation: Excitation) -> tuple[str, str]:
    """Return reason and help where a quantity is not identifiable, two empty texts where it is."""
    a_y = excitation.lateral_acceleration
    if name in TYRES and a_y < LEAST_ACCELERATION:
        reason = f"95 % of the drive stay below {a_y:.2g} m/s^2 of lateral acceleration, less than "
        return f"{reason}{LEAST_ACCELERATION:g} m/s^2", rule.help + MANOEUVRE
    if half <= rule.limit:
        return "", ""
    is_relative = name in (*TYRES, "max_rate", "ratio")
    shown = f"{100 * half:.0f} %" if is_relative else f"{half:.2g}"
    limit = f"{100 * rule.limit:.0f} %" if is_relative else f"{rule.limit:.2g}"
    if name == "measured_point":
        shown, limit = f"{shown} wheelbases", f"{limit} wheelbases"
    text = f"the 95 % interval is ±{shown}, wider than ±{limit}"
    low, high = excitation.speed
    text += f"; lateral acceleration up to {a_y:.2g} m/s^2, speeds from {low:.2g} to {high:.2g} m/s"
    return text, rule.help + MANOEUVRE


def identified_chassis(start: ChassisParameters, found: dict[str, Quantity]) -> ChassisParameters:
    """Return the start chassis with the identified values.

    If only the understeer gradient is identified, the front stiffness is chosen to reproduce it.
    """
    keys = ("front_cornering_stiffness", "rear_cornering_stiffness", "yaw_inertia")
    values = {key: found[key].value for key in keys if found[key].is_identified}
    chassis = replace(start, **values)
    stiffness = {*keys[:2]} & values.keys()
    if found["understeer_gradient"].is_identified and len(stiffness) < 2:
        m, L = chassis.mass, chassis.wheelbase
        l_f, l_r = chassis.cg_to_front_axle, chassis.cg_to_rear_axle
        slope = found["understeer_gradient"].value * L / m + l_f / (
            2 * chassis.rear_cornering_stiffness
        )
        if slope > 0.0:
            chassis = replace(chassis, front_cornering_stiffness=l_r / (2 * slope))
    return chassis


def odometry_noise(recording: RecordedDrive, fit: LeastSquaresFit) -> OdometryNoise:
    """Return the noise of the odometry: of its pose from differences, of its twist as well."""
    return OdometryNoise(
        math.sqrt(
            (high_frequency_noise(recording.x) ** 2 + high_frequency_noise(recording.y) ** 2) / 2
        ),
        high_frequency_noise(np.asarray(np.unwrap(recording.yaw), dtype=float)),
        min(high_frequency_noise(recording.yaw_rate), float(fit.sigma.yaw_rate)),
        min(high_frequency_noise(recording.v_y), float(fit.sigma.lateral_velocity)),
    )


def age_of(age: Array) -> Age | None:
    """Return the age of the odometry, if arrival and stamp are on one clock."""
    if not len(age) or not -0.01 <= float(np.median(age)) <= 5.0:
        return None
    median = float(np.median(age))
    spread = 1.4826 * float(np.median(np.abs(age - median)))
    return Age(median, spread, float(np.quantile(age, 0.99)))
