"""Output for readers: self-contained HTML pages, tables for terminal and Markdown, JSON values.

`base.html` is the frame of every page, `macros.html` holds tables, figures and lists.
"""

import argparse
import base64
import math
import re
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape
from rich.console import JustifyMethod
from rich.table import Table
from rich.text import Text

ROOT = Path(__file__).parents[1]
"""Folder of the templates; a template is named relative to it: `comparing/compare.html`."""
FORMATS = ("csv", "svg", "pdf")
NO_NUMBER = "\u2013"
"""Shown in place of a missing value."""
SHORT_LENGTH = 0.0995
"""Lengths below this are shown in millimetres [m]."""
Part = str | float
"""Text, which is escaped unless it is `Markup`, or a number, which is formatted by `num`."""


def render(template: str, **values: Any) -> str:
    """Return a page.

    Args:
        template: Path below `launch_scripts`, such as `comparing/compare.html`.
        values: Variables of the template; strings are escaped unless they are `Markup`.

    Raises:
        jinja2.UndefinedError: The template uses a variable that is not in `values`.
    """
    return str(environment().get_template(template).render(**values))


def num(value: float, pattern: str = "") -> Markup:
    """Return a measured number; see `data`.

    Args:
        value: Any number.
        pattern: Format of the visible text; default: three significant digits, integers in full.
    """
    shown = format(value, pattern or ("d" if isinstance(value, int) else "#.3g"))
    mantissa, e, exponent = shown.partition("e")
    shown = mantissa.rstrip(".") + (f"e{int(exponent)}" if e else "")
    if e and int(exponent) > 0:
        shown = f"{float(shown):,.0f}"
    return data(value, shown)


def data(value: float, shown: str) -> Markup:
    """Return a number with its visible text; the attribute `value` holds all digits."""
    return Markup('<data value="{}">{}</data>').format(repr(value), shown)


def text(parts: Part | Sequence[Part]) -> Markup:
    """Return one part, or several parts joined, as HTML."""
    if isinstance(parts, str):
        return escape(parts)
    if isinstance(parts, (int, float)):
        return num(parts)
    return Markup("").join(text(part) for part in parts)


def terminal_table(
    heads: Sequence[str], rows: Iterable[Sequence[Any]], align: str, title: str = ""
) -> Table:
    """Return a table for the terminal; it shows the text of the cells of an HTML table.

    Args:
        heads: Titles of the columns.
        rows: Cells; see `text`.
        align: `l` or `r` for each column; the last letter holds for all further columns.
        title: Text above the table.
    """
    table = Table(title=Text(title) if title else None, title_justify="left")
    for head, letter in zip(heads, align + align[-1] * len(heads), strict=False):
        justify: JustifyMethod = "right" if letter == "r" else "left"
        table.add_column(Text(head), justify=justify, overflow="fold")
    for row in rows:
        cells = [Text(text(cell).striptags()) for cell in row]
        for cell in cells:
            cell.highlight_regex(r"^.*\*$|\bpass$", "bold green")
            cell.highlight_regex(r"\bfail$|^(lost|gave up) at .*|^refused$", "bold red")
        table.add_row(*cells)
    return table


def markdown_table(
    heads: Sequence[str], rows: Iterable[Sequence[object]], align: str = "r"
) -> list[str]:
    """Return the lines of a table.

    Args:
        heads: Titles of the columns.
        rows: Cells; each is converted by `str`.
        align: `l` or `r` for the columns after the first, which is aligned to the left; the last
            letter holds for all further columns.
    """
    letters = "l" + align + align[-1] * len(heads)
    rule = ["---:" if letter == "r" else "---" for letter in letters[: len(heads)]]
    lines = [[str(cell).replace("|", "\\|") for cell in row] for row in (heads, *rows)]
    head, *body = [f"| {' | '.join(cells)} |" for cells in lines]
    return [head, f"|{'|'.join(rule)}|", *body]


def add_format_option(parser: argparse.ArgumentParser, content: str) -> None:
    """Add the option for further output files."""
    text = f"further output files ({content}); default: none"
    parser.add_argument("--format", nargs="+", choices=FORMATS, default=[], help=text)


def to_json(value: Any) -> Any:
    """Return a value with tuples as lists, and None in place of nan and infinity."""
    if isinstance(value, dict):
        return {key: to_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def source(file: str) -> Markup:
    """Return the text of a style sheet or script below `launch_scripts`, to be inlined."""
    return Markup((ROOT / file).read_text(encoding="utf-8"))  # noqa: S704 (a file of this package)


def length_text(metres: float) -> str:
    """Return a length: millimetres below 0.1 m, such as `4.6 mm`, otherwise metres."""
    if not math.isfinite(metres):
        return NO_NUMBER
    if abs(metres) < SHORT_LENGTH:
        return f"{rounded_text(1e3 * metres)} mm"
    return f"{rounded_text(metres)} m"


def duration_text(seconds: float) -> str:
    """Return a short time: microseconds, milliseconds or seconds."""
    if not math.isfinite(seconds):
        return NO_NUMBER
    for factor, unit in ((1e6, "\u00b5s"), (1e3, "ms")):
        if abs(seconds) * factor < 995.0:
            return f"{rounded_text(factor * seconds)} {unit}"
    return f"{rounded_text(seconds)} s"


def rounded_text(value: float) -> str:
    """Return a number with at most two significant digits behind the point, without an exponent."""
    digits = 0 if abs(value) >= 99.5 else 1 if abs(value) >= 0.995 else 2
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if not float(text) else text


def breakable(name: str) -> Markup:
    """Return a name that a narrow page breaks after `_` and `/` only."""
    return Markup(re.sub(r"([_/])", r"\1<wbr>", str(escape(name))))  # noqa: S704 (escaped)


def command_words(command: str) -> Markup:
    """Return a command that a narrow page breaks between its words only."""
    word = Markup('<span class="word">{}</span>')
    return Markup(" ").join(word.format(each) for each in command.split())


def svg_url(svg: str) -> str:
    """Return a `data:` URL of an SVG picture."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode()}"


@cache
def environment() -> Any:
    """Return the settings, filters and functions of all templates (jinja2.Environment)."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # `--help` needs no pages

    result = Environment(
        loader=FileSystemLoader(ROOT),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    result.filters |= {"num": num, "text": text, "svg_url": svg_url, "length_text": length_text}
    result.filters |= {"breakable": breakable, "command": command_words}
    result.globals["source"] = source
    return result
