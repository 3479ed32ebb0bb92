"""Controllers by name, behind one `step()`."""

import math
from contextlib import suppress
from typing import Protocol

from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Command, VehicleState
from ampc_ros.configuration import Choices, Configuration, configuration, gain_file
from ampc_ros.mpc.gain_table import gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.pure_pursuit import PurePursuit

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

    def reset(self, steering: float = 0.0) -> None:
        """Forget all earlier steps; the angle in force is given [rad]."""


def make_controller(choices: Choices) -> Controller:
    """Make the controller that a user chose.

    Raises:
        ValueError: A name is unknown, or a file is missing or wrong.
    """
    return build_controller(configuration(choices), gain_file(choices))


def build_controller(config: Configuration, source: object = "gain table") -> Controller:
    """Make the controller of a configuration.

    Args:
        config: What it is made of.
        source: Of its gains, for the message.

    Raises:
        ValueError: The gains make its problem numerically singular.
    """
    chassis, settings, to_cg = config.chassis, config.settings, config.base_link_to_cg
    if config.controller == "pure_pursuit":
        return PurePursuit(chassis, settings, to_cg)
    try:
        table = gain_table(config.gains)
        if config.controller == "preview":
            return PreviewMpc(chassis, config.steering, settings, table, to_cg)
        return LateralMpc(chassis, settings, table, to_cg)
    except (KeyError, ValueError) as error:
        raise ValueError(f"{source}: {error}") from error


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
