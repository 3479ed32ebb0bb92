"""The default controller: adaptive MPC that previews the path, with the actuator in its model."""

import math

import numpy as np

from ampc_msgs_config.parameters import (
    MIN_SPEED,
    ChassisParameters,
    ControllerSettings,
    SteeringParameters,
)
from ampc_msgs_config.paths.path import NOT_CAUGHT, Path, advance
from ampc_msgs_config.types import NANOSECONDS, Array, Diagnosis, Plan, VehicleState
from ampc_ros.assumed_car import AssumedCar
from ampc_ros.controller_interface import Controller, Estimates
from ampc_ros.mpc.gain_schedule import CURVATURE_PREVIEW, GainSchedule, Situation, scheduled_gains
from ampc_ros.mpc.gain_table import GainTable, Table
from ampc_ros.mpc.internal_model import (
    ACTUATOR,
    LARGEST_LAG,
    ROW_SIZE,
    InternalModel,
    delayed,
    pack_internal_model,
    unpack_internal_model,
)
from ampc_ros.mpc.qp_solver import scratch_numbers
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.model import unmodelled_accelerations
from ampc_ros.preview.state_filter import LEAST_SHARE, filter_numbers, noise_of
from ampc_ros.preview.tick import (
    ACCELERATION,
    BEFORE,
    DISTURBANCE,
    EXPECTED,
    EXPECTS,
    INDEX,
    LAST_SPEED,
    LEVEL,
    SENT,
    STATE_DELTA,
    call_preview_tick,
    new_memory,
    store_command,
)

SCHEDULE_LAG = 1.0
"""Time constant of scheduled gains: without it the command jumps where a bend comes into view [s].
"""


