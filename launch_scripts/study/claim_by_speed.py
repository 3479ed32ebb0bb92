"""Measure the paper's claim over speed: what adapting the model wins, and what adapting the gains.

`python -m launch_scripts.study.claim_by_speed` drives a lane change at speeds of 3 to 27 m/s with
four controllers of formulation `paper`. It writes a page, its figure and all numbers.
"""

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import Progress

from ampc_msgs_config.config import find
from ampc_msgs_config.metrics import LOST
from ampc_msgs_config.scenarios.scenario import Scenario
from ampc_msgs_config.types import Array
from ampc_ros.mpc.gain_table import Gains, GainTable, load_gain_table
from ampc_ros.paper.controller import LateralMpc
from ampc_ros.pso.minimize import map_vectorized, minimize
from ampc_ros.pso.swarm import PsoSettings
from launch_scripts.reporting.pages import markdown_table
from launch_scripts.reporting.style import BLUE, INK, ORANGE, label_ends, save_png, stack
from launch_scripts.study.drives import Switches, controller_settings, plant_vehicle
from launch_scripts.tuning.drives import Plant, lane_change, simulated_car
from launch_scripts.tuning.fitness import gains_of_row, repeat_for_gain_sets
from launch_scripts.tuning.fleet import CROSS_TRACK_ERROR
from launch_scripts.tuning.fleet_rows import Entry, FleetRun, prepare_fleet, run_fleet
from launch_scripts.tuning.task import Bounds, geometric_mean, search_space
from sim_vehicle.parameters import load_vehicle_file

CLAIM_PLANTS = (
    Plant("nominal"),
    Plant("50 ms unknown delay", delay=0.05),
    Plant("stiffness -20 %", stiffness=0.8),
    Plant("stiffness +20 %", stiffness=1.2),
    Plant("noise", seed=1),
)
"""The five drives at each speed, with the Magic Formula. The last one is repeated in a search."""
UNSEEN_SEED = 1001
"""Seed of the noise at the first speed of the evaluation; the next speed has the next seed."""
LINEAR = "nominal, linear tyre"
"""Drive beside the five, with the linear tyre of the authors' code; in no mean over drives."""
CLAIM_MODEL_SPEED = 9.0
"""Speed of the model of the classic MPC [m/s]."""
CLAIM_GAINS = Gains(25, 12, 3, 0.3, 10.0, 100.0)
"""Horizons, terms and Q are the same at every speed; pole and increment weight are searched."""
POLE_BOUNDS, INCREMENT_WEIGHT_BOUNDS = (0.0, 0.9), (1e-2, 1e4)
CLAIM_CONTENDERS = {
    "classic": "classic MPC, model at 9 m/s",
    "table3": "adaptive model, Table 3",
    "single": "adaptive model, single set",
    "table": "adaptive model, table",
}
CLAIM_COLORS = {"classic": INK, "table3": ORANGE, "single": "#56B4E9", "table": BLUE}
CLAIM_RATIOS = {
    "model": ("classic", "table3"),
    "one set": ("table3", "single"),
    "gains": ("single", "table"),
}
"""Adaptation of the model, tuning of one set, adaptation of the gains: errors that are divided."""
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
Flags = npt.NDArray[np.bool_]


class ClaimPlan(NamedTuple):
    """Extent of the measurement."""

    nodes: tuple[float, ...] = tuple(np.linspace(3.0, 27.0, 11).round(1).tolist())
    """Speeds of the table [m/s]; the speeds half-way are driven, too."""
    swarm: PsoSettings = PsoSettings(particles=8, generations=6)
    """Swarm of each node, and of the single set on all nodes."""
    noise_seeds: int = 4
    """Repetitions of the drive with noise in a search; their mean error counts."""
    pole_change: float = 0.15
    """Largest change of the pole from node to node: sets of different valleys are not mixed."""
    seed: int = 1

    @property
    def steps(self) -> int:
        """Number of steps that `measure_claim` reports."""
        return 1 + len(self.nodes) + 1

    @property
    def speeds(self) -> list[float]:
        """Speeds of the evaluation [m/s]: nodes, and half-way between them."""
        between = [round((a + b) / 2, 3) for a, b in pairwise(self.nodes)]
        return sorted([*self.nodes, *between])


