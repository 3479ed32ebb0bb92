"""One supervised drive with wrong, late, noisy or missing states, and its true error.

The car advances in steps of 50 ms or of the controller's period. At each tick the newest state that
has arrived is delivered with its own stamp, and the supervisor answers, as in the node.
"""

import math
from contextlib import suppress
from dataclasses import astuple, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.scenarios.scenario import (
    POINT_SPACING,
    Scenario,
    SpeedPlanner,
    SpeedProfile,
    load_scenario,
    run_out,
)
from ampc_msgs_config.types import NANOSECONDS, WARN, Array, VehicleState
from ampc_ros.configuration import Choices, Configuration, configuration
from ampc_ros.supervision.health import health
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.measurement import Deviations, noisy
from sim_vehicle.parameters import MeasurementNoise, Vehicle, load_vehicle_file
from tests.supervised import Distortion, Fault, never, undistorted
from tests.workshop.acceptance.independent_plant import Disturbance, assumed_parameters
from tests.workshop.acceptance.trials import INDEPENDENT
from tests.workshop.leaderboard.fast_plant import FastSimulation

STEP = 0.05
"""Longest time between two samples of a drive [s]."""
SERVO_LAG = 0.05
"""Lag of the steering servo of the independent car [s]."""
SETTINGS = {
    10: ("table3", "preview"),
    50: ("50hz", "preview_50hz"),
    100: ("100hz", "preview_100hz"),
}
"""Settings and gains by rate of the controller [Hz]."""
MOTORWAY = "lane change of 5 s"
MOTORWAY_SPEED, LANE, CHANGE_TIME = 36.0, 3.5, 5.0
"""Speed [m/s], width [m] and duration [s] of that lane change."""
BEFORE_CHANGE, AFTER_CHANGE = 3.0, 5.0
"""Time on the straight road before and after it [s]."""
BRAKING = 2.0
"""Deceleration of a driver who obeys a stop request [m/s^2]."""
TURNING = 0.08
"""Yaw rate from which a car counts as turning [rad/s]."""


class StateTrial(NamedTuple):
    """Road, car, and what happens to its actuator and to its states."""

    road: str
    """Shipped scenario, or MOTORWAY."""
    car: str
    """Name of a shipped vehicle, or `independent`."""
    speed: float | None = None
    """Speed that replaces that of the scenario [m/s]."""
    hz: int = 10
    delay: float = 0.0
    """Delay of the actuator [s]."""
    lag: float = 0.0
    """Lag of the actuator [s]."""
    configured: bool = True
    """Whether rate, delay and lag of the actuator are configured."""
    friction: float | None = None
    """Friction of the road; on the independent car a factor on that of its tyres."""
    late: float = 0.0
    """Age of the odometry when it arrives [s]."""
    seed: int | None = None
    """Seed of the measurement noise `x1`; None: no noise."""

    def __str__(self) -> str:
        """Return the description in tables."""
        parts = [f"{self.road}, {self.car} car"]
        if self.speed is not None:
            parts.append(f"{self.speed:g} m/s")
        for value, name in ((self.delay, "delay"), (self.lag, "lag")):
            if value:
                parts.append(f"{name} {1000 * value:g} ms")
        if self.friction is not None:
            parts.append(f"friction {self.friction:g}")
        if self.seed is not None:
            parts.append(f"seed {self.seed}")
        return ", ".join(parts)

    @property
    def vehicle(self) -> Vehicle:
        """The true car."""
        if self.car != "independent":
            vehicle = load_vehicle_file(find("vehicles", self.car))
            steering = replace(vehicle.steering, delay=self.delay, lag=self.lag)
            return vehicle._replace(steering=steering)
        chassis, steering = assumed_parameters(INDEPENDENT)
        steering = replace(steering, delay=self.delay, lag=self.lag)
        ordinary = load_vehicle_file(find("vehicles", "ordinary"))
        return ordinary._replace(chassis=chassis, steering=steering)

    @property
    def config(self) -> Configuration:
        """Configuration of the controller."""
        settings, gains = SETTINGS[self.hz]
        own = self.car != "independent"
        known, table = (self.car, "") if own and self.hz == 10 else ("ordinary", gains)
        choices = Choices("preview", known, settings, table, guard="track", static_path=True)
        vehicle = self.vehicle
        steering = vehicle.steering
        if not self.configured:
            steering = SteeringParameters(max_angle=steering.max_angle)
        chassis = vehicle.chassis
        return loaded(choices)._replace(
            chassis=chassis, steering=steering, base_link_to_cg=chassis.cg_to_rear_axle
        )

    @property
    def scenario(self) -> Scenario:
        """The road."""
        if self.road == MOTORWAY:
            return motorway()
        scenario = load_scenario(self.road, self.vehicle.size, self.speed)
        return scenario._replace(start_offset=0.0)

    def plant(self, road: Scenario) -> Simulation | FastSimulation:
        """Return the car at the start of the road."""
        if self.car != "independent":
            return Simulation(self.vehicle, road, friction=self.friction)
        friction = 1.0 if self.friction is None else self.friction
        disturbance = Disturbance(self.delay, friction, servo_lag=self.lag)
        return FastSimulation(road, INDEPENDENT, disturbance)


