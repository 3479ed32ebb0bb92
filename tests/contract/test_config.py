"""Configuration layer: shipped files load, bad ones are rejected with file, key, value, bound."""

import math
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config import strict_yaml
from ampc_msgs_config.config import MAX_YAML_BYTES, build, dump, find, load, parse, read, shipped
from ampc_msgs_config.parameters import (
    ChassisParameters,
    ControllerSettings,
    SizeParameters,
    SteeringParameters,
)
from ampc_msgs_config.validation import Checked, check_range, choice, hints, number, unwrap
from ampc_msgs_config.vehicle_file import load_section

PAPER = {
    "mass": 1575.0,
    "yaw_inertia": 2875.0,
    "cg_to_front_axle": 1.2,
    "cg_to_rear_axle": 1.6,
    "front_cornering_stiffness": 19000.0,
    "rear_cornering_stiffness": 33000.0,
}


@dataclass(frozen=True, kw_only=True)
class Part(Checked):
    """Nested record with a renamed key."""

    RENAMED = {"mass": "weight"}  # noqa: RUF012

    weight: Annotated[float, number(0.0, 5.0, "kg")] = 1.0


@dataclass(frozen=True, kw_only=True)
class Sample(Checked):
    """One field of each kind."""

    length: Annotated[float, number(0.0, 10.0, "m")]
    limit: Annotated[float, number(0.0, math.inf, "m")] = math.inf
    kind: Annotated[str, choice(("round", "square"))] = "round"
    ready: bool = True
    count: Annotated[int, number(0, 9)] = 0
    row: tuple[Annotated[float, number(0.0, 1.0, "s")], ...] = ()
    parts: tuple[Part, ...] = ()


class Document(NamedTuple):
    """File of one section."""

    part: Sample


@pytest.mark.parametrize("name", sorted(shipped("vehicles")))
@pytest.mark.parametrize(
    ("section", "cls"),
    [("chassis", ChassisParameters), ("steering", SteeringParameters), ("size", SizeParameters)],
)
def test_sections_of_shipped_vehicles_load(name: str, section: str, cls: type[Checked]) -> None:
    assert load_section(cls, find("vehicles", name), section)


def test_vehicle_of_the_paper_is_that_of_table_3() -> None:
    chassis = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
    assert astuple(chassis) == tuple(PAPER.values())
    steering = load_section(SteeringParameters, find("vehicles", "paper"), "steering")
    assert steering.max_angle == pytest.approx(math.pi / 6)
    assert (steering.max_rate, steering.lag, steering.delay) == (math.inf, 0.0, 0.0)


def test_characteristic_speed_of_the_paper_s_car_is_14_4_metres_per_second() -> None:
    chassis = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
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
    assert load_section(ChassisParameters, file, "chassis") == ChassisParameters(**PAPER)


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
    r"parts\[1\]: unknown key 'wait'; known are weight": {"length": 1, "parts": [{}, {"wait": 1}]},
    r"parts\[1\]: key 'mass' is now 'weight'": {"length": 1, "parts": [{}, {"mass": 1}]},
    r"parts\[0\].weight = 6 must lie in \[0, 5\] kg": {"length": 1, "parts": [{"weight": 6}]},
    r"parts = 7 must be a list": {"length": 1, "parts": 7},
    r"parts\[0\] = 7 must be a mapping of keys": {"length": 1, "parts": [7]},
    r"row\[1\] = 2 must lie in \[0, 1\] s": {"length": 1, "row": [1, 2]},
    r"row = 2 must be a list of numbers": {"length": 1, "row": 2},
    r"ready = 'yes' must be true or false": {"length": 1, "ready": "yes"},
    r"ready = 1 must be true or false": {"length": 1, "ready": 1},
    r"count = 1.5 must be a whole number in \[0, 9\]": {"length": 1, "count": 1.5},
    r"count = 10 must lie in \[0, 9\]": {"length": 1, "count": 10},
    r"count = True must be a whole number in \[0, 9\]": {"length": 1, "count": True},
    r"unknown key 3; known are": {3: 1.0},
    r"length = -0.1 must lie in \[0, 10\] m": {"length": -0.1},
    r"length = 10.1 must lie in \[0, 10\] m": {"length": 10.1},
    r"length = nan must lie in": {"length": math.nan},
    r"length = inf must lie in": {"length": math.inf},
    r"length = '1e-3' must be a number in \[0, 10\] m": {"length": "1e-3"},
    r"length = True must be a number": {"length": True},
    r"length = None must be a number": {"length": None},
    r"length = \[1.0\] must be a number": {"length": [1.0]},
    r"limit = -1 must lie in \[0, inf\] m": {"length": 1.0, "limit": -1},
    r"kind = 'oval' must be one of round, square": {"length": 1.0, "kind": "oval"},
    r"kind = \['round'\] must be one of round, square": {"length": 1.0, "kind": ["round"]},
    r"must be a mapping of keys, not \[1\]": [1],
    r"must be a mapping of keys, not None": None,
    r"length = a whole number of 401 digits must lie in \[0, 10\] m": {"length": 10**400},
    r"limit = a whole number of 401 digits must lie in \[0, inf\] m": {
        "length": 1,
        "limit": 10**400,
    },
}


