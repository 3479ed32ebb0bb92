"""The tables of a report: summary, thresholds, provenance."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timezone
from html import escape
from typing import Any

import yaml

from launch_scripts.reporting.drive import Judged
from launch_scripts.reporting.lines import PALETTE
from launch_scripts.reporting.page_html import Html, Part, Parts, items, num, paragraph, table, text
from launch_scripts.reporting.summary import QUANTITIES, Verdict

Verdicts = Sequence[list[Verdict]]
UNTOLD = "\u2013"
YEAR_2000 = 946_684_800
"""Stamps before are no dates, but times of a simulation [s]."""
LONGEST = 60_000
"""Of a configuration that is shown whole [characters]."""


def shown(name: str, value: float | None) -> str:
    """Give a quantity of the summary as a person reads it, without its unit."""
    if value is None:
        return UNTOLD
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value * QUANTITIES[name].scale:#.3g}".rstrip(".")


def summary_table(drives: Sequence[Judged]) -> Html:
    """Give the numbers of all drives, a column each."""
    rows: list[list[Parts | Part]] = []
    for name, quantity in QUANTITIES.items():
        values = [drive.summary[name] for drive in drives]
        if any(value is not None for value in values):
            how = Html(f"<small>{escape(quantity.how)}</small>") if quantity.how else ""
            cells = [
                UNTOLD if v is None else num(v if isinstance(v, int) else v * quantity.scale)
                for v in values
            ]
            rows.append([[quantity.label, how], *cells, quantity.unit])
    heads = ["Quantity", *(drive.name for drive in drives), "Unit"]
    untold = "\u2013: the bag does not tell. " if len(drives) > 1 else ""
    caption = f"{untold}The same numbers, in SI units and all digits, stand in the JSON file."
    return table(heads, rows, [caption], title="Numbers of the whole drive")


def verdict_table(drives: Sequence[Judged], judged: Verdicts, file: str) -> Html:
    """Give how each drive stands against the thresholds, in the units of their file."""
    rows: list[list[Parts | Part]] = [
        [
            of_all[0].threshold,
            bound(of_all[0]),
            *([measured(v), " ", badge(v.passed)] for v in of_all),
        ]
        for of_all in zip(*judged, strict=True)
    ]
    heads = ["Threshold", "Bound", *(drive.name for drive in drives)]
    title = '<section id="thresholds" aria-labelledby="th-head"><h2 id="th-head">Thresholds</h2>'
    found = table(heads, rows, [], title=f"Held against {file}")
    return Html(f"{title}\n{found}</section>")


def measured(verdict: Verdict) -> str:
    """Give what was measured, SI as in the file."""
    if verdict.value is None:
        return "not in the bag"
    return f"{verdict.value:.4g} {verdict.unit}".strip()


def bound(verdict: Verdict) -> str:
    """Give what is asked for, SI as in the file."""
    sign = "\u2265" if verdict.at_least else "\u2264"
    return f"{sign} {verdict.limit:.6g} {verdict.unit}".strip()


def badge(passed: bool, words: str = "") -> Html:
    """Give a verdict in words, colour and sign."""
    kind = "pass" if passed else "fail"
    return Html(f'<span class="verdict {kind}">{escape(words or kind)}</span>')


def legend(drives: Sequence[Judged]) -> Html:
    """Give the colours of the bags, where there are several."""
    if len(drives) == 1:
        return Html("")
    entries = [
        f'<li><span class="swatch" style="background:{PALETTE[k % len(PALETTE)]}"></span>'
        f"{escape(drive.name)}</li>"
        for k, drive in enumerate(drives)
    ]
    return Html(f'<ul class="legend" aria-label="Colours of the drives">{"".join(entries)}</ul>')


def provenance(drives: Sequence[Judged]) -> Html:
    """Give where each drive comes from, what is missing, and what the nodes said."""
    facts = [dict(facts_of(drive)) for drive in drives]
    keys = dict.fromkeys(key for each in facts for key in each)
    rows: list[list[Parts | Part]] = [
        [key, *(each.get(key, UNTOLD) for each in facts)] for key in keys
    ]
    heads = ["", *(drive.name for drive in drives)]
    parts = [table(heads, rows, [], cards=True, title="What the bags say about themselves")]
    for drive in drives:
        about = f" about {drive.name}" if len(drives) > 1 else ""
        parts.append(Html(f"<h3>What is missing or odd{escape(about)}</h3>\n"))
        parts.append(items(drive.notes) if drive.notes else paragraph("Nothing."))
        parts += [document(drive, node) for node in drive.columns.configuration]
    return Html("".join(parts))


def facts_of(drive: Judged) -> Iterable[tuple[str, str]]:
    """Give what is known about a drive, in words."""
    known, columns = drive.known, drive.columns
    yield "Bag", f"{columns.bag.resolve().parent.name}/{columns.bag.name}"
    yield "Namespace", columns.namespace or "/"
    yield "Begin", begin(columns.start_ns)
    yield "Version of the controller", known.version or "not in the bag"
    yield "Controller", known.controller or "not in the bag"
    source = "of its settings" if known.settings else "by its stamps"
    yield "Rate", f"{1 / drive.period:.4g} Hz, {source}" if drive.period else UNTOLD
    if known.chassis:
        chassis = known.chassis
        yield "Vehicle", f"{chassis.mass:g} kg, wheelbase {chassis.wheelbase:.4g} m"
    else:
        yield "Vehicle", "not in the bag"
    gains = columns.configuration.get("controller", {}).get("gains")
    origin = gains.get("provenance") if isinstance(gains, Mapping) else None
    if isinstance(origin, Mapping) and "command" in origin:
        yield "Gains", str(origin["command"])[:200]
    yield from simulated(columns.configuration.get("simulator", {}))


def simulated(content: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    """Give what the simulator says about its run, where it was one."""
    scenario = content.get("scenario")
    if isinstance(scenario, Mapping) and "name" in scenario:
        yield "Scenario", str(scenario["name"])
    for key in ("friction", "noise", "seed"):
        if content.get(key) not in (None, ""):
            yield f"Simulator: {key}", str(content[key])[:200]


def begin(start_ns: int) -> str:
    """Give the time of the first command."""
    seconds = start_ns / 1e9
    if seconds < YEAR_2000:
        return f"{seconds:.3f} s of a simulation's clock"
    return datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%d %H:%M:%S UTC")


def document(drive: Judged, node: str) -> Html:
    """Give what a node said about itself, folded."""
    content = yaml.safe_dump(drive.columns.configuration[node], sort_keys=False, width=100)
    cut = "" if len(content) <= LONGEST else "\n... cut; the whole text is in the JSON file"
    head = text([f"{drive.name}: {node}/configuration"])
    body = escape(content[:LONGEST] + cut)
    return Html(f"<details><summary>{head}</summary><pre>{body}</pre></details>\n")
