"""Section of the page about what could not be reproduced."""

from collections.abc import Mapping
from typing import Any

from launch_scripts.reporting.page_html import Html, items, num, paragraph, seen, table
from launch_scripts.study.cases import CONTENDERS

TOGETHER = (
    "AMPC and classic MPC stay together at every length: no geometry gives the paper\u2019s ratio "
    "with equal gains."
)
STABILITY = (
    "Below its limit of stability the wind makes next to no difference to either; above it the "
    "classic MPC is lost with and without wind."
)
SWINGS = (
    "A working controller is back on the path, or nearly, at the end; the AMPC with Table 3 swings "
    "on, because its tiny weight on the increments leaves no margin."
)


def limit_section(results: Mapping[str, Any]) -> Html:
    """Say what was tried in vain."""
    fragile = results["fragile"]
    rows = [
        (what, *(num(found[n]["last_3_s_rms_m"]) for n in found)) for what, found in fragile.items()
    ]
    names = [CONTENDERS[n] for n in next(iter(fragile.values()))]
    speeds = [
        (num(speed, "g"), *(num(value) for value in values))
        for speed, *values in (row.values() for row in results["wind_speeds"])
    ]
    lengths = [
        (num(row["length_m"], "g"), *(num(value) for value in row["mse_m2"].values()))
        for row in results["geometry"]
    ]
    return Html(
        paragraph(
            "The paper leaves open: paths, speed profiles and wind (its figures), the gains of its "
            "classic MPC, the look-ahead of its pure pursuit, the bounds of its search. Tried:"
        )
        + "<h3>Other lane changes</h3>\n"
        + table(
            ("length of each move [m]", "AMPC", "classic", "pure pursuit"),
            lengths,
            [
                "MSE [m\u00b2] on Sc1 with moves of another length. ",
                seen(results, TOGETHER),
            ],
        )
        + "<h3>Divergence by wind</h3>\n"
        + table(
            ("speed [m/s]", "AMPC, calm", "AMPC, wind", "classic, calm", "classic, wind"),
            speeds,
            [
                "Largest error [m] on the stretched Sc3; the classic MPC\u2019s model stays at "
                "11 m/s. ",
                seen(results, STABILITY),
            ],
        )
        + "<h3>Numbers of no use as a target</h3>\n"
        + items(
            [
                "Sc3: the paper\u2019s MSE of 7 to 77 m\u00b2 means errors of 3 to 9 m all along "
                "the road, also for its AMPC. Our Sc3 asks for nearly all that the tyres give; "
                "the errors on it are in the tables above.",
                "The ratio of classic MPC to AMPC on Sc2 depends on tyre, plant and gains (see "
                "the switches): its size is no result.",
            ]
        )
        + "<h3>Table 3 with delay, lag or an offset</h3>\n"
        + table(
            ("RMS error of the last 3 s [m]", *names),
            rows,
            [
                "What the controllers were not told. ",
                seen(results, SWINGS),
            ],
        )
    )
