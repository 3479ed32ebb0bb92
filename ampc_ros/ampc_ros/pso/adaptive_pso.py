"""Adaptive particle swarm: evolutionary state estimation, adapted weights, elitist learning.

Z.-H. Zhan, J. Zhang, Y. Li, H. S.-H. Chung, "Adaptive Particle Swarm Optimization", IEEE Trans.
Systems, Man, and Cybernetics B 39(6), 2009, pp. 1362-1381: reference [23] of the paper. Published
with a velocity clamp of 20 % of the range, as `PsoSettings` has it.
"""

import numpy as np

from ampc_msgs_config.types import Array
from ampc_ros.pso.swarm import Swarm, Task, Weights

EXPLORATION, EXPLOITATION, CONVERGENCE, JUMPING_OUT = range(4)
FIRST = Weights(0.9, 2.0, 2.0)
MEMBERSHIP = (
    ((0.4, 0.6, 0.7, 0.8), (0.0, 1.0, 1.0, 0.0)),
    ((0.2, 0.3, 0.4, 0.6), (0.0, 1.0, 1.0, 0.0)),
    ((0.1, 0.3), (1.0, 0.0)),
    ((0.7, 0.9), (0.0, 1.0)),
)
"""Of the evolutionary factor in each state: corners of the trapezium, and values there."""
DIRECTIONS = ((1.0, -1.0), (0.5, -0.5), (0.5, 0.5), (-1.0, 1.0))
"""Of the changes of c_1 and c_2 in each state."""
RATE = (0.05, 0.1)
"""Least and greatest change of c_1 and c_2 in a generation."""
ACCELERATION = (1.5, 2.5)
"""Least and greatest c_1 and c_2."""
GREATEST_SUM = 4.0
"""Of c_1 and c_2; above it both are scaled down."""
LEARNING = (1.0, 0.1)
"""Elitist learning rate, standard deviation of the jump, at the start and end of the schedule."""


def adapted(swarm: Swarm, task: Task) -> Swarm:
    """Estimate the evolutionary state, and set the weights for the next move."""
    f = evolutionary_factor(swarm.position / (task.space.high - task.space.low), swarm.leader)
    state = classified(f, swarm.state)
    return swarm._replace(state=state, weights=adapted_weights(swarm.weights, f, state, task.rng))


def evolutionary_factor(position: Array, leader: int) -> float:
    """How far away the leader is from the swarm, 0 (amid) to 1 (the farthest particle).

    Args:
        position: (n, d), of dimensions that can be compared. Published without a scale, for
            functions whose dimensions all have the same range.
        leader: Index of the globally best particle.

    Returns:
        f = (d_g - d_min) / (d_max - d_min) of the mean distances d to all other particles; 0 where
        all are equal.
    """
    apart = np.sqrt(np.square(position[:, None] - position[None]).sum(axis=2))  # (n, n)
    d = apart.sum(axis=1) / (len(position) - 1)
    span = d.max() - d.min()
    return float((d[leader] - d.min()) / span) if span > 0 else 0.0


def classified(f: float, before: int) -> int:
    """Evolutionary state of a factor; where two are possible, the state before decides.

    It stays where it was, else goes to its successor in exploration -> exploitation -> convergence
    -> jumping out -> exploration, else where the membership is greatest.
    """
    degrees = [float(np.interp(f, *corners)) for corners in MEMBERSHIP]
    for state in (before, (before + 1) % len(degrees)):
        if degrees[state] > 0:
            return state
    return int(np.argmax(degrees))


def adapted_weights(before: Weights, f: float, state: int, rng: np.random.Generator) -> Weights:
    """Inertia as a sigmoid of the factor, and accelerations one step in the state's direction."""
    rates = rng.uniform(*RATE, 2)
    c = np.array(before[1:]) + np.array(DIRECTIONS[state]) * rates
    c = np.clip(c, *ACCELERATION)
    c *= min(1.0, GREATEST_SUM / c.sum())
    return Weights(float(1 / (1 + 1.5 * np.exp(-2.6 * f))), float(c[0]), float(c[1]))


def learned(swarm: Swarm, task: Task) -> Swarm:
    """Let the leader of a converged swarm try a jump in one dimension: one more evaluation.

    A better place becomes its best; a worse one is where the worst particle goes.
    """
    if swarm.state != CONVERGENCE:
        return swarm
    place = jump(swarm, task)
    fitness = float(task.evaluate(place[None])[0])
    if fitness < swarm.best_fitness[swarm.leader]:
        return _remembering(swarm, swarm.leader, place, fitness)
    worst = int(np.argmax(swarm.fitness))
    swarm = swarm._replace(position=_with_row(swarm.position, worst, place))
    better = fitness < swarm.best_fitness[worst]
    return _remembering(swarm, worst, place, fitness) if better else swarm


def jump(swarm: Swarm, task: Task) -> Array:
    """Place of the leader's jump (d,): Gb, one dimension of it changed by a normal number."""
    _, (low, high, _), settings, rng = task
    time = min(swarm.generation / settings.schedule, 1.0)
    sigma = LEARNING[0] + (LEARNING[1] - LEARNING[0]) * time
    place = swarm.best_position[swarm.leader].copy()
    d = rng.integers(len(place))
    place[d] += (high[d] - low[d]) * rng.normal(0.0, sigma)
    clipped: Array = np.clip(place, low, high)
    return clipped


def _remembering(swarm: Swarm, who: int, place: Array, fitness: float) -> Swarm:
    return swarm._replace(
        best_position=_with_row(swarm.best_position, who, place),
        best_fitness=_with_row(swarm.best_fitness, who, fitness),
    )


def _with_row(values: Array, index: int, row: Array | float) -> Array:
    changed = values.copy()
    changed[index] = row
    return changed
