"""A reading of the paper with weak baselines: its order and ratios, and what causes them.

AMPC: Table 3 with R = 10. Classic MPC: fixed model, R = 1000. Pure pursuit: look-ahead of 3.0 s.
"""

from collections.abc import Sequence
from typing import Any

from launch_scripts.study.claims import PAPER_MSE
from launch_scripts.study.drives import (
    WEAK_LABELS,
    WEAK_LOOK_AHEAD,
    WEAK_WEIGHTS,
    TunedGains,
    drive_contender,
    drive_metrics,
    study_scenario,
    table3_gains,
)
from launch_scripts.study.switches import WEAK, Switches


def measure_weak_baselines(roads: Sequence[str], switches: Switches) -> dict[str, Any]:
    """Return the errors of the reading on the roads for which the paper has numbers, for JSON.

    `same_gains` is the fixed model with the gains of the AMPC: what adaptation of the model gives.
    """
    ampc = table3_gains()._replace(increment_weight=WEAK_WEIGHTS["paper"])
    tuned, rows = TunedGains(WEAK_LOOK_AHEAD, fixed=ampc, adaptive=ampc), {}
    for road in (name for name in PAPER_MSE if name in roads):
        scenario, reading = study_scenario(road), switches | {WEAK}
        metrics = {
            name: drive_metrics(drive_contender(name, scenario, tuned, reading))
            for name in (*WEAK_LABELS, "classic_pso")
        }
        mse = {name: metrics[name]["mse_m2"] for name in WEAK_LABELS}
        paper = PAPER_MSE[road]
        rows[road] = {
            "mse_m2": mse,
            "ratio": {name: error / mse["paper"] for name, error in mse.items()},
            "paper_ratio": {name: error / paper["paper"] for name, error in paper.items()},
            "same_gains": metrics["classic_pso"]["mse_m2"] / mse["paper"],
            "order": mse["paper"] < mse["classic"] < mse["pure_pursuit"],
        }
    return rows
