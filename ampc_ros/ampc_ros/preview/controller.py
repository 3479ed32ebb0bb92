"""The controller that drives cars: adaptive MPC on the path ahead, actuator in its model."""

import math

import numpy as np

from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.paths.path import NOT_CAUGHT, Array, Path
from ampc_msgs_config.types import NANOSECONDS, Diagnosis, Plan, VehicleState
from ampc_ros.controller_interface import Controller, Estimates
from ampc_ros.mpc.gain_table import GainTable
from ampc_ros.mpc.internal_model import InternalModel, believed, internal_model_row
from ampc_ros.mpc.programme import scratch_numbers
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.preview.tick import (
    ACCELERATION,
    BEFORE,
    DISTURBANCE,
    EXPECTED,
    EXPECTS,
    INDEX,
    LAST_SPEED,
    SENT,
    STATE_DELTA,
    new_memory,
    preview_answer,
    send,
)


class PreviewMpc(Controller):
    """Adaptive MPC in path coordinates, the default."""

    formulation = "preview"

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
        self.numbers = internal_model_row(chassis, settings, steering, base_link_to_cg)
        self.belief: InternalModel = believed(self.numbers)
        self.period = settings.sample_time
        self.table = table.table
        ticks = self.belief.actuator.ticks
        self.horizon = max(gains.prediction_horizon for gains in table.nodes) + ticks
        sizes = [(gains.prediction_horizon + ticks, *gains[1:3]) for gains in table.nodes]
        self.scratch = make_scratch(max(scratch_numbers(*size) for size in sizes))
        self.reset()

    def reset(self, steering: float = 0.0) -> None:
        """Forget all earlier steps: one angle was always in force, no disturbance, no path."""
        self.memory: Array = new_memory(self.belief.actuator.ticks)
        self.memory[BEFORE] = self.memory[STATE_DELTA] = steering
        self.memory[SENT:] = steering
        self.path: Path | None = None
        self.last_ns: int | None = None

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
            state: At `base_link`.
            path: The reference; another object is taken as another path, without a jump.
        """
        if path is not self.path:
            self.path, self.memory[INDEX] = path, NOT_CAUGHT
        last_ns, self.last_ns = self.last_ns, state.stamp_ns
        elapsed = math.nan if last_ns is None else (state.stamp_ns - last_ns) / NANOSECONDS
        points = np.empty((self.horizon, 3))
        table, scratch = tuple(self.table), tuple(self.scratch)
        steering, rate, diagnosis = preview_answer(
            self.numbers, table, tuple(path), tuple(state), elapsed, self.memory, scratch, points
        )
        answer = Plan(state.stamp_ns, steering, rate, Diagnosis(*diagnosis))
        if math.isnan(answer.diagnosis.prediction_horizon):
            return answer
        H = int(answer.diagnosis.prediction_horizon) + self.belief.actuator.ticks
        return answer._replace(prediction=points[:H, :2], angles=points[:H, 2])

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Go on from an angle that was commanded by somebody else; see `Controller`."""
        self.memory[EXPECTS] = 0.0
        if stepped:
            self.memory[-1] = steering
        else:
            send(self.memory, steering)

    def observe_steering(self, angle: float) -> None:
        """Take the measured road-wheel angle [rad] in place of the one that the model expects.

        A command may be ahead of it by what the steering still has to do: one tick, delay and lag
        at the largest rate. Where the wheel is held or stuck, the next step starts from there.
        """
        ticks, share, lag = self.belief.actuator
        reach = (1.0 + ticks + share + lag / self.period) * self.belief.limits.Delta_u_max
        self.memory[STATE_DELTA] = angle
        self.memory[-1] = min(max(self.steering, angle - reach), angle + reach)
