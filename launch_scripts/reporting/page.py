"""The page of a report: one file that needs no network."""

import base64
import gzip
import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np
import plotly
from plotly.offline import get_plotlyjs

from ampc_msgs_config import __version__
from ampc_msgs_config.types import RUNGS
from launch_scripts.reporting.drive import Judged
from launch_scripts.reporting.events import PLOT as EVENTS
from launch_scripts.reporting.events import events_panel
from launch_scripts.reporting.map import OLDEST, draw_map
from launch_scripts.reporting.page_html import Html, items, paragraph
from launch_scripts.reporting.panels import Panel, panels
from launch_scripts.reporting.plots import Plot
from launch_scripts.reporting.tables import (
    Verdicts,
    badge,
    legend,
    provenance,
    summary_table,
    verdict_table,
)

HERE = Path(__file__).parent
STYLES = ("page.css", "report.css")
MAX_BYTES = 2_950_000
"""Of the page."""
POINTS = 2000
"""Of a line, at first; halved until the page is small enough."""
FEWEST = 60


class Judgement(NamedTuple):
    """What the thresholds say about all drives."""

    file: str
    verdicts: Verdicts

    @property
    def passed(self) -> bool:
        """Whether every drive passes."""
        return all(each.passed for found in self.verdicts for each in found)


def page(drives: Sequence[Judged], judgement: Judgement | None, generated: str) -> str:
    """Give the page, as fine as its size allows.

    Args:
        drives: One or several bags.
        judgement: Against thresholds, where there are some.
        generated: How and when, in words.

    Raises:
        ValueError: There are so many bags that the page becomes too large.
    """
    points = POINTS
    while points >= FEWEST:
        text = filled(drives, judgement, generated, points)
        if len(text.encode()) <= MAX_BYTES:
            return text
        points //= 2
    raise ValueError(f"{len(drives)} bags make a page of more than {MAX_BYTES / 1e6:g} MB")


def filled(
    drives: Sequence[Judged], judgement: Judgement | None, generated: str, points: int
) -> str:
    """Give the page with lines of so many points."""
    drawn, empty = panels(drives, points)
    events = events_panel(drives)
    drawn += [events] if events else []
    template = Template((HERE / "report.html").read_text(encoding="utf-8"))
    return template.substitute(
        title=escape(title_of(drives)),
        style="".join((HERE / css).read_text(encoding="utf-8") for css in STYLES),
        script=(HERE / "report.js").read_text(encoding="utf-8"),
        lead=lead(drives, judgement),
        verdicts=verdict_table(drives, judgement.verdicts, judgement.file) if judgement else "",
        summary=summary_table(drives),
        legend=legend(drives),
        map_alt=escape(map_alt(drives)),
        plots="".join(map(section, drawn)) + absent(drives, empty, events is None),
        provenance=provenance(drives),
        about=about(points, generated),
        data=packed(json.dumps(content(drives, drawn, points), allow_nan=False)),
        plotly=packed(get_plotlyjs()),
    )


def title_of(drives: Sequence[Judged]) -> str:
    """Give the headline."""
    names = [drive.name for drive in drives]
    if len(names) == 1:
        return f"Drive report: {names[0]}"
    return f"{len(names)} drives side by side: {', '.join(names[:4])}" + ", \u2026" * (
        len(names) > 4
    )


def lead(drives: Sequence[Judged], judgement: Judgement | None) -> Html:
    """Give the outcome in a sentence."""
    words = []
    for drive in drives:
        most, length = drive.summary["max_cross_track_error"], drive.summary["distance"]
        told = (
            "no path to compare with" if most is None else f"at most {most:.3g} m beside its path"
        )
        who = f" by {drive.known.controller}" if drive.known.controller else ""
        name = f"{drive.name}: " if len(drives) > 1 else ""
        words.append(f"{name}{length:,.0f} m{who} in {duration(drive)}, {told}.")
    text = Html(f'<p class="lead">{"<br>".join(map(escape, words))}</p>')
    if judgement is None:
        return text
    failed = sum(not each.passed for found in judgement.verdicts for each in found)
    count = sum(map(len, judgement.verdicts))
    sentence = f"all {count} thresholds held" if judgement.passed else f"{failed} of {count} failed"
    return Html(
        f"{text}<p>{badge(judgement.passed, sentence).replace('verdict', 'verdict banner')}</p>"
    )


