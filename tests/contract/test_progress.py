"""Progress along a path: against the same search written with arrays, and without an allocation."""

import math
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.dispatcher import Dispatcher

from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.frames import as_received, at_distance
from ampc_msgs_config.paths.path import (
    AHEAD,
    BEHIND,
    FIRST_CATCH,
    MAX_PROJECTION_DISTANCE,
    NOT_CAUGHT,
    Path,
    Progress,
    advance,
    errors_at,
    first_catch,
    point_at,
    project,
)
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.paths.path_frame import PathFrame, path_frame, place, set_point
from ampc_msgs_config.scenarios.scenario import SpeedProfile, preview_speed
from ampc_msgs_config.types import Array, VehicleState

many = settings(max_examples=150, deadline=None, derandomize=True)
Pose = tuple[float, float, float]


def catch_by_arrays(path: Path, x: float, y: float, yaw: float) -> int:
    """Return the result of `first_catch`, by masks over all samples."""
    distance = np.hypot(path.x - x, path.y - y)
    leads_away = np.cos(path.heading - yaw) < 0
    if not leads_away.all():
        distance[leads_away] = np.inf
    near = np.append(distance <= distance.min() + FIRST_CATCH, False)
    first = int(np.argmax(near))
    return first + int(np.argmin(distance[first : first + int(np.argmin(near[first:]))]))


def advance_by_arrays(path: Path, index: int | None, pose: Pose) -> tuple[float, int]:
    """Return the result of `advance`; the index is None before the first catch."""
    reach = math.ceil(BEHIND / path.spacing), math.ceil(AHEAD / path.spacing)
    for known in (index, None):
        i = catch_by_arrays(path, *pose) if known is None else known
        window = [i - reach[0], i + reach[1] + 1]
        if not path.closed:
            window = [max(window[0], 0), min(window[1], len(path.x))]
        s = project(path, pose[0], pose[1], window[0], window[1])
        point = point_at(path, s)
        if math.hypot(point.x - pose[0], point.y - pose[1]) <= MAX_PROJECTION_DISTANCE:
            break
    nearest = round(s / path.spacing)
    return s, nearest if path.closed else min(max(nearest, 0), len(path.x) - 1)


def winding(bends: list[float]) -> Path:
    """Return a path of 20 m for each of these curvatures [1/m]; it may cross itself often."""
    heading = np.cumsum(np.repeat(bends, 10) * 2.0)
    steps = 2.0 * np.column_stack((np.cos(heading), np.sin(heading)))
    return make_path(np.cumsum(steps, axis=0))


def circuit(radius: float) -> Path:
    """Return a closed circle about the origin."""
    angle = np.arange(0.0, math.tau, 1.0 / radius, dtype=np.float64)
    return make_path(radius * np.column_stack((np.cos(angle), np.sin(angle))))


paths = st.one_of(
    st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=15).map(winding),
    st.floats(5.0, 60.0).map(circuit),
)
near = st.floats(-6.0, 6.0)
drives = st.lists(
    st.tuples(st.floats(-30.0, 40.0), near, st.one_of(st.just(math.nan), st.floats(-4.0, 4.0))),
    min_size=1,
    max_size=12,
)


@many
@given(path=paths, drive=drives)
def test_progress_is_that_of_a_search_with_arrays_bit_for_bit(
    path: Path, drive: list[Pose]
) -> None:
    s, index, progress = 0.0, None, Progress(path)
    for forwards, left, turned in drive:
        s += forwards
        point = point_at(path, s)
        x, y = point.x - left * math.sin(point.heading), point.y + left * math.cos(point.heading)
        actual, index = advance_by_arrays(path, index, (x, y, point.heading + turned))
        assert (progress.advance(x, y, point.heading + turned), progress.index) == (actual, index)


@many
@given(path=paths, x=st.floats(-200.0, 200.0), y=st.floats(-200.0, 200.0), yaw=st.floats(-9.0, 9.0))
def test_first_catch_from_anywhere_is_that_of_a_search_with_arrays(
    path: Path, x: float, y: float, yaw: float
) -> None:
    assert first_catch(path, x, y, yaw) == catch_by_arrays(path, x, y, yaw)
    assert first_catch(path, x, y, math.nan) == catch_by_arrays(path, x, y, math.nan)


def test_car_that_no_part_of_the_path_leads_is_caught_by_the_nearest() -> None:
    road = make_path([(0.0, 0.0), (100.0, 0.0)])
    assert advance(road, NOT_CAUGHT, 60.0, 1.0, math.pi)[0] == pytest.approx(60.0)


def test_car_behind_the_start_of_a_circuit_stays_behind_it() -> None:
    path = circuit(40.0)
    _, index = advance(path, 0, *point_at(path, -path.spacing)[:3])
    assert index == -1
    assert advance(path, index, *point_at(path, 0.0)[:3])[0] == pytest.approx(0.0, abs=0.01)


class Swarm(NamedTuple):
    """What a compiled drive needs of the packages' common ground."""

    path: Path
    frame: PathFrame
    profile: SpeedProfile


@compiled
def driven(swarm: Swarm, state: VehicleState, steps: int, results: Array) -> int:
    """Drive along X as a compiled loop does, telling the numbers of each step; gives the index."""
    index = NOT_CAUGHT
    for _ in range(steps):
        car = as_received(at_distance(state, 1.5))
        s, index = advance(swarm.path, index, car.x, car.y, car.yaw)
        results[0], results[1] = errors_at(swarm.path, s, car.x, car.y, car.yaw)
        elapsed = (state.stamp_ns - 1_700_000_000_000_000_000) / 1e9
        results[2], index = preview_speed(
            swarm.profile, swarm.path, index, elapsed, car.x, car.y, car.yaw
        )
        results[3], results[4], results[5] = place(swarm.frame, car.x, car.y, car.yaw)
        results[6] = set_point(swarm.frame, results[3])
        stamp_ns, x, y, yaw, v_x, v_y, yaw_rate = state
        state = VehicleState(stamp_ns + 10**7, x + 0.01 * v_x, y, yaw, v_x, v_y, yaw_rate)
    return index


@pytest.mark.skipif(not isinstance(driven, Dispatcher), reason="counts for compiled code")
@pytest.mark.parametrize("over_distance", [True, False])
def test_no_step_of_a_compiled_drive_allocates(over_distance: bool) -> None:
    path = winding([0.01, -0.01, 0.0, 0.02])
    table = np.array([0.0, 40.0]), np.array([5.0, 9.0])
    swarm = Swarm(path, path_frame(path), SpeedProfile(over_distance, *table))
    state, results = (
        VehicleState(1_700_000_000_123_456_789, 0.0, 0.0, 0.1, 5.0, 0.1, 0.2),
        np.zeros(7),
    )
    runtime: Any = import_module("numba.core.runtime")
    import_module("numba.core.runtime._nrt_python").memsys_enable_stats()
    allocations = []
    for steps in (1, 1, 1000):
        before = runtime.rtsys.get_allocation_stats().mi_alloc
        index = driven(swarm, state, steps, results)
        allocations.append(runtime.rtsys.get_allocation_stats().mi_alloc - before)
    assert allocations[2] == allocations[1]  # those of the call itself
    assert index == pytest.approx(50.0 / path.spacing, rel=0.1)
    assert np.isfinite(results).all()
