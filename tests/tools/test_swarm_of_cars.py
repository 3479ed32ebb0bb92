"""The plant as compiled code calls it: in place, on rows of matrices, without allocation."""

import math
import re
from dataclasses import astuple, make_dataclass, replace
from typing import Any, cast

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import nrt

from ampc_msgs_config import config
from ampc_msgs_config.compiled import compiled
from ampc_msgs_config.types import Array
from sim_vehicle.car import Car
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from sim_vehicle.vehicle import CAR_V_X, SIZE, WORK_SIZE, drive_steps
from sim_vehicle.vehicle_row import pack_vehicle, unpack_vehicle, vehicle_numbers
from sim_vehicle.wheels import wheel_forces

PAPER = load_vehicle_file(config.find("vehicles", "paper"))
ORDINARY = load_vehicle_file(config.find("vehicles", "ordinary"))
SLOW_STEERING = PAPER._replace(
    steering=replace(PAPER.steering, delay=0.13, lag=0.08, max_rate=0.5),
    tyre=replace(PAPER.tyre, model="linear"),
)
CARS = (PAPER, ORDINARY, SLOW_STEERING)
STEP, STEPS, PERIODS = 0.005, 20, 30


@compiled
def drive_swarm(
    periods: tuple[int, int],
    states: Array,
    queues: Array,
    flat: Array,
    wind: Array,
    frictions: Array,
    work: Array,
) -> None:
    """Drive every car through the control periods from the first to before the last."""
    for k in range(periods[0], periods[1]):
        for i in range(len(states)):
            command, car = 0.1 * math.sin(0.3 * k + i), unpack_vehicle(flat[i])
            queue, friction = queues[i, : int(queues[i, -1])], frictions[i]
            first = k * STEPS
            drive_steps(
                states[i], queue, command, 15.0, wind, first, STEPS, friction, STEP, car, work
            )


def swarm(cars: tuple[Vehicle, ...]) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return states, queues (their lengths last), numbers, wind, frictions and scratch."""
    states, queues = np.zeros((len(cars), SIZE)), np.zeros((len(cars), 40))
    states[:, CAR_V_X] = 14.0
    queues[:, -1] = [round(car.steering.delay / STEP) for car in cars]
    wind = 8.0 * np.random.default_rng(2).standard_normal((PERIODS * STEPS, 3, 2))
    flat = np.array([pack_vehicle(car) for car in cars])
    frictions = np.array([car.tyre.friction for car in cars])
    return states, queues, flat, wind, frictions, np.full(WORK_SIZE, math.nan)


def test_each_car_of_a_swarm_drives_as_a_car_of_its_own_bit_for_bit() -> None:
    arrays = swarm(CARS)
    states, wind = arrays[0], arrays[3]
    alone = [Car(vehicle, speed=14.0) for vehicle in CARS]
    for k in range(PERIODS):
        drive_swarm((k, k + 1), *arrays)
        for i, car in enumerate(alone):
            steps = slice(k * STEPS, (k + 1) * STEPS)
            car.advance(0.1 * math.sin(0.3 * k + i), 15.0, wind[steps])
            assert np.array_equal(states[i], car.state)


@pytest.mark.skipif(not isinstance(drive_steps, Dispatcher), reason="nothing is compiled")
def test_control_period_allocates_nothing() -> None:
    arrays = swarm(CARS)
    drive_swarm((0, 1), *arrays)

    runtime: Any = nrt
    stats, switch = runtime.rtsys.get_allocation_stats, runtime._nrt

    def allocations(last: int) -> Any:
        before = stats()
        drive_swarm((0, last), *arrays)
        return np.subtract(stats(), before).tolist()

    switch.memsys_enable_stats()
    try:
        once, often = allocations(1), allocations(PERIODS)
    finally:
        switch.memsys_disable_stats()
    assert once == often  # what handing over the arrays takes, and no more
    assert sum(once) > 0


def test_state_that_a_car_gave_away_does_not_change_any_more() -> None:
    car = Car(PAPER, speed=14.0)
    held = car.state
    car.advance(0.1, 15.0, np.zeros((20, 2)))
    assert held[0] == 0.0
    assert car.state[0] > 1.0


@pytest.mark.parametrize("vehicle", CARS, ids=["paper", "ordinary", "linear"])
def test_numbers_of_a_car_come_back_from_their_row(vehicle: Vehicle) -> None:
    row = pack_vehicle(vehicle)
    assert unpack_vehicle(row) == vehicle_numbers(vehicle)
    row[:] = np.arange(len(row))
    assert [x for section in unpack_vehicle(row) for x in section] == row.tolist()


def test_a_field_inserted_in_one_section_only_is_rejected() -> None:
    body = make_dataclass("Longer", [*vars(PAPER.body), "pitch_stiffness"])
    longer = PAPER._replace(body=body(*astuple(PAPER.body), 1.0))
    with pytest.raises(ValueError, match=r"vehicle row: .* 10, 15, .* 10, 14,"):
        pack_vehicle(longer)


@pytest.mark.skipif(not isinstance(wheel_forces, Dispatcher), reason="nothing is compiled")
def test_loop_over_the_wheels_becomes_simd_code() -> None:
    compiler: Any = numba.njit(error_model="numpy")
    loop = compiler(cast(Any, wheel_forces).py_func)
    work, road, stage = np.ones(WORK_SIZE), (0.9, STEP), (0.0, 1.0)
    loop(work, (14.0, 0.1, 0.1), (4e3, 4e3, 3e3, 3e3), (100.0, 0.0), road, stage)
    (code,) = loop.inspect_llvm().values()
    assert re.search(r"llvm\.sqrt\.v[248]f64", code)
    assert not re.search(r"llvm\.sqrt\.f64", code)
