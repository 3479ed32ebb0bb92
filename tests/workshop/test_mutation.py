"""The mutation tests: which changes are made, which tests run, and what is detected."""

import ast
import json
from pathlib import Path

import pytest

from tests.left_processes import processes_with
from tests.workshop.proofs import mutation
from tests.workshop.proofs.mutant_trees import Baseline, Project, Stage, Tree, Worker
from tests.workshop.proofs.mutants import Mutant, mutants_of
from tests.workshop.proofs.mutation import Case, all_cases, count, document, draw, survivors

CHANGES = {
    "x = a + b": ["x = a - b"],
    "x = a // 2": ["x = a / 2", "x = a // 3"],
    "x = a ** b": ["x = a * b"],
    "x = a & b": ["x = a | b"],
    "x = (a) * (b - c)": ["x = (a) / (b - c)", "x = (a) * (b + c)"],
    "x = a <= b": ["x = a < b"],
    "x = a < b < c": ["x = a <= b < c", "x = a < b <= c"],
    "x = a is not b": ["x = a is b"],
    "x = a not in b": ["x = a in b"],
    "x = a and b and c": ["x = a or b and c", "x = a and b or c"],
    "x = not a": ["x = (a)"],
    "x = -a": ["x = (a)"],
    "x = 1.5": ["x = 2.5"],
    "x = True": ["x = False"],
    "x = 'é' if a < b else ''": ["x = 'é' if a <= b else ''"],
    "x += a": ["pass", "x -= a"],
    "x.y = a": ["pass"],
    "x[a] = b": ["pass"],
    "f(a)": ["pass"],
    "raise ValueError(a + 1)": ["pass"],
    "break": ["pass"],
    "x = a": [],
    "'text'": [],
    "7": [],
    "x: int = a": [],
    "x = f'{a + b}'": [],
    "x = 'text %d' % a": [],
    "self.get_logger().info(a + b)": [],
    "print(a + 1)": [],
}
"""Mutants of single statements in a function."""


@pytest.mark.parametrize("statement", CHANGES)
def test_a_statement_is_changed_in_these_ways_and_no_others(statement: str) -> None:
    source = f"def f():\n    while a:\n        {statement}\n".encode()
    assert sorted(each.lines(source)[1] for each in mutants_of(source)) == sorted(
        CHANGES[statement]
    )
    for each in mutants_of(source):
        assert each.line == 3
        assert each.lines(source)[0] == statement
        ast.parse(each.apply(source))


@pytest.mark.parametrize(
    ("annotation", "after"),
    [("bool", "return not (a)"), ("float", "return -(a)"), ("str", None)],
)
def test_a_return_value_is_negated_by_the_annotation(annotation: str, after: str | None) -> None:
    source = f"def f(a: {annotation}) -> {annotation}:\n    return a\n".encode()
    assert [each.lines(source)[1] for each in mutants_of(source)] == [after] * bool(after)


def test_defaults_are_changed_and_annotations_decorators_and_code_outside_functions_are_not() -> (
    None
):
    source = b"""
LIMIT = 1 + 2
class A:
    width: int = 3
    @decorated(4)
    def f(self, a: Literal[5] = 6, *, b: int = 7) -> Literal[8]:
        \"\"\"Return 9.\"\"\"
        return a
"""
    assert [source[each.start : each.end] for each in mutants_of(source)] == [b"6", b"7"]


def test_a_change_over_several_lines_is_one_edit() -> None:
    source = b"def f():\n    x = (a  # first\n        +\n        b)\n"
    (mutant,) = mutants_of(source)
    assert (mutant.line, mutant.apply(source)) == (3, source.replace(b"+", b"-"))
    assert mutant.lines(source) == ("+", "-")


@pytest.mark.parametrize("name", ["mpc/active_set", "nodes/controller_node", "supervision/guard"])
def test_all_mutants_of_real_modules_can_be_parsed(name: str) -> None:
    source = (mutation.ROOT / "ampc_ros" / "ampc_ros" / f"{name}.py").read_bytes()
    mutants = mutants_of(source)
    assert len(mutants) > 30
    for each in mutants:
        ast.parse(each.apply(source))


