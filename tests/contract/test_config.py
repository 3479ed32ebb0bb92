"""YAML <-> dataclass: shipped files load, and bad ones are refused by file, key, value, bound."""

import math
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import MAX_BYTES, build, find, load, read, shipped
from ampc_msgs_config.parameters import (
    ChassisParameters,
    Checked,
    ControllerSettings,
    SizeParameters,
    SteeringParameters,
    choice,
    number,
)

PAPER = {
    "mass": 1575.0,
    "yaw_inertia": 2875.0,
    "cg_to_front_axle": 1.2,
    "cg_to_rear_axle": 1.6,
    "front_cornering_stiffness": 19000.0,
    "rear_cornering_stiffness": 33000.0,
}


@dataclass(frozen=True, kw_only=True)
class Sample(Checked):
    """One field of each kind."""

    length: float = number(0.0, 10.0, "m")
    limit: float = number(0.0, math.inf, "m", math.inf)
    kind: str = choice("round", "square", default="round")


@pytest.mark.parametrize("name", sorted(shipped("vehicles")))
@pytest.mark.parametrize(
    ("section", "cls"),
    [("chassis", ChassisParameters), ("steering", SteeringParameters), ("size", SizeParameters)],
)
def test_sections_of_shipped_vehicles_load(name: str, section: str, cls: type[Checked]) -> None:
    assert load(cls, find("vehicles", name), section)


def test_vehicle_of_the_paper_is_that_of_table_3() -> None:
    chassis = load(ChassisParameters, find("vehicles", "paper"), "chassis")
    assert astuple(chassis) == tuple(PAPER.values())
    steering = load(SteeringParameters, find("vehicles", "paper"), "steering")
    assert steering.max_angle == pytest.approx(math.pi / 6)
    assert (steering.max_rate, steering.lag, steering.delay) == (math.inf, 0.0, 0.0)


def test_characteristic_speed_of_the_paper_s_car_is_14_4_metres_per_second() -> None:
    chassis = load(ChassisParameters, find("vehicles", "paper"), "chassis")
    speed = math.sqrt(chassis.wheelbase / chassis.understeer_gradient)
    assert speed == pytest.approx(14.4, abs=0.05)


@pytest.mark.parametrize("name", sorted(shipped("controllers")))
def test_shipped_settings_load(name: str) -> None:
    assert load(ControllerSettings, find("controllers", name))


def test_settings_of_table_3_are_the_defaults() -> None:
    settings_file = load(ControllerSettings, find("controllers", "table3"))
    assert astuple(settings_file) == pytest.approx(astuple(ControllerSettings()))
    assert settings_file.max_increment == pytest.approx(math.pi / 12)
    assert settings_file.max_angle == pytest.approx(math.pi / 6)


def test_written_parameters_read_back(tmp_path: Path) -> None:
    file = tmp_path / "car.yaml"
    file.write_text(yaml.safe_dump({"chassis": PAPER}), encoding="utf-8")
    assert load(ChassisParameters, file, "chassis") == ChassisParameters(**PAPER)


def test_missing_keys_take_their_defaults_and_whole_numbers_become_floats() -> None:
    sample = build(Sample, {"length": 3}, "sample.yaml")
    assert sample == Sample(length=3.0, limit=math.inf, kind="round")
    assert isinstance(sample.length, float)


def test_parameters_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        Sample(length=1.0).length = 2.0  # type: ignore[misc]


BAD: dict[str, Any] = {
    r"missing key 'length'": {},
    r"unknown key 'lenght'; known are length, limit, kind": {"lenght": 1.0},
    r"unknown key 3; known are": {3: 1.0},
    r"length = -0.1 must lie in \[0, 10\] m": {"length": -0.1},
    r"length = 10.1 must lie in \[0, 10\] m": {"length": 10.1},
    r"length = nan must lie in": {"length": math.nan},
    r"length = inf must lie in": {"length": math.inf},
    r"length = '1e-3' must be a number \(YAML needs a point in the mantissa": {"length": "1e-3"},
    r"length = True must be a number": {"length": True},
    r"length = None must be a number": {"length": None},
    r"length = \[1.0\] must be a number": {"length": [1.0]},
    r"limit = -1.0 must lie in \[0, inf\] m": {"length": 1.0, "limit": -1},
    r"kind = 'oval' must be one of round, square": {"length": 1.0, "kind": "oval"},
    r"kind = \['round'\] must be one of round, square": {"length": 1.0, "kind": ["round"]},
    r"must be a mapping of keys, not \[1\]": [1],
    r"must be a mapping of keys, not None": None,
    r"too large": {"length": 10**400},
}