class PreviewMpc(Controller):
    """Adaptive MPC in path coordinates, the default."""

    formulation = "preview"
    scheduled: tuple[float, float] | None = None
    """Pole and increment weight of the last tick with a learned schedule."""

    def __init__(
        self,
        chassis: ChassisParameters,
        steering: SteeringParameters,
        settings: ControllerSettings,
        table: GainTable,
        base_link_to_cg: float | None = None,
    ) -> None:
        """Create a controller at rest.

        Args:
            chassis: Chassis of the internal model.
            steering: Steering actuator of the internal model: limits, delay, lag.
            settings: Limits and solver.
            table: Gains by speed, or a gain set with a learned schedule.
            base_link_to_cg: Distance from the point that `odom` describes forward to the centre of
                gravity [m]; by default `odom` describes the rear axle.
        """
        row = pack_internal_model(chassis, settings, steering, base_link_to_cg)
        self.model: InternalModel = unpack_internal_model(row)
        vehicle, _, actuator, *_ = self.model
        noise, least_share = noise_of(settings), 0.0 if steering.is_lag_configured else 1.0
        numbers = filter_numbers(vehicle, actuator, settings.sample_time, noise, least_share)
        self.model_row = np.append(row, numbers)
        self.period = settings.sample_time
        self.table, self.schedule = table.table, table.schedule
        unknown = LARGEST_LAG if settings.adaptation else 0.0
        ticks = self.most_ticks = math.ceil((steering.delay + unknown) / self.period - 1e-6)
        self.horizon = max(gains.prediction_horizon for gains in table.nodes) + ticks
        sizes = [(gains.prediction_horizon + ticks, *gains[1:3]) for gains in table.nodes]
        self.scratch = make_scratch(max(scratch_numbers(*size) for size in sizes))
        self.reset()

    def reset(self, steering: float = 0.0) -> None:
        """Discard the history: a constant angle in force [rad], no disturbance, no path."""
        self.memory: Array = new_memory(self.most_ticks)
        self.memory[BEFORE] = self.memory[STATE_DELTA] = steering
        self.memory[SENT:] = steering
        self.path: Path | None = None
        self.last_ns: int | None = None
        if self.schedule:
            self.scheduled = None

    @property
    def estimates(self) -> Estimates:
        """Memory of the controller and the stamp of the last answered state."""
        return Estimates(self.memory, self.last_ns)

    def inherit(self, other: Controller) -> None:
        """Take over disturbance (a number per tick) and acceleration of the same formulation."""
        estimates = other.estimates if other.formulation == self.formulation else None
        if estimates is None:
            return
        ticks, memory = self.period / other.period, estimates.values
        self.memory[DISTURBANCE:EXPECTED] = ticks * memory[DISTURBANCE:EXPECTED]
        if math.isfinite(self.model_row[ROW_SIZE]):  # otherwise there is no filter
            self.memory[LEVEL:BEFORE] = memory[LEVEL:BEFORE]
        for each in (LAST_SPEED, ACCELERATION):
            self.memory[each] = memory[each]
        self.last_ns = estimates.stamp_ns

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""
        return float(self.memory[-1])

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Answer one state; see `preview_tick`.

        Args:
            state: State at `base_link`.
            path: Reference path; a different object counts as a new path, joined at its entry.
        """
        if path is not self.path:
            self.path, self.memory[INDEX] = path, path.entry
        last_ns, self.last_ns = self.last_ns, state.stamp_ns
        elapsed = math.nan if last_ns is None else (state.stamp_ns - last_ns) / NANOSECONDS
        points = np.empty((self.horizon, 3))
        table, outside = self.table, False
        if self.schedule:
            table, outside = self.scheduled_table(self.schedule, state, path)
        gains, scratch = tuple(table), tuple(self.scratch)
        steering, rate, diagnosis = call_preview_tick(
            self.model_row, gains, tuple(path), tuple(state), elapsed, self.memory, scratch, points
        )
        answer = Plan(state.stamp_ns, steering, rate, Diagnosis(*diagnosis))
        if math.isnan(answer.diagnosis.prediction_horizon):
            return answer
        if outside:
            answer = answer._replace(diagnosis=answer.diagnosis._replace(outside_table=1.0))
        H = int(answer.diagnosis.prediction_horizon) + self.model.actuator.ticks
        return answer._replace(prediction=points[:H, :2], angles=points[:H, 2])

    def scheduled_table(
        self, schedule: GainSchedule, state: VehicleState, path: Path
    ) -> tuple[Table, bool]:
        """Return a single node with scheduled gains, and whether the speed is outside their range.

        Where an input is not finite the gains are those of the set. They follow any change with
        SCHEDULE_LAG.
        """
        (ticks, share, lag), v_x, index = self.model.actuator, state.v_x, int(self.memory[INDEX])
        if index == NOT_CAUGHT:
            _, index = advance(path, index, state.x, state.y, state.yaw)
        curvature = curvature_ahead(path, index, CURVATURE_PREVIEW * v_x)
        situation = Situation(v_x, curvature, (ticks + share) * self.period + lag)
        horizon, moves, terms, pole, Q, R = self.table.nodes[0].tolist()
        target = scheduled_gains(schedule, situation) or (pole, R)
        self.scheduled = approach(self.scheduled or target, target, self.period)
        node = (horizon, moves, terms, self.scheduled[0], Q, self.scheduled[1])
        outside = not schedule.speed[0] <= v_x <= schedule.speed[1]
        return self.table._replace(nodes=np.array([node])), outside

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Continue from an angle that another source commanded; see `Controller`."""
        self.memory[EXPECTS] = 0.0
        if stepped:
            self.memory[-1] = steering
        else:
            store_command(self.memory, steering)

    def hold_estimates(self) -> None:
        """Use the next state, which is predicted, without filter, and keep all estimates.

        Its speed is that of an earlier state: no measurement of the acceleration.
        """
        self.memory[EXPECTS], self.last_ns = 0.0, None

    def expect_after(self, ticks: int) -> None:
        """Learn the error of the next state as one of several ticks."""
        if self.memory[EXPECTS]:
            self.memory[EXPECTS] = ticks

    def disturbance(self, v_x: float) -> tuple[float, float]:
        """Return the accelerations of the estimated disturbance [m/s^2, rad/s^2]."""
        change = self.memory[DISTURBANCE:EXPECTED]
        if v_x < MIN_SPEED or not change.any():
            return 0.0, 0.0
        self.scratch.used[0] = 0
        vehicle, T = self.model.vehicle, self.period
        return unmodelled_accelerations(vehicle, v_x, T, change, self.scratch)

    def use_car(self, car: AssumedCar) -> None:
        """Use another chassis, delay and lag, and a least share of the filter."""
        self.model_row[: len(car.vehicle)] = car.vehicle
        self.model_row[ACTUATOR : ACTUATOR + 3] = delayed(*car.response, self.period)
        if math.isfinite(self.model_row[ROW_SIZE]):  # otherwise there is no filter
            self.model_row[ROW_SIZE + LEAST_SHARE] = car.caution
        self.model = unpack_internal_model(self.model_row)

    def distrust_noise(self) -> None:
        """Use the next state without filter."""
        self.memory[LEVEL:BEFORE] = 0.0
        self.model_row[ROW_SIZE + LEAST_SHARE] = 0.0  # until `use_car`

    def observe_steering(self, angle: float) -> None:
        """Replace the road-wheel angle predicted by the model with the measured one [rad].

        The last command may lead the measured angle by what the steering can still turn during one
        tick, its delay and its lag at the largest rate. If the wheel is stuck, the next step starts
        from that bound.
        """
        ticks, share, lag = self.model.actuator
        reach = (1.0 + ticks + share + lag / self.period) * self.model.limits.Delta_u_max
        self.memory[STATE_DELTA] = angle
        self.memory[-1] = min(max(self.steering, angle - reach), angle + reach)


def approach(
    gains: tuple[float, float], target: tuple[float, float], T: float
) -> tuple[float, float]:
    """Return pole and increment weight one tick of T [s] later; the weight in the logarithm."""
    share = -math.expm1(-T / SCHEDULE_LAG)
    (pole, R), (new_pole, new_R) = gains, target
    return pole + share * (new_pole - pole), R * (new_R / R) ** share


def curvature_ahead(path: Path, index: int, distance: float) -> float:
    """Return the largest |curvature| of a path over a distance from a sample [1/m].

    Args:
        path: The path; beyond its end it is straight.
        index: Sample of the last projection, which continues over the laps of a closed path.
        distance: [m].

    Returns:
        nan if the distance is not finite.
    """
    if not math.isfinite(distance):
        return math.nan
    last = len(path.x) - 1
    count = int(min(max(distance / path.spacing, 0.0), last)) + 1
    ahead = np.arange(index, index + count)
    inside = ahead % last if path.closed else ahead[ahead <= last]
    return float(np.abs(path.curvature[inside]).max(initial=0.0))
