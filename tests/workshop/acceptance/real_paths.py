"""Drive roads whose published points are noisy, rounded, re-sent or short, and check the targets.

`python -m tests.workshop.acceptance.real_paths`; also a section of `make acceptance`. Errors are
those of the centre of gravity against the true road. Exit code 0: all targets are met.
The speed is that of the true road: a planner that slows down on rough points would hide errors.
"""

import argparse
import json
import math
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from ampc_msgs_config.types import Array
from ampc_ros.supervision.supervisor import Supervisor
from tests.workshop.acceptance.real_drives import (
    LONGITUDINAL,
    PERIOD,
    Publisher,
    RoadDrive,
    Setup,
    drive,
    lap_time,
    step_excess,
)
from tests.workshop.acceptance.real_roads import (
    MIXED,
    TURNED,
    Disturbance,
    Road,
    places,
    road,
    roads,
)
from tests.workshop.acceptance.road_data import CIRCUITS, DATA, IS_RECORDED
from tests.workshop.acceptance.targets import (
    Observation,
    Section,
    Target,
    Task,
    observe,
    targets_of,
    write_json,
)
from tests.workshop.acceptance.trials import QUANTITIES, Trial, run

CARS, GUARDS = ("paper", "ordinary"), ("road", "track")
SPEEDS = (4.0, 9.0, 15.0, 21.0, 27.0)
"""Largest speeds [m/s]."""
SPACINGS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, MIXED)
"""Distances of the published points [m]."""
CLEAN = Disturbance()
WINDOW, WINDOW_STARTS = 60.0, (-5.0, 3.0)
"""Length of a rolling window, and its start ahead of the car [m]."""
RUN_IN, STATIC_TIME, WINDOW_TIME = 30.0, 120.0, 30.0
"""Distance beyond the seam of a lap [m]; longest drives on static paths and windows [s]."""
SEAM = 0.5
"""Distance from the last to the first point of a lap with mixed spacing [m]."""
RUN_OUT = 25.0
"""Distance from the end of an open road at which a drive on a static path ends [m]."""
RESENT, SHIFT = (0.1, 0.2, 0.5, 1.0), 0.05
"""Times between two paths [s], and the largest shift of each [m]."""
RESENT_ROADS = ("crossing", "parallel laps", "hairpins")
RESENT_SPACING, RESENT_SPEED = 0.5, 9.0
END_SPEEDS, END_MARGIN = (4.0, 9.0, 15.0, 27.0), 60.0
"""Speeds of the path ends [m/s]; distance driven before the latest start of braking [m]."""
CLEAN_FILE = Path(__file__).with_name("real_paths_clean.json")
BEFORE_FILE = Path(__file__).with_name("real_paths_before.json")
CLEAN_LIMIT = 0.002
"""Largest change of a result on clean points [m]."""

# Quantities of a target.
MAX, RMS = "largest error [m]", "RMS error [m]"
REVERSALS = "steering reversals beyond twice those on clean points"
TIME = "planned time, relative to clean points [%]"
UNSOLVED = "unsolved QPs"
STEP = "steering step at an update, beyond what the road asks [deg]"
ADDED = "largest error beyond that of a path sent once [m]"
MOVING = "drives that do not stop"
BEYOND = "standstill beyond the end of the path [m]"
CHANGE_MAX, CHANGE_RMS = "change of the largest error [m]", "change of the RMS error [m]"


SAME = {REVERSALS: 0.0, TIME: 5.0, UNSOLVED: 0.0}
STATIC_LIMITS: dict[Disturbance, dict[str, float]] = {
    Disturbance(0.005): {MAX: 0.12, RMS: 0.03, **SAME},
    Disturbance(0.01): {MAX: 0.12, RMS: 0.03, **SAME},
    Disturbance(0.02): {MAX: 0.15, RMS: 0.03, **SAME},
    Disturbance(0.05): {MAX: 0.30, **SAME},
    Disturbance(grid=0.01): {MAX: 0.08, **SAME},
    Disturbance(grid=0.05): {MAX: 0.20, **SAME},
    Disturbance(grid=0.10): {MAX: 0.35, **SAME},
}
"""Targets of static paths by disturbance."""
WINDOW_LIMITS: dict[Disturbance, dict[str, float]] = {
    Disturbance(0.02): {RMS: 0.05, MAX: 0.15, STEP: 1.0},
    Disturbance(0.05): {RMS: 0.10, MAX: 0.30, STEP: 1.0},
}
"""Targets of rolling windows by disturbance."""
CLEAN_NAME, END_NAME = "clean points against the version before", "end of an open path"


