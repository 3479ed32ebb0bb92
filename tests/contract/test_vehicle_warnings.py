"""Implausible vehicles are reported with key and remedy; real ones are not."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.parameters import ChassisParameters, SteeringParameters
from ampc_msgs_config.vehicle_file import load_section
from ampc_msgs_config.vehicle_warnings import LIGHT, file_warnings, vehicle_warnings
from launch_scripts.templates.vehicle_rules import DataSheet, vehicle_template
from tests.workshop.acceptance.independent_plant import assumed_parameters

PLAIN = SteeringParameters(max_angle=0.6, max_rate=0.7)
HOLLOW = "gazebo_ackermann"
"""Robot with a body of 1 kg: twenty times its mass is still plausible."""


def template(mass: float, wheelbase: float, kind: str = "") -> ChassisParameters:
    sheet = DataSheet(mass=mass, wheelbase=wheelbase)
    return ChassisParameters(**vehicle_template(sheet, kind).sections["chassis"])


CARS = {
    **{
        name: load_section(ChassisParameters, find("vehicles", name), "chassis")
        for name in shipped("vehicles")
        if name != HOLLOW
    },
    **{f"CommonRoad {number}": assumed_parameters(number)[0] for number in (1, 2, 3)},
    "van": template(2800.0, 3.3),
    "bus": template(15000.0, 5.9),
    "truck": template(18000.0, 4.8),
    "sport": template(1300.0, 2.5, "sport"),
    "model car": template(3.0, 0.33),
}
every_car = pytest.mark.parametrize("car", CARS)
FULL_SIZE = [name for name, chassis in CARS.items() if chassis.mass > LIGHT]


def only(chassis: ChassisParameters, steering: SteeringParameters = PLAIN) -> str:
    """Return the only warning."""
    (sentence,) = vehicle_warnings(chassis, steering)
    return sentence


@every_car
def test_no_real_car_is_reported(car: str) -> None:
    assert vehicle_warnings(CARS[car], PLAIN) == []


@pytest.mark.parametrize("name", shipped("vehicles"))
def test_no_shipped_file_is_reported(name: str) -> None:
    assert file_warnings(find("vehicles", name)) == []


@pytest.mark.parametrize("car", FULL_SIZE)  # below the least stiffness for the model car
def test_stiffness_per_degree_is_recognised_with_the_right_value(car: str) -> None:
    chassis = CARS[car]
    front, rear = chassis.front_cornering_stiffness, chassis.rear_cornering_stiffness
    wrong = replace(
        chassis,
        front_cornering_stiffness=math.radians(front),
        rear_cornering_stiffness=math.radians(rear),
    )
    for sentence, right in zip(vehicle_warnings(wrong, PLAIN), (front, rear), strict=True):
        assert "is it in N/deg?" in sentence
        assert f"state {right:.6g}" in sentence


@pytest.mark.parametrize("car", [name for name in FULL_SIZE if name != "paper"])
def test_stiffness_of_an_axle_is_recognised(car: str) -> None:
    chassis = CARS[car]
    doubled = replace(
        chassis,
        front_cornering_stiffness=2 * chassis.front_cornering_stiffness,
        rear_cornering_stiffness=2 * chassis.rear_cornering_stiffness,
    )
    assert "both tyres of an axle? Then halve them" in only(doubled)


@every_car
@pytest.mark.parametrize("factor", [0.2, 4.0, 1000.0])
def test_implausible_yaw_inertia_is_recognised(car: str, factor: float) -> None:
    wrong = replace(CARS[car], yaw_inertia=min(factor * CARS[car].yaw_inertia, 1.0e6))
    assert "chassis.yaw_inertia = " in only(wrong)


@pytest.mark.parametrize("car", [name for name in CARS if not name.startswith("CommonRoad")])
def test_an_oversteering_car_is_reported_with_its_critical_speed(car: str) -> None:
    chassis = CARS[car]
    exchanged = replace(
        chassis,
        front_cornering_stiffness=chassis.rear_cornering_stiffness * 1.3,
        rear_cornering_stiffness=chassis.front_cornering_stiffness * 0.75,
    )
    (sentence,) = [s for s in vehicle_warnings(exchanged, PLAIN) if "oversteers" in s]
    critical = math.sqrt(-exchanged.wheelbase / exchanged.understeer_gradient)
    assert f"unstable above {critical:.3g} m/s" in sentence


@pytest.mark.parametrize("car", FULL_SIZE)
def test_limits_of_a_steering_wheel_are_recognised(car: str) -> None:
    for rate in (3.0, 11.2, 16.0):
        assert "steering.max_rate = " in only(CARS[car], replace(PLAIN, max_rate=rate))
    assert "steering.max_angle = 1.4 rad" in only(CARS[car], replace(PLAIN, max_angle=1.4))
    assert vehicle_warnings(CARS[car], replace(PLAIN, max_rate=math.inf)) == []


@every_car
def test_mass_in_tonnes_or_grams_is_recognised(car: str) -> None:
    chassis = CARS[car]
    masses = [factor * chassis.mass for factor in (1e-3, 20.0, 1000.0)]
    for mass in (each for each in masses if 1.0 <= each <= 1.0e5):
        sentences = vehicle_warnings(replace(chassis, mass=mass), PLAIN)
        assert any(sentence.startswith("chassis.mass = ") for sentence in sentences)


@every_car
def test_a_centre_of_gravity_near_an_axle_is_recognised(car: str) -> None:
    chassis, L = CARS[car], CARS[car].wheelbase
    for share in (0.16, 0.84):
        wrong = replace(chassis, cg_to_front_axle=(1 - share) * L, cg_to_rear_axle=share * L)
        sentences = vehicle_warnings(wrong, PLAIN)
        assert any(f"carries {100 * share:.0f} % of the mass" in each for each in sentences)


REMEDIES: dict[str, dict[str, Any]] = {
    "key 'wheelbase'; known are .*; it is cg_to_front_axle \\+ cg_to_rear_axle, which .*new_car": {
        "chassis": {"wheelbase": 2.7}
    },
    "unknown key 'track'; .*; 'track' is a key of the section 'body'": {"chassis": {"track": 1.5}},
    "unknown key 'ratio'; .*; 'ratio' is a key of the section 'steering'": {
        "chassis": {"ratio": 15.0}
    },
    "unknown key 'yaw_inertai'; .*; did you mean 'yaw_inertia'": {"chassis": {"yaw_inertai": 1.0}},
    "unknown section 'stering'; .*; did you mean 'steering'": {"stering": {"max_angle": 1.0}},
    r"max_angle = 8.2 must lie in \[0, 1.5\] rad; it is a road-wheel angle: that of the": {
        "steering": {"max_angle": 8.2}
    },
    "same_as = .* shipped vehicles: .*ordinary, paper; did you mean 'ordinary'": {
        "same_as": "ordinray"
    },
}


@pytest.mark.parametrize("complaint", REMEDIES)
def test_a_misplaced_or_misspelt_word_is_refused_with_the_right_one(
    complaint: str, tmp_path: Path
) -> None:
    file = tmp_path / "my.yaml"
    content = {"same_as": "ordinary", **REMEDIES[complaint]}
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(ValueError, match=complaint) as error:
        file_warnings(file)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["ordinray", "Ordinary", "papr", "ordinary.yml"])
def test_a_misspelt_shipped_name_is_refused_with_the_nearest_one(name: str) -> None:
    nearest = "paper" if name == "papr" else "ordinary"
    with pytest.raises(ValueError, match=f"ordinary, paper; did you mean '{nearest}'"):
        find("vehicles", name)
