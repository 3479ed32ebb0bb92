"""Change the code in small ways, one at a time, and count how many changes the tests detect.

`make mutation` draws a seeded sample of mutants of ampc_ros, sim_vehicle and ampc_msgs_config,
equally many of each package, and runs tests that import the changed module against each mutant:

1. the nearest test files that are quick without compilation, uncompiled;
2. the other test files with compilation, in two stages, the nearest first.

Near is a file that is named after the module, or imports it over few other modules. The next stage
runs only where the one before has detected nothing. Each stage has at most `MOST_FILES` files, so
the detection rate is a lower bound.

Written: ampc_ros/doc/mutation.md (where all modules are sampled), and in the work folder
results.jsonl, from which an interrupted run continues, and survivors.json. The exit code is 1 where
less than 92 % of a package's mutants are detected; mutants that are listed as equivalent to the
original code do not count.
"""

import argparse
import json
import random
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from queue import Queue
from typing import NamedTuple

from rich.console import Console

from tests.markers import EQUATIONS
from tests.workshop.proofs.mutant_trees import MOST_FILES, Baseline, Project, Worker, stop_all
from tests.workshop.proofs.mutants import Mutant, mutants_of

ROOT = Path(__file__).resolve().parents[3]
DOCUMENT = ROOT / "ampc_ros" / "doc" / "mutation.md"
PACKAGES = ("ampc_msgs_config", "ampc_ros", "sim_vehicle")
BAR = 0.92
"""Share of the mutants of a package that must be detected."""
PROGRESS_PERIOD = 30.0
"""Time between two lines of progress [s]."""
EQUIVALENT: dict[str, str] = {
    f"plausibility: {line}": "only differences of these numbers are used"
    for numbers in ("1.0, 0.0, 0.0", "0.0, 1.0, 0.0", "0.0, 0.0, 1.0")
    for line in (
        f"self.window.append((state, {numbers}))",
        f"self.window = deque([(state, {numbers})], MOST_STATES)",
    )
} | {
    "plausibility: while len(self.window) > 2 and "
    "seconds(self.window[1][0], state) >= CHECK_WINDOW:": (
        "the second of two states is the newest, of age 0"
    ),
    "plausibility: while len(self.window) > 1 and "
    "seconds(self.window[1][0], state) > CHECK_WINDOW:": (
        "one more state is stored, which is ignored where the window is read"
    ),
    "plausibility: if dt <= 0.0:": "a difference of 0 has been handled before",
    "smoothing: node, weight = np.polynomial.legendre.leggauss(4)": (
        "three nodes integrate the products, of degree 4, exactly already"
    ),
}
"""Reasons why no test can detect a mutant, by module and changed line."""


class Case(NamedTuple):
    """A mutant of a file, and after its tests the outcome."""

    file: str
    """Path below the root of the project."""
    mutant: Mutant
    before: str
    after: str
    outcome: str = ""
    """`detected`, `timeout` or `survived`; empty before the tests."""
    source: str = ""
    """Digest of the file."""

    @property
    def key(self) -> str:
        """Identification of the mutant in the results of earlier runs."""
        return f"{self.file} {self.source} {self.mutant.start} {self.mutant.end} {self.after}"

    @property
    def package(self) -> str:
        """Name of the package."""
        return self.file.partition("/")[0]

    @property
    def reason(self) -> str:
        """Reason why the mutant is equivalent to the original code; empty where it is not."""
        return EQUIVALENT.get(f"{Path(self.file).stem}: {self.after}", "")


def all_cases(project: Project, chosen: Sequence[str] = ()) -> dict[str, list[Case]]:
    """Return all mutants of each package.

    Args:
        project: Sources.
        chosen: Modules by path or stem; all where there are none.

    Raises:
        ValueError: A chosen module does not exist.
    """
    files = [
        file
        for file in project.product_files()
        if not chosen or {file, Path(file).stem} & set(chosen)
    ]
    unknown = set(chosen) - set(files) - {Path(file).stem for file in files}
    if unknown:
        raise ValueError(f"--modules: unknown {', '.join(sorted(unknown))}")
    cases: dict[str, list[Case]] = {package: [] for package in project.packages}
    for file in files:
        source = (project.root / file).read_bytes()
        for mutant in mutants_of(source):
            case = Case(file, mutant, *mutant.lines(source), source=project.digest(file))
            cases[case.package].append(case)
    return {package: each for package, each in cases.items() if each}


