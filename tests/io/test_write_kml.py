"""Fixes as KML and KMZ: valid by its schema, heights above the sea as its standard has them, nothing invented."""

from __future__ import annotations

import pathlib
import zipfile
from xml.etree import ElementTree as ET

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from pyogrio import raw

from jaxgeo import Status
from jaxgeo.io.fix_files import write_fixes
from tests.support.made_fixes import ALPS, DATE_LINE, LEVEL, made

KML = {"kml": "http://www.opengis.net/kml/2.2"}
NASTY = '<b>&amp;</b> "q" ü→ ]]>'


def document(path: pathlib.Path) -> bytes:
    if path.suffix != ".kmz":
        return path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() == ["doc.kml"]
        assert archive.testzip() is None
        return archive.read("doc.kml")


def write(path: pathlib.Path, **more) -> ET.Element:
    """Three fixes, of which the second has no coordinates, as a tree of elements."""
    cov = np.stack([LEVEL, np.full((3, 3), np.nan), 100.0 * LEVEL])
    attributes = [{"name": f"r{i}", "note": NASTY, "count": i, "kept": True, "empty": None} for i in range(3)]
    write_fixes(path, made(lost={1: Status.rises_away}), cov_enu=cov, attributes=attributes, **more)
    return ET.fromstring(document(path))


@pytest.mark.costly
@pytest.mark.parametrize("suffix", [".kml", ".kmz", ".KML"])
def test_points_stand_above_the_sea_and_a_lost_fix_has_no_place(tmp_path: pathlib.Path, suffix: str) -> None:
    root = write(tmp_path / f"fixes{suffix}")
    fixes, ellipses = root.findall("kml:Document/kml:Document", KML)
    marks = fixes.findall("kml:Placemark", KML)
    assert [mark.findtext("kml:name", None, KML) for mark in marks] == ["r0", "r1: rises_away", "r2"]
    assert marks[1].find("kml:Point", KML) is None
    assert Status.rises_away.message in (marks[1].findtext("kml:description", None, KML) or "")
    to_sea = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:9707", always_xy=True)
    for i in (0, 2):
        point = marks[i].find("kml:Point", KML)
        assert point is not None
        assert point.findtext("kml:altitudeMode", None, KML) == "absolute"
        found = [float(x) for x in (point.findtext("kml:coordinates", None, KML) or "").split(",")]
        lat, lon, height = ALPS[i]
        assert found[:2] == pytest.approx([lon, lat], abs=1e-10)
        assert found[2] == pytest.approx(to_sea.transform(lon, lat, height)[2], abs=1e-4)  # m
    assert len(ellipses.findall("kml:Placemark/kml:Polygon", KML)) == 2
    assert {mode.text for mode in ellipses.iter(f"{{{KML['kml']}}}altitudeMode")} == {"clampToGround"}
    assert "EGM96" in (root.findtext("kml:Document/kml:description", None, KML) or "")


def test_points_above_a_take_off_of_unknown_height_are_on_the_ground(tmp_path: pathlib.Path) -> None:
    """OGC KML 2.2 (OGC 07-147r2, 2008), 9.20: `absolute` is above the sea, which is not known; clamped it is true."""
    validator = pytest.importorskip("fastkml.validator")
    path = tmp_path / "fixes.kml"
    write_fixes(path, made(), is_above_takeoff=True)
    assert validator.validate(file_to_validate=path)
    root = ET.fromstring(path.read_bytes())
    points = root.findall(".//kml:Point", KML)
    assert [point.findtext("kml:altitudeMode", None, KML) for point in points] == ["clampToGround"] * 3
    for point, (lat, lon, _) in zip(points, ALPS, strict=True):
        found = [float(x) for x in (point.findtext("kml:coordinates", None, KML) or "").split(",")]
        assert found == pytest.approx([lon, lat], abs=1e-10)
    assert "EGM96" not in path.read_text()
    assert "msl" not in path.read_text()