def static_name(disturbance: Disturbance) -> str:
    """Return the name of the rows of a static path."""
    return f"static path, {disturbance}"


def window_name(disturbance: Disturbance) -> str:
    """Return the name of the rows of a rolling window."""
    return f"window of {WINDOW:g} m at {1 / PERIOD:g} Hz, {disturbance}"


def resent_name(name: str) -> str:
    """Return the name of the row of a road whose path is re-sent."""
    return f"{name}, re-sent with shifts up to {100 * SHIFT:g} cm"


def limits() -> dict[Target, float]:
    """Return all targets in the order of the table; an infinite limit is reported only."""
    static = {static_name(d): rows for d, rows in STATIC_LIMITS.items()}
    window = {window_name(d): rows for d, rows in WINDOW_LIMITS.items()}
    resent = {resent_name(name): {ADDED: 0.05} for name in RESENT_ROADS}
    rows: dict[str, dict[str, float]] = {
        static_name(CLEAN): {MAX: math.inf, RMS: math.inf},
        **static,
        **window,
        CLEAN_NAME: {CHANGE_MAX: CLEAN_LIMIT, CHANGE_RMS: CLEAN_LIMIT},
        **resent,
        END_NAME: {MOVING: 0.0, BEYOND: math.inf},
    }
    return targets_of(rows)


SECTION = Section("real paths", "real_paths", limits(), BEFORE_FILE)


class Block(NamedTuple):
    """Drives that differ only in the disturbance of the points."""

    road: str
    setup: Setup
    spacing: float
    turned: float
    share: float
    seed: tuple[int, ...]

    def __str__(self) -> str:
        """Return the description of its drives."""
        points = f"points {self.spacing:g} m apart" if self.spacing else "points 0.1 to 5 m apart"
        return f"{self.road}, {self.setup}, {points}"

    @property
    def true_road(self) -> Road:
        """The road."""
        return road(self.road, self.turned, self.share)

    def rng(self, *numbers: int) -> np.random.Generator:
        """Return the random numbers of one drive."""
        return np.random.default_rng((*self.seed, *numbers))


def once(points: Array) -> Publisher:
    """Return the publisher that sends a path once."""
    return lambda tick, s, supervisor: points if tick == 0 else None


def drive_static(block: Block, disturbance: Disturbance, number: int) -> tuple[RoadDrive, Array]:
    """Drive on a path that is sent once; return the drive and the points (n, 2) [m]."""
    true, rng = block.true_road, block.rng(number)
    length = true.path.length
    along = places(0.0, length, block.spacing, block.rng())
    if true.path.closed and block.spacing == MIXED:  # its ends meet
        along = np.append(along[along < length - SEAM], length - SEAM)
    points = disturbance.applied(true.curve(along), rng)
    end = length + RUN_IN if true.path.closed else length - RUN_OUT
    return drive(true, block.setup, once(points), end, STATIC_TIME), points


def measure_static(block: Block) -> list[Observation]:
    """Drive clean points and all disturbances of static paths."""
    clean, exact = drive_static(block, CLEAN, 0)
    seconds = lap_time(exact, block.setup.speed)
    found = observe(static_name(CLEAN), block, {MAX: clean.max, RMS: clean.rms})
    for number, disturbance in enumerate(STATIC_LIMITS, start=1):
        driven, points = drive_static(block, disturbance, number)
        values = {
            MAX: driven.max,
            RMS: driven.rms,
            REVERSALS: max(driven.reversals - 2 * clean.reversals, 0),
            TIME: 100 * (lap_time(points, block.setup.speed) / seconds - 1),
            UNSOLVED: driven.unsolved,
        }
        wanted = {key: values[key] for key in STATIC_LIMITS[disturbance]}
        found += observe(static_name(disturbance), block, wanted)
    return found


