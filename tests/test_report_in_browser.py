"""A report as a browser shows it: what is seen at two sizes, what a pointer is told, and that nothing is fetched."""

from __future__ import annotations

import contextlib
import io
import os
import pathlib
import shutil
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

from jaxgeo.demo import scene_file
from jaxgeo.io import read_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.plot import words as say
from jaxgeo.report import ReportData, ReportHeader, write_report

pytestmark = pytest.mark.slow

playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
QUIET = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
).split()
SIZES = {"desk": (1400, 1000), "phone": (390, 844)}
PIXELS = [(1200.0, 2400.0), (1200.0, -30000.0)]  # the second is far above the image, which sees no ground there


def browser_path() -> str:
    named = os.environ.get("JAXGEO_TEST_BROWSER")
    found = named or next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is on the PATH, and JAXGEO_TEST_BROWSER names none")
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator:
    path = browser_path()
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=QUIET)
        yield started
        started.close()


@pytest.fixture(scope="module")
def subject() -> ReportData:
    """A pixel of the demonstration's scene whose lines of sight jump, and one that sees nothing."""
    browser_path()  # nothing is computed without one
    scene = read_scene(scene_file())
    assert scene.shot is not None
    dem = read_dem(scene_file().with_name("jacksboro.tif"))
    labels = [{"name": "<i>one</i>"}, {"name": "two"}]
    return ReportData.of(scene.sensor, scene.shot, PIXELS, dem, scene.errors, labels=labels)


@pytest.fixture(scope="module")
def page_file(subject: ReportData, tmp_path_factory) -> pathlib.Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(path, subject, header=ReportHeader("A <b>report</b>", assumed=["Something was assumed."]))
    return path


@contextlib.contextmanager
def opened(browser, path: pathlib.Path, size: tuple[int, int]) -> Iterator:
    """The page, ready; when it is left, that nothing was fetched and that the console is empty."""
    asked: list[str] = []
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": size[0], "height": size[1]})
    page = context.new_page()
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "console", lambda message: complaints.append(message.text) if message.type in ("error", "warning") else None
    )
    page.goto(path.as_uri())
    page.wait_for_selector("html[data-ready]", state="attached", timeout=60_000)
    page.wait_for_timeout(300)
    yield page
    context.close()
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []
    assert complaints == []


def test_a_dark_screen_gets_a_dark_page_and_light_comes_back(browser, page_file: pathlib.Path) -> None:
    """Corners of charts have the colour of the page, and axis labels stand out from it."""
    with opened(browser, page_file, SIZES["desk"]) as page:
        for scheme, is_dark in (("light", False), ("dark", True), ("light", False)):
            page.emulate_media(color_scheme=scheme)
            page.wait_for_timeout(500)
            around = page.evaluate("getComputedStyle(document.body).backgroundColor")
            paper = np.array([int(number) for number in around.removeprefix("rgb(").removesuffix(")").split(",")])
            assert (paper.mean() < 60) == is_dark
            seen = picture(page, "#chart-map")
            np.testing.assert_allclose(seen[-3, 3], paper, atol=2)
            labels = seen[-60:, 60:].reshape(-1, 3).mean(axis=1)  # below the map
            assert (labels.max() > 150) if is_dark else (labels.min() < 100)


def test_on_a_phone_zoom_buttons_are_on_one_line_and_a_cut_table_says_so(browser, page_file: pathlib.Path) -> None:
    with opened(browser, page_file, SIZES["phone"]) as page:
        closer, farther = (page.locator(f"[aria-label={name}]").bounding_box() for name in ("closer", "farther"))
        assert abs(closer["y"] - farther["y"]) < 1.0
        assert page.locator("#table .narrow").is_visible()
    with opened(browser, page_file, SIZES["desk"]) as page:
        assert not page.locator("#table .narrow").is_visible()
        swatches = page.locator("#where .swatch.dots").count()
        assert swatches >= 1, "samples are small dots, the fix a large one"


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_the_image_is_beside_the_map_with_its_pixel(browser, subject: ReportData, tmp_path, size) -> None:
    """On a desk to the right of it, on a phone below; the mark lies on its pixel, light and dark; nothing overflows."""
    file = tmp_path / "image.png"
    Image.new("RGB", (2400, 4800), (40, 90, 160)).save(file)
    path = tmp_path / "report.html"
    write_report(path, subject, header=ReportHeader(notice="CE90 is assumed."), images={0: file, 1: file})
    with opened(browser, path, size) as page:
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert page.locator(".chip").count() == 1, "the second pixel is outside the image"
            photo, mark, chart = (page.locator(one).bounding_box() for one in (".photo", ".mark", "#chart-map"))
            assert abs(photo["width"] - photo["height"]) < 1.0
            assert abs(mark["x"] + 0.5 * mark["width"] - photo["x"] - 0.5 * photo["width"]) < 2.0
            assert abs(mark["y"] + 0.5 * mark["height"] - photo["y"] - 0.5 * photo["height"]) < 2.0
            is_beside = photo["x"] >= chart["x"] + chart["width"]
            is_below = photo["y"] >= chart["y"] + chart["height"]
            assert is_beside == (size[0] > 860)
            assert is_below != is_beside
            assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
            seen = picture(page, ".photo")
            np.testing.assert_allclose(seen[5, 5], [40, 90, 160], atol=6)
            assert page.locator(".notice").is_visible()


