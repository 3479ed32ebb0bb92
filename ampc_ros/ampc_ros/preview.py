"""The controller that drives cars: adaptive MPC on the path ahead, actuator in its model."""

import math
from dataclasses import astuple

import numpy as np

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.path import Array, Path, Progress, curvature_between, errors_at, point_at
from ampc_msgs_config.types import (
    NANOSECONDS,
    PATH_END,
    REVERSE,
    STANDSTILL,
    TRACKING,
    WRONG_WAY,
    Command,
    Diagnosis,
    VehicleState,
    at_distance,
)
from ampc_ros.gain_table import GainTable
from ampc_ros.lateral_mpc import Limits, limits_of
from ampc_ros.model import Vehicle
from ampc_ros.preview_model import (
    DELTA,
    STATES,
    Actuator,
    actuator_of,
    sampled_model,
    side_acceleration,
    steady_steering,
)
from ampc_ros.preview_mpc import Past, Road, preview_plan
from ampc_ros.qp import SOLVED
from ampc_ros.small_matrices import apply

HOLD_BELOW = 0.3
"""Below this speed the steering holds [m/s]."""
REVERSE_BELOW = -0.3
"""Below this speed the car drives backwards, which this controller refuses to steer; a standing
car with noise does not [m/s]."""
LEARN_ABOVE = 1.5
"""Speed from which the disturbance is learnt: below it the model is not the car's [m/s]."""
DISTURBANCE_GAIN = np.array([0.3, 0.05, 0.3, 0.05, 0.3])
"""Share of a new residual that enters the estimate in a tick, by state."""
MAX_DISTURBANCE = np.array([3.0, 0.05, 1.5, 0.5, 0.0])
"""Largest disturbance: what is more is a skid, and no wind [unit of the state / s]."""
ACCELERATION_GAIN = 0.3
"""Share of a new difference of speeds that enters the estimated acceleration in a tick."""
ACCELERATION_FADE = 1.0
"""Time constant with which the acceleration is expected to fade [s]."""


@compiled
def road_ahead(path: Path, s: float, v_x: float, a_x: float, T: float, H: int) -> Road:
    """Speeds and mean curvatures of the horizon, from one tick back to H ticks ahead.

    Args:
        path: The reference.
        s: Arc length of the car [m].
        v_x: Speed now [m/s].
        a_x: Acceleration now; it is expected to fade [m/s^2].
        T: Step [s].
        H: Steps.
    """
    speed, curvature = np.empty(H + 1), np.empty(H + 1)
    speed[0] = v_x
    curvature[0] = curvature_between(path, s - v_x * T, s)
    for j in range(H):
        gained = a_x * ACCELERATION_FADE * (1.0 - math.exp(-(j + 0.5) * T / ACCELERATION_FADE))
        speed[j + 1] = max(v_x + gained, 0.0)
        curvature[j + 1] = curvature_between(path, s, s + speed[j + 1] * T)
        s += speed[j + 1] * T
    return Road(speed, curvature)


@compiled
def predicted_points(path: Path, s: float, speed: Array, lateral: Array, T: float) -> Array:
    """Where the car is expected at each step of the horizon, (H, 2) in `map` [m]."""
    points = np.empty((len(lateral), 2))
    for j in range(len(lateral)):
        s += speed[j + 1] * T
        point = point_at(path, s)
        points[j, 0] = point.x - lateral[j] * math.sin(point.heading)
        points[j, 1] = point.y + lateral[j] * math.cos(point.heading)
    return points


