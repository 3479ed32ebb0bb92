"""Pieces of HTML: measured numbers, tables, figures."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

Part = str | float
Parts = Sequence[Part]
STYLE = Path(__file__).with_name("page.css")
"""Of every page that is one file."""


class Html(str):
    """Text that is HTML already."""


def seen(results: Mapping[str, Any], words: str) -> str:
    """Give words that say what was seen in a full run of the paper's reading; else nothing."""
    meta = results["meta"]
    return "" if meta["quick"] or meta["authors_code"] else words


def num(value: float, pattern: str = "") -> Html:
    """Give a measured number; its element carries the exact value, as `results.json` does."""
    shown = format(value, pattern or ("d" if isinstance(value, int) else "#.3g"))
    mantissa, e, exponent = shown.partition("e")
    shown = mantissa.rstrip(".") + (f"e{int(exponent)}" if e else "")
    if e and int(exponent) > 0:
        shown = f"{float(shown):,.0f}"
    return Html(f'<data value="{value!r}">{shown}</data>')


def text(parts: Parts | Part) -> Html:
    """Join words and numbers: words are escaped unless they are HTML."""
    several = [parts] if isinstance(parts, (str, int, float)) else parts
    return Html("".join(_part(part) for part in several))


def _part(part: Part) -> str:
    if isinstance(part, Html):
        return part
    return escape(part) if isinstance(part, str) else num(part)


def paragraph(*parts: Part) -> Html:
    """Give a paragraph."""
    return Html(f"<p>{text(parts)}</p>\n")


def items(rows: Iterable[Parts | Part]) -> Html:
    """Give a list."""
    return Html("<ul>\n" + "".join(f"<li>{text(row)}</li>\n" for row in rows) + "</ul>\n")


def table(
    heads: Sequence[str],
    rows: Iterable[Sequence[Parts | Part]],
    caption: Parts,
    cards: bool = False,
    title: str = "",
) -> Html:
    """Give a table whose first column names the rows.

    Args:
        heads: Of the columns.
        rows: Cells.
        caption: Below it, in words.
        cards: On a phone each row is a card; otherwise the table scrolls sideways.
        title: The table's own caption, above it.
    """
    style = "" if cards else ' class="n"'
    head = f'<th scope="col">{escape(heads[0])}</th>' + "".join(
        f'<th scope="col"{style}>{escape(name)}</th>' for name in heads[1:]
    )
    body = "".join(f"<tr>{_row(heads, row, style)}</tr>\n" for row in rows)
    kind = ' class="cards"' if cards else ""
    head_line = f"<caption>{escape(title)}</caption>\n" if title else ""
    below = f'<p class="caption">{text(caption)}</p>\n' if caption else ""
    return Html(
        f'<div class="scroll"><table{kind}>\n{head_line}<thead><tr>{head}</tr></thead>\n<tbody>\n'
        f"{body}</tbody></table></div>\n{below}"
    )


def _row(heads: Sequence[str], row: Sequence[Parts | Part], style: str) -> str:
    first, *others = row
    cells = "".join(
        f'<td{style} data-head="{escape(name)}">{text(cell)}</td>'
        for name, cell in zip(heads[1:], others, strict=True)
    )
    return f'<th scope="row">{text(first)}</th>{cells}'


def figure(svg: str, caption: Parts, alt: str) -> Html:
    """Give a figure whose picture is inside the page."""
    data = base64.b64encode(svg.encode()).decode()
    return Html(
        f'<figure><img alt="{escape(alt)}" src="data:image/svg+xml;base64,{data}">\n'
        f"<figcaption>{text(caption)}</figcaption></figure>\n"
    )
