"""The certificate of a gain table: measure, compare with the bounds, and write as JSON."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ampc_msgs_config.config import FOLDER, find, shipped
from ampc_msgs_config.types import Array
from ampc_ros.certificate import CERTIFICATE_VERSION, SUFFIX, content_digest, identity_of
from launch_scripts.certifying.bounds import ACCEPTANCE_BOUNDS, Bound
from launch_scripts.certifying.margins import (
    COARSE_DELAYS,
    COARSE_GAINS,
    COARSE_REDUCTIONS,
    MARGIN_DURATION,
    margins,
)
from launch_scripts.certifying.measurements import (
    OFFSETS,
    RAMP_ACCELERATION,
    SLOW,
    disturbances,
    gain_steps,
    time_constants,
)
from launch_scripts.certifying.subject import (
    DEFAULT_SPREAD,
    Subject,
    speed_grid,
    top_speed,
)
from launch_scripts.run.progress import Advance
from launch_scripts.tuning.drives import JOIN_DURATION

VALUE_DIGITS, VALUE_DECIMALS = 3, 4
"""Significant digits and decimals of a measured value."""
SHIPPED_FOLDER = FOLDER / "gains"
"""Folder of a certificate whose gain table and vehicle are both shipped."""


class Check(NamedTuple):
    """One quantity at all speeds."""

    bound: Bound
    values: tuple[float, ...]
    """Rounded values in the order of the speeds; nan or infinite: the car was lost."""

    @property
    def worst(self) -> int:
        """Index of the worst value."""
        sign = 1.0 if self.bound.at_least else -1.0
        keys = [sign * v if math.isfinite(v) else -math.inf for v in self.values]
        return keys.index(min(keys))

    @property
    def failed(self) -> tuple[int, ...]:
        """Indices of the speeds at which the bound does not hold."""
        return tuple(i for i, v in enumerate(self.values) if not self.bound.holds(v))


class Result(NamedTuple):
    """All checks of one vehicle and gain table."""

    subject: Subject
    speeds: Array
    """(n,) [m/s]."""
    out_of_reach: Array
    """Speeds of the grid that the car cannot reach [m/s]."""
    checks: tuple[Check, ...]

    @property
    def certified(self) -> bool:
        """Whether all bounds hold at all speeds."""
        return not any(check.failed for check in self.checks)

    @property
    def failures(self) -> list[str]:
        """One sentence for each bound that does not hold."""
        return [self.failure(check) for check in self.checks if check.failed]

    def failure(self, check: Check) -> str:
        """Return the sentence of a check that failed."""
        bound, i = check.bound, check.worst
        side = "at least" if bound.at_least else "at most"
        limit = f"must be {side} {with_unit(bound.limit, bound.unit)}"
        where = f"at {self.speeds[i]:g} m/s"
        share = f"{len(check.failed)} of {len(self.speeds)} speeds"
        return (
            f"{bound.title} = {with_unit(check.values[i], bound.unit)} {where}, {limit} ({share})"
        )


def with_unit(value: float, unit: str) -> str:
    """Return a value with its unit.

    A value that is not finite means that the car was lost, or for times and factors that the loop
    is unstable.
    """
    if math.isfinite(value):
        return f"{value:g} {unit}".strip()
    return "unstable" if unit in ("s", "") else "lost"


def certify(subject: Subject, threads: int, advance: Advance) -> Result:
    """Measure everything and compare it with the bounds.

    Args:
        subject: Vehicle, controller and gains.
        threads: Number of threads; they do not influence the result.
        advance: Receives the driven seconds.

    Raises:
        ValueError: The car reaches no speed of the table.
    """
    speeds, out_of_reach = speed_grid(subject.config.gains["speed"], top_speed(subject.vehicle))
    if not len(speeds):
        raise ValueError(f"the car reaches no speed of the table, from {out_of_reach[0]:g} m/s on")

    def report(stage: str) -> Callable[[float], object]:
        return lambda amount: advance(amount, stage)

    values = {
        **time_constants(subject, speeds),
        **margins(subject, speeds, threads, report("margins")),
        **disturbances(subject, speeds, threads, report("disturbances")),
        **gain_steps(subject, speeds, report("changes of the gains")),
    }
    checks = tuple(
        Check(bound, tuple(map(rounded_value, values[bound.key]))) for bound in ACCEPTANCE_BOUNDS
    )
    return Result(subject, speeds, out_of_reach, checks)


def rounded_value(value: float) -> float:
    """Return a value with VALUE_DIGITS significant digits and at most VALUE_DECIMALS decimals."""
    return round(float(f"{value:.{VALUE_DIGITS}g}"), VALUE_DECIMALS)


def to_document(result: Result) -> dict[str, Any]:
    """Return the content of a certificate file; it depends on nothing but vehicle and gains."""
    subject = result.subject
    content = {
        "version": CERTIFICATE_VERSION,
        "certified": result.certified,
        "failures": result.failures,
        "identity": identity_of(subject.config, subject.content)._asdict(),
        "vehicle": Path(subject.choices.vehicle).stem,
        "gain_table": subject.gain_table.stem,
        "settings": Path(subject.choices.settings).stem,
        "spread": {**DEFAULT_SPREAD, **subject.content.estimated},
        "speeds_out_of_reach": result.out_of_reach.tolist(),
        "speeds": result.speeds.tolist(),
        "checks": [check_document(check, result.speeds) for check in result.checks],
    }
    return {**content, "sha256": content_digest(content)}


def check_document(check: Check, speeds: Array) -> dict[str, Any]:
    """Return a check as JSON values; a value that is not finite is null: the car was lost."""
    values = [value if math.isfinite(value) else None for value in check.values]
    return {
        "key": check.bound.key,
        "holds": not check.failed,
        "limit": check.bound.limit,
        "at_least": check.bound.at_least,
        "unit": check.bound.unit,
        "worst": values[check.worst],
        "at": float(speeds[check.worst]),
        "values": values,
    }


def to_text(document: dict[str, Any]) -> str:
    """Return the text of a certificate file: one line for each key and each check."""
    lines = []
    for key, value in document.items():
        if key == "checks":
            rows = ",\n  ".join(json.dumps(each, allow_nan=False) for each in value)
            lines.append(f' "checks": [\n  {rows}\n ]')
        else:
            lines.append(f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def file_name(subject: Subject) -> str:
    """Return the name of the certificate: table and vehicle."""
    return f"{subject.gain_table.stem}.{Path(subject.choices.vehicle).stem}{SUFFIX}"


def default_folder(subject: Subject) -> Path:
    """Return the folder in which the controller looks for the certificate.

    That of the gain table; of the vehicle where the table is shipped with the package; that of the
    package where both are.
    """
    vehicle = find("vehicles", subject.choices.vehicle)
    for file, folder in ((subject.gain_table, "gains"), (vehicle, "vehicles")):
        if file not in shipped(folder).values():
            return file.parent
    return SHIPPED_FOLDER


def loop_speeds(subject: Subject) -> Array:
    """Return the speeds that a certificate checks [m/s]."""
    return np.asarray(speed_grid(subject.config.gains["speed"], top_speed(subject.vehicle))[0])


def driven_seconds(subject: Subject, speeds: Array) -> float:
    """Return how many seconds all drives take, for an estimate of the remaining time [s]."""
    per_margin = len(COARSE_DELAYS) + len(COARSE_GAINS) + len(COARSE_REDUCTIONS) + 5
    longer = np.maximum(SLOW / speeds, 1.0).sum()
    drives = len(OFFSETS) + 5 + 2 * len(subject.variations)
    ramps = 2.0 * (speeds[-1] - speeds[0]) / RAMP_ACCELERATION
    return float(longer * (per_margin * MARGIN_DURATION + drives * JOIN_DURATION) + ramps)
