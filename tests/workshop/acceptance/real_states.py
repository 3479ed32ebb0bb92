"""Drive with unknown actuators and with late, missing, noisy and wrong states; check the targets.

`python -m tests.workshop.acceptance.real_states`; also a section of `make acceptance`. Errors are
those of the centre of gravity, of the true state against the road. Exit code 0: all targets are
met.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from rich.console import Console

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.types import VehicleState
from sim_vehicle.parameters import load_vehicle_file
from tests.supervised import between
from tests.workshop.acceptance.real_states_figure import FIGURE, curves, draw, read_curves
from tests.workshop.acceptance.state_drives import (
    MOTORWAY,
    MOTORWAY_SPEED,
    SERVO_LAG,
    StateDrive,
    StateTrial,
    drive,
)
from tests.workshop.acceptance.targets import (
    Observation,
    Section,
    Target,
    Task,
    observe,
    targets_of,
    write_json,
)

OWN = ("paper", "ordinary")
BEFORE_FILE = Path(__file__).with_name("real_states_before.json")
BEFORE_COMMIT = "9c869f3"
"""The version before."""
STORE = f"""git worktree add ../before {BEFORE_COMMIT} && cp -r tests ../before && cd ../before && \
PYTHONPATH=.:ampc_msgs_config:ampc_ros:sim_vehicle \
python -m tests.workshop.acceptance.real_states --store-before"""
"""Commands that store its results."""
REPORTED = math.inf

# Quantities of a target.
MAX, END = "largest error [m]", "largest error of the last 3 s, as a share of the largest error"
CHANGE = "largest error beyond that of the version before [m]"
ADDED = "largest error beyond that with odometry on time [m]"
ACTIVITY = "RMS steering increment in 0.1 s [deg]"
ACCELERATION = "largest v r [m/s^2]"
WARNED_5 = "drives with the warning within 5 s of turning [%]"
WARNED_10 = "drives with the warning within 10 s of turning [%]"
FALSE = "false warnings"

# A: nothing is configured about the actuator.
UNKNOWN = StateTrial("sc1_falcone", "independent", lag=SERVO_LAG, configured=False)
UNKNOWN_ACTUATOR: dict[str, tuple[StateTrial, dict[str, float]]] = {
    "9 m/s": (UNKNOWN._replace(speed=9.0), {MAX: 0.04}),
    "10 m/s": (UNKNOWN._replace(speed=10.0), {MAX: 0.04}),
    "11 m/s": (UNKNOWN._replace(speed=11.0), {MAX: 0.04}),
    "13 m/s": (UNKNOWN._replace(speed=13.0), {MAX: 0.07}),
    "15 m/s": (UNKNOWN._replace(speed=15.0), {MAX: 0.10}),
    "100 ms more delay": (UNKNOWN._replace(speed=11.0, delay=0.1), {MAX: 0.15}),
    "200 ms more delay": (UNKNOWN._replace(speed=11.0, delay=0.2), {MAX: 0.5, END: 0.5}),
    "friction 0.5, 11 m/s": (UNKNOWN._replace(speed=11.0, friction=0.5), {MAX: 0.05}),
    "friction 0.5, 13 m/s": (UNKNOWN._replace(speed=13.0, friction=0.5), {MAX: 0.15}),
    "50 Hz, 100 ms more delay": (UNKNOWN._replace(speed=11.0, delay=0.1, hz=50), {MAX: 0.10}),
    "100 Hz, 100 ms more delay": (UNKNOWN._replace(speed=11.0, delay=0.1, hz=100), {MAX: 0.10}),
    "servo of 5 ms": (UNKNOWN._replace(speed=11.0, lag=0.005), {MAX: REPORTED}),
}
"""Trials and targets by name."""

# B: delay and lag are configured.
KNOWN_DELAYS, KNOWN_LAGS = (0.0, 0.1, 0.2), (0.0, 0.1)
WORSE = 0.01
"""Largest change for the worse [m]."""

# C: late and missing states.
LATE = {0.05: 0.03, 0.10: 0.05, 0.15: 0.08}
"""Targets of `ADDED` by age of the odometry [m]."""
BLIND, BLIND_BEGINS, AFTERWARDS = 2.0, (5.0, 125.0), 4.0
"""Time without any state [s]; range of the positions at which it begins on sc1, which contains all
bends [m]; time that is driven afterwards [s]."""
BLIND_STEP = 4.5
"""Distance between two of these positions [m]."""
BLIND_LIMITS = {9.0: 0.5, 15.0: 1.0, 20.0: 1.5}
"""Targets by speed [m]."""

# D: measurement noise.
SEEDS = (21, 22, 23, 24, 25)
"""None of these was used to tune anything."""
NOISE_SPEED = 15.0
NOISE_LIMITS = {MAX: 0.10, ACTIVITY: 0.45}
MOTORWAY_LIMITS = {MAX: 0.12, ACCELERATION: 2.5}

# E: wrong states.
WRONG_BEGIN, WRONG_TIME = 5.0, 5.0
"""Begin of the defect, and time for which it lasts [s]."""
YAW_RATES: dict[str, Callable[[float], float]] = {
    "stuck at 9 rad/s": lambda r: 9.0,
    "stuck at 1 rad/s": lambda r: 1.0,
    "0.3 rad/s too large": lambda r: r + 0.3,
    "0.3 rad/s too small": lambda r: r - 0.3,
}
POINTS = ("at the front bumper", "at the centre of gravity", "1 m behind the rear axle")
POINT_ROADS: tuple[tuple[str, float | None], ...] = (
    ("circle", 5.0),
    ("circle", 9.0),
    ("sine", 9.0),
    ("sine", 15.0),
    ("sc1", 9.0),
    ("sc2", None),
)
"""Roads and speeds of drives with odometry of another point."""


def unknown_name(name: str) -> str:
    """Return the name of the rows of an actuator that is not configured."""
    return f"nothing configured, {name}"


def known_name(delay: float) -> str:
    """Return the name of the rows of a configured actuator."""
    return f"configured, delay {1000 * delay:g} ms"


def late_name(late: float) -> str:
    """Return the name of the rows of late odometry."""
    return f"odometry {1000 * late:g} ms late"


def blind_name(speed: float, *, brakes: bool) -> str:
    """Return the name of the rows without states."""
    driver = "brakes" if brakes else "keeps the speed"
    return f"{BLIND:g} s without states, {speed:g} m/s, driver {driver}"


def noise_name(car: str) -> str:
    """Return the name of the rows with noise."""
    return f"noise x1, {NOISE_SPEED:g} m/s, {car} car"


def motorway_name(car: str) -> str:
    """Return the name of the rows of a lane change at high speed with noise."""
    return f"noise x1, {MOTORWAY} at {MOTORWAY_SPEED:g} m/s, {car} car"


def without(name: str) -> str:
    """Return the name of the rows of the same drives without noise."""
    return name.replace("noise x1", "no noise")


KNOWN_FRICTION = "configured, friction 0.5"
CARS = ("independent", *OWN)
ONLY_REPORTED = {MAX: REPORTED, ACTIVITY: REPORTED}


def limits() -> dict[Target, float]:
    """Return all targets in the order of the table; an infinite limit is reported only."""
    rows: dict[str, dict[str, float]] = {
        unknown_name(name): bars for name, (_, bars) in UNKNOWN_ACTUATOR.items()
    }
    for delay in KNOWN_DELAYS:
        rows[known_name(delay)] = {MAX: REPORTED, CHANGE: WORSE}
    rows[KNOWN_FRICTION] = {MAX: REPORTED, CHANGE: WORSE}
    for late, limit in LATE.items():
        rows[late_name(late)] = {ADDED: limit}
    for brakes, (speed, limit) in product((False, True), BLIND_LIMITS.items()):
        rows[blind_name(speed, brakes=brakes)] = {MAX: REPORTED if brakes else limit}
    for car in CARS:
        rows[noise_name(car)] = NOISE_LIMITS
        rows[without(noise_name(car))] = ONLY_REPORTED
    for car in CARS:
        rows[motorway_name(car)] = MOTORWAY_LIMITS
        rows[without(motorway_name(car))] = MOTORWAY_LIMITS
    for defect in YAW_RATES:
        rows[f"yaw rate {defect}"] = {MAX: 0.3}
    for point in POINTS:
        rows[f"odometry {point}"] = {WARNED_5: REPORTED, WARNED_10: REPORTED}
    rows["correct odometry, shipped scenarios"] = {FALSE: 0.0}
    return targets_of(rows)


SECTION = Section("real states", "real_states", limits(), BEFORE_FILE)


def measure_unknown(name: str) -> list[Observation]:
    """Drive with an actuator about which nothing is configured."""
    trial, bars = UNKNOWN_ACTUATOR[name]
    driven = drive(trial)
    values = {MAX: driven.max, END: driven.largest(-3.0) / driven.max}
    return observe(unknown_name(name), trial, {key: values[key] for key in bars})


def known_trials() -> Iterator[tuple[str, StateTrial]]:
    """Yield names of rows and trials with a configured actuator."""
    independent = UNKNOWN._replace(configured=True)
    for delay in KNOWN_DELAYS:
        for speed in (9.0, 11.0, 15.0):
            yield known_name(delay), independent._replace(speed=speed, delay=delay)
        for car, lag in product(OWN, KNOWN_LAGS):
            own = StateTrial("sc1", car, delay=delay, lag=lag)
            for trial in (
                own._replace(speed=9.0),
                own._replace(road="sc2"),
                own._replace(road="sc1_falcone", speed=15.0),
            ):
                yield known_name(delay), trial
    for v, delay in ((11.0, 0.0), (13.0, 0.0), (11.0, 0.1)):
        yield KNOWN_FRICTION, independent._replace(speed=v, delay=delay, friction=0.5)
    for car, delay in product(OWN, (0.0, 0.1)):
        yield KNOWN_FRICTION, StateTrial("sc1", car, 9.0, delay=delay, friction=0.5)


def measure_known(name: str) -> list[Observation]:
    """Drive with a configured actuator, and compare with the version before."""
    stored, found = stored_errors(), []
    for row, trial in known_trials():
        if row == name:
            now = drive(trial).max
            change = now - stored.get(str(trial), math.nan)
            found += observe(name, trial, {MAX: now, CHANGE: change})
    return found


def stored_errors() -> dict[str, float]:
    """Return the largest errors of the version before, by trial; empty before they are stored."""
    if not BEFORE_FILE.is_file():
        return {}
    content = json.loads(BEFORE_FILE.read_text(encoding="utf-8"))
    return {str(name): float(value) for name, value in content["values"].items()}


def measure_late(car: str, road: str) -> list[Observation]:
    """Drive with late odometry, whose stamps are right."""
    trial = StateTrial(road, car, 9.0 if road == "sc1" else None)
    on_time, found = drive(trial).max, []
    for late in LATE:
        added = drive(trial._replace(late=late)).max - on_time
        found += observe(late_name(late), trial, {ADDED: added})
    return found


def measure_blind(car: str, speed: float, brakes: bool) -> list[Observation]:
    """Drive sc1 without any state for some seconds, from each position on."""
    trial, found = StateTrial("sc1", car, speed), []
    for position in np.arange(*BLIND_BEGINS, BLIND_STEP).tolist():
        begin = position / speed
        end = begin + BLIND
        driven = drive(trial, blind=between(begin, end), brakes=brakes, end=end + AFTERWARDS)
        place = f"{trial}, from {position:g} m on"
        found += observe(blind_name(speed, brakes=brakes), place, {MAX: driven.max})
    return found


def noise_trial(car: str) -> StateTrial:
    """Return the trial with noise."""
    if car == "independent":
        return UNKNOWN._replace(speed=NOISE_SPEED)
    return StateTrial("sc1_falcone", car, NOISE_SPEED)


def with_seeds(trial: StateTrial) -> list[StateTrial]:
    """Return a trial without noise, and with each seed."""
    return [trial, *(trial._replace(seed=seed) for seed in SEEDS)]


def measure_noise(car: str) -> list[Observation]:
    """Drive with measurement noise, with each seed and without."""
    found, name = [], noise_name(car)
    for trial in with_seeds(noise_trial(car)):
        driven = drive(trial)
        values = {MAX: driven.max, ACTIVITY: driven.activity}
        found += observe(without(name) if trial.seed is None else name, trial, values)
    return found


def measure_motorway(car: str) -> list[Observation]:
    """Change the lane at high speed, with each seed and without noise."""
    found, name = [], motorway_name(car)
    for trial in with_seeds(noise_trial(car)._replace(road=MOTORWAY, speed=None)):
        driven = drive(trial)
        values = {MAX: driven.max, ACCELERATION: float(np.abs(driven.acceleration).max())}
        found += observe(without(name) if trial.seed is None else name, trial, values)
    return found


def measure_yaw_rate(car: str) -> list[Observation]:
    """Drive straight on with a wrong yaw rate."""
    trial, end = StateTrial("straight", car, 9.0), WRONG_BEGIN + WRONG_TIME
    found = []
    for defect, wrong in YAW_RATES.items():

        def distort(
            state: VehicleState, t: float, wrong: Callable[[float], float] = wrong
        ) -> VehicleState:
            return state if t < WRONG_BEGIN else state._replace(yaw_rate=wrong(state.yaw_rate))

        driven = drive(trial, distort=distort, end=end)
        found += observe(f"yaw rate {defect}", trial, {MAX: driven.max})
    return found


def measure_point(point: str) -> list[Observation]:
    """Drive with odometry of another point than the configured one; count the warnings."""
    drives = [
        drive_at_point(point, StateTrial(road, car, speed, seed=seed))
        for (road, speed), car, seed in product(POINT_ROADS, OWN, (None, SEEDS[0]))
    ]
    values, counts = dict[str, float](), dict[float, int]()
    for quantity, least in ((WARNED_5, 5.0), (WARNED_10, 10.0)):
        long = [each for each in drives if each.turning[-1] >= least]
        counts[least] = len(long)
        values[quantity] = 100 * sum(each.is_warned(least) for each in long) / len(long)
    place = ", ".join(f"{n} drives with {t:g} s of turning" for t, n in counts.items())
    return observe(f"odometry {point}", place, values)


def drive_at_point(point: str, trial: StateTrial) -> StateDrive:
    """Drive with odometry of another point."""
    vehicle = load_vehicle_file(find("vehicles", trial.car))
    bumper = vehicle.chassis.wheelbase + vehicle.size.front_overhang
    ahead = dict(zip(POINTS, (bumper, vehicle.chassis.cg_to_rear_axle, -1.0), strict=True))[point]
    return drive(trial, distort=lambda state, _: at_distance(state, ahead))


def measure_false(road: str) -> list[Observation]:
    """Drive a shipped scenario with correct odometry; count the drives with a warning."""
    found = []
    for car, seed in product(OWN, (None, SEEDS[0])):
        trial = StateTrial(road, car, seed=seed)
        warned = float(any(drive(trial).warnings))
        found += observe("correct odometry, shipped scenarios", trial, {FALSE: warned})
    return found


def tasks() -> list[Task]:
    """Return all tasks for parallel processes, the longest first."""
    blind = product(OWN, BLIND_LIMITS, (False, True))
    return [
        *(partial(measure_unknown, name) for name in reversed(UNKNOWN_ACTUATOR)),
        *(partial(measure_blind, *each) for each in blind),
        *(partial(measure_point, point) for point in POINTS),
        *(
            partial(measure_known, name)
            for name in (*map(known_name, KNOWN_DELAYS), KNOWN_FRICTION)
        ),
        *(partial(measure_false, road) for road in sorted(shipped("scenarios"))),
        *(partial(measure_noise, car) for car in CARS),
        *(partial(measure_motorway, car) for car in CARS),
        *(partial(measure_late, *each) for each in product(OWN, ("sc1", "sc2"))),
        *(partial(measure_yaw_rate, car) for car in OWN),
    ]


def store_before(workers: int, console: Console) -> None:
    """Store the results of the version before: run its packages with the files of this one."""
    rows = SECTION.measure_alone(tasks(), workers, console)
    rows = [row for row in rows if row.target.quantity != CHANGE]
    values = {str(trial): drive(trial).max for _, trial in known_trials()}
    source = f"controller of commit {BEFORE_COMMIT}, driven by the files of this folder"
    others = {"source": source, "values": values, "curves": curves(workers)}
    write_json(rows, BEFORE_FILE, STORE, **others)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all targets, print and write the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/acceptance"), help="folder")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    parser.add_argument("--only", default="", help="tasks whose function name contains this text")
    parser.add_argument("--update", type=Path, help="page whose table is replaced")
    parser.add_argument("--figure", action="store_true", help=f"draw {FIGURE}, and end")
    parser.add_argument("--store-before", action="store_true", help="store the column 'before'")
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    if chosen.store_before:
        store_before(chosen.workers, console)
        return 0
    if chosen.figure:
        draw(read_curves(BEFORE_FILE), curves(chosen.workers), FIGURE)
        return 0
    jobs = [job for job in tasks() if chosen.only in job.func.__name__]
    rows = SECTION.measure_alone(jobs, chosen.workers, console)
    return SECTION.report(rows, chosen.output, chosen.update, console)


if __name__ == "__main__":
    raise SystemExit(main())
