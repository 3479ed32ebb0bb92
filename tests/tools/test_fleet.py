"""A fleet in one compiled call against the same cars driven one by one in Python."""

import math
from dataclasses import fields, replace
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import Drive
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.scenarios.scenario import Scenario, SpeedProfile, load_scenario
from ampc_msgs_config.types import Array
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.mpc.gain_table import GainTable, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.tuning.fleet import CROSS_TRACK_ERROR
from launch_scripts.tuning.fleet_rows import Entry, drive_fleet, prepare_fleet, run_fleet
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.measurement import Deviations
from sim_vehicle.parameters import MeasurementNoise, Vehicle, load_vehicle_file

PAPER = load_vehicle_file(find("vehicles", "paper"))
ORDINARY = load_vehicle_file(find("vehicles", "ordinary"))
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
NOISE = load(MeasurementNoise, find("noise", "x1"))


def circuit() -> Scenario:
    """Return two laps of a closed path at a speed over distance."""
    angle = np.linspace(0.0, math.tau, 200)
    points = np.column_stack((60 * np.sin(angle), 40 * (1 - np.cos(angle)))).astype(np.float64)
    at = np.array([0.0, 80.0, 200.0, 318.0])
    profile = SpeedProfile(True, at, np.array([8.0, 11.0, 7.0, 8.0]), 318.0)
    return Scenario("circuit", points, profile, 12.0)


def controller_of(kind: str, vehicle: Vehicle) -> PreviewMpc | LateralMpc:
    """Create a controller with this internal model."""
    if kind == "preview":
        return PreviewMpc(vehicle.chassis, vehicle.steering, SETTINGS, load_gain_table("preview"))
    nominal = 9.0 if kind == "classic" else 0.0
    settings = replace(SETTINGS, nominal_speed=nominal)
    return LateralMpc(vehicle.chassis, settings, load_gain_table("table3"))


def entries(kind: str) -> list[Entry]:
    """Return cars that differ in road, load, steering, friction, noise and linkage."""
    lagging = PAPER._replace(steering=replace(PAPER.steering, delay=0.13, lag=0.1))
    heavy = PAPER._replace(chassis=replace(PAPER.chassis, mass=1900.0))
    roads = {name: load_scenario(name, PAPER.size) for name in ("sc1", "sc2", "sc3_wind")}
    short: list[tuple[Vehicle, Vehicle, Scenario, dict[str, Any], float]] = [
        (PAPER, PAPER, roads["sc1"], {}, 0.0),
        (PAPER, heavy, roads["sc2"], {"friction": 0.7}, 0.0),
        (PAPER, lagging, roads["sc1"], {}, math.radians(0.5)),
        (ORDINARY, ORDINARY, roads["sc3_wind"]._replace(duration=20.0), {}, 0.0),
        (PAPER, PAPER, roads["sc1"], {"noise": NOISE, "rng": np.random.default_rng(3)}, 0.0),
    ]
    if kind == "preview":
        short.append((lagging, lagging, circuit(), {}, 0.0))
    return [
        Entry(
            Simulation(car, road._replace(start_offset=0.3), **options),
            controller_of(kind, model),
            u,
        )
        for model, car, road, options, u in short
    ]


class Misaligned:
    """Controller behind a linkage that adds an angle."""

    def __init__(self, entry: Entry) -> None:
        """Wrap the controller of an entry."""
        self.entry, self.period = entry, entry.controller.period

    def step(self, *arguments: object):  # type: ignore[no-untyped-def]
        """Return the command with the angle added."""
        command = self.entry.controller.step(*arguments)  # type: ignore[arg-type]
        return command._replace(steering=command.steering + self.entry.misalignment)


def one_by_one(entry: Entry) -> Drive:
    """Drive a car in Python."""
    return drive(entry.simulation, Misaligned(entry))


def motion(driven: Drive) -> Array:
    """Return all that was measured (n, 7)."""
    return np.array(driven.states, dtype=float)


@pytest.mark.parametrize("kind", ["preview", "paper", "classic"])
def test_a_fleet_drives_as_its_cars_do_one_by_one(kind: str) -> None:
    fleet = drive_fleet(entries(kind))
    for driven, entry in zip(fleet, entries(kind), strict=True):
        alone = one_by_one(entry)
        np.testing.assert_allclose(motion(driven), motion(alone), rtol=0, atol=1e-9)
        command = driven.steering + entry.misalignment
        np.testing.assert_allclose(command, alone.steering, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["preview", "paper"])
