"""Drives of a certificate on the simulated car: disturbances, and changes of the gains."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import cornering_angle
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedProfile
from ampc_msgs_config.types import Array, Plan, VehicleState
from ampc_ros.mpc.gain_table import Gains
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.certifying.linear_loop import (
    CertifiedController,
    spectral_radius,
    time_constant,
)
from launch_scripts.certifying.subject import Subject
from launch_scripts.tuning.drives import (
    CURVATURE,
    GUST,
    JOIN_DURATION,
    LANE_CHANGE_START,
    LARGE_OFFSET,
    lane_change,
    straight,
)
from launch_scripts.tuning.fleet import CONVERGED, CROSS_TRACK_ERROR, LOG_STEERING
from launch_scripts.tuning.fleet_rows import Entry, prepare_fleet, run_fleet
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, Vehicle

LOST_CAR_ERROR = 10.0
"""Cross-track error beyond which a drive ends [m]."""
OFFSETS = (0.5, 1.0, 2.0, 3.0, 5.0)
"""Initial offsets of joining a straight road [m]."""
SLOW = 3.0
"""Speed below which drives last longer, in inverse proportion to the speed [m/s]."""
REST_TIME = 3.0
"""Time at the end of a drive in which the car must have settled [s]."""
CHANGE_FRICTION, JOIN_FRICTION = 0.5, 0.3
"""Friction of the lane change and of joining on a slippery road."""
STEERING_SHARE = 0.5
"""Share of the largest steering angle that the lane change may need at walking speed."""
NOISE_SEED = 1
"""Seed of the measurement noise."""
LARGEST_WHEEL_ANGLE = 1.5
"""Largest angle that `SteeringParameters` accept [rad]."""
RAMP_ACCELERATION = 1.0
"""Acceleration of the speed ramp across the table [m/s^2]."""
CHUNK = 128
"""Cars that are driven between two reports of progress."""


class Case(NamedTuple):
    """One drive."""

    scenario: Scenario
    car: Vehicle
    """Car that is driven; the controller assumes the car of the subject."""
    friction: float | None = None
    effect: float = 1.0
    """Factor on the effect of the steering, behind its limits."""
    misalignment: float = 0.0
    """Road-wheel angle when straight ahead is commanded [rad]."""
    is_noisy: bool = False


Report = Callable[[float], object]
"""Receives driven seconds, for progress."""


def drive_cases(
    subject: Subject, cases: Sequence[Case], threads: int, report: Report
) -> list[Array]:
    """Drive all cases.

    Returns:
        Log (ticks, LOGGED) of each case, see `tuning.fleet`; shorter if the car was lost.
    """
    logs = []
    noise = load(MeasurementNoise, find("noise", "x1"))
    for begin in range(0, len(cases), CHUNK):
        part, entries = cases[begin : begin + CHUNK], []
        for case in part:
            rng = np.random.default_rng(NOISE_SEED) if case.is_noisy else None
            simulation = Simulation(
                with_effect(case.car, case.effect),
                case.scenario,
                friction=case.friction,
                noise=noise if case.is_noisy else None,
                rng=rng,
            )
            entries.append(Entry(simulation, subject.controller(), case.misalignment, case.effect))
        logs += list(run_fleet(prepare_fleet(entries, LOST_CAR_ERROR), threads))
        report(sum(case.scenario.duration for case in part))
    return [log[: ticks_of(case, subject.period)] for log, case in zip(logs, cases, strict=True)]


def with_effect(car: Vehicle, effect: float) -> Vehicle:
    """Return a car whose steering limits suit a factor on the commanded angle.

    Delay and lag are linear, so the factor may stand in front of the steering if the limits of
    angle and rate are multiplied as well: the car then turns its wheels as if the factor acted
    behind the steering, as a wrong steering ratio does.
    """
    steering = car.steering
    angle, rate = min(effect * steering.max_angle, LARGEST_WHEEL_ANGLE), effect * steering.max_rate
    return car._replace(steering=replace(steering, max_angle=angle, max_rate=rate))


def ticks_of(case: Case, period: float) -> int:
    """Return the number of ticks of a drive."""
    return math.ceil(case.scenario.duration / period - 1e-9)


def error_of(log: Array) -> Array:
    """Return the cross-track error of a drive [m]; infinite after a loss or a failed solution."""
    error = np.where(log[:, CONVERGED] > 0.0, log[:, CROSS_TRACK_ERROR], np.inf)
    return np.where(np.isfinite(log[:, CROSS_TRACK_ERROR]), error, np.inf)


def largest_deviation(log: Array) -> float:
    """Return the largest error of a drive [m]."""
    return float(np.abs(error_of(log)).max())


def rest(log: Array, period: float, seconds: float = REST_TIME) -> float:
    """Return the largest error in the last seconds of a drive [m]."""
    return float(np.abs(error_of(log)[-round(seconds / period) :]).max())


def overshoot(log: Array) -> float:
    """Return the largest error beyond the path, seen from the start on its left [m]."""
    error = error_of(log)
    return math.inf if np.isinf(error).any() else float(max(-error.min(), 0.0))


def steering_rate(log: Array, period: float) -> float:
    """Return the RMS steering rate of a drive [deg/s]; infinite after a loss."""
    steering = log[:, LOG_STEERING]
    if not np.isfinite(steering).all():
        return math.inf
    return math.degrees(float(np.sqrt(np.mean(np.diff(steering) ** 2)))) / period


def joining_road(v: float, offset: float) -> Scenario:
    """Return a straight road that is joined from the left, speed [m/s], offset [m]."""
    return straight(v, JOIN_DURATION * max(SLOW / v, 1.0), offset)


def changing_road(subject: Subject, v: float) -> Scenario:
    """Return a lane change at a speed [m/s] that the car can steer."""
    angle = STEERING_SHARE * subject.max_angle
    road = lane_change(v, min(CURVATURE, math.tan(angle) / subject.vehicle.chassis.wheelbase))
    duration = max(road.duration, LANE_CHANGE_START + road.duration * SLOW / v)
    return road._replace(start_offset=0.0, wind=(), duration=duration)


def gusty_road(v: float) -> Scenario:
    """Return a straight road with a gust from the side at a speed [m/s]."""
    begin = replace(GUST, start=2.0, end=2.0 + GUST.end - GUST.start)
    return straight(v, JOIN_DURATION, 0.0)._replace(wind=(begin,))


def disturbances(
    subject: Subject, speeds: Array, threads: int, report: Report
) -> dict[str, list[float]]:
    """Drive with offsets, gust, low friction, noise and cars within the spread.

    Returns:
        Values at each speed by key of `ACCEPTANCE_BOUNDS`.
    """
    car, T = subject.vehicle, subject.period
    within = subject.variations
    slippery, icy = (min(mu, car.tyre.friction) for mu in (CHANGE_FRICTION, JOIN_FRICTION))

    def cases_at(v: float) -> list[Case]:
        change, join = changing_road(subject, v), joining_road(v, LARGE_OFFSET)
        return [
            *(Case(joining_road(v, offset), car) for offset in OFFSETS),
            Case(change, car),
            Case(gusty_road(v), car),
            Case(change, car, friction=slippery),
            Case(join, car, friction=icy),
            Case(change, car, is_noisy=True),
            *(Case(change, v.car, None, v.effect, v.misalignment) for v in within),
            *(Case(join, v.car, None, v.effect, v.misalignment) for v in within),
        ]

    # All drives of all speeds, in the order of `cases_at`
    cases = [case for v in speeds.tolist() for case in cases_at(v)]
    logs = drive_cases(subject, cases, threads, report)
    rows = [logs[i :: len(cases) // len(speeds)] for i in range(len(cases) // len(speeds))]
    join, (change, gust, slip, ice, noise) = rows[: len(OFFSETS)], rows[len(OFFSETS) :][:5]
    spread_change, spread_join = np.array_split(np.arange(len(OFFSETS) + 5, len(rows)), 2)

    def worst(measure: Callable[[Array], float], drives: Sequence[list[Array]]) -> list[float]:
        return [max(map(measure, at)) for at in zip(*drives, strict=True)]

    def rest_of(log: Array) -> float:
        return rest(log, T)

    changed, joined = [rows[i] for i in spread_change], [rows[i] for i in spread_join]
    return {
        "joining_rest": worst(rest_of, join),
        "joining_overshoot": worst(overshoot, join),
        "lane_change": worst(largest_deviation, [change]),
        "gust": worst(largest_deviation, [gust]),
        "friction": worst(largest_deviation, [slip]),
        "friction_rest": worst(rest_of, [ice]),
        "friction_overshoot": worst(overshoot, [ice]),
        "noise": worst(largest_deviation, [noise]),
        "noise_steering_rate": worst(lambda log: steering_rate(log, T), [noise]),
        "spread": worst(largest_deviation, changed),
        "spread_rest": worst(rest_of, joined),
        "spread_overshoot": worst(overshoot, joined),
    }


def time_constants(subject: Subject, speeds: Array) -> dict[str, list[float]]:
    """Compute the time constant of the slowest mode, without and with the estimator [s].

    Args:
        subject: Car and controller.
        speeds: (n,) [m/s].

    Returns:
        Values at each speed by key of `ACCEPTANCE_BOUNDS`.
    """
    car, T = subject.vehicle, subject.period

    def at(v: float, estimator: bool) -> float:
        loop = subject.controller(), car.chassis, car.steering
        return time_constant(spectral_radius(*loop, v, estimator=estimator), T)

    return {
        "loop_time_constant": [at(v, False) for v in speeds.tolist()],
        "estimator_time_constant": [at(v, True) for v in speeds.tolist()],
    }


class GainStepMeter:
    """Controller that measures how much of each command is due to the newest change of the gains.

    Each tick is computed twice from the same state and memory: with the gains of this tick and with
    those of the tick before.
    """

    def __init__(self, controller: CertifiedController) -> None:
        """Wrap a controller before its first step."""
        self.controller, self.period = controller, controller.period
        self.gains: Gains | None = None
        self.steps: list[tuple[float, float]] = []
        """Speed [m/s] and size of each step of the command [rad]."""

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Answer a state, and record the step due to the gains."""
        other = copy.copy(self.controller)
        other.memory = self.controller.memory.copy()
        plan = self.controller.step(state, path)
        gains = gains_in_use(plan)
        if self.gains and gains and gains != self.gains:
            rows = len(other.table.nodes)  # as before: the memory holds the node in use
            other.table = other.table._replace(nodes=np.tile(self.gains, (rows, 1)))
            if isinstance(other, PreviewMpc):
                other.schedule = None
            change = abs(plan.steering - other.step(state, path).steering)
            self.steps.append((state.v_x, change))
        self.gains = gains
        return plan


