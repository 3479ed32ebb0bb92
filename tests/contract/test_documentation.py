"""Documentation: size of the README, links, commands, and the language of docstrings."""

import ast
import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = [
    README,
    *(ROOT / name for name in ("SECURITY.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "ampc_ros" / "doc").glob("*.md")),
]
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
MODULE = re.compile(r"python -m ((?:tests|launch_scripts|ampc_\w+|sim_vehicle)[\w.]*)")
SCRIPT = re.compile(r"python (launch_scripts/\w+\.py)")
TARGET = re.compile(r"`make (\w+)")
MAX_LINES, MAX_WIDTH = 170, 120
DIALECT = ("Give", "Gives", "Tell", "Tells", "Say", "Says")
"""First words that no docstring may have."""
SOURCES = [
    file
    for folder in ("ampc_msgs_config", "ampc_ros", "sim_vehicle", "launch_scripts", "tests")
    for file in sorted((ROOT / folder).rglob("*.py"))
]


def test_the_readme_is_one_short_page() -> None:
    lines = README.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_LINES
    assert not [line for line in lines if len(line) > MAX_WIDTH and not line.startswith("|")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_relative_link_leads_to_a_file(page: Path) -> None:
    links = [link for link in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in link]
    assert not [link for link in links if not (page.parent / link).exists()]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_exists(page: Path) -> None:
    text, makefile = page.read_text(encoding="utf-8"), (ROOT / "Makefile").read_text()
    assert all(importlib.util.find_spec(name) for name in MODULE.findall(text))
    assert all((ROOT / name).exists() for name in SCRIPT.findall(text))
    assert all(re.search(rf"^{name}:", makefile, re.MULTILINE) for name in TARGET.findall(text))


def test_no_docstring_starts_in_dialect() -> None:
    wrong = [
        f"{file.relative_to(ROOT)}: {text.splitlines()[0]}"
        for file in SOURCES
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(text := node.value.value, str) and text.split()[:1] in [[w] for w in DIALECT]
    ]
    assert not wrong
