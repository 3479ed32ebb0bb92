"""The paper's controller: adaptive MPC with Laguerre increments towards a held set-point."""

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.paths.path import NOT_CAUGHT, Path
from ampc_msgs_config.paths.path_frame import path_frame
from ampc_msgs_config.types import Diagnosis, Plan, VehicleState
from ampc_ros.controller_interface import Controller
from ampc_ros.mpc.gain_table import GainTable
from ampc_ros.mpc.internal_model import InternalModel, believed, internal_model_row
from ampc_ros.mpc.programme import check_conditioning, scratch_numbers
from ampc_ros.mpc.small_matrices import make_scratch
from ampc_ros.paper.tick import INDEX, KNOWN, STEERING, new_memory, paper_answer

Array = NDArray[np.float64]


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
        """Make a controller at rest.

        Args:
            chassis: The car as the controller believes it to be.
            settings: Limits and solver.
            table: Gains by speed and lateral reference.
            base_link_to_cg: From the point that `odom` describes forward to the centre of gravity
                [m]; by default `odom` describes the rear axle.

        Raises:
            ValueError: A gain set makes the problem numerically singular.
        """
        self.numbers = internal_model_row(chassis, settings, None, base_link_to_cg)
        self.belief: InternalModel = believed(self.numbers)
        self.period = settings.sample_time
        self.table = table.table
        for gains in table.nodes:
            check_conditioning(self.belief.vehicle, gains, self.belief.limits)
        self.scratch = make_scratch(max(scratch_numbers(*gains[:3]) for gains in table.nodes))
        self.moves = max(gains.control_horizon for gains in table.nodes)
        self.reset()

    def reset(self, steering: float = 0.0) -> None:
        """Forget all earlier steps: the angle in force is given, no increment known, no path."""
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
            state: At `base_link`.
            path: The reference; another object is taken as another path.

        Raises:
            ValueError: The path is no graph over its chord.
        """
        if path is not self.path:
            self._take_path(path)
        table, scratch, angles = tuple(self.table), tuple(self.scratch), np.empty(self.moves)
        steering, rate, diagnosis = paper_answer(
            self.numbers, table, self.road, tuple(state), self.memory, scratch, angles
        )
        answer = Plan(state.stamp_ns, steering, rate, Diagnosis(*diagnosis))
        return answer._replace(angles=angles[: int(answer.diagnosis.control_horizon)])

    def check(self, path: Path) -> None:
        """Refuse what `step` would refuse.

        Raises:
            ValueError: The path is no graph over its chord.
        """
        path_frame(path)

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Go on from an angle that was commanded by somebody else; see `Controller`."""
        self.memory[STEERING] = steering
        if not stepped:
            self.memory[KNOWN] = 0.0  # the next increment of the state would span two ticks

    def _take_path(self, path: Path) -> None:
        """Follow a new path: new inertial frame, increments start anew, the angle is kept."""
        self.road, self.path = (tuple(path), tuple(path_frame(path))), path
        self.memory[KNOWN], self.memory[INDEX] = 0.0, NOT_CAUGHT
