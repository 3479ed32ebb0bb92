"""Page of the reproduction: measured values in the template `reproduce.html`."""

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from launch_scripts.reporting.page_html import STYLE, num
from launch_scripts.study.claims import PAPER_MSE
from launch_scripts.study.drives import CONTENDERS, STUDY_ROADS


def study_page(results: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """Return the page; every measured number in it comes from `results`.

    Args:
        results: Content of `results.json`.
        figures: SVG texts by name.
    """
    labels = STUDY_ROADS | CONTENDERS
    page = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page.filters["num"] = lambda value, pattern="": Markup(num(value, pattern))  # noqa: S704
    return page.get_template("reproduce.html").render(
        results,
        style=STYLE.read_text(encoding="utf-8"),
        pictures={name: base64.b64encode(svg.encode()).decode() for name, svg in figures.items()},
        labels=labels,
        labels_of=lambda names: [labels[name] for name in names],
        explained=not (results["meta"]["quick"] or results["meta"]["authors_code"]),
        nearest={road: nearest_switch(results, road) for road in ("sc1", "sc2")},
    )


def nearest_switch(results: Mapping[str, Any], road: str) -> str:
    """Return the switch that brings the MSE of the AMPC nearest to the paper's number."""
    paper = PAPER_MSE[road]["paper"]
    mse: dict[str, float] = {
        name: row[road]["paper"]["mse_m2"] for name, row in results["switches"].items()
    }
    return min(mse, key=lambda name: abs(math.log(mse[name] / paper)))
