"""Sections of the page about tuning and swarms."""

from collections.abc import Mapping
from typing import Any

from launch_scripts.reporting.page_html import Html, figure, items, num, paragraph, seen, table
from launch_scripts.study.cases import SHORT

WEIGHT = (
    "Below about 1 the error no longer falls: what is left belongs to the held set-point. Both of "
    "the paper\u2019s numbers can be had with the same controller, from two weights: at constant "
    "speed its comparison is one of gains."
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
                "Best fitness over the generations. ",
                seen(
                    results,
                    "The swarm improves on its first, random generation by a fraction, not by "
                    "orders of magnitude: the held set-point, not the gains, limits the result.",
                ),
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
                "paper\u2019s numbers for Sc1 as dotted lines. ",
                seen(results, WEIGHT),
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
            "Gains found, fitness, and MSE [m\u00b2] on the roads. The search of the "
            "authors\u2019 code has another fitness (a step), other bounds and sizes. ",
            seen(results, "Nearly equal fitness comes from very different gains."),
        ],
    )


def look_ahead(results: Mapping[str, Any], figures: Mapping[str, str]) -> Html:
    """Give the search of pure pursuit."""
    found = results["look_ahead"]
    best, alone = found["best"], found["best_alone"]
    single = [
        [
            f"{SHORT[road]}: ",
            num(trial["time_s"], "g"),
            " s, at least ",
            num(trial["distance_m"], "g"),
            " m gives an MSE of ",
            num(trial["mse"][road]),
            " m\u00b2",
        ]
        for road, trial in alone.items()
    ]
    return Html(
        paragraph(
            "All pairs of a look-ahead time and a shortest distance were tried; the best for the "
            "geometric mean, used everywhere on this page, is ",
            num(best["time_s"], "g"),
            " s and at least ",
            num(best["distance_m"], "g"),
            " m. The best for one road:",
        )
        + items(single)
        + figure(
            figures["look_ahead"],
            [
                "Geometric mean of the MSE over look-ahead time, for three shortest distances. ",
                seen(results, "Too short a look-ahead swings, too long a one cuts corners."),
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
                "stars are the paper\u2019s numbers after 41 generations, one run each. "
                "Zhan\u2019s adaptive is the paper\u2019s reference [23] programmed as published; "
                "what the paper calls so is only the linear inertia."
            ],
            "Best value over generations.",
        )
        + table(
            ("median, 41 generations", *names),
            finals,
            [
                "Bold is the best of a row. \u201cfitted linear\u201d is the linear inertia with a "
                "schedule that ends with the run and a velocity clamp, as a user would set it. "
                "Better than the proposed variant: ",
                better_than_proposed(sphere["final"]),
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


def better_than_proposed(final: Mapping[str, Any]) -> str:
    """Say who ends with a better median, by function."""
    lines = []
    for problem, row in final.items():
        better = [name for name, values in row.items() if values[1] < row["proposed"][1]]
        lines.append(f"{problem}: {' and '.join(better) or 'none'}")
    return "; ".join(lines) + "."
