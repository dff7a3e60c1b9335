"""A report in a real browser: opened as a file, without a network, at desktop and phone sizes."""

import io
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.cli import invoke
from tests.cli.processes import meshfit
from tests.small import config_file

sync_api = pytest.importorskip("playwright.sync_api", reason="reports are opened by playwright")
image = pytest.importorskip("PIL.Image", reason="reports need the extra `report`")
pytest.importorskip("pyvista", reason="reports need the extra `report`")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"),
]

SOFTWARE = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WIDTHS = (390, 1440)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser")
    meshfit("run", config_file(folder), "-q", folder=folder)
    meshfit("run", "small.yaml", "-q", "--set", "seeds=[7]", "--set", "fit.optimizer.lr=1e30", folder=folder, code=1)
    assert invoke("report", folder / "runs", "-o", folder / "page", "-q", "--partial").code == 0
    return folder / "page" / "index.html"


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SOFTWARE))
        yield browser
        browser.close()


@pytest.fixture(params=[(width, theme) for width in WIDTHS for theme in ("light", "dark")], ids=str)
def page(request, browser, report):
    """The page, all of it drawn; afterwards, that nothing was asked of a network and nothing was complained of."""
    width, theme = request.param
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=theme, offline=True)
    page, asked, said = context.new_page(), [], []
    page.on("request", lambda one: asked.append(one.url))
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(Path(report).as_uri())
    look_through(page)
    yield page
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    assert said == []
    context.close()


def look_through(page):
    """Bring all that waits for being looked at into view, and wait until it is drawn."""
    for section in page.query_selector_all("main > section"):
        section.scroll_into_view_if_needed()
    page.wait_for_function("document.querySelectorAll('canvas[data-drawn]').length === 3")
    page.wait_for_function("document.querySelectorAll('#curves svg.chart').length > 4")
    page.wait_for_function("document.querySelectorAll('#histograms svg.chart').length > 0")


def pixels(element):
    element.scroll_into_view_if_needed()
    return np.asarray(image.open(io.BytesIO(element.screenshot())).convert("RGB"), dtype=float)


def views(page):
    page.wait_for_timeout(200)
    return [pixels(canvas)[60:-60, 20:-20] for canvas in page.query_selector_all("canvas")]


def test_the_page_is_as_wide_as_the_window_and_draws_all(page):
    width = page.viewport_size["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("#results", "#pictures", "#scenes", "#curves", "#histograms", "#failures", "#machines"):
        assert page.query_selector(name).bounding_box()["width"] <= width
    for picture in page.query_selector_all("img"):
        picture.scroll_into_view_if_needed()
        assert picture.evaluate("image => image.decode().then(() => image.naturalWidth)") > 0
    for view in views(page):
        assert np.abs(view - view[0, 0]).sum(axis=2).max() > 60
        assert (np.abs(view - view[0, 0]).sum(axis=2) > 12).mean() > 0.1


def test_views_are_turned_zoomed_and_put_back_together(page):
    page.query_selector("canvas").scroll_into_view_if_needed()
    first = views(page)
    box = page.query_selector("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.query_selector("canvas").scroll_into_view_if_needed()
    box = page.query_selector("canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 50, y + 30, steps=4)
    page.mouse.up()
    turned = views(page)
    assert all(np.abs(a - b).max() > 20 for a, b in zip(first, turned, strict=True))
    page.query_selector("canvas").press("+")
    zoomed = views(page)
    assert all(np.abs(a - b).max() > 20 for a, b in zip(turned, zoomed, strict=True))
    page.click("#reset-views")
    back = views(page)
    assert all(np.abs(a - b).mean() < 2 for a, b in zip(first, back, strict=True))


def test_charts_have_the_colours_of_the_theme_and_text_that_can_be_read(page):
    text = page.query_selector("#curves svg.chart text")
    soft = page.evaluate("getComputedStyle(document.querySelector('#curves figcaption')).color")
    assert text.evaluate("element => getComputedStyle(element).fill") == soft
    heights = page.evaluate(
        "[...document.querySelectorAll('svg.chart text')].map((t) => t.getBoundingClientRect().height)"
    )
    assert min(heights) > 10
    line = page.query_selector("#curves .row-1 path").evaluate("element => getComputedStyle(element).stroke")
    swatch = page.evaluate(
        "getComputedStyle(document.querySelector('#curves [data-row=\"1\"] .swatch')).backgroundColor"
    )
    assert line == swatch


def test_the_theme_can_be_changed_and_rows_left_out(page):
    shade = "getComputedStyle(document.body).backgroundColor"
    before = page.evaluate(shade)
    page.click("#theme")
    assert page.evaluate(shade) != before
    lines = (
        "[...document.querySelectorAll('#curves .row-0')].filter((line) => line.getBoundingClientRect().width).length"
    )
    assert page.evaluate(lines) > 4
    page.click("#curves .key")
    assert page.evaluate(lines) == 0
    page.click("#curves .key")
    assert page.evaluate(lines) > 4
    page.check("#show-edges")
    assert all(np.ptp(view) > 60 for view in views(page))
