"""The page in a real browser: silent, wholly visible, zoomed and moved by a real mouse; skipped where there is none."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import page_results
import pytest

from rths_cli.report.page import write_page

sync_api = pytest.importorskip("playwright.sync_api")
BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
PLOTS = ":is(#response-plots, #time-plots)"  # record, storey, its error; table, its error
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a page of a good result, a stopped one of five storeys with a hostile name, and one that ran away."""
    folder = tmp_path_factory.mktemp("browser")
    results = [
        page_results.write(folder / "a.h5"),
        page_results.write(
            folder / "b.h5",
            storeys=5,
            stopped=9_000,
            status="aborted",
            reason=HOSTILE,
            case_name=HOSTILE,
            controller="FF",
        ),
        page_results.write(folder / "c.h5", cut=900, case_name="cut", controller="none"),
    ]
    write_page(results, folder / "page.html", HOSTILE)
    return folder / "page.html"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Yield a browser without a window."""
    with sync_api.sync_playwright() as playwright:
        try:
            started = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        except sync_api.Error as error:
            pytest.skip(f"no browser starts: {str(error).splitlines()[0]}")
        yield started
        started.close()


@pytest.fixture(params=[1280, 390])
def opened(request: pytest.FixtureRequest, browser: Any, file: Path) -> Iterator[Any]:
    """Yield the page at a width; whatever it said, asked of a network or showed as a dialog is a fault."""
    tab = browser.new_page(viewport={"width": request.param, "height": 900})
    said: list[str] = []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("dialog", lambda dialog: said.append(dialog.message))
    tab.on("request", lambda asked: said.append(asked.url) if not asked.url.startswith("file:") else None)
    tab.goto(file.as_uri())
    yield tab
    tab.close()
    assert said == []


def view(tab: Any) -> list[float]:
    """Return the shown range of time in s."""
    words = tab.locator("#time-plots output").inner_text().split()
    return [float(words[0]), float(words[2])]


def over(tab: Any, plot: int = 0) -> dict[str, float]:
    """Return where the area of a plot of time is on the screen."""
    tab.locator(f"{PLOTS} .u-over").nth(plot).scroll_into_view_if_needed()
    return dict(tab.locator(f"{PLOTS} .u-over").nth(plot).bounding_box())


def drag(tab: Any, start: float, end: float, plot: int = 0) -> None:
    """Drag with the mouse from one share of a plot's width to another."""
    box = over(tab, plot)
    height = box["y"] + 0.5 * box["height"]
    tab.mouse.move(box["x"] + start * box["width"], height)
    tab.mouse.down()
    tab.mouse.move(box["x"] + end * box["width"], height, steps=4)
    tab.mouse.up()


def test_the_page_is_no_wider_than_the_screen_and_all_of_it_is_seen(opened: Any) -> None:
    assert opened.evaluate("document.documentElement.scrollWidth <= innerWidth")
    for name in ("verdicts", "errors", "histories", "cases", "provenance"):
        assert opened.locator(f"#{name} > h2").is_visible()
    assert opened.locator("#response-plots canvas").count() == 3
    assert opened.locator("#time-plots canvas").count() == 2
    assert opened.locator("#frequency-plots canvas").count() == 3
    outside = """[...document.querySelectorAll('main *')].filter((e) => !e.closest('.frame, pre, details:not([open])')
        && e.getBoundingClientRect().right > innerWidth + 1).map((e) => e.outerHTML.slice(0, 80))"""
    assert opened.evaluate(outside) == []


def test_the_first_screen_shows_verdict_sketch_record_response_and_error(opened: Any) -> None:
    opened.set_viewport_size({"width": 1400, "height": 1000})
    opened.evaluate("scrollTo(0, 0)")
    for what in (".verdict", "svg.sketch", "#response-plots canvas >> nth=0", "#response-plots canvas >> nth=2"):
        box = opened.locator(what).first.bounding_box()
        assert box is not None and box["height"] > 10 and box["y"] + box["height"] <= 1000, what


def test_plots_are_not_empty(opened: Any) -> None:
    drawn = """[...document.querySelectorAll('.plot canvas')].map((c) => new Set(
        new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size)"""
    assert min(opened.evaluate(drawn)) > 3


def test_dragging_zooms_all_plots_and_a_double_click_shows_all(opened: Any) -> None:
    assert view(opened) == [0, pytest.approx(39.999, rel=1e-3)]
    drag(opened, 0.25, 0.5)
    assert view(opened) == pytest.approx([10.0, 20.0], abs=0.2)
    drag(opened, 0.0, 0.5, plot=4)
    assert view(opened) == pytest.approx([10.0, 15.0], abs=0.2)
    box = over(opened)
    opened.mouse.dblclick(box["x"] + 50, box["y"] + 50)
    assert view(opened) == [0, pytest.approx(39.999, rel=1e-3)]


