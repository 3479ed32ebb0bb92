"""Cars driven with defects of odometry that last, and without any."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.types import NANOSECONDS, WARN, VehicleState
from ampc_ros.supervision.health import health, health_numbers
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.parameters import load_vehicle_file
from tests.supervised import Distortion, made_for, supervised
from tests.workshop.acceptance.trials import Trial

CARS = ("paper", "ordinary")
BEGIN = 5.0
"""Begin of the defects [s]."""
YAW_RATES: dict[str, Callable[[float, float], float]] = {
    "9 rad/s": lambda r, t: 9.0,
    "1 rad/s": lambda r, t: 1.0,
    "0 rad/s": lambda r, t: 0.0,
    "+0.3 rad/s": lambda r, t: r + 0.3,
    "-0.3 rad/s": lambda r, t: r - 0.3,
    "+0.1 rad/s": lambda r, t: r + 0.1,
    "drift of 0.02 rad/s2": lambda r, t: r + 0.02 * (t - BEGIN),
}


def wrong_yaw_rate(name: str) -> Distortion:
    """Return a defect of the yaw rate from BEGIN on."""

    def distort(state: VehicleState, t: float) -> VehicleState:
        if t < BEGIN:
            return state
        return state._replace(yaw_rate=YAW_RATES[name](state.yaw_rate, t))

    return distort


@pytest.mark.parametrize("seed", [None, 2])
@pytest.mark.parametrize("fault", YAW_RATES)
@pytest.mark.parametrize("road", ["straight", "circle"])
@pytest.mark.parametrize("car", CARS)
def test_a_wrong_yaw_rate_costs_less_than_0_35_m(
    car: str, road: str, fault: str, seed: int | None
) -> None:
    trial = Trial(road, car, 9.0, seed=seed)
    config = made_for(car)
    supervisor = Supervisor(config)
    run = supervised(trial, config, supervisor=supervisor, distort=wrong_yaw_rate(fault))
    begin = round(BEGIN / supervisor.period)
    assert np.abs(run.driven.error[begin:]).max() < 0.35
    corrected = [record.corrected_yaw_rate for record in run.records]
    assert all(map(math.isnan, corrected[:begin]))
    if road == "straight" and fault == "0 rad/s":
        return  # it is right there
    assert not math.isnan(corrected[-1])
    now_ns = supervisor.newest_ns
    level, sentence = health(supervisor, run.records[-1], now_ns)
    assert level == WARN
    assert sentence.startswith("odom: yaw_rate_")
    assert "the heading turns at" in sentence
    assert any(key.startswith("replaced_yaw_rate_") for key in health_numbers(supervisor, None))


@pytest.mark.parametrize("car", CARS)
def test_replaced_yaw_rates_are_replayed_bit_for_bit(car: str) -> None:
    config = made_for(car)
    distort = wrong_yaw_rate("1 rad/s")
    run = supervised(Trial("circle", car, 9.0), config, distort=distort)
    again = Supervisor(config)
    again.take_path(run.driven.scenario.points, NANOSECONDS, NANOSECONDS)
    states = {state.stamp_ns: state for state in run.driven.drive.states}
    for t, record in zip(run.times, run.records, strict=True):
        reported = distort(states[record.command.stamp_ns], t)
        received = Received(reported, reported.stamp_ns, reported.stamp_ns)
        again.replay_state(received, int(record.resets), record.corrected_yaw_rate)
        replayed = again.tick(NANOSECONDS + round(t * NANOSECONDS))
        assert replayed is not None
        assert replayed.command.steering == record.command.steering
        assert repr(replayed.corrected_yaw_rate) == repr(record.corrected_yaw_rate)


SCENARIOS = ("sc1", "sc2", "sc3_varying", "sc3_wind", "iso3888_2")


@pytest.mark.parametrize(("seed", "friction"), [(None, None), (4, None), (4, 0.5)])
@pytest.mark.parametrize("road", SCENARIOS)
@pytest.mark.parametrize("car", CARS)
def test_correct_odometry_is_never_criticised(
    car: str, road: str, seed: int | None, friction: float | None
) -> None:
    config = made_for(car)
    supervisor = Supervisor(config)
    problems = set[str]()

    def watch(state: VehicleState, _: float) -> VehicleState:
        problems.update(supervisor.odometry.problems(config.chassis, config.base_link_to_cg))
        return state

    trial = Trial(road, car, seed=seed, friction=friction)
    supervised(trial, config, supervisor=supervisor, distort=watch)
    assert not problems
    assert not any(supervisor.odometry.yaw_rate.replaced.values())


@pytest.mark.parametrize("seed", [None, 3])
@pytest.mark.parametrize(("road", "speed"), [("circle", 5.0), ("circle", 9.0), ("sine", 15.0)])
@pytest.mark.parametrize("car", CARS)
def test_odometry_of_the_front_bumper_is_named_and_accepted_with_the_parameter(
    car: str, road: str, speed: float, seed: int | None
) -> None:
    vehicle = load_vehicle_file(find("vehicles", car))
    ahead = vehicle.chassis.wheelbase + vehicle.size.front_overhang

    def at_bumper(state: VehicleState, _: float) -> VehicleState:
        return at_distance(state, ahead)

    to_cg = vehicle.chassis.cg_to_rear_axle - ahead
    for parameter, is_named in ((None, True), (to_cg, False)):
        config = made_for(car, base_link_to_cg=parameter)
        supervisor = Supervisor(config)
        trial = Trial(road, car, speed, seed=seed)
        run = supervised(trial, config, supervisor=supervisor, distort=at_bumper)
        sentence = health(supervisor, run.records[-1], supervisor.newest_ns).sentence
        assert ("odom: measuring_point: " in sentence) == is_named
