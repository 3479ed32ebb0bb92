"""Tables of the benchmark on the screen, as JSON and as Markdown."""

import json
from collections.abc import Sequence
from pathlib import Path as File
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

Row = dict[str, Any]

BEGIN, END = "<!-- bench: begin -->", "<!-- bench: end -->"


class Section(NamedTuple):
    """One table."""

    key: str
    """Key in JSON."""
    title: str
    note: str
    """Conditions of the measurement."""
    rows: list[Row]
    """Rows with the same headings."""


def text(value: Any) -> str:
    """Return a cell as text: three digits, or a dash without a value."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return str(value)


def show(section: Section, console: Console) -> None:
    """Print a table."""
    table = Table(title=section.title, box=SIMPLE_HEAD, title_justify="left")
    for name, value in section.rows[0].items():
        table.add_column(escape(name), justify="left" if isinstance(value, str) else "right")
    for row in section.rows:
        table.add_row(*(escape(text(value)) for value in row.values()))
    console.print(table)
    console.print(f"{escape(section.note)}\n", style="dim")


def bench_markdown(of_machine: Row, sections: Sequence[Section]) -> str:
    """Return all tables as Markdown."""
    packages = ", ".join(f"{name} {version}" for name, version in of_machine["packages"].items())
    parts = [f"{machine_line(of_machine)} {packages}.\n"]
    for section in sections:
        note = f"**{section.title}.** {section.note}".rstrip()
        parts.append(f"{note}\n\n{markdown_table(section.rows)}")
    return "\n".join(parts)


def machine_line(of_machine: Row) -> str:
    """Return a description of the machine."""
    return (
        f"{of_machine['cpu']}, {of_machine['cores']} cores, {of_machine['system']}, "
        f"Python {of_machine['python']}; "
        f"load average {of_machine['load average at the start']} at the start."
    )


def markdown_table(rows: Sequence[Row]) -> str:
    """Return one table as Markdown."""
    headings = list(rows[0])
    lines = ["| " + " | ".join(headings) + " |", "|---" * len(headings) + "|"]
    lines += ["| " + " | ".join(map(text, row.values())) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def put_into(file: File, of_machine: Row, section: Section) -> None:
    """Replace the text between the two marks of a Markdown file by one table.

    Raises:
        ValueError: The marks are missing.
    """
    before, begin, rest = file.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{file}: {BEGIN} and {END} are missing")
    table = f"{machine_line(of_machine)}\n\n{markdown_table(section.rows)}"
    file.write_text(f"{before}{begin}\n{table}{end}{after}", encoding="utf-8")


def read(files: Sequence[File]) -> tuple[Row, list[Section]]:
    """Read `bench.json` files; the machine is that of the first."""
    contents = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    by_key = {key: value for content in contents for key, value in content["sections"].items()}
    sections = [Section(key, **value) for key, value in by_key.items() if key != "thresholds"]
    return contents[0]["machine"], sections


def write(folder: File, of_machine: Row, sections: Sequence[Section]) -> None:
    """Write `bench.json` and `bench.md`."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "machine": of_machine,
        "sections": {s.key: {"title": s.title, "note": s.note, "rows": s.rows} for s in sections},
    }
    encoded = json.dumps(content, indent=2, allow_nan=False) + "\n"
    (folder / "bench.json").write_text(encoded, encoding="utf-8")
    (folder / "bench.md").write_text(bench_markdown(of_machine, sections), encoding="utf-8")
