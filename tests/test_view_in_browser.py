"""The viewer in a browser, at two sizes, by pointer and by keys; that it asks nothing of another machine."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from PIL import Image
from support.command_files import DJI
from support.drone_image_files import FULL, packet, write_image
from test_report_in_browser import QUIET, SIZES, browser_path, playwright

import jaxgeo
from jaxgeo.plot import words
from jaxgeo.view import ViewData, ViewServer, serve

GROUND = jaxgeo.ConstantHeight(300.0)
FIX = np.array([0xD5, 0x5E, 0x00])  # colour of a fix


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Two images that look the same way, 180 m apart."""
    browser_path()  # nothing is computed without one
    folder = tmp_path_factory.mktemp("images")
    for name, lon in (("one.jpg", "-84.105"), ("two.jpg", "-84.103")):
        write_image(folder / name, packet(DJI | {"drone-dji:GpsLongitude": lon}), make="DJI", size=FULL)
    return jaxgeo.io.read_observations(folder, height_datum="ellipsoid")


@pytest.fixture(scope="module")
def viewer(observed) -> Iterator[ViewServer]:
    with serve(observed, GROUND, title="Two images") as server:
        yield server


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=browser_path(), args=QUIET)
        yield started
        started.close()


@contextlib.contextmanager
def opened(browser, viewer: ViewServer, size: tuple[int, int], scheme: Any = "light") -> Iterator[Any]:
    """The page, ready; when it is left, that only the viewer was asked, and that the console is empty."""
    asked: list[str] = []
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
    page = context.new_page()
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    page.goto(viewer.address)
    page.wait_for_selector("html[data-ready][data-map]", state="attached", timeout=60_000)
    yield page
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0], "nothing sticks out to the side"
    context.close()
    assert [url for url in asked if not url.startswith((viewer.address, "data:", "blob:"))] == []
    assert complaints == []


def answered(page, before: Any) -> dict[str, Any]:
    """The next point shown with its accuracy."""
    page.wait_for_function(
        "before => (p => p && p.ellipse && JSON.stringify([p.u, p.v]) !== before)(jaxgeoView.shown.point)", arg=before
    )
    return page.evaluate("jaxgeoView.shown.point")


def point_of(page) -> Any:
    return page.evaluate("(p => p ? JSON.stringify([p.u, p.v]) : '')(jaxgeoView.shown.point)")


def place_of(observed, u: float, v: float) -> tuple[float, float]:
    """Latitude and longitude in deg of a pixel of the first image."""
    exposure = observed.at(0)[0].exposure
    lat, lon, _ = jaxgeo.locate(exposure.sensor, exposure.motion, (u, v), GROUND).position.to_degrees()
    return float(lat), float(lon)


def pixel_of(observed, lat: float, lon: float) -> tuple[float, float]:
    exposure = observed.at(0)[0].exposure
    place = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=300.0)
    u, v = np.asarray(jaxgeo.project(exposure.sensor, exposure.motion, place).uv)
    return float(u), float(v)


def ce90_of(observed, u: float, v: float) -> float:
    batch = observed.part(0, np.zeros(1, int)).batches[0]
    found = jaxgeo.accuracy(
        batch.sensor, batch.shots, np.array([[u, v]]), GROUND, batch.sources, in_axes=(0, 0, 0, None, 0)
    )
    return float(found.circular[0])


def colour_at(page, stage: str, where: str) -> np.ndarray:
    """What is seen at a point of a pane's world, given in JavaScript."""
    canvas = page.locator(f"#{stage}-canvas")
    x, y = page.evaluate(f"((v, p) => v.{stage}.toScreen(...{where}))(jaxgeoView, jaxgeoView.shown.point)")
    page.wait_for_timeout(100)
    seen = np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB")).astype(float)
    return seen[round(y), round(x)]


def click(page, selector: str, across: float, down: float) -> None:
    page.locator(selector).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])


def check_point(page, observed, point: dict[str, Any]) -> None:
    """The numbers of a point and both of its markers."""
    lat, lon = place_of(observed, point["u"], point["v"])
    assert (point["lat"], point["lon"]) == pytest.approx((lat, lon), abs=2e-7)  # deg; 2 cm, the last digit shown
    circular = ce90_of(observed, point["u"], point["v"])
    assert point["ce"] == pytest.approx(circular, rel=1e-6)
    assert page.locator("#ce").inner_text() == words.length(circular)
    assert page.get_by_text("CE90", exact=True).count() == 1, "one CE90 of a fix"
    for stage, where in (("image", "[p.u, p.v]"), ("map", "v.map.toMap(p.lat, p.lon)")):
        assert np.abs(colour_at(page, stage, where) - FIX).max() < 25.0, stage


