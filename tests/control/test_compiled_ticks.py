"""Compiled ticks: agreement with plain Python, no allocation, sufficient scratch memory."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path as File
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.core.errors import NumbaError
from numba.core.runtime import _nrt_python, rtsys  # type: ignore[attr-defined]

from ampc_msgs_config.compiled import compiled, in_place
from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.paths.path_frame import path_frame
from ampc_msgs_config.types import Array, Diagnosis, VehicleState
from ampc_ros.mpc.active_set import active_set, active_set_numbers
from ampc_ros.mpc.gain_table import BOUNDS, Gains, GainTable
from ampc_ros.mpc.hildreth import hildreth, hildreth_numbers
from ampc_ros.mpc.qp import SOLVED
from ampc_ros.mpc.small_matrices import Scratch, make_scratch, matrix, vector
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.paper.tick import call_paper_tick, new_memory
from ampc_ros.preview.controller import PreviewMpc
from ampc_ros.preview.tick import call_preview_tick
from ampc_ros.preview.tick import new_memory as new_preview_memory
from tests.control.test_qp import random_problem
from tests.generated_ticks import CARS, CASES, all_results

needs_compilation = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT),  # type: ignore[attr-defined]
    reason="compilation is switched off",
)
CAR = CARS[0]
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
BEND = make_path([(x, 3.0 * np.sin(x / 20.0)) for x in range(0, 200, 2)])
STATE = VehicleState(0, 10.0, 0.8, 0.1, 9.0, 0.1, 0.05)


@needs_compilation
def test_compiled_ticks_agree_with_plain_python(tmp_path: File) -> None:
    file = tmp_path / "plain.npz"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run(
        [sys.executable, "-m", "tests.generated_ticks", str(file)],
        cwd=File(__file__).parents[2], env=environment, check=True, timeout=200,
    )  # fmt: skip
    plain, own = np.load(file)["results"], all_results()
    np.testing.assert_allclose(own, plain, rtol=1e-9, atol=1e-9)
    diagnoses = plain[:, :, 2 : 2 + len(Diagnosis._fields)].reshape(-1, len(Diagnosis._fields))
    reached = dict(zip(Diagnosis._fields, diagnoses.T, strict=True))
    assert np.mean(reached["active_constraints"] > 1) > 0.3
    assert np.mean(reached["slack"] > 0.0) > 0.1
    assert np.mean(reached["converged"] == 0.0) > 0.05
    assert np.mean(reached["mode"] != 0.0) > 0.1
    assert len(own) == CASES


@pytest.fixture
def allocations() -> Iterator[Callable[[], Any]]:
    """Counts what compiled code allocates and frees."""
    _nrt_python.memsys_enable_stats()
    yield rtsys.get_allocation_stats
    _nrt_python.memsys_disable_stats()


def makes_an_array(n: int) -> float:
    """Allocate once a round, to see that this is counted."""
    total = 0.0
    for i in range(n):
        total += np.ones(i).sum()
    return total


def makes_zeros(a: Array) -> float:
    """Create an array by numpy."""
    return float(np.zeros(len(a))[0])


def copies(a: Array) -> float:
    """Create an array by a method."""
    return float(a.copy()[0])


def adds(a: Array) -> float:
    """Create an array by arithmetic."""
    return float((a + a)[0])


def makes_a_list(a: Array) -> float:
    """Create a list."""
    return float(sum([a[0], a[1]]))


GAINS = [Gains(20, 10, 3, 0.5, 10.0, 50.0), Gains(25, 12, 4, 0.4, 10.0, 80.0)]
OPTIONS: list[dict[str, Any]] = [
    {},
    {"max_output_error": 0.3},
    {"max_output_error": 0.3, "solver": "hildreth"},
]


def drive_by_dead_reckoning(ticks: int) -> Iterator[tuple[Any, ...]]:
    """Yield the states of a drive."""
    x, yaw = 0.0, 0.1
    for k in range(ticks):
        yield tuple(VehicleState(k, x, 0.8, yaw, 9.0, 0.0, 0.0))
        x, yaw = x + 0.15, yaw + 0.001 * (k % 7 - 3)


@needs_compilation
@pytest.mark.parametrize("options", OPTIONS, ids=["active set", "lane", "Hildreth"])
def test_ticks_allocate_nothing(options: dict[str, Any], allocations: Callable[[], Any]) -> None:
    limits, table = replace(SETTINGS, **options), GainTable([5.0, 15.0], [0.0], GAINS)
    one = LateralMpc(CAR.chassis, limits, table)
    steering = replace(CAR.steering, delay=0.13, lag=0.05)
    other = PreviewMpc(CAR.chassis, steering, limits, table)
    road, points = (tuple(BEND), tuple(path_frame(BEND))), np.empty((other.horizon, 3))
    paper, angles = new_memory(), np.empty(12)
    sent = new_preview_memory(other.model.actuator.ticks)
    gains, scratch = tuple(one.table), tuple(one.scratch)
    their, ahead = tuple(other.table), tuple(other.scratch)
    steered = 0.0
    before = allocations().alloc
    for state in drive_by_dead_reckoning(1000):
        first = call_paper_tick(one.model_row, gains, road, state, paper, scratch, angles)
        second = call_preview_tick(other.model_row, their, road[0], state, 0.1, sent, ahead, points)
        steered += abs(first[0]) + abs(second[0])
    assert allocations().alloc == before
    assert steered > 0.0
    assert compiled(makes_an_array)(1000) > 0.0
    assert allocations().alloc >= before + 1000


@needs_compilation
@pytest.mark.parametrize("function", [makes_zeros, copies, adds, makes_a_list])
def test_a_function_in_place_that_takes_memory_is_refused(
    function: Callable[[Array], float],
) -> None:
    with pytest.raises(NumbaError):
        in_place(function)(np.ones(2))
    assert function(np.ones(2)) in (0.0, 1.0, 2.0)  # nothing else is wrong with it


@given(
    horizon=st.integers(1, 200),
    share=st.floats(0.0, 1.0),
    N=st.integers(1, 20),
    delay=st.integers(0, 19),
    solver=st.sampled_from(["active_set", "hildreth"]),
)
@settings(max_examples=40, deadline=None, derandomize=True)
def test_scratch_memory_is_enough_for_every_gain_table(
    horizon: int, share: float, N: int, delay: int, solver: str
) -> None:
    N_c = max(1, round(share * horizon))
    gains = Gains(horizon, N_c, min(N, N_c), 0.0, 1.0, 1e3)
    limits = replace(SETTINGS, max_output_error=0.05, solver=solver, hildreth_sweeps=2.0)
    steering = replace(CAR.steering, delay=0.1 * delay + 0.03, lag=0.1)
    table = GainTable([9.0], [0.0], [gains])
    assert np.isfinite(PreviewMpc(CAR.chassis, steering, limits, table).step(STATE, BEND).steering)
    assert np.isfinite(LateralMpc(CAR.chassis, limits, table).step(STATE, BEND).steering)


@pytest.mark.parametrize("solver", ["active_set", "hildreth"])
def test_scratch_memory_is_enough_for_the_largest_gains_and_longest_delay(solver: str) -> None:
    highest = [int(BOUNDS[key].le) for key in Gains._fields[:3]]
    gains = Gains(*highest, 0.0, 1.0, 1e3)  # type: ignore[call-arg]
    limits = replace(
        SETTINGS, max_output_error=0.05, solver=solver, hildreth_sweeps=2.0, sample_time=0.01
    )
    steering = replace(CAR.steering, delay=2.0, lag=0.1)
    table = GainTable([9.0], [0.0], [gains])
    command = PreviewMpc(CAR.chassis, steering, limits, table).step(STATE, BEND)
    assert command.prediction is not None
    assert command.prediction.shape == (400, 2)
    assert np.isfinite(command.prediction).all()


@pytest.mark.parametrize("kind", ["plain", "two sides", "equal bounds", "shared slack"])
def test_solvers_need_what_their_formulas_say_and_give_it_back(kind: str) -> None:
    rng = np.random.default_rng(11)
    for _ in range(50):
        qp = random_problem(rng, kind)
        m, n = qp.M.shape
        scratch = make_scratch(active_set_numbers(m, n))
        _, status = active_set(qp, np.zeros(n), np.zeros(m), scratch)
        assert (status, scratch.used[0]) == (SOLVED, 0)
        scratch = make_scratch(hildreth_numbers(m, n))
        hildreth(qp, (5, 1e-7), np.zeros(n), np.zeros(m), scratch)
        assert scratch.used[0] == 0


def test_too_small_a_scratch_memory_is_refused() -> None:
    qp = random_problem(np.random.default_rng(0), "two sides")
    m, n = qp.M.shape
    for size in (0, n * n + n, n * n + n + m):
        with pytest.raises(MemoryError, match="scratch memory is too small"):
            active_set(qp, np.zeros(n), np.zeros(m), make_scratch(size))
        with pytest.raises(MemoryError, match="scratch memory is too small"):
            hildreth(qp, (5, 1e-7), np.zeros(n), np.zeros(m), make_scratch(size))


def test_ticks_refuse_too_small_a_scratch_memory_and_go_on_with_enough() -> None:
    table = GainTable([9.0], [0.0], [GAINS[0]])
    controllers: list[LateralMpc | PreviewMpc] = [
        LateralMpc(CAR.chassis, SETTINGS, table),
        PreviewMpc(CAR.chassis, CAR.steering, SETTINGS, table),
    ]
    for controller in controllers:
        enough, controller.scratch = controller.scratch, make_scratch(100)
        with pytest.raises(MemoryError, match="scratch memory is too small"):
            controller.step(STATE, BEND)
        controller.scratch = enough
        assert np.isfinite(controller.step(STATE, BEND).steering)


@in_place
def take(scratch: Scratch) -> float:
    """Take a vector and a matrix, and write into them."""
    v, m = vector(scratch, 3), matrix(scratch, 2, 2)
    total = 0.0
    for i in range(3):
        total += v[i]
        v[i] = 1.0
    for i in range(2):
        total += m[i, 0] + m[i, 1]
        m[i, 0] = m[i, 1] = 2.0
    return total


def test_scratch_memory_gives_zeros_one_after_the_other() -> None:
    scratch = make_scratch(14)
    assert take(scratch) == 0.0
    np.testing.assert_array_equal(scratch.numbers, [1] * 3 + [2] * 4 + [0] * 7)
    assert take(scratch) == 0.0
    assert scratch.used[0] == 14
    scratch.used[0] = 0
    assert take(scratch) == 0.0  # what was written before is gone
    scratch.used[0] = 8
    with pytest.raises(MemoryError):
        take(scratch)
