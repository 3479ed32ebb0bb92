"""Serialisable configuration of a controller, complete enough to rebuild it exactly.

It is published as YAML on a latched topic, and so is part of every recording. Functions import what
loads compiled code, so that commands can list and check their options without it.
"""

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from ampc_msgs_config.config import build, find, is_regular_file, load, shipped
from ampc_msgs_config.parameters import (
    ChassisParameters,
    ControllerSettings,
    GuardLimits,
    SteeringParameters,
)
from ampc_msgs_config.validation import Checked, number
from ampc_msgs_config.vehicle_file import read_vehicle

CONTROLLERS = {
    "preview": "adaptive MPC on the path ahead, with the actuator in its model",
    "paper": "adaptive MPC of the paper, model at the measured speed",
    "classic": "the same MPC with its model fixed at a nominal speed",
    "pure_pursuit": "geometric baseline on the rear axle",
}
CERTIFIED_CONTROLLERS = ("preview", "paper")
"""Controllers whose gain tables are certified."""
DEFAULT_TABLES = {"preview": "preview", "paper": "table3", "classic": "table3"}
"""Gains for any car; `default_table` selects gains tuned for one car."""
CLASSIC_SPEED = 9.0
"""Speed of the classic MPC's fixed model, that of the paper's Sc1 [m/s]."""
FILE_SEPARATOR = ".py:"
"""In the name of a custom controller, `FILE.py:CLASS`."""


class Choices(NamedTuple):
    """Choices of a user, by shipped names or files."""

    controller: str = "preview"
    """One of CONTROLLERS, or `FILE.py:CLASS`."""
    vehicle: str = "paper"
    settings: str = "table3"
    gain_table: str = ""
    """Empty: see `default_table`."""
    guard: str = "road"
    base_link_to_cg: float | None = None
    """Distance from the point of `odom` forward to the centre of gravity [m]; None: rear axle."""
    static_path: bool = False
    """The path is published once and stays valid until the next one."""
    simulated_time: bool = False
    """Time that goes back means a simulated car at its start."""


class CarDifference(NamedTuple):
    """Estimated differences from the configured car."""

    latency: Annotated[float, number(-10.0, 10.0, "s")] = 0.0
    """Difference of the total latency of the steering [s]."""
    understeer_gradient: Annotated[float, number(-1.0, 1.0, "rad s^2/m")] = 0.0
    """Difference of the understeer gradient [rad s^2/m]."""
    steering_offset: Annotated[float, number(-1.0, 1.0, "rad")] = 0.0
    """Road-wheel angle at a commanded angle of zero [rad]."""
    rear_stiffness: Annotated[float, number(-5.0, 5.0)] = 0.0
    """Natural logarithm of the ratio of the rear cornering stiffnesses."""


class Configuration(NamedTuple):
    """Values of all choices, loaded and checked."""

    controller: str
    """One of CONTROLLERS, or `FILE.py:CLASS`."""
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
    difference: CarDifference | None = None
    """Differences with which the adaptation starts; None: it continues, at first from zero."""

    @property
    def max_angle(self) -> float:
        """Largest angle of controller and steering [rad]."""
        return min(self.settings.max_angle, self.steering.max_angle)


LATER: dict[str, Any] = {
    "adaptation": False,
    "end_deceleration": math.inf,
    "state_prediction": 0.0,
    "position_noise": 0.0,
    "heading_noise": 0.0,
}
"""Settings that later versions have added, with the values that switch their effect off."""
PARTS: dict[str, type[Checked]] = {
    "chassis": ChassisParameters,
    "steering": SteeringParameters,
    "settings": ControllerSettings,
    "guard": GuardLimits,
}
"""Parts of a configuration that are parameter classes."""


def default_table(controller: str, vehicle: str) -> str:
    """Return the name of the shipped gains, such as `preview_paper` if tuned for the vehicle."""
    name = DEFAULT_TABLES[controller]
    tuned = f"{name}_{vehicle}"
    return tuned if vehicle in shipped("vehicles") and tuned in shipped("gains") else name


