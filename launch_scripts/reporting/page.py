"""Report page: one HTML file with tables, charts and the script that plays the drive, and JSON."""

import base64
import gzip
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import plotly
import plotly.graph_objects as go
import yaml
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from ampc_msgs_config import __version__
from ampc_msgs_config.metrics import METRICS, Metric, Value
from ampc_msgs_config.types import RUNGS
from launch_scripts.reporting.charts import OLDEST, draw_events, draw_map, draw_panel
from launch_scripts.reporting.drive import SUMMARY, JudgedDrive
from launch_scripts.reporting.pages import SHORT_LENGTH, render, to_json
from launch_scripts.reporting.panels import EVENTS, PALETTE, PANELS, Panel

MAX_BYTES = 2_950_000
"""Largest size of the page."""
POINTS, FEWEST_POINTS = 2000, 60
"""Points of a line: first choice, which is halved until the page is small enough, and smallest."""
NEVER_FOLDED = {EVENTS.key, "cross_track", "heading", "steering", "speed"}
"""Charts that are open also where all their lines are constant."""
NO_DATA = "\u2013"
YEAR_2000 = 946_684_800
"""Earlier stamps are times of a simulation, not dates [s]."""
MAX_CONFIGURATION = 60_000
"""Longest part of a configuration that is shown [characters]."""
CUT = "\n... truncated; complete in the JSON file"
Rows = list[list[Any]]


def write_report(file: Path, drives: Sequence[JudgedDrive], thresholds: str, command: str) -> None:
    """Write the page, and next to it the metrics as JSON.

    Args:
        file: HTML file to write.
        drives: Content.
        thresholds: Name of the file of thresholds, or nothing.
        command: Text that names the command.

    Raises:
        OSError: The file cannot be written.
        ValueError: The page would be too large.
    """
    now = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
    page = report_page(drives, thresholds, f"{command}, {now}")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(page, encoding="utf-8")
    content = to_json(report_json(drives, thresholds))
    text = json.dumps(content, indent=2, allow_nan=False, default=str)
    file.with_suffix(".json").write_text(text + "\n", encoding="utf-8")


def all_passed(drives: Sequence[JudgedDrive]) -> bool | None:
    """Return whether all thresholds pass; None without thresholds."""
    verdicts = [verdict for drive in drives for verdict in drive.verdicts]
    return all(verdict.passed for verdict in verdicts) if verdicts else None


def report_json(drives: Sequence[JudgedDrive], thresholds: str) -> dict[str, Any]:
    """Return all numbers of the page, in SI units."""
    return {
        "version": __version__,
        "passed": all_passed(drives),
        "thresholds": thresholds or None,
        "drives": [
            {
                "name": drive.name,
                "bag": str(drive.columns.bag),
                "namespace": drive.columns.namespace,
                "start_ns": drive.columns.start_ns,
                "controller": drive.context.controller or None,
                "period": drive.record.period,
                "incomplete": drive.incomplete or None,
                "summary": drive.metrics,
                "verdicts": [each._asdict() | {"passed": each.passed} for each in drive.verdicts],
                "notes": drive.notes,
                "configuration": drive.columns.configuration,
            }
            for drive in drives
        ],
    }