def draw(cases: Mapping[str, Sequence[Case]], size: int, seed: int) -> list[Case]:
    """Return a sample with equally many mutants of each package, packages in turn.

    A larger sample with the same seed contains the smaller one. A size of 0 takes all mutants.
    """
    shuffled = {
        package: random.Random(seed).sample(each, len(each)) for package, each in cases.items()
    }
    share = -(-size // len(cases)) if size else max(map(len, cases.values()))
    return [each[k] for k in range(share) for each in shuffled.values() if k < len(each)]


def run_cases(cases: Sequence[Case], project: Project, work: Path, workers: int) -> Iterator[Case]:
    """Run the tests against each mutant, several at a time, and yield the outcomes as they come."""
    trees: Queue[Worker] = Queue()
    baseline = Baseline(project, work / "baseline")
    for number in range(workers):
        trees.put(Worker(project, work, number, baseline))

    def run(case: Case) -> Case:
        tree = trees.get()
        try:
            return case._replace(outcome=tree.outcome(case.file, case.mutant))
        finally:
            trees.put(tree)

    with ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(run, case) for case in cases]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            stop_all()
            raise


def load_results(file: Path) -> dict[str, str]:
    """Return the outcomes of earlier runs by key."""
    if not file.exists():
        return {}
    rows = (json.loads(line) for line in file.read_text(encoding="utf-8").splitlines())
    return {row["key"]: row["outcome"] for row in rows}


def with_progress(cases: Iterable[Case], total: int, console: Console) -> Iterator[Case]:
    """Print each survivor, and now and then how many mutants are left and for how long."""
    begin = last = time.monotonic()
    survived = 0
    for number, case in enumerate(cases, start=1):
        if case.outcome == "survived":
            survived += 1
            console.print(
                f"survived: {case.file}:{case.mutant.line}\n  - {case.before}\n  + {case.after}"
            )
        now = time.monotonic()
        if now - last > PROGRESS_PERIOD or number == total:
            last = now
            left = (now - begin) / number * (total - number) / 60.0
            console.print(
                f"{number} of {total} mutants, {survived} survived, about {left:.0f} min left"
            )
        yield case


class Count(NamedTuple):
    """Outcomes of a package or module."""

    sample: int
    detected: int
    """Timeouts included."""
    timeouts: int
    equivalent: int

    @property
    def survived(self) -> int:
        """Mutants that no test has detected although one could."""
        return self.sample - self.detected - self.equivalent

    @property
    def rate(self) -> float:
        """Share of the mutants detected, equivalent ones not counted."""
        return self.detected / max(self.sample - self.equivalent, 1)


def count(cases: Iterable[Case]) -> Count:
    """Count outcomes."""
    cases = list(cases)
    survivors = [case for case in cases if case.outcome == "survived"]
    timeouts = sum(case.outcome == "timeout" for case in cases)
    equivalent = sum(bool(case.reason) for case in survivors)
    return Count(len(cases), len(cases) - len(survivors), timeouts, equivalent)


HEADER = """# Mutation tests

`make mutation` (seed {seed}) changes single operators, comparisons, constants, signs, booleans,
return values and statements in functions of the three packages. Against each change it runs the
nearest test files of the changed module, at most {files} in each of three stages. Text,
annotations, log calls and code at module and class level are not changed. A test process that
exceeds its time counts as detected. This page is generated.

| package | mutants | sample | detected | of these by timeout | equivalent | survived | rate |
|---|---|---|---|---|---|---|---|
"""


