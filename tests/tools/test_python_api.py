"""The Python interface and custom controllers: the code of the docs, and unsuitable classes."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ampc_msgs_config.config import find
from ampc_msgs_config.types import FEED_FORWARD, NANOSECONDS, SHIFTED_PLAN, VehicleState
from ampc_ros import AdaptiveMpc, load_vehicle, make_state
from ampc_ros.configuration import (
    Choices,
    check_controller,
    configuration,
    from_yaml,
    to_yaml,
)
from ampc_ros.controller import make_controller
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.warm_up import warm_up
from launch_scripts.run.simulate import simulate

DOC = Path(__file__).resolve().parents[2] / "ampc_ros" / "doc"
ROAD = np.array([(x, 0.0) for x in np.arange(0.0, 200.0, 5.0)])
GOOD = "class Mine:\n    period = 0.1\n    def step(self, state, path): return 0.01\n"


def blocks(page: str) -> list[str]:
    """Return the Python blocks of a page."""
    text = (DOC / page).read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)


def write(text: str) -> str:
    """Write a file with the class Mine; return its name as a controller."""
    Path("mine.py").write_text(text, encoding="utf-8")
    return "mine.py:Mine"


def supervised(name: str) -> Supervisor:
    """Return a supervisor of a custom controller with a path."""
    supervisor = Supervisor(configuration(Choices(name, static_path=True)))
    supervisor.take_path(ROAD, NANOSECONDS, NANOSECONDS)
    return supervisor


def tick(supervisor: Supervisor, tick: int) -> Any:
    """Answer the state of a tick; return the command."""
    now_ns = NANOSECONDS + tick * NANOSECONDS // 10
    state = VehicleState(now_ns, 20.0 + 0.9 * tick, 0.2, 0.0, 9.0, 0.0, 0.0)
    supervisor.take_state(state, now_ns)
    record = supervisor.tick(now_ns)
    assert record
    return record.command


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_code_of_the_page_of_the_python_interface_runs() -> None:
    names: dict[str, Any] = {}
    for block in blocks("python_api.md"):
        exec(block, names)  # noqa: S102 - our own page
    plan, result = names["plan"], names["result"]
    assert np.isfinite(plan.steering)
    assert plan.steering == plan.angles[0]
    assert plan.status == "tracking"
    assert plan.prediction.shape[1] == 2
    assert abs(plan.cross_track_error) < 0.5
    assert {values.shape for values in result} == {result.time.shape}
    assert names["rms"] < 0.05


def test_the_code_of_the_page_of_custom_controllers_runs() -> None:
    first, *others = blocks("my_controller.md")
    Path("my_controller.py").write_text(first, encoding="utf-8")
    names: dict[str, Any] = {}
    for block in others:
        exec(block, names)  # noqa: S102 - our own page
    assert 0.0 < abs(names["mine"].cross_track_error).max() < 1.0


def test_an_import_of_the_package_is_cheap() -> None:
    code = "import sys, ampc_ros; print('numba' in sys.modules, 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


def test_points_and_path_give_the_same_plan_and_equal_points_are_one_path() -> None:
    mpc, other = (AdaptiveMpc(load_vehicle("paper")) for _ in range(2))
    controller = make_controller(Choices())
    supervisor = Supervisor(configuration(Choices(static_path=True)))
    supervisor.take_path(ROAD, 0, 0)
    assert supervisor.path
    for k in range(3):
        state = make_state(0.9 * k, 0.1, 0.0, 9.0, time=0.1 * k)
        plan = mpc.step(state, ROAD.copy())
        assert plan.steering == other.step(state, supervisor.path.value).steering
        assert plan.steering == controller.step(state, supervisor.path.value).steering


def test_a_vehicle_file_needs_only_chassis_and_steering() -> None:
    text = find("vehicles", "ordinary").read_text(encoding="utf-8")
    sections = re.split(r"(?m)^(?=\w)", text)
    wanted = (each for each in sections if each.startswith(("chassis", "steering")))
    Path("car.yaml").write_text("".join(wanted), encoding="utf-8")
    assert load_vehicle("car.yaml")[1:] == load_vehicle("ordinary")[1:]


UNSUITABLE = {
    "no file": (None, "no file .*mine.py"),
    "no class": ("x = 1\n", "no class Mine"),
    "no step": ("class Mine:\n    period = 0.1\n", "no method step"),
    "no period": ("class Mine:\n    def step(self, state, path): return 0.0\n", "period = None"),
    "period": (GOOD.replace("0.1", "5"), r"period = 5 must lie in \[0.001, 1\] s"),
    "syntax": ("class Mine\n", "SyntaxError"),
    "import": ("import no_such_module\n", "ModuleNotFoundError"),
    "constructor": (GOOD + "    def __init__(self): raise KeyError('gain')\n", "KeyError: 'gain'"),
    "argument": (GOOD + "    def __init__(self, gain): pass\n", "TypeError.*gain"),
}


@pytest.mark.parametrize("case", UNSUITABLE)
def test_an_unsuitable_file_or_class_is_rejected_in_one_line(case: str) -> None:
    text, message = UNSUITABLE[case]
    name = write(text) if text else "mine.py:Mine"
    with pytest.raises(ValueError, match=message) as error:
        make_controller(Choices(name))
    assert "\n" not in str(error.value)
    assert "mine.py:Mine" in str(error.value)


@pytest.mark.parametrize("name", ["mine", "mine.py", "mine.py:", ".py:Mine", "mine.py:a b", ""])
def test_a_name_that_is_no_controller_is_rejected(name: str) -> None:
    with pytest.raises(ValueError, match=r"must be one of preview, .*FILE\.py:CLASS"):
        check_controller(name)


def test_the_name_of_a_custom_controller_becomes_absolute_and_survives_yaml(folder: Path) -> None:
    config = configuration(Choices(write(GOOD)))
    assert config.controller == f"{folder / 'mine.py'}:Mine"
    text = to_yaml(config, 3)
    Path("mine.py").unlink()
    assert from_yaml(text, "bag") == (config, 3)
    with pytest.raises(ValueError, match=r"no file .*mine\.py"):
        Supervisor(config)


def test_a_file_may_import_its_neighbours_and_have_data_classes() -> None:
    Path("neighbour.py").write_text("ANGLE = 0.02\n", encoding="utf-8")
    head = "from __future__ import annotations\nfrom dataclasses import dataclass\n"
    text = f"{head}from neighbour import ANGLE\n@dataclass\n{GOOD.replace('0.01', 'ANGLE')}"
    supervisor = supervised(write(text))
    assert tick(supervisor, 0).steering == 0.02


def test_the_constructor_gets_the_arguments_that_it_has() -> None:
    name = write(GOOD + "    def __init__(self, chassis, base_link_to_cg): self.got = chassis\n")
    controller: Any = make_controller(Choices(name, vehicle="ordinary"))
    assert controller.custom.got == configuration(Choices(vehicle="ordinary")).chassis
    everything: Any = make_controller(
        Choices(write(GOOD + "    def __init__(self, **values): self.got = values\n"))
    )
    assert set(everything.custom.got) == {"chassis", "steering", "settings", "base_link_to_cg"}


FAILING = {
    "raises": "raise RuntimeError('no idea')",
    "nan": "return float('nan')",
    "infinite": "return -1e999",
    "nothing": "return None",
    "text": "return 'left'",
}


@pytest.mark.parametrize("case", FAILING)
def test_a_step_that_fails_leads_to_the_fallback_and_is_reported(case: str) -> None:
    body = f"if state.stamp_ns > 1_250_000_000: {FAILING[case]}\n        return 0.01"
    name = write(GOOD.replace("return 0.01", f"\n        {body}"))
    supervisor = supervised(name)
    rungs, angles = [], []
    for k in range(12):
        command = tick(supervisor, k)
        rungs.append(command.rung)
        angles.append(command.steering)
        assert bool(supervisor.controller.failure) is (k > 2)
    assert rungs == [0] * 3 + [SHIFTED_PLAN] * 5 + [FEED_FORWARD] * 4
    assert np.isfinite(angles).all()
    assert "mine.py:Mine" in supervisor.controller.failure


def test_an_angle_beyond_all_limits_is_clipped_by_the_guard() -> None:
    supervisor = supervised(write(GOOD.replace("0.01", "1e300")))
    angles = [0.0, *(tick(supervisor, k).steering for k in range(30))]
    assert max(angles) <= max(supervisor.config.guard.max_angle)
    assert max(np.diff(angles)) <= 0.1 * max(supervisor.config.guard.max_rate) + 1e-12
    assert supervisor.controller.steering == supervisor.steering


def test_a_controller_that_raises_for_some_states_survives_the_warm_up() -> None:
    body = "raise ValueError('backwards') if state.v_x < 0 else ValueError('slow')"
    name = write(
        GOOD.replace("return 0.01", f"\n        if state.v_x < 5: {body}\n        return 0")
    )
    warm_up(configuration(Choices(name)))


def test_an_object_may_be_simulated() -> None:
    class Straight:
        period = 0.1

        def step(self, state: VehicleState, path: object) -> float:
            return 0.0

    assert not simulate(Straight(), scenario="straight").steering.any()