class FoundGains(NamedTuple):
    """Result of a search."""

    gains: Gains
    fitness: float
    """[m^2]."""


class ClaimErrors(NamedTuple):
    """Errors of several drives."""

    mse: Array
    """Mean squared cross-track error [m^2]."""
    lost: Flags
    """Whether the car was lost, same shape."""


def measure_claim(plan: ClaimPlan, step: Callable[[], None]) -> dict[str, Any]:
    """Search for gains and drive all contenders; return the results for JSON."""
    single, table = search_claim_gains(plan, step)
    table3 = [load_gain_table("table3").nodes[0]]
    rows = {"classic": table3, "table3": table3, "single": [single.gains]}
    rows["table"] = [found.gains for found in table]
    controllers = [
        claim_controller(plan.nodes, gains, CLAIM_MODEL_SPEED if name == "classic" else 0.0)
        for name, gains in rows.items()
    ]
    mse, lost = drive_claim(controllers, plan.speeds)
    step()
    five, at_node = len(CLAIM_PLANTS), np.isin(plan.speeds, plan.nodes)
    groups = {"nodes": at_node, "between": ~at_node, "all": at_node | True}
    every = [plant.name for plant in CLAIM_PLANTS] + [LINEAR]

    def part(speeds: Any, drives: Any) -> dict[str, Any]:
        return claim_summary(mse[:, speeds][:, :, drives], lost[:, speeds][:, :, drives])

    return {
        "speeds": [
            {"speed_mps": v, "node": bool(at_node[k]), **part([k], slice(five))}
            for k, v in enumerate(plan.speeds)
        ],
        "means": {name: part(chosen, slice(five)) for name, chosen in groups.items()},
        "drives": {name: part(slice(None), [k]) for k, name in enumerate(every)},
        "gains": {
            "single": single.gains._asdict(),
            "table": [found.gains._asdict() for found in table],
        },
        "search": {
            "fitness_m2": {"single": single.fitness, "table": [row.fitness for row in table]},
            "evaluations_per_node": plan.swarm.particles * (plan.swarm.generations + 1),
            "seed": plan.seed,
        },
    }


def claim_summary(mse: Array, lost: Flags) -> dict[str, Any]:
    """Return mean errors, number of lost drives and ratios; arguments (contenders, any, any)."""
    means, count = geometric_mean(mse.reshape(len(mse), -1).T), lost.sum(axis=(1, 2))
    mean = dict(zip(CLAIM_CONTENDERS, means.tolist(), strict=True))
    return {
        "mse_m2": mean,
        "lost": dict(zip(CLAIM_CONTENDERS, count.tolist(), strict=True)),
        "ratio": {name: mean[a] / mean[b] for name, (a, b) in CLAIM_RATIOS.items()},
    }


def search_claim_gains(
    plan: ClaimPlan, step: Callable[[], None]
) -> tuple[FoundGains, list[FoundGains]]:
    """Search for the best single set, and for the best set of each node from low to high speed."""
    nodes = [prepare_claim_node(speed, plan.noise_seeds) for speed in plan.nodes]

    def best_gains(chosen: Sequence[FleetRun], key: int, poles: Bounds) -> FoundGains:
        def cost(positions: Array) -> Array:
            gains = space.gains_at(positions)
            return geometric_mean(np.array([claim_cost(node, gains) for node in chosen]))

        space = search_space({"alpha": poles, "R": INCREMENT_WEIGHT_BOUNDS}, CLAIM_GAINS)
        rng = np.random.default_rng([plan.seed, key])
        best = minimize(cost, space.dimensions, plan.swarm, rng, map_vectorized)
        step()
        return FoundGains(gains_of_row(space.gains_at(best.position[None])[0]), best.fitness)

    single, table, poles = (
        best_gains(nodes, len(nodes), POLE_BOUNDS),
        list[FoundGains](),
        POLE_BOUNDS,
    )
    for k, node in enumerate(nodes):
        table.append(best_gains([node], k, poles))
        pole, (low, high) = table[-1].gains.laguerre_pole, POLE_BOUNDS
        poles = max(low, pole - plan.pole_change), min(high, pole + plan.pole_change)
    return single, table


