"""The paper's controller: adaptive MPC with Laguerre increments towards a held set-point."""

import numpy as np

from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_frame import path_frame
from ampc_msgs_config.types import Array, Diagnosis, Plan, VehicleState
from ampc_ros.controller_interface import Controller
from ampc_ros.mpc.gain_table import GainTable
from ampc_ros.mpc.internal_model import InternalModel, pack_internal_model, unpack_internal_model
from ampc_ros.mpc.qp_solver import scratch_numbers
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.paper.qp_assembly import check_conditioning
from ampc_ros.paper.tick import (
    HAS_LAST,
    INDEX,
    STEERING,
    call_paper_tick,
    new_memory,
)


class LateralMpc(Controller):
    """Adaptive MPC of the paper; with a nominal speed set, the classic MPC it is compared with."""

    formulation = "paper"

    def __init__(
        self,
        chassis: ChassisParameters,
        settings: ControllerSettings,
        table: GainTable,
        base_link_to_cg: float | None = None,
    ) -> None:
        """Create a controller at rest.

        Args:
            chassis: Chassis of the internal model.
            settings: Limits and solver.
            table: Gains by speed and lateral reference.
            base_link_to_cg: Distance from the point that `odom` describes forward to the centre of
                gravity [m]; by default `odom` describes the rear axle.

        Raises:
            ValueError: A gain set makes the problem numerically singular, or there is a schedule.
        """
        if table.schedule:
            raise ValueError("schedule: only the controller preview has a learned schedule")
        self.model_row = pack_internal_model(chassis, settings, None, base_link_to_cg)
        self.model: InternalModel = unpack_internal_model(self.model_row)
        self.period = settings.sample_time
        self.table = table.table
        for gains in table.nodes:
            check_conditioning(self.model.vehicle, gains, self.model.limits)
        self.scratch = make_scratch(max(scratch_numbers(*gains[:3]) for gains in table.nodes))
        self.moves = max(gains.control_horizon for gains in table.nodes)
        self.reset()

    def reset(self, steering: float = 0.0) -> None:
        """Discard the history: set the angle in force [rad], no last state, no path."""
        self.memory: Array = new_memory()
        self.memory[STEERING] = steering
        self.path: Path | None = None

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""
        return float(self.memory[STEERING])

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Answer one state; see `paper_tick`.

        Args:
            state: State at `base_link`.
            path: Reference path; a different object counts as a new path, joined at its entry.

        Raises:
            ValueError: The path is no graph over its chord.
        """
        if path is not self.path:
            self._take_path(path)
        table, scratch, angles = tuple(self.table), tuple(self.scratch), np.empty(self.moves)
        steering, rate, diagnosis = call_paper_tick(
            self.model_row, table, self.road, tuple(state), self.memory, scratch, angles
        )
        answer = Plan(state.stamp_ns, steering, rate, Diagnosis(*diagnosis))
        return answer._replace(angles=angles[: int(answer.diagnosis.control_horizon)])

    def check(self, path: Path) -> None:
        """Check a path as `step` would.

        Raises:
            ValueError: The path is no graph over its chord.
        """
        path_frame(path)

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Continue from an angle that another source commanded; see `Controller`."""
        self.memory[STEERING] = steering
        if not stepped:
            self.memory[HAS_LAST] = 0.0  # the next increment of the state would span two ticks

    def _take_path(self, path: Path) -> None:
        """Follow a new path: new inertial frame, no last state; the angle in force is kept."""
        self.road, self.path = (tuple(path), tuple(path_frame(path))), path
        self.memory[HAS_LAST], self.memory[INDEX] = 0.0, path.entry
