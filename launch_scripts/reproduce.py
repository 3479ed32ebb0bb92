"""Reproduce the paper: every figure and table that its text describes, in one page.

`python launch_scripts/reproduce.py` writes `page.html`, which needs no network, and `results.json`.
`--quick` for a first look; `--reading authors_code` or `--switch tyre=authors_code` for what the
authors' released code does instead of the paper.
"""

import argparse
import json
import os
import platform
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import Progress

from ampc_msgs_config import __version__
from launch_scripts.reporting.style import save_png, svg
from launch_scripts.run.json_values import to_json
from launch_scripts.run.simulated import SimulatedDrive
from launch_scripts.study.cases import SHORT, SWITCHES, Authors
from launch_scripts.study.claims import DIRECTION, NO, PAPER, YES, claims
from launch_scripts.study.figures import draw_adaptation, draw_lines, draw_sphere
from launch_scripts.study.measure import Plan, measure, quick, steps
from launch_scripts.study.page import page
from launch_scripts.study.road_figure import draw_road
from launch_scripts.study.search import DISTANCES

PICTURES = ("sc2", "sweep", "sphere")
"""Figures that the documentation shows."""
READINGS = ("paper", "authors_code")


def options(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--output", type=Path, default=Path("runs/reproduce"), help="folder to write"
    )
    parser.add_argument("--reading", choices=READINGS, default="paper", help="of all differences")
    parser.add_argument(
        "--switch",
        action="append",
        default=[],
        metavar="NAME=READING",
        help=f"of one difference, NAME: {', '.join(SWITCHES)}",
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
        chosen.authors = switched(chosen.reading, chosen.switch)
    except ValueError as error:
        parser.error(str(error))
    return chosen


def switched(reading: str, switches: Sequence[str]) -> Authors:
    """Give the differences that are taken from the authors' code.

    Raises:
        ValueError: Names a switch that is unknown, or the choice that it does not have.
    """
    names = set(SWITCHES) if reading == "authors_code" else set()
    for item in switches:
        name, _, choice = item.partition("=")
        if name not in SWITCHES:
            raise ValueError(f"--switch {item}: {name!r} must be one of {', '.join(SWITCHES)}")
        if choice not in READINGS:
            raise ValueError(f"--switch {item}: {choice!r} must be one of {', '.join(READINGS)}")
        (names.add if choice == "authors_code" else names.discard)(name)
    return frozenset(names)


def plan_of(chosen: argparse.Namespace) -> Plan:
    """Give how much is measured."""
    plan = quick(chosen.authors) if chosen.quick else Plan(chosen.authors)
    return plan._replace(sphere_seeds=chosen.sphere_seeds or plan.sphere_seeds)


def processor() -> str:
    """Name the processor, where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def meta(plan: Plan, arguments: Sequence[str]) -> dict[str, Any]:
    """Give what is needed to repeat the run."""
    packages = ("numpy", "numba", "scipy", "matplotlib")
    return {
        "command": f"python launch_scripts/reproduce.py {shlex.join(arguments)}".strip(),
        "authors_code": sorted(plan.authors),
        "quick": plan == quick(plan.authors)._replace(sphere_seeds=plan.sphere_seeds),
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "seeds": f"gains {plan.tuning_seeds}, swarms 0 to {plan.sphere_seeds - 1}",
        "version": f"AMPC for ROS 2 {__version__}",
        "machine": f"{processor()}, {os.cpu_count()} cores, {platform.system()}",
        "Python": platform.python_version(),
        "packages": ", ".join(f"{name} {version(name)}" for name in packages),
    }


def judged(results: Mapping[str, Any]) -> dict[str, Any]:
    """Give the verdicts on the paper's claims, and where pure pursuit beats its controller."""
    found = [claim._asdict() for claim in claims(dict(results))]
    better = {
        road: row["pure_pursuit"]["mse_m2"] < row["paper"]["mse_m2"]
        for road, row in results["roads"].items()
    }
    held = ("paper", "paper_pso", "paper_one", "classic", "classic_pso")
    gain = [
        min(row[name]["mse_m2"] for name in held if name in row) / row["preview"]["mse_m2"]
        for row in results["roads"].values()
    ]
    return {
        "paper": PAPER,
        "preview_gain": [min(gain), max(gain)],
        "claims": found,
        "verdicts": {v: sum(c["verdict"] == v for c in found) for v in (YES, DIRECTION, NO)},
        "pure_pursuit_beats_ampc": {
            "on": [road for road, wins in better.items() if wins],
            "not_on": [road for road, wins in better.items() if not wins],
        },
    }


def draw(
    results: Mapping[str, Any], runs: Mapping[str, Mapping[str, SimulatedDrive]]
) -> dict[str, Figure]:
    """Draw all figures."""
    figures = {road: draw_road(row) for road, row in runs.items()}
    figures["adaptation"] = draw_adaptation(runs.get("sc3_varying") or runs["sc2"])
    shown = ("proposed", "linear", "damped", "classic", "Zhan's adaptive")
    figures["sphere"] = draw_sphere({n: results["sphere"]["curves"][n] for n in shown})
    histories = {
        f"{t['model']}, seed {t['seed']}": (list(range(len(t["history_m2"]))), t["history_m2"])
        for t in results["tuning"]
        if t["used"]
    }
    figures["tuning"] = draw_lines(histories, ("generation", "best fitness [m\u00b2]"))
    trials = results["look_ahead"]["trials"]
    figures["look_ahead"] = draw_lines(
        {
            f"at least {d:g} m": (
                [t["time_s"] for t in trials if t["distance_m"] == d],
                [t["fitness_m2"] for t in trials if t["distance_m"] == d],
            )
            for d in DISTANCES
        },
        ("look-ahead time [s]", "mean MSE [m\u00b2]"),
    )
    rows = results["sweep"]
    figures["sweep"] = draw_lines(
        {
            SHORT[road]: ([r["R"] for r in rows], [r["mse_m2"][road] for r in rows])
            for road in rows[0]["mse_m2"]
        },
        ("increment weight R", "MSE [m\u00b2]"),
        {"paper's AMPC": PAPER["sc1"]["paper"], "paper's classic": PAPER["sc1"]["classic"]},
        log_x=True,
    )
    return figures


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, judge, draw, write."""
    chosen, console, begin = options(arguments), Console(highlight=False), time.monotonic()
    given = list(sys.argv[1:] if arguments is None else arguments)
    plan = plan_of(chosen)
    with Progress(console=console) as progress:
        task = progress.add_task("reproducing", total=steps(plan))
        results, runs = measure(plan, lambda: progress.advance(task))
    results |= {"meta": meta(plan, given), **judged(results)}
    figures = draw(results, runs)
    results["duration_s"] = round(time.monotonic() - begin, 1)
    chosen.output.mkdir(parents=True, exist_ok=True)
    text = page(results, {name: svg(figure) for name, figure in figures.items()})
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
