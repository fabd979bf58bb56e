"""`jaxgeo report`: a page that says what the library found, that asks the network for nothing, and that is small."""

from __future__ import annotations

import dataclasses
import datetime
import html
import json
import math
import pathlib
import re
import sys
from collections import Counter
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from bokeh.plotting import figure
from support.command_runner import CliRunner
from support.drone_image_files import packet, write_image

from jaxgeo import ConstantHeight, Pose, Sensor, Shot
from jaxgeo.cli import app
from jaxgeo.demo import scene_file
from jaxgeo.io._fix_columns import figures_of, rows_of
from jaxgeo.plot import words as say
from jaxgeo.plot.relief import Box
from jaxgeo.report import Detail, ReportData, ReportHeader, details_of, report_html, write_report
from jaxgeo.report.details import chosen, region_of
from jaxgeo.report.map import draw_region, map_of
from jaxgeo.report.places import places_of, rings_of
from jaxgeo.uncertainty import Method, sources
from tests.support import looks
from tests.support.clouds import cloud, normal

DJI = {
    "drone-dji:AbsoluteAltitude": "+700.0",
    "drone-dji:RelativeAltitude": "+99.9",
    "drone-dji:GpsLatitude": "+36.318",
    "drone-dji:GpsLongitude": "-84.105",
    "drone-dji:GimbalYawDegree": "+160.00",
    "drone-dji:GimbalPitchDegree": "-60.00",
    "drone-dji:GimbalRollDegree": "+0.00",
    "drone-dji:CalibratedFocalLength": "3666.67",
}
GROUND = ["--ground", "300", "--camera-datum", "ellipsoid"]
MOST_BYTES = 5_000_000
FROM_THE_NETWORK = re.compile(
    r"""(?:src|href|poster|srcset)\s*=\s*["']?\s*(?:https?:)?//|@import|url\(\s*["']?(?:https?:)?//"""
)
ERRORS = (
    sources.Position.from_ned(north=1.0, east=1.0, down=2.0),
    sources.Attitude.from_degrees(heading=0.1, pitch=0.05, roll=0.05),
)


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def seen(page: str) -> str:
    """The words of a page, without its scripts and its style."""
    body = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.DOTALL)
    return html.unescape(" ".join(re.sub(r"<[^>]*>", " ", body).split()))


