"""Vehicle templates: valid files, published vehicles within the spreads, drives, errors."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find
from ampc_msgs_config.parameters import GRAVITY, ChassisParameters
from ampc_msgs_config.vehicle_file import load_section, read_vehicle
from ampc_ros import load_vehicle
from launch_scripts.new_car import main
from launch_scripts.templates.vehicle_rules import TYPES, DataSheet, type_of, vehicle_template
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from tests.workshop.acceptance.independent_plant import assumed_parameters
from tests.workshop.acceptance.templates import bound_of, drawn_sheet, drive_template

SEVERAL = 6
"""Drives of each type; `tests/workshop/acceptance/templates.py` drives more."""


class Known(NamedTuple):
    """A published vehicle."""

    kind: str
    chassis: ChassisParameters
    outside: tuple[str, ...] = ()
    """Values outside the spread of the template, for a reason."""


def published(name: str) -> ChassisParameters:
    return load_section(ChassisParameters, find("vehicles", name), "chassis")


def bus(mass: float) -> ChassisParameters:
    """O 305: Ackermann et al., "Robust control", 1993; stiffness of an axle is twice a tyre's."""
    return ChassisParameters(
        mass=mass,
        yaw_inertia=10.85 * mass,
        cg_to_front_axle=3.67,
        cg_to_rear_axle=1.93,
        front_cornering_stiffness=198000.0 / 2,
        rear_cornering_stiffness=470000.0 / 2,
    )


F1TENTH_LOAD = 0.5 * 3.74 * GRAVITY / 0.3302
KNOWN = {
    "ordinary.yaml": Known("passenger", published("ordinary")),
    # Table 3 of the paper has front tyres of a third of the usual stiffness, rear ones of half.
    "paper.yaml": Known("passenger", published("paper"), ("front_cornering_stiffness",)),
    "CommonRoad 1, Ford Escort": Known("passenger", assumed_parameters(1)[0]),
    "CommonRoad 2, BMW 320i": Known("passenger", assumed_parameters(2)[0]),
    "CommonRoad 3, VW Vanagon": Known("passenger", assumed_parameters(3)[0]),
    # Rajamani, "Vehicle dynamics and control"
    "Rajamani": Known(
        "passenger",
        ChassisParameters(
            mass=1573.0,
            yaw_inertia=2873.0,
            cg_to_front_axle=1.1,
            cg_to_rear_axle=1.58,
            front_cornering_stiffness=80000.0,
            rear_cornering_stiffness=80000.0,
        ),
    ),
    "O 305, empty": Known("bus", bus(9950.0)),
    "O 305, loaded": Known("bus", bus(16000.0)),
    # mu C_S times the load: f1tenth_gym
    "F1TENTH": Known(
        "model_car",
        ChassisParameters(
            mass=3.74,
            yaw_inertia=0.04712,
            cg_to_front_axle=0.15875,
            cg_to_rear_axle=0.17145,
            front_cornering_stiffness=1.0489 * 4.718 * F1TENTH_LOAD * 0.17145,
            rear_cornering_stiffness=1.0489 * 5.4562 * F1TENTH_LOAD * 0.15875,
        ),
    ),
}
COMPARED = ("yaw_inertia", "front_cornering_stiffness", "rear_cornering_stiffness")


@pytest.mark.parametrize("name", KNOWN)
def test_a_published_vehicle_lies_within_the_spread_of_its_template(name: str) -> None:
    kind, known, outside = KNOWN[name]
    share = known.cg_to_rear_axle / known.wheelbase
    sheet = DataSheet(mass=known.mass, wheelbase=known.wheelbase, front_share=share)
    template = vehicle_template(sheet, kind)
    for key in COMPARED:
        ratio = getattr(known, key) / template.sections["chassis"][key]
        spread = template.estimated[f"chassis.{key}"]
        print(f"{name}: {key} {ratio:.2f} of the template, spread {spread:g}")
        assert (abs(ratio - 1.0) <= spread) == (key not in outside), key


def write(file: Path, *options: str) -> Vehicle:
    assert main([*options, "--output", str(file)]) == 0
    return load_vehicle_file(file)


def test_the_file_is_complete_and_marks_what_is_estimated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my car.yaml"
    vehicle = write(file, "--mass", "2100", "--wheelbase", "2.85")
    said = capsys.readouterr().out
    assert "warning" not in said
    assert "estimated, +-25 %" in said
    assert f"start.py --vehicle '{file}'" in said
    assert vehicle.chassis.mass == 2100.0
    assert vehicle.chassis.wheelbase == pytest.approx(2.85, abs=1e-12)
    assert not vehicle.steering.is_lag_configured
    estimated = read_vehicle(file).estimated
    assert estimated["chassis.yaw_inertia"] == 0.25
    assert "chassis.mass" not in estimated
    assert "chassis.cg_to_front_axle" in estimated
    assert load_vehicle(str(file)).chassis == vehicle.chassis


