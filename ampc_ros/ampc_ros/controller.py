"""Controllers by name, behind one `step()`."""

import math
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, Protocol

from ampc_msgs_config.config import find, load, shipped
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.path import Path
from ampc_msgs_config.path_making import make_path
from ampc_msgs_config.types import NANOSECONDS, Command, VehicleState
from ampc_ros.gain_table import load_gain_table
from ampc_ros.lateral_mpc import LateralMpc
from ampc_ros.preview import PreviewMpc
from ampc_ros.pure_pursuit import PurePursuit

CONTROLLERS = {
    "preview": "adaptive MPC on the path ahead, with the actuator in its model",
    "paper": "adaptive MPC of the paper, model at the measured speed",
    "classic": "the same MPC with its model fixed at a nominal speed",
    "pure_pursuit": "geometric baseline on the rear axle",
}
DEFAULT_TABLES = {"preview": "preview", "paper": "table3", "classic": "table3"}
"""Gains that hold for any car; `default_table` knows better ones."""
CLASSIC_SPEED = 9.0
"""Speed at which the classic MPC's model stays, that of the paper's Sc1 [m/s]."""

STRAIGHT = [(0.0, 0.0), (50.0, 0.0)]
CIRCLE = [(30.0 * math.sin(0.1 * i), 30.0 - 30.0 * math.cos(0.1 * i)) for i in range(63)]
REHEARSAL = (
    (0.0, 0.1, 0.0, 9.0, 0.0, 0.0),
    (1.0, 0.1, 0.0, 9.0, 0.1, 0.01),
    (2.0, -6.0, 0.3, 35.0, -0.5, -0.2),
    (3.0, 6.0, -0.3, 2.0, 0.5, 0.2),
    (60.0, 0.1, 0.0, 9.0, 0.0, 0.0),
    (0.0, 500.0, 0.0, 9.0, 0.0, 0.0),
    (0.0, 0.1, math.pi, 9.0, 0.0, 0.0),
    (0.0, 0.1, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.1, 0.0, -1.0, 0.0, 0.0),
)
"""States to warm up with: x, y, yaw, v_x, v_y, yaw rate."""


class Controller(Protocol):
    """What every controller offers: one command for one state, and a fresh start."""

    period: float
    """Time from one step to the next [s]."""

    @property
    def steering(self) -> float:
        """Angle commanded last [rad]."""

    def step(self, state: VehicleState, path: Path) -> Command:
        """Answer a state at `base_link`."""

    def check(self, path: Path) -> None:
        """Refuse, with a ValueError, a path on which `step` would."""

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Go on from an angle that was commanded by somebody else, a guard or a fall-back.

        Args:
            steering: In force now [rad].
            stepped: Whether it came in place of what the last step answered, or in a tick that
                had no step.
        """

    def reset(self) -> None:
        """Forget all earlier steps."""


class Choices(NamedTuple):
    """What a user chooses, by shipped names or files."""

    controller: str = "preview"
    vehicle: str = "paper"
    settings: str = "table3"
    gain_table: str = ""
    """Empty: see `default_table`."""
    base_link_to_cg: float | None = None
    """From the point that `odom` describes to the centre of gravity [m]; None: the rear axle."""


def default_table(controller: str, vehicle: str) -> str:
    """Give the shipped gains for a vehicle: `preview_paper` where they are tuned for that one."""
    name = DEFAULT_TABLES[controller]
    tuned = f"{name}_{vehicle}"
    return tuned if vehicle in shipped("vehicles") and tuned in shipped("gains") else name


def make_controller(choices: Choices) -> Controller:
    """Make the controller that a user chose.

    Raises:
        ValueError: A name is unknown, or a file is missing or wrong.
    """
    chassis = load(ChassisParameters, find("vehicles", choices.vehicle), "chassis")
    settings = load(ControllerSettings, find("controllers", choices.settings))
    if choices.controller == "pure_pursuit":
        return PurePursuit(chassis, settings, choices.base_link_to_cg)
    if choices.controller not in CONTROLLERS:
        known = ", ".join(CONTROLLERS)
        raise ValueError(f"controller = {choices.controller!r} must be one of {known}")
    if choices.controller == "classic":
        settings = replace(settings, nominal_speed=settings.nominal_speed or CLASSIC_SPEED)
    gains = choices.gain_table or default_table(choices.controller, choices.vehicle)
    table = load_gain_table(gains)
    if choices.controller == "preview":
        steering = load(SteeringParameters, find("vehicles", choices.vehicle), "steering")
        return PreviewMpc(chassis, steering, settings, table, choices.base_link_to_cg)
    try:
        return LateralMpc(chassis, settings, table, choices.base_link_to_cg)
    except ValueError as error:
        raise ValueError(f"{find('gains', gains)}: {error}") from error


def warm_up(controller: Controller) -> None:
    """Go through all that a step can meet, so that nothing is compiled or loaded in a tick.

    What numba compiles follows from the types of the arguments, which every branch here has; the
    values decide the way through the rest: which bounds are active, whether the path is closed, at
    its end, or lost, whether the car stands, drives backwards or the wrong way.
    """
    for path in (make_path(STRAIGHT), make_path(CIRCLE)):
        controller.reset()
        for tick in range(2 * len(REHEARSAL)):
            stamp_ns = round(tick * controller.period * NANOSECONDS)
            state = VehicleState(stamp_ns, *REHEARSAL[tick % len(REHEARSAL)])
            with suppress(ValueError):  # the paper's formulation refuses to drive away from the end
                controller.step(state, path)
            if isinstance(controller, PreviewMpc):
                controller.observe_steering(controller.steering)
    controller.reset()
