"""Tracks of exposures: places, heights above the sea and times, as other readers have them.

Held against: GDAL's driver of GPX, KML's schema (fastkml), and PROJ for heights above EGM96.
"""

from __future__ import annotations

import dataclasses
import pathlib
from xml.etree import ElementTree as ET

import numpy as np
import pyproj
import pytest
import shapely
from pyogrio import raw
from support.command_runner import CliRunner

from jaxgeo import Fix, Status
from jaxgeo.cli import app
from jaxgeo.earth import Geodetic
from jaxgeo.io import Acquisition, read_acquisition, write_fixes, write_track
from tests.io.test_flight_logs import airdata, subtitles

ROWS = [{"latitude": str(36.3 + 1e-3 * k), "time(millisecond)": str(1500 + 1000 * k)} for k in (0, 2, 1)]
KML = {"kml": "http://www.opengis.net/kml/2.2", "gx": "http://www.google.com/kml/ext/2.2"}
TIMES = [f"2025-05-04T10:20:{second}.000Z" for second in (31, 32, 33)]


@pytest.fixture
def flight(tmp_path: pathlib.Path) -> Acquisition:
    """Three records, of which the last two are not in order of time."""
    path = tmp_path / "flight.csv"
    path.write_text(airdata(*ROWS), encoding="utf-8")
    return read_acquisition(path, takeoff_height=600.0)


def places() -> np.ndarray:
    """Longitudes, latitudes and heights above EGM96, by PROJ."""
    to_sea = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:9707", always_xy=True)
    return np.array([to_sea.transform(-84.2, 36.3 + 1e-3 * k, 600.0 + 984.252 * 0.3048) for k in range(3)])


def test_gdal_reads_points_and_times_of_gpx(tmp_path: pathlib.Path, flight: Acquisition) -> None:
    path = tmp_path / "track.gpx"
    write_track(path, flight)
    known, _, shapes, columns = raw.read(path, layer="track_points")
    table = dict(zip(known["fields"], columns, strict=True))
    np.testing.assert_allclose(table["ele"], places()[:, 2], atol=1e-3)  # m
    np.testing.assert_array_equal(table["time"], np.array([one[:-1] for one in TIMES], "datetime64[ms]"))
    assert table["name"].tolist() == ["0", "2", "1"]
    found = shapely.get_coordinates(shapely.from_wkb(shapes), include_z=False)
    np.testing.assert_allclose(found, places()[:, :2], atol=1e-9)
    root = ET.parse(path).getroot()
    assert (root.tag, root.get("version")) == ("{http://www.topografix.com/GPX/1/1}gpx", "1.1")


def test_gdal_reads_fixes_of_gpx(tmp_path: pathlib.Path) -> None:
    """Those with coordinates, with their times, and their radii in words."""
    path = tmp_path / "fixes.gpx"
    lat, lon, height = (
        np.radians([36.3, np.nan, 36.302]),
        np.radians([-84.2, np.nan, -84.2]),
        np.array([300.0, np.nan, 310.0]),
    )
    status = np.array([Status.hit, Status.rises_away, Status.hit], np.int8)
    number = np.zeros(3)
    fixes = Fix(Geodetic(lat=lat, lon=lon, height=height), np.zeros((3, 3)), number, number, number, number, status)
    rows = [{"name": name, "time_utc": time} for name, time in zip("abc", TIMES, strict=True)]
    write_fixes(path, fixes, attributes=rows, cov_enu=np.stack([np.diag([4.0, 4.0, 1.0])] * 3))
    known, _, shapes, columns = raw.read(path, layer="track_points")
    table = dict(zip(known["fields"], columns, strict=True))
    assert table["name"].tolist() == ["a", "c"]
    said = [text.split(", SE90")[0] for text in table["desc"]]
    assert said == ["CE90 4.29 m, LE90 1.64 m"] * 2  # 2 m times 2.146 (Rayleigh), 1 m times 1.645
    np.testing.assert_array_equal(table["time"], np.array([TIMES[0][:-1], TIMES[2][:-1]], "datetime64[ms]"))
    to_sea = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:9707", always_xy=True)
    expected = [to_sea.transform(-84.2, 36.3, 300.0), to_sea.transform(-84.2, 36.302, 310.0)]
    np.testing.assert_allclose(shapely.get_coordinates(shapely.from_wkb(shapes)), np.array(expected)[:, :2], atol=1e-9)
    np.testing.assert_allclose(table["ele"], np.array(expected)[:, 2], atol=1e-3)  # m
    with pytest.raises(ValueError, match="GPX has longitudes and latitudes on WGS 84"):
        write_fixes(path, fixes, crs="EPSG:32616")