@pytest.mark.parametrize("complaint", BAD)
def test_bad_content_is_refused_with_place_key_value_and_bound(complaint: str) -> None:
    with pytest.raises(ValueError, match=f"^sample.yaml: {complaint}"):
        build(Sample, BAD[complaint], "sample.yaml")


NOT_NUMBERS = [
    "0017",
    "1:30",
    "1:30.5",
    "1_0",
    "0x1F",
    "0o17",
    "0b1",
    "yes",
    "No",
    "on",
    "2026-01-01",
]


@pytest.mark.parametrize("text", [*NOT_NUMBERS, "true", "'1'", "~", "[1]"])
def test_what_only_looks_like_a_number_is_refused_with_key_value_and_bound(text: str) -> None:
    with pytest.raises(
        ValueError, match=r"^x.yaml: part.length = .* must be a number in \[0, 10\] m"
    ):
        build(Sample, parse(f"length: {text}", "x.yaml"), "x.yaml", "part")


@pytest.mark.parametrize("text", ["1e-3", "1E-3", "1.0e-3", "+.001", "1.e-3", "0.001"])
def test_numbers_are_read_with_and_without_a_point(text: str) -> None:
    assert parse(f"length: {text}", "x.yaml") == {"length": 0.001}


def test_only_true_and_false_are_booleans_and_infinity_is_a_number() -> None:
    content = parse("{a: true, b: False, c: yes, d: off, e: .inf, f: -7, g: -.INF, h: null}", "x")
    expected = {"a": True, "b": False, "c": "yes", "d": "off", "e": math.inf, "f": -7}
    assert content == {**expected, "g": -math.inf, "h": None}


@pytest.mark.parametrize(
    "text", [*NOT_NUMBERS, "1e-3", "1e3", "true", "null", "plain", "=", "a: b"]
)
def test_text_that_is_written_is_read_back_as_text(text: str) -> None:
    assert parse(dump({"name": text}), "x") == {"name": text}


TWICE = {
    "a: 1\na: 2": "a = 2 in line 2 repeats the key of line 1",
    "{a: 1, a: 2}": "a = 2 in line 1 repeats the key of line 1",
    "a: {b: 1, c: 2}\nd:\n  - b: 1\n    b: [3]": r"d\[0\].b = ... in line 4 repeats",
    "a: &a {b: 1}\nc:\n  <<: *a\n  d: 1\n  <<: *a": "c.<< = ... in line 5 repeats",
}


@pytest.mark.parametrize("text", TWICE)
def test_a_key_that_occurs_twice_is_refused_with_key_value_and_lines(text: str) -> None:
    with pytest.raises(ValueError, match=f"^mine.yaml: {TWICE[text]}"):
        parse(text, "mine.yaml")


@pytest.mark.parametrize("value", [0.0, 9, 9.0])
def test_an_argument_in_its_range_passes(value: float) -> None:
    check_range("--laps", value, number(0, 9))


@pytest.mark.parametrize("value", [-1, 9.5, math.nan, True, "3", None])
def test_an_argument_outside_its_range_is_refused_by_name_and_value(value: object) -> None:
    with pytest.raises(ValueError, match=rf"^--laps = {value!r} must .* \[0, 9\]"):
        check_range("--laps", value, number(0, 9))


TEXTS: dict[str, str | bytes] = {
    "not YAML: ": "a: [1, 2",
    "must hold a mapping of keys, not list": "[1, 2]",
    "must hold a mapping of keys, not NoneType": "",
    "must hold a mapping of keys, not str": "just words",
    "cannot be read": b"\xff\xfe\x80",
    "not YAML: .*recursion": "[" * 5000,
    "not YAML: .*could not determine a constructor": "a: !!python/object/apply:os.getcwd []",
    r"\d+ bytes are more than": b" " * (MAX_YAML_BYTES + 1),
    "more than 5000000 values, with aliases replaced": "\n".join(
        [
            "a0: &a0 [1, 2]",
            *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 40)),
        ]
    ),
    "more than 5000000 values": "\n".join(
        ["a0: &a0 {b: 1}", *(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}" for i in range(1, 40))]
    ),
    "an alias names what it is part of": "part: &a {length: *a}",
    "part = '2026-99-01' must be a mapping of keys": "part: 2026-99-01",
    "not YAML: .*tag 'tag:yaml.org,2002:timestamp'": "part: {length: !!timestamp soon}",
    "not YAML: .*found unhashable key": "part: {[1]: 2}",
    "not YAML: .*expected a single document": "part: {}\n---\npart: {}",
    "not YAML: .*found undefined alias 'a'": "part: *a",
    "not YAML: .*found duplicate anchor 'a'": "part: &a 1\nother: &a 2",
    "not YAML: .*for merging, but found scalar": "part: {<<: 7}",
    "not YAML: .*a mapping for merging, but found sequence": "part: {<<: [[]]}",
    "not YAML: .*tag 'tag:yaml.org,2002:merge'": "part: <<",
    "Exceeds the limit": f"part: {'9' * 5000}",
    "not YAML: '1:30' is not of the type int": "part: {length: !!int 1:30}",
    "not YAML: 'yes' is not of the type bool": "part: {ready: !!bool yes}",
    "not YAML: 1e999 is beyond the range": "part: {length: 1e999}",
    "unknown key 'other'; known are part": "other: {length: 1.0}",
    "part: missing key 'length'": "part: {}",
}


