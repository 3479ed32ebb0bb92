"""Serialisable configuration of a controller, complete enough to rebuild it exactly.

As YAML text it is published on a latched topic, and so becomes part of every recording.
"""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from ampc_msgs_config.config import build, find, load, shipped
from ampc_msgs_config.parameters import (
    ChassisParameters,
    ControllerSettings,
    GuardLimits,
    SteeringParameters,
)
from ampc_msgs_config.scenarios.scenario_yaml import document, read_document
from ampc_msgs_config.validation import Checked, choice, number
from ampc_ros.mpc.gain_table import gain_table, read_gain_table

CONTROLLERS = {
    "preview": "adaptive MPC on the path ahead, with the actuator in its model",
    "paper": "adaptive MPC of the paper, model at the measured speed",
    "classic": "the same MPC with its model fixed at a nominal speed",
    "pure_pursuit": "geometric baseline on the rear axle",
}
DEFAULT_TABLES = {"preview": "preview", "paper": "table3", "classic": "table3"}
"""Gains for any car; `default_table` returns tuned ones where they exist."""
CLASSIC_SPEED = 9.0
"""Speed of the classic MPC's model, that of the paper's Sc1 [m/s]."""


class Choices(NamedTuple):
    """Selection of a user, by shipped names or files."""

    controller: str = "preview"
    vehicle: str = "paper"
    settings: str = "table3"
    gain_table: str = ""
    """Empty: see `default_table`."""
    guard: str = "road"
    base_link_to_cg: float | None = None
    """Distance from the point of `odom` to the centre of gravity; None: from the rear axle [m]."""
    static_path: bool = False
    """Whether the path is published once and does not age."""
    simulated_time: bool = False
    """Whether time that goes back means a simulated car that is at its start again."""


class Configuration(NamedTuple):
    """Content of the selected files, checked."""

    controller: Annotated[str, choice(tuple(CONTROLLERS))]
    chassis: ChassisParameters
    steering: SteeringParameters
    settings: ControllerSettings
    guard: GuardLimits
    gains: dict[str, Any]
    """Content of a gain table; empty for a controller without one."""
    base_link_to_cg: Annotated[float, number(-20.0, 20.0, "m")]
    """Distance from the point of `odom` forward to the centre of gravity [m]."""
    static_path: bool
    simulated_time: bool

    @property
    def max_angle(self) -> float:
        """Largest angle that the controller may command [rad]."""
        return min(self.settings.max_angle, self.steering.max_angle)


PARTS: dict[str, type[Checked]] = {
    "chassis": ChassisParameters,
    "steering": SteeringParameters,
    "settings": ControllerSettings,
    "guard": GuardLimits,
}
"""Parts of a configuration that are parameter classes."""


def default_table(controller: str, vehicle: str) -> str:
    """Return the shipped gains for a vehicle: `preview_paper` if tuned for it, else `preview`."""
    name = DEFAULT_TABLES[controller]
    tuned = f"{name}_{vehicle}"
    return tuned if vehicle in shipped("vehicles") and tuned in shipped("gains") else name


def configuration(choices: Choices) -> Configuration:
    """Load the files of a selection.

    Raises:
        ValueError: A name is unknown, or a file is missing or wrong.
    """
    check_controller(choices.controller)
    vehicle = find("vehicles", choices.vehicle)
    chassis = load(ChassisParameters, vehicle, "chassis")
    settings = load(ControllerSettings, find("controllers", choices.settings))
    if choices.controller == "classic":
        settings = replace(settings, nominal_speed=settings.nominal_speed or CLASSIC_SPEED)
    to_cg, gains = choices.base_link_to_cg, gain_file(choices)
    return Configuration(
        choices.controller,
        chassis,
        load(SteeringParameters, vehicle, "steering"),
        settings,
        load(GuardLimits, find("guards", choices.guard)),
        read_gain_table(gains) if gains else {},
        chassis.cg_to_rear_axle if to_cg is None else to_cg,
        choices.static_path,
        choices.simulated_time,
    )


def check_controller(name: str) -> None:
    """Raise a ValueError unless there is a controller of this name."""
    if name not in tuple(CONTROLLERS):
        raise ValueError(f"controller = {name!r} must be one of {', '.join(CONTROLLERS)}")


def gain_file(choices: Choices) -> Path | None:
    """Return the file of the gains, or None for a controller without gains."""
    if choices.controller not in DEFAULT_TABLES:
        return None
    name = choices.gain_table or default_table(choices.controller, choices.vehicle)
    return find("gains", name)


def to_yaml(config: Configuration, number: int) -> str:
    """Write a configuration as text that `from_yaml` reads back, number for number.

    Args:
        config: Configuration.
        number: Count of the configurations of a run; each tick publishes the one that it used.
    """
    items = config._asdict().items()
    return document({key: asdict(v) if key in PARTS else v for key, v in items}, number)


def from_yaml(text: str, where: str) -> tuple[Configuration, int]:
    """Read a configuration and its number.

    Args:
        text: Text that `to_yaml` wrote.
        where: Source of the text, for the message.

    Raises:
        ValueError: Source, key, value and bound.
    """
    content, number = read_document(text, where)
    config = build(Configuration, content, where)
    if config.gains:
        gain_table(config.gains, where, "gains")
    return config, number
