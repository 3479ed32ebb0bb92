"""Quadratic programs from closed loops, with the exact first move of each."""

import math
from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import at_distance, wrap_angle
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.paths.path_frame import path_frame, place, set_point
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import Array
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.mpc.qp import Qp
from ampc_ros.paper.qp_assembly import StepInput
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import load_vehicle_file
from tests.workshop.bench.bench_ours import GAINS, SETTINGS, Task, laguerre, qp_of
from tests.workshop.bench.bench_qp import exact_move, one_sided

CAR = load_vehicle_file(find("vehicles", "paper"))
SCENARIOS = ("sc3_constant", "sc2")
KINDS = ("recorded", "perturbed", "lane with slack", "repeated rows", "hard lane", "infeasible")
SPREAD = np.array([0.3, 0.03, 0.1, 0.2, 1.5])
"""Scale of the random perturbations of [Delta v_y, Delta yaw, Delta r, Delta Y, Y], SI units."""
BORDER = 1e-6
"""Relative distance to the border of feasibility below which a problem is omitted."""


class Problem(NamedTuple):
    """A quadratic program and its exact first move."""

    kind: str
    qp: Qp
    L_0: Array
    """First move = L(0)' x, zero at the slack (n,)."""
    move: float
    """First move of the solution [rad]; NaN: infeasible."""
    doubt: float
    """Bound of the error of `move` [rad]."""
    active: int
    """Number of active rows."""


def problems(count: int, seed: int = 1) -> list[Problem]:
    """Return a number of problems of every kind."""
    rng = np.random.default_rng(seed)
    ticks = recorded_ticks()
    return [p for kind in KINDS for p in islice(of_kind(kind, ticks, rng), count)]


def recorded_ticks() -> list[StepInput]:
    """Return the inputs of the paper's controller in closed loop, tick by tick."""
    return [tick for name in SCENARIOS for tick in ticks_of(*drive_scenario(name))]


def drive_scenario(name: str) -> tuple[Drive, Path]:
    """Drive a scenario with the paper's controller; return drive and path."""
    scenario = load_scenario(name, CAR.size)
    driven = drive(Simulation(CAR, scenario), make_controller(Choices("paper")))
    return driven, make_path(scenario.points)


def ticks_of(driven: Drive, path: Path) -> list[StepInput]:
    """Reconstruct the inputs of the controller at each tick of a drive."""
    frame, ticks = path_frame(path), []
    last: Array | None = None
    for k, state in enumerate(driven.states):
        car = at_distance(state, CAR.chassis.cg_to_rear_axle)
        X, Y, yaw = place(frame, car.x, car.y, car.yaw)
        x = np.array([car.v_y, yaw, car.yaw_rate, Y])
        Delta_x = np.zeros(4) if last is None else x - last
        Delta_x[1], last = wrap_angle(Delta_x[1]), x
        u = float(driven.steering[k - 1]) if k else 0.0
        ticks.append(StepInput(car.v_x, np.append(Delta_x, Y), u, set_point(frame, X)))
    return ticks


def perturbed(tick: StepInput, rng: np.random.Generator) -> StepInput:
    """Perturb a recorded tick so that bounds become active."""
    x = tick.x + rng.choice([0.3, 1.0, 3.0]) * SPREAD * rng.standard_normal(5)
    u = rng.uniform(-1.0, 1.0) * SETTINGS.max_angle
    return StepInput(tick.v_x * rng.uniform(0.7, 1.3), x, u, tick.r)


def task_of(kind: str, ticks: list[StepInput], rng: np.random.Generator) -> Task:
    """Return a random tick of a kind."""
    tick = ticks[rng.integers(len(ticks))]
    if kind != "recorded":
        tick = perturbed(tick, rng)
    half_width = rng.uniform(0.1, 3.0) if "lane" in kind or kind == "infeasible" else math.inf
    return Task(GAINS, half_width, tick)


def of_kind(kind: str, ticks: list[StepInput], rng: np.random.Generator) -> Iterator[Problem]:
    """Yield random problems of a kind without end."""
    while True:
        qp = qp_of(task_of(kind, ticks, rng))
        if kind == "repeated rows":
            qp = with_repeated_rows(qp, rng)
        if kind in ("hard lane", "infeasible"):
            qp = without_slack(qp)
            room = room_inside(qp)
            if abs(room) < BORDER or (room > 0) != (kind == "hard lane"):
                continue
        yield with_solution(kind, qp)


def with_repeated_rows(qp: Qp, rng: np.random.Generator) -> Qp:
    """Repeat half of the rows, some scaled, so that active rows are linearly dependent."""
    chosen = rng.permutation(len(qp.M))[: len(qp.M) // 2]
    scale = rng.choice([1.0, 1.0, 3.0], len(chosen))
    return qp._replace(
        M=np.vstack((qp.M, scale[:, None] * qp.M[chosen])),
        low=np.append(qp.low, scale * qp.low[chosen]),
        high=np.append(qp.high, scale * qp.high[chosen]),
    )


def without_slack(qp: Qp) -> Qp:
    """Remove the slack, the last unknown and the last row, so that the lane is a hard bound."""
    n = len(qp.K) - 1
    E, M = np.ascontiguousarray(qp.E[:n, :n]), np.ascontiguousarray(qp.M[:-1, :n])
    return Qp(E, qp.K[:n].copy(), M, qp.low[:-1].copy(), qp.high[:-1].copy())


def room_inside(qp: Qp) -> float:
    """Return the largest possible distance to all bounds, up to 1; negative if infeasible.

    Rows are scaled to length 1; HiGHS solves the linear program.
    """
    M, gamma = one_sided(qp)
    lengths = np.linalg.norm(M, axis=1)
    room = np.append(np.zeros(len(qp.K)), 1.0)
    rows = np.vstack((np.column_stack((M / lengths[:, None], np.ones(len(M)))), room))
    result = linprog(-room, rows, np.append(gamma / lengths, 1.0), bounds=(None, None))
    return float(result.x[-1])


def with_solution(kind: str, qp: Qp) -> Problem:
    """Return the problem with its exact first move."""
    L_0 = np.append(laguerre(GAINS)[0], np.zeros(len(qp.K) - GAINS.laguerre_terms))
    if kind == "infeasible":
        return Problem(kind, qp, L_0, math.nan, 0.0, 0)
    return Problem(kind, qp, L_0, *exact_move(qp, L_0))