@pytest.mark.parametrize(
    "suffix, place", [(".kml", "kml:Document/kml:Document/kml:Placemark"), (".gpx", ".//{*}trkpt")]
)
def test_fixes_of_one_image_are_told_apart_by_their_pixels(tmp_path: pathlib.Path, suffix: str, place: str) -> None:
    pixels = [("a.jpg", 10.0, 20.5), ("a.jpg", 30.0, 40.0), ("b.jpg", 10.0, 20.5)]
    attributes = [{"name": name, "u": u, "v": v} for name, u, v in pixels]
    path = tmp_path / f"fixes{suffix}"
    write_fixes(path, made(), attributes=attributes)
    names = [one.findtext("{*}name") for one in ET.fromstring(path.read_bytes()).findall(place, KML)]
    assert names == ["a.jpg, pixel 10, 20.5", "a.jpg, pixel 30, 40", "b.jpg"]


def test_texts_survive_and_markup_stays_text(tmp_path: pathlib.Path) -> None:
    root = write(tmp_path / "fixes.kml")
    mark = root.findall("kml:Document/kml:Document/kml:Placemark", KML)[0]
    data = {one.get("name"): one.text for one in mark.iter(f"{{{KML['kml']}}}SimpleData")}
    assert (data["note"], data["count"], data["kept"], data["status"]) == (NASTY, "0", "1", "hit")
    assert "empty" not in data
    table = ET.fromstring(mark.findtext("kml:description", "", KML))
    cells = {row[0].text: row[1].text for row in table}
    heights = ["height above WGS 84, m", "height above mean sea level (EGM96), m"]
    radii = ["CE90, m", "LE90, m", "SE90, m"]
    assert list(cells) == ["latitude, deg", "longitude, deg", *heights, "status", *radii]
    assert cells.pop("status") == data["status_text"]
    columns = ["fix_lat_deg", "fix_lon_deg", "fix_height_m", "fix_height_msl_m", "ce90_m", "le90_m", "se90_m"]
    for name, (title, text) in zip(columns, cells.items(), strict=True):
        places = 7 if "deg" in title else 2
        assert float(text or "") == pytest.approx(float(data[name] or ""), abs=0.5001 * 10.0**-places)


def test_times_are_those_of_placemarks_and_nothing_comes_from_the_net(tmp_path: pathlib.Path) -> None:
    """Valid by KML's schema, which fastkml holds; nothing but namespaces is an address."""
    validator = pytest.importorskip("fastkml.validator")
    path = tmp_path / "fixes.kml"
    times = ["2024-05-10T10:20:31.250Z", None, "no time"]
    write_fixes(path, made(), cov_enu=np.stack([LEVEL] * 3), attributes=[{"time_utc": one} for one in times])
    text = path.read_text()
    assert [line for line in text.splitlines() if "http" in line] == [f'<kml xmlns="{KML["kml"]}">']
    marks = list(ET.fromstring(text).iter(f"{{{KML['kml']}}}Placemark"))
    assert [mark.findtext("kml:TimeStamp/kml:when", None, KML) for mark in marks] == [times[0], None, None] * 2
    assert validator.validate(file_to_validate=path)


@pytest.mark.parametrize("last, count", [("2024-05-10T10:20:32Z", 1), ("2024-05-10T10:20:31Z", 0), (None, 0)])
def test_fixes_with_a_time_each_are_joined_by_a_line(tmp_path: pathlib.Path, last: str | None, count: int) -> None:
    """In order of time, without what has no coordinates; not if two have the same time, or one has none."""
    times = ["2024-05-10T10:20:33Z", "2024-05-10T10:20:31Z", last]
    path = tmp_path / "fixes.kml"
    write_fixes(path, made(), attributes=[{"time_utc": one} for one in times])
    lines = list(ET.fromstring(path.read_bytes()).iter(f"{{{KML['kml']}}}LineString"))
    assert len(lines) == count
    for line in lines:
        words = (line.findtext("kml:coordinates", "", KML)).split()
        places = [tuple(map(float, word.split(",")[:2])) for word in words]
        assert places == [pytest.approx(ALPS[i][1::-1], abs=1e-9) for i in (1, 2, 0)]


