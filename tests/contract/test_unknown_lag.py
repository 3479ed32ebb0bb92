"""A steering whose lag is not configured: what is assumed, by whom, and what is rejected."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ASSUMED_LAG, ControllerSettings, SteeringParameters
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.configuration import Choices, Configuration, configuration, from_yaml, to_yaml
from ampc_ros.mpc.internal_model import actuator_of
from ampc_ros.preview.state_filter import LEAST_SHARE
from ampc_ros.supervision.supervisor import Supervisor
from sim_vehicle.car import Car
from sim_vehicle.parameters import Vehicle, load_vehicle_file


def vehicle_file(folder: Path, lag: str) -> Path:
    """Return a copy of a shipped vehicle file with another line of the lag; empty: without."""
    text = find("vehicles", "ordinary").read_text(encoding="utf-8")
    text, count = re.subn(
        r"^  lag: .*\n", f"  lag: {lag}\n" if lag else "", text, flags=re.MULTILINE
    )
    assert count == 1
    file = folder / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def without_lag(folder: Path) -> tuple[Configuration, Vehicle]:
    """Return controller and car of a vehicle file without a lag."""
    file = vehicle_file(folder, "")
    return configuration(Choices(vehicle=str(file))), load_vehicle_file(file)


def test_a_vehicle_file_without_lag_loads_with_the_assumed_one(tmp_path: Path) -> None:
    config, vehicle = without_lag(tmp_path)
    for steering in (config.steering, vehicle.steering):
        assert not steering.is_lag_configured
        assert steering.time_constant == ASSUMED_LAG == 0.08
    assert actuator_of(config.steering, 0.1).lag == ASSUMED_LAG
    again, _ = from_yaml(to_yaml(config, 1), "bag")
    assert again.steering == config.steering


@pytest.mark.parametrize("lag", [0.0, 0.08, 0.3])
def test_a_lag_that_is_stated_is_used_also_zero(lag: float, tmp_path: Path) -> None:
    steering = load_section(SteeringParameters, vehicle_file(tmp_path, str(lag)), "steering")
    assert steering.is_lag_configured
    assert steering.time_constant == lag
    assert actuator_of(steering, 0.1).lag == lag


def test_minus_one_is_the_same_as_no_line(tmp_path: Path) -> None:
    stated = load_section(SteeringParameters, vehicle_file(tmp_path, "-1"), "steering")
    assert stated == load_section(SteeringParameters, vehicle_file(tmp_path, ""), "steering")


@pytest.mark.parametrize(
    ("lag", "sentence"),
    [
        ("-0.5", "steering.lag = -0.5 must be 0 or more, or -1 if it is unknown"),
        ("-1.0e-9", "steering.lag = -1e-09 must be 0 or more, or -1 if it is unknown"),
        ("-2", "steering.lag = -2 must lie in [-1, 5] s"),
        ("5.1", "steering.lag = 5.1 must lie in [-1, 5] s"),
        (".nan", "steering.lag = nan must "),
    ],
)
def test_another_negative_lag_is_rejected_with_file_key_value_and_bound(
    lag: str, sentence: str, tmp_path: Path
) -> None:
    file = vehicle_file(tmp_path, lag)
    with pytest.raises(ValueError, match=re.escape(f"{file}: {sentence}")):
        load_vehicle_file(file)
    with pytest.raises(ValueError, match=re.escape(f"{file}: {sentence}")):
        configuration(Choices(vehicle=str(file)))


def test_the_simulated_car_has_the_assumed_lag(tmp_path: Path) -> None:
    _, vehicle = without_lag(tmp_path)

    def angle(vehicle: Vehicle) -> float:
        car = Car(vehicle._replace(steering=replace(vehicle.steering, max_rate=math.inf)))
        for _ in range(16):
            car.advance(0.1, 0.0, np.zeros((1, 2)))
        return float(car.steering)

    assert angle(vehicle) == pytest.approx(0.1 * (1.0 - math.exp(-1.0)), abs=1e-9)
    at_once = replace(vehicle.steering, lag=0.0)
    assert angle(vehicle._replace(steering=at_once)) == pytest.approx(0.1)


def numbers(config: Configuration) -> Array:
    """Return the row of a controller's model and filter."""
    row: Array = Supervisor(config).controller.model_row  # type: ignore[attr-defined]
    return row


def test_the_controller_has_the_model_of_the_assumed_lag_and_always_filters(tmp_path: Path) -> None:
    config, _ = without_lag(tmp_path)
    stated = config._replace(steering=replace(config.steering, lag=ASSUMED_LAG))
    unknown, known = numbers(config), numbers(stated)
    (differs,) = np.flatnonzero(unknown != known)
    assert (unknown[differs], known[differs]) == (1.0, 0.0)
    assert differs == len(unknown) - len(known[20:]) + LEAST_SHARE
    settings = load(ControllerSettings, find("controllers", "table3"))
    off = replace(settings, position_noise=0.0, heading_noise=0.0)
    assert not numbers(config._replace(settings=off))[20 + LEAST_SHARE :].any()