@pytest.mark.parametrize("complaint", BAD)
def test_bad_content_is_refused_with_place_key_value_and_bound(complaint: str) -> None:
    with pytest.raises(ValueError, match=f"sample.yaml: part: .*{complaint}"):
        build(Sample, BAD[complaint], "sample.yaml: part")


TEXTS: dict[str, str | bytes] = {
    "not YAML: ": "a: [1, 2",
    "must hold a mapping of keys, not list": "[1, 2]",
    "must hold a mapping of keys, not NoneType": "",
    "must hold a mapping of keys, not str": "just words",
    "cannot be read": b"\xff\xfe\x80",
    "not YAML: .*recursion": "[" * 5000,
    "not YAML: .*could not determine a constructor": "a: !!python/object/apply:os.getcwd []",
    r"\d+ bytes are more than": b" " * (MAX_BYTES + 1),
    "not YAML: more than 5000000 values, with aliases replaced": "\n".join(
        [
            "a0: &a0 [1, 2]",
            *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 40)),
        ]
    ),
    "not YAML: more than 5000000 values": "\n".join(
        ["a0: &a0 {b: 1}", *(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}" for i in range(1, 40))]
    ),
    "not YAML: an alias names what it is part of": "part: &a {length: *a}",
    "not YAML: month must be in": "part: 2026-99-01",
    "not YAML: Exceeds the limit": f"part: {'9' * 5000}",
    "missing section 'part'": "other: {length: 1.0}",
    "part: missing key 'length'": "part: {}",
}


@pytest.mark.parametrize("complaint", TEXTS)
def test_bad_file_is_refused_in_one_line_with_its_name(complaint: str, tmp_path: Path) -> None:
    file, text = tmp_path / "sample.yaml", TEXTS[complaint]
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=f"sample.yaml: {complaint}") as error:
        load(Sample, file, "part")
    assert "\n" not in str(error.value)


def test_a_device_that_never_ends_is_refused() -> None:
    with pytest.raises(ValueError, match=r"/dev/zero: cannot be read: no regular file"):
        read(Path("/dev/zero"))


def test_aliases_within_reason_are_read(tmp_path: Path) -> None:
    file = tmp_path / "sample.yaml"
    file.write_text("base: &base {length: 1.0}\npart: {<<: *base, kind: square}", encoding="utf-8")
    assert load(Sample, file, "part") == Sample(length=1.0, kind="square")


def test_missing_file_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none.yaml: cannot be read"):
        read(tmp_path / "none.yaml")


def test_unknown_name_lists_the_shipped_ones() -> None:
    with pytest.raises(ValueError, match=r"'papr' is neither a file nor .* vehicles: .*paper"):
        find("vehicles", "papr")


def test_own_file_is_found_and_shipped_names_win(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text("a: 1\n", encoding="utf-8")
    assert find("vehicles", str(own)) == own
    assert find("vehicles", "paper").name == "paper.yaml"
    assert read(own) == {"a": 1}


@settings(max_examples=200, deadline=None, derandomize=True)
@given(value=st.floats(allow_nan=True))
def test_a_value_is_taken_exactly_if_it_lies_in_its_range(value: float) -> None:
    if 0.0 <= value <= 10.0:
        assert Sample(length=value).length == value
    else:
        with pytest.raises(ValueError, match=r"length = .* must lie in \[0, 10\] m"):
            Sample(length=value)


@pytest.mark.parametrize(
    "cls", [ChassisParameters, SteeringParameters, ControllerSettings, SizeParameters]
)
def test_every_number_has_a_range_and_a_unit(cls: type[Checked]) -> None:
    for item in fields(cls):
        assert "options" in item.metadata or {"low", "high", "unit"} <= set(item.metadata)