@pytest.mark.costly
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_a_click_in_one_pane_marks_the_other(browser, viewer, observed, size: tuple[int, int]) -> None:
    with opened(browser, viewer, size) as page:
        click(page, "#image-canvas", 0.6, 0.6)
        point = answered(page, "")
        assert 1000 < point["u"] < 3800
        check_point(page, observed, point)
        shown = [page.locator(f"#{name}").input_value() for name in ("u", "v", "lat", "lon")]
        assert shown == [f"{point['u']:g}", f"{point['v']:g}", f"{point['lat']:.7f}", f"{point['lon']:.7f}"]
        assert "Visible in 2 of 2 images" in page.locator("#seen-words").inner_text()
        before = point_of(page)
        x, y = page.evaluate("((m, p) => m.toScreen(...m.toMap(p.lat, p.lon)))(jaxgeoView.map, jaxgeoView.shown.point)")
        box = page.locator("#map-canvas").bounding_box()
        click(page, "#map-canvas", (x + 7) / box["width"], (y - 5) / box["height"])
        point = answered(page, before)
        assert (point["u"], point["v"]) == pytest.approx(pixel_of(observed, point["lat"], point["lon"]), abs=0.01)
        check_point(page, observed, point)


@pytest.mark.costly
@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
def test_the_same_by_keys_only(browser, viewer, observed, size: tuple[int, int]) -> None:
    with opened(browser, viewer, size, "dark") as page:
        focus_by_tab(page, "image-canvas")
        for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "Shift+ArrowDown", "Enter"):
            page.keyboard.press(key)
        point = answered(page, "")
        assert (point["u"], point["v"]) == pytest.approx((1999.5 + 1.0, 1499.5 + 10.0), abs=0.051)  # from the middle
        assert (point["lat"], point["lon"]) == pytest.approx(place_of(observed, point["u"], point["v"]), abs=2e-7)
        page.wait_for_timeout(700)  # ms; 500 ms after the cross stops its place would be said, had the answer not come
        spoken = page.locator("#spoken").inner_text()
        assert f"{point['lat']:.7f}° N" in spoken
        assert f"CE90 {words.length(ce90_of(observed, point['u'], point['v']))}" in spoken
        focus_by_tab(page, "map-canvas")
        before = point_of(page)
        for key in ("Shift+ArrowUp", "ArrowRight", "Enter"):
            page.keyboard.press(key)
        moved = answered(page, before)
        assert moved["lat"] > point["lat"]
        assert moved["lon"] > point["lon"]
        assert (moved["u"], moved["v"]) == pytest.approx(pixel_of(observed, moved["lat"], moved["lon"]), abs=0.01)
        focus_by_tab(page, "lat")
        page.keyboard.type("36.3165, -84.1055")  # both into the first field
        before = point_of(page)
        page.keyboard.press("Enter")
        typed = answered(page, before)
        assert (typed["u"], typed["v"]) == pytest.approx(pixel_of(observed, 36.3165, -84.1055), abs=0.01)


def focus_by_tab(page, name: str) -> None:
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == name:
            outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
            assert outline != "none", "what has the focus is seen"
            return
    raise AssertionError(f"Tab does not reach {name}")


@pytest.mark.costly
def test_a_click_while_the_map_is_prepared_is_answered_later(browser, viewer, observed) -> None:
    with ViewServer() as server:
        context = browser.new_context(viewport={"width": 1400, "height": 1000})
        page = context.new_page()
        page.goto(server.address)
        assert "Preparing" in page.locator("#state").inner_text()
        server.show_images(observed)
        page.wait_for_selector("html[data-images]", state="attached")
        click(page, "#image-canvas", 0.5, 0.5)
        assert page.locator("#headline").inner_text() == "Preparing …"
        server.show(ViewData(observed, [GROUND]))
        point = answered(page, "")
        assert (point["lat"], point["lon"]) == pytest.approx(place_of(observed, point["u"], point["v"]), abs=2e-7)
        server.fail("The flight is over.")
        page.reload()
        page.wait_for_selector("#state.error")
        assert page.locator("#state").inner_text() == "The flight is over."
        context.close()


@pytest.mark.costly
def test_a_line_of_sight_without_ground_is_said_in_words(browser, viewer) -> None:
    with opened(browser, viewer, SIZES["phone"]) as page:
        page.locator("#u").fill("12")
        page.locator("#v").fill("-800")
        page.locator("#v").press("Enter")
        page.wait_for_selector("#result.none")
        assert page.locator("#headline").inner_text() == "No fix"
        assert jaxgeo.Status.outside_image.message in page.locator("#result").inner_text()
        assert "°" not in page.locator("#result").inner_text()
        assert not page.locator("#ce").is_visible()
        page.locator("#u").fill("here")
        page.locator("#u").press("Enter")
        assert "as numbers" in page.locator("#result").inner_text()
        page.locator("#lat").fill("36.5")
        page.locator("#lon").fill("-84,1")  # a decimal comma
        page.locator("#lon").press("Enter")
        page.wait_for_selector("#headline:has-text('Not visible')")
        assert "Visible in none of the 2 images." in page.locator("#seen-words").inner_text()
