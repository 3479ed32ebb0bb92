"""Matching of certificates: what they hold for, and files that are damaged or hostile."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import find, shipped
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.certificate import (
    LONGEST_SENTENCE,
    MAX_CERTIFICATE_BYTES,
    certificate_problem,
    certify_command,
    content_digest,
    identity_of,
)
from ampc_ros.configuration import Choices, configuration
from tests.certificates import certificate_of, write_certificate

CAR = "same_as: ordinary\nbody: {cg_height: 0.5}\n"
many = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture
def choices(tmp_path: Path) -> Choices:
    """Return choices of a gain table and a vehicle in a folder of their own."""
    (tmp_path / "car.yaml").write_text(CAR, encoding="utf-8")
    (tmp_path / "t.yaml").write_bytes(shipped("gains")["preview"].read_bytes())
    return Choices(vehicle=str(tmp_path / "car.yaml"), gain_table=str(tmp_path / "t.yaml"))


def problem(choices: Choices, **options: bool) -> str:
    """Return the problem of choices after a check of its form."""
    sentence = certificate_problem(choices, configuration(choices), **options)
    assert sentence.isprintable()
    assert len(sentence) <= LONGEST_SENTENCE
    return sentence


def change(file: str, old: str, new: str) -> None:
    """Replace a text that occurs in a file."""
    text = Path(file).read_text(encoding="utf-8")
    assert old in text
    Path(file).write_text(text.replace(old, new, 1), encoding="utf-8")


def test_a_certified_table_has_no_problem(choices: Choices) -> None:
    assert "no certificate exists" in problem(choices)
    write_certificate(choices)
    assert problem(choices) == ""


def test_a_certificate_next_to_the_vehicle_counts_for_a_shipped_table(choices: Choices) -> None:
    own = choices._replace(gain_table="preview")
    assert "is of another vehicle" in problem(own)
    file = Path(own.vehicle).with_name("preview.car.certificate.json")
    file.write_text(json.dumps(certificate_of(own)), encoding="utf-8")
    assert problem(own) == ""


OTHER_CAR = {
    "mass": "chassis: {mass: 1501.0}\n",
    "stiffness": "chassis: {rear_cornering_stiffness: 61000}\n",
    "delay": "steering: {delay: 0.02}\n",
    "tyre": "tyre: {friction: 0.9}\n",
    "power": "powertrain: {max_power: 90000.0}\n",
    "spread": "estimated: {chassis.mass: 0.4}\n",
}


@pytest.mark.parametrize("case", OTHER_CAR)
def test_another_car_is_noticed(case: str, choices: Choices) -> None:
    write_certificate(choices)
    Path(choices.vehicle).write_text(CAR + OTHER_CAR[case], encoding="utf-8")
    sentence = problem(choices)
    assert "t.car.certificate.json is of another vehicle" in sentence
    assert sentence.endswith(certify_command(choices, Path(choices.gain_table)))
    assert f"--vehicle {choices.vehicle} --gain-table {choices.gain_table}" in sentence


@pytest.mark.parametrize("text", ["size: {width: 2.0}\n", "chassis: {mass: 1500}\n", "# note\n"])
def test_the_same_car_written_differently_stays_certified(text: str, choices: Choices) -> None:
    write_certificate(choices)
    Path(choices.vehicle).write_text(CAR + text, encoding="utf-8")
    assert problem(choices) == ""


def test_other_gains_and_settings_are_noticed_but_not_supervision(
    choices: Choices, tmp_path: Path
) -> None:
    write_certificate(choices)
    mine = tmp_path / "mine.yaml"
    for text, same in (("path_lost: 3.0\n", True), ("max_increment: 0.2\n", False)):
        mine.write_text(text, encoding="utf-8")
        sentence = problem(choices._replace(settings=str(mine)))
        assert (sentence == "") == same
        assert same or f"--settings {mine}" in sentence
    change(choices.gain_table, "increment_weight: 65.0", "increment_weight: 66.0")
    assert "is of another gains" in problem(choices)


def test_a_table_that_fails_names_what_fails(choices: Choices) -> None:
    write_certificate(choices, ("delay margin = 0.04 s", "b", "c", "d\ne\x1b[31m" + "x" * 999))
    assert "fails: delay margin = 0.04 s; b; c; and 1 more" in problem(choices)


def test_controllers_without_certificates_have_a_problem_only_where_one_is_required() -> None:
    for name in ("pure_pursuit", "classic"):
        assert problem(Choices(name)) == ""
        assert problem(Choices(name), required=True) == f"controller {name} has no certificate"


def test_certificate_of_a_longer_table_name_is_not_confused(choices: Choices) -> None:
    other = Path(choices.gain_table).with_name("t_fast.car.certificate.json")
    other.write_text("{", encoding="utf-8")
    assert "no certificate exists" in problem(choices)
    other.write_text(json.dumps(certificate_of(choices)), encoding="utf-8")
    assert problem(choices) == ""


@many
@given(data=st.binary(max_size=400))
def test_any_bytes_are_a_problem_and_no_error(data: bytes, choices: Choices) -> None:
    write_certificate(choices).write_bytes(data)
    assert "t.car.certificate.json: " in problem(choices)


json_values = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=9),
    lambda part: st.lists(part, max_size=3) | st.dictionaries(st.text(max_size=9), part),
    max_leaves=5,
)


@many
@given(key=st.sampled_from(["version", "certified", "failures", "identity"]), value=json_values)
def test_any_value_with_a_fitting_digest_never_certifies(
    key: str, value: Any, choices: Choices
) -> None:
    content = certificate_of(choices, ("fails",))
    del content["sha256"]
    content[key] = value
    file = write_certificate(choices)
    file.write_text(json.dumps({**content, "sha256": content_digest(content)}), encoding="utf-8")
    assert problem(choices)


@many
@given(at=st.integers(0, 10**6), byte=st.integers(0, 255), cut=st.booleans())
def test_a_changed_byte_is_noticed_or_changes_nothing(
    at: int, byte: int, cut: bool, choices: Choices
) -> None:
    file = write_certificate(choices, ("fails",))
    data = bytearray(file.read_bytes())
    at %= len(data)
    if cut:
        data = data[:at]
    else:
        data[at] = byte
    file.write_bytes(bytes(data))
    assert problem(choices)


def test_hostile_files_are_a_problem_and_no_error(choices: Choices) -> None:
    file = write_certificate(choices)
    hostile = {
        "huge": b" " * (MAX_CERTIFICATE_BYTES + 1),
        "deep": b"[" * 200_000,
        "digits": b'{"version": ' + b"9" * 100_000 + b"}",
        "duplicate": b'{"version": 1, "version": 2}',
        "list": b"[]",
    }
    for data in hostile.values():
        file.write_bytes(data)
        assert "t.car.certificate.json: " in problem(choices)
    file.unlink()
    file.mkdir()
    assert "no regular file" in problem(choices)
    file.rmdir()
    os.mkfifo(file)
    assert "no regular file" in problem(choices)
    file.unlink()
    file.symlink_to(file)
    assert "t.car.certificate.json: " in problem(choices)


def test_many_files_are_not_all_read(choices: Choices) -> None:
    folder = Path(choices.gain_table).parent
    for i in range(300):
        (folder / f"t.{i}.certificate.json").write_text("{}", encoding="utf-8")
    assert problem(choices)


def test_identity_of_two_shipped_cars_differs_only_in_the_vehicle() -> None:
    one, other = (
        identity_of(
            configuration(Choices(vehicle=car, gain_table="preview")),
            read_vehicle(find("vehicles", car)),
        )
        for car in ("paper", "ordinary")
    )
    assert one.vehicle != other.vehicle
    assert one._replace(vehicle="") == other._replace(vehicle="")
