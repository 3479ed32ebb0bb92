"""Change the code of guard and track in every small way there is: a test has to notice each.

`make mutation`, or `python tests/workshop/proofs/mutation.py` where requirements-mutation.txt is
installed; `--modules guard track checks` for the rest of the input checks, too. Writes
ampc_ros/doc/mutation.md; the exit code is 1 where a mutant survives that is not listed below as
equivalent.
"""

import argparse
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = "ampc_ros"
TESTS = {
    "guard": ["test_guard.py"],
    "track": ["test_checks.py"],
    "checks": ["test_checks.py", "test_check_path.py"],
}
"""Modules to change, and the tests that have to notice."""
EQUIVALENT: dict[str, str] = {
    f"track: {line}": "only differences of these numbers are used"
    for numbers in ("1.0, 0.0, 0.0", "0.0, 1.0, 0.0", "0.0, 0.0, 1.0")
    for line in (
        f"self.window.append((state, {numbers}))",
        f"self.window = deque([(state, {numbers})], MOST_STATES)",
    )
} | {
    "track: while len(self.window) > 2 and seconds(self.window[1][0], state) >= WINDOW:": (
        "the second of two states is the newest, of age 0"
    ),
    "track: while len(self.window) > 1 and seconds(self.window[1][0], state) > WINDOW:": (
        "one state more is kept, which is passed over when the window is read"
    ),
    "track: if dt <= 0.0:": "0 has been answered before",
}
"""Mutants that no test can notice, by module and changed line, and why."""
NOTICED = ("killed", "timeout")
"""Verdicts of mutmut on a mutant that is gone."""
SETTINGS = """[mutmut]
source_paths={package}
only_mutate={package}/{module}.py
pytest_add_cli_args_test_selection=
{tests}
pytest_add_cli_args=
    -k
    not whatever and not mirrored and not remembers and not ten_minutes
use_git_change_detection=false
"""
"""Searches at random are left out: what only they notice should have a test of its own."""


class Survivor(NamedTuple):
    """A change that no test noticed."""

    name: str
    removed: str
    added: str

    @property
    def reason(self) -> str:
        """Why no test can notice; empty where one should."""
        return EQUIVALENT.get(f"{self.name.split('.')[1]}: {self.added}", "")


class Outcome(NamedTuple):
    """What became of one module's mutants."""

    module: str
    counts: Counter[str]
    survivors: list[Survivor]


def stage(module: str, folder: Path) -> None:
    """Lay a module, its neighbours and its tests out as mutmut expects them."""
    shutil.rmtree(folder, ignore_errors=True)
    (folder / PACKAGE).mkdir(parents=True)
    (folder / "tests").mkdir()
    for name in ("__init__", *TESTS):
        shutil.copy(ROOT / PACKAGE / PACKAGE / f"{name}.py", folder / PACKAGE)
    for test in TESTS[module]:
        shutil.copy(ROOT / "tests" / test, folder / "tests")
    tests = "\n".join(f"    tests/{test}" for test in TESTS[module])
    text = SETTINGS.format(package=PACKAGE, module=module, tests=tests)
    (folder / "setup.cfg").write_text(text, encoding="utf-8")


def mutmut(folder: Path, *arguments: str) -> str:
    """Run mutmut there, and give what it says."""
    command = [sys.executable, "-m", "mutmut", *arguments]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise SystemExit(f"mutmut {' '.join(arguments)}:\n{ran.stdout[-2000:]}{ran.stderr}")
    return ran.stdout


def survivor(name: str, folder: Path) -> Survivor:
    """Read what a mutant changes."""
    lines = mutmut(folder, "show", name).splitlines()
    removed = [line[1:].strip() for line in lines if re.match(r"-[^-]", line)]
    added = [line[1:].strip() for line in lines if re.match(r"\+[^+]", line)]
    return Survivor(name, " ".join(removed), " ".join(added))


def mutate(module: str, folder: Path, workers: int) -> Outcome:
    """Change a module in every way; tell what was noticed."""
    stage(module, folder)
    mutmut(folder, "run", "--max-children", str(workers))
    told = mutmut(folder, "results", "--all", "1").splitlines()
    found = [(line.split()[0].rstrip(":"), line.split(": ")[1]) for line in told if ": " in line]
    counts = Counter(state for _, state in found)
    survivors = [survivor(name, folder) for name, state in found if state not in NOTICED]
    return Outcome(module, counts, survivors)


def markdown(outcomes: Sequence[Outcome]) -> str:
    """Write the document."""
    lines = [
        "# Mutation tests",
        "",
        "`make mutation` changes the modules below in every small way that mutmut knows, one at a",
        "time, and runs their tests without those that search at random: each change has to be",
        "noticed. Constants of the modules are no mutants; tests state their numbers. This page is",
        "written by it.",
        "",
        "| module | mutants | noticed | not noticed | of these equivalent |",
        "|---|---|---|---|---|",
    ]
    for module, counts, survivors in outcomes:
        noticed = sum(counts[state] for state in NOTICED)
        equal = sum(1 for each in survivors if each.reason)
        row = (f"`{module}.py`", sum(counts.values()), noticed, len(survivors), equal)
        lines.append("| " + " | ".join(map(str, row)) + " |")
    for outcome in outcomes:
        for each in outcome.survivors:
            lines += ["", f"`{outcome.module}.py`: {each.reason or 'NOT NOTICED'}", "", "```diff"]
            lines += [f"- {each.removed}", f"+ {each.added}", "```"]
    return "\n".join(lines) + "\n"


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    text = "default: guard track; track and checks take minutes"
    parser.add_argument(
        "--modules", nargs="+", default=["guard", "track"], choices=TESTS, help=text
    )
    parser.add_argument("--workers", type=int, default=2, help="processes; default: %(default)s")
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "mutation", help="folder")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Mutate, tell, write."""
    chosen, console = options(arguments), Console(highlight=False)
    outcomes = []
    for module in chosen.modules:
        outcomes.append(mutate(module, chosen.work / module, chosen.workers))
        console.print(f"{module}: {dict(outcomes[-1].counts)}")
        for each in outcomes[-1].survivors:
            console.print(f"  {each.name}\n  - {each.removed}\n  + {each.added}\n  {each.reason}")
    document = ROOT / PACKAGE / "doc" / "mutation.md"
    document.write_text(markdown(outcomes), encoding="utf-8")
    return int(any(not each.reason for outcome in outcomes for each in outcome.survivors))


if __name__ == "__main__":
    raise SystemExit(main())