def picture(page, selector: str) -> np.ndarray:
    """What is seen of an element, (rows, cols, 3)."""
    page.locator(selector).scroll_into_view_if_needed()
    page.wait_for_timeout(200)
    return np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB"))


def on_map(page, lon: float, lat: float) -> tuple[float, float]:
    """Where a place of the map is in the window, pixels."""
    page.locator("#chart-map").scroll_into_view_if_needed()
    return tuple(
        page.evaluate(
            """([lon, lat]) => {
              const map = Bokeh.documents[0].get_model_by_name("map");
              const view = Bokeh.index.find_one(map) ?? Bokeh.index.get_one(map);
              const box = view.el.getBoundingClientRect();
              return [box.left + view.frame.x_scale.compute(lon), box.top + view.frame.y_scale.compute(lat)];
            }""",
            [lon, lat],
        )
    )


def ranges(page) -> list[float]:
    """West, east, south and north of the map."""
    return page.evaluate(
        """() => {
          const map = Bokeh.documents[0].get_model_by_name("map");
          return [map.x_range.start, map.x_range.end, map.y_range.start, map.y_range.end];
        }"""
    )


def metres_of(shown: list[float]) -> float:
    """Length of a metre north against one east on the map."""
    west, east, south, north = shown
    return (north - south) / ((east - west) * np.cos(np.deg2rad(0.5 * (south + north))))


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_what_is_seen(browser, page_file: pathlib.Path, subject: ReportData, size: tuple[int, int]) -> None:
    lat, lon, height = (float(np.asarray(x)[0]) for x in subject.fixes.position.to_degrees())
    with opened(browser, page_file, size) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0], "nothing sticks out to the side"
        assert page.title() == "A <b>report</b>"
        headline = page.locator(".card .headline").first
        assert headline.is_visible()
        assert headline.inner_text().split() == f"{lat:.7f}° N {-lon:.7f}° W".split()
        card = page.locator(".card").first.inner_text()
        assert "<i>one</i>" in card
        assert f"{height:.2f} m above the WGS 84 ellipsoid" in card
        assert subject.accuracy is not None
        figures = page.locator(".card").first.locator(".figure .value").all_inner_texts()
        radii = (subject.accuracy.circular, subject.accuracy.linear, subject.accuracy.spherical)
        assert figures == [say.length(float(np.asarray(x)[0])) for x in radii]
        without = page.locator(".card").nth(1)
        assert without.locator(".headline").inner_text() == "No fix"
        assert "°" not in without.locator(".headline").inner_text()
        assert page.get_by_text("Something was assumed.").is_visible()
        for name in ("map", "section-0", "cloud-0"):
            box = page.locator(f"#chart-{name} canvas").first.bounding_box()
            assert box is not None
            assert box["width"] > 0.8 * min(size[0], 500), name
            assert box["height"] > 150, name
            colours = picture(page, f"#chart-{name}")
            assert len(np.unique(colours.reshape(-1, 3), axis=0)) > 40, name
        relief = picture(page, "#chart-map")
        middle = relief[relief.shape[0] // 3 : relief.shape[0] // 2, relief.shape[1] // 3 : relief.shape[1] // 2]
        assert middle.std() > 8.0, "the relief is drawn, where the page is a picture"
        row = page.locator("table.fixes tbody tr").first
        assert row.is_visible()
        assert f"{lat:.7f}" in row.inner_text()
        assert page.locator(".budget-row").count() > 5
        assert 0.9 < metres_of(ranges(page)) * size_ratio(page) < 1.1, "a metre is as long north as east"


def size_ratio(page) -> float:
    """Width of the map's frame against its height."""
    return page.evaluate(
        """() => { const m = Bokeh.documents[0].get_model_by_name("map"); return m.inner_width / m.inner_height; }"""
    )


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_the_map_answers_a_pointer(
    browser, page_file: pathlib.Path, subject: ReportData, size: tuple[int, int]
) -> None:
    lat, lon, _ = (float(np.asarray(x)[0]) for x in subject.fixes.position.to_degrees())
    with opened(browser, page_file, size) as page:
        page.mouse.move(*on_map(page, lon, lat))
        tip = page.locator(".bk-tooltip-content")  # in the shadow of the chart
        tip.first.wait_for(timeout=10_000)
        told = tip.all_inner_texts()
        assert len(told) == 1, "one tip at a time"
        assert any(f"{lat:.7f}° N" in one and "CE90" in one for one in told), told
        assert any("<i>one</i>" in one for one in told), "a name is text"
        readout = page.locator("#readout").inner_text()
        assert f"{lat:.3f}" in readout
        assert "ground about" in readout
        before = ranges(page)
        page.mouse.wheel(0, -400)
        page.wait_for_timeout(400)
        closer = ranges(page)
        assert closer[1] - closer[0] < 0.95 * (before[1] - before[0])
        page.get_by_role("button", name="Fix 1").click()
        at_fix = ranges(page)
        assert at_fix[1] - at_fix[0] < 0.3 * (before[1] - before[0])
        assert at_fix[0] < lon < at_fix[1]
        assert at_fix[2] < lat < at_fix[3]
        page.get_by_role("button", name="All").click()
        room = 0.03 * (before[3] - before[2])  # labels of the axes take more or less of it
        assert ranges(page) == pytest.approx(before, abs=room)


def test_layers_bars_and_headers_do_what_they_say(browser, page_file: pathlib.Path) -> None:
    with opened(browser, page_file, SIZES["desk"]) as page:
        with_relief = picture(page, "#chart-map").astype(float)
        page.locator('[data-layer="relief"]').uncheck()
        without = picture(page, "#chart-map").astype(float)
        assert np.mean(np.abs(with_relief - without)) > 10.0
        page.get_by_role("button", name="Fix 1").click()
        assert page.get_by_text("region of samples", exact=True).is_visible()
        with_region = picture(page, "#chart-map").astype(float)
        page.locator('[data-layer="region"]').uncheck()
        changed = np.abs(with_region - picture(page, "#chart-map").astype(float)).max(axis=2) > 20.0
        assert 500 < changed.sum() < 0.2 * changed.size, "its two pieces, and nothing else"
        bar = page.locator(".budget-row").first
        tip = bar.locator(".tip")
        assert not tip.is_visible()
        bar.hover()
        assert tip.is_visible()
        assert "of the variance" in tip.inner_text()
        assert "CE90 without it" not in tip.inner_text(), "the figures of this fix are of samples"
        head = page.locator("table.fixes thead th").filter(has_text="name")
        first = page.locator("table.fixes tbody tr").first
        head.click()
        assert "<i>one</i>" in first.inner_text()
        head.click()
        assert "two" in first.inner_text()
        assert head.get_attribute("aria-sort") == "descending"


def test_a_window_that_changes_keeps_metres_alike(browser, page_file: pathlib.Path) -> None:
    with opened(browser, page_file, SIZES["desk"]) as page:
        page.set_viewport_size({"width": 700, "height": 900})
        page.wait_for_timeout(500)
        assert 0.9 < metres_of(ranges(page)) * size_ratio(page) < 1.1
        assert page.evaluate("document.documentElement.scrollWidth") <= 700


def test_charts_are_whole_on_paper(browser, page_file: pathlib.Path) -> None:
    boxes = """() => [...document.querySelectorAll(".chart")].flatMap(chart => {
      const outer = chart.getBoundingClientRect(), inner = chart.firstElementChild.getBoundingClientRect();
      const gaps = [inner.left - outer.left, outer.right - inner.right, outer.bottom - inner.bottom, outer.right];
      return outer.width ? [gaps] : [];
    })"""
    with opened(browser, page_file, SIZES["desk"]) as page:
        before = page.evaluate(boxes)
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        page.emulate_media(media="print")
        page.set_viewport_size({"width": 688, "height": 1000})  # 182 mm
        page.wait_for_timeout(300)
        on_paper = np.array(page.evaluate(boxes))
        assert len(on_paper) == len(before) > 2
        assert np.all(on_paper[:, :3] > -1.0)  # pixels
        assert np.all(on_paper[:, 3] <= 688.0)
        page.set_viewport_size(dict(zip(("width", "height"), SIZES["desk"], strict=True)))
        page.emulate_media(media="screen")
        page.evaluate("window.dispatchEvent(new Event('afterprint'))")
        page.wait_for_timeout(300)
        np.testing.assert_allclose(page.evaluate(boxes), before, atol=1.0)
