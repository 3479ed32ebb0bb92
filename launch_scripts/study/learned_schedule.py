"""Compare learned schedules with the gain table and the single gain set on held-out plants.

`python -m launch_scripts.study.learned_schedule --update ampc_ros/doc/learned_schedule.md` learns
an ANFIS and a network for both shipped cars and drives all candidates once, closed loop in Python.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ControllerSettings, cornering_angle
from ampc_msgs_config.paths.path import Path as RoadPath
from ampc_msgs_config.types import Array, Plan, VehicleState
from ampc_ros.mpc.gain_table import GainTable
from ampc_ros.preview.controller import PreviewMpc
from launch_scripts.certifying.measurements import GainStepMeter
from launch_scripts.reporting.pages import markdown_table
from launch_scripts.study.shipped_tables import proof_file
from launch_scripts.tune import build_parser
from launch_scripts.tuning.choices import SCHEDULES
from launch_scripts.tuning.drives import ROADS, Plant, nominal_vehicle, simulated_car
from launch_scripts.tuning.fitness import JUDGED, LOST_ERROR, Node, fitness_of_log, gains_of_row
from launch_scripts.tuning.fleet import CONVERGED, CROSS_TRACK_ERROR, LOG_STEERING, LOGGED
from launch_scripts.tuning.learning import Learned, fit_results, schedule_searches
from launch_scripts.tuning.methods import SearchRecord
from launch_scripts.tuning.search import Checkpoints, run_searches
from launch_scripts.tuning.task import Search, TuningTask, geometric_mean, read_task
from launch_scripts.tuning.workers import open_workers
from sim_vehicle.closed_loop import drive

VEHICLES = ("ordinary", "paper")
"""Shipped cars that are compared."""
SCHEDULE_SEED = "1"
"""Seed of the searches and fits."""
DEFAULT_SAVING = 0.05
"""Saving against the table without which a schedule cannot become the default."""
SCHEDULE_HEADINGS = (
    "car",
    "gains",
    "mean",
    "saves against the table",
    "worst speed against the table",
    "largest gain step [m/s2]",
)
PAGE_START = """\
# Learned schedule of the gains

A gain file of the controller `preview` may hold a `schedule`: a neural network with one hidden
layer of six neurons (`network`), or a Takagi-Sugeno system of three rules of first order with
Gaussian memberships (`anfis`). It maps three inputs to pole and increment weight R in each tick:

* speed,
* curvature ahead: the largest |curvature| of the path over the next 2 s,
* latency: delay and lag of the steering in the internal model, with the estimated difference.

```bash
python launch_scripts/tune.py --vehicle my_car.yaml --schedule network
```

Horizons, terms and Q are those of the one gain set in the file, which is also the fallback where an
input is not finite. The gains follow a change with a time constant of 1 s, chosen from the measured
gain steps alone: without it the command jumps where a bend comes into view.
Inputs outside the ranges of the training are clipped to them; a speed outside is reported like one
outside a table. The schedule is part of the configuration in a bag, so a replay repeats it bit for
bit. The keys are listed in [parameters](parameters.md); a file with a schedule has no
[certificate](certificate.md), because `certify.py` drives cars whose gains are constant.

Training: the tuner's search (`--method pso`, 48 evaluations) runs at each of 90 situations (10
speeds, 3 curvatures, delays of 0, 0.1 and 0.2 s in addition to the car's) on the training plants,
the choice among their candidates keeps neighbouring speeds similar as for a table, and SciPy's
`least_squares` fits the parameters. A table has 10 searches, so a schedule costs about six times as
many drives: a straight situation has 14 drives, each other one 11, a node of the table 18.

## Measurement

Fitness on the 14 held-out plants (see the [rule](table_rule.md)), geometric mean over the speeds
half-way between the nodes, each drive in closed loop in Python. *single* and *table*
are the tuned gains in the proofs of the shipped files. The residual is the root mean square of the
fit, in units of 0.1 of the pole and half a decade of R. The *gain step* is the part of one command
that is due to the newest change of the gains, as steady lateral acceleration, in the lane changes
with noise; a certificate allows 0.315 m/s2 (`gain_step`).