def level_sensor() -> tuple[Sensor, Shot]:
    """A camera 800 m over level ground that looks 85 degrees off nadir; its upper rows see the sky."""
    sensor = looks.level_sensor()  # whose programs other tests compile
    pose = Pose.from_degrees(lat=46.0, lon=179.98, height=800.0, heading=90.0)
    return sensor, Shot(pose, sensor.gimbal.readings_from_degrees(outer=0.0, inner=85.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("report")
    write_image(folder / "<b>DJI & co.JPG", packet(DJI), make="DJI")
    return folder


@pytest.fixture(scope="module")
def told(folder: pathlib.Path) -> dict:
    """What --json says of two pixels; the page is beside the image."""
    image = folder / "<b>DJI & co.JPG"
    result = run(
        *("report", image, *GROUND, "--pixel", "10,20", "--pixel", "30,25", "--json"),
        *("-o", folder / "page.html", "--title", "A <script>alert(1)</script> title"),
    )
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def page(folder: pathlib.Path, told: dict) -> str:
    return (folder / "page.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_numbers_are_those_of_locate(folder: pathlib.Path, told: dict, page: str) -> None:
    result = run("locate", folder / "<b>DJI & co.JPG", *GROUND, "--pixel", "10,20", "--pixel", "30,25", "--json")
    located = json.loads(result.stdout)
    assert told["command"] == "report"
    assert told["fixes"] == located["fixes"]
    assert told["assumed"] == located["assumed"]
    text = seen(page)
    for row in located["fixes"]:
        assert f"{row['fix_lat_deg']:.7f}° N" in text
        assert f"{-row['fix_lon_deg']:.7f}° W" in text
        assert f"{row['fix_height_m']:.2f} m above the WGS 84 ellipsoid" in text
        assert f"CE90 {say.length(row['ce90_m'])}" in text
        assert f"LE90 {say.length(row['le90_m'])}" in text
        assert row["accuracy_text"] in text
        assert row["status_text"] in text
    for sentence in located["assumed"]:
        assert sentence in text


@pytest.mark.slow
def test_budget_and_samples_are_told_as_json_and_on_the_page(told: dict, page: str) -> None:
    text = seen(page)
    for fix, detail in zip(told["fixes"], told["details"], strict=True):
        budget, samples = detail["budget"], detail["samples"]
        assert budget["circular_error_m"] == pytest.approx(fix["ce90_m"], abs=5e-5)  # as rounded in the table
        whole = budget["variance_m2"]["horizontal"]
        assert sum(source["variance_m2"]["horizontal"] for source in budget["sources"]) == pytest.approx(whole)
        assert samples["count"] == 20_000
        share = samples["within"]
        assert share["low"] < share["value"] < share["high"]
        assert share["value"] == pytest.approx(0.9, abs=0.03)
        assert f"{100.0 * share['value']:.1f} % of 20 000 samples lie within this CE90" in text
        largest = max((s for source in budget["sources"] for s in source["sigmas"]), key=_level_variance)
        assert largest["name"] in text
        assert f"{100.0 * _level_variance(largest) / whole:.1f}" in text


def _level_variance(sigma: dict) -> float:
    return sigma["variance_m2"]["horizontal"]


@pytest.mark.slow
def test_nothing_is_asked_of_the_network(page: str) -> None:
    outside = re.sub(r"<script\b.*?</script>", "", page, flags=re.DOTALL)
    assert not FROM_THE_NETWORK.search(outside)
    assert not re.search(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=[\"'](?!data:)", page)
    assert "default-src 'none'" in page
    assert "sourceMappingURL" not in page


@pytest.mark.slow
def test_it_is_small(folder: pathlib.Path, page: str) -> None:
    assert 100_000 < (folder / "page.html").stat().st_size < MOST_BYTES


@pytest.mark.slow
def test_names_and_titles_are_text(page: str) -> None:
    assert "<b>DJI" not in page
    assert "<script>alert" not in page
    assert "&lt;b&gt;DJI &amp; co.JPG" in page
    assert "A <script>alert(1)</script> title" in seen(page)


@pytest.mark.slow
def test_what_was_asked_and_with_what_is_told(page: str) -> None:
    text = seen(page)
    for what in ("10,20 and 30,25", "ground 300", "height datum ellipsoid", "jax ", "numpy ", "bokeh "):
        assert what in text


WRONG = [
    (["{image}", *GROUND], ["--output is missing"]),
    (["{image}", *GROUND, "-o", "page.pdf"], ["--output page.pdf", "unsupported file type .pdf", ".html"]),
    (["{image}", *GROUND, "-o", "nowhere/page.html"], ["--output nowhere/page.html", "there is no folder"]),
    (["{image}", *GROUND, "-o", "page.html", "--details", "-1"], ["--details -1", "0 or more"]),
    (["{image}", *GROUND, "-o", "page.html", "--probability", "90"], ["--probability 90", "between 0 and 1"]),
    (["{image}", "--camera-datum", "ellipsoid", "-o", "page.html"], ["give the ground", "--dem FILE"]),
    (["nowhere.JPG", *GROUND, "-o", "page.html"], ["nowhere.JPG", "no such file"]),
    (["--scene", "scene.html", "--ground", "0", "-o", "scene.html"], ["scene.html", "this is an input"]),
]


@pytest.mark.parametrize("arguments, words", WRONG, ids=[words[0] for _, words in WRONG])
def test_mistakes_are_one_line(
    folder: pathlib.Path, tmp_path: pathlib.Path, monkeypatch, arguments: list[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = scene_file().read_text()
    pathlib.Path("scene.html").write_text(scene)
    result = run("report", *(one.format(image=folder / "<b>DJI & co.JPG") for one in arguments))
    assert result.exit_code == 2, result.output
    (line,) = [line for line in result.stderr.splitlines() if "assumed:" not in line]
    assert line.startswith("jaxgeo: ")
    for word in words:
        assert word in line
    assert [path.name for path in tmp_path.iterdir()] == ["scene.html"], "nothing half done is left"
    assert pathlib.Path("scene.html").read_text() == scene


def test_without_the_extra_the_line_says_what_to_install(folder: pathlib.Path, tmp_path, monkeypatch) -> None:
    for name in [name for name in sys.modules if name.startswith("jaxgeo.report")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    result = run("report", folder / "<b>DJI & co.JPG", *GROUND, "-o", tmp_path / "page.html")
    assert result.exit_code == 2
    assert "pip install 'jaxgeo[report]'" in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.costly
def test_a_page_without_any_fix_is_written_and_the_code_says_so(tmp_path: pathlib.Path) -> None:
    image = tmp_path / "DJI_0042.JPG"
    write_image(image, packet(DJI), make="DJI")
    above = ["--camera-datum", "ellipsoid", "--ground", "9000"]
    result = run("report", image, *above, "-o", tmp_path / "page.html")
    assert result.exit_code == 1, result.output
    assert "no pixel has a fix" in result.stderr
    assert "No fix" in seen((tmp_path / "page.html").read_text(encoding="utf-8"))


@pytest.mark.costly
def test_a_pixel_that_sees_the_sky_has_no_numbers(tmp_path: pathlib.Path) -> None:
    """It has its status in words; no place, and nothing about how sure it is."""
    sensor, shot = level_sensor()
    subject = ReportData.of(sensor, shot, (1200.0, 5.0), ConstantHeight(0.0))
    (detail,) = details_of(subject)
    assert (detail.checked, detail.budget) == (None, None)
    assert detail.to_dict()["because"] == "The ray rises above the highest ground without meeting the terrain."
    made = datetime.datetime(2020, 2, 3, 4, 5, tzinfo=datetime.UTC)
    write_report(tmp_path / "sky.html", subject, header=ReportHeader("The sky", made=made), details=[detail])
    text = seen((tmp_path / "sky.html").read_text(encoding="utf-8"))
    assert "No fix" in text
    assert "rises away" in text
    assert detail.to_dict()["because"] in text
    assert "Created 2020-02-03 04:05 UTC" in text
    assert "MGRS" not in text
    assert "CE90 " not in text.split("Definitions")[0]


@pytest.mark.costly
@pytest.mark.parametrize(
    "errors", [None, pytest.param(ERRORS, marks=pytest.mark.slow)], ids=["fixes alone", "with errors"]
)
def test_many_pixels_have_a_summary_and_a_table(errors) -> None:
    """Across the date line, some of them of the sky."""
    sensor, shot = level_sensor()
    uv = np.stack([np.full(40, 1200.0), np.linspace(0.0, 3199.0, 40)], axis=-1)
    labels = [{"name": f"number {k}"} for k in range(40)]
    subject = ReportData.of(sensor, shot, uv, ConstantHeight(0.0), errors, labels=labels)
    found = int(subject.is_fix.sum())
    assert 5 < found < 40
    page = report_html(subject, most=0)
    text = seen(page)
    assert f"{found} of 40 have a fix" in text
    assert page.count("<tr class=") == 40
    assert page.count('<tr class="none">') == 40 - found
    assert ("median" in text) == (errors is not None)
    if errors is not None:
        assert subject.accuracy is not None
        radii = np.asarray(subject.accuracy.circular)[subject.is_fix]
        order = np.flatnonzero(subject.is_fix)[np.argsort(radii)]
        picks = chosen(subject, 3)
        assert [index for index, _ in picks] == [order[len(order) // 2], order[-1], order[0]]
        assert [why for _, why in picks] == ["median CE90", "largest CE90", "smallest CE90"]
        assert say.length(float(radii.max())) in text


@pytest.mark.costly
def test_an_ellipse_is_drawn_where_it_is_true_and_a_region_in_its_place_where_it_is_not() -> None:
    """On level ground; with its figures by samples the same fix has no ellipse, and no circle beside the region."""
    look = looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL  # whose programs other tests compile
    subject = ReportData.of(*look, looks.level_errors())
    (detail,) = details_of(subject)
    assert detail.region is not None
    assert (detail.region.probability, len(detail.region.modes)) == (0.9, 1)
    assert detail.to_dict()["region"]["words"] == detail.region.words
    text = seen(report_html(subject, details=[detail]))
    assert f"Region of the samples: {detail.region.words} The map shows the ellipse of linear propagation" in text
    assert "solid: 90 % ellipse of linear propagation" in text
    assert layers_of(subject, detail) == {"region": 2, "ellipse": 2}
    assert subject.accuracy is not None
    unknown = {name: np.full_like(getattr(subject.accuracy, name), np.nan) for name in ("cov_enu", "bias_enu")}
    of_samples = dataclasses.replace(subject.accuracy, method=np.array([int(Method.samples)]), **unknown)
    sampled = dataclasses.replace(subject, accuracy=of_samples)
    text = seen(report_html(sampled, details=[detail]))
    assert f"{detail.region.words} The map shows this region; an ellipse would be wrong." in text
    assert layers_of(sampled, detail) == {"region": 2}
    assert layers_of(sampled, detail._replace(region=None)) == {"ellipse": 2}, "the circle"
    lost = detail._replace(region=None, no_region="No region.")
    assert "Region of the samples: No region." in seen(report_html(sampled, details=[lost]))


def layers_of(subject: ReportData, detail: Detail) -> dict[str, int]:
    """Number of drawn parts of the regions and ellipses of a map."""
    rows = rows_of(subject.fixes, figures_of("report", subject.fixes, subject.accuracy, None, None, None))
    chart = map_of(subject, [detail], rows, places_of(subject, [detail]), [])
    return Counter(one.name for one in chart.renderers if one.name in ("region", "ellipse"))


def test_a_region_is_drawn_as_it_is() -> None:
    """Its areas with their holes, and its outlines."""
    ring = shapely.Point(0.0, 0.0).buffer(100.0).difference(shapely.Point(0.0, 0.0).buffer(40.0))
    far = shapely.box(500.0, 0.0, 520.0, 10.0)
    chart: Any = figure()
    draw_region(chart, [(*rings_of(one), "words") for one in (ring, far)])
    areas, lines = chart.renderers
    drawn = []
    for xs, ys in zip(areas.data_source.data["xs"], areas.data_source.data["ys"], strict=True):
        outer, *holes = (np.column_stack(part) for part in zip(xs[0], ys[0], strict=True))
        drawn.append(shapely.Polygon(outer, holes))
    assert [one.symmetric_difference(other).area for one, other in zip(drawn, (ring, far), strict=True)] == [0.0, 0.0]
    assert len(lines.data_source.data["xs"]) == 3
    assert list(lines.data_source.data["what"]) == ["words"] * 3


def test_samples_without_a_region_say_why() -> None:
    region, why = region_of(cloud(normal(300, [[1.0, 0.0], [0.0, 1.0]], seed=1), lost=100), 0.9)
    assert region is None
    assert why.startswith("No region holds the truth with 90 %: 25 % of the samples have no ground")


def test_labels_are_one_for_each_pixel() -> None:
    sensor, shot = level_sensor()
    with pytest.raises(ValueError, match="one for each of 1 pixels; got 2"):
        ReportData.of(sensor, shot, (1200.0, 3100.0), ConstantHeight(0.0), labels=[{"name": "a"}, {"name": "b"}])


@pytest.mark.parametrize(
    "value, text",
    [
        (0.0123, "0.0123 m"),
        (1.0, "1.00 m"),
        (9.996, "10.0 m"),
        (137.4, "137 m"),
        (999.6, "1000 m"),
        (16_375.2, "16.4 km"),
        (math.inf, "infinite"),
        (math.nan, "–"),
        (None, "–"),
    ],
)
def test_lengths_in_words(value, text: str) -> None:
    assert say.length(value) == text


def test_degrees_minutes_and_seconds() -> None:
    assert say.sexagesimal(36.26902667, "N", "S") == "36° 16' 08.50\" N"
    assert say.sexagesimal(-0.9999999999, "E", "W") == "1° 00' 00.00\" W"
    assert say.coordinate(-84.5, "E", "W", 3) == "84.500° W"


def test_boxes_are_as_long_as_they_say() -> None:
    box = Box(10.0, 46.0, 10.01, 46.02)
    square = box.squared()
    assert square.sides[0] == pytest.approx(square.sides[1], rel=1e-3)
    assert square.sides[1] == pytest.approx(box.sides[1], rel=1e-3)
    assert box.grown(0.5).sides[0] == pytest.approx(2.0 * box.sides[0], rel=1e-6)
    assert box.grown(0.0, 5000.0).sides[0] == pytest.approx(5000.0, rel=1e-6)
    assert box.sides[1] == pytest.approx(0.02 * 111_150.0, rel=1e-3)
    assert jnp.isfinite(jnp.asarray(square)).all()
