"""Roads from files: recorded ones where their files exist, otherwise generated ones of their kind.

`make data`, or `python -m tests.workshop.acceptance.road_data`, writes the generated roads into
build/roads. They depend on nothing but this file.

The recorded roads are in `../shared/data`, which is not part of this repository because of their
licences. Their sources:

* tracks/: Oschersleben, Norisring and IMS of github.com/TUMFTM/racetrack-database (LGPL-3.0,
  geometry ODbL), unchanged CSV files with points 5 m apart
* authors_trajectories/: the .mat files of github.com/yassinekebbati/Optimized_adaptive_MPC (MIT) as
  CSV files with the columns t_s, x_m, y_m, yaw_rad
* real_drive/: example 1 of github.com/commaai/comma2k19 (MIT), as a CSV file with the columns of
  `motorway`
"""

import math
from collections.abc import Sequence
from pathlib import Path as File

import numpy as np

from ampc_msgs_config.types import Array

REPOSITORY = File(__file__).resolve().parents[3]
RECORDED, GENERATED = REPOSITORY.parent / "shared" / "data", REPOSITORY / "build" / "roads"
IS_RECORDED = RECORDED.is_dir()
DATA = RECORDED if IS_RECORDED else GENERATED
"""Folder of the roads that are driven."""
PREFIX = "generated_"
"""Of the names of generated roads."""
CIRCUITS = (
    ("Oschersleben", "Norisring") if IS_RECORDED else (f"{PREFIX}circuit", f"{PREFIX}hairpins")
)
"""Two circuits in the folder `tracks`: bends of 20 m and more, and hairpins of 10 m."""
FINE = 0.01
"""Distance at which curvature is integrated [m]."""
HALF_LAPS: dict[str, tuple[float, tuple[tuple[float, float, float], ...]]] = {
    "circuit": (
        12.0,
        (
            (420.0, 55.0, 90.0),
            (160.0, 21.0, 120.0),
            (120.0, 45.0, -80.0),
            (230.0, 110.0, -60.0),
            (310.0, 35.0, 70.0),
            (90.0, 80.0, 40.0),
            (150.0, 200.0, 0.0),
        ),
    ),
    "hairpins": (
        4.0,
        ((560.0, 11.0, 180.0), (240.0, 40.0, -25.0), (30.0, 40.0, 25.0), (250.0, 40.0, 0.0)),
    ),
    "oval": (60.0, ((1150.0, 185.0, 90.0), (280.0, 185.0, 90.0))),
}
"""Length of the transitions [m], and straights [m] with the radius [m] and angle [deg] of the bend
behind each. The second half of a lap repeats the first one, turned by 180 degrees, so that every
lap closes."""


def integrated(curvature: Array) -> Array:
    """Return the positions of a curve given by its curvature every centimetre (n, 2) [m]."""
    heading = np.cumsum(curvature) * FINE
    return np.asarray(np.cumsum(np.column_stack((np.cos(heading), np.sin(heading))), axis=0) * FINE)


def circuit(transition: float, bends: Sequence[tuple[float, float, float]]) -> Array:
    """Return the centre line of a closed lap, 5 m apart, and its widths (n, 4) [m]."""
    pieces = []
    for straight, radius, angle_deg in bends:
        angle = math.radians(angle_deg)
        count = round(abs(angle) * radius / FINE)
        bend = np.full(count, angle / (max(count, 1) * FINE))
        pieces += [np.zeros(round(straight / FINE)), bend]
    half = np.concatenate(pieces)
    lap = np.roll(np.tile(half, 2), -round(bends[0][0] / 2.0 / FINE))  # begins on a straight
    window = np.ones(round(transition / 2.0 / FINE))
    for _ in range(2):  # means around the closed lap; the angles stay
        spread = np.zeros(len(lap))
        spread[: len(window)] = window / len(window)
        lap = np.fft.irfft(np.fft.rfft(lap) * np.fft.rfft(spread), len(lap))
    count = round(len(lap) * FINE / 5.0)
    points = integrated(lap)[np.linspace(0, len(lap), count, endpoint=False).astype(int)]
    return np.column_stack((points, np.full((count, 2), 7.5)))


