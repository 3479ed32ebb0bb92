"""The page of the reproduction, from its results and figures."""

from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

from launch_scripts.reproduce_cases import CONTENDERS, ROADS
from launch_scripts.reproduce_claims import DIRECTION, NO, PAPER, PAPER_WORDS, YES
from launch_scripts.reproduce_html import Html, Parts, figure, items, num, paragraph, table, text
from launch_scripts.reproduce_sections import pso_section, switch_section, tuning_section

TEMPLATE = Path(__file__).with_name("reproduce.html")
VERDICT_STYLE = {YES: "yes", DIRECTION: "direction", NO: "no"}
CAPTIONS = {
    "sc1": "Double lane change at constant speed (the paper\u2019s Figs. 5-7). The adaptive and "
    "the classic MPC lie on each other: there is nothing to adapt to. Both turn in late and cut "
    "the error only afterwards, because their set-point does not see the road ahead; pure pursuit "
    "and preview do.",
    "sc2": "The same with speed from 9 to 15 and down to 6 m/s (Figs. 8-11). The classic MPC, whose "
    "model stays at 9 m/s, over-steers at 15 m/s and spins; with tuned gains it does not. Pure "
    "pursuit overshoots, but stays.",
    "sc3_constant": "General path at 11 m/s (Figs. 12-14), which asks for nearly all the friction. "
    "The adaptive and the classic MPC do the same again.",
    "sc3_varying": "General path, speed from 13 to 6 m/s (Figs. 15-18). The MPCs with a held "
    "set-point lag behind the path in every bend.",
    "sc3_wind": "The same with side wind (Figs. 21-24), drawn in the last panel. At these speeds "
    "the wind is hardly seen in any of the curves.",
    "sc3_fast_wind": "The path stretched, at 18 m/s in the same wind: here the models fixed at "
    "11 m/s lose the path, and the adaptive ones do not notice the wind.",
}


def page(results: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """Give the whole page; every number in it comes from `results`."""
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        command=text(results["meta"]["command"]),
        reading=text(reading(results)),
        summary=summary(results),
        claims=claim_table(results),
        errors=error_section(results),
        roads=road_section(results, figures),
        tuning=tuning_section(results, figures),
        pso=pso_section(results, figures),
        switches=switch_section(results),
        limits=limit_section(results),
        run=run_section(results),
    )


def reading(results: Mapping[str, Any]) -> str:
    """Say which switches differ from the paper."""
    switched = results["meta"]["authors_code"]
    if not switched:
        return "Where paper and released code differ, the paper counts; the differences are below."
    return f"Taken from the authors\u2019 code instead of the paper: {', '.join(switched)}."


def summary(results: Mapping[str, Any]) -> Html:
    """Say it in three sentences."""
    counts = results["verdicts"]
    beats = results["pure_pursuit_beats_ampc"]
    wins = ", ".join(beats["on"]) or "none of the roads"
    loses = f"; not on {', '.join(beats['not_on'])}" if beats["not_on"] else ""
    return items(
        [
            [
                "Of the claims that can be tested, ",
                num(counts[YES]),
                " reproduce, ",
                num(counts[DIRECTION]),
                " in direction only, ",
                num(counts[NO]),
                " do not.",
            ],
            "What decides is less the adaptation than the set-point: the paper holds it constant "
            "over the horizon. Looking at the path ahead (preview) makes the error smaller by "
            "orders of magnitude, which no tuning of the paper\u2019s gains does.",
            f"Pure pursuit with a fair look-ahead beats the paper\u2019s AMPC on {wins}{loses}.",
        ]
    )


def claim_table(results: Mapping[str, Any]) -> Html:
    """Give the headline table."""
    rows = [
        (
            claim["claim"],
            Html(f'<span class="verdict {VERDICT_STYLE[claim["verdict"]]}">')
            + text(claim["verdict"])
            + Html("</span>"),
            text(claim["paper"]),
            text(claim["here"]),
            claim["why"],
        )
        for claim in results["claims"]
    ]
    marked = [(c, Html(v), p, h, w) for c, v, p, h, w in rows]
    caption = (
        "AMPC: adaptive MPC with the gains of the paper\u2019s Table 3. \u201cyes\u201d: same "
        "direction, and a ratio of errors within a factor of 1.5 of the paper\u2019s. "
        "\u201cdirection only\u201d: at least 1.1 times smaller, but of another size, or the other "
        "car is lost, so that its error has no meaning."
    )
    heads = ("claim", "reproduced?", "paper", "here", "why")
    return table(heads, marked, [caption], cards=True)


