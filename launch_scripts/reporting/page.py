"""Report page: one HTML file that contains tables, charts and the script that plays the drive."""

import base64
import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from typing import Any, NamedTuple

import numpy as np
import plotly
import plotly.graph_objects as go
import yaml
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from ampc_msgs_config import __version__
from ampc_msgs_config.metrics import METRICS, NOTES, Value
from ampc_msgs_config.types import RUNGS
from launch_scripts.reporting.drive import JudgedDrive
from launch_scripts.reporting.events import EVENTS, draw_events
from launch_scripts.reporting.lines import PALETTE
from launch_scripts.reporting.map import OLDEST, draw_map
from launch_scripts.reporting.pages import num, render
from launch_scripts.reporting.panels import PANELS, Panel, draw_panel
from launch_scripts.reporting.summary import SUMMARY

MAX_BYTES = 2_950_000
"""Largest size of the page."""
POINTS, FEWEST_POINTS = 2000, 60
"""Points of a line: first choice, which is halved until the page is small enough, and smallest."""
NO_DATA = "\u2013"
YEAR_2000 = 946_684_800
"""Earlier stamps are times of a simulation, not dates [s]."""
MAX_CONFIGURATION = 60_000
"""Longest part of a configuration that is shown [characters]."""
Rows = list[list[Any]]


class Chart(NamedTuple):
    """A panel with its chart."""

    panel: Panel
    figure: go.Figure

    @property
    def alt(self) -> str:
        """Description for readers who cannot see the chart: each line with its range."""
        names = list(dict.fromkeys(line.name for line in self.figure.data))
        if self.panel is not EVENTS:
            names = []
            for line in self.figure.data:
                values = np.array([v for v in line.y if v is not None], dtype=float)
                if len(values):
                    names.append(f"{line.name} from {values.min():.3g} to {values.max():.3g}")
        return f"{self.panel.title} over time. {'; '.join(names)}."


def report_page(drives: Sequence[JudgedDrive], thresholds: str, command: str) -> str:
    """Return the page, with as many points per line as its size allows.

    Args:
        drives: One or several drives.
        thresholds: Name of the file of thresholds, or nothing.
        command: Text that names the command and the time of the report.

    Raises:
        ValueError: The page would exceed `MAX_BYTES`.
    """
    points = POINTS
    while points >= FEWEST_POINTS:
        page = fill_page(drives, thresholds, command, points)
        if len(page.encode()) <= MAX_BYTES:
            return page
        points //= 2
    raise ValueError(f"{len(drives)} bags exceed the page size of {MAX_BYTES / 1e6:g} MB")


def fill_page(drives: Sequence[JudgedDrive], thresholds: str, command: str, points: int) -> str:
    """Return the page with about `points` points per line."""
    charts = [Chart(panel, draw_panel(panel, drives, points)) for panel in PANELS]
    events = draw_events(drives)
    drawn = [chart for chart in charts if chart.figure.data]
    if events is not None:
        drawn.append(Chart(EVENTS, events))
    facts = [dict(facts_of(drive)) for drive in drives]
    verdicts = [verdict for drive in drives for verdict in drive.verdicts]
    return render(
        "reporting/report.html",
        drives=drives,
        palette=PALETTE,
        thresholds=thresholds,
        verdict_rows=verdict_rows(drives),
        judged=len(verdicts),
        failed=sum(not verdict.passed for verdict in verdicts),
        summary=summary_rows(drives),
        charts=drawn,
        empty=[chart.panel.title for chart in charts if not chart.figure.data],
        has_events=events is not None,
        has_ticks=any("rung" in drive.record.tick for drive in drives),
        provenance=[
            [key, *(each.get(key, NO_DATA) for each in facts)]
            for key in dict.fromkeys(key for each in facts for key in each)
        ],
        configurations=[configuration_texts(drive) for drive in drives],
        points=points,
        command=command,
        version=__version__,
        plotly_version=plotly.__version__,
        data=compress(json.dumps(page_data(drives, drawn, points), allow_nan=False)),
        plotly=compress(get_plotlyjs()),
    )


