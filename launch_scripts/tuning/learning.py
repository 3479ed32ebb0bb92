"""Learned schedules of pole and increment weight: situations, fit, and file.

The targets are the best gains of separate searches at a grid of speed, curvature and latency, on
the training plants. A network or an ANFIS is fitted to them with SciPy's `least_squares`.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from scipy import optimize

from ampc_msgs_config.config import dump, schema_line, shipped_schema
from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_schedule import (
    Anfis,
    FuzzyRule,
    GainSchedule,
    Network,
    Neuron,
    ScheduledGains,
    Situation,
    anfis_outputs,
    network_outputs,
    scale_inputs,
)
from ampc_ros.mpc.gain_table import Gains
from launch_scripts.tuning.drives import CURVATURE, LANE_CHANGE_ACCELERATION, STRAIGHT_CURVATURE
from launch_scripts.tuning.fitness import SITUATION, Node
from launch_scripts.tuning.methods import SearchRecord
from launch_scripts.tuning.search import Checkpoints, SearchResult, run_searches
from launch_scripts.tuning.smoothness import smoothest
from launch_scripts.tuning.task import SINGLE, Search, TuningTask
from launch_scripts.tuning.workers import Workers

ADDED_LATENCIES = (0.0, 0.1, 0.2)
"""Delays of the situations in addition to the latency of the vehicle [s]."""
SHARES = (0.0, 1.0 / 3.0, 1.0)
"""Curvatures of the situations, relative to that of the lane change of the fitness."""
NEURONS, RULE_COUNT = 6, 3
"""Sizes of the two kinds."""
WIDTHS = (0.6, 4.0)
"""Bounds of the widths of memberships; the inputs span 2. Narrower ones interpolate badly."""
FIT_STARTS = 3
"""Random starts of a fit; the one with the smallest residual is used."""
POLE_ERROR, WEIGHT_ERROR = 0.1, 0.5
"""Errors of the pole and of log10 R that count the same."""
SHRINKAGE = 0.02
"""Weight of the parameters themselves in the residual, which keeps them small."""
LARGEST = 20.0
"""Bound of the parameters."""
MOST_FIT_STEPS = 60
"""Largest number of steps of a fit."""
PARAMETER_DIGITS = 6
"""Significant digits of a parameter in the file."""


class Target(NamedTuple):
    """Best gains in one situation."""

    situation: Situation
    gains: Gains
    fitness: float


class Learned(NamedTuple):
    """Result of a training."""

    kind: str
    """One of SCHEDULES."""
    schedule: GainSchedule
    single: Gains
    """The best single gain set of the same task: horizons, terms, Q, and the fallback."""
    targets: list[Target]
    residual: float
    """Root mean square, see `fit_schedule`."""


def situations(task: TuningTask) -> list[tuple[Situation, Node]]:
    """Return the situations of the training with their nodes, the speeds fastest."""
    result = []
    for added, share in product(ADDED_LATENCIES, SHARES):
        for node in task.nodes():
            steering = node.vehicle.steering
            delayed = replace(steering, delay=steering.delay + added)
            bend = min(LANE_CHANGE_ACCELERATION / node.speed**2, CURVATURE)
            curvature = max(share * bend, STRAIGHT_CURVATURE)
            latency = delayed.delay + delayed.time_constant
            vehicle = node.vehicle._replace(steering=delayed)
            node = node._replace(vehicle=vehicle, kind=SITUATION, curvature=curvature)
            result.append((Situation(node.speed, curvature, latency), node))
    return result


def schedule_searches(task: TuningTask) -> list[Search]:
    """Return the search for the single gain set, and one for each situation, for each seed."""
    nodes = [node for _, node in situations(task)]
    return [
        *(search for search in task.searches() if search.purpose == SINGLE),
        *(
            task.search(SITUATION, seed, i, (node,), task.evaluations)
            for seed in task.seeds
            for i, node in enumerate(nodes)
        ),
    ]


def choose_targets(task: TuningTask, results: dict[str, SearchResult]) -> list[Target]:
    """Return the best gains in all situations, similar at neighbouring speeds.

    The results of all seeds are candidates. Situations in which each gain set loses a car are left
    out.
    """
    targets, line, n = [], [], len(task.speeds)
    for i, (situation, _) in enumerate(situations(task)):
        names = [f"{SITUATION}_{seed}_{i:03d}" for seed in task.seeds]
        pairs = [pair for name in names for pair in results[name] if math.isfinite(pair[1])]
        if pairs:
            line.append((situation, pairs))
        if (i + 1) % n == 0 and line:  # a line of speeds is complete
            chosen = smoothest([each for _, each in line])
            targets += [
                Target(at, gains, dict(each)[gains])
                for (at, each), gains in zip(line, chosen, strict=True)
            ]
            line = []
    return targets


def ranges(targets: Sequence[Target]) -> dict[str, tuple[float, float]]:
    """Return the ranges of the inputs and outputs of a schedule: those of its targets."""
    columns = {key: [getattr(each.situation, key) for each in targets] for key in Situation._fields}
    for key in ScheduledGains._fields:
        columns[key] = [getattr(each.gains, key) for each in targets]
    return {key: (min(values), max(values)) for key, values in columns.items()}


def make_network(parameters: Array, ends: Mapping[str, Any]) -> Network:
    """Return the network with some parameters (6 NEURONS + 2,) and ranges."""
    rows: Any = parameters[2:].reshape(NEURONS, 6).tolist()
    neurons = tuple(Neuron(inputs=row[:4], outputs=row[4:]) for row in rows)
    biases: Any = tuple(parameters[:2].tolist())
    return Network(neurons=neurons, biases=biases, **ends)


def make_anfis(parameters: Array, ends: Mapping[str, Any]) -> Anfis:
    """Return the ANFIS with some parameters (14 RULE_COUNT,) and ranges; widths are exponents."""
    rows: Any = parameters.reshape(RULE_COUNT, 14).tolist()
    rules = tuple(
        FuzzyRule(
            centre=row[:3],
            width=tuple(np.clip(np.exp(row[3:6]), *WIDTHS).tolist()),
            laguerre_pole=row[6:10],
            increment_weight=row[10:],
        )
        for row in rows
    )
    return Anfis(rules=rules, **ends)


def fit_schedule(kind: str, targets: Sequence[Target], seed: int) -> tuple[GainSchedule, float]:
    """Fit a schedule to targets.

    Args:
        kind: One of SCHEDULES.
        targets: Situations and gains.
        seed: Of the random starts.

    Returns:
        The schedule, and the root mean square of its residuals in the units of POLE_ERROR and
        WEIGHT_ERROR.
    """
    make: Any = make_network if kind == "network" else make_anfis
    outputs: Any = network_outputs if kind == "network" else anfis_outputs
    size = 6 * NEURONS + 2 if kind == "network" else 14 * RULE_COUNT
    ends = ranges(targets)
    wanted = [(t.gains.laguerre_pole, math.log10(t.gains.increment_weight)) for t in targets]
    inputs = [scale_inputs(make(np.zeros(size), ends), target.situation) for target in targets]
    weights = 1.0 / np.array([POLE_ERROR, WEIGHT_ERROR])

    def errors(parameters: Array) -> Array:
        schedule = make(parameters, ends)
        return (np.array([outputs(schedule, u) for u in inputs]) - wanted) * weights

    def residuals(parameters: Array) -> Array:
        return np.append(errors(parameters), SHRINKAGE * parameters)

    least_squares: Any = optimize.least_squares  # mypy takes it for a module
    rng = np.random.default_rng(seed)
    starts = [0.5 * rng.standard_normal(size) for _ in range(FIT_STARTS)]
    fits = [least_squares(residuals, x, bounds=(-LARGEST, LARGEST), max_nfev=MOST_FIT_STEPS)
            for x in starts]  # fmt: skip
    best = min(fits, key=lambda each: float(each.cost)).x
    rounded = np.array([float(f"{each:.{PARAMETER_DIGITS}g}") for each in best])
    return make(rounded, ends), float(np.sqrt(np.mean(errors(rounded) ** 2)))


def learn(
    task: TuningTask,
    kind: str,
    workers: Workers,
    checkpoints: Checkpoints,
    show: Callable[[Search, SearchRecord], None],
) -> Learned:
    """Search the targets and the single gain set, and fit a schedule.

    Raises:
        ValueError: Every gain set loses a car.
    """
    return fit_results(
        task, kind, run_searches(schedule_searches(task), workers, checkpoints, show)
    )


def check_learnable(task: TuningTask) -> None:
    """Raise a ValueError unless a schedule can be learned for a task."""
    if task.formulation != "preview" or task.kind != "robust":
        raise ValueError("--schedule: needs --formulation preview and --fitness robust")
    if len(task.speeds) < 2:
        raise ValueError(f"--schedule: needs two speeds or more, not {list(task.speeds)}")


def fit_results(task: TuningTask, kind: str, results: dict[str, SearchResult]) -> Learned:
    """Fit a schedule to the results of `schedule_searches`.

    Raises:
        ValueError: Every gain set loses a car.
    """
    singles = [results[name][0] for name in results if name.startswith(f"{SINGLE}_")]
    single, targets = min(singles, key=lambda pair: pair[1]), choose_targets(task, results)
    if not math.isfinite(single[1]) or not targets:
        raise ValueError("search: every gain set loses a car: choose other bounds or speeds")
    schedule, residual = fit_schedule(kind, targets, task.seeds[0])
    return Learned(kind, schedule, single[0], targets, residual)


def schedule_yaml(task: TuningTask, learned: Learned, command: str, file: Path) -> str:
    """Return the YAML text of a gain file with a learned schedule and its provenance."""
    origin = {
        "command": command,
        **task.describe(),
        "schedule": learned.kind,
        "targets": len(learned.targets),
        "evaluations_at_nodes": sum(search.drives for search in schedule_searches(task)),
        "residual": float(f"{learned.residual:.4g}"),
    }
    content = {
        "speed": [task.speeds[0]],
        "gains": [learned.single._asdict()],
        "schedule": msgspec.to_builtins(learned.schedule),
        "provenance": origin,
    }
    text = dump(content, width=100, default_flow_style=None)
    return f"{schema_line(shipped_schema('gains'), file)}\n# Again: {command}\n{text}"