@pytest.mark.parametrize("complaint", TEXTS)
def test_bad_file_is_refused_in_one_line_with_its_name(complaint: str, tmp_path: Path) -> None:
    file, text = tmp_path / "sample.yaml", TEXTS[complaint]
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=f"sample.yaml: {complaint}") as error:
        load(Document, file)
    assert "\n" not in str(error.value)


def read_by(libyaml: bool, text: str) -> str:
    """Return the content of a text, or the message about it, as one of the parsers reads it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(yaml, "__with_libyaml__", libyaml)
        try:
            return repr(parse(text, "x.yaml"))
        except ValueError as error:
            return str(error)


WORDS = [*NOT_NUMBERS, "1e-3", "-.inf", ".nan", "1e999", "true", "null", "~", "''", "<<", "a b"]
BITS = [
    *(f"{word}{end}" for word in WORDS for end in (": 1\n", "\n")),
    *("- ", "  ", "a: ", "b:\n  ", "{", "}", "[", "]", ", ", "? ", "&a ", "*a", "!!int ", "! "),
    *("|\n", "'", '"', "#", "%", "\t", "---\n", "\ufeff", "\x07", "\u2028", "\u00e4"),
]


@settings(max_examples=300, deadline=None, derandomize=True)
@given(text=st.lists(st.sampled_from(BITS), max_size=12).map("".join))
def test_any_text_has_the_same_content_or_message_without_libyaml(text: str) -> None:
    assert read_by(True, text) == read_by(False, text)


@pytest.mark.parametrize("text", [*TWICE, *(each for each in TEXTS.values() if each != "")])
def test_a_bad_text_has_the_same_message_without_libyaml(text: str | bytes) -> None:
    if isinstance(text, str):
        assert read_by(True, text) == read_by(False, text)


SCALAR = (
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=9)
)
CONTENT = st.recursive(
    SCALAR,
    lambda part: (
        st.lists(part, max_size=4) | st.dictionaries(st.text(max_size=9), part, max_size=4)
    ),
)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(content=CONTENT)
def test_content_that_is_written_is_read_back_value_for_value(content: Any) -> None:
    text = dump({"content": content})
    for libyaml in (True, False):
        assert read_by(libyaml, text) == repr({"content": content})


MERGED = """\
base: &base {a: 1, b: 2}
more: &more {b: 3, c: 4}
one: {<<: *base, b: 5}
two: {d: 6, <<: [*base, *more]}
"""


def test_a_merge_key_states_what_the_mapping_and_those_before_do_not() -> None:
    content = parse(MERGED, "x.yaml")
    assert content["one"] == {"a": 1, "b": 5}
    assert content["two"] == {"a": 1, "b": 2, "c": 4, "d": 6}
    assert content == yaml.safe_load(MERGED)


LONG = "".join(f"key_{i}: [{i / 7}, text, {{a: 1}}]\n" for i in range(5000))


@pytest.mark.parametrize("end", ["", "key_9: 1", "bad: [", "\tb: ?"])
def test_a_long_text_is_read_once_and_by_libyaml(end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = {
        "": "{'key_0': [0.0, ",
        "key_9: 1": "x.yaml: key_9 = 1 in line 5001 repeats the key",
    }
    monkeypatch.setattr(strict_yaml.Loader, "get_event", None)
    assert len(LONG) > strict_yaml.LONGEST_REPEATED
    assert read_by(True, LONG + end).startswith(expected.get(end, "x.yaml: not YAML: "))


@pytest.mark.parametrize("container", ["[", "{a: ", "- "])
def test_containers_are_nested_up_to_a_bound(container: str) -> None:
    depth = strict_yaml.MAX_DEPTH - 1
    inner = "- 1" if container == "- " else "1" + {"[": "]", "{a: ": "}"}[container] * depth
    assert parse(f"a:\n  {container * (depth - (container == '- '))}{inner}", "x")
    with pytest.raises(ValueError, match="not YAML: maximum recursion depth exceeded"):
        parse(f"a:\n  {container * 100_000}{inner}", "x")


def test_a_device_that_never_ends_is_refused() -> None:
    with pytest.raises(ValueError, match=r"/dev/zero: cannot be read: no regular file"):
        read(Path("/dev/zero"))


def test_aliases_within_reason_are_read(tmp_path: Path) -> None:
    file = tmp_path / "sample.yaml"
    file.write_text("base: &base {length: 1.0}\npart: {<<: *base, kind: square}", encoding="utf-8")
    assert build(Sample, read(file)["part"], "") == Sample(length=1.0, kind="square")


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
    for kind in hints(cls).values():
        inner, declared = unwrap(kind)
        assert declared
        assert declared.extra
        assert declared.extra["meaning"]
        assert inner is bool or "options" in declared.extra or declared.ge is not None
