"""Measure the paper's claim over speed: what adapting the model wins, and what adapting the gains.

`python -m launch_scripts.study.claim_by_speed` drives a lane change at speeds of 3 to 27 m/s with
four controllers of formulation `paper`. It writes a page, its figure and all numbers.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import Progress

from launch_scripts.reporting.pages import markdown_table
from launch_scripts.reporting.style import BLUE, INK, ORANGE, label_ends, save_png, stack
from launch_scripts.study.speed_sweep import (
    CLAIM_CONTENDERS,
    CLAIM_RATIOS,
    ClaimPlan,
    measure_claim,
)

CLAIM_COLORS = {"classic": INK, "table3": ORANGE, "single": "#56B4E9", "table": BLUE}
RATIO_LABELS = {
    "model": "adapting the model",
    "one set": "tuning one set",
    "gains": "adapting the gains",
}
CLAIM_NOTE = """\
# The paper's claim over speed

`python -m launch_scripts.study.claim_by_speed` writes this page, and all numbers as JSON, into
`runs/claim_by_speed`. The page of `reproduce.py` contains the same. `--seed` changes the search.

![MSE over speed, and the share of each step](claim_by_speed.png)

A lane change of 3.5 m with 2.5 m/s2 (less at 3 m/s, where its curvature is limited to 0.1 1/m), the
paper's car with the Magic Formula, formulation `paper`. Each error is the geometric mean of the MSE
[m2] of five drives: nominal, 50 ms of unknown delay, all tyres 20 % softer, 20 % stiffer, noise
`x1`. It is the error that the controller measures. A drive ends 10 m off the path, and its missing
ticks count with 10 m; "(2)": two of the five cars are lost.

* classic: the model stays at 9 m/s. Table 3: the model follows the speed. Both have the gains of
  the paper's Table 3.
* single, table: the swarm searches for pole and R; N_p = 25, N_c = 12, N = 3, Q = 10. Its fitness
  is the error above. Both searches drive equally many cars. The table has the nodes marked *, and
  its pole changes by at most 0.15 from node to node. No search has seen the speeds between the
  nodes, nor the noise of any row.
* model = classic / Table 3, one set = Table 3 / single, gains = single / table: the factor of each
  step.
"""


def claim_tables(results: Mapping[str, Any]) -> str:
    """Return the tables in Markdown: by speed, means, by drive, gains."""
    rows = [
        [f"{row['speed_mps']:g}{' *' if row['node'] else ''}", *claim_cells(row)]
        for row in results["speeds"]
    ]
    rows += [[f"mean, {name}", *claim_cells(row)] for name, row in results["means"].items()]
    drives = [[name, *claim_cells(row)] for name, row in results["drives"].items()]
    roads = [[name, *claim_cells(row)] for name, row in results["roads"].items()]
    nodes = [row["speed_mps"] for row in results["speeds"] if row["node"]]
    gains = [("single", results["gains"]["single"])]
    gains += [(f"{v:g}", row) for v, row in zip(nodes, results["gains"]["table"], strict=True)]
    weights = [
        [name, f"{row['laguerre_pole']:.2f}", f"{row['increment_weight']:.3g}"]
        for name, row in gains
    ]
    heads = ["classic", "Table 3", "single", "table", *CLAIM_RATIOS]
    search = results["search"]
    lines = [
        *markdown_table(["speed [m/s]", *heads], rows),
        "",
        "By drive, geometric mean over all speeds. The last drive is not part of the five.",
        "",
        *markdown_table(["drive", *heads], drives),
        "",
        "The same gains on the paper's roads, which no search has seen; MSE of one drive each.",
        "",
        *markdown_table(["road, drive", *heads], roads),
        "",
        f"Gains that the swarm found with seed {search['seed']} and "
        f"{search['evaluations_per_node']} evaluations at each node:",
        "",
        *markdown_table(["node [m/s]", "alpha", "R"], weights),
        "",
    ]
    return "\n".join(lines)


def claim_cells(row: Mapping[str, Any]) -> list[str]:
    """Return the errors of the contenders with the number of lost drives, and the ratios."""
    lost = {name: f" ({count})" if count else "" for name, count in row["lost"].items()}
    errors = [f"{mse:.3g}{lost[name]}" for name, mse in row["mse_m2"].items()]
    return errors + [f"{ratio:.2f}" for ratio in row["ratio"].values()]


def draw_claim(results: Mapping[str, Any]) -> Figure:
    """Draw the MSE of the contenders over speed, and below it the ratios."""
    figure, (top, bottom) = stack([1.9, 1.4])
    rows = results["speeds"]
    speed = np.array([row["speed_mps"] for row in rows])
    nodes = [k for k, row in enumerate(rows) if row["node"]]
    colors = {"model": INK, "one set": ORANGE, "gains": BLUE}
    panels = (
        (top, "mse_m2", CLAIM_CONTENDERS, CLAIM_COLORS),
        (bottom, "ratio", RATIO_LABELS, colors),
    )
    for ax, key, labels, palette in panels:
        curves = {name: np.array([row[key][name] for row in rows]) for name in labels}
        ax.set_yscale("log")
        for name, values in curves.items():
            ax.plot(speed, values, "-o", color=palette[name], markevery=nodes, markersize=3.5)
        ax.set_xlim(speed[0], speed[-1])
        figure.draw_without_rendering()
        ends = {labels[name]: float(values[-1]) for name, values in curves.items()}
        label_ends(ax, ends, {labels[name]: palette[name] for name in curves})
    bottom.axhline(1.0, color=INK, linewidth=0.8, linestyle=":")
    top.set_ylabel("MSE [m\u00b2], five drives")
    bottom.set_ylabel("times smaller by")
    bottom.set_xlabel("speed [m/s]; dots: nodes of the table")
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--output", type=Path, default=Path("runs/claim_by_speed"), help="folder")
    parser.add_argument("--seed", type=int, default=1, help="seed of the swarm; default: 1")
    chosen, console = parser.parse_args(arguments), Console(highlight=False)
    if chosen.seed < 0:
        parser.error(f"--seed {chosen.seed} must not be negative")
    plan = ClaimPlan(seed=chosen.seed)
    with Progress(console=console) as progress:
        task = progress.add_task("speeds", total=plan.steps)
        results = measure_claim(plan, lambda: progress.advance(task))
    tables = claim_tables(results)
    console.print(Markdown(tables))
    chosen.output.mkdir(parents=True, exist_ok=True)
    content = json.dumps(results, indent=1, allow_nan=False) + "\n"
    (chosen.output / "claim_by_speed.json").write_text(content, encoding="utf-8")
    text = f"{CLAIM_NOTE}\n{tables}"
    (chosen.output / "claim_by_speed.md").write_text(text, encoding="utf-8")
    save_png(draw_claim(results), chosen.output / "claim_by_speed.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