MODULE = '''"""A tiny module."""

def larger(a, b):
    """Return the larger number."""
    return a if a > b else b

def spin(n):
    """Count to n."""
    k = 0
    while k < n:
        k += 1
    return k
'''
TESTS = """
from tiny.module import larger, spin

def test_larger():
    assert larger(1, 2) == 2
    assert larger(2, 1) == 2

def test_spin():
    assert spin(0) == 0
    assert spin(3) == 3
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """Write a project with one module and its tests."""
    root = tmp_path_factory.mktemp("project")
    for name, text in {
        "tiny/tiny/__init__.py": "",
        "tiny/tiny/module.py": MODULE,
        "tiny/tiny/user.py": "from tiny import module\n",
        "tests/__init__.py": "",
        "tests/test_module.py": TESTS,
        "tests/test_user.py": "import tiny.user\ndef test_user():\n    assert tiny.user.module\n",
        "launch_scripts/nothing.py": "",
    }.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    return Project(root, ["tiny"], ["test_module"])


def test_quick_tests_come_before_those_with_compilation_and_near_before_far_ones(
    tiny: Project,
) -> None:
    assert tiny.stages("tiny/tiny/module.py") == [
        Stage(("tests/test_module.py",), compiled=False),
        Stage(("tests/test_user.py",), compiled=True),
    ]
    assert tiny.importers("tiny/tiny/module.py") == {
        "tiny/tiny/module.py", "tiny/tiny/user.py", "tests/test_module.py", "tests/test_user.py",
    }  # fmt: skip


def test_mutants_of_a_tiny_project_are_detected_time_out_or_survive(
    tiny: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.workshop.proofs.mutant_trees.SPARE", 3)
    worker = Worker(tiny, tmp_path, 0, Baseline(tiny, tmp_path / "baseline"))
    outcomes = {
        case.after: worker.outcome(case.file, case.mutant) for case in all_cases(tiny)["tiny"]
    }
    assert outcomes == {
        "return a if a >= b else b": "survived",
        "k = 1": "detected",
        "while k <= n:": "detected",
        "k -= 1": "timeout",
        "k += 2": "detected",
        "pass": "timeout",
    }
    assert (worker.tree.folder / "tiny/tiny/module.py").read_text(encoding="utf-8") == MODULE


def test_tests_that_fail_without_a_mutation_are_an_error(tiny: Project, tmp_path: Path) -> None:
    baseline = Baseline(tiny, tmp_path / "baseline")
    (baseline.tree.folder / "tests/test_user.py").write_text("def test(): assert False\n")
    with pytest.raises(RuntimeError, match=r"test_user\.py fails without a mutation"):
        baseline.time(Stage(("tests/test_user.py",), compiled=True))


LEAVING = """
import subprocess, sys

def test_that_leaves_a_process():
    sleeper = [sys.executable, "-c", "import time; time.sleep(600.0)"]
    starter = f"import subprocess; print(subprocess.Popen({sleeper}, start_new_session=True).pid)"
    subprocess.run([sys.executable, "-c", starter], stdout=open("left", "w"))
"""


@pytest.mark.parametrize("end", ["pass", "assert False", "while True: pass"])
def test_processes_that_a_test_leaves_are_killed_however_it_ends(
    end: str, tiny: Project, tmp_path: Path
) -> None:
    tree = Tree(tiny, tmp_path / "tree")
    (tree.folder / "tests/test_user.py").write_text(f"{LEAVING}    {end}\n", encoding="utf-8")
    code, _ = tree.run(Stage(("tests/test_user.py",), compiled=True), limit=2)
    assert (code == 0) is (end == "pass")
    left = int((tree.folder / "left").read_text(encoding="utf-8"))
    assert left not in processes_with("PATH")


def case(package: str, line: int, outcome: str = "") -> Case:
    """Return a mutant of a module."""
    mutant = Mutant(line, "comparison", 0, 1, "b")
    return Case(f"{package}/{package}/a.py", mutant, "a", f"b{line}", outcome)


def test_a_sample_has_equally_many_mutants_of_each_package_and_is_part_of_a_larger_one() -> None:
    cases = {package: [case(package, k) for k in range(20)] for package in ("p", "q")}
    sample = draw(cases, 10, seed=1)
    assert [each.package for each in sample] == ["p", "q"] * 5
    assert draw(cases, 20, seed=1)[:10] == sample
    assert draw(cases, 10, seed=2) != sample
    assert sorted(draw(cases, 0, seed=1)) == sorted(cases["p"] + cases["q"])


def test_timeouts_are_detected_and_equivalent_mutants_do_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mutation, "EQUIVALENT", {"a: b3": "no difference"})
    monkeypatch.setattr(mutation, "PACKAGES", ("p",))
    outcomes = ["detected", "timeout", "survived", "survived", "survived"]
    cases = [case("p", k, outcome) for k, outcome in enumerate(outcomes)]
    result = count(cases)
    assert result == (5, 2, 1, 1)
    assert (result.survived, result.rate) == (2, 0.5)
    page = document(cases, {"p": 40, "p/p/a.py": 40}, seed=1)
    assert "| p | 40 | 5 | 2 | 1 | 1 | 2 | 50.0% |" in page
    assert "`p/p/a.py:3`: no difference" in page
    assert survivors(cases)[0] == {
        "file": "p/p/a.py", "line": 2, "kind": "comparison", "before": "a", "after": "b2",
        "equivalent": "",
    }  # fmt: skip


def test_a_run_writes_its_results_and_the_next_one_continues(
    tiny: Project,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(mutation, "PACKAGES", ("tiny",))
    monkeypatch.setattr(mutation, "ROOT", tiny.root)
    monkeypatch.setattr(Worker, "outcome", lambda *_: "survived")
    words = ["--modules", "module", "--work", str(tmp_path), "--sample", "2", "--workers", "1"]
    assert mutation.main(words) == 1
    assert "2 of 2 mutants, 2 survived, about 0 min left" in capsys.readouterr().out
    assert len(json.loads((tmp_path / "survivors.json").read_text(encoding="utf-8"))) == 2
    assert (tmp_path / "COLCON_IGNORE").is_file()
    monkeypatch.setattr(Worker, "outcome", lambda *_: "detected")
    assert mutation.main([*words, "--sample", "6"]) == 1
    assert "6 mutants, 2 of them from an earlier run" in capsys.readouterr().out
    assert mutation.main([*words, "--sample", "6", "--retry"]) == 0
    assert "tiny: 100.0% detected" in capsys.readouterr().out
    assert "| tiny | 6 | 6 | 6 |" in (tmp_path / "mutation.md").read_text(encoding="utf-8")


def test_an_unknown_module_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert mutation.main(["--modules", "guard", "nothing"]) == 2
    assert "error: --modules: unknown nothing" in capsys.readouterr().out