def duration(drive: Judged) -> str:
    """Give how long a drive took."""
    seconds = drive.summary["duration"] or 0.0
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def map_alt(drives: Sequence[Judged]) -> str:
    """Describe the map to who cannot see it."""
    names = ", ".join(drive.name for drive in drives)
    return f"Map, equal axes: reference path, driven path, car and predicted path of {names}"


def section(panel: Panel) -> str:
    """Give heading, words and place of a plot."""
    plot = panel.plot
    return (
        f'<div class="panel"><h3 id="head-{plot.key}">{escape(plot.title)}</h3>\n'
        f'<p class="words">{escape(plot.words)}</p>\n'
        f'<div class="plot" id="plot-{plot.key}" role="figure" '
        f'aria-label="{escape(alt(panel))}"></div></div>\n'
    )


def alt(panel: Panel) -> str:
    """Describe a plot to who cannot see it: each line with its extremes."""
    said = []
    for line in panel.figure.data:
        values = np.array([v for v in line.y if v is not None], dtype=float)
        if len(values):
            said.append(f"{line.name} from {values.min():.3g} to {values.max():.3g}")
    if panel.plot.key == EVENTS.key:
        said = list(dict.fromkeys(line.name for line in panel.figure.data))
    return f"{panel.plot.title} over time. {'; '.join(said)}."


def absent(drives: Sequence[Judged], empty: Sequence[Plot], in_order: bool) -> str:
    """Say which plots there are no data for."""
    sentences = [f"{plot.title}: not in the bag{'s' * (len(drives) > 1)}." for plot in empty]
    if in_order:
        told = any("rung" in drive.columns.tick for drive in drives)
        fine = "Faults, fall-backs and guard: everything was in order at all ticks."
        unknown = "Faults, fall-backs and guard: nothing is known of (no controller/tick)."
        sentences.append(fine if told else unknown)
    return items(sentences) if sentences else ""


def about(points: int, generated: str) -> Html:
    """Say how to read the page, and how it was made."""
    return Html(
        paragraph(
            "Time counts from the first command of each bag. Errors are worked out here, from the "
            "recorded states and the path in force, not taken from the controller. Each number of "
            "the summary comes from all data of the bag; lines longer than "
            f"{points} points are drawn thinned by MinMaxLTTB, which keeps the peaks."
        )
        + paragraph(
            "Colours are those of Okabe and Ito, which the colour-blind tell apart. The page is "
            "complete in itself: it loads nothing. "
            f"{generated}, AMPC for ROS 2 {__version__}, plotly {plotly.__version__}."
        )
    )


def content(drives: Sequence[Judged], drawn: Sequence[Panel], points: int) -> dict[str, Any]:
    """Give what the page's script works with."""
    begin = min(float(drive.time[0]) for drive in drives)
    end = max(float(drive.time[-1]) for drive in drives)
    for panel in drawn:
        panel.figure.update_xaxes(range=[begin, end])
    drawn_map = draw_map(drives, points)
    return {
        "begin": begin,
        "end": end,
        "oldest": OLDEST,
        "period": min(drive.period for drive in drives),
        "rungs": [word.replace("_", " ") for word in RUNGS],
        "map": drawn_map.figure.to_plotly_json(),
        "drives": drawn_map.drives,
        "plots": {panel.plot.key: panel.figure.to_plotly_json() for panel in drawn},
    }


def packed(text: str) -> str:
    """Pack a text as the page unpacks it: gzip, then base64."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
