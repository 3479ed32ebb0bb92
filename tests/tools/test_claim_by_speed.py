"""The paper's claim over speed: its drives, its means, its searches and its tables."""

import math

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import errors
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_ros.mpc.gain_table import Gains, load_gain_table
from launch_scripts.study.claim_by_speed import claim_tables, main
from launch_scripts.study.drives import TunedGains, metrics_of, study_scenario
from launch_scripts.study.speed_sweep import (
    CLAIM_GAINS,
    CLAIM_PLANTS,
    CLAIM_RATIOS,
    CLAIM_ROADS,
    UNSEEN_SEED,
    ClaimPlan,
    claim_controller,
    claim_cost,
    claim_errors,
    claim_road,
    claim_summary,
    drive_claim,
    drive_claim_roads,
    measure_claim,
    prepare_claim_node,
    search_claim_gains,
)
from launch_scripts.tuning.fleet import CROSS_TRACK_ERROR, LOGGED
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

TABLE3 = load_gain_table("table3").nodes[0]
SMALL = ClaimPlan((4.0, 9.0), evaluations=6, noise_seeds=1)
NOISE = [plant.name for plant in CLAIM_PLANTS].index("noise")


def do_nothing() -> None:
    pass


def test_plan_drives_eleven_nodes_from_3_to_27_m_s_and_the_speeds_half_way() -> None:
    plan = ClaimPlan()
    assert plan.speeds[::2] == list(plan.nodes) == pytest.approx(np.linspace(3.0, 27.0, 11))
    assert plan.speeds[1::2] == pytest.approx((np.array(plan.nodes)[1:] + plan.nodes[:-1]) / 2)


@pytest.mark.parametrize("speed", [12.0, 20.0])
def test_lane_change_asks_for_2_5_m_s2(speed: float) -> None:
    path = make_path(claim_road(speed).points)
    assert np.abs(path.curvature).max() * speed**2 == pytest.approx(2.5, rel=0.02)


@pytest.mark.parametrize(("drive_name", "speed"), [("nominal", 12.0), ("noise", 5.0)])
def test_errors_are_those_of_a_single_car_in_the_closed_loop(drive_name: str, speed: float) -> None:
    car, road = load_vehicle_file(find("vehicles", "paper")), claim_road(speed)
    names = [plant.name for plant in CLAIM_PLANTS]
    measured = drive_claim([claim_controller([speed], [TABLE3])], [speed]).mse[0, 0]
    noise = load(MeasurementNoise, find("noise", "x1")) if drive_name == "noise" else None
    rng = np.random.default_rng(UNSEEN_SEED) if noise else None
    controller = claim_controller([speed], [TABLE3])
    driven = drive(Simulation(car, road, noise=noise, rng=rng), controller)
    alone = errors(driven, make_path(road.points), car.chassis.cg_to_rear_axle)[:, 0]
    assert measured[names.index(drive_name)] == pytest.approx(np.mean(alone**2), rel=1e-6)


def test_errors_on_the_paper_s_roads_are_those_of_the_contender_ampc_of_the_study() -> None:
    mse = drive_claim_roads([claim_controller([3.0, 27.0], [TABLE3])], CLAIM_PLANTS[0]).mse[0]
    tuned = TunedGains((0.6, 4.0), TABLE3, TABLE3)
    for road, value in zip(CLAIM_ROADS, mse, strict=True):
        alone = metrics_of(["paper"], study_scenario(road), tuned, frozenset())["paper"]
        assert value == pytest.approx(alone["mse_m2"], rel=1e-6)


def test_table_of_equal_nodes_drives_as_its_single_set() -> None:
    equal = claim_controller([5.0, 8.0, 11.0], [CLAIM_GAINS] * 3)
    single = claim_controller([5.0, 8.0, 11.0], [CLAIM_GAINS])
    mse = drive_claim([equal, single], [6.5]).mse
    assert np.array_equal(mse[0], mse[1])


def test_at_the_speed_of_the_fixed_model_nothing_is_left_to_adapt() -> None:
    fixed = claim_controller([9.0], [CLAIM_GAINS], fixed_speed=9.0)
    mse = drive_claim([fixed, claim_controller([9.0], [CLAIM_GAINS])], [9.0]).mse
    assert mse[0, :, :NOISE] == pytest.approx(mse[1, :, :NOISE], rel=0.01)


