"""Base class of every steering controller, with defaults for the optional parts."""

from typing import NamedTuple

from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.types import Array, Plan, VehicleState
from ampc_ros.assumed_car import AssumedCar


class Estimates(NamedTuple):
    """Estimates of a controller that survive a change of its configuration."""

    values: Array
    """Numbers in an order defined by the formulation."""
    stamp_ns: int | None
    """Stamp of the last answered state [ns]; None: no state was answered."""


class Controller:
    """Computes one plan per state."""

    formulation = ""
    """Kind of control law: `preview`, `paper`, `pure_pursuit` or `custom`."""
    period: float
    """Time from one step to the next [s]."""
    failure = ""
    """Reason why the last step has no result, in one line; empty: it has one."""

    @property
    def estimates(self) -> Estimates | None:
        """Estimates for `inherit`; by default there are none."""
        return None

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""
        raise NotImplementedError

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Compute the plan for a state at `base_link`."""
        raise NotImplementedError

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Continue from an angle commanded by the guard or by a fallback.

        Args:
            steering: Angle in force [rad].
            stepped: Whether the controller stepped in this tick.
        """
        raise NotImplementedError

    def reset(self, steering: float = 0.0) -> None:
        """Forget all earlier steps; `steering` is the angle in force [rad]."""
        raise NotImplementedError

    def check(self, path: Path) -> None:
        """Raise a ValueError for a path on which `step` would raise one; by default none."""

    def observe_steering(self, angle: float) -> None:
        """Use a measured road-wheel angle [rad]; by default it is ignored."""

    def hold_estimates(self) -> None:
        """Keep all estimates in the next step, whose state is predicted; by default none exist."""

    def expect_after(self, ticks: int) -> None:
        """Expect the next state to be the first measured one for some ticks; see `PreviewMpc`."""

    def disturbance(self, v_x: float) -> tuple[float, float]:
        """Return the accelerations beyond the model at a speed [m/s^2, rad/s^2]; by default 0."""
        return 0.0, 0.0

    def use_car(self, car: AssumedCar) -> None:
        """Use another car in the model, which has been estimated; by default it is ignored."""

    def distrust_noise(self) -> None:
        """Expect other noise than configured in the next state; by default it is ignored."""

    def inherit(self, other: "Controller") -> None:
        """Use the estimates of a controller of the same formulation; by default there are none."""
