"""Adapters of AMPC for the benchmark; only this file depends on its interfaces."""

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np

from ampc_msgs_config.compiled import in_place
from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.mpc.active_set import active_set, active_set_numbers
from ampc_ros.mpc.gain_table import Gains, load_gain_table
from ampc_ros.mpc.internal_model import Limits, limits_of
from ampc_ros.mpc.laguerre import laguerre_sequence
from ampc_ros.mpc.model import BicycleParameters
from ampc_ros.mpc.qp import SOLVED, Qp
from ampc_ros.mpc.qp_solver import scratch_numbers
from ampc_ros.mpc.small_matrices import Scratch, make_scratch, vector
from ampc_ros.mpc.tick_result import QpResult
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.paper.qp_assembly import StepInput, new_qp, paper_plan
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.tuning.fleet import LOG_STEERING
from launch_scripts.tuning.fleet_rows import Entry, prepare_fleet, run_fleet
from sim_vehicle.closed_loop import Simulation
from sim_vehicle.parameters import load_vehicle_file
from tests.filled import solve_in, solver_memory

CHASSIS = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
VEHICLE: BicycleParameters = astuple(CHASSIS)
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
CAR = load_vehicle_file(find("vehicles", "paper"))
ROADS = ("sc1", "sc2", "sc3_constant", "sc3_wind")
GAINS = load_gain_table("table3").nodes[0]
"""Sizes of the paper: (45, 15, 5)."""


class Task(NamedTuple):
    """Inputs of one tick: gains, lane, and state."""

    gains: Gains
    half_width: float
    """Half width of the soft lane; infinite: no output rows [m]."""
    tick: StepInput


def limits(half_width: float = math.inf) -> Limits:
    """Return the limits of Table 3 with an optional lane."""
    return limits_of(replace(SETTINGS, max_output_error=half_width))


def qp_of(task: Task) -> Qp:
    """Build the quadratic program of a tick."""
    return new_qp(VEHICLE, task.gains, limits(task.half_width), task.tick)


def qp_alone(qp: Qp) -> Callable[[], Array | None]:
    """Return a call that solves in preallocated memory."""
    matrices, memory = tuple(qp), solver_memory(*qp.M.shape)

    def solve() -> Array | None:
        _, status = solve_in(matrices, memory)
        return memory[0] if status == SOLVED else None

    return solve


@in_place
def solve_often(qp: Qp, x: Array, multipliers: Array, scratch: Scratch, times: int) -> None:
    """Solve repeatedly inside compiled code."""
    for _ in range(times):
        for i in range(len(multipliers)):
            multipliers[i] = 0.0
        active_set(qp, x, multipliers, scratch)


def qp_inside(qp: Qp, times: int) -> Callable[[], object]:
    """Return a call that solves a number of times inside compiled code."""
    m, n = qp.M.shape
    memory = np.zeros(n), np.zeros(m), make_scratch(active_set_numbers(m, n))
    return partial(solve_often, qp, *memory, times)


def whole_tick(gains: Gains) -> Callable[[StepInput], float | None]:
    """Return a function from tick to first move [rad] with preallocated memory."""
    scratch = tuple(make_scratch(scratch_numbers(*gains[:3])))
    fixed = VEHICLE, tuple(gains), tuple(limits())

    def answer(tick: StepInput) -> float | None:
        Delta_u, status = plan_often(*fixed, tuple(tick), scratch, 1)
        return Delta_u if status == SOLVED else None

    return answer


def tick_inside(gains: Gains, tick: StepInput, times: int) -> Callable[[], object]:
    """Return a call that computes a tick a number of times inside compiled code."""
    scratch = tuple(make_scratch(scratch_numbers(*gains[:3])))
    fixed = VEHICLE, tuple(gains), tuple(limits()), tuple(tick)
    return partial(plan_often, *fixed, scratch, times)


@in_place
def plan_often(
    vehicle: BicycleParameters,
    gains: tuple[Any, ...],
    bounds: tuple[Any, ...],
    tick: tuple[Any, ...],
    scratch: tuple[Any, ...],
    times: int,
) -> tuple[float, int]:
    """Build and solve a tick repeatedly in its own scratch memory."""
    memory, step, plan = Scratch(*scratch), StepInput(*tick), QpResult(0.0, 0, 0.0, 0, 0)
    for _ in range(times):
        memory.used[0] = 0
        no_angles = vector(memory, 0)
        plan = paper_plan(vehicle, Gains(*gains), Limits(*bounds), step, no_angles, memory)
    return plan.steering - step.u, plan.status


def full_steps(driven: Drive, path: Path) -> list[Callable[[], object]]:
    """Return calls that repeat the steps of a drive, each with the memory at that time."""
    controller = LateralMpc(CHASSIS, SETTINGS, load_gain_table("table3"))
    memories = []
    for state in driven.states:
        memories.append(controller.memory.copy())
        controller.step(state, path)

    def step(memory: Array, state: VehicleState) -> object:
        controller.memory[:] = memory
        return controller.step(state, path)

    return [partial(step, *both) for both in zip(memories, driven.states, strict=True)]


def laguerre(gains: Gains) -> Array:
    """Return the Laguerre functions L(0)' .. L(N_c - 1)' as rows (N_c, N)."""
    L = np.zeros((gains.control_horizon, gains.laguerre_terms))
    laguerre_sequence(gains.laguerre_pole, L)
    return L


def make_swarm(formulation: str, cars: int, step: float, seconds: float) -> Callable[[], int]:
    """Prepare cars on the roads of the paper, each with another friction.

    Args:
        formulation: `paper` or `preview`.
        cars: Number of cars.
        step: Integration step [s].
        seconds: Simulated duration of the drives [s].

    Returns:
        A call that drives all cars to the end in one thread and returns the number of control
        ticks.
    """
    roads = [load_scenario(name, CAR.size)._replace(duration=seconds) for name in ROADS]
    step_ns, friction = round(step * NANOSECONDS), np.linspace(0.8, 1.0, cars)
    choices = Choices(formulation, settings="table3")
    fleet_run = prepare_fleet(
        [
            Entry(
                Simulation(CAR, roads[i % len(roads)], step_ns, friction=float(friction[i])),
                cast(LateralMpc | PreviewMpc, make_controller(choices)),
            )
            for i in range(cars)
        ]
    )

    def drive() -> int:
        return int(np.isfinite(run_fleet(fleet_run)[:, :, LOG_STEERING]).sum())

    return drive