def trajectory(v: float, y: Array) -> Array:
    """Return time, x, y and yaw every 0.1 s of a curve y at the arc lengths x = v t (n, 4)."""
    t = 0.1 * np.arange(len(y))
    return np.column_stack((t, v * t, y, np.arctan(np.gradient(y, v * 0.1))))


SAMPLING = ((3.0, 76), (2.0, 133), (11.7, 15))
"""Distances [m] and numbers of the points of the trajectories at 30, 20 and 9 m/s."""


def trajectories() -> dict[str, Array]:
    """Return trajectories like those of the paper's authors: columns t_s, x_m, y_m, yaw_rad."""

    def moved(x: Array, at: float, length: float) -> Array:
        z = np.clip((x - at) / length, 0.0, 1.0)
        return np.asarray(z**3 * (10.0 - 15.0 * z + 6.0 * z**2))

    fast, slow, way = (step * np.arange(n, dtype=float) for step, n in SAMPLING)
    bends, turns = 12.0 * np.sin(fast / 20.0), 10.0 * np.sin(way / 15.0)
    return {
        "lane_change_30mps": trajectory(30.0, 3.5 * moved(fast[:38], 30.0, 38.0)),
        "double_lane_change_30mps": trajectory(
            30.0, 3.5 * (moved(fast, 30.0, 38.0) - moved(fast, 130.0, 38.0))
        ),
        "general_30mps": trajectory(30.0, bends * moved(fast, 0.0, 60.0)),
        "weave_20mps": trajectory(20.0, 2.4 * np.sin(slow / 9.0) * moved(slow, 0.0, 40.0)),
        "general_9mps": np.column_stack((1.3 * np.arange(15), way, turns)),
    }


def motorway() -> Array:
    """Return a minute of accelerating on a motorway at 20 Hz, as a localisation reports it (n, 8).

    Columns: t_s, x_east_m, y_north_m, course_rad, gps_speed_mps, course_rate_radps, can_speed_mps,
    steering_wheel_deg.
    """
    rng, t = np.random.default_rng(0), 0.05 * np.arange(1200)
    speed = 8.0 + 12.0 * np.clip(t / 40.0, 0.0, 1.0) + 0.3 * np.sin(t / 3.0)
    course = 1.53 + 0.008 * np.sin(t / 6.0) + 0.004 * np.sin(t / 1.7)
    rate = np.gradient(course, t)
    steps = 0.05 * speed[:, np.newaxis] * np.column_stack((np.cos(course), np.sin(course)))
    place = np.cumsum(steps, axis=0) + np.cumsum(0.001 * rng.standard_normal(steps.shape), axis=0)
    wheel = np.degrees(15.0 * 2.7 * rate / speed) + 0.1 * rng.standard_normal(len(t))
    noisy_rate = rate + 0.001 * rng.standard_normal(len(t))
    gps, can = speed + 0.02 * rng.standard_normal((2, len(t)))
    return np.column_stack((t, place, course, gps, noisy_rate, can, wheel))


def generate(folder: File) -> list[File]:
    """Write the generated roads into a folder, and return their files."""
    content = {
        f"tracks/{PREFIX}{name}": ("# x_m,y_m,w_tr_right_m,w_tr_left_m", circuit(*shape))
        for name, shape in HALF_LAPS.items()
    }
    for name, rows in trajectories().items():
        header = "t_s,x_m,y_m,yaw_rad" if rows.shape[1] == 4 else "t_s,x_m,y_m"
        content[f"trajectories/{PREFIX}{name}"] = (header, rows)
    header = "t_s,x_east_m,y_north_m,course_rad,gps_speed_mps,course_rate_radps,can_speed_mps"
    content[f"drive/{PREFIX}motorway"] = (f"{header},steering_wheel_deg", motorway())
    files = []
    for name, (header, rows) in content.items():
        file = folder / f"{name}.csv"
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(file, rows, fmt="%.6f", delimiter=",", header=header, comments="")
        files.append(file)
    return files


def main() -> int:
    """Write the generated roads, and return the exit code."""
    for file in generate(GENERATED):
        print(file)
    if IS_RECORDED:
        print(f"note: {RECORDED} exists, so its roads are driven")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
