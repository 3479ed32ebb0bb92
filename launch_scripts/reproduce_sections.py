"""Sections of the page about tuning, swarms and switches."""

from collections.abc import Mapping
from typing import Any

from launch_scripts.reproduce_cases import CONTENDERS, SHORT, SWITCHES
from launch_scripts.reproduce_html import Html, figure, items, num, paragraph, table

NOT_SWITCHED = (
    "Table over speed, reference, friction and wind (4235 cells): friction and wind are not "
    "measured by any sensor of the paper; our tables have speed and reference.",
    "Constraints on the outputs of the first move only: Table 3 bounds no outputs.",
    "The solution that Hildreth\u2019s method has after 38 sweeps is applied by the authors as it "
    "is, converged or not; our controller holds the angle instead, so the row \u201csolver\u201d "
    "is a drive with held angles.",
    "Their wind law (side coefficient 3 beta, moment beta, table clamped at 0.3 rad), the "
    "longitudinal driver PI(100, 1) and the wheels\u2019 spin: our plant has side area, a driver "
    "without lag, no spinning wheels. At clamped angles their wind is weaker than ours.",
)


def tuning_section(results: Mapping[str, Any], figures: Mapping[str, str]) -> Html:
    """Give the search for gains, for the look-ahead, and the sweep of R."""
    return Html(
        paragraph(
            "To tell adaptation from effort of tuning, the paper\u2019s swarm tunes one set of "
            "gains for a model that follows the speed and one for a model that does not. Fitness "
            "is the geometric mean of the MSE on the roads in the table; all other roads are held "
            "out."
        )
        + gain_table(results)
        + figure(
            figures["tuning"],
            [
                "Best fitness over the generations. The swarm improves on its first, random "
                "generation by a fraction, not by orders of magnitude: the held set-point, not the "
                "gains, limits the result."
            ],
            "Fitness over generations.",
        )
        + "<h3>Look-ahead of pure pursuit</h3>\n"
        + look_ahead(results, figures)
        + "<h3>What a weight can do</h3>\n"
        + figure(
            figures["sweep"],
            [
                "MSE of the AMPC over the increment weight R, all else from Table 3, and the "
                "paper\u2019s numbers for Sc1 as dotted lines. Below about 1 the error no longer "
                "falls: what is left belongs to the held set-point. Both of the paper\u2019s "
                "numbers can be had with the same controller, from two weights: at constant speed "
                "its comparison is one of gains."
            ],
            "MSE over R.",
        )
    )


def gain_table(results: Mapping[str, Any]) -> Html:
    """Give what the searches found."""
    rows = []
    for found in results["tuning"]:
        gains = found["gains"]
        rows.append(
            (
                [
                    f"{found['model']}, ",
                    "authors\u2019 " if found["search"] == "authors_code" else "",
                    "seed ",
                    num(found["seed"]),
                ],
                num(found["evaluations"]),
                *(num(gains[key]) for key in gains),
                num(found["fitness_m2"]),
                *(num(value) for value in found["mse_m2"].values()),
            )
        )
    task = [SHORT[name] for name in results["tuning"][0]["mse_m2"]]
    heads = ("model", "tried", "N_p", "N_c", "N", "alpha", "Q", "R", "fitness", *task)
    return table(
        heads,
        rows,
        [
            "Gains found, fitness, and MSE [m2] on the roads. Equal fitness from very different "
            "gains: the optimum is not identifiable. The search of the authors\u2019 code has "
            "another fitness (a step), other bounds and sizes."
        ],
    )


def look_ahead(results: Mapping[str, Any], figures: Mapping[str, str]) -> Html:
    """Give the search of pure pursuit."""
    found = results["look_ahead"]
    best, alone = found["best"], found["best_alone"]
    single = [
        [
            f"{SHORT[road]}: ",
            num(trial["time_s"]),
            " s, at least ",
            num(trial["distance_m"]),
            " m gives an MSE of ",
            num(trial["mse"][road]),
            " m2",
        ]
        for road, trial in alone.items()
    ]
    return Html(
        paragraph(
            "All pairs of a look-ahead time and a shortest distance were tried; the best for the "
            "geometric mean, used everywhere on this page, is ",
            num(best["time_s"]),
            " s and at least ",
            num(best["distance_m"]),
            " m. The best for one road:",
        )
        + items(single)
        + figure(
            figures["look_ahead"],
            [
                "Geometric mean of the MSE over the look-ahead time: too short swings, too long "
                "cuts corners, and in between is a range of good values."
            ],
            "Fitness over look-ahead time.",
        )
    )


def pso_section(results: Mapping[str, Any], figures: Mapping[str, str]) -> Html:
    """Give convergence on the sphere, where the proposed variant loses, and the readings."""
    sphere = results["sphere"]
    names = list(next(iter(sphere["final"].values())))
    finals = []
    for problem, row in sphere["final"].items():
        best = min(values[1] for values in row.values())
        cells = [num(values[1]) for values in row.values()]
        bold = [
            Html(f"<b>{cell}</b>") if values[1] == best else cell
            for cell, values in zip(cells, row.values(), strict=True)
        ]
        finals.append((problem, *bold))
    variants = list(next(iter(sphere["readings"].values()))["median"])
    ways = [
        (name, *(num(v) for v in way["median"].values()), "yes" if way["holds"] else "no")
        for name, way in sphere["readings"].items()
    ]
    return Html(
        figure(
            figures["sphere"],
            [
                "Sphere function in 5 dimensions within +-10 (Fig. 4): median and quartiles; "
                "stars are the paper\u2019s numbers after 41 generations, one run each. The order "
                "of the paper reproduces. Its reference [23], programmed as published (Zhan\u2019s "
                "adaptive), is better than the proposed variant."
            ],
            "Best value over generations.",
        )
        + table(
            ("median, 41 generations", *names),
            finals,
            [
                "Bold is the best of a row. \u201cfitted linear\u201d is the linear inertia with a "
                "schedule that ends with the run and a velocity clamp, as a user would set it: on "
                "most functions it beats the proposed variant."
            ],
        )
        + table(
            ("reading of the paper (sphere, n = 5)", *variants, "order holds"),
            ways,
            [
                "The paper shows 41 generations, but its Table 2 has G = 15; it names neither "
                "velocity clamp nor boundary rule. \u201cauthors code\u201d has their slip in "
                "c_1, c_2."
            ],
        )
    )


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
            ("MSE [m2]", *(SHORT[road] for road in roads)),
            rows,
            [
                "One difference at a time taken from the authors\u2019 code, then all that change "
                "a drive."
            ],
        )
        + paragraph("Not switched, and why:")
        + items(NOT_SWITCHED)
    )