class PreviewMpc:
    """Adaptive MPC in path coordinates, the default."""

    def __init__(
        self,
        chassis: ChassisParameters,
        steering: SteeringParameters,
        settings: ControllerSettings,
        table: GainTable,
        base_link_to_cg: float | None = None,
    ) -> None:
        """Make a controller at rest.

        Args:
            chassis: The car as the controller believes it to be.
            steering: Its actuator: limits, delay, lag.
            settings: Limits and solver.
            table: Gains by speed.
            base_link_to_cg: From the point that `odom` describes forward to the centre of gravity
                [m]; by default `odom` describes the rear axle.
        """
        self.vehicle: Vehicle = astuple(chassis)
        self.to_cg = chassis.cg_to_rear_axle if base_link_to_cg is None else base_link_to_cg
        self.period = settings.sample_time
        self.limits: Limits = limits_of(settings, steering)
        self.actuator: Actuator = actuator_of(steering, self.period)
        self.table = table
        self.reset()

    def reset(self) -> None:
        """Forget all earlier steps: no command, no disturbance, no path."""
        self.sent: Array = np.zeros(self.actuator.ticks + 1)
        self.disturbance: Array = np.zeros(STATES)
        self.acceleration = 0.0
        self.path: Path | None = None
        self.last: VehicleState | None = None
        self.expected: Array | None = None
        self.before = 0.0
        self.delta = 0.0
        self.table.reset()

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""
        return float(self.sent[-1])

    def step(self, state: VehicleState, path: Path) -> Command:
        """Answer one state: place on the path, what the last tick taught, gains, road, plan.

        Args:
            state: At `base_link`.
            path: The reference; another object is taken as another path, without a jump.
        """
        car = at_distance(state, self.to_cg)
        if path is not self.path:
            self.path, self.progress = path, Progress(path)
        s = self.progress.advance(car.x, car.y, car.yaw)
        e_y, e_psi = errors_at(path, s, car.x, car.y, car.yaw)
        x = np.array([car.v_y, math.sin(e_psi), car.yaw_rate, e_y, self.delta])
        self._learn(car, x)
        diagnosis = self._place(path, s, car, (e_y, e_psi))
        if diagnosis.mode not in (TRACKING, PATH_END):
            self._send(self.steering)
            self.expected = None
            return Command(car.stamp_ns, self.steering, 0.0, diagnosis)
        gains, outside = self.table.lookup(car.v_x)
        H = gains.prediction_horizon + self.actuator.ticks
        road = road_ahead(path, s, car.v_x, self.acceleration, self.period, H)
        past = Past(x, self.sent, self.disturbance)
        plan = preview_plan(self.vehicle, self.actuator, gains, self.limits, past, road)
        rate = self._send(plan.steering)
        self._expect(x, road)
        diagnosis = diagnosis._replace(
            active_constraints=plan.active,
            slack=plan.slack,
            solver_iterations=plan.iterations,
            converged=plan.status == SOLVED,
            outside_table=outside,
            **gains._asdict(),
        )
        points = predicted_points(path, s, road.speed, plan.lateral, self.period)
        return Command(car.stamp_ns, self.steering, rate, diagnosis, points)

    def observe_steering(self, angle: float) -> None:
        """Take the measured road-wheel angle [rad] in place of the one that the model expects.

        A command may be ahead of it by what the steering still has to do: one tick, delay and lag
        at the largest rate. Where the wheel is held or stuck, the next step starts from there.
        """
        self.delta = angle
        behind = 1.0 + self.actuator.ticks + self.actuator.share + self.actuator.lag / self.period
        reach = behind * self.limits.Delta_u_max
        self.sent[-1] = min(max(self.steering, angle - reach), angle + reach)

    def _place(
        self, path: Path, s: float, car: VehicleState, errors: tuple[float, float]
    ) -> Diagnosis:
        """Say where the car is, and whether it can be steered along the path."""
        curvature = point_at(path, s).curvature
        mode = TRACKING if path.closed or s <= path.length else PATH_END
        if car.v_x < HOLD_BELOW:
            mode = STANDSTILL if car.v_x > REVERSE_BELOW else REVERSE
        elif abs(errors[1]) > math.pi / 2:
            mode = WRONG_WAY
        return Diagnosis(
            cross_track_error=errors[0],
            heading_error=errors[1],
            curvature=curvature,
            feed_forward=steady_steering(self.vehicle, car.v_x, curvature),
            disturbance=side_acceleration(self.vehicle, car.v_x, self.period, self.disturbance),
            mode=mode,
        )

    def _learn(self, car: VehicleState, x: Array) -> None:
        """Update disturbance and acceleration by what the last tick should have brought."""
        last, self.last = self.last, car
        if last is None:
            return
        elapsed = (car.stamp_ns - last.stamp_ns) / NANOSECONDS
        if not 0.5 * self.period < elapsed < 1.5 * self.period:
            self.expected = None
            return
        change = (car.v_x - last.v_x) / elapsed
        self.acceleration += ACCELERATION_GAIN * (change - self.acceleration)
        if self.expected is not None:
            slow = car.v_x < LEARN_ABOVE
            residual = np.zeros(STATES) if slow else x - self.expected
            self.disturbance += DISTURBANCE_GAIN * (residual - self.disturbance)
            bound = MAX_DISTURBANCE * self.period
            self.disturbance = np.clip(self.disturbance, -bound, bound)

    def _expect(self, x: Array, road: Road) -> None:
        """Note the state that the model, without disturbance, expects at the next tick."""
        A, B_old, B_new, D = sampled_model(self.vehicle, road.speed[0], self.period, self.actuator)
        older, old = self.before, self.sent[-1 - self.actuator.ticks]
        self.expected = apply(A, x) + B_old * older + B_new * old + D * road.curvature[1]
        self.delta = float(self.expected[DELTA])

    def _send(self, steering: float) -> float:
        """Remember a command; gives its rate [rad/s]."""
        before = self.steering
        self.before = float(self.sent[0])
        self.sent = np.append(self.sent[1:], steering)
        return (steering - before) / self.period
