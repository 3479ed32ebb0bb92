"""Configuration of a simulated drive, which YAML text stores and restores bit for bit."""

from dataclasses import asdict
from typing import Annotated, NamedTuple

import numpy as np

from ampc_msgs_config.config import build
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.scenarios.scenario_yaml import (
    document,
    read_document,
    read_scenario,
    scenario_content,
)
from ampc_msgs_config.validation import number
from sim_vehicle.closed_loop import STEP_NS, Simulation
from sim_vehicle.parameters import MeasurementNoise, Vehicle


class SimulatorConfiguration(NamedTuple):
    """Car, road and drive; the start follows from the scenario."""

    vehicle: Vehicle
    scenario: Scenario
    friction: Annotated[float, number(0.01, 3.0)] | None = None
    """mu of the road; None: that of the tyres."""
    noise: MeasurementNoise | None = None
    seed: Annotated[int, number(0, 2**63 - 1)] = 0
    """Seed of the noise."""
    step_ns: Annotated[int, number(10_000, 20_000_000, "ns")] = STEP_NS
    """Step of the integration [ns]."""
    lock_step: bool = True
    """Whether every state was answered; otherwise the drive depends on the machine's timing."""

    def simulation(self) -> Simulation:
        """Return the simulation with the car at its start."""
        return Simulation(
            self.vehicle,
            self.scenario,
            self.step_ns,
            friction=self.friction,
            noise=self.noise,
            rng=np.random.default_rng(self.seed),
        )


def simulator_text(config: SimulatorConfiguration) -> str:
    """Write a configuration as text that `read_simulator` reads back."""
    return document(
        {
            **config._asdict(),
            "vehicle": {key: asdict(part) for key, part in config.vehicle._asdict().items()},
            "scenario": scenario_content(config.scenario),
            "noise": asdict(config.noise) if config.noise else None,
        }
    )


def read_simulator(text: str, where: str) -> SimulatorConfiguration:
    """Read a configuration.

    Args:
        text: Text that `to_yaml` wrote.
        where: Source of the text, for the message.

    Raises:
        ValueError: Source, key, value and bound.
    """
    content, _ = read_document(text, where)
    for key in SimulatorConfiguration._fields:  # a recorded configuration is complete
        if key not in content:
            raise ValueError(f"{where}: missing key {key!r}")
    scenario = read_scenario(content["scenario"], where, "scenario")
    return build(SimulatorConfiguration, {**content, "scenario": scenario}, where)


def simulation_of(text: str, where: str) -> Simulation:
    """Return the simulation of a configuration with the car at its start.

    Raises:
        ValueError: Source, key, value and bound.
    """
    config = read_simulator(text, where)
    try:
        return config.simulation()
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
