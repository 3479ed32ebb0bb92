"""Identify known cars from the manoeuvre, and check the targets of issue 15, section 2.

`python -m tests.workshop.acceptance.identification` prints the table, and writes it with all errors
next to `--output`. Exit code 0: all targets are met.

Understeer gradient and stiffness are compared with the linear single-track parameters of the
vehicle file. The gradient of a car below 1 deg/g is compared with 10 % of 1 deg/g; CommonRoad
vehicle 2 is neutral in the linear theory.
"""

import argparse
import json
import math
import sys
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_ros.identification.result import ONE_DEGREE_PER_G, Identification, identify
from launch_scripts.reporting.pages import markdown_table, to_json
from sim_vehicle.parameters import MeasurementNoise
from tests.workshop.acceptance.identification_drives import (
    CARS,
    Assumed,
    KnownCar,
    drive_manoeuvre,
    random_car,
    start_of,
)

SEED = 5100
"""First seed; none of the seeds from here on was used while the estimator was developed."""
QUANTITIES = {
    "delay": ("delay [ms]", 1e3, 10.0),
    "lag": ("lag [ms]", 1e3, 15.0),
    "total_latency": ("delay + lag [ms]", 1e3, 20.0),
    "understeer_gradient": ("understeer gradient [%]", 100.0, 10.0),
    "rear_cornering_stiffness": ("rear cornering stiffness [%]", 100.0, 15.0),
    "front_cornering_stiffness": ("front cornering stiffness [%]", 100.0, math.inf),
    "yaw_inertia": ("yaw inertia [%]", 100.0, math.inf),
    "offset": ("steering offset [deg]", math.degrees(1.0), 0.1),
    "ratio": ("steering ratio [%]", 100.0, 1.0),
    "measured_point": ("measured point [cm]", 100.0, 5.0),
}
"""Title, factor from SI units, and target by quantity; infinite: reported only."""
RELATIVE = ("ratio", "front_cornering_stiffness", "rear_cornering_stiffness", "yaw_inertia")
COVERAGE = (0.90, 0.99)
TRACKING, LEAST_RMS = 1.2, 0.01
"""Largest ratio of the tracking errors; errors below LEAST_RMS count as it [m]."""
TRACKING_SPEED = {"model_car": 3.0}
"""Speed on the road of the comparison, otherwise 9 m/s [m/s]."""


class Trial(NamedTuple):
    """One identified car."""

    car: str
    seed: int
    with_steering: bool
    errors: dict[str, float]
    """Error of each quantity in the unit of its target."""
    half_widths: dict[str, float]
    identified: dict[str, bool]
    lateral_acceleration: float
    area: float
    tracking: float
    """Ratio of the tracking errors; nan: not driven."""
    seconds: float
    """CPU time of the identification [s]."""


def true_values(car: KnownCar) -> dict[str, float]:
    """Return the true values of QUANTITIES."""
    c, s = car.vehicle.chassis, car.vehicle.steering
    lag = max(s.lag, 0.002) if car.name == "independent" else s.lag
    return {
        "delay": s.delay,
        "lag": lag,
        "total_latency": s.delay + lag,
        "understeer_gradient": c.understeer_gradient,
        "rear_cornering_stiffness": c.rear_cornering_stiffness,
        "front_cornering_stiffness": c.front_cornering_stiffness,
        "yaw_inertia": c.yaw_inertia,
        "offset": car.offset,
        "ratio": car.ratio,
        "measured_point": car.x_P,
    }


def run_trial(place: tuple[str, int, bool, bool]) -> Trial:
    """Draw a car, drive the manoeuvre, identify, and compare the tracking error if asked to."""
    import time

    name, seed, with_steering, is_tracked = place
    rng = np.random.default_rng([seed, CARS.index(name)])
    car = random_car(name, rng)
    driven = drive_manoeuvre(car, rng, with_steering=with_steering)
    begin = time.process_time()
    result = identify(driven.recording, start_of(car))
    seconds = time.process_time() - begin
    errors, half_widths, identified = {}, {}, {}
    for key, true in true_values(car).items():
        scale = QUANTITIES[key][1] / (abs(true) if key in RELATIVE else 1.0)
        if key == "understeer_gradient":
            scale = QUANTITIES[key][1] / max(abs(true), ONE_DEGREE_PER_G)
        quantity = result.quantities[key]
        errors[key] = (quantity.value - true) * scale
        half_widths[key] = quantity.half_width * scale
        identified[key] = quantity.is_identified
    tracking = tracking_ratio(car, result) if is_tracked else math.nan
    return Trial(
        name,
        seed,
        with_steering,
        errors,
        half_widths,
        identified,
        driven.lateral_acceleration,
        max(driven.area),
        tracking,
        seconds,
    )


def tracking_ratio(car: KnownCar, result: Identification) -> float:
    """Return the RMS tracking error with the identified values over that with the true ones."""
    found, s = result.quantities, car.vehicle.steering
    true = replace(s, ratio=car.ratio, offset=car.offset)
    keys = ("delay", "lag", "ratio", "offset", "max_rate")
    values = {key: found[key].value for key in keys if found[key].is_identified}
    if found["total_latency"].is_identified:
        values |= {key: found[key].value for key in ("delay", "lag")}
    known = replace(car.start.steering, **values)
    x_P = found["measured_point"].value if found["measured_point"].is_identified else 0.0
    road = load_scenario("sc1", car.vehicle.size, TRACKING_SPEED.get(car.name, 9.0))
    rms = [
        max(
            drive_manoeuvre(
                car,
                np.random.default_rng(0),
                controller="preview",
                noise=MeasurementNoise(),
                road=road,
                assumed=assumed,
            ).rms,
            LEAST_RMS,
        )
        for assumed in (
            Assumed(result.chassis, known, x_P),
            Assumed(car.vehicle.chassis, true, car.x_P),
        )
    ]
    return rms[0] / rms[1]