def configuration(choices: Choices) -> Configuration:
    """Load the choices of a user.

    Raises:
        ValueError: A name is unknown, or a file is missing or wrong.
    """
    from ampc_ros.mpc.gain_table import read_gain_table

    controller = check_controller(choices.controller)
    vehicle = read_vehicle(find("vehicles", choices.vehicle))
    chassis = vehicle.section(ChassisParameters, "chassis", "the controller")
    settings = load(ControllerSettings, find("controllers", choices.settings))
    if choices.controller == "classic":
        settings = replace(settings, nominal_speed=settings.nominal_speed or CLASSIC_SPEED)
    to_cg, gains = choices.base_link_to_cg, gain_file(choices)
    return Configuration(
        controller,
        chassis,
        vehicle.section(SteeringParameters, "steering", "the controller"),
        settings,
        load(GuardLimits, find("guards", choices.guard)),
        read_gain_table(gains) if gains else {},
        chassis.cg_to_rear_axle if to_cg is None else to_cg,
        choices.static_path,
        choices.simulated_time,
    )


def check_controller(name: str) -> str:
    """Return the name of a controller, that of a custom one with the absolute path of its file.

    Raises:
        ValueError: There is no controller of this name, or no such file.
    """
    check_controller_name(name)
    file, separator, class_name = name.rpartition(FILE_SEPARATOR)
    if not separator:
        return name
    path = Path(file + ".py")
    if not is_regular_file(path):
        raise ValueError(f"controller = {name!r}: there is no file {path}")
    return f"{path.resolve()}:{class_name}"


def check_controller_name(name: object) -> None:
    """Raise a ValueError unless a name is one of CONTROLLERS or has the form `FILE.py:CLASS`."""
    if name in tuple(CONTROLLERS) or is_custom(name):
        return
    names = ", ".join(CONTROLLERS)
    raise ValueError(f"controller = {name!r} must be one of {names}, or FILE.py:CLASS")


def is_custom(name: object) -> bool:
    """Return whether a name has the form `FILE.py:CLASS` of a custom controller."""
    if not isinstance(name, str):
        return False
    file, separator, class_name = name.rpartition(FILE_SEPARATOR)
    return bool(file and separator) and class_name.isidentifier()


def gain_file(choices: Choices) -> Path | None:
    """Return the file of the gains; None for a controller without gains."""
    if choices.controller not in DEFAULT_TABLES:
        return None
    name = choices.gain_table or default_table(choices.controller, choices.vehicle)
    return find("gains", name)


def to_yaml(config: Configuration, number: int) -> str:
    """Return a configuration as YAML that `from_yaml` reads back without loss.

    Args:
        config: Configuration to write.
        number: Number of the configuration in its run; each tick refers to it.
    """
    from ampc_msgs_config.scenarios.scenario_yaml import document

    items = config._asdict().items()
    content: dict[str, Any] = {key: asdict(v) if key in PARTS else v for key, v in items}
    difference = config.difference and config.difference._asdict()
    return document({**content, "difference": difference}, number)


def from_yaml(text: str, where: str) -> tuple[Configuration, int]:
    """Read a configuration and its number from YAML.

    Args:
        text: Text of `to_yaml`.
        where: Origin of the text, for the error message.

    Raises:
        ValueError: Source, key, value and bound.

    Note:
        A recording without one of the keys of LATER is older than what the key controls, and is
        repeated without it. All other missing keys have their defaults.
    """
    from ampc_msgs_config.scenarios.scenario_yaml import read_document
    from ampc_ros.mpc.gain_table import gain_table

    content, number = read_document(text, where)
    if isinstance(settings := content.get("settings"), dict):
        content["settings"] = {**LATER, **settings}
    config = build(Configuration, content, where)
    try:
        check_controller_name(config.controller)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
    if config.gains:
        gain_table(config.gains, where, "gains")
    return config, number
