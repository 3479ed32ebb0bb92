"""Section of the page about what could not be reproduced."""

from collections.abc import Mapping
from typing import Any

from launch_scripts.reproduce_cases import CONTENDERS
from launch_scripts.reproduce_html import Html, items, num, paragraph, table


def limit_section(results: Mapping[str, Any]) -> Html:
    """Say what was tried in vain."""
    fragile = results["fragile"]
    rows = [
        (what, *(num(found[n]["last_3_s_rms_m"]) for n in found)) for what, found in fragile.items()
    ]
    names = [CONTENDERS[n] for n in next(iter(fragile.values()))]
    speeds = [tuple(num(value) for value in row.values()) for row in results["wind_speeds"]]
    lengths = [
        (num(row["length_m"]), *(num(value) for value in row["mse_m2"].values()))
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
                "MSE [m2] on Sc1 with moves of another length. AMPC and classic MPC stay together "
                "at every length: no geometry gives the paper\u2019s ratio with equal gains."
            ],
        )
        + "<h3>Divergence by wind</h3>\n"
        + table(
            ("speed [m/s]", "AMPC, calm", "AMPC, wind", "classic, calm", "classic, wind"),
            speeds,
            [
                "Largest error [m] on the stretched Sc3; the classic MPC\u2019s model stays at "
                "11 m/s. Below its limit of stability the wind makes no difference to either; "
                "above it the classic MPC is lost with and without wind."
            ],
        )
        + "<h3>Numbers of no use as a target</h3>\n"
        + items(
            [
                "Sc3: the paper\u2019s MSE of 7 to 77 m2 means errors of 3 to 9 m all along the "
                "road, also for its AMPC. Our Sc3 asks for nearly all that the tyres give, and "
                "every controller but a lost one is far closer to it.",
                "The ratio AMPC to classic MPC on Sc2 depends on tyre, plant and gains by orders "
                "of magnitude (see the switches): its size is no result.",
            ]
        )
        + "<h3>Table 3 on a real car</h3>\n"
        + table(
            ("RMS error of the last 3 s [m]", *names),
            rows,
            [
                "What the controllers were not told. After each of these a working controller is "
                "back on the path at the end; the AMPC with Table 3 swings on, because its tiny "
                "weight on the increments leaves no margin."
            ],
        )
    )
