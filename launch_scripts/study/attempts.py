"""What was tried where the paper does not reproduce: other lane changes, margins, wind."""

from itertools import product
from typing import Any

import numpy as np

from ampc_msgs_config.paths.curves import q
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import Array
from launch_scripts.study.drives import (
    TunedGains,
    drive_contender,
    largest_error,
    metrics_of,
    study_scenario,
)
from launch_scripts.study.switches import Switches

MOVE_LENGTHS = (15.0, 20.0, 30.0, 45.0, 60.0)
"""Lengths of each half of the double lane change in the geometry sweep [m]."""
LANE_WIDTH, STRAIGHT_LENGTH = 3.5, 25.0
"""Lateral offset of the lane change, and distance between its halves [m]."""
FRAGILITY: dict[str, tuple[str, dict[str, float], dict[str, float]]] = {
    "Sc1, 50 ms of steering delay": ("sc1", {}, {"delay": 0.05}),
    "Sc1, 100 ms of steering lag": ("sc1", {}, {"lag": 0.1}),
    "straight, joined from 0.5 m, 9 m/s": ("straight", {"start_offset": 0.5, "speed": 9.0}, {}),
    "straight, joined from 0.5 m, 15 m/s": ("straight", {"start_offset": 0.5, "speed": 15.0}, {}),
    "straight, joined from 0.5 m, 21 m/s": ("straight", {"start_offset": 0.5, "speed": 21.0}, {}),
}
"""Unmodelled conditions: scenario, changes of the scenario, changes of the steering."""
WIND_SPEEDS = (11.0, 13.0, 15.0, 16.0, 17.0, 18.0)
"""Speeds on the stretched road, with and without wind [m/s]."""


def measure_attempts(tuned: TunedGains, switches: Switches) -> dict[str, Any]:
    """Return what was tried where the paper does not reproduce: lane changes, margins, wind."""
    geometry, wind_speeds = [], []
    for length in MOVE_LENGTHS:
        names = ("paper", "classic", "pure_pursuit")
        metrics = metrics_of(names, double_lane_change(length), tuned, switches)
        mse = {name: row["mse_m2"] for name, row in metrics.items()}
        geometry.append({"length_m": length, "mse_m2": mse})
    names = ("paper", "pure_pursuit", "preview")
    fragile = {
        condition: metrics_of(names, study_scenario(road, **changes), tuned, switches, **steering)
        for condition, (road, changes, steering) in FRAGILITY.items()
    }
    for speed in WIND_SPEEDS:
        windy = study_scenario("sc3_fast_wind", speed=speed)
        air = {"calm": windy._replace(wind=()), "wind": windy}
        errors_m = {
            f"{name}_{key}_m": largest_error(drive_contender(name, scenario, tuned, switches))
            for name, (key, scenario) in product(("paper", "classic"), air.items())
        }
        wind_speeds.append({"speed_mps": speed, **errors_m})
    return {"geometry": geometry, "fragile": fragile, "wind_speeds": wind_speeds}


def double_lane_change(length: float) -> Scenario:
    """Return Sc1 with another length of each half of the double lane change [m]."""
    X = np.arange(0.0, 30.0 + 2 * length + STRAIGHT_LENGTH + 150.0, 0.5)
    back = (X - 30.0 - length - STRAIGHT_LENGTH) / length
    Y: Array = LANE_WIDTH * (q((X - 30.0) / length) - q(back))
    duration = round((30.0 + 2 * length + STRAIGHT_LENGTH + 40.0) / 9.0, 1)
    return study_scenario("sc1", points=np.column_stack((X, Y)), duration=duration)