def test_dragging_with_shift_moves_and_stops_at_the_end(opened: Any) -> None:
    drag(opened, 0.25, 0.5)
    opened.keyboard.down("Shift")
    drag(opened, 0.6, 0.1)
    assert view(opened) == pytest.approx([15.0, 25.0], abs=0.3)
    drag(opened, 0.0, 1.0)
    drag(opened, 0.0, 1.0)
    drag(opened, 0.0, 1.0)
    opened.keyboard.up("Shift")
    assert view(opened) == pytest.approx([0.0, 10.0], abs=0.2)


def test_buttons_zoom_move_and_reset(opened: Any) -> None:
    buttons = opened.locator("#time-plots .zoom button")
    buttons.get_by_text("+").click()
    assert view(opened) == pytest.approx([10.0, 30.0], abs=0.01)
    buttons.get_by_text("\u25b6").click()
    assert view(opened) == pytest.approx([15.0, 35.0], abs=0.01)
    buttons.get_by_text("whole").click()
    assert view(opened) == [0, pytest.approx(39.999, rel=1e-3)]


def test_the_wheel_zooms_with_ctrl_and_scrolls_the_page_without(opened: Any) -> None:
    box = over(opened)
    opened.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    opened.mouse.wheel(0, -50)
    assert view(opened)[1] > 39.9
    box = over(opened)
    opened.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    opened.keyboard.down("Control")
    opened.mouse.wheel(0, -50)
    opened.keyboard.up("Control")
    opened.wait_for_function("document.querySelector('#time-plots output').textContent.startsWith('4')")
    assert view(opened) == pytest.approx([4.0, 36.0], abs=0.2)


def test_another_storey_and_another_result_can_be_chosen(opened: Any) -> None:
    results, storeys = (opened.locator("#controls select").nth(place) for place in range(2))
    assert opened.locator("#response-plots h4").nth(1).inner_text() == "Absolute acceleration, storey 5"  # the roof
    storeys.select_option(index=2)
    assert opened.locator("#response-plots h4").nth(1).inner_text() == "Absolute acceleration, storey 3"
    labels = results.locator("option").all_inner_texts()
    results.select_option(index=next(place for place, label in enumerate(labels) if HOSTILE in label))
    assert storeys.locator("option").count() == 5
    assert HOSTILE in opened.locator("#time-plots .remark").inner_text()
    assert HOSTILE in opened.locator(".verdict:visible").inner_text()
    results.select_option(index=next(place for place, label in enumerate(labels) if "cut" in label))
    assert "SIM-DELAY (cut: click to show)" in opened.locator("#response-plots .u-legend").nth(1).inner_text()


def test_the_cursor_tells_every_line_its_value(opened: Any) -> None:
    box = over(opened, 1)
    told = opened.locator("#response-plots .u-legend").nth(1).locator(".u-value")
    opened.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 20)
    assert min(map(float, told.all_inner_texts())) < 8.0 and float(told.first.inner_text()) == pytest.approx(
        8.0, abs=0.3
    )
    opened.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 20)
    assert told.all_inner_texts()[3] == "-"  # EXP-RTHS of the first result was stopped after 9 s


def test_a_command_is_copied(opened: Any) -> None:
    opened.evaluate("navigator.clipboard.writeText = (text) => { window.copied = text; return Promise.resolve(); }")
    opened.locator("button.copy").last.click()
    assert opened.evaluate("window.copied") == HOSTILE


def test_fingers_move_and_zoom(browser: Any, file: Path) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    tab = context.new_page()
    tab.goto(file.as_uri())
    tab.locator("#time-plots .zoom button").get_by_text("+").click()
    box = over(tab)
    touch = context.new_cdp_session(tab)

    def put(kind: str, *shares: float) -> None:
        points = [{"x": box["x"] + s * box["width"], "y": box["y"] + 60, "id": i} for i, s in enumerate(shares)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    put("touchStart", 0.6)
    for share in (0.5, 0.4, 0.3, 0.2, 0.1):
        put("touchMove", share)
    put("touchEnd")
    assert view(tab)[0] == pytest.approx(20.0, abs=1.5)
    before = view(tab)
    put("touchStart", 0.4, 0.6)
    put("touchMove", 0.3, 0.7)
    put("touchMove", 0.2, 0.8)
    put("touchEnd")
    assert view(tab)[1] - view(tab)[0] == pytest.approx((before[1] - before[0]) / 3, rel=0.1)
    context.close()


def test_dark_and_paper(browser: Any, file: Path, tmp_path: Path) -> None:
    tab = browser.new_page(color_scheme="dark")
    tab.goto(file.as_uri())
    colour = "getComputedStyle(document.body).backgroundColor"
    assert tab.evaluate(colour) == "rgb(22, 25, 28)"
    tab.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert tab.evaluate(colour) == "rgb(255, 255, 255)"
    assert tab.evaluate("document.querySelector('#time-plots .uplot').offsetWidth") == 680
    assert tab.evaluate("document.querySelector('#response-plots .uplot').offsetWidth") == 480  # beside the sketch
    tab.evaluate("dispatchEvent(new Event('afterprint'))")
    assert tab.evaluate(colour) == "rgb(22, 25, 28)"
    paper = tab.pdf(path=tmp_path / "page.pdf", format="A4")
    assert 3 <= paper.count(b"/Type /Page\n") <= 20
    tab.close()