def test_every_array_of_a_fleet_has_one_row_per_car(kind: str) -> None:
    fleet = prepare_fleet(entries(kind)).fleet
    assert {name: len(rows) for name, rows in fleet._asdict().items()} == dict.fromkeys(
        fleet._fields, len(entries(kind))
    )


def test_noise_is_packed_in_the_order_in_which_it_is_read() -> None:
    assert Deviations._fields == tuple(field.name for field in fields(MeasurementNoise))


@pytest.mark.parametrize("kind", ["preview", "paper"])
def test_threads_and_company_change_no_bit(kind: str) -> None:
    whole = run_fleet(prepare_fleet(entries(kind)))
    np.testing.assert_array_equal(run_fleet(prepare_fleet(entries(kind)), threads=3), whole)
    alone = run_fleet(prepare_fleet(entries(kind)[1:2]))[0]
    np.testing.assert_array_equal(alone, whole[1, : len(alone)])


def test_a_prepared_fleet_can_be_driven_again() -> None:
    expedition = prepare_fleet(entries("preview"))
    np.testing.assert_array_equal(run_fleet(expedition), run_fleet(expedition))


def test_a_lost_car_drives_no_farther() -> None:
    log = run_fleet(prepare_fleet(entries("preview"), lost=0.2))[0]
    error = log[:, CROSS_TRACK_ERROR]
    assert abs(error[0]) == pytest.approx(0.3, abs=1e-9)
    assert np.isnan(log[1:]).all()


def test_mirrored_road_and_start_give_the_mirrored_drive() -> None:
    road = load_scenario("sc1", PAPER.size)._replace(start_offset=0.4)
    mirrored = road._replace(points=road.points * (1.0, -1.0), start_offset=-0.4)
    left, right = run_fleet(
        prepare_fleet(
            [Entry(Simulation(PAPER, r), controller_of("preview", PAPER)) for r in (road, mirrored)]
        )
    )
    signs = np.array([-1, -1, 1, 1, -1, -1, 1, -1, -1])
    np.testing.assert_allclose(right, signs * left, rtol=0, atol=1e-9)


def test_cars_of_one_fleet_may_have_gains_of_their_own() -> None:
    road = load_scenario("sc1", PAPER.size)
    node = load_gain_table("preview").nodes[1]
    tables = [GainTable([9.0], [0.0], [node._replace(increment_weight=R)]) for R in (50.0, 5000.0)]
    cars = [PreviewMpc(PAPER.chassis, PAPER.steering, SETTINGS, table) for table in tables]
    fleet = drive_fleet([Entry(Simulation(PAPER, road), controller) for controller in cars])
    for driven, table in zip(fleet, tables, strict=True):
        controller = PreviewMpc(PAPER.chassis, PAPER.steering, SETTINGS, table)
        alone = drive(Simulation(PAPER, road), controller)
        np.testing.assert_allclose(driven.steering, alone.steering, rtol=0, atol=1e-9)


def test_a_drive_allocates_no_more_the_longer_it_is() -> None:
    runtime: Any = import_module("numba.core.runtime")
    import_module("numba.core.runtime._nrt_python").memsys_enable_stats()
    road = load_scenario("sc1", PAPER.size)
    allocations = []
    for duration in (0.1, 0.1, 10.0):
        simulation = Simulation(PAPER, road._replace(duration=duration))
        expedition = prepare_fleet([Entry(simulation, controller_of("preview", PAPER))])
        before = runtime.rtsys.get_allocation_stats().mi_alloc
        run_fleet(expedition)
        allocations.append(runtime.rtsys.get_allocation_stats().mi_alloc - before)
    assert allocations[2] == allocations[1]


def test_mixed_company_is_refused() -> None:
    with pytest.raises(ValueError, match="same formulation, period and step"):
        prepare_fleet([*entries("preview"), *entries("paper")])
    coarse = make_controller(Choices(gain_table="preview"))
    assert isinstance(coarse, PreviewMpc)
    single = GainTable([9.0], [0.0], [load_gain_table("preview").nodes[1]])
    other = PreviewMpc(PAPER.chassis, PAPER.steering, SETTINGS, single)
    road = load_scenario("sc1", PAPER.size)
    with pytest.raises(ValueError, match="gain grids must be the same"):
        prepare_fleet([Entry(Simulation(PAPER, road), c) for c in (coarse, other)])
