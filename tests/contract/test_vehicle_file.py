"""Vehicle files: inheritance, sections that a program needs, marks of estimated values."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from ampc_msgs_config.config import find, read, shipped
from ampc_msgs_config.parameters import ChassisParameters, SizeParameters, SteeringParameters
from ampc_msgs_config.vehicle_file import SECTIONS, VehicleContent, load_section, read_vehicle
from ampc_ros import load_vehicle
from ampc_ros.configuration import Choices, configuration
from launch_scripts.tuning.task import sha256
from sim_vehicle.parameters import Vehicle, load_vehicle_file

HEAVY = {"same_as": "ordinary", "chassis": {"mass": 1900.0}}


def write(file: Path, content: dict[str, Any]) -> Path:
    file.parent.mkdir(exist_ok=True)
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return file


def test_sections_are_those_of_the_simulated_car() -> None:
    assert Vehicle._fields == SECTIONS


@pytest.mark.parametrize("name", shipped("vehicles"))
def test_a_file_that_states_nothing_is_the_car_that_it_inherits_from(
    name: str, tmp_path: Path
) -> None:
    file = write(tmp_path / "same.yaml", {"same_as": name})
    assert load_vehicle_file(file) == load_vehicle_file(find("vehicles", name))
    assert configuration(Choices(vehicle=str(file), gain_table="preview")) == configuration(
        Choices(vehicle=name, gain_table="preview")
    )
    assert load_vehicle(str(file))[1:] == load_vehicle(name)[1:]


def test_stated_keys_replace_inherited_ones_along_a_chain(tmp_path: Path) -> None:
    write(tmp_path / "heavy.yaml", HEAVY)
    tow = {"same_as": "../heavy.yaml", "chassis": {"yaw_inertia": 4000.0}, "tyre": {"shape": 1.3}}
    car = load_vehicle_file(write(tmp_path / "tow" / "tow.yaml", tow))
    ordinary = load_vehicle_file(find("vehicles", "ordinary"))
    assert (car.chassis.mass, car.chassis.yaw_inertia, car.tyre.shape) == (1900.0, 4000.0, 1.3)
    assert car.chassis.front_cornering_stiffness == ordinary.chassis.front_cornering_stiffness
    assert car.tyre.friction == ordinary.tyre.friction
    assert car[4:] == ordinary[4:]


@given(st.sets(st.sampled_from(SECTIONS)), st.sets(st.sampled_from(SECTIONS)))
def test_every_section_comes_from_the_nearest_file_that_states_it(
    tmp_path_factory: pytest.TempPathFactory, child: set[str], parent: set[str]
) -> None:
    folder = tmp_path_factory.mktemp("cars")
    paper, ordinary = (read(find("vehicles", name)) for name in ("paper", "ordinary"))
    write(folder / "parent.yaml", {key: paper[key] for key in parent})
    own = {key: ordinary[key] for key in child}
    merged = read_vehicle(write(folder / "child.yaml", {"same_as": "parent.yaml", **own}))
    for key in SECTIONS:
        nearest = ordinary if key in child else paper if key in parent else {}
        stated = {**(paper[key] if key in parent else {}), **nearest.get(key, {})}
        assert merged.sections.get(key, {}) == stated


def test_a_cycle_is_refused_with_the_names(tmp_path: Path) -> None:
    for name, parent in (("a", "b"), ("b", "c"), ("c", "a")):
        write(tmp_path / f"{name}.yaml", {"same_as": f"{parent}.yaml"})
    with pytest.raises(ValueError, match=r"a\.yaml -> .*b\.yaml -> .*c\.yaml -> .*a\.yaml"):
        read_vehicle(tmp_path / "a.yaml")
    with pytest.raises(ValueError, match=r"d\.yaml: same_as is a cycle: .*d\.yaml -> .*d\.yaml"):
        read_vehicle(write(tmp_path / "d.yaml", {"same_as": "d.yaml"}))


WRONG: dict[str, dict[str, Any]] = {
    r"same_as: '.*nowhere' is neither a file nor one of the shipped": {"same_as": "nowhere"},
    r"same_as = 3 must be a shipped vehicle or a file": {"same_as": 3},
    r"unknown section 'stering'; known are same_as, estimated, chassis": {"stering": {}},
    r"chassis = None must be a mapping": {"chassis": None},
    r"estimated = 0.3 must be a mapping": {"estimated": 0.3},
    r"estimated: 'chassis.inertia' is no value of this file": {
        **HEAVY,
        "estimated": {"chassis.inertia": 0.3},
    },
    r"estimated: 'mass' is no value": {**HEAVY, "estimated": {"mass": 0.3}},
    r"estimated.chassis.mass = -0.1 must lie in \[0, 10\]": {
        **HEAVY,
        "estimated": {"chassis.mass": -0.1},
    },
    r"estimated.steering.delay = '30 ms' must be a number": {
        **HEAVY,
        "estimated": {"steering.delay": "30 ms"},
    },
}


@pytest.mark.parametrize("complaint", WRONG)
def test_wrong_file_is_refused_by_name_and_key(complaint: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=rf"my\.yaml: {complaint}"):
        read_vehicle(write(tmp_path / "my.yaml", WRONG[complaint]))


def test_an_inherited_wrong_value_is_refused_with_both_files(tmp_path: Path) -> None:
    write(tmp_path / "wrong.yaml", {"same_as": "paper", "chassis": {"mass": -1.0}})
    file = write(tmp_path / "heir.yaml", {"same_as": "wrong.yaml"})
    with pytest.raises(ValueError, match=r"heir\.yaml \(.*wrong\.yaml.*\): chassis\.mass = -1"):
        load_vehicle_file(file)


def test_estimates_are_inherited_until_a_file_states_the_value(tmp_path: Path) -> None:
    parent = HEAVY | {"estimated": {"chassis.mass": 0.1, "chassis.yaw_inertia": 0.3}}
    write(tmp_path / "parent.yaml", parent)
    child = {
        "same_as": "parent.yaml",
        "chassis": {"mass": 1850.0, "cg_to_front_axle": 1.3},
        "estimated": {"chassis.cg_to_front_axle": 0.1, "steering.delay": 0.05},
    }
    merged = read_vehicle(write(tmp_path / "child.yaml", child))
    assert merged.estimated == {
        "chassis.yaw_inertia": 0.3,
        "chassis.cg_to_front_axle": 0.1,
        "steering.delay": 0.05,
    }


def test_a_program_requires_only_the_sections_that_it_uses(tmp_path: Path) -> None:
    content = read(find("vehicles", "ordinary"))
    file = write(tmp_path / "my.yaml", {key: content[key] for key in ("chassis", "steering")})
    assert configuration(Choices(vehicle=str(file))).chassis.mass == 1500.0
    assert load_vehicle(str(file)).chassis.mass == 1500.0
    said = (
        r"my\.yaml: missing section 'size', which the simulated car needs: .*same_as.*new_car\.py"
    )
    with pytest.raises(ValueError, match=said):
        load_vehicle_file(file)
    with pytest.raises(ValueError, match=r"missing section 'size', which the planner needs"):
        load_section(SizeParameters, file, "size", "the planner")
    file = write(tmp_path / "my.yaml", {"chassis": content["chassis"]})
    with pytest.raises(ValueError, match=r"missing section 'steering', which the controller needs"):
        configuration(Choices(vehicle=str(file)))


def test_the_digest_is_that_of_all_files(tmp_path: Path) -> None:
    ordinary, file = find("vehicles", "ordinary"), write(tmp_path / "heavy.yaml", HEAVY)
    assert read_vehicle(ordinary).digest == sha256(ordinary.read_bytes())
    assert read_vehicle(file).digest == sha256(file.read_bytes() + ordinary.read_bytes())


def test_an_empty_content_has_no_section() -> None:
    content = VehicleContent((Path("my.yaml"),), {}, {})
    for cls, name in ((ChassisParameters, "chassis"), (SteeringParameters, "steering")):
        with pytest.raises(ValueError, match=f"my.yaml: missing section '{name}'"):
            content.section(cls, name, "the test")
