"""Controllers by name, or by a file of the user, behind one interface."""

import importlib.util
import inspect
import math
import sys
from pathlib import Path as File
from typing import Any

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.paths.path import Path, Progress
from ampc_msgs_config.types import Diagnosis, Plan, VehicleState
from ampc_msgs_config.validation import check_range, number
from ampc_ros.configuration import (
    FILE_SEPARATOR,
    Choices,
    Configuration,
    check_controller,
    configuration,
    gain_file,
    is_custom,
)
from ampc_ros.controller_interface import Controller
from ampc_ros.mpc.gain_table import gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.pure_pursuit import PurePursuit

PERIOD_BOUNDS = number(0.001, 1.0, "s")
"""Bounds of the period of a custom controller, those of `sample_time`."""
CUSTOM_ARGUMENTS = ("chassis", "steering", "settings", "base_link_to_cg")
"""Arguments that the class of a custom controller may have."""


def make_controller(choices: Choices) -> Controller:
    """Build the controller of a user's choices.

    Raises:
        ValueError: A name is unknown, or a file is missing or wrong.
    """
    return build_controller(configuration(choices), gain_file(choices))


def build_controller(config: Configuration, source: object = "gain table") -> Controller:
    """Build the controller of a configuration.

    Args:
        config: Configuration of the controller.
        source: Origin of its gains, for the error message.

    Raises:
        ValueError: The gains make its problem numerically singular, or a custom class is
            unsuitable.
    """
    chassis, settings, to_cg = config.chassis, config.settings, config.base_link_to_cg
    if is_custom(config.controller):
        return load_custom_controller(config)
    if config.controller == "pure_pursuit":
        return PurePursuit(chassis, settings, to_cg)
    try:
        table = gain_table(config.gains)
        if config.controller == "preview":
            return PreviewMpc(chassis, config.steering, settings, table, to_cg)
        return LateralMpc(chassis, settings, table, to_cg)
    except (KeyError, ValueError) as error:
        raise ValueError(f"{source}: {error}") from error


class CustomController(Controller):
    """Adapter of a user's class: every result is checked, an error holds the last angle."""

    formulation = "custom"
    steering = 0.0

    def __init__(self, name: str, custom: Any, base_link_to_cg: float) -> None:
        """Create the adapter at rest.

        Args:
            name: `FILE.py:CLASS`, for messages.
            custom: Object with `period` and `step(state, path)`.
            base_link_to_cg: Distance from the point of `odom` forward to the centre of gravity [m].

        Raises:
            ValueError: It has no `step`, or no `period` within PERIOD_BOUNDS.
        """
        if not callable(getattr(custom, "step", None)):
            raise ValueError(f"controller = {name!r}: the class has no method step(state, path)")
        period: Any = getattr(custom, "period", None)
        check_range(f"controller = {name!r}: period", period, PERIOD_BOUNDS)
        self.name, self.custom, self.to_cg = name, custom, base_link_to_cg
        self.period = float(period)
        self.reset()

    def reset(self, steering: float = 0.0) -> None:
        """Forget the path, call the user's `reset()` if any; `steering` is in force [rad]."""
        self.steering, self.failure = steering, ""
        self.path: Path | None = None
        if callable(getattr(self.custom, "reset", None)):
            try:
                self.custom.reset()
            except Exception as error:
                self.failure = f"{self.name}: reset raised {type(error).__name__}: {error}"

    def step(self, state: VehicleState, path: Path) -> Plan:
        """Compute the plan for a state at `base_link`; an error counts as 'not solved'."""
        if path is not self.path:
            self.path, self.progress = path, Progress(path)
        errors = self.progress.errors(at_distance(state, self.to_cg))
        plan = Plan(state.stamp_ns, self.steering, 0.0, Diagnosis(*errors))
        try:
            result = self.custom.step(state, path)
            angle = float(getattr(result, "steering", result))
            if not math.isfinite(angle):
                raise ValueError(f"the angle {angle} is not finite")
        except Exception as error:
            text = " ".join(str(error).split())
            self.failure = f"{self.name}: step failed: {type(error).__name__}: {text}"
            return plan._replace(diagnosis=plan.diagnosis._replace(converged=0.0))
        self.failure = ""
        rate, self.steering = (angle - self.steering) / self.period, angle
        return plan._replace(steering=angle, steering_rate=rate)

    def take_over(self, steering: float, *, stepped: bool) -> None:
        """Continue from another angle in force; see `Controller`."""
        self.steering = steering


def load_custom_controller(config: Configuration) -> CustomController:
    """Build the controller of a user's file; this executes the file.

    The class gets those of CUSTOM_ARGUMENTS that its constructor has, as keyword arguments.

    Raises:
        ValueError: File or class is missing or unsuitable, in one line.
    """
    name = check_controller(config.controller)
    file, _, class_name = name.rpartition(FILE_SEPARATOR)
    try:
        custom_class = getattr(_import_file(File(file + ".py")), class_name, None)
        if not isinstance(custom_class, type):
            raise ValueError(f"the file has no class {class_name}")
        parameters = inspect.signature(custom_class).parameters.values()
        arguments = {each.name for each in parameters if each.kind is not each.VAR_KEYWORD}
        if any(each.kind is each.VAR_KEYWORD for each in parameters):
            arguments |= set(CUSTOM_ARGUMENTS)
        values = {key: getattr(config, key) for key in CUSTOM_ARGUMENTS if key in arguments}
        custom = custom_class(**values)
    except Exception as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        text = " ".join(str(error).split())
        raise ValueError(f"controller = {name!r}: {kind}{text}") from error
    return CustomController(name, custom, config.base_link_to_cg)


def _import_file(file: File) -> Any:
    """Execute a Python file as a module; its own folder is on the path for its imports."""
    spec = importlib.util.spec_from_file_location(f"custom_controller_{file.stem}", file)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # for dataclasses
    sys.path.insert(0, str(file.parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(file.parent))
    return module
