"""The shipped settings and gains for 50 and 100 Hz drive as those for 10 Hz do."""

from functools import cache

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.metrics import evaluate_drive
from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.scenarios.scenario import Scenario, load_scenario
from ampc_ros.controller import make_controller
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.certifying.linear_loop import delay_margin, spectral_radius
from sim_vehicle.closed_loop import Simulation, drive
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file
from tests.workshop.bench.bench_node import CHOICES

FAST = [rate for rate in CHOICES if rate > 10]
SHORTENED = {"sc3_varying": 20.0}
"""Durations of drives whose later speeds occur in others, too [s]."""
every_rate = pytest.mark.parametrize("rate", FAST)
every_car = pytest.mark.parametrize("car", ["paper", "ordinary"])


def controller_at(rate: int, car: str) -> PreviewMpc:
    """Create the controller of a rate [Hz] for a car."""
    controller = make_controller(CHOICES[rate]._replace(vehicle=car))
    assert isinstance(controller, PreviewMpc)
    assert controller.period == 1.0 / rate
    return controller


@cache
def metrics_of(
    rate: int, name: str, car: str, offset: float = 0.0, noise: str = ""
) -> dict[str, float]:
    """Drive a scenario at a rate [Hz]; return the numbers of the result table."""
    vehicle, controller = load_vehicle_file(find("vehicles", car)), controller_at(rate, car)
    scenario: Scenario = load_scenario(name, vehicle.size)._replace(start_offset=offset)
    scenario = scenario._replace(duration=SHORTENED.get(name, scenario.duration))
    heard = load(MeasurementNoise, find("noise", noise)) if noise else None
    simulation = Simulation(vehicle, scenario, noise=heard, rng=np.random.default_rng(1))
    done = drive(simulation, controller)
    path = make_path(scenario.points)
    return evaluate_drive(done, path, vehicle.chassis.cg_to_rear_axle, controller.period)


@every_rate
@every_car
@pytest.mark.parametrize("name", ["sc1", "sc2", "sc3_varying", "sc3_wind", "sine", "circle"])
def test_a_faster_controller_follows_the_path_as_closely(rate: int, car: str, name: str) -> None:
    fast, slow = metrics_of(rate, name, car), metrics_of(10, name, car)
    step = 0.06 if name == "circle" else 0.005  # a circle begins with a step of the curvature
    assert fast["max_error_m"] < 1.2 * slow["max_error_m"] + step
    assert fast["missed_ticks"] == 0


@every_rate
@every_car
def test_a_faster_controller_joins_the_path_from_beside(rate: int, car: str) -> None:
    fast, slow = (metrics_of(each, "straight", car, offset=3.0) for each in (rate, 10))
    assert fast["rms_error_m"] < 1.1 * slow["rms_error_m"]
    assert fast["max_error_m"] < 3.05


@every_rate
def test_noise_moves_car_and_wheel_no_more_than_at_10_hz_is_allowed(rate: int) -> None:
    numbers = metrics_of(rate, "sc1", "paper", noise="x1")
    assert numbers["mse_m2"] < 5e-3
    assert numbers["steering_rms_increment_deg"] < 1.0


@every_rate
@every_car
@pytest.mark.parametrize("v_x", [3.0, 15.0, 40.0])
def test_a_faster_loop_is_stable_with_80_ms_of_unknown_delay(
    rate: int, car: str, v_x: float
) -> None:
    controller, vehicle = controller_at(rate, car), load_vehicle_file(find("vehicles", car))
    parameters = vehicle.chassis, vehicle.steering
    radius = spectral_radius(controller, *parameters, v_x)
    assert radius ** (rate / 10) < 0.97
    assert delay_margin(controller, *parameters, v_x) > 0.08
