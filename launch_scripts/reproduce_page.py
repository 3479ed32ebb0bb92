"""The page of the reproduction, from its results and figures."""

from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

from launch_scripts.reproduce_cases import CONTENDERS, ROADS, SHORT
from launch_scripts.reproduce_claims import DIRECTION, NO, PAPER, PAPER_WORDS, YES
from launch_scripts.reproduce_html import Html, Parts, figure, items, num, paragraph, table, text
from launch_scripts.reproduce_limits import limit_section
from launch_scripts.reproduce_sections import pso_section, switch_section, tuning_section

TEMPLATE = Path(__file__).with_name("reproduce.html")
VERDICT_STYLE = {YES: "yes", DIRECTION: "direction", NO: "no"}
CAPTIONS = {
    "sc1": "Double lane change at constant speed (the paper\u2019s Figs. 5-7). The adaptive and "
    "the classic MPC lie on each other: there is nothing to adapt to. Both turn in late and cut "
    "the error only afterwards, because their set-point does not see the road ahead; pure pursuit "
    "and preview do.",
    "sc2": "The same with speed from 9 to 15 and down to 6 m/s (Figs. 8-11). The classic MPC, "
    "whose model stays at 9 m/s, over-steers at 15 m/s and spins; with tuned gains it does not. "
    "Pure pursuit overshoots, but stays.",
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
    wins = "; ".join(SHORT[road] for road in beats["on"]) or "none of the roads"
    loses = "; ".join(SHORT[road] for road in beats["not_on"]) or "none"
    least, most = results["preview_gain"]
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
            [
                "What decides is less the adaptation than the set-point, which the paper holds "
                "constant over the horizon. Looking at the path ahead (preview) makes the MSE ",
                num(least),
                " to ",
                num(most),
                " times smaller than the best of all the MPCs with a held set-point, tuned or not.",
            ],
            "Pure pursuit with a fair look-ahead beats the paper\u2019s AMPC (Table 3) on: "
            f"{wins}. It loses on: {loses}.",
            "The fixed model loses the car only well above the speed it believes in, and there its "
            "loop is unstable without any wind; adaptation of the model cures that.",
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
    heads = ("MSE [m2]", *(SHORT[road] for road in roads))
    rows = [(CONTENDERS[n], *(error_cell(results, r, n) for r in roads)) for n in names]
    caption = (
        "Mean squared cross-track error over the 0.1 s ticks; bold is the best of a column; "
        "\u201clost\u201d: more than 10 m off the path at some time. Classic and fixed: the model "
        "stays at the speed at which the scenario begins (9 m/s on Sc1 and Sc2, 11 m/s on Sc3, "
        "also where that is driven at 18 m/s). The rows with tuned gains tell tuning from "
        "adaptation: same model as the classic MPC, same effort of tuning as the AMPC."
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
        "speed): horizons, Laguerre terms and the ratio of the weights, which is all that counts "
        "of them. With Table 3 only the model adapts, its gains are constant by definition; "
        "preview weights the increments more at speed."
    )
    parts.append(figure(figures["adaptation"], [caption], "Gains over time."))
    return Html("".join(parts))


def wind_table(effect: Mapping[str, Any]) -> Html:
    """Give the largest errors with and without wind."""
    rows = [(CONTENDERS[n], e["calm_m"], e["wind_m"]) for n, e in effect.items()]
    heads = ("largest error [m]", "without wind", "in the wind")
    return table(heads, rows, ["The same drive without and with the wind."])


def run_section(results: Mapping[str, Any]) -> Html:
    """Give what is needed to repeat the run."""
    meta = results["meta"]
    rows = [(key.replace("_", " "), text(str(value))) for key, value in meta.items() if value]
    duration: Parts = ["It took ", num(results["duration_s"], ".0f"), " s."]
    return Html(
        table(("", "value"), [(k, v) for k, v in rows], ["All that is needed to repeat it."], True)
        + paragraph(*duration)
    )
