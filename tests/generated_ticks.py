"""Generated cases of both ticks, run as a script without compilation for comparison.

Usage: NUMBA_DISABLE_JIT=1 python -m tests.generated_ticks OUTPUT.npz
"""

import sys
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import ControllerSettings, SteeringParameters
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.gain_table import Gains, GainTable
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from sim_vehicle.parameters import load_vehicle_file

CASES = 240
TICKS = 3
WIDTH = 200
"""Numbers of a tick that are compared, filled up with zeros."""
CARS = [load_vehicle_file(find("vehicles", name)) for name in ("paper", "ordinary")]


class Case(NamedTuple):
    """One controller, its path, and the states that it results."""

    controller: LateralMpc | PreviewMpc
    path: Path
    states: list[VehicleState]


def generated(seed: int) -> Case:
    """Return a case with random options of car, settings, gains and path."""
    rng = np.random.default_rng(seed)
    car, settings = CARS[seed // 2 % 2], drawn_settings(rng)
    table = drawn_table(rng)
    controller: LateralMpc | PreviewMpc
    if seed % 2:
        settings = replace(settings, nominal_speed=float(rng.choice([0.0, 9.0])))
        controller = LateralMpc(car.chassis, settings, table)
    else:
        steering = drawn_steering(rng, settings.sample_time)
        controller = PreviewMpc(car.chassis, steering, settings, table)
    x = np.arange(0.0, 80.0, 2.0)
    path = make_path(np.column_stack((x, rng.uniform(0.0, 4.0) * np.sin(x / rng.uniform(8, 30)))))
    return Case(controller, path, drawn_states(rng, path, settings.sample_time))


def drawn_settings(rng: np.random.Generator) -> ControllerSettings:
    """Draw limits and solver; half of them with a lane, a third with Hildreth."""
    return ControllerSettings(
        sample_time=float(rng.choice([0.02, 0.05, 0.1])),
        max_increment=float(rng.choice([0.0, 0.005, 0.05, 0.3])),
        max_angle=float(rng.uniform(0.02, 0.6)),
        max_output_error=float(rng.choice([np.inf, np.inf, 0.1, 0.5])),
        friction=float(rng.uniform(0.1, 1.0)),
        slack_weight=float(10 ** rng.uniform(0, 4)),
        solver=str(rng.choice(["active_set", "active_set", "hildreth"])),
        hildreth_sweeps=20.0,
    )


def drawn_steering(rng: np.random.Generator, T: float) -> SteeringParameters:
    """Draw an actuator: whole ticks of delay, a share of one, or none; with and without lag."""
    return SteeringParameters(
        max_angle=float(rng.uniform(0.1, 0.6)),
        max_rate=float(rng.choice([np.inf, 0.4])),
        lag=float(rng.choice([0.0, 0.02, 0.2])),
        delay=float(rng.choice([0.0, 1.0, 2.0, 0.4, 1.7])) * T,
    )


def drawn_table(rng: np.random.Generator) -> GainTable:
    """Draw a table of two speeds and one or two references; well conditioned, for nine digits."""
    speeds, references = [5.0, 15.0], [[0.0], [-2.0, 2.0]][int(rng.integers(2))]
    nodes = []
    for _ in range(2 * len(references)):
        N_p, N = int(rng.integers(6, 14)), int(rng.integers(1, 5))
        pole, Q, R = rng.uniform(0.0, 0.6), 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(0, 2)
        nodes.append(Gains(N_p, int(rng.integers(N, N_p + 1)), N, pole, Q, R))
    return GainTable(speeds, references, nodes)


def drawn_states(rng: np.random.Generator, path: Path, T: float) -> list[VehicleState]:
    """Draw states about a path: from near it to lost, standing, backwards, after a gap in time."""
    far, v_x = rng.choice([0.1, 1.0, 4.0]), rng.choice([-1.0, 0.0, 1.2, 6.0, 12.0, 30.0])
    at = int(rng.integers(0, len(path.x) - 1))
    stamps = np.cumsum(rng.choice([T, T, T, 1.2 * T, 3.0 * T], TICKS)) * NANOSECONDS
    states = []
    for k in range(TICKS):
        x, y = path.x[at] + v_x * T * k, path.y[at] + far * rng.standard_normal()
        yaw = path.heading[at] + 0.1 * far * rng.standard_normal()
        motion = v_x + 0.1 * rng.standard_normal(), *(0.1 * far * rng.standard_normal(2))
        states.append(VehicleState(round(stamps[k]), *map(float, (x, y, yaw, *motion))))
    return states


def results(case: Case) -> Array:
    """Return commands, diagnoses, memory and predictions of the ticks of a case, (TICKS, WIDTH)."""
    rows = np.zeros((TICKS, WIDTH))
    for row, state in zip(rows, case.states, strict=True):
        command = case.controller.step(state, case.path)
        points = np.zeros(0) if command.prediction is None else command.prediction.ravel()
        diagnosis = np.array(command.diagnosis, dtype=float)
        numbers = [command.steering, command.steering_rate, *diagnosis]
        everything = np.concatenate((numbers, case.controller.memory, points))
        row[: len(everything)] = everything
    return rows


def all_results() -> Array:
    """Return the results of all cases (CASES, TICKS, WIDTH)."""
    return np.array([results(generated(seed)) for seed in range(CASES)])


if __name__ == "__main__":
    np.savez(sys.argv[1], results=all_results())
