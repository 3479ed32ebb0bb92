"""The tuner's fitness: against drives one by one, and what it may and may not prefer."""

import pickle

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import errors
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from launch_scripts.tuning.drives import PLANTS, Plant, lane_change, simulated_car, step_to
from launch_scripts.tuning.fitness import (
    INCREMENT_WEIGHT,
    NEGLIGIBLE,
    Node,
    combined,
    drive_gain_sets,
    fitness,
)
from launch_scripts.tuning.fleet import CROSS_TRACK_ERROR
from sim_vehicle.closed_loop import drive
from sim_vehicle.parameters import load_vehicle_file

PAPER = load_vehicle_file(find("vehicles", "paper"))
TABLE_3 = load_gain_table("table3").nodes[0]
HAND_SET = load_gain_table("preview")
STEP = Node(PAPER, "paper", "paper", 9.0, 5.0)
ROBUST = Node(PAPER, "preview", "robust", 9.0)


def test_fitness_of_the_paper_is_the_mean_squared_error_of_the_step() -> None:
    scenario = step_to(STEP.speed, STEP.reference)
    settings = load(ControllerSettings, find("controllers", "table3"))
    controller = LateralMpc(PAPER.chassis, settings, GainTable([9.0], [0.0], [TABLE_3]))
    driven = drive(simulated_car(Plant("step"), PAPER, scenario), controller)
    path = make_path(scenario.points)
    error = errors(driven, path, PAPER.chassis.cg_to_rear_axle)[:, 0]
    assert abs(error[0]) == pytest.approx(5.0)
    assert fitness(STEP, [TABLE_3])[0] == pytest.approx(np.mean(error**2), rel=1e-9)


def test_fitness_does_not_depend_on_the_company_in_the_generation() -> None:
    gains = [
        Gains(55, 18, 9, 0.9, 10.0, 1.0),
        TABLE_3,
        Gains(5, 2, 1, 0.75, 10.0, 0.1),
        Gains(30, 10, 3, 0.8, 10.0, 5.0),
    ]
    together = fitness(STEP, gains)
    alone = np.concatenate([fitness(STEP, [each]) for each in gains])
    np.testing.assert_array_equal(together, alone)
    assert np.isfinite(together[1:]).all()


def test_left_and_right_are_equally_hard() -> None:
    right = STEP._replace(reference=-STEP.reference)
    assert fitness(right, [TABLE_3])[0] == pytest.approx(fitness(STEP, [TABLE_3])[0], rel=1e-9)


def test_a_node_without_a_lateral_reference_uses_a_small_step() -> None:
    assert fitness(STEP._replace(reference=0.0), [TABLE_3])[0] > 0.01


def test_gains_that_the_controller_refuses_are_infinitely_bad() -> None:
    singular = TABLE_3._replace(laguerre_terms=8)
    settings = load(ControllerSettings, find("controllers", "table3"))
    with pytest.raises(ValueError, match=r"cond\(E\)"):
        LateralMpc(PAPER.chassis, settings, GainTable([9.0], [0.0], [singular]))
    values = fitness(STEP, [singular, TABLE_3])
    assert np.isinf(values[0])
    assert np.isfinite(values[1])


def test_a_lost_car_is_infinitely_bad() -> None:
    fast = Node(PAPER, "paper", "robust", 27.0)
    assert np.isinf(fitness(fast, [TABLE_3])[0])


def test_robust_fitness_prefers_hand_set_gains_to_dead_beat_ones_that_win_the_nominal_drive() -> (
    None
):
    hand_set = HAND_SET.lookup(9.0).gains
    dead_beat = hand_set._replace(increment_weight=0.01)
    log = drive_gain_sets(ROBUST, np.array([hand_set, dead_beat], dtype=float))
    nominal = np.mean(log[:, 0, :, CROSS_TRACK_ERROR] ** 2, axis=1)
    assert nominal[1] < nominal[0]
    values = fitness(ROBUST, [hand_set, dead_beat])
    assert values[0] < 0.5 * values[1]


def test_robust_fitness_is_what_its_drives_say() -> None:
    row = np.array([HAND_SET.lookup(9.0).gains], dtype=float)
    cost = []
    for plant, log in zip(PLANTS, drive_gain_sets(ROBUST, row)[0], strict=True):
        tail = log[90:] if plant.road == "joining" else log[30:]
        increments = 9.0 * 0.1 * np.diff(log[:, 1])
        cost.append(np.mean(tail[:, 0] ** 2) + INCREMENT_WEIGHT * np.mean(increments**2))
    total = np.array(cost) + NEGLIGIBLE**2
    expected = np.sqrt(np.prod(total) ** (1 / len(total)) * total.max())
    assert fitness(ROBUST, row)[0] == pytest.approx(expected, rel=1e-9)


def test_the_worst_drive_and_every_other_count() -> None:
    base = np.array([[1.0, 2.0, 8.0]])
    for column in range(3):
        worse = base.copy()
        worse[0, column] *= 1.5
        assert combined(worse)[0] > combined(base)[0]


@pytest.mark.parametrize("v", [5.0, 15.0, 40.0])
def test_the_lane_change_asks_for_its_lateral_acceleration(v: float) -> None:
    path = make_path(lane_change(v).points)
    assert np.abs(path.curvature).max() * v**2 == pytest.approx(2.5, rel=0.05)


def test_a_node_keeps_its_fitness_when_it_travels() -> None:
    travelled = pickle.loads(pickle.dumps(STEP))
    assert travelled == STEP
    assert hash(travelled) == hash(STEP)
    np.testing.assert_array_equal(fitness(travelled, [TABLE_3]), fitness(STEP, [TABLE_3]))