def compress(text: str) -> str:
    """Return text as the page expects it: gzip, then base64."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def page_data(
    drives: Sequence[JudgedDrive], charts: Sequence[Chart], points: int
) -> dict[str, Any]:
    """Return the input of the page's script."""
    begin = min(float(drive.record.time[0]) for drive in drives)
    end = max(float(drive.record.time[-1]) for drive in drives)
    for chart in charts:
        chart.figure.update_xaxes(range=[begin, end])
    drawn_map = draw_map(drives, points)
    return {
        "begin": begin,
        "end": end,
        "oldest": OLDEST,
        "period": min(drive.record.period for drive in drives),
        "rungs": [word.replace("_", " ") for word in RUNGS],
        "map": drawn_map.figure.to_plotly_json(),
        "drives": drawn_map.drives,
        "plots": {chart.panel.key: chart.figure.to_plotly_json() for chart in charts},
    }


def visible_metrics(drives: Sequence[JudgedDrive]) -> Iterator[tuple[str, list[Value]]]:
    """Yield the key and the values of each metric that at least one drive has."""
    for key in SUMMARY:
        values = [drive.metrics[key] for drive in drives]
        if any(value is not None for value in values):
            yield key, values


def summary_rows(drives: Sequence[JudgedDrive]) -> Rows:
    """Return the rows of the metrics, one column per drive."""
    rows: Rows = []
    for key, values in visible_metrics(drives):
        metric = METRICS[key]
        note = Markup("<small>{}</small>").format(NOTES[key]) if key in NOTES else ""
        cells = [
            NO_DATA if v is None else num(v if isinstance(v, int) else v * metric.scale)
            for v in values
        ]
        rows.append([[metric.title, note], *cells, metric.unit])
    return rows


def verdict_rows(drives: Sequence[JudgedDrive]) -> Rows:
    """Return the rows of the thresholds, one column per drive, in the units of their file."""
    badge = Markup('<span class="verdict {0}">{0}</span>')
    return [
        [
            of_all[0].threshold,
            of_all[0].bound,
            *([v.measured, " ", badge.format("pass" if v.passed else "fail")] for v in of_all),
        ]
        for of_all in zip(*(drive.verdicts for drive in drives), strict=True)
    ]


def facts_of(drive: JudgedDrive) -> Iterator[tuple[str, str]]:
    """Yield title and text of each fact about the origin of a drive."""
    context, columns = drive.context, drive.columns
    yield "Bag", f"{columns.bag.resolve().parent.name}/{columns.bag.name}"
    yield "Namespace", columns.namespace or "/"
    yield "Begin", format_begin(columns.start_ns)
    yield "Version of the controller", context.version or "not in the bag"
    yield "Controller", context.controller or "not in the bag"
    source = "from its settings" if context.settings else "from its stamps"
    period = drive.record.period
    yield "Rate", f"{1 / period:.4g} Hz, {source}" if period else NO_DATA
    chassis = context.chassis
    vehicle = chassis and f"{chassis.mass:g} kg, wheelbase {chassis.wheelbase:.4g} m"
    yield "Vehicle", vehicle or "not in the bag"
    gains = columns.configuration.get("controller", {}).get("gains")
    origin = gains.get("provenance") if isinstance(gains, Mapping) else None
    if isinstance(origin, Mapping) and "command" in origin:
        yield "Gains", str(origin["command"])[:200]
    simulator = columns.configuration.get("simulator", {})
    scenario = simulator.get("scenario")
    if isinstance(scenario, Mapping) and "name" in scenario:
        yield "Scenario", str(scenario["name"])
    for key in ("friction", "noise", "seed"):
        if simulator.get(key) not in (None, ""):
            yield f"Simulator: {key}", str(simulator[key])[:200]


def format_begin(start_ns: int) -> str:
    """Return the time of the first command as text."""
    seconds = start_ns / 1e9
    if seconds < YEAR_2000:
        return f"{seconds:.3f} s of a simulation's clock"
    return datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")


def configuration_texts(drive: JudgedDrive) -> dict[str, str]:
    """Return the YAML text of each node's configuration, truncated where it is very long."""
    texts = {}
    for node, content in drive.columns.configuration.items():
        text = yaml.safe_dump(content, sort_keys=False, width=100)
        cut = "" if len(text) <= MAX_CONFIGURATION else "\n... truncated; complete in the JSON file"
        texts[node] = text[:MAX_CONFIGURATION] + cut
    return texts
