"""Faults and roads of the fault matrix, and losses that no controller can avoid."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import shipped
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario
from launch_scripts.faults.schedule import Fault
from tests.workshop.acceptance.road_data import CIRCUITS, DATA
from tests.workshop.acceptance.trials import LIMITS

RUN_ON = 5.0
"""Extension of the shipped drives, on the straight after their path [s]."""
LONGEST = 45.0
"""Longest duration of a drive [s]."""
OFFSET = "straight_3m"
"""Name of the straight road that is joined from 3 m."""
CIRCUIT = CIRCUITS[0]
SCENARIOS = ("sc1", "sc2", "sc3_varying", "sc3_wind", "circle", "sine", OFFSET, CIRCUIT)


class Case(NamedTuple):
    """A row of the matrix."""

    name: str
    fault: Fault
    """The fault, with start 0; each road has its own start."""


def case(
    name: str, kind: str, duration: float, amount: float | None = None, field: str = "x"
) -> Case:
    """Build a row of the matrix."""
    return Case(name, Fault(kind=kind, start=0.0, duration=duration, amount=amount, field=field))


CASES = (
    case("odom lost for 0.4 s", "drop", 0.4),
    case("half of odom lost", "drop", 5.0, 0.5),
    case("simulator gone for 2 s", "silence", 2.0),
    case("peers restarted, 1 s", "restart", 1.0),
    case("odom 150 ms late", "delay", 5.0),
    case("jitter 0-200 ms", "jitter", 5.0),
    case("reordered, 0-200 ms", "reorder", 5.0),
    case("every odom twice", "duplicate", 5.0),
    case("queue held for 0.4 s", "hold", 0.4),
    case("queue of 1000 old odom", "burst", 0.1),
    case("last odom again, 0.4 s", "repeat", 0.4),
    case("pose frozen for 0.4 s", "freeze", 0.4),
    case("pose frozen for 2 s", "freeze", 2.0),
    case("x is NaN for 0.4 s", "nan", 0.4),
    case("v_x is NaN for 0.4 s", "nan", 0.4, field="v_x"),
    case("noise 0.1 m, 0.6 deg", "noise", 5.0),
    case("position 0.3 m off", "bias_position", 5.0),
    case("heading 3 deg off", "bias_heading", 5.0),
    case("speed 2 m/s too high", "bias_speed", 2.0),
    case("position drifts by 1 m", "drift", 5.0),
    case("position jumps by 2 m", "pose_jump", 2.0),
    case("wrong frame for 0.4 s", "wrong_frame", 0.4),
    case("zero quaternion, 0.4 s", "zero_quaternion", 0.4),
    case("stamps 1 s ahead, 0.4 s", "stamp_jump", 0.4, 1.0),
    case("stamps 1 s back, 0.4 s", "stamp_jump", 0.4, -1.0),
    case("all clocks 1 s ahead", "clock_jump", 3.0, 1.0),
    case("all clocks 1 s back", "clock_jump", 3.0, -1.0),
    case("steering sensor 3 deg off", "bias_steering", 5.0),
    case("steering sensor frozen", "freeze_steering", 5.0),
    case("QP fails for 0.3 s", "qp_fault", 0.3),
    case("QP fails for 3 s", "qp_fault", 3.0),
    case("planner gone for 5 s", "path_gone", 5.0),
    case("path 2 m aside", "path_shift", 3.0),
    case("path with a step of 2 m", "path_step", 3.0),
    case("path zigzags by 1 m", "path_zigzag", 3.0),
    case("path with NaN", "path_nan", 3.0),
    case("path of one point", "path_point", 3.0),
    case("empty path", "path_empty", 3.0),
)


class Unavoidable(NamedTuple):
    """A loss that the controller cannot avoid."""

    case: str
    scenarios: tuple[str, ...]
    reason: str


UNAVOIDABLE: tuple[Unavoidable, ...] = ()


def allowed_reason(name: str, scenario: str) -> str:
    """Return the reason why a cell may be lost; empty if it may not."""
    losses = (each for each in UNAVOIDABLE if each.case == name and scenario in each.scenarios)
    return next((each.reason for each in losses), "")


def load_course(name: str, size: SizeParameters) -> Scenario:
    """Load a scenario by a name of SCENARIOS, a shipped name, or a YAML or CSV file.

    Raises:
        ValueError: Names file, key, value and bound.
    """
    if name == CIRCUIT or name.endswith(".csv"):
        file = DATA / "tracks" / f"{name}.csv" if name == CIRCUIT else Path(name)
        scenario = from_csv(file, limits=LIMITS)
    elif name == OFFSET:
        scenario = load_scenario("straight", size)._replace(name=OFFSET, start_offset=3.0)
    else:
        scenario = load_scenario(name, size)
    if name in shipped("scenarios") or name == OFFSET:
        scenario = scenario._replace(duration=scenario.duration + RUN_ON)
    return scenario._replace(duration=min(scenario.duration, LONGEST))


def mirrored(scenario: Scenario) -> Scenario:
    """Return the mirror image of a scenario."""
    return scenario._replace(
        points=scenario.points * np.array([1.0, -1.0]),
        wind=tuple(replace(wind, speed=-wind.speed) for wind in scenario.wind),
        lanes=(),
        start_offset=-scenario.start_offset,
    )
