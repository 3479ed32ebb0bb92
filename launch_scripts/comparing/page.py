"""What a comparison leaves behind: one page that needs no network, JSON, Markdown, a picture."""

import json
from pathlib import Path
from string import Template

from ampc_msgs_config import __version__
from ampc_msgs_config.metrics import LOST
from launch_scripts.comparing.cells import QUANTITIES, Cell, Quantity, best_of
from launch_scripts.comparing.figure import draw_matrix, draw_road, styles
from launch_scripts.comparing.table import Comparison, content, markdown, remarks, shared, short
from launch_scripts.reporting.page_html import STYLE, Html, figure, items, paragraph, table, text
from launch_scripts.reporting.style import save_png, svg
from launch_scripts.run.machine import describe_machine

TEMPLATE = Path(__file__).with_name("compare.html")


def write(comparison: Comparison, quantity: str, folder: Path) -> None:
    """Write all files into a folder that is there."""
    found = json.dumps(content(comparison), indent=1, allow_nan=False) + "\n"
    (folder / "compare.json").write_text(found, encoding="utf-8")
    (folder / "compare.md").write_text(markdown(comparison), encoding="utf-8")
    (folder / "page.html").write_text(page(comparison, quantity), encoding="utf-8")
    save_png(draw_matrix(comparison, quantity), folder / "compare.png")


def page(comparison: Comparison, quantity: str) -> str:
    """Give the whole page."""
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        style=STYLE.read_text(encoding="utf-8"),
        command=text(comparison.command),
        shared=text(shared(comparison.conditions)),
        lost=text(f"{LOST:g} m"),
        overview=overview(comparison, quantity),
        remarks=remark_section(comparison),
        matrices=Html("".join(matrix(comparison, what) for what in QUANTITIES.values())),
        roads=road_section(comparison),
        run=run_section(comparison),
    )


def overview(comparison: Comparison, quantity: str) -> Html:
    """Give the heat map."""
    what = QUANTITIES[quantity]
    caption = (
        f"{what.label}, logarithmic colours; light is small. A frame marks the smallest of a "
        "scenario. Hatched: the car was lost; crossed: the controller cannot take this path."
    )
    drawn = svg(draw_matrix(comparison, quantity))
    return figure(drawn, [caption], f"{what.label} of all controllers in all scenarios.")


def remark_section(comparison: Comparison) -> Html:
    """Say who was lost or gave up, and why."""
    said = remarks(comparison)
    return items(said) if said else paragraph("Everybody kept to every road.")


def matrix(comparison: Comparison, quantity: Quantity) -> Html:
    """Give the table of one quantity."""
    rows = []
    for name, cells in comparison.rows():
        best = best_of(cells, quantity.key)
        rows.append([name, *(_cell(cell, quantity, cell.contender in best) for cell in cells)])
    title = Html(f"<h3>{text(quantity.heading)}</h3>\n")
    return Html(title + table(("scenario", *comparison.labels), rows, [quantity.note]))


def _cell(cell: Cell, quantity: Quantity, best: bool) -> Html:
    if not cell.kept:
        return text(cell.outcome)
    value = cell.numbers[quantity.key]
    shown = Html(f'<data value="{value!r}">{short(value)}</data>')
    return Html(f"<b>{shown}</b>") if best else shown


def road_section(comparison: Comparison) -> Html:
    """Give a figure for each scenario."""
    look, parts = styles(comparison.labels), []
    for name, cells in comparison.rows():
        drawn = draw_road(cells, look)
        parts.append(f"<h3>{text(name)}</h3>\n")
        words = "".join(f" {cell.contender}: {cell.outcome}." for cell in cells if not cell.kept)
        if drawn is None:
            parts.append(paragraph("Nobody could drive here.", words))
            continue
        best = ", ".join(sorted(best_of(cells, "rms_error_m"))) or "nobody alone"
        caption = f"Smallest RMS error: {best}.{words}"
        alt = f"Path, cross-track error and steering of the controllers on {name}."
        parts.append(figure(svg(drawn), [caption], alt))
    return Html("".join(parts))


def run_section(comparison: Comparison) -> Html:
    """Give what is needed to repeat the run."""
    conditions = comparison.conditions._asdict()
    rows = [
        ("command", comparison.command),
        *((key, str(value)) for key, value in conditions.items() if value not in (None, "")),
        *(
            (c.label, f"{c.controller}, gains {c.gain_table or 'none'}")
            for c in comparison.contenders
        ),
        ("version", f"AMPC for ROS 2 {__version__}"),
        *((key, str(value)) for key, value in describe_machine().items() if key != "packages"),
    ]
    return table(
        ("", "value"), rows, ["All numbers, and the gains themselves: compare.json."], True
    )