def document(cases: Sequence[Case], totals: Mapping[str, int], seed: int) -> str:
    """Return the page of the results.

    Args:
        cases: Sample with outcomes.
        totals: Number of all mutants by package and by file.
        seed: Seed of the sample.
    """
    text = HEADER.format(seed=seed, files=MOST_FILES)
    for package in PACKAGES:
        result = count(case for case in cases if case.package == package)
        row = (package, totals.get(package, 0), *result, result.survived, f"{result.rate:.1%}")
        text += f"| {' | '.join(map(str, row))} |\n"
    text += "\n| module | mutants | sample | detected | equivalent | survived |\n"
    text += "|---|---|---|---|---|---|\n"
    for file in sorted({case.file for case in cases}):
        result = count(case for case in cases if case.file == file)
        numbers = (totals[file], result.sample, result.detected, result.equivalent, result.survived)
        text += f"| `{file}` | {' | '.join(map(str, numbers))} |\n"
    for case in sorted(cases):
        if case.outcome == "survived":
            text += f"\n`{case.file}:{case.mutant.line}`: {case.reason or 'not detected'}\n\n"
            text += f"```diff\n- {case.before}\n+ {case.after}\n```\n"
    return text


def survivors(cases: Sequence[Case]) -> list[dict[str, object]]:
    """Return the mutants that survived, as JSON values."""
    return [
        {
            "file": case.file,
            "line": case.mutant.line,
            "kind": case.mutant.kind,
            "before": case.before,
            "after": case.after,
            "equivalent": case.reason,
        }
        for case in sorted(cases)
        if case.outcome == "survived"
    ]


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = partial(parser.add_argument, metavar="N", type=int)
    add("--sample", default=300, help="mutants in all; 0 for every mutant; default: %(default)s")
    add("--seed", default=1, help="of the sample; default: %(default)s")
    add("--workers", default=2, help="processes at a time; default: %(default)s")
    parser.add_argument("--modules", nargs="+", default=[], help="paths or names; default: all")
    parser.add_argument("--work", type=Path, default=ROOT / "runs" / "mutation", help="folder")
    parser.add_argument(
        "--retry", action="store_true", help="run the survivors of earlier runs once more"
    )
    chosen = parser.parse_args(arguments)
    if chosen.sample < 0 or chosen.workers < 1:
        parser.error("--sample must be at least 0, and --workers at least 1")
    return chosen


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw a sample, run it, write the results; return the exit code."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    chosen, console = parse(arguments), Console(highlight=False, markup=False, soft_wrap=True)
    project = Project(ROOT, PACKAGES, EQUATIONS)
    try:
        cases = all_cases(project, chosen.modules)
    except ValueError as error:
        console.print(f"error: {error}")
        return 2
    sample = draw(cases, chosen.sample, chosen.seed)
    chosen.work.mkdir(parents=True, exist_ok=True)
    (chosen.work / "COLCON_IGNORE").touch()  # `make setup` would find each package several times
    results = chosen.work / "results.jsonl"
    known = load_results(results)
    if chosen.retry:
        known = {key: outcome for key, outcome in known.items() if outcome != "survived"}
    complete = [each._replace(outcome=known[each.key]) for each in sample if each.key in known]
    missing = [each for each in sample if each.key not in known]
    console.print(f"{len(sample)} mutants, {len(complete)} of them from an earlier run")
    with results.open("a", encoding="utf-8") as stream:
        outcomes = run_cases(missing, project, chosen.work, chosen.workers)
        for case in with_progress(outcomes, len(missing), console):
            stream.write(json.dumps({"key": case.key, "outcome": case.outcome}) + "\n")
            stream.flush()
            complete.append(case)
    totals = {package: len(each) for package, each in cases.items()}
    for each in (case for every in cases.values() for case in every):
        totals[each.file] = totals.get(each.file, 0) + 1
    page = chosen.work / "mutation.md" if chosen.modules else DOCUMENT
    page.write_text(document(complete, totals, chosen.seed), encoding="utf-8")
    text = json.dumps(survivors(complete), indent=2, ensure_ascii=False) + "\n"
    (chosen.work / "survivors.json").write_text(text, encoding="utf-8")
    low = False
    for package in cases:
        rate = count(case for case in complete if case.package == package).rate
        console.print(f"{package}: {rate:.1%} detected, at least {BAR:.0%} required")
        low |= rate < BAR
    console.print(f"{page} and {chosen.work / 'survivors.json'}")
    return int(low)


if __name__ == "__main__":
    sys.exit(main())
