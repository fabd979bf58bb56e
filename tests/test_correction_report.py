"""Page of a mutual correction: what it draws is the correction's, and it asks the network for nothing."""

from __future__ import annotations

import html
import os
import pathlib
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from support.drone_strip import GROUND, ground
from support.surveyed_strip import surveyed

from jaxgeo.adjust import ImagePoints
from jaxgeo.report import ReportHeader, correction_html, write_correction_report
from jaxgeo.report.correction_map import block_map
from jaxgeo.report.residual_maps import camera_maps, image_maps
from jaxgeo.ties import Control, Correction, correct
from tests.test_report import FROM_THE_NETWORK

pytestmark = pytest.mark.costly
WRONG = "<b>p1</b>"
LINE = re.compile(r'<line x1="([-\d.]+)" y1="([-\d.]+)" x2="([-\d.]+)" y2="([-\d.]+)"/>')


@pytest.fixture(scope="module")
def found() -> Correction:
    """With two check points, and a control point with a name like markup that is wrong by 8 m."""
    strip = surveyed(1, check=("p3", "p6"))
    control, marks = strip.control, strip.control.marks
    height = np.array(control.position.height) + 8.0 * (control.name == "p1")
    position = replace(control.position, height=height)
    name, point = (np.where(x == "p1", WRONG, x) for x in (control.name, marks.point))
    return correct(
        strip.given,
        strip.ties,
        control=Control(name, position, control.sigma_enu, ImagePoints(marks.image, point, marks.uv, marks.sigma),
                        control.check),
    )  # fmt: skip


@pytest.fixture(scope="module")
def page(found: Correction) -> str:
    return correction_html(found, ground(), header=ReportHeader("A <i>block</i>", assumed=["An <u>assumption</u>."]))


def test_nothing_is_fetched_and_names_are_text(page: str) -> None:
    assert not FROM_THE_NETWORK.search(page)
    assert "default-src 'none'" in page
    for text in (WRONG, "<i>block</i>", "<u>assumption</u>"):
        assert text not in page
        assert html.escape(text) in page


def test_numbers_are_those_of_the_correction(found: Correction, page: str) -> None:
    text = html.unescape(re.sub(r"<[^>]+>", " ", page))
    assert f"{found.rms_after:.2f} px" in text
    for sentence in found.words().splitlines():
        assert sentence in html.unescape(page)
    residuals = found.control_residuals
    assert residuals is not None
    table = page.split('id="control"')[1].split("</table>")[0]
    rows = [re.findall(r"<td[^>]*>([^<]*)</td>", row) for row in table.split("<tr")[2:]]
    assert [row[0] for row in rows] == [html.escape(name) for name in residuals.name]
    for k, row in enumerate(rows):
        assert row[1] == residuals.role[k]
        assert [float(x) for x in row[3:9]] == pytest.approx([*residuals.enu[k], *residuals.sigma_enu[k]], abs=6e-4)
    assert sum(row[1] == "left out" for row in rows) == 1
    images = page.split('id="table"')[1].split("</table>")[0]
    sigma = found.adjustment.sigma_of_images
    for k, row in enumerate(images.split("<tr")[2:]):
        cells = re.findall(r"<td[^>]*>([^<]*)</td>", row)
        assert cells[0] == found.names[k]
        assert [float(cells[i]) for i in (1, 4, 7)] == pytest.approx(found.moved[k], abs=6e-4)
        assert [float(cells[i]) for i in (3, 6, 9)] == pytest.approx(sigma[k, :3], abs=6e-4)


