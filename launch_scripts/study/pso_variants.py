"""Swarms of the paper's comparison: classic, linear, damped, authors' code, Zhan's adaptive swarm.

Z.-H. Zhan, J. Zhang, Y. Li, H. S.-H. Chung, "Adaptive Particle Swarm Optimization", IEEE Trans.
Systems, Man, and Cybernetics B 39(6), 2009, pp. 1362-1381: reference [23] of the paper. The
publication clamps velocities to 20 % of the range, the default of `PsoSettings`.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ampc_msgs_config.types import Array
from ampc_msgs_config.validation import choice, number
from ampc_ros.pso.swarm import PsoSettings, Space, Swarm, SwarmContext, Weights

VARIANTS = ("proposed", "linear", "damped", "classic", "authors_code", "adaptive")
EXPLORATION, EXPLOITATION, CONVERGENCE, JUMPING_OUT = range(4)
INITIAL_WEIGHTS = Weights(0.9, 2.0, 2.0)
"""Weights of the adaptive swarm before its first move."""
MEMBERSHIP = (
    ((0.4, 0.6, 0.7, 0.8), (0.0, 1.0, 1.0, 0.0)),
    ((0.2, 0.3, 0.4, 0.6), (0.0, 1.0, 1.0, 0.0)),
    ((0.1, 0.3), (1.0, 0.0)),
    ((0.7, 0.9), (0.0, 1.0)),
)
"""Membership of the evolutionary factor in each state: corners of the trapezium, values there."""
DIRECTIONS = ((1.0, -1.0), (0.5, -0.5), (0.5, 0.5), (-1.0, 1.0))
"""Direction of the changes of c_1 and c_2 in each state."""
RATE_RANGE = (0.05, 0.1)
"""Range of the change of c_1 and c_2 in a generation."""
ACCELERATION_RANGE = (1.5, 2.5)
"""Range of c_1 and c_2."""
MAX_SUM = 4.0
"""Upper bound of c_1 + c_2; above it both are scaled down."""
LEARNING = (1.0, 0.1)
"""Standard deviation of the jump at the start and at the end of the schedule."""


@dataclass(frozen=True, kw_only=True)
class VariantSettings(PsoSettings):
    """Settings of the swarms that only the study uses."""

    variant: Annotated[
        str,
        choice(
            VARIANTS,
            "proposed: Eqs. (33), (34). linear: Eq. (32). damped: omega(k+1) = omega(k) damping. "
            "classic: omega = max_inertia. authors_code: as proposed, with the error of the "
            "authors' code in Eq. (34). adaptive: Zhan et al.",
        ),
    ] = "proposed"
    schedule_length: Annotated[
        int, number(0, 1_000_000, "", "G of Eqs. (32)-(34); 0: the number of generations.")
    ] = 0
    inertia_damping: Annotated[float, number(0.0, 1.0, "", "Damping of variant damped.")] = 0.99
    boundary: Annotated[
        str,
        choice(
            ("clip", "absorb", "reflect"),
            "A particle that leaves is put on the bound. clip keeps its velocity, absorb removes "
            "the outward component, reflect mirrors position and velocity.",
        ),
    ] = "clip"

    @property
    def schedule(self) -> int:
        """G of Eqs. (32)-(34)."""
        return self.schedule_length or super().schedule

    def weights(self, g: int) -> Weights:
        """Return the weights of the move that follows generation g."""
        return INITIAL_WEIGHTS if self.variant == "adaptive" else super().weights(g)

    def inertia(self, g: int) -> float:
        """Return omega: Eq. (32), Eq. (33), damped or constant."""
        high, low = self.max_inertia, self.min_inertia
        if self.variant == "linear":
            return high - (high - low) * min(g / self.schedule, 1.0)
        if self.variant == "damped":
            return high * self.inertia_damping**g
        return high if self.variant == "classic" else super().inertia(g)

    def schedule_times(self, g: int) -> list[float]:
        """Return the times g/G of Eq. (34) so far; none where c_1 and c_2 are constant.

        Note:
            The authors' code compares the particle counter, not the generation, with the limits of
            Eq. (34). It always takes the same branch.
        """
        if self.variant == "authors_code":
            return [(self.particles - 1) / self.schedule] * g
        return super().schedule_times(g) if self.variant == "proposed" else []

    def adapt(self, swarm: Swarm, context: SwarmContext) -> Swarm:
        """Set the weights of the next move; the adaptive swarm may also move its leader."""
        if self.variant != "adaptive":
            return super().adapt(swarm, context)
        space = context.space
        f = evolutionary_factor(swarm.position / (space.high - space.low), swarm.leader)
        state = classify_state(f, swarm.state)
        weights = adapt_weights(swarm.weights, f, state, context.rng)
        return learn_from_jump(swarm._replace(state=state, weights=weights), context)

    def keep_inside(self, position: Array, velocity: Array, space: Space) -> tuple[Array, Array]:
        """Move positions (n, d) by velocities (n, d), and apply the boundary rule."""
        if self.boundary == "clip":
            return super().keep_inside(position, velocity, space)
        moved = position + velocity
        inside = np.clip(moved, space.low, space.high)
        if self.boundary == "absorb":
            return inside, np.where(inside == moved, velocity, 0.0)
        mirrored = np.clip(2 * inside - moved, space.low, space.high)
        return mirrored, np.where(inside == moved, velocity, -velocity)


def evolutionary_factor(position: Array, leader: int) -> float:
    """Return the distance of the leader from the swarm, from 0 (centre) to 1 (farthest particle).

    Args:
        position: (n, d), scaled to comparable dimensions. The publication has no scale, because its
            functions have the same range in all dimensions.
        leader: Index of the globally best particle.

    Returns:
        f = (d_g - d_min) / (d_max - d_min) of the mean distances d to all other particles; 0 where
        all are equal.
    """
    apart = np.sqrt(np.square(position[:, None] - position[None]).sum(axis=2))  # (n, n)
    d = apart.sum(axis=1) / (len(position) - 1)
    span = d.max() - d.min()
    return float((d[leader] - d.min()) / span) if span > 0 else 0.0


def classify_state(f: float, before: int) -> int:
    """Return the evolutionary state of a factor; the state before decides between two candidates.

    The state stays if it can. Otherwise it advances in the order exploration, exploitation,
    convergence, jumping out, exploration. Otherwise the greatest membership decides.
    """
    degrees = [float(np.interp(f, *corners)) for corners in MEMBERSHIP]
    for state in (before, (before + 1) % len(degrees)):
        if degrees[state] > 0:
            return state
    return int(np.argmax(degrees))


def adapt_weights(before: Weights, f: float, state: int, rng: np.random.Generator) -> Weights:
    """Return the inertia, a sigmoid of the factor, and the accelerations changed by the state."""
    rates = rng.uniform(*RATE_RANGE, 2)
    c = np.array(before[1:]) + np.array(DIRECTIONS[state]) * rates
    c = np.clip(c, *ACCELERATION_RANGE)
    c *= min(1.0, MAX_SUM / c.sum())
    return Weights(float(1 / (1 + 1.5 * np.exp(-2.6 * f))), float(c[0]), float(c[1]))


def learn_from_jump(swarm: Swarm, context: SwarmContext) -> Swarm:
    """Evaluate a jump of the leader of a converged swarm in one dimension.

    A better position becomes the leader's best. A worse one becomes the position of the worst
    particle.
    """
    if swarm.state != CONVERGENCE:
        return swarm
    jump = leader_jump(swarm, context)
    fitness, index = float(context.evaluate(jump[None])[0]), swarm.leader
    if fitness >= swarm.best_fitness[index]:
        index = int(np.argmax(swarm.fitness))
        swarm = swarm._replace(position=_with_row(swarm.position, index, jump))
    if fitness >= swarm.best_fitness[index]:
        return swarm
    return swarm._replace(
        best_position=_with_row(swarm.best_position, index, jump),
        best_fitness=_with_row(swarm.best_fitness, index, fitness),
    )


def leader_jump(swarm: Swarm, context: SwarmContext) -> Array:
    """Return Gb (d,) with one dimension changed by a normally distributed number."""
    _, (low, high, _), settings, rng = context
    time = min(swarm.generation / settings.schedule, 1.0)
    sigma = LEARNING[0] + (LEARNING[1] - LEARNING[0]) * time
    position = swarm.best_position[swarm.leader].copy()
    d = rng.integers(len(position))
    position[d] += (high[d] - low[d]) * rng.normal(0.0, sigma)
    clipped: Array = np.clip(position, low, high)
    return clipped


def _with_row(values: Array, index: int, row: Array | float) -> Array:
    changed = values.copy()
    changed[index] = row
    return changed