@cache
def loaded(choices: Choices) -> Configuration:
    """Return the configuration of these choices."""
    return configuration(choices)


@cache
def deviations() -> Deviations:
    """Return the measurement noise `x1`."""
    return Deviations(*astuple(load(MeasurementNoise, find("noise", "x1"))))


def noise(seed: int | None, steps: int) -> Array:
    """Return standard normal numbers of all samples (steps, 6); without seed: zeros."""
    if seed is None:
        return np.zeros((steps, 6))
    return np.random.default_rng(seed).standard_normal((steps, 6))


@cache
def motorway() -> Scenario:
    """Return a lane change along a quintic polynomial of time at constant speed."""
    v, duration = MOTORWAY_SPEED, BEFORE_CHANGE + CHANGE_TIME + AFTER_CHANGE
    x = np.arange(0.0, v * duration + run_out(v), POINT_SPACING, dtype=np.float64)
    y = LANE * q((x - v * BEFORE_CHANGE) / (v * CHANGE_TIME))
    constant = SpeedProfile(False, np.zeros(1), np.full(1, v))
    return Scenario(MOTORWAY, np.column_stack([x, y]), constant, duration)


class StateDrive(NamedTuple):
    """A finished drive, one sample for each step."""

    period: float
    """Time between two samples [s]."""
    error: Array
    """True cross-track error of the centre of gravity (n,) [m]."""
    steering: Array
    """Commanded angle (n,) [rad]."""
    acceleration: Array
    """True v r (n,) [m/s^2]."""
    turning: Array
    """Time of turning so far (n,) [s]."""
    warnings: tuple[str, ...]
    """First sentence of `/diagnostics` about odometry, empty: none (n,)."""

    @property
    def max(self) -> float:
        """Largest error [m]."""
        return self.largest(0.0)

    def largest(self, begin: float) -> float:
        """Return the largest error from a time [s] on; negative: from the end."""
        first = round(begin / self.period)
        return float(np.abs(self.error[first:]).max())

    @property
    def activity(self) -> float:
        """RMS change of the commanded angle in 0.1 s [deg]."""
        tenth = round(0.1 / self.period)
        change = self.steering[tenth:] - self.steering[:-tenth]
        return math.degrees(math.sqrt(float(np.mean(change**2))))

    def is_warned(self, turning: float) -> bool:
        """Return whether odometry was warned about within a time of turning [s]."""
        return any(w for w, t in zip(self.warnings, self.turning, strict=True) if t <= turning)


def drive(
    trial: StateTrial,
    *,
    distort: Distortion = undistorted,
    blind: Fault = never,
    brakes: bool = False,
    end: float = math.inf,
) -> StateDrive:
    """Drive a trial to its end, or until the car is lost.

    Args:
        trial: Road, car, delays and noise.
        distort: What odometry makes of a measured state.
        blind: When no state arrives.
        brakes: Whether the driver obeys a stop request; otherwise it is ignored.
        end: Time at which the drive ends [s].
    """
    road, supervisor = trial.scenario, Supervisor(trial.config)
    car, planner, along = trial.plant(road), SpeedPlanner(road), Progress(road.path)
    to_cg = trial.vehicle.chassis.cg_to_rear_axle
    step = min(supervisor.period, STEP)
    step_ns, every = round(step * NANOSECONDS), round(supervisor.period / step)
    steps, age = round(min(road.duration, end) / step), round(trial.late / step)
    normal = noise(trial.seed, steps)
    supervisor.take_path(road.points, NANOSECONDS, NANOSECONDS)
    rows, warnings = list[tuple[float, float, float, float]](), list[str]()
    arrived, turning, sentence, target = list[VehicleState](), 0.0, "", math.inf
    for number in range(steps):
        # True state and its error
        t, now_ns = number * step, NANOSECONDS + number * step_ns
        true = car.car.measure(now_ns)
        error = along.errors(at_distance(true, to_cg))[0]
        turning += step * (abs(true.yaw_rate) >= TURNING)

        # The newest state that has arrived, and the answer
        arrived.append(as_received(noisy(distort(true, t), deviations(), normal[number])))
        if number % every == 0 and number >= age:
            if not blind(t):
                with suppress(ValueError):  # rejected after a long gap, until others confirm it
                    supervisor.take_state(arrived[number - age], now_ns)
            record = supervisor.tick(now_ns)
            level, sentence = health(supervisor, record, now_ns)
            sentence = sentence if level == WARN and "odom: " in sentence else ""
        warnings.append(sentence)
        rows.append((error, supervisor.steering, true.v_x * true.yaw_rate, turning))
        if abs(error) > LOST:
            break

        # The driver
        wanted = planner.target_speed(true)
        if brakes and supervisor.stop_requested:
            target = max(min(target, true.v_x) - BRAKING * step, 0.0)
            wanted = min(wanted, target)
        car.advance(supervisor.steering, wanted, step_ns)
    errors, steering, acceleration, turns = np.array(rows).T
    return StateDrive(step, errors, steering, acceleration, turns, tuple(warnings))
