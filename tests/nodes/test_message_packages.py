"""Messages of other stacks, built for the tests, are those of the real packages."""

import json
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ampc_msgs_config.recording.message_types import define
from tests import message_packages
from tests.echo_of_messages import filled
from tests.foreign_messages import PACKAGES, PUBLISHED_HASHES, type_names
from tests.message_packages import built, environment_with

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def store() -> Typestore:
    """Return a type store of rosbags that has read our message texts."""
    types: dict[str, Any] = {}
    for package, texts in PACKAGES.items():
        for name, text in texts.items():
            types |= get_types_from_msg(text, f"{package}/msg/{name}")
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register({name: each for name, each in types.items() if name not in store.fielddefs})
    return store


@pytest.fixture(scope="module")
def echoes(foreign_packages: dict[str, Path]) -> dict[str, dict[str, Any]]:
    """Publish a message of each type in a process; return what its subscriber heard, by type."""
    command = [sys.executable, "-m", "tests.echo_of_messages", *type_names()]
    done = subprocess.run(
        command,
        env=environment_with(foreign_packages),
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, dict[str, Any]] = json.loads(done.stdout)
    return result


def plain(value: Any) -> Any:
    """Return a message of rosbags, or a part of it, as numbers, texts, lists and dictionaries."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list):
        return [plain(each) for each in value]
    if hasattr(value, "__msgtype__"):
        names = (each.name for each in fields(value) if each.name != "__msgtype__")
        return {name: plain(getattr(value, name)) for name in names}
    return value


def test_every_type_hash_is_that_of_the_real_package(echoes: dict[str, dict[str, Any]]) -> None:
    assert {name: echoes[name]["type_hash"] for name in PUBLISHED_HASHES} == PUBLISHED_HASHES


@pytest.mark.parametrize("name", type_names())
def test_type_hash_and_bytes_mean_the_same_to_an_independent_implementation(
    name: str, store: Typestore, echoes: dict[str, dict[str, Any]]
) -> None:
    echo = echoes[name]
    assert echo["type_hash"] == store.hash_rihs01(name)
    assert echo["heard"] == echo["sent"]
    numbers = store.deserialize_cdr(bytes.fromhex(echo["bytes"]), name)
    assert plain(numbers) == echo["sent"]


def test_a_recorder_finds_the_definition_of_a_built_type(foreign_messages: None) -> None:
    for name in type_names():
        definition = define(name)
        package, _, message = name.split("/")
        text = (built(package) / "share" / package / "msg" / f"{message}.msg").read_text()
        assert definition.text.split("\n")[0].split() == text.split("\n")[0].split()
        assert definition.type_hash == PUBLISHED_HASHES.get(name, definition.type_hash)


@pytest.mark.parametrize("turn", ["first", "second"])
def test_messages_work_in_this_process_also_after_another_test(
    turn: str, foreign_messages: None, store: Typestore
) -> None:
    name = "autoware_planning_msgs/msg/Trajectory"
    message = filled(name)
    numbers: Any = store.deserialize_cdr(serialize_message(message), name)
    assert [p.longitudinal_velocity_mps for p in numbers.points] == [
        p.longitudinal_velocity_mps for p in message.points
    ]


def test_no_package_is_left_in_this_process() -> None:
    assert not [entry for entry in sys.path if str(message_packages.CACHE) in entry]
    assert not set(PACKAGES) & set(sys.modules)


def test_a_child_process_imports_only_the_packages_that_it_is_given(
    foreign_packages: dict[str, Path],
) -> None:
    names = ("autoware_control_msgs", "carla_msgs")
    code = f"import importlib.util as u; print([bool(u.find_spec(n)) for n in {names}])"
    for packages, expected in (([], [False, False]), (["carla_msgs"], [False, True])):
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment_with(packages),
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.strip() == str(expected)


def test_a_package_that_exists_is_not_built_again(
    foreign_packages: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_packages, "build", None)  # a call would fail
    for name, folder in foreign_packages.items():
        assert built.__wrapped__(name) == folder


def test_a_missing_compiler_is_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(message_packages, "CACHE", tmp_path)
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(RuntimeError, match=r"^[^\n]*need gcc and g\+\+[^\n]*$"):
        built.__wrapped__("tf2_msgs")
    assert not list(tmp_path.glob("tf2_msgs-*[!k]"))  # nothing but the lock
