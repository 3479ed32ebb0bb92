"""Section of the page about the differences between the paper and its authors' code."""

import math
from collections.abc import Mapping
from typing import Any

from launch_scripts.reporting.page_html import Html, items, num, paragraph, table
from launch_scripts.study.cases import CONTENDERS, SHORT, SWITCHES
from launch_scripts.study.claims import PAPER

NOT_SWITCHED = (
    "Table over speed, reference, friction and wind (4235 cells): our tables have speed and "
    "reference; friction and wind would have to be estimated first.",
    "Constraints on the outputs of the first move only: Table 3 bounds no outputs.",
    "The solution that Hildreth\u2019s method has after 38 sweeps is applied by the authors as it "
    "is, converged or not; our controller holds the angle instead, so the row \u201csolver\u201d "
    "is a drive with held angles.",
    "Their wind law (side coefficient 3 beta, moment beta, table clamped at 0.3 rad), the "
    "longitudinal driver PI(100, 1) and the wheels\u2019 spin: our plant has side area, a driver "
    "without lag, no spinning wheels. At clamped angles their wind is weaker than ours.",
)


def closest(results: Mapping[str, Any], road: str) -> list[str | float]:
    """Say which switch brings the AMPC nearest to the paper's number."""
    paper = PAPER[road]["paper"]
    found = {name: row[road]["paper"]["mse_m2"] for name, row in results["switches"].items()}
    name = min(found, key=lambda n: abs(math.log(found[n] / paper)))
    return [
        f"{SHORT[road]}: switch \u201c{name}\u201d gives ",
        num(found[name]),
        ", the paper has ",
        num(paper, ".5g"),
    ]


def switch_section(results: Mapping[str, Any]) -> Html:
    """Give one difference at a time, then all."""
    meaning = [
        (
            name,
            switch.what,
            switch.paper,
            switch.authors_code,
            "drive" if switch.drives else "search",
        )
        for name, switch in SWITCHES.items()
    ]
    roads = list(results["roads"])
    rows = []
    for switch, row in results["switches"].items():
        for name in ("paper", "classic"):
            cells = []
            for road in roads:
                found = row[road][name]
                shown = num(found["mse_m2"])
                cells.append(Html(f"lost ({shown})") if found["lost"] else shown)
            rows.append((f"{switch}: {CONTENDERS[name].split(',')[0]}", *cells))
    return Html(
        table(
            ("switch", "what", "paper", "authors\u2019 code", "changes"),
            meaning,
            [
                "Differences between paper and released code that can be switched here: "
                "--reading authors_code for all, --switch NAME=authors_code for one."
            ],
            cards=True,
        )
        + table(
            ("MSE [m\u00b2]", *(SHORT[road] for road in roads)),
            rows,
            [
                "One difference at a time taken from the authors\u2019 code, then all that change "
                "a drive."
            ],
        )
        + paragraph("Nearest to the MSE that the paper reports for its AMPC:")
        + items([closest(results, road) for road in ("sc1", "sc2")])
        + paragraph("Not switched, and why:")
        + items(NOT_SWITCHED)
    )