def prepare_claim_node(speed: float, noise_seeds: int) -> FleetRun:
    """Return the fleet of a search at a speed [m/s], with placeholder gains."""
    controller, road = claim_controller([speed], [CLAIM_GAINS]), claim_road(speed)
    *plants, noisy = CLAIM_PLANTS
    plants += [noisy._replace(seed=1 + k) for k in range(noise_seeds)]
    car = plant_vehicle(frozenset())
    return prepare_fleet([Entry(simulated_car(p, car, road), controller) for p in plants], LOST)


def claim_cost(node: FleetRun, gains: Array) -> Array:
    """Return the geometric mean over the five drives of the MSE (n,) of gain sets (n, 6) [m^2]."""
    mse = claim_errors(run_fleet(repeat_for_gain_sets(node, gains), 2)).mse
    mse, single = mse.reshape(len(gains), -1), len(CLAIM_PLANTS) - 1
    return geometric_mean(np.vstack((mse[:, :single].T, mse[:, single:].mean(axis=1))))


def drive_claim(controllers: Sequence[LateralMpc], speeds: Sequence[float]) -> ClaimErrors:
    """Drive all controllers at all speeds [m/s] with noise that no search has seen.

    Returns:
        Errors (controllers, speeds, drives), the last of which is LINEAR.
    """
    car, linear = plant_vehicle(frozenset()), plant_vehicle(Switches({"tyre"}))
    cars, roads = list[Entry](), [claim_road(speed) for speed in speeds]
    for controller in controllers:
        for k, road in enumerate(roads):
            seen = [plant._replace(seed=plant.seed and UNSEEN_SEED + k) for plant in CLAIM_PLANTS]
            cars += [Entry(simulated_car(plant, car, road), controller) for plant in seen]
            cars.append(Entry(simulated_car(Plant(LINEAR), linear, road), controller))
    mse, lost = claim_errors(run_fleet(prepare_fleet(cars, LOST), 2))
    shape = len(controllers), len(speeds), len(CLAIM_PLANTS) + 1
    return ClaimErrors(mse.reshape(shape), lost.reshape(shape))


def claim_controller(
    nodes: Sequence[float], gains: Sequence[Gains], fixed_speed: float = 0.0
) -> LateralMpc:
    """Return a controller with a table over speed, or with one set at all of its nodes.

    Args:
        nodes: Speeds of the nodes [m/s].
        gains: A set per node, or one for all.
        fixed_speed: Speed of the model [m/s]; 0: the measured one.
    """
    chassis = load_vehicle_file(find("vehicles", "paper")).chassis
    rows = list(gains) * (len(nodes) if len(gains) == 1 else 1)
    settings = controller_settings(fixed_speed, frozenset())
    return LateralMpc(chassis, settings, GainTable(list(nodes), [0.0], rows))


def claim_road(speed: float) -> Scenario:
    """Return the lane change of the tuner at a speed [m/s], without its offset and its gust."""
    return lane_change(speed)._replace(wind=(), start_offset=0.0)


def claim_errors(log: Array) -> ClaimErrors:
    """Return the errors (n,) of a log (n, ticks, LOGGED); missing ticks count with LOST."""
    error = log[..., CROSS_TRACK_ERROR]
    error = np.where(np.isnan(error), LOST, error)
    return ClaimErrors(np.mean(error**2, axis=1), np.abs(error).max(axis=1) >= LOST)


def claim_tables(results: Mapping[str, Any]) -> str:
    """Return the tables in Markdown: by speed, means, by drive, gains."""
    rows = [
        [f"{row['speed_mps']:g}{' *' if row['node'] else ''}", *claim_cells(row)]
        for row in results["speeds"]
    ]
    rows += [[f"mean, {name}", *claim_cells(row)] for name, row in results["means"].items()]
    drives = [[name, *claim_cells(row)] for name, row in results["drives"].items()]
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