def test_far_above_its_speed_the_fixed_model_loses_the_car_and_the_adaptive_one_does_not() -> None:
    fixed = claim_controller([20.0], [TABLE3], fixed_speed=9.0)
    lost = drive_claim([fixed, claim_controller([20.0], [TABLE3])], [20.0]).lost
    assert lost[0, 0, 0]
    assert not lost[1, 0, 0]


def test_ticks_after_a_loss_count_with_10_m() -> None:
    log = np.full((3, 10, LOGGED), np.nan)
    log[0, :, CROSS_TRACK_ERROR] = 2.0
    log[1, :4, CROSS_TRACK_ERROR] = -1.0
    log[2, :5, CROSS_TRACK_ERROR] = 3.0  # a drive of five ticks
    mse, lost = claim_errors(log, np.array([10, 10, 5]))
    assert mse == pytest.approx([4.0, 0.4 * 1.0 + 0.6 * 100.0, 9.0])
    assert lost.tolist() == [False, True, False]


def test_each_factor_is_the_ratio_of_two_geometric_means_and_their_product_is_the_whole() -> None:
    mse = np.exp(np.random.default_rng(3).normal(size=(4, 2, 5)))
    summary = claim_summary(mse, mse > 2.0)
    mean = [math.prod(values.ravel().tolist()) ** 0.1 for values in mse]
    assert list(summary["mse_m2"].values()) == pytest.approx(mean)
    assert list(summary["lost"].values()) == [int((values > 2.0).sum()) for values in mse]
    assert list(summary["ratio"]) == list(CLAIM_RATIOS)
    assert math.prod(summary["ratio"].values()) == pytest.approx(mean[0] / mean[3])


def test_fitness_of_a_search_is_the_reported_error_with_the_noise_that_it_has_seen() -> None:
    seen = prepare_claim_node(7.0, noise_seeds=1)
    cost = claim_cost(seen, np.array([TABLE3, CLAIM_GAINS], dtype=float))
    for gains, value in zip((TABLE3, CLAIM_GAINS), cost, strict=True):
        mse = drive_claim([claim_controller([7.0], [gains])], [7.0]).mse[0, 0]
        four = math.prod(mse[:NOISE].tolist())
        noisy = value**5 / four
        assert noisy != pytest.approx(mse[NOISE], rel=1e-6)
        assert noisy == pytest.approx(mse[NOISE], rel=0.5)


def test_no_search_sees_the_noise_of_the_evaluation() -> None:
    plan = ClaimPlan()
    assert 1 + plan.noise_seeds <= UNSEEN_SEED
    assert CLAIM_PLANTS[NOISE] is CLAIM_PLANTS[-1]


def test_searches_are_repeatable_and_the_pole_changes_little_from_node_to_node() -> None:
    plan = SMALL._replace(nodes=(4.0, 9.0, 20.0), pole_change=0.05)
    single, table = search_claim_gains(plan, do_nothing)
    assert (single, table) == search_claim_gains(plan, do_nothing)
    assert np.abs(np.diff([found.gains.laguerre_pole for found in table])).max() <= 0.05 + 1e-6
    fixed = [(g.prediction_horizon, g.control_horizon, g.laguerre_terms) for g, _ in table]
    assert set(fixed) == {(25, 12, 3)}
    assert search_claim_gains(plan._replace(seed=2), do_nothing)[0] != single


def test_tables_show_every_speed_and_mark_nodes_and_losses() -> None:
    steps: list[int] = []
    results = measure_claim(SMALL, lambda: steps.append(1))
    assert len(steps) == SMALL.steps
    assert [row["speed_mps"] for row in results["speeds"]] == [4.0, 6.5, 9.0]
    assert [row["node"] for row in results["speeds"]] == [True, False, True]
    results["speeds"][1]["lost"]["classic"] = 3
    lines = claim_tables(results).splitlines()
    assert [line.split("|")[1].strip() for line in lines[2:5]] == ["4 *", "6.5", "9 *"]
    assert "(3)" in lines[3].split("|")[2]
    assert Gains(**results["gains"]["single"]).output_weight == CLAIM_GAINS.output_weight


def test_a_negative_seed_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--seed", "-1"])
    assert "--seed -1 must not be negative" in capsys.readouterr().err