def gains_in_use(plan: Plan) -> Gains | None:
    """Return the gains of a plan; None where no problem was solved."""
    used = plan.diagnosis
    if math.isnan(used.prediction_horizon):
        return None
    whole = (used.prediction_horizon, used.control_horizon, used.laguerre_terms)
    weights = (used.laguerre_pole, used.output_weight, used.increment_weight)
    return Gains._make((*map(int, whole), *weights))


def ramp(low: float, high: float) -> Scenario:
    """Return a straight road with a speed ramp up and down [m/s]."""
    duration = max((high - low) / RAMP_ACCELERATION, 1.0)
    road = straight(high, 2.0 * duration, 0.0)
    at, speed = np.array([0.0, duration, 2.0 * duration]), np.array([low, high, low])
    return road._replace(speed=SpeedProfile(False, at, speed))


def gain_steps(subject: Subject, speeds: Array, report: Report) -> dict[str, list[float]]:
    """Measure the steps of the lateral acceleration that are due to changes of the gains [m/s^2].

    A ramp up and down through all speeds with measurement noise, which keeps the loop busy. A step
    of the command counts as that of the steady lateral acceleration of its angle.

    Returns:
        Largest step nearest to each speed, by key of `ACCEPTANCE_BOUNDS`.
    """
    road = ramp(float(speeds[0]), float(speeds[-1]))
    noise, rng = load(MeasurementNoise, find("noise", "x1")), np.random.default_rng(NOISE_SEED)
    meter = GainStepMeter(subject.controller())
    drive(Simulation(subject.vehicle, road, noise=noise, rng=rng), meter)
    chassis, largest_step = subject.vehicle.chassis, np.zeros(len(speeds))
    for v, change in meter.steps:
        per_acceleration = cornering_angle(chassis.wheelbase, chassis.understeer_gradient, v, 1.0)
        i = int(np.abs(speeds - v).argmin())
        largest_step[i] = max(largest_step[i], change / per_acceleration)
    report(road.duration)
    return {"gain_step": largest_step.tolist()}