def rows_of(trials: Sequence[Trial]) -> tuple[list[list[str]], bool]:
    """Return the rows of the table, and whether all targets are met."""
    groups: dict[tuple[str, bool], list[Trial]] = defaultdict(list)
    for trial in trials:
        groups[trial.car, trial.with_steering].append(trial)
    rows, met = [], True
    for (car, with_steering), each in groups.items():
        for key, (title, _, target) in QUANTITIES.items():
            is_free = key in ("delay", "lag") and not with_steering
            limit = math.inf if is_free else target
            errors = np.abs([trial.errors[key] for trial in each])
            within = float(np.mean(errors <= limit))
            met &= within == 1.0
            rows.append(
                [
                    f"{car}, {'with' if with_steering else 'without'} steering_state",
                    title,
                    f"{limit:g}" if limit < math.inf else "",
                    f"{np.quantile(errors, 0.5):.2g}",
                    f"{np.quantile(errors, 0.95):.2g}",
                    f"{errors.max():.2g}",
                    f"{100 * within:.0f} %" if limit < math.inf else "",
                    f"{100 * np.mean([trial.identified[key] for trial in each]):.0f} %",
                    f"{100 * coverage([(trial, key) for trial in each]):.0f} %",
                ]
            )
    return rows, met


def coverage(cells: Sequence[tuple[Trial, str]]) -> float:
    """Return the share of intervals that contain the true value."""
    return float(np.mean([abs(t.errors[k]) <= t.half_widths[k] for t, k in cells]))


def summary_of(trials: Sequence[Trial]) -> tuple[list[list[str]], bool]:
    """Return rows on coverage, tracking, manoeuvre and time; and whether the targets are met."""
    rows, met = [], True
    for with_steering in (True, False):
        kind = f"{'with' if with_steering else 'without'} steering_state"
        part = [trial for trial in trials if trial.with_steering == with_steering]
        for key, (title, *_) in QUANTITIES.items():
            share = coverage([(t, key) for t in part])
            met &= COVERAGE[0] <= share <= COVERAGE[1]
            rows.append([f"coverage, {title}, {kind}", f"{100 * share:.1f} %", "90 to 99 %"])
        share = coverage(list(product(part, QUANTITIES)))
        rows.append([f"coverage, all quantities, {kind}", f"{100 * share:.1f} %", "90 to 99 %"])
    for car in dict.fromkeys(trial.car for trial in trials):
        ratios = [t.tracking for t in trials if t.car == car and not math.isnan(t.tracking)]
        if ratios:
            met &= max(ratios) <= TRACKING
            text = f"{max(ratios):.2f}, median {np.median(ratios):.2f}"
            rows.append([f"tracking error, identified / true, {car}, largest", text, "1.2"])
        part = [trial for trial in trials if trial.car == car]
        most = max(trial.lateral_acceleration for trial in part)
        above = sum(trial.lateral_acceleration > 3.0 for trial in part)
        met &= above == 0
        text = f"{most:.2f}; {above} of {len(part)} above"
        rows.append([f"lateral acceleration, {car}, largest [m/s^2]", text, "3"])
        rows.append([f"area, {car}, largest side [m]", f"{max(t.area for t in part):.0f}", "80"])
    seconds = max(trial.seconds for trial in trials)
    rows.append(["CPU time of an identification, largest [s]", f"{seconds:.1f}", "60"])
    return rows, met


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all trials, print and write the tables, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cars", nargs="+", default=list(CARS), choices=CARS)
    parser.add_argument("--seeds", type=int, default=40, help="cars of each kind")
    parser.add_argument(
        "--tracked", type=int, default=8, help="cars of each kind whose tracking error is compared"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path("runs/identification"))
    options = parser.parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    seeds = range(SEED, SEED + options.seeds)
    places = [
        (c, s, w, w and s < SEED + options.tracked)
        for c in options.cars
        for w in (True, False)
        for s in seeds
    ]
    trials = []
    with ProcessPoolExecutor(options.workers) as pool:
        for trial in pool.map(partial(run_trial), places):
            trials.append(trial)
            if trial.seed % 10 == 0:
                console.print(f"{len(trials)} of {len(places)}: {trial.car}", markup=False)
    heads = ["car", "error of", "target", "median", "95 %", "largest", "within target"]
    rows, is_accurate = rows_of(trials)
    lines = markdown_table([*heads, "identified", "coverage"], rows, "lrrrrrrr")
    others, is_covered = summary_of(trials)
    lines += ["", *markdown_table(["quantity", "value", "target"], others, "rr")]
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "identification.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    content: Any = to_json([trial._asdict() for trial in trials])
    (options.output / "identification.json").write_text(
        json.dumps(content, indent=1) + "\n", encoding="utf-8"
    )
    console.print("\n".join(lines), markup=False)
    return 0 if is_accurate and is_covered else 1


if __name__ == "__main__":
    sys.exit(main())
