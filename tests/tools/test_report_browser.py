"""Report page in a browser: playing, keys, zoom, and no network access."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from launch_scripts.report import main
from tests.html_pages import CHROMIUM, PATIENCE, check_widths, open_browser
from tests.workshop.bench.bench_report_page import make_bag

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the page of two bags: one with faults at its end, and a shorter one."""
    folder = tmp_path_factory.mktemp("pages")
    bags = [make_bag(folder / "one" / "bag", 0.2, 590.0), make_bag(folder / "two" / "bag", 0.1)]
    assert main([*map(str, bags), "--output", str(folder)]) == 0
    return folder / "report.html"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Start the chromium of the system."""
    with open_browser() as started:
        yield started


@pytest.fixture
def said() -> list[str]:
    """Return the list of console messages, errors and requests of the page."""
    return []


@pytest.fixture
def page(browser: Any, page_file: Path, said: list[str]) -> Iterator[Any]:
    """Open the page offline; afterwards check that it logged and requested nothing."""
    context = browser.new_context(offline=True, viewport={"width": 1100, "height": 800})
    context.set_default_timeout(PATIENCE)
    opened = context.new_page()
    opened.on("console", lambda message: said.append(f"console: {message.text}"))
    opened.on("pageerror", lambda error: said.append(f"error: {error}"))
    opened.on("request", lambda request: said.append(request.url))
    opened.goto(page_file.as_uri())
    opened.wait_for_selector("body[data-ready=yes]", timeout=PATIENCE)
    yield opened
    context.close()
    assert said == [page_file.as_uri()]


def car(page: Any, name: str = "map") -> list[float]:
    """Return the position of the first car's marker."""
    script = """name => { const marker = report.drives[0].trace + 2;
                const trace = document.getElementById(name).data[marker];
                return [trace.x[0], trace.y[0]]; }"""
    place: list[float] = page.evaluate(script, name)
    return place


def clock(page: Any) -> float:
    """Return the displayed time [s]."""
    return float(page.text_content("#clock").split()[0])


def settle(page: Any) -> None:
    """Wait until the cars are at the time of the slider."""
    page.wait_for_function("!drawing")


def test_the_slider_moves_car_outline_and_cursors(page: Any) -> None:
    begin = car(page)
    page.locator("#slider").fill("6000")
    settle(page)
    moved = car(page)
    assert abs(moved[0] - begin[0]) + abs(moved[1] - begin[1]) > 50.0
    assert clock(page) == 6.0
    cursor = "document.getElementById('plot-cross_track').cursor.offsetLeft"
    at_six = page.evaluate(cursor)
    page.locator("#slider").fill("9000")
    assert page.evaluate(cursor) > at_six + 50
    outline = page.evaluate("document.getElementById('near').data[report.drives[0].trace + 1].x")
    settle(page)
    assert len(outline) == 7
    view = page.evaluate("document.getElementById('near')._fullLayout.xaxis.range")
    assert view[0] < car(page, "near")[0] < view[1]


def test_a_metre_is_as_long_on_both_axes_of_the_map(page: Any) -> None:
    script = """() => ['xaxis', 'yaxis'].map(name => { const axis = document.getElementById('map')
                ._fullLayout[name]; return axis._length / (axis.range[1] - axis.range[0]); })"""
    across, up = page.evaluate(script)
    assert abs(across) == pytest.approx(abs(up), rel=0.01)


def test_the_page_is_driven_by_keys_alone(page: Any) -> None:
    page.locator("#slider").focus()
    page.keyboard.press("ArrowRight")
    assert clock(page) == pytest.approx(0.1)
    page.keyboard.press("Shift+ArrowRight")
    assert clock(page) == pytest.approx(5.1)
    page.keyboard.press("ArrowLeft")
    assert clock(page) == pytest.approx(5.0)
    page.keyboard.press("End")
    assert clock(page) == pytest.approx(11.9)
    page.keyboard.press("Home")
    page.keyboard.press("Space")
    page.wait_for_function("now > report.begin + 0.2")
    assert page.get_attribute("#play", "aria-pressed") == "true"
    page.keyboard.press("Space")
    assert page.get_attribute("#play", "aria-pressed") == "false"
    stopped = clock(page)
    page.wait_for_timeout(200)
    assert clock(page) == stopped


def test_focus_is_visible_and_every_control_has_a_name(page: Any) -> None:
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    page.locator("#play").focus()
    page.keyboard.press("Tab")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    for role, name in (("button", "Play"), ("slider", "Time"), ("combobox", "Speed")):
        assert page.get_by_role(role, name=name).count() == 1
    unnamed = "[...document.querySelectorAll('.plot')].filter(p => !p.getAttribute('aria-label'))"
    assert page.evaluate(f"{unnamed}.length") == 0


def test_zooming_one_plot_zooms_all(page: Any) -> None:
    page.evaluate("Plotly.relayout('plot-speed', {'xaxis.range': [2, 4]})")
    ranges = "plots.every(p => p._fullLayout.xaxis.range[0] === 2)"
    page.wait_for_function(ranges)
    page.evaluate("Plotly.relayout('plot-heading', {'xaxis.autorange': true})")
    page.wait_for_function("plots.every(p => p._fullLayout.xaxis.range[1] === report.end)")


def test_the_numbers_at_the_slider_are_those_of_the_bag(page: Any) -> None:
    page.locator("#slider").fill("8000")
    settle(page)
    row = page.locator("#readout tbody tr").first
    assert row.locator("td").nth(3).text_content() == "15.00 m/s"
    assert row.locator("td").nth(4).text_content() == "shifted plan"


def test_nothing_overlaps_on_a_phone_a_tablet_and_a_desktop(browser: Any, page_file: Path) -> None:
    check_widths(browser, page_file, "body[data-ready=yes]")


def test_one_drive_is_readable_at_every_width_and_constant_charts_are_folded(
    browser: Any, tmp_path: Path
) -> None:
    bag = make_bag(tmp_path / "20261128_120000_a_long_name_of_a_drive" / "bag", 0.1)
    assert main([str(bag), "--output", str(tmp_path)]) == 0
    file = tmp_path / "report.html"
    check_widths(browser, file, "body[data-ready=yes]")
    page = browser.new_page()
    page.goto(file.as_uri())
    page.wait_for_selector("body[data-ready=yes]", timeout=PATIENCE)
    folds = page.locator("details.fold")
    titles = [text.split(":")[0] for text in folds.locator("summary").all_text_contents()]
    assert "Constraints" in titles
    assert "Cross-track error" not in titles
    assert "mm" in page.locator(".lead").text_content() or "cm" not in page.content()
    page.close()


def test_an_old_browser_is_told_why_it_sees_no_plots(browser: Any, page_file: Path) -> None:
    context = browser.new_context(offline=True)
    opened = context.new_page()
    opened.add_init_script("delete window.DecompressionStream")
    opened.goto(page_file.as_uri())
    assert "too old" in opened.text_content("#trouble")
    assert opened.locator("#summary tbody tr").count() > 10
    context.close()


def test_the_printed_page_has_no_controls(page: Any) -> None:
    page.emulate_media(media="print")
    assert not page.locator("#controls").is_visible()
    assert page.locator("#map").is_visible()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
