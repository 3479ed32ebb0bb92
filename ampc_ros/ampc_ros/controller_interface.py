"""Interface of every steering controller, with defaults for its optional parts."""

from typing import NamedTuple, Protocol

from ampc_msgs_config.paths.path import Array, Path
from ampc_msgs_config.types import Plan, VehicleState


class Estimates(NamedTuple):
    """Estimates of a controller that survive a change of its configuration."""

    values: Array
    """Numbers in an order defined by the formulation."""
    stamp_ns: int | None
    """Stamp of the last answered state [ns]; None: no state was answered."""


class Controller(Protocol):
    """Computes one plan per state."""

    formulation: str
    """Kind of control law: `preview`, `paper`, `pure_pursuit` or `custom`."""
    period: float
    """Time from one step to the next [s]."""

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""

    @property
    def failure(self) -> str:
        """Reason why the last step has no result, in one line; empty: it has one."""

    @property
    def estimates(self) -> Estimates | None:
        """Estimates for `inherit`; None: the controller has none."""

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Compute the plan for a state at `base_link`."""

    def check(self, path: Path) -> None:
        """Raise a ValueError for a path on which `step` would raise one."""

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Continue from an angle commanded by the guard or by a fallback.

        Args:
            steering: Angle in force [rad].
            stepped: Whether the controller made a step in this tick.
        """

    def reset(self, steering: float = 0.0) -> None:
        """Forget all earlier steps; `steering` is the angle in force [rad]."""

    def observe_steering(self, angle: float) -> None:
        """Use a measured road-wheel angle [rad]."""

    def inherit(self, other: "Controller") -> None:
        """Take over the estimates of a controller of the same formulation."""


class ControllerDefaults:
    """Optional parts of a Controller: any path, no measured angle, no estimates."""

    formulation = ""
    failure = ""

    @property
    def estimates(self) -> Estimates | None:
        """None: there are no estimates."""
        return None

    def check(self, path: Path) -> None:
        """Accept any path."""

    def observe_steering(self, angle: float) -> None:
        """Ignore the measured angle."""

    def inherit(self, other: Controller) -> None:
        """Start without estimates."""