The schedules were trained once. Their drives were repeated when the gain steps required the lag and
gains of the schedule in the first tick: without lag (commit 96a6232) network and ANFIS saved
1.0 % and 5.3 % for `ordinary`, with gain steps of 1.6 and 0.99 m/s2; with 0.5 s (9daeb29) 0.3 % and
3.6 %, and -1.6 % and -1.0 % for `paper`. Those savings came with commands that jump.

"""


class Observed:
    """Controller whose errors are recorded, on a car whose wheels are misaligned."""

    def __init__(self, controller: PreviewMpc, misalignment: float) -> None:
        """Wrap a controller before its first step; misalignment of the wheels [rad]."""
        self.controller, self.misalignment = controller, misalignment
        self.period = controller.period
        self.rows: list[Array] = []
        """Rows (LOGGED,) of the log, see `fleet`."""

    def step(self, state: VehicleState, path: RoadPath) -> Plan:
        """Answer a state, and record the error and the command."""
        plan = self.controller.step(state, path)
        row = np.full(LOGGED, np.nan)
        row[CROSS_TRACK_ERROR] = plan.diagnosis.cross_track_error
        row[LOG_STEERING], row[CONVERGED] = plan.steering, plan.diagnosis.converged
        self.rows.append(row)
        return plan._replace(steering=plan.steering + self.misalignment)


class DrivenGains(NamedTuple):
    """Gains with their fitness on the held-out plants."""

    name: str
    fitness: Array
    """(n,) at the speeds between the nodes."""
    gain_step: float
    """Largest step of the steady lateral acceleration due to a change of the gains [m/s^2]."""

    @property
    def mean(self) -> float:
        """Geometric mean over the speeds."""
        return float(geometric_mean(self.fitness))


def build_preview(node: Node, plant: Plant, table: GainTable) -> PreviewMpc:
    """Return the controller of a plant before its first step."""
    settings = load(ControllerSettings, find("controllers", node.settings))
    known = nominal_vehicle(plant, node.vehicle)
    return PreviewMpc(known.chassis, known.steering, settings, table)


def drive_plant(node: Node, plant: Plant, table: GainTable) -> Array:
    """Drive one car in Python; return its log (ticks, LOGGED)."""
    observed = Observed(build_preview(node, plant, table), plant.misalignment)
    drive(simulated_car(plant, node.vehicle, ROADS[plant.road](node.speed)), observed)
    log = np.array(observed.rows)
    log[np.abs(log[:, CROSS_TRACK_ERROR]) > LOST_ERROR[node.kind], CONVERGED] = 0.0
    return log


def judge_at(node: Node, table: GainTable) -> float:
    """Return the fitness of gains at one node, driven in closed loop in Python."""
    logs = [drive_plant(node, plant, table) for plant in node.plants]
    return float(fitness_of_log(node, np.array(logs)[None])[0])


def gain_step(node: Node, plant: Plant, table: GainTable) -> float:
    """Return the largest step of the lateral acceleration due to the gains of one drive [m/s^2]."""
    meter = GainStepMeter(build_preview(node, plant, table))
    drive(simulated_car(plant, node.vehicle, ROADS[plant.road](node.speed)), meter)
    chassis = node.vehicle.chassis
    gradient = chassis.understeer_gradient
    steps = [change / cornering_angle(chassis.wheelbase, gradient, v, 1.0)
             for v, change in meter.steps]  # fmt: skip
    return max(steps, default=0.0)


def judge_gains(name: str, table: GainTable, task: TuningTask) -> DrivenGains:
    """Drive the held-out plants at the speeds between the nodes."""
    nodes = [node._replace(kind=JUDGED) for node in task.held_out_nodes()]
    values = np.array([judge_at(node, table) for node in nodes])
    noisy = next(p for p in nodes[0].plants if p.seed is not None and p.road == "lane change")
    return DrivenGains(name, values, max(gain_step(node, noisy, table) for node in nodes))


def tuned_tables(vehicle: str, task: TuningTask) -> dict[str, GainTable]:
    """Return single set and table from the proof of the shipped gains, the best seed of each."""
    proof = json.loads(proof_file(f"preview_{vehicle}").read_text(encoding="utf-8"))
    tables: dict[str, GainTable] = {}
    for title, item in proof["candidates"].items():
        name = title.partition(",")[0]
        if name in ("single", "table") and name not in tables:
            gains = [gains_of_row(np.array(row)) for row in item["gains"]]
            tables[name] = GainTable(list(task.speeds), [0.0], gains)
    return {name: tables[name] for name in ("single", "table")}


def learn_both(task: TuningTask, folder: Path, console: Console) -> dict[str, Learned]:
    """Search the targets of a task and fit both kinds; finished searches are read from a folder."""
    checkpoints = Checkpoints(folder)
    checkpoints.begin(task.describe(), resume=folder.is_dir())
    done: set[str] = set()

    def show(search: Search, record: SearchRecord) -> None:
        if len(record.fitness) == search.evaluations and search.name not in done:
            done.add(search.name)
            console.print(f"{search.name}: best fitness {record.best[1]:.3g}")

    with open_workers(1) as workers:
        results = run_searches(schedule_searches(task), workers, checkpoints, show)
    return {kind: fit_results(task, kind, results) for kind in SCHEDULES}


def table_rows(vehicle: str, candidates: Sequence[DrivenGains]) -> list[list[str]]:
    """Return the rows of one car."""
    table = next(each for each in candidates if each.name == "table")
    return [
        [
            f"`{vehicle}`",
            each.name,
            f"{each.mean:.4e}",
            f"{1.0 - each.mean / table.mean:.1%}",
            f"{float(np.max(each.fitness / table.fitness)):.3f}",
            f"{each.gain_step:.3f}",
        ]
        for each in candidates
    ]


def verdict(vehicle: str, candidates: Sequence[DrivenGains]) -> str:
    """Return the decision for one car in one line."""
    mean = {each.name: each.mean for each in candidates}
    best = min(SCHEDULES, key=lambda kind: mean[kind])
    saved = 1.0 - mean[best] / mean["table"]
    reaches = "reaches" if saved >= DEFAULT_SAVING else "does not reach"
    condition = f"{reaches} the {DEFAULT_SAVING:.0%} without which it cannot become the default"
    return f"* `{vehicle}`: the {best} saves {saved:.1%} against the table: it {condition}."


def main(arguments: Sequence[str] | None = None) -> int:
    """Learn, drive, print the table, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    page = Path("runs/learned_schedule.md")
    parser.add_argument("--update", type=Path, default=page, help="page to write")
    text, folder = "evaluations; an interrupted run continues", Path("runs/learned_schedule")
    parser.add_argument("--folder", type=Path, default=folder, help=text)
    parser.add_argument("--vehicles", nargs="+", default=VEHICLES, choices=VEHICLES)
    chosen, console = parser.parse_args(arguments), Console(highlight=False, soft_wrap=True)
    rows, verdicts = [], []
    for vehicle in chosen.vehicles:
        task = read_task(
            build_parser().parse_args(["--vehicle", vehicle, "--seeds", SCHEDULE_SEED])
        )
        tables = tuned_tables(vehicle, task)
        learned = learn_both(task, chosen.folder / vehicle, console)
        for kind, item in learned.items():
            tables[kind] = GainTable([task.speeds[0]], [0.0], [item.single], item.schedule)
            verdicts.append(f"* `{vehicle}`, {kind}: residual {item.residual:.2f}.")
        candidates = [judge_gains(name, table, task) for name, table in tables.items()]
        rows += table_rows(vehicle, candidates)
        console.print("\n".join(map(" | ".join, table_rows(vehicle, candidates))), markup=False)
        verdicts.append(verdict(vehicle, candidates))
    lines = [*markdown_table(SCHEDULE_HEADINGS, rows, "llr"), "", *verdicts]
    console.print("\n".join(lines), markup=False)
    command = "`python -m launch_scripts.study.learned_schedule --update FILE`"
    chosen.update.parent.mkdir(parents=True, exist_ok=True)
    text = "\n".join([PAGE_START, *lines, "", f"Command: {command}.", ""])
    chosen.update.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
