"""The page of the reproduction, from its results and figures."""

from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

from launch_scripts.reporting.page_html import (
    STYLE,
    Html,
    Parts,
    figure,
    items,
    num,
    paragraph,
    seen,
    table,
    text,
)
from launch_scripts.study.cases import CONTENDERS, ROADS, SHORT
from launch_scripts.study.claims import DIRECTION, NO, PAPER, PAPER_WORDS, YES
from launch_scripts.study.limits import limit_section
from launch_scripts.study.sections import pso_section, tuning_section
from launch_scripts.study.switches import switch_section

TEMPLATE = Path(__file__).with_name("reproduce.html")
ADAPTATION = (
    "On these roads a fixed model loses the car only well above the speed that it believes in, and "
    "there its loop is unstable without any wind; adaptation of the model cures that."
)
VERDICT_STYLE = {YES: "yes", DIRECTION: "direction", NO: "no"}
FIGURES = {
    "sc1": "The paper\u2019s Figs. 5-7. ",
    "sc2": "The paper\u2019s Figs. 8-11. ",
    "sc3_constant": "The paper\u2019s Figs. 12-14. ",
    "sc3_varying": "The paper\u2019s Figs. 15-18. ",
    "sc3_wind": "The paper\u2019s Figs. 21-24; the wind is drawn in the last panel. ",
    "sc3_fast_wind": "Stretched path, 18 m/s, the same wind; the paper has no such figure. ",
}
SEEN = {
    "sc1": "The adaptive and the classic MPC lie on each other: there is nothing to adapt to. Both "
    "turn in late, because their set-point does not see the road ahead; pure pursuit and preview "
    "do.",
    "sc2": "The classic MPC, whose model stays at 9 m/s, over-steers at 15 m/s and spins; with "
    "tuned gains it does not, but its steering never rests. Pure pursuit overshoots, but stays.",
    "sc3_constant": "This asks for nearly all the friction. The adaptive and the classic MPC do "
    "the same again; all MPCs with a held set-point cut the bends by metres.",
    "sc3_varying": "The MPCs with a held set-point lag behind the path in every bend, adaptive or "
    "not.",
    "sc3_wind": "At these speeds the wind is hardly seen in any of the curves.",
    "sc3_fast_wind": "The models fixed at 11 m/s saw with the steering from the first second on, "
    "before any wind blows, and lose the path; the adaptive one does not notice the wind.",
}


def page(results: Mapping[str, Any], figures: Mapping[str, str]) -> str:
    """Give the whole page; every number in it comes from `results`."""
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        style=STYLE.read_text(encoding="utf-8"),
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
    if results["meta"]["quick"]:
        return "A first look (--quick): the searches are too small to mean anything."
    if not switched:
        return "Where paper and released code differ, the paper counts; the differences are below."
    names = ", ".join(switched)
    return f"From the authors\u2019 code, not the paper: {names}. Explanations are left out."


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
                seen(results, "What decides is less the adaptation than the set-point. "),
                "The paper holds it constant over the horizon; with the path ahead instead "
                "(preview) the MSE is ",
                num(least),
                " to ",
                num(most),
                " times smaller than the best of all the MPCs with a held set-point, tuned or not.",
            ],
            "Pure pursuit with a fair look-ahead beats the paper\u2019s AMPC (Table 3) on: "
            f"{wins}. It loses on: {loses}.",
            *filter(None, [seen(results, ADAPTATION)]),
        ]
    )


def verdict_mark(verdict: str) -> Html:
    """Give a verdict with its sign."""
    return Html(f'<span class="verdict {VERDICT_STYLE[verdict]}">{verdict}</span>')


def claim_table(results: Mapping[str, Any]) -> Html:
    """Give the headline table."""
    rows = [
        (
            claim["claim"],
            verdict_mark(claim["verdict"]),
            text([num(p, ".3g") if isinstance(p, float) else p for p in claim["paper"]]),
            text(claim["here"]),
            seen(results, claim["why"]),
        )
        for claim in results["claims"]
    ]
    caption = (
        "AMPC: adaptive MPC with the gains of the paper\u2019s Table 3. \u201cyes\u201d: same "
        "direction, and a ratio of errors within a factor of 1.5 of the paper\u2019s; an order or "
        "a fact holds. "
        "\u201cdirection only\u201d: at least 1.1 times smaller, but of another size, or the other "
        "car is lost, so that its error has no meaning."
    )
    heads = ("claim", "reproduced?", "paper", "here", "why")
    return table(heads, rows, [caption], cards=True)


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
    said: Parts = [num(PAPER[road][name], ".5g")] if name in PAPER.get(road, {}) else []
    said = said or ([PAPER_WORDS[road, name]] if (road, name) in PAPER_WORDS else [])
    return Html(shown + (f"<small>paper: {text(said)}</small>" if said else ""))


def error_section(results: Mapping[str, Any]) -> Html:
    """Give MSE of all controllers on all roads, then the largest errors."""
    roads = list(results["roads"])
    names = list(results["roads"][roads[0]])
    heads = ("MSE [m\u00b2]", *(SHORT[road] for road in roads))
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
        caption = FIGURES[name] + seen(results, SEEN[name]) + lost_words(results, name)
        parts.append(figure(figures[name], [caption], alt))
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


def lost_words(results: Mapping[str, Any], road: str) -> str:
    """Say who is lost on a road."""
    lost = [CONTENDERS[n] for n, row in results["roads"][road].items() if row["lost"]]
    return f" Lost: {'; '.join(lost)}." if lost else " Nobody is lost."


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
