"""Page of the reproduction: measured values in the template `reproduce.html`."""

import math
from collections.abc import Mapping
from typing import Any

from launch_scripts.reporting.pages import render
from launch_scripts.study.claims import PAPER_MSE
from launch_scripts.study.drives import STUDY_ROADS, contender_labels
from launch_scripts.study.switches import WEAK


def study_page(results: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """Return the page; every measured number in it comes from `results`.

    Args:
        results: Content of `results.json`.
        figures: SVG texts by name.
    """
    weak = results["meta"]["reading"] == WEAK
    labels = STUDY_ROADS | contender_labels(frozenset({WEAK} if weak else ()))
    return render(
        "study/reproduce.html",
        **results,
        figures=figures,
        labels=labels,
        labels_of=lambda names: [labels[name] for name in names],
        weak=weak,
        explained=not (results["meta"]["quick"] or results["meta"]["authors_code"] or weak),
        nearest={road: nearest_switch(results, road) for road in ("sc1", "sc2")},
    )


def nearest_switch(results: Mapping[str, Any], road: str) -> str:
    """Return the switch that brings the MSE of the AMPC nearest to the paper's number."""
    paper = PAPER_MSE[road]["paper"]
    mse: dict[str, float] = {n: r[road]["paper"]["mse_m2"] for n, r in results["switches"].items()}
    return min(mse, key=lambda name: abs(math.log(mse[name] / paper)))
