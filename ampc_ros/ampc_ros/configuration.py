"""All that a controller is made of, as values: what a run was made with, and may be made with anew.

As YAML text it goes over a latched topic, and so into every recording.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

from ampc_msgs_config.config import build, find, load, shipped
from ampc_msgs_config.parameters import (
    ChassisParameters,
    Checked,
    ControllerSettings,
    GuardLimits,
    SteeringParameters,
    check_range,
)
from ampc_msgs_config.scenarios.scenario_yaml import document, read_document
from ampc_ros.mpc.gain_table import read_gain_table

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


class Choices(NamedTuple):
    """What a user chooses, by shipped names or files."""

    controller: str = "preview"
    vehicle: str = "paper"
    settings: str = "table3"
    gain_table: str = ""
    """Empty: see `default_table`."""
    guard: str = "road"
    base_link_to_cg: float | None = None
    """From the point that `odom` describes to the centre of gravity [m]; None: the rear axle."""
    static_path: bool = False
    """The path is published once and holds until the next one: it does not grow old."""
    simulated_time: bool = False
    """Time that goes back means a simulated car that is at its start again."""


class Configuration(NamedTuple):
    """What was chosen, read and checked."""

    controller: str
    chassis: ChassisParameters
    steering: SteeringParameters
    settings: ControllerSettings
    guard: GuardLimits
    gains: dict[str, Any]
    """Content of a gain table; empty for a controller without one."""
    base_link_to_cg: float
    """From the point that `odom` describes forward to the centre of gravity [m]."""
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


TO_CG = {"low": -20.0, "high": 20.0, "unit": "m"}
"""Bounds of `base_link_to_cg`."""
KINDS = {"number": int, "gains": dict, "static_path": bool, "simulated_time": bool}
KIND_NAMES = {int: "a whole number", dict: "a mapping", bool: "true or false"}


def default_table(controller: str, vehicle: str) -> str:
    """Give the shipped gains for a vehicle: `preview_paper` where they are tuned for that one."""
    name = DEFAULT_TABLES[controller]
    tuned = f"{name}_{vehicle}"
    return tuned if vehicle in shipped("vehicles") and tuned in shipped("gains") else name


def configuration(choices: Choices) -> Configuration:
    """Read what a user chose.

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
    """Give the file of the gains, or None for a controller without gains."""
    if choices.controller not in DEFAULT_TABLES:
        return None
    name = choices.gain_table or default_table(choices.controller, choices.vehicle)
    return find("gains", name)


def to_yaml(config: Configuration, number: int) -> str:
    """Write a configuration as text that `from_yaml` reads back, number for number.

    Args:
        config: What to write.
        number: Counts the configurations of a run; each tick names the one that it used.
    """
    items = config._asdict().items()
    return document({key: asdict(v) if key in PARTS else v for key, v in items}, number)


def from_yaml(text: str, where: str) -> tuple[Configuration, int]:
    """Read a configuration and its number.

    Args:
        text: What `to_yaml` wrote.
        where: It comes from, for the message.

    Raises:
        ValueError: Names place, key, value and bound.
    """
    content = read_document(text, where, Configuration._fields)
    check_plain(content, where)
    values = {key: content[key] for key in Configuration._fields}
    for key, cls in PARTS.items():
        values[key] = build(cls, values[key], f"{where}: {key}")
    return Configuration(**values), content["number"]


def check_plain(content: Mapping[str, Any], where: str) -> None:
    """Raise a ValueError, with place, key and value, unless all that is no part is of its kind."""
    try:
        check_controller(content["controller"])
        check_range("base_link_to_cg", content["base_link_to_cg"], TO_CG)
        for key, kind in KINDS.items():
            if not isinstance(content[key], kind):
                raise ValueError(f"{key} = {content[key]!r} must be {KIND_NAMES[kind]}")
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
