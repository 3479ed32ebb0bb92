"""Checks of self-contained pages, as text and in the chromium of the system."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from tests.waiting import TIMEOUT

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
OPTIONS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
PATIENCE = 1000.0 * TIMEOUT
"""Wall time after which a wait for the page has failed [ms]."""
WIDTHS = (390, 768, 1400)
"""Widths of a phone, a tablet and a desktop [px]."""
OVERLAPS = """() => {
  const found = [];
  const boxes = (plot, selector) => [...plot.querySelectorAll(selector)]
    .map(each => each.getBoundingClientRect()).filter(box => box.width > 0 && box.height > 0);
  const parts = { legend: ".legend", "tool bar": ".modebar-group", "x numbers": ".xtick text",
    "y numbers": ".ytick text", "x title": ".xtitle, .x2title, .x3title, .x4title",
    "y title": ".ytitle, .y2title, .y3title, .y4title" };
  for (const plot of document.querySelectorAll(".plot.js-plotly-plot")) {
    const area = boxes(plot, ".plot .bglayer rect, .nsewdrag");
    const all = Object.entries(parts).map(([name, selector]) => [name, boxes(plot, selector)]);
    const meets = (a, b) => Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
      && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1;
    all.forEach(([one, first], k) => all.slice(k + 1).forEach(([other, second]) => {
      if (first.some(a => second.some(b => meets(a, b))))
        found.push(`${plot.id}: ${one}, ${other}`);
    }));
    for (const [name, of] of all)
      if (!["tool bar"].includes(name) && of.some(a => area.some(b => meets(a, b))))
        found.push(`${plot.id}: ${name} inside the chart`);
  }
  return found; }"""
"""Script that returns which parts of charts overlap."""


class Elements(HTMLParser):
    """Parser that collects tags with their attributes."""

    def __init__(self, page: str) -> None:
        """Parse a page."""
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Store a tag."""
        self.found.append((tag, dict(attrs)))


def check_that_no_request_leaves(page: str) -> None:
    """Check that no element makes a browser load anything."""
    for tag, attributes in Elements(page).found:
        assert tag not in ("script", "link", "iframe", "object", "base")
        for name in ("src", "href", "srcset", "poster", "action"):
            value = attributes.get(name) or "#"
            assert value.startswith(("#", "data:image/svg+xml;base64,")), (tag, value)
    assert "@import" not in page
    assert "url(" not in page


@contextmanager
def open_browser(*options: str) -> Iterator[Any]:
    """Start the chromium of the system, without a window; options replace the usual ones."""
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=CHROMIUM, args=list(options or OPTIONS)
        )
        yield started
        started.close()


def check_widths(browser: Any, file: Path, ready: str = "main") -> None:
    """Check that nothing of a page overlaps or sticks out, and that all its links lead somewhere.

    Args:
        browser: Started browser.
        file: The page.
        ready: Selector of an element of the complete page.
    """
    for width in WIDTHS:
        context = browser.new_context(offline=True, viewport={"width": width, "height": 800})
        context.set_default_timeout(PATIENCE)
        said: list[str] = []
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))  # noqa: B023
        page.on("pageerror", lambda error: said.append(str(error)))  # noqa: B023
        page.goto(file.as_uri())
        page.wait_for_selector(ready)
        assert not said
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        for fold in page.query_selector_all("details.fold"):
            fold.evaluate("fold => { fold.open = true; }")
            fold.wait_for_selector(".main-svg")
        assert page.evaluate(OVERLAPS) == []
        links = "[...document.querySelectorAll('a[href^=\"#\"]')].map(a => a.hash.slice(1))"
        assert all(
            page.evaluate("id => !!document.getElementById(id)", n) for n in page.evaluate(links)
        )
        context.close()