def test_what_the_data_sheet_states_is_not_estimated(tmp_path: Path) -> None:
    options = "--mass 1300 --wheelbase 2.5 --front-share 0.45 --width 1.9 --steering-ratio 14"
    file = tmp_path / "sport.yaml"
    vehicle = write(file, *options.split(), "--type", "sport")
    estimated = read_vehicle(file).estimated
    assert not {"chassis.cg_to_front_axle", "chassis.cg_to_rear_axle", "size.width"} & {*estimated}
    assert vehicle.chassis.cg_to_rear_axle == pytest.approx(0.45 * 2.5)
    assert (vehicle.size.width, vehicle.steering.ratio) == (1.9, 14.0)
    assert vehicle.steering.max_rate == pytest.approx(math.radians(640.0) / 14.0, rel=1e-3)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(list(TYPES)), st.integers(0, 10**6))
def test_every_template_understeers_mildly(kind: str, seed: int) -> None:
    sheet = drawn_sheet(kind, np.random.default_rng(seed))
    template = vehicle_template(sheet, kind)
    chassis = ChassisParameters(**template.sections["chassis"])
    per_g = math.degrees(chassis.understeer_gradient * GRAVITY)
    assert 0.3 < per_g < 3.5
    index = chassis.yaw_inertia / (sheet.mass * chassis.cg_to_front_axle * chassis.cg_to_rear_axle)
    assert 0.6 < index < 2.2
    assert chassis.wheelbase == pytest.approx(sheet.wheelbase, abs=1e-6)


@pytest.mark.parametrize("kind", TYPES)
def test_templates_drive_with_the_default_gains(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(15)
    for _ in range(SEVERAL):
        driven = drive_template(kind, rng, tmp_path)
        assert driven.error <= bound_of(kind), driven
        assert driven.warnings == []


@pytest.mark.parametrize(
    ("mass", "wheelbase", "kind"),
    [
        *((3.0, 0.33, "model_car"), (25.0, 0.65, "model_car"), (950.0, 2.3, "passenger")),
        *((2900.0, 3.1, "passenger"), (7500.0, 3.9, "truck"), (18000.0, 4.8, "truck")),
        *((18000.0, 6.0, "bus"), (12000.0, 5.85, "bus")),
    ],
)
def test_mass_and_wheelbase_select_the_type(mass: float, wheelbase: float, kind: str) -> None:
    assert type_of(mass, wheelbase) == kind
    assert vehicle_template(DataSheet(mass=mass, wheelbase=wheelbase)).type == kind


WRONG = {
    "mass = -3.0 must lie in [1, 30000] kg": "--mass -3 --wheelbase 2.8",
    "mass = nan must": "--mass nan --wheelbase 2.8",
    "wheelbase = 2850.0 must lie in [0.15, 9] m": "--mass 1500 --wheelbase 2850",
    "mass = 2100.0 must lie in [1, 6.75] for the type model_car with a wheelbase of 0.3 m": (
        "--mass 2100 --wheelbase 0.3"
    ),
    "mass = 1.5 must lie in": "--mass 1.5 --wheelbase 2.7",
    "wheelbase = 2.7 must lie in [3, 8.5] for the type bus": (
        "--mass 9000 --wheelbase 2.7 --type bus"
    ),
    "front_share = 55.0 must lie in [0.1, 0.9]": "--mass 1500 --wheelbase 2.7 --front-share 55",
    "front_share = 0.8 must lie in [0.35, 0.7] for the type passenger": (
        "--mass 1500 --wheelbase 2.7 --front-share 0.8"
    ),
    "width = 0.7 must lie in [0.9, 2.3] for the type passenger": (
        "--mass 1500 --wheelbase 2.7 --width 0.7"
    ),
    "steering_ratio = 0.0 must lie in": "--mass 1500 --wheelbase 2.7 --steering-ratio 0",
}


@pytest.mark.parametrize("complaint", WRONG)
def test_an_impossible_data_sheet_is_refused_in_one_line(
    complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my.yaml"
    assert main([*WRONG[complaint].split(), "--output", str(file)]) == 2
    said = capsys.readouterr().out
    assert said.startswith(f"error: {complaint}")
    assert said.count("\n") == 1
    assert not file.exists()


def test_an_existing_file_is_overwritten_only_by_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, options = tmp_path / "my.yaml", ["--mass", "1500", "--wheelbase", "2.7"]
    file.write_text("mine", encoding="utf-8")
    assert main([*options, "--output", str(file)]) == 2
    assert "exists; --force overwrites it" in capsys.readouterr().out
    assert file.read_text(encoding="utf-8") == "mine"
    write(file, *options, "--force")
    assert main([*options, "--output", str(tmp_path / "none" / "my.yaml")]) == 2