def drive_window(block: Block, disturbance: Disturbance, start: float, number: int) -> RoadDrive:
    """Drive on a window of the road that moves with the car, with new noise at each tick."""
    true, rng = block.true_road, block.rng(number)
    path = true.path

    def publish(tick: int, s: float, supervisor: Supervisor) -> Array:
        first, last = s + start, s + start + WINDOW
        if not path.closed:
            first, last = max(first, 0.0), min(last, path.length)
        return disturbance.applied(true.curve(places(first, last, block.spacing, rng)), rng)

    end = math.inf if path.closed else path.length - WINDOW - max(WINDOW_STARTS)
    return drive(true, block.setup, publish, end, WINDOW_TIME, static_path=False)


def measure_window(block: Block) -> list[Observation]:
    """Drive all rolling windows; the steering steps are compared with those on clean points."""
    clean, found = drive_static(block, CLEAN, 0)[0], []
    reach = 0.5 * block.setup.speed
    for number, (disturbance, start) in enumerate(product(WINDOW_LIMITS, WINDOW_STARTS), start=20):
        driven = drive_window(block, disturbance, start, number)
        step = math.degrees(step_excess(driven, clean, reach))
        values = {RMS: driven.rms, MAX: driven.max, STEP: max(step, 0.0)}
        side = f"{start:g} m ahead" if start > 0 else f"{-start:g} m behind"
        found += observe(window_name(disturbance), f"{block}, starting {side}", values)
    return found


def measure_resent(name: str, car: str, seed: int) -> list[Observation]:
    """Drive a road that passes itself closely, with a path sent once and re-sent with shifts."""
    true, setup = road(name, TURNED[1]), Setup(car, RESENT_SPEED)
    length = true.path.length
    rng = np.random.default_rng((seed, RESENT_ROADS.index(name), CARS.index(car)))
    points = true.curve(places(0.0, length, RESENT_SPACING, rng))

    def resend(every: int, tick: int, s: float, supervisor: Supervisor) -> Array | None:
        return points + shift(rng) if tick % every == 0 else None

    def reload(tick: int, s: float, supervisor: Supervisor) -> Array | None:
        if tick and tick % round(1 / PERIOD) == 0:
            supervisor.reconfigure(supervisor.config)
        return points if tick == 0 else None

    publishers: dict[str, Publisher] = {
        f"each {period:g} s": partial(resend, round(period / PERIOD)) for period in RESENT
    }
    publishers["gains read anew each second"] = reload
    least = drive(true, setup, once(points), length - RUN_OUT, STATIC_TIME).max
    found = []
    for label, publish in publishers.items():
        driven = drive(true, setup, publish, length - RUN_OUT, STATIC_TIME)
        found += observe(resent_name(name), f"{setup}, {label}", {ADDED: driven.max - least})
    return found


def shift(rng: np.random.Generator) -> Array:
    """Return a random displacement of at most `SHIFT` (2,) [m]."""
    angle, distance = rng.uniform(0.0, math.tau), SHIFT * math.sqrt(rng.uniform())
    return np.array([distance * math.cos(angle), distance * math.sin(angle)])


def measure_end(car: str, speed: float) -> list[Observation]:
    """Drive to the end of an open path with a driver who obeys the stop request."""
    true, setup = road("straight"), Setup(car, speed)
    length = speed**2 / (2 * LONGITUDINAL) + END_MARGIN
    points = true.curve(np.arange(0.0, length + 1e-6, 1.0, dtype=np.float64))
    length = float(math.floor(length))
    seconds = length / speed + speed / LONGITUDINAL + END_MARGIN
    driven = drive(true, setup, once(points), length + END_MARGIN, seconds, brakes=True)
    values = {MOVING: float(not driven.stands), BEYOND: driven.position(length)}
    return observe(END_NAME, str(setup), values)


def clean_trials() -> dict[str, Trial]:
    """Return the trials on clean points whose results may not change; circuits if recorded."""
    found = sorted(DATA.glob("tracks/*.csv")) if IS_RECORDED else []
    files = [f"tracks/{file.name}" for file in found]
    trials = {
        f"{Path(name).stem}, {car} car": Trial(name, car)
        for name, car in product(("sc1", *files), CARS)
    }
    nominal = Trial("sc1_falcone", "independent")
    for speed in (9.0, 11.0, 15.0):
        trials[f"independent plant, {speed:g} m/s"] = nominal._replace(speed=speed)
    slow = nominal._replace(speed=11.0)
    trials["independent plant, 11 m/s, 100 ms delay, unknown"] = slow._replace(delay=0.1)
    for speed in (11.0, 13.0):
        trial = nominal._replace(speed=speed, friction=0.5)
        trials[f"independent plant, {speed:g} m/s, friction 0.5"] = trial
    trials["independent plant, 11 m/s, gust"] = slow._replace(gust=(1500.0, 400.0))
    return trials