def test_vectors_are_the_residuals(found: Correction) -> None:
    """Those of all images and those of each, by one factor; the line of reference has the length that it states."""
    observed, residuals = found.adjustment.block.observations, found.adjustment.residuals
    (camera,) = camera_maps(found)
    vectors, means = (camera["svg"].split(f'<g class="{kind}">')[1:] for kind in ("vector", "mean"))
    drawn = np.array([[float(x) for x in LINE.findall(one)[0]] for one in vectors])
    assert np.allclose(drawn[:, :2], observed.uv, atol=0.06)
    off = drawn[:, 2:] - drawn[:, :2]
    factor = float(np.sum(off * residuals) / np.sum(residuals**2))
    assert np.allclose(off, factor * residuals, atol=0.11)
    percent, pixels = camera["reference_percent"], float(camera["reference"].removesuffix(" px"))
    assert percent == pytest.approx(100.0 * pixels * factor / (256.0 + 2.0 * 0.02 * 256.0), rel=0.02)
    side = 256.0 / 12.0
    counts = sum(int(re.findall(r"mean of (\d+)", one)[0]) for one in means)
    cells = np.unique((observed.uv // side).astype(int), axis=0, return_counts=True)[1]
    assert counts == cells[cells >= 3].sum()
    maps, left_out = image_maps(found)
    assert left_out == 0
    assert sorted(one["name"] for one in maps) == sorted(found.names)
    assert sum(one["svg"].count('<g class="vector">') for one in maps) == len(observed)
    assert [one["rms"] for one in maps] == sorted((one["rms"] for one in maps), reverse=True)


def test_footprints_are_where_the_adjusted_images_see_flat_ground(found: Correction) -> None:
    """Corners by the collinearity equations."""
    drawn = block_map(found, ground())
    rings = re.findall(r'class="footprint" d="M([^Z]+)Z"', drawn["svg"])
    assert len(rings) == len(found.names)
    first = np.array([[float(x) for x in ring.split("L")[0].split()] for ring in rings])
    images, camera = found.adjustment.images, found.views.cameras["1"]
    ray = np.append((0.0 - np.asarray(camera.principal_px)) / np.asarray(camera.focal_px), 1.0)
    ray = images.R_frame_from_camera @ ray
    level = GROUND  # of the frame at these distances, to millimetres
    corner = images.centre + ray * ((level - images.centre[:, 2]) / ray[:, 2])[:, None]
    expected = corner[:, :2] * [1.0, -1.0]
    assert np.allclose(first - first[0], expected - expected[0], atol=0.05)


def test_a_page_without_terrain_or_control(found: Correction, tmp_path) -> None:
    alone = replace(found, control=None, control_residuals=None, blunders=[])
    write_correction_report(tmp_path / "page.html", alone)
    text = (tmp_path / "page.html").read_text()
    assert 'id="control"' not in text
    assert 'class="footprint"' not in text
    assert 'class="vector"' in text


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
def test_what_a_browser_shows(page: str, tmp_path: pathlib.Path, scheme, width: int) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="the package playwright is not installed")
    path = os.environ.get("JAXGEO_TEST_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip("no browser on the PATH, and JAXGEO_TEST_BROWSER names none")
    file = tmp_path / "page.html"
    file.write_text(page)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        shown = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme).new_page()
        asked: list[str] = []
        complaints: list[str] = []
        shown.on("request", lambda request: asked.append(request.url))
        shown.on("console", lambda message: complaints.append(message.text))
        shown.on("pageerror", lambda error: complaints.append(str(error)))
        shown.goto(file.as_uri())
        shown.wait_for_selector("html[data-ready]", state="attached")
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        place, svg = (shown.locator(one).bounding_box() for one in (".place", ".place svg"))
        assert abs(place["width"] - svg["width"]) < 4.0
        assert abs(place["height"] - svg["height"]) < 4.0  # else labels lie beside their marks
        colour = shown.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", colour)[:3])) < 150) == (scheme == "dark")
        shown.locator("#table th").nth(1).click()
        east = [float(x) for x in shown.locator("#table tbody tr td:nth-child(2)").all_inner_texts()]
        assert east == sorted(east)
        browser.close()
    assert [one for one in asked if not one.startswith(("file:", "data:"))] == []
    assert complaints == []
