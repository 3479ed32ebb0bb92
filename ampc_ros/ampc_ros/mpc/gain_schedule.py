"""Learned schedule: pole and increment weight as a function of speed, curvature and latency.

A gain file may hold a `schedule` beside its gain set: a small neural network, or an adaptive-
network-based fuzzy inference system (ANFIS: J.-S. R. Jang, IEEE Transactions on Systems, Man, and
Cybernetics 23(3), 1993; here Takagi-Sugeno rules of first order with Gaussian memberships).
`tune.py --schedule` fits them; see doc/learned_schedule.md.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul
from typing import Annotated, NamedTuple

import msgspec

from ampc_msgs_config.validation import Checked, described, number

CURVATURE_PREVIEW = 2.0
"""Time over which the largest curvature ahead is taken [s]."""
Coefficient = Annotated[float, number(-1.0e6, 1.0e6)]
Affine = tuple[Coefficient, Coefficient, Coefficient, Coefficient]
"""Constant, and coefficients of the scaled speed, curvature and latency."""
Width = Annotated[float, number(1.0e-3, 1.0e3)]
SpeedEnd = Annotated[float, number(0.1, 200.0, "m/s")]
CurvatureEnd = Annotated[float, number(1.0e-6, 10.0, "1/m")]
LatencyEnd = Annotated[float, number(0.0, 10.0, "s")]
PoleEnd = Annotated[float, number(0.0, 0.999)]
WeightEnd = Annotated[float, number(1.0e-9, 1.0e9)]


class Situation(NamedTuple):
    """Inputs of a schedule."""

    speed: float
    """[m/s]."""
    curvature: float
    """Largest |curvature| of the path over CURVATURE_PREVIEW [1/m]."""
    latency: float
    """Delay and lag of the steering in the internal model [s]."""


class ScheduledGains(NamedTuple):
    """Outputs of a schedule."""

    laguerre_pole: float
    increment_weight: float


class ScheduleShape(msgspec.Struct, frozen=True, tag_field="kind", forbid_unknown_fields=True):
    """Learned schedule of a gain file; `kind` selects one of the subclasses.

    Inputs and outputs are clipped to their ranges. The inputs are scaled to -1 .. 1, speed and
    curvature in the logarithm. The outputs are the pole and the decimal logarithm of R.
    """

    speed: Annotated[tuple[SpeedEnd, SpeedEnd], described("Least and greatest speed.")]
    curvature: Annotated[
        tuple[CurvatureEnd, CurvatureEnd], described("Least and greatest curvature ahead.")
    ]
    latency: Annotated[
        tuple[LatencyEnd, LatencyEnd], described("Least and greatest latency of the steering.")
    ]
    laguerre_pole: Annotated[tuple[PoleEnd, PoleEnd], described("Least and greatest pole, alpha.")]
    increment_weight: Annotated[
        tuple[WeightEnd, WeightEnd], described("Least and greatest increment weight, R.")
    ]

    def __post_init__(self) -> None:
        """Check the order of the ranges."""
        for key in (*Situation._fields, *ScheduledGains._fields):
            low, high = getattr(self, key)
            if high <= low:
                raise ValueError(f"{key}[1] = {high:g} must be greater than {low:g} before it")


@dataclass(frozen=True, kw_only=True)
class Neuron(Checked):
    """Neuron of the hidden layer: tanh of an affine function of the scaled inputs."""

    inputs: Annotated[Affine, described("Bias, and weights of speed, curvature and latency.")]
    outputs: Annotated[
        tuple[Coefficient, Coefficient], described("Weights of the neuron in pole and log10 R.")
    ]


class Network(ScheduleShape, frozen=True, tag="network"):
    """Neural network with one hidden layer."""

    neurons: Annotated[tuple[Neuron, ...], described("Hidden layer.", most=100)]
    biases: Annotated[
        tuple[Coefficient, Coefficient], described("Biases of the pole and of log10 R.")
    ]


@dataclass(frozen=True, kw_only=True)
class FuzzyRule(Checked):
    """Takagi-Sugeno rule of first order."""

    centre: Annotated[
        tuple[Coefficient, Coefficient, Coefficient],
        described("Centres of the Gaussian memberships of the scaled inputs."),
    ]
    width: Annotated[
        tuple[Width, Width, Width], described("Standard deviations of the memberships.")
    ]
    laguerre_pole: Annotated[
        Affine, described("Pole: constant, and slopes over speed, curvature and latency.")
    ]
    increment_weight: Annotated[Affine, described("log10 R in the same form.")]


class Anfis(ScheduleShape, frozen=True, tag="anfis"):
    """Adaptive-network-based fuzzy inference system."""

    rules: Annotated[tuple[FuzzyRule, ...], described("Rules.", most=100)]


GainSchedule = Network | Anfis


def scheduled_gains(schedule: GainSchedule, situation: Situation) -> ScheduledGains | None:
    """Return the gains in a situation; None if an input is not finite."""
    if not all(map(math.isfinite, situation)):
        return None
    u = scale_inputs(schedule, situation)
    if isinstance(schedule, Network):
        pole, log_weight = network_outputs(schedule, u)
    else:
        pole, log_weight = anfis_outputs(schedule, u)
    low, high = schedule.increment_weight
    weight = 10.0 ** clip(log_weight, math.log10(low), math.log10(high))
    return ScheduledGains(clip(pole, *schedule.laguerre_pole), clip(weight, low, high))


def scale_inputs(schedule: GainSchedule, situation: Situation) -> tuple[float, ...]:
    """Return 1 and the inputs (3,), clipped to their ranges and scaled to -1 .. 1."""
    result = [1.0]
    for key, value in situation._asdict().items():
        low, high = getattr(schedule, key)
        value = clip(value, low, high)
        if key != "latency":
            low, value, high = math.log(low), math.log(value), math.log(high)
        result.append((value - low) / (high - low) * 2.0 - 1.0)
    return tuple(result)


def network_outputs(network: Network, u: Sequence[float]) -> tuple[float, float]:
    """Return pole and log10 R of a network for 1 and the scaled inputs (4,)."""
    hidden = [math.tanh(scalar_product(neuron.inputs, u)) for neuron in network.neurons]
    pole, log_weight = (
        scalar_product((bias, *(neuron.outputs[i] for neuron in network.neurons)), (1.0, *hidden))
        for i, bias in enumerate(network.biases)
    )
    return pole, log_weight


def anfis_outputs(anfis: Anfis, u: Sequence[float]) -> tuple[float, float]:
    """Return pole and log10 R of an ANFIS for 1 and the scaled inputs (4,).

    Note:
        The firing strengths are relative to the greatest one, so that they cannot all vanish.
    """
    exponents = [
        -0.5 * math.fsum(((x - c) / s) ** 2 for x, c, s in zip(u[1:], *shape, strict=True))
        for shape in ((rule.centre, rule.width) for rule in anfis.rules)
    ]
    strengths = [math.exp(each - max(exponents)) for each in exponents]
    total = math.fsum(strengths)
    poles = [scalar_product(rule.laguerre_pole, u) for rule in anfis.rules]
    weights = [scalar_product(rule.increment_weight, u) for rule in anfis.rules]
    return scalar_product(strengths, poles) / total, scalar_product(strengths, weights) / total


def scalar_product(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the scalar product of two rows.

    Note:
        `math.fsum` rounds exactly, so that replays give the same bits with every version of Python
        and without a BLAS library.
    """
    return math.fsum(map(mul, a, b))


def clip(value: float, low: float, high: float) -> float:
    """Return a value limited to a range."""
    return min(max(value, low), high)
