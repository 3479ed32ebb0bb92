"""All that a simulated drive is made of, as values that go through YAML and back bit for bit."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from ampc_msgs_config.config import build
from ampc_msgs_config.paths.curves import bounded, check_known
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.scenarios.scenario_yaml import (
    document,
    mapping_of,
    read_document,
    require,
    scenario_of,
)
from sim_vehicle.closed_loop import STEP_NS, Simulation
from sim_vehicle.parameters import MeasurementNoise, Vehicle


class Configuration(NamedTuple):
    """Car, road and drive; the start follows from the scenario."""

    vehicle: Vehicle
    scenario: Scenario
    friction: float | None = None
    """mu of the road; None: that of the tyres."""
    noise: MeasurementNoise | None = None
    seed: int = 0
    """Of the noise."""
    step_ns: int = STEP_NS
    """Of the integration [ns]."""
    lock_step: bool = True
    """Every state was answered; else the drive depends on the machine's timing, too."""

    def simulation(self) -> Simulation:
        """Place the car at its start."""
        return Simulation(
            self.vehicle,
            self.scenario,
            self.step_ns,
            friction=self.friction,
            noise=self.noise,
            rng=np.random.default_rng(self.seed),
        )


def to_yaml(config: Configuration) -> str:
    """Write a configuration as text that `from_yaml` reads back."""
    return document(
        {
            **config._asdict(),
            "vehicle": {key: asdict(part) for key, part in config.vehicle._asdict().items()},
            "scenario": mapping_of(config.scenario),
            "noise": asdict(config.noise) if config.noise else None,
        }
    )


def from_yaml(text: str, where: str) -> Configuration:
    """Read a configuration.

    Args:
        text: What `to_yaml` wrote.
        where: It comes from, for the message.

    Raises:
        ValueError: Names place, key, value and bound.
    """
    content = read_document(text, where, Configuration._fields)
    noise, friction = content["noise"], content["friction"]
    if not isinstance(content["lock_step"], bool):
        raise ValueError(f"{where}: lock_step = {content['lock_step']!r} must be true or false")
    try:
        return Configuration(
            vehicle=_vehicle(content["vehicle"], f"{where}: vehicle"),
            scenario=scenario_of(content["scenario"], f"{where}: scenario"),
            friction=None if friction is None else bounded(content, "friction", 0.01, 3.0),
            noise=None if noise is None else build(MeasurementNoise, noise, "noise"),
            seed=int(bounded(content, "seed", 0, 2**63 - 1)),
            step_ns=int(bounded(content, "step_ns", 10_000, 20_000_000)),
            lock_step=content["lock_step"],
        )
    except ValueError as error:
        named = str(error).startswith(where)
        raise ValueError(str(error) if named else f"{where}: {error}") from error


def simulation_of(text: str, where: str) -> Simulation:
    """Place the car of a configuration at its start.

    Raises:
        ValueError: Names place, key, value and bound.
    """
    config = from_yaml(text, where)
    try:
        return config.simulation()
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _vehicle(content: Mapping[str, Any], where: str) -> Vehicle:
    sections = get_type_hints(Vehicle)
    check_known(content, sections, where)
    require(content, sections, where)
    return Vehicle(*(build(cls, content[key], f"{where}: {key}") for key, cls in sections.items()))
