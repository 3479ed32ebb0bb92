"""Configurations as values and as YAML: exact there and back; errors name place, key and value."""

from itertools import cycle, product
from typing import Any

import pytest
import yaml

from ampc_msgs_config import __version__
from ampc_msgs_config.config import find, shipped
from ampc_ros.configuration import (
    CLASSIC_SPEED,
    CONTROLLERS,
    DEFAULT_TABLES,
    Choices,
    configuration,
    default_table,
    from_yaml,
    gain_file,
    to_yaml,
)
from ampc_ros.controller import build_controller

WHERE = "/controller/configuration"


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("vehicle", sorted(shipped("vehicles")))
def test_every_shipped_file_goes_through_yaml_number_for_number(name: str, vehicle: str) -> None:
    tables = [table for table in shipped("gains") if table.startswith("preview")]
    if name != "preview":
        tables = ["table3", "paper_pso"] if name in DEFAULT_TABLES else [""]
    guards = cycle(sorted(shipped("guards")))
    rest = list(product(sorted(shipped("controllers")), ["", *tables]))
    rest = rest if vehicle in ("ordinary", "paper") else rest[:1]  # what varies is the vehicle
    for number, ((limits, table), guard) in enumerate(zip(rest, guards, strict=False)):
        config = configuration(Choices(name, vehicle, limits, table, guard, None, True, False))
        again, counted = from_yaml(to_yaml(config, number), WHERE)
        assert again == config
        assert counted == number


def test_yaml_tells_the_version_first() -> None:
    content = yaml.safe_load(to_yaml(configuration(Choices()), 3))
    assert list(content)[:2] == ["version", "number"]
    assert content["version"] == __version__


@pytest.mark.parametrize("name", CONTROLLERS)
def test_controller_of_what_was_read_back_can_be_built(name: str) -> None:
    config, _ = from_yaml(to_yaml(configuration(Choices(name)), 1), WHERE)
    assert build_controller(config).period == config.settings.sample_time


WRONG: list[tuple[tuple[str, ...], Any, str]] = [
    (("controller",), "lqr", "controller = 'lqr' must be one of preview, paper"),
    (("controller",), ["preview"], r"controller = \['preview'\] must be text"),
    (("chassis", "mass"), -1.0, r"chassis.mass = -1.0 must lie in \[1, 100000\] kg"),
    (("chassis", "colour"), 1.0, "chassis: unknown key 'colour'"),
    (("chassis",), 3, "chassis = 3 must be a mapping of keys"),
    (("settings", "solver"), "magic", "settings.solver = 'magic' must be one of"),
    (
        ("settings", "state_late"),
        "1:30",
        "settings.state_late = '1:30' must be a number",
    ),
    (("steering", "lag"), 9.0, "steering.lag = 9.0 must lie in"),
    (("guard", "speed"), [0.0, 0.0], "guard.max_angle = "),
    (("gains",), [1.0], r"gains = \[1.0\] must be a mapping of keys"),
    (("gains", "speed"), [], "gains.speed = "),
    (("gains", "gains"), [{}], r"gains.gains\[0\]: missing key 'prediction_horizon'"),
    (("base_link_to_cg",), "far", "base_link_to_cg = 'far' must be a number"),
    (("base_link_to_cg",), float("nan"), r"base_link_to_cg = nan must lie in \[-20, 20\] m"),
    (("base_link_to_cg",), True, "base_link_to_cg = True must be a number"),
    (("static_path",), "yes", "static_path = 'yes' must be true or false"),
    (("simulated_time",), 1, "simulated_time = 1 must be true or false"),
    (("number",), "one", "number = 'one' must be a whole number"),
    (("number",), 1.5, "number = 1.5 must be a whole number"),
]


@pytest.mark.parametrize(("keys", "value", "message"), WRONG)
def test_wrong_values_are_refused_with_place_key_and_value(
    keys: tuple[str, ...], value: object, message: str
) -> None:
    content = yaml.safe_load(to_yaml(configuration(Choices()), 1))
    place = content
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    with pytest.raises(ValueError, match=f"^{WHERE}: {message}"):
        from_yaml(yaml.safe_dump(content), WHERE)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  mass: 1575.0", "  mass: 1575.0\n  mass: 1600.0", "chassis.mass = 1600.0 in line"),
        ("  mass: 1575.0", "  mass: 1:30", "chassis.mass = '1:30' must be a number in"),
        ("  mass: 1575.0", "  mass: 0017", "chassis.mass = '0017' must be a number in"),
        ("  mass: 1575.0", "  mass: 1_0", "chassis.mass = '1_0' must be a number in"),
        ("  mass: 1575.0", f"  mass: 1{'0' * 400}", "chassis.mass = a whole number of 401 digits"),
        ("  mass: 1575.0", "  mass: yes", "chassis.mass = 'yes' must be a number in"),
        ("static_path: false", "static_path: no", "static_path = 'no' must be true or false"),
    ],
)
def test_text_of_a_bag_is_read_as_strictly_as_a_file(old: str, new: str, message: str) -> None:
    text = to_yaml(configuration(Choices()), 1)
    assert old in text
    with pytest.raises(ValueError, match=f"^{WHERE}: {message}"):
        from_yaml(text.replace(old, new), WHERE)


@pytest.mark.parametrize("key", ["number", "controller", "gains", "guard", "simulated_time"])
def test_missing_key_is_named(key: str) -> None:
    content = yaml.safe_load(to_yaml(configuration(Choices()), 1))
    del content[key]
    with pytest.raises(ValueError, match=f"^{WHERE}: missing key '{key}'"):
        from_yaml(yaml.safe_dump(content), WHERE)


@pytest.mark.parametrize("text", ["", "3", "- 1", "{", "!!python/object:os.system {}"])
def test_what_is_no_mapping_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=f"^{WHERE}: "):
        from_yaml(text, WHERE)


def test_default_table_is_the_one_tuned_for_the_car() -> None:
    assert default_table("preview", "paper") == "preview_paper"
    assert default_table("preview", "ordinary") == "preview_ordinary"
    assert default_table("preview", "my_car.yaml") == "preview"
    assert default_table("paper", "paper") == "table3"
    assert gain_file(Choices("pure_pursuit")) is None
    assert gain_file(Choices(gain_table="table3")) == find("gains", "table3")


def test_classic_controller_has_a_nominal_speed_and_the_others_have_none() -> None:
    speeds = {name: configuration(Choices(name)).settings.nominal_speed for name in CONTROLLERS}
    assert speeds.pop("classic") == CLASSIC_SPEED
    assert set(speeds.values()) == {0.0}


def test_unknown_names_are_refused() -> None:
    for wrong in (
        Choices("lqr"),
        Choices(vehicle="bike"),
        Choices(settings="fast"),
        Choices(guard="none"),
        Choices(gain_table="best"),
    ):
        with pytest.raises(ValueError, match=r"must be one of|neither a file nor one of"):
            configuration(wrong)