@pytest.mark.parametrize("suffix", [".kml", ".kmz"])
def test_gdal_reads_points_areas_and_columns(tmp_path: pathlib.Path, suffix: str) -> None:
    if "LIBKML" not in pyogrio.list_drivers():
        pytest.skip("this GDAL has no driver LIBKML, and its older one reads no columns and no KMZ")
    path = tmp_path / f"fixes{suffix}"
    write(path)
    assert pyogrio.list_layers(path)[:, 0].tolist() == ["Fixes", "Ellipses"]
    known, _, shapes, columns = raw.read(path, layer="Fixes")
    points = [None if shape is None else shapely.from_wkb(shape) for shape in shapes]
    assert points[1] is None
    assert points[0].coords[0] == pytest.approx((11.0, 47.0, 600.0), abs=60.0)
    table = dict(zip(known["fields"], columns, strict=True))
    assert table["count"].tolist() == [0, 1, 2]
    assert table["ce90_m"][2] == pytest.approx(10.0 * table["ce90_m"][0], abs=1e-3)
    _, _, shapes, _ = raw.read(path, layer="Ellipses")
    first, last = (shapely.from_wkb(shape) for shape in shapes)
    assert last.area / first.area == pytest.approx(100.0, rel=1e-3)
    assert first.contains(shapely.Point(11.0, 47.0))


@pytest.mark.costly
@pytest.mark.parametrize("suffix", [".kml", ".kmz"])
def test_it_is_valid_by_the_schema(tmp_path: pathlib.Path, suffix: str) -> None:
    """Of fixes on the date line too, whose outline is in two parts."""
    fastkml = pytest.importorskip("fastkml")
    validator = pytest.importorskip("fastkml.validator")
    pytest.importorskip("lxml")
    path = tmp_path / f"fixes{suffix}"
    write(path)
    texts = [document(path)]
    write_fixes(path, made(DATE_LINE), cov_enu=LEVEL[None])
    texts.append(document(path))
    for text, count in zip(texts, (2, 1), strict=True):
        plain = tmp_path / "plain.kml"
        plain.write_bytes(text)
        assert validator.validate(file_to_validate=plain)
        (content,) = fastkml.KML.from_string(text.decode().split("?>", 1)[1]).features
        folders = content.features
        assert [folder.name for folder in folders] == ["Fixes", "Ellipses"]
        assert len(folders[1].features) == count
    assert folders[1].features[0].geometry.geom_type == "MultiPolygon"


@pytest.mark.costly
def test_the_same_fixes_make_the_same_kmz(tmp_path: pathlib.Path) -> None:
    one, other = tmp_path / "one.kmz", tmp_path / "other.kmz"
    write(one)
    write(other)
    assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize(
    "asked", [{"crs": "EPSG:32632"}, {"heights": "ellipsoid", "crs": "EPSG:4979"}, {"crs": "EPSG:32632+5773"}]
)
def test_another_crs_is_refused(tmp_path: pathlib.Path, asked: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="heights above EGM96, and no others; leave crs and heights out"):
        write(tmp_path / "fixes.kml", **asked)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.costly
def test_its_own_crs_may_be_named(tmp_path: pathlib.Path) -> None:
    left_out = ET.tostring(write(tmp_path / "fixes.kml"))
    assert ET.tostring(write(tmp_path / "fixes.kml", heights="EPSG:5773")) == left_out
    assert ET.tostring(write(tmp_path / "fixes.kml", crs="EPSG:4979")) == left_out


def test_what_xml_cannot_hold_is_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(ValueError, match=r"fixes\.kml: XML cannot hold the character '\\x00'"):
        write_fixes(tmp_path / "fixes.kml", made(), attributes=[{"a": "x\0"}] * 3)
    assert list(tmp_path.iterdir()) == []


def test_numbered_frames_are_named_with_their_times(tmp_path: pathlib.Path) -> None:
    """As the frames of a video; images keep their names, and frames without a time their numbers."""
    rows = [("0", "2024-05-10T10:20:31.500Z"), ("1", None), ("a.jpg", "2024-05-10T10:20:32.000Z")]
    attributes = [{"name": name, "time_utc": time} for name, time in rows]
    for ending, tag in (("kml", "Placemark"), ("gpx", "trkpt")):
        path = tmp_path / f"fixes.{ending}"
        write_fixes(path, made(), attributes=attributes)
        marks = [one for one in ET.fromstring(path.read_bytes()).iter() if one.tag.endswith(tag)]
        assert [one.findtext("{*}name") for one in marks] == ["0, 2024-05-10T10:20:31.500Z", "1", "a.jpg"]