def report_page(drives: Sequence[JudgedDrive], thresholds: str, command: str) -> str:
    """Return the page, with as many points per line as its size allows.

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
    # Charts; all share the time axis.
    drawn = [(panel, draw_panel(panel, drives, points)) for panel in PANELS]
    empty = [panel.title for panel, figure in drawn if not figure.data]
    charts = [(panel, figure) for panel, figure in drawn if figure.data]
    events = draw_events(drives)
    if events is not None:
        charts.append((EVENTS, events))
    begin = min(float(drive.record.time[0]) for drive in drives)
    end = max(float(drive.record.time[-1]) for drive in drives)
    for _, figure in charts:
        figure.update_xaxes(range=[begin, end])
    # Input of the script
    figure, moving = draw_map(drives, points)
    data = {
        "begin": begin,
        "end": end,
        "oldest": OLDEST,
        "period": min(drive.record.period for drive in drives),
        "rungs": [word.replace("_", " ") for word in RUNGS],
        "map": figure.to_plotly_json(),
        "drives": moving,
        "plots": {panel.key: figure.to_plotly_json() for panel, figure in charts},
    }
    # Texts
    facts = [dict(facts_of(drive)) for drive in drives]
    titles = dict.fromkeys(title for each in facts for title in each)
    return render(
        "reporting/report.html",
        drives=drives,
        palette=PALETTE,
        thresholds=thresholds,
        verdict_rows=verdict_rows(drives),
        summary=summary_rows(drives),
        charts=[
            (panel, describe_chart(panel, figure), constant_values(panel, figure))
            for panel, figure in charts
        ],
        empty=empty,
        has_events=events is not None,
        has_ticks=any("rung" in drive.record.tick for drive in drives),
        provenance=[[title, *(each.get(title, NO_DATA) for each in facts)] for title in titles],
        configurations=[configuration_texts(drive) for drive in drives],
        points=points,
        command=command,
        version=__version__,
        plotly_version=plotly.__version__,
        data=compress(json.dumps(data, allow_nan=False)),
        plotly=compress(get_plotlyjs()),
    )


def describe_chart(panel: Panel, figure: go.Figure) -> str:
    """Return text for readers who cannot see the chart: each line with its range."""
    names = []
    for line in figure.data:
        values = np.array([v for v in line.y if v is not None], dtype=float)
        if panel is EVENTS:
            names.append(line.name)
        elif len(values):
            names.append(f"{line.name} from {values.min():.3g} to {values.max():.3g}")
    return f"{panel.title} over time. {'; '.join(dict.fromkeys(names))}."


def constant_values(panel: Panel, figure: go.Figure) -> str:
    """Return the value of each line of a chart without any change; empty: something changes."""
    values: dict[str, None] = {}
    for line in figure.data:
        numbers = {value for value in line.y if value is not None}
        if panel.key in NEVER_FOLDED or len(numbers) > 1:
            return ""
        axis = figure.layout[(line.yaxis or "y").replace("y", "yaxis", 1)]
        _, bracket, unit = str(axis.title.text).partition(" [")
        unit = f" {unit.rstrip(']')}" if bracket else ""
        values |= {f"{line.name} {number:.4g}{unit}": None for number in numbers}
    return ", ".join(values)


def compress(text: str) -> str:
    """Return text as the page expects it: gzip, then base64."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def summary_rows(drives: Sequence[JudgedDrive]) -> Rows:
    """Return the rows of the metrics that at least one drive has: title, a cell per drive, unit."""
    rows: Rows = []
    for metric in map(METRICS.__getitem__, SUMMARY):
        values = [drive.metrics[metric.key] for drive in drives]
        if any(value is not None for value in values):
            scale, unit = scale_of(metric, values)
            shown = [v if isinstance(v, int) or v is None else v * scale for v in values]
            note = Markup("<small>{}</small>").format(metric.note) if metric.note else ""
            cells = [NO_DATA if value is None else value for value in shown]
            rows.append([[metric.title, note], *cells, unit])
    return rows


def scale_of(metric: Metric, values: Sequence[Value]) -> tuple[float, str]:
    """Return factor and unit in which values of all drives are readable: short lengths in mm."""
    largest = max((abs(value) for value in values if value is not None), default=0.0)
    if metric.unit == "m" and largest < SHORT_LENGTH:
        return 1e3 * metric.scale, "mm"
    return metric.scale, metric.unit


def verdict_rows(drives: Sequence[JudgedDrive]) -> Rows:
    """Return the rows of the thresholds, a cell per drive, in the units of their file."""
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
    if not math.isnan(drive.path_noise):
        yield "Path noise", f"{100 * drive.path_noise:.1f} cm"
    gains = columns.configuration.get("controller", {}).get("gains")
    origin = gains.get("provenance") if isinstance(gains, Mapping) else None
    if isinstance(origin, Mapping) and "command" in origin:
        yield "Gains tuned by", str(origin["command"])[:200]
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
    texts = {
        node: yaml.safe_dump(content, sort_keys=False, width=100)
        for node, content in drive.columns.configuration.items()
    }
    most = MAX_CONFIGURATION
    return {node: text[:most] + (CUT if len(text) > most else "") for node, text in texts.items()}