def error_cell(results: Mapping[str, Any], road: str, name: str) -> Html:
    """Give our MSE, and the paper's below it."""
    row = results["roads"][road]
    measured = row[name]
    best = min(r["mse_m2"] for r in row.values())
    shown = num(measured["mse_m2"])
    if measured["mse_m2"] == best:
        shown = Html(f"<b>{shown}</b>")
    if measured["lost"]:
        shown = Html(f"lost ({shown})")
    said: Parts = [PAPER[road][name]] if name in PAPER.get(road, {}) else []
    said = said or ([PAPER_WORDS[road, name]] if (road, name) in PAPER_WORDS else [])
    return Html(shown + (f"<small>paper: {text(said)}</small>" if said else ""))


def error_section(results: Mapping[str, Any]) -> Html:
    """Give MSE of all controllers on all roads, then the largest errors."""
    roads = list(results["roads"])
    names = list(results["roads"][roads[0]])
    heads = ("MSE [m2]", *(road.replace("_", " ") for road in roads))
    rows = [(CONTENDERS[n], *(error_cell(results, r, n) for r in roads)) for n in names]
    caption = (
        "Mean squared cross-track error over the 0.1 s ticks; bold is the best of a column; "
        "\u201clost\u201d: more than 10 m off the path at some time. Classic and fixed: the model "
        "stays at the speed at which the scenario begins (9 m/s on Sc1 and Sc2, 11 m/s on Sc3, also "
        "where that is driven at 18 m/s). The rows with tuned gains tell tuning from adaptation: "
        "same model as the classic MPC, same effort of tuning as the AMPC."
    )
    largest = [
        (CONTENDERS[n], *(num(results["roads"][r][n]["max_error_m"]) for r in roads)) for n in names
    ]
    effort = [
        (CONTENDERS[n], *(num(results["roads"][r][n]["steering_rms_increment_deg"]) for r in roads))
        for n in names
    ]
    return Html(
        table(heads, rows, [caption])
        + table(("largest error [m]", *heads[1:]), largest, ["Largest cross-track error."])
        + table(
            ("steering [deg]", *heads[1:]),
            effort,
            [
                "What it costs: RMS change of the steering command per tick. The swarm\u2019s "
                "fitness, the MSE alone, does not see it."
            ],
        )
    )


def road_section(results: Mapping[str, Any], figures: Mapping[str, str]) -> Html:
    """Give a figure for each scenario, the wind's effect and the adaptation."""
    parts = []
    for name in results["roads"]:
        parts.append(f"<h3>{text(ROADS[name])}</h3>\n")
        alt = f"Path, error, steering, yaw rate and speed of the controllers on {name}."
        parts.append(figure(figures[name], [CAPTIONS[name]], alt))
        if name in results["wind_effect"]:
            parts.append(wind_table(results["wind_effect"][name]))
    parts.append("<h3>Adaptation of the parameters</h3>\n")
    caption = (
        "Gains in use on the last road without wind (Figs. 19-20 of the paper, on Sc3 with varying "
        "speed): horizons, Laguerre terms and the ratio of the weights, which is all that counts of "
        "them. With Table 3 only the model adapts, its gains are constant by definition; preview "
        "weights the increments more at speed."
    )
    parts.append(figure(figures["adaptation"], [caption], "Gains over time."))
    return Html("".join(parts))


def wind_table(effect: Mapping[str, Any]) -> Html:
    """Give the largest errors with and without wind."""
    rows = [(CONTENDERS[n], e["calm_m"], e["wind_m"]) for n, e in effect.items()]
    heads = ("largest error [m]", "without wind", "in the wind")
    return table(heads, rows, ["The same drive without and with the wind."])


def limit_section(results: Mapping[str, Any]) -> Html:
    """Say what was tried in vain."""
    fragile = results["fragile"]
    rows = [
        (what, *(num(found[n]["last_3_s_rms_m"]) for n in found)) for what, found in fragile.items()
    ]
    names = [CONTENDERS[n] for n in next(iter(fragile.values()))]
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
        + "<h3>Numbers of no use as a target</h3>\n"
        + items(
            [
                "Sc3: an MSE of 7 to 77 m2 means errors of 3 to 9 m all along the road. On every "
                "path that the tyres can follow our errors are far smaller; on others none of the "
                "controllers means anything.",
                "The ratio AMPC to classic MPC on Sc2 depends on tyre, plant and gains by orders of "
                "magnitude (see the switches): its size is no result.",
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


def run_section(results: Mapping[str, Any]) -> Html:
    """Give what is needed to repeat the run."""
    meta = results["meta"]
    rows = [(key.replace("_", " "), text(str(value))) for key, value in meta.items() if value]
    duration: Parts = ["It took ", num(results["duration_s"], ".0f"), " s."]
    return Html(
        table(("", "value"), [(k, v) for k, v in rows], ["All that is needed to repeat it."], True)
        + paragraph(*duration)
    )
