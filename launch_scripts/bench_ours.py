"""What is measured of ours, behind plain functions: the one place that follows changes of it."""

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings
from ampc_msgs_config.path import Array
from ampc_ros.gain_table import Gains, load_gain_table
from ampc_ros.laguerre import network
from ampc_ros.lateral_mpc import Limits, Tick, limits_of, plan, problem
from ampc_ros.model import Vehicle
from ampc_ros.qp import SOLVED, Qp, active_set
from sim_vehicle.parameters import load_vehicle, numbers
from sim_vehicle.vehicle import SIZE, V_X, V_Y, YAW, YAW_RATE, Y, drive

VEHICLE: Vehicle = astuple(load(ChassisParameters, find("vehicles", "paper"), "chassis"))
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
GAINS = load_gain_table("table3").nodes[0]
"""(45, 15, 5): the paper's sizes."""


class Task(NamedTuple):
    """One tick to answer: gains, lane, and what the controller knows."""

    gains: Gains
    half_width: float
    """Of the soft lane; infinite: no output rows [m]."""
    tick: Tick


class TwoSided(NamedTuple):
    """Minimise 1/2 x' E x + x' K subject to low <= A x <= high, as most solvers want it."""

    E: Array
    """(n, n)."""
    K: Array
    """(n,)."""
    A: Array
    """(m, n)."""
    low: Array
    """(m,), -inf where there is no bound."""
    high: Array
    """(m,), inf where there is no bound."""


def limits(half_width: float = math.inf) -> Limits:
    """Give the limits of Table 3, with a lane if asked for."""
    return limits_of(replace(SETTINGS, max_output_error=half_width))


def posed(task: Task) -> TwoSided:
    """Pose the programme of a tick with the readable functions; the two sides of a row are one."""
    E, K, M, gamma = problem(VEHICLE, task.gains, limits(task.half_width), task.tick)
    h = 4 * task.gains.control_horizon
    A = np.vstack((M[:h:2], M[h:]))
    low = np.append(-gamma[1:h:2], np.full(len(M) - h, -math.inf))
    return TwoSided(E, K, A, low, np.append(gamma[:h:2], gamma[h:]))


def prepared(qp: TwoSided) -> Qp:
    """Bring a programme into the form of our solver."""
    rows, bounds = one_sided(qp)
    return Qp(qp.E, qp.K, rows, bounds)


def one_sided(qp: TwoSided) -> tuple[Array, Array]:
    """Rows and bounds of M x <= gamma."""
    lower = np.isfinite(qp.low)
    M = np.vstack((qp.A, -qp.A[lower]))
    return np.ascontiguousarray(M), np.append(qp.high, -qp.low[lower])


def qp_alone(qp: Qp) -> Array | None:
    """Solve; nothing where the solver says that there is no solution."""
    solution = active_set(qp)
    return solution.x if solution.status == SOLVED else None


def whole_tick(task: Task) -> float | None:
    """Answer a tick by its first move [rad]."""
    Delta_u, _, _, solution = plan(VEHICLE, task.gains, TABLE_3, task.tick)
    return Delta_u if solution.status == SOLVED else None


TABLE_3 = limits()


def first_laguerre(gains: Gains) -> Array:
    """L(0), which makes the first move of eta (N,)."""
    return network(gains.laguerre_pole, gains.laguerre_terms)[1]


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
    plant = numbers(load_vehicle(find("vehicles", "paper")))
    still, queue = np.zeros((round(SETTINGS.sample_time / step), 2)), np.zeros(0)
    seen = [V_Y, YAW, YAW_RATE, Y]

    def advance(seconds: float) -> int:
        ticks = round(seconds / SETTINGS.sample_time)
        for _ in range(ticks):
            for i in range(cars):
                x = np.append(state[i, seen] - last[i, seen], state[i, Y])
                tick = Tick(state[i, V_X], x, steering[i], 0.0)
                steering[i] += plan(VEHICLE, GAINS, TABLE_3, tick)[0]
                last[i] = state[i]
                state[i] = drive(state[i], queue, steering[i], speed[i], still, 0.9, step, plant)
        return ticks * cars

    return advance