def test_kml_is_valid_by_its_schema_with_and_without_times(tmp_path: pathlib.Path, flight: Acquisition) -> None:
    validator = pytest.importorskip("fastkml.validator")
    path = tmp_path / "track.kml"
    write_track(path, flight)
    assert validator.validate(file_to_validate=path)
    track = ET.parse(path).getroot().find(".//gx:Track", KML)
    assert track is not None
    assert [one.text for one in track.findall("kml:when", KML)] == TIMES
    found = np.array([(one.text or "").split() for one in track.findall("gx:coord", KML)], float)
    np.testing.assert_allclose(found, places(), atol=1e-3)
    clip = tmp_path / "clip.srt"
    clip.write_text(subtitles({}, {}), encoding="utf-8")  # its times are of an unknown zone
    write_track(path, read_acquisition(clip, takeoff_height=600.0))
    assert validator.validate(file_to_validate=path)
    assert ET.parse(path).getroot().find(".//kml:LineString", KML) is not None
    assert "when" not in path.read_text()


def test_the_command_line_writes_tracks(tmp_path: pathlib.Path, flight: Acquisition) -> None:
    output = tmp_path / "track.gpx"
    line = ["inspect", flight.path, "--takeoff-height", "600", "-o"]
    assert CliRunner().invoke(app, [*line, str(output)]).exit_code == 0
    assert output.read_text().count("<trkpt") == 3
    refused = CliRunner().invoke(app, [*line, str(tmp_path / "track.shp")])
    assert refused.exit_code == 2
    assert "use .csv, .gpx or .kml" in refused.stderr
    with pytest.raises(ValueError, match=r"tracks are written to files that end in \.gpx, \.kml"):
        write_track(tmp_path / "track.csv", flight)


def test_tracks_above_a_take_off_of_unknown_height_claim_no_sea_level(tmp_path: pathlib.Path) -> None:
    """GPX 1.1 (Topografix, 2004): `ele` may be left out. KML 2.2 (OGC, 2008): `clampToGround` ignores heights, which
    above the ground below would be wrong over hills."""
    path = tmp_path / "flight.csv"
    path.write_text(airdata(*ROWS), encoding="utf-8")
    line = ["inspect", str(path), "--takeoff-height", "0", "-o"]
    for name in ("track.kml", "track.gpx"):
        assert CliRunner().invoke(app, [*line, str(tmp_path / name)]).exit_code == 0
    track = ET.parse(tmp_path / "track.kml").getroot().find(".//gx:Track", KML)
    assert track is not None
    assert track.findtext("kml:altitudeMode", None, KML) == "clampToGround"
    found = np.array([(one.text or "").split() for one in track.findall("gx:coord", KML)], float)
    np.testing.assert_array_equal(found[:, 2], 0.0)
    assert "<ele>" not in (tmp_path / "track.gpx").read_text()
    for one in ("track.kml", "track.gpx"):
        assert "sea level" not in (tmp_path / one).read_text()
    assert CliRunner().invoke(app, [*line, str(tmp_path / "shots.csv")]).exit_code == 0
    assert "height_datum" not in (tmp_path / "shots.csv").read_text()


@pytest.mark.parametrize("above", [False, True], ids=["above the sea", "above the take-off"])
@pytest.mark.parametrize("timed", [True, False])
def test_a_single_exposure_is_a_point_of_kml(tmp_path: pathlib.Path, timed: bool, above: bool) -> None:
    """By KML's schema (OGC, 2008) the time of a placemark is before its point; GDAL reads a point, not a line."""
    validator = pytest.importorskip("fastkml.validator")
    source = tmp_path / "flight.csv"
    source.write_text(airdata(ROWS[0]), encoding="utf-8")
    found = dataclasses.replace(read_acquisition(source, takeoff_height=600.0), time_is_utc=timed)
    path = tmp_path / "track.kml"
    write_track(path, found, is_above_takeoff=above)
    assert validator.validate(file_to_validate=path)
    (mark,) = ET.parse(path).getroot().iter(f"{{{KML['kml']}}}Placemark")
    assert mark.findtext("kml:Point/kml:altitudeMode", None, KML) == ("clampToGround" if above else "absolute")
    assert mark.findtext("kml:TimeStamp/kml:when", None, KML) == (TIMES[0] if timed else None)
    text = mark.findtext("kml:Point/kml:coordinates", "", KML)
    np.testing.assert_allclose([float(one) for one in text.split(",")], places()[0, : 2 if above else 3], atol=1e-3)
    _, _, shapes, _ = raw.read(path)
    assert [one.geom_type for one in shapely.from_wkb(shapes)] == ["Point"]
