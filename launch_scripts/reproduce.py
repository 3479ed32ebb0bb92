"""Reproduce the paper: every figure and table that its text describes, on one page.

`python launch_scripts/reproduce.py` writes `page.html`, which needs no network, and `results.json`.
Use `--quick` for a short run, `--reading authors_code` or `--switch tyre=authors_code` for the
choices of the authors' released code, `--reading weak_baselines` for gains that result in the
paper's order and ratios.
"""

import argparse
import json
import os
import platform
import shlex
import sys
import time
from collections.abc import Sequence
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if not __package__:  # run as a file
    import run.guard  # noqa: F401 - one line where a package is missing

from rich.console import Console
from rich.progress import Progress

from ampc_msgs_config import __version__
from launch_scripts.run.machine import cpu_model
from launch_scripts.study.switches import STUDY_SWITCHES, WEAK, Switches

if TYPE_CHECKING:
    from launch_scripts.study.measurements import StudyPlan

PICTURES = ("sc2", "sweep", "sphere")
"""Figures of the documentation."""
ORIGINS = ("paper", "authors_code")


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--output", type=Path, default=Path("runs/reproduce"), help="folder to write"
    )
    parser.add_argument(
        "--reading", choices=(*ORIGINS, WEAK), default="paper", help="source of all choices"
    )
    parser.add_argument(
        "--switch",
        action="append",
        default=[],
        metavar="NAME=READING",
        help=f"source of one choice, NAME: {', '.join(STUDY_SWITCHES)}",
    )
    parser.add_argument("--quick", action="store_true", help="two roads and a tiny search")
    parser.add_argument("--pictures", type=Path, help="folder for PNG files of some figures")
    parser.add_argument("--sphere-seeds", type=int, help="runs of each swarm; default: 51")
    chosen = parser.parse_args(arguments)
    if chosen.sphere_seeds is not None and chosen.sphere_seeds < 1:
        parser.error(f"--sphere-seeds {chosen.sphere_seeds} must be at least 1")
    for name in ("output", "pictures"):
        folder = getattr(chosen, name)
        if folder is not None and folder.exists() and not folder.is_dir():
            parser.error(f"--{name} {folder} is a file, must be a folder")
    try:
        chosen.switches = read_switches(chosen.reading, chosen.switch)
    except ValueError as error:
        parser.error(str(error))
    return chosen


def read_switches(reading: str, assignments: Sequence[str]) -> Switches:
    """Return the switches that are set to the authors' code, and WEAK in that reading.

    Raises:
        ValueError: Names an unknown switch or an unknown reading.
    """
    names = set(STUDY_SWITCHES) if reading == "authors_code" else {WEAK} & {reading}
    for item in assignments:
        name, _, choice = item.partition("=")
        if name not in STUDY_SWITCHES:
            raise ValueError(
                f"--switch {item}: {name!r} must be one of {', '.join(STUDY_SWITCHES)}"
            )
        if choice not in ORIGINS:
            raise ValueError(f"--switch {item}: {choice!r} must be one of {', '.join(ORIGINS)}")
        (names.add if choice == "authors_code" else names.discard)(name)
    return frozenset(names)


def run_description(
    chosen: argparse.Namespace, plan: "StudyPlan", words: Sequence[str]
) -> dict[str, Any]:
    """Return all that is needed to repeat the run."""
    packages = ("numpy", "numba", "scipy", "matplotlib")
    return {
        "command": f"python launch_scripts/reproduce.py {shlex.join(words)}".strip(),
        "reading": chosen.reading,
        "authors_code": sorted(chosen.switches - {WEAK}),
        "quick": chosen.quick,
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "seeds": f"gains {plan.tuning_seeds}, swarms 0 to {plan.sphere_seeds - 1}",
        "version": f"AMPC for ROS 2 {__version__}",
        "machine": f"{cpu_model()}, {os.cpu_count()} cores, {platform.system()}",
        "Python": platform.python_version(),
        "packages": ", ".join(f"{name} {version(name)}" for name in packages),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, check the claims, draw and write."""
    chosen, console, begin = parse_arguments(arguments), Console(highlight=False), time.monotonic()
    # These modules load compiled code and matplotlib.
    from launch_scripts.reporting.pages import to_json
    from launch_scripts.reporting.style import save_png, svg
    from launch_scripts.study.claims import conclusions
    from launch_scripts.study.drives import contender_labels
    from launch_scripts.study.figures import draw_figures
    from launch_scripts.study.measurements import count_steps, measure_study, study_plan
    from launch_scripts.study.page import study_page

    plan = study_plan(chosen.switches, chosen.quick, chosen.sphere_seeds)
    with Progress(console=console) as progress:
        task = progress.add_task("reproducing", total=count_steps(plan))
        results, driven = measure_study(plan, lambda: progress.advance(task))
    words = sys.argv[1:] if arguments is None else arguments
    results |= {"meta": run_description(chosen, plan, words), **conclusions(results)}
    figures = draw_figures(results, driven, contender_labels(chosen.switches))
    results["duration_s"] = round(time.monotonic() - begin, 1)
    # page, pictures of the documentation, results
    chosen.output.mkdir(parents=True, exist_ok=True)
    text = study_page(results, {name: svg(figure) for name, figure in figures.items()})
    (chosen.output / "page.html").write_text(text, encoding="utf-8")
    if chosen.pictures:
        chosen.pictures.mkdir(parents=True, exist_ok=True)
        for name in PICTURES:
            save_png(figures[name], chosen.pictures / f"reproduce_{name}.png")
    content = json.dumps(to_json(results), indent=1, allow_nan=False) + "\n"
    (chosen.output / "results.json").write_text(content, encoding="utf-8")
    for claim in results["claims"]:
        console.print(f"{claim['verdict']:>14}  {claim['claim']}")
    console.print(f"{results['duration_s']:.0f} s; written to {chosen.output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
