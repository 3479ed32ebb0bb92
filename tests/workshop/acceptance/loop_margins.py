"""Section "eigenvalues": stability of the loop, of the linear model and of the simulated car.

The eigenvalues are those of the controller and its own linear model, so that car and controller
agree. The margins of the simulated car (two tracks, tyres with relaxation, steering with its
limits) are driven: see `delay_margins`. Its steps of 5 ms are the resolution.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ampc_msgs_config.types import Array
from ampc_ros.configuration import Choices
from launch_scripts.certifying.linear_loop import delay_margin, spectral_radius
from launch_scripts.certifying.margins import Drives, delay_margins
from launch_scripts.certifying.measurements import error_of
from launch_scripts.certifying.subject import Subject, load_subject
from tests.workshop.acceptance.trials import OTHER_TABLES

LOOP_SPEEDS = (1.0, 3.0, 5.0, 9.0, 15.0, 20.0, 27.0, 33.0, 40.0)
"""Speeds of the table [m/s]."""
SMALL = 0.02
"""Distance from the road [m] at the start of the drives that show the limit of stability."""
LOOP_RADIUS = round(math.exp(-0.1 / 2.0), 3)
"""Largest radius per tick of 0.1 s of the loop: `loop_time_constant` of certificates, 2 s."""
DELAYS = tuple(i * 0.05 for i in range(7))
"""Unknown delays that are driven before the bisection [s]."""
COLUMNS = ("radius", "estimator_radius", "margin", "small_margin", "large_margin")
"""Quantities of the table: without and with the estimator, and unknown delays."""


def subject_with_delay(car: str, delay: float) -> Subject:
    """Return a shipped car with its gain table, and a configured delay of the steering [s]."""
    subject = load_subject(Choices(vehicle=car, gain_table=OTHER_TABLES.get(car, "")))
    steering = replace(subject.vehicle.steering, delay=delay)
    config = subject.config._replace(steering=replace(subject.config.steering, delay=delay))
    return subject._replace(vehicle=subject.vehicle._replace(steering=steering), config=config)


def decays(log: Array, period: float) -> bool:
    """Return whether the deviation falls in the last 10 s, below SMALL, or to a tenth of it.

    The amplitude of a limit cycle is above SMALL.
    """
    last, before = (np.abs(part).max() for part in np.array_split(error_of(log), 3)[:0:-1])
    return bool(last < max(min(before, SMALL), 0.1 * SMALL))


def loop_margins(car: str, delay: float, name: str) -> dict[str, float]:
    """Return the quantities of COLUMNS at each speed, and the worst of each.

    Args:
        car: Shipped vehicle.
        delay: Delay of its steering that the controller knows [s].
        name: Controller; `preview` only.
    """
    assert name == "preview"
    subject = subject_with_delay(car, delay)
    loop = (subject.controller(), subject.vehicle.chassis, subject.vehicle.steering)
    drives = Drives(subject, np.array(LOOP_SPEEDS), 1, lambda _: None)
    rows = {
        "radius": [spectral_radius(*loop, v, estimator=False) for v in LOOP_SPEEDS],
        "estimator_radius": [spectral_radius(*loop, v) for v in LOOP_SPEEDS],
        "margin": [delay_margin(*loop, v) for v in LOOP_SPEEDS],
        "small_margin": delay_margins(drives, SMALL, DELAYS, decays),
        "large_margin": delay_margins(drives, delays=DELAYS),
    }
    worst = {key: max(row) if "radius" in key else min(row) for key, row in rows.items()}
    at = {
        f"{key} at {v:g} m/s": value
        for key, row in rows.items()
        for v, value in zip(LOOP_SPEEDS, row, strict=True)
    }
    return worst | at


def loop_table(measured: Mapping[str, Mapping[str, float]]) -> str:
    """Return the quantities over speed as Markdown; empty without any.

    Args:
        measured: `loop_margins` by name of the car.
    """
    if not measured:
        return ""
    text = (
        "\nLoop at each speed: spectral radius with the disturbance estimate held at zero, and "
        "three largest unknown delays [s]: with which the controller's own linear model is stable; "
        f"with which the deviation of the simulated car decays from {SMALL:g} m beside its road; "
        "with which it settles from 0.5 m as in a certificate (5 cm after 10 s). The largest delay "
        "that is tried is 0.3 s. With the estimator, whose own poles are 0.95, all radii are "
    )
    radii = [
        each[f"estimator_radius at {v:g} m/s"] for each in measured.values() for v in LOOP_SPEEDS
    ]
    text += f"{min(radii):.3f} to {max(radii):.3f}.\n\n"
    shown = [key for key in COLUMNS if key != "estimator_radius"]
    lines = [
        "| " + " | ".join(["speed [m/s]", *measured]) + " |",
        "|---" * (len(measured) + 1) + "|",
    ]
    for v in LOOP_SPEEDS:
        cells = [
            ", ".join(f"{each[f'{key} at {v:g} m/s']:.3f}" for key in shown)
            for each in measured.values()
        ]
        lines.append(" | ".join([f"| {v:g}", *cells]) + " |")
    return text + "\n".join(lines) + "\n"