def clean_values(name: str) -> dict[str, float]:
    """Return largest and RMS error of a trial on clean points [m]."""
    driven = run(clean_trials()[name], "preview")
    values = {}
    for key in ("max", "rms"):
        function = QUANTITIES[key].measure
        assert function is not None
        values[key] = function(driven)
    return values


def measure_clean(name: str) -> list[Observation]:
    """Compare a trial on clean points with its stored results."""
    stored = json.loads(CLEAN_FILE.read_text(encoding="utf-8"))["values"][name]
    now = clean_values(name)
    change = {key: now[key] - stored[key] for key in now}
    pairs = (f"{key} {stored[key]:.4f} to {now[key]:.4f} m" for key in now)
    place = f"{name}, {', '.join(pairs)}"
    values = {CHANGE_MAX: abs(change["max"]), CHANGE_RMS: abs(change["rms"])}
    return observe(CLEAN_NAME, place, values)


def blocks(seed: int) -> list[Block]:
    """Return the grid: each road, car and spacing; speed, guard and rotation alternate.

    Another seed combines them differently.
    """
    names = ("straight", "sc1", "circle", *CIRCUITS)
    grid = product(roads(), enumerate(CARS), enumerate(SPACINGS))
    rows = []
    for name, (c, car), (i, spacing) in grid:
        r = names.index(name)
        speed = SPEEDS[(i + 2 * r + 3 * c + seed) % len(SPEEDS)]
        guard = GUARDS[(i + r + c + seed // len(SPEEDS)) % len(GUARDS)]
        turned = TURNED[(i + r + seed) % len(TURNED)]
        share = (0.137 * (i + 7 * c) + 0.061 * seed) % 1.0
        rows.append(Block(name, Setup(car, speed, guard), spacing, turned, share, (seed, r, c, i)))
    return rows


def tasks(seed: int) -> list[Task]:
    """Return the full grid as tasks for parallel processes, the longest first."""
    grid = blocks(seed)
    windows = grid[seed % 3 :: 3]
    return [
        *(partial(measure_window, block) for block in reversed(windows)),
        *(partial(measure_static, block) for block in reversed(grid)),
        *(partial(measure_clean, name) for name in reversed(clean_trials())),
        *(partial(measure_resent, *pair, seed) for pair in product(RESENT_ROADS, CARS)),
        *(partial(measure_end, *pair) for pair in product(CARS, END_SPEEDS)),
    ]


def reduced_tasks(seed: int) -> list[Task]:
    """Return a reduced grid without recorded circuits, for the tests."""
    grid = [block for block in blocks(seed) if block.road in ("straight", "sc1", "circle")]
    return [
        *(partial(measure_window, block) for block in grid[5::19]),
        *(partial(measure_static, block) for block in grid[::5]),
        partial(measure_clean, "sc1, ordinary car"),
        partial(measure_resent, "crossing", "paper", seed),
        *(partial(measure_end, "ordinary", speed) for speed in (9.0, 27.0)),
    ]


def store_clean() -> None:
    """Write the results on clean points, with which later versions are compared."""
    command = f"{SECTION.command} --store-clean"
    values = {name: clean_values(name) for name in clean_trials()}
    text = json.dumps({"command": command, "values": values}, indent=1)
    CLEAN_FILE.write_text(text + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure all targets, print and write the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/acceptance"), help="folder")
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="another seed: other combinations")
    parser.add_argument("--only", default="", help="tasks whose function name contains this text")
    parser.add_argument("--update", type=Path, help="page whose table is replaced")
    parser.add_argument("--store-clean", action="store_true", help="store clean results and end")
    parser.add_argument("--store-before", action="store_true", help="store the column 'before'")
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    if chosen.store_clean:
        store_clean()
        return 0
    jobs = [job for job in tasks(chosen.seed) if chosen.only in job.func.__name__]
    rows = SECTION.measure_alone(jobs, chosen.workers, console)
    if chosen.store_before:
        write_json(rows, BEFORE_FILE, f"{SECTION.command} --store-before")
    return SECTION.report(rows, chosen.output, chosen.update, console)


if __name__ == "__main__":
    raise SystemExit(main())
