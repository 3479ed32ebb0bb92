"""The attack command: its auditor, its oracle of files, its table."""

import math
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ampc_msgs_config import ros
from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters, GuardLimits
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.supervision.guard import bounds
from tests.workshop.attacks import attack, file_attacks
from tests.workshop.attacks.attempts import Attempt, Choice
from tests.workshop.attacks.auditor import Auditor, Limits, new_context
from tests.workshop.attacks.file_attacks import Mutant, load_mutant, load_table, mutate
from tests.workshop.proofs.config_files import KINDS, ROOT

PERIOD = 0.1


@pytest.fixture
def auditor(own_domain: None) -> Iterator[Auditor]:
    """Return an auditor whose car drives with 8 m/s."""
    context = new_context()
    node = Auditor(context, PERIOD, simulated=False)
    node.v, node.speeds = 8.0, []
    yield node
    node.destroy_node()  # type: ignore[no-untyped-call]
    context.try_shutdown()


def send(node: Auditor, times: list[float], angles: list[float], rate: float = 0.0) -> list[str]:
    """Audit commands; return what is wrong, certainly or perhaps."""
    for at, angle in zip(times, angles, strict=True):
        stamp_ns = round((0.3 if at == 0.32 else at) * 1e9)  # that at 0.32 s repeats a command
        node.audit(ros.STEERING_COMMAND, ros.joint_message(stamp_ns, angle, rate), at)
    return node.violations + node.doubts


@pytest.mark.parametrize("speed", [0.0, 3.0, 8.0, 14.0, 33.0])
def test_the_auditor_s_limits_are_those_of_the_guard(speed: float) -> None:
    chassis = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
    bound = bounds(load(GuardLimits, find("guards", "road")), chassis, speed)
    assert Limits().rate(speed) == pytest.approx(min(bound.rate, bound.jerk))


def test_commands_at_the_largest_rate_are_sound(auditor: Auditor) -> None:
    step = auditor.limits.rate(8.0) * PERIOD
    times, angles = [0.0, 0.1, 0.2, 0.3, 0.32, 0.4], [0.0, 1.0, 2.0, 3.0, 3.0, 4.0]
    assert not send(auditor, times, [step * angle for angle in angles])


def test_a_delayed_publication_is_no_step(auditor: Auditor) -> None:
    step = auditor.limits.rate(8.0) * PERIOD
    assert not send(auditor, [0.0, 0.16, 0.2], [0.0, step, 2.0 * step])


UNSAFE = {
    "not finite": ([0.0, 0.1], [0.0, math.nan]),
    "beyond the largest angle": ([0.0, 0.1], [0.55, 0.61]),
    "two steps within 1.2 ms": ([0.0, 0.1, 0.1012], [0.0, 0.13, 0.26]),
    "more than two periods after a pause": ([0.0, 5.0], [0.0, 0.28]),
    "a jump": ([0.0, 0.1, 0.2], [0.1, 0.1, -0.1]),
}


@pytest.mark.parametrize("fault", UNSAFE)
def test_an_unsafe_command_is_found(auditor: Auditor, fault: str) -> None:
    assert send(auditor, *UNSAFE[fault])
    assert auditor.violations


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_changed_files_are_refused_in_one_line_or_read_as_they_state(
    kind: Any, tmp_path: Path
) -> None:
    (tmp_path / "mine").mkdir()
    choice, rng = Choice(1, tmp_path / "mine", "file"), random.Random(kind.name)
    files = sorted((ROOT / kind.files).glob("*.yaml"))
    for _ in range(12):
        file = rng.choice(files)
        mutant = mutate(file.read_text("utf-8"), rng)
        assert load_mutant(choice, kind, file, mutant) == "", f"{file}: {mutant.what}"


def test_a_number_that_is_read_as_another_one_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = next(kind for kind in KINDS if kind.name == "guard")
    file = ROOT / kind.files / "road.yaml"
    monkeypatch.setattr(file_attacks, "load_as", lambda _, path: path.read_text("utf-8"))
    choice, text = Choice(1, tmp_path, "file"), file.read_text("utf-8")
    for strange in ("0017", "1:30", "1_0", "yes"):
        mutant = Mutant("a number", text.replace("0.6", strange, 1), strange)
        assert "is read as something" in load_mutant(choice, kind, file, mutant)
    assert load_mutant(choice, kind, file, Mutant("twice", text + text, must_fail=True))


@pytest.mark.parametrize("row", ["1_0,2,8", "1e200,0,8", "1e308,-1e308,8", "-1e10,0,8"])
def test_a_strange_number_of_a_path_file_is_refused_without_a_warning(
    row: str, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    rows = "".join(f"{k},0,8\n" for k in range(40))
    choice = Choice(1, tmp_path, "file")
    assert load_table(choice, f"x_m,y_m,v_mps\n{rows}{row}\n".encode()) == ""
    with pytest.raises(ValueError, match=r"must (be a number|lie in)"):
        from_csv(tmp_path / "path.csv")
    assert not recwarn.list


def test_the_table_counts_outcomes_and_replaces_that_of_a_page(tmp_path: Path) -> None:
    attempts = [Attempt("file", "a"), Attempt("file", "b", "broke"), Attempt("bag", "c", "", "?")]
    page = tmp_path / "page.md"
    page.write_text(f"before\n{attack.BEGIN}\nold\n{attack.END}\nafter\n", "utf-8")
    attack.update(page, attack.table(attack.count(attempts)))
    text = page.read_text("utf-8")
    assert "old" not in text
    assert "| all | 3 | 1 | 1 | 1 |" in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")


def test_one_attack_is_repeated_by_area_name_and_seed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    only = ["--only", "file/path file words", "--output", str(tmp_path)]
    assert attack.main([*only, "--seed", "3"]) == 0
    assert "| all | 1 | 1 | 0 | 0 |" in capsys.readouterr().out
    assert not (tmp_path / "attack.json").exists()


def test_a_run_of_one_area_keeps_the_counts_of_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attack, "run", lambda choice: iter([Attempt(choice.area, "a")] * 2))
    for area, seed in (("bag", "1"), ("file", "1"), ("path", "2")):
        attack.main(["--only", area, "--seed", seed, "--output", str(tmp_path)])
        rows = (tmp_path / "attack.md").read_text("utf-8").splitlines()[2:]
        assert rows[-1].startswith("| all | 4 " if area == "file" else "| all | 2 ")
