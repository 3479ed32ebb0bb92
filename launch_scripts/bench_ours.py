"""What is measured of ours, behind plain functions: the one place that follows changes of it."""

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.path import Array, Path
from ampc_msgs_config.types import VehicleState
from ampc_ros.belief import Limits, limits_of
from ampc_ros.gain_table import Gains, load_gain_table
from ampc_ros.laguerre import laguerre_sequence
from ampc_ros.lateral_mpc import LateralMpc, Move, Tick, plan, problem, scratch_numbers
from ampc_ros.model import Vehicle
from ampc_ros.qp import SOLVED, Qp, active_set, solver_numbers
from ampc_ros.small_matrices import Scratch, make_scratch
from sim_vehicle.parameters import load_vehicle, numbers
from sim_vehicle.vehicle import SIZE, V_X, V_Y, YAW, YAW_RATE, Y, drive

CHASSIS = load(ChassisParameters, find("vehicles", "paper"), "chassis")
VEHICLE: Vehicle = astuple(CHASSIS)
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
GAINS = load_gain_table("table3").nodes[0]
"""(45, 15, 5): the paper's sizes."""


class Task(NamedTuple):
    """One tick to answer: gains, lane, and what the controller knows."""

    gains: Gains
    half_width: float
    """Of the soft lane; infinite: no output rows [m]."""
    tick: Tick


def limits(half_width: float = math.inf) -> Limits:
    """Give the limits of Table 3, with a lane if asked for."""
    return limits_of(replace(SETTINGS, max_output_error=half_width))


def posed(task: Task) -> Qp:
    """Pose the programme of a tick."""
    return problem(VEHICLE, task.gains, limits(task.half_width), task.tick)


def qp_alone(qp: Qp) -> Callable[[], Array | None]:
    """Give a call that solves, in memory made beforehand."""
    m, n = qp.M.shape
    x, multipliers, scratch = np.zeros(n), np.zeros(m), make_scratch(solver_numbers(m, n))

    def solve() -> Array | None:
        multipliers.fill(0.0)
        _, status = active_set(qp, x, multipliers, scratch)
        return x if status == SOLVED else None

    return solve


def whole_tick(gains: Gains) -> Callable[[Tick], float | None]:
    """Give what answers a tick by its first move [rad], in memory made beforehand."""
    scratch, bounds = make_scratch(scratch_numbers(*gains[:3])), limits()

    def answer(tick: Tick) -> float | None:
        move = planned(gains, bounds, tick, scratch)
        return move.Delta_u if move.status == SOLVED else None

    return answer


def planned(gains: Gains, bounds: Limits, tick: Tick, scratch: Scratch) -> Move:
    """Pose and solve in scratch memory that nobody else uses."""
    scratch.used[0] = 0
    return plan(VEHICLE, gains, bounds, tick, scratch)


def full_steps(driven: Drive, path: Path) -> list[Callable[[], object]]:
    """Give the controller's answers to a drive, each from what it remembered then."""
    controller = LateralMpc(CHASSIS, SETTINGS, load_gain_table("table3"))
    remembered = []
    for state in driven.states:
        remembered.append(controller.memory.copy())
        controller.step(state, path)

    def step(memory: Array, state: VehicleState) -> object:
        controller.memory[:] = memory
        return controller.step(state, path)

    return [partial(step, *both) for both in zip(remembered, driven.states, strict=True)]


def laguerre(gains: Gains) -> Array:
    """Laguerre functions L(0)' .. L(N_c - 1)' as rows (N_c, N)."""
    L = np.zeros((gains.control_horizon, gains.laguerre_terms))
    laguerre_sequence(gains.laguerre_pole, L)
    return L


def make_swarm(cars: int, step: float) -> Callable[[float], int]:
    """Place cars beside a straight road, each elsewhere and at another speed.

    Args:
        cars: How many.
        step: Of the integration [s].

    Returns:
        A function that drives all of them on for some simulated seconds, and gives the number of
        control ticks that this took.
    """
    state = np.zeros((cars, SIZE))
    state[:, Y], state[:, V_X] = np.linspace(-1.0, 1.0, cars), np.linspace(8.0, 20.0, cars)
    speed, steering, last = state[:, V_X].copy(), np.zeros(cars), state.copy()
    plant, scratch = numbers(load_vehicle(find("vehicles", "paper"))), make_scratch(4000)
    still, queue = np.zeros((round(SETTINGS.sample_time / step), 2)), np.zeros(0)
    seen, bounds = [V_Y, YAW, YAW_RATE, Y], limits()

    def advance(seconds: float) -> int:
        ticks = round(seconds / SETTINGS.sample_time)
        for _ in range(ticks):
            for i in range(cars):
                x = np.append(state[i, seen] - last[i, seen], state[i, Y])
                tick = Tick(state[i, V_X], x, steering[i], 0.0)
                steering[i] += planned(GAINS, bounds, tick, scratch).Delta_u
                last[i] = state[i]
                state[i] = drive(state[i], queue, steering[i], speed[i], still, 0.9, step, plant)
        return ticks * cars

    return advance
