"""Footprints as GeoJSON and GeoPackage: read back they lie where they were seen, and no failure looks like ground."""

from __future__ import annotations

import json
import pathlib
import sqlite3
from xml.etree import ElementTree as ET

import jax.numpy as jnp
import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from pyogrio import raw

from jaxgeo import Fix, Geodetic, Status
from jaxgeo.coverage._footprint import Footprint
from jaxgeo.earth import WGS84, TransverseMercator
from jaxgeo.io import write_footprints
from jaxgeo.io._outlines import runs
from tests.io.test_write_kml import document

ALPS = np.array([[47.02, 11.00], [47.03, 11.04], [47.00, 11.05], [46.995, 11.02], [46.99, 11.01]])  # lat, lon in deg
DATE_LINE = np.array([[-17.0, 179.97], [-17.0, -179.96], [-17.04, -179.95], [-17.05, 179.98]])
DRIVERS = [".geojson", ".gpkg"]


def made(latlon: np.ndarray, *, hidden: tuple[int, ...] = (), lost: dict[int, Status] | None = None) -> Footprint:
    """A footprint through places on the ground, with jumps after some, and some that see no ground."""
    count, lost = len(latlon), lost or {}
    status = np.array([lost.get(i, Status.hit) for i in range(count)], np.int8)
    known = status == Status.hit
    lat, lon = (np.where(known, np.deg2rad(x), np.nan) for x in latlon.T)
    height = np.where(known, 500.0 + 10.0 * np.arange(count), np.nan)
    position = Geodetic(lat=lat, lon=lon, height=height)
    ecef = np.stack([WGS84.to_ecef(Geodetic(lat=x, lon=y, height=z)) for x, y, z in zip(lat, lon, height, strict=True)])
    number = np.where(known, 1.0, np.nan)
    fix = Fix(position, ecef, number, number, number, number, status)
    jumps = np.isin(np.arange(count), hidden)
    whole = Status.crosses_horizon if lost else Status.hit
    projection = TransverseMercator.gauss_krueger(jnp.deg2rad(latlon[0, 1]))
    outline = np.stack([np.asarray(projection.forward(x, y)) for x, y in zip(lat, lon, strict=True)])
    return Footprint(np.zeros((count, 2)), fix, jumps, outline, np.int8(whole), projection)


def read(path: pathlib.Path) -> tuple[dict, list, list[dict]]:
    """What GDAL knows of a file, its geometries, and their attributes."""
    known, _, shapes, columns = raw.read(path)
    names = list(known["fields"])
    rows = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
    return known, [None if shape is None else shapely.from_wkb(shape) for shape in shapes], rows


def assert_same_ring(ring, expected: np.ndarray, atol: float) -> None:
    """The same places in the same order around, whatever the first and the sense."""
    found = np.asarray(ring.coords)[:-1, : expected.shape[1]]
    assert len(found) == len(expected)
    shifts = [np.roll(way, -k, axis=0) for way in (found, found[::-1]) for k in range(len(found))]
    assert min(np.abs(shift - expected).max() for shift in shifts) < atol


@pytest.mark.parametrize("suffix", [*DRIVERS, ".JSON"])
def test_degrees_come_back(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"seen{suffix}"
    write_footprints(path, [made(ALPS), made(ALPS + 1.0)])
    known, shapes, rows = read(path)
    assert pyogrio.list_layers(path)[:, 0].tolist() == ["footprints"]
    assert pyproj.CRS(known["crs"]).equals("EPSG:4326", ignore_axis_order=True)
    for index, (shape, row) in enumerate(zip(shapes, rows, strict=True)):
        assert_same_ring(shape.exterior, ALPS[:, ::-1] + index, 1e-9)  # deg
        assert shape.exterior.is_ccw
        assert not shape.has_z
        assert (row["index"], row["kind"], row["status"]) == (index, "outline", "hit")
    assert [other.name for other in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", DRIVERS)
@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:3857", "EPSG:25832", "EPSG:3035", "EPSG:25832+5773"])
def test_metres_come_back(tmp_path: pathlib.Path, suffix: str, crs: str) -> None:
    path = tmp_path / f"seen{suffix}"
    write_footprints(path, [made(ALPS)], crs=crs)
    known, (shape,), _ = read(path)
    flat = crs.split("+")[0]
    assert pyproj.CRS(known["crs"]).equals(flat, ignore_axis_order=True)
    x, y = pyproj.Transformer.from_crs("EPSG:4326", flat, always_xy=True).transform(ALPS[:, 1], ALPS[:, 0])
    assert_same_ring(shape.exterior, np.stack([x, y], axis=-1), 1e-6)  # m
    assert not shape.has_z


@pytest.mark.parametrize("suffix", DRIVERS)
def test_a_crs_with_ellipsoidal_heights_takes_them(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"seen{suffix}"
    write_footprints(path, [made(ALPS)], crs="EPSG:4979")
    _, (shape,), _ = read(path)
    heights = 500.0 + 10.0 * np.arange(len(ALPS))
    assert_same_ring(shape.exterior, np.column_stack([ALPS[:, ::-1], heights]), 1e-9)


def test_a_crs_of_grads_from_paris(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "seen.gpkg"
    write_footprints(path, [made(ALPS)], crs="EPSG:4807")
    _, (shape,), _ = read(path)
    back = pyproj.Transformer.from_crs("EPSG:4807", "EPSG:4326", always_xy=True)
    lon, lat = back.transform(*np.asarray(shape.exterior.coords).T)
    assert shape.bounds[0] == pytest.approx((11.0 - 2.337229) / 0.9, abs=1e-3)  # grads
    np.testing.assert_allclose(sorted(set(np.round(lat, 6))), sorted(ALPS[:, 0]), atol=1e-5)
    np.testing.assert_allclose(sorted(set(np.round(lon, 6))), sorted(ALPS[:, 1]), atol=1e-5)


def test_a_crs_of_nobody_is_kept_by_a_geopackage_and_refused_by_geojson(tmp_path: pathlib.Path) -> None:
    own = "+proj=tmerc +lat_0=47 +lon_0=11 +k=1 +ellps=GRS80 +towgs84=0,0,0 +units=m +type=crs"
    write_footprints(tmp_path / "seen.gpkg", [made(ALPS)], crs=own)
    _, (shape,), _ = read(tmp_path / "seen.gpkg")
    assert shape.area == pytest.approx(float(made(ALPS).area), rel=1e-5)
    with pytest.raises(ValueError, match=r"GeoJSON names a crs by its code.*write a \.gpkg"):
        write_footprints(tmp_path / "seen.geojson", [made(ALPS)], crs=own)


def test_geojson_in_degrees_is_as_the_standard_says(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "seen.geojson"
    write_footprints(path, [made(ALPS), made(ALPS, lost={2: Status.rises_away})])
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["type"] == "FeatureCollection"
    assert "crs" not in content
    whole, torn = content["features"]
    assert whole["geometry"]["type"] == "Polygon"
    ring = whole["geometry"]["coordinates"][0]
    assert ring[0] == ring[-1]
    assert torn["geometry"] is None


@pytest.mark.parametrize("suffix", DRIVERS)
@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:4979"])
def test_the_date_line_cuts_an_outline_in_two(tmp_path: pathlib.Path, suffix: str, crs: str) -> None:
    path = tmp_path / f"seen{suffix}"
    for turned in (DATE_LINE, np.roll(DATE_LINE, 2, axis=0), DATE_LINE[::-1]):
        write_footprints(path, [made(turned, hidden=(1,))], crs=crs, edges=True)
        _, (area, *lines), rows = read(path)
        assert area.geom_type == "MultiPolygon"
        east, west = sorted(area.geoms, key=lambda part: part.bounds[0], reverse=True)
        assert (east.bounds[2], west.bounds[0]) == (180.0, -180.0)
        assert east.bounds[0] == pytest.approx(179.97, abs=1e-9)
        assert west.bounds[2] == pytest.approx(-179.95, abs=1e-9)
        unwound = shapely.Polygon(np.column_stack([DATE_LINE[:, 1] % 360.0, DATE_LINE[:, 0]]))
        assert area.area == pytest.approx(unwound.area, abs=1e-12)
        assert all(part.exterior.is_ccw for part in area.geoms)
        assert {"hidden", "seen"} == {row["kind_of_edge"] for row in rows[1:]}
        assert sum(one.length for one in lines) == pytest.approx(unwound.length, abs=1e-9)
        assert all(max(abs(one.bounds[0]), abs(one.bounds[2])) <= 180.0 for one in lines)


@pytest.mark.parametrize("crs", ["EPSG:32701", "EPSG:3832"])
def test_a_map_made_for_the_date_line_does_not_cut(tmp_path: pathlib.Path, crs: str) -> None:
    path, footprint = tmp_path / "seen.gpkg", made(DATE_LINE)
    write_footprints(path, [footprint], crs=crs)
    _, (area,), _ = read(path)
    assert area.geom_type == "Polygon"
    scale = 1.0 if crs == "EPSG:32701" else 1.0 / np.cos(np.deg2rad(17.025))
    assert area.area == pytest.approx(float(footprint.area) * scale**2, rel=1e-2)


def test_an_outline_that_ends_at_the_date_line_is_not_cut(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "seen.geojson"
    write_footprints(path, [made(np.array([[10.0, 179.9], [10.0, 180.0], [9.9, 180.0], [9.9, 179.9]]))])
    _, (area,), _ = read(path)
    assert area.geom_type == "Polygon"
    assert area.bounds == pytest.approx((179.9, 9.9, 180.0, 10.0), abs=1e-9)


@pytest.mark.parametrize("lat", [89.9, -89.9])
def test_an_outline_around_a_pole(tmp_path: pathlib.Path, lat: float) -> None:
    """In degrees it takes in the pole; in a polar map it is what was seen."""
    places = np.column_stack([np.full(12, lat), np.linspace(10.0, 370.0, 12, endpoint=False) % 360.0])
    path = tmp_path / "seen.gpkg"
    write_footprints(path, [made(places)])
    _, (area,), _ = read(path)
    assert area.area == pytest.approx(360.0 * 0.1, abs=1e-6)
    assert area.covers(shapely.Point(77.0, np.sign(lat) * 89.95))
    write_footprints(path, [made(places)], crs="EPSG:5041" if lat > 0.0 else "EPSG:5042")
    _, (area,), _ = read(path)
    assert area.geom_type == "Polygon"
    assert area.contains(shapely.Point(2e6, 2e6))


@pytest.mark.parametrize("suffix", DRIVERS)
def test_what_is_not_whole_has_no_polygon(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"seen{suffix}"
    torn = made(ALPS, lost={1: Status.rises_away, 2: Status.rises_away})
    nothing = made(ALPS, lost=dict.fromkeys(range(len(ALPS)), Status.rises_away))
    write_footprints(path, [torn, made(ALPS), nothing], edges=True)
    _, shapes, rows = read(path)
    areas = {row["index"]: shape for shape, row in zip(shapes, rows, strict=True) if row["kind"] == "outline"}
    assert [areas[index] is None for index in range(3)] == [True, False, True]
    row = rows[0]
    assert (row["status"], row["status_text"]) == ("crosses_horizon", Status.crosses_horizon.message)
    assert np.isnan(row["hidden_share"])
    assert np.isnan(row["area_m2"])
    (edge,) = (shape for shape, row in zip(shapes, rows, strict=True) if row["kind"] == "edge" and row["index"] == 0)
    np.testing.assert_allclose(edge.coords, ALPS[[3, 4, 0], ::-1], atol=1e-9)
    write_footprints(path, [nothing])
    assert read(path)[1] == [None]


@pytest.mark.parametrize("suffix", DRIVERS)
def test_edges_say_where_ground_is_hidden(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"seen{suffix}"
    footprint = made(ALPS, hidden=(1, 4))
    write_footprints(path, [footprint], edges=True)
    _, shapes, rows = read(path)
    lines = [(row["kind_of_edge"], shape) for shape, row in zip(shapes, rows, strict=True) if row["kind"] == "edge"]
    expected = {"seen": [[0, 1], [2, 3, 4]], "hidden": [[1, 2], [4, 0]]}
    for kind, runs_ in expected.items():
        found = sorted((np.asarray(shape.coords) for name, shape in lines if name == kind), key=len)
        assert [len(one) for one in found] == [len(run) for run in runs_]
        for run in runs_:
            assert any(len(one) == len(run) and np.abs(one - ALPS[run, ::-1]).max() < 1e-9 for one in found)
    geod = pyproj.Geod(ellps="WGS84")
    after = np.roll(ALPS, -1, axis=0)
    lengths = np.array(geod.inv(ALPS[:, 1], ALPS[:, 0], after[:, 1], after[:, 0])[2])
    assert rows[0]["hidden_share"] == pytest.approx(lengths[[1, 4]].sum() / lengths.sum(), rel=1e-3)
    area, _ = geod.polygon_area_perimeter(ALPS[:, 1], ALPS[:, 0])
    assert rows[0]["area_m2"] == pytest.approx(abs(area), rel=1e-3)
    assert rows[0]["kind_of_edge"] is None


def test_runs_go_around() -> None:
    found = {(label, *run) for label, run in runs(np.array([1, 2, 0, 1, 1]))}
    assert found == {(1, 3, 4, 0, 1), (2, 1, 2)}
    assert [(label, *run) for label, run in runs(np.array([1, 1, 1]))] == [(1, 0, 1, 2, 0)]
    assert list(runs(np.array([0, 0]))) == []


def test_an_outline_that_crosses_itself_is_cut_there(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "seen.gpkg"
    bow = np.array([[47.0, 11.0], [47.01, 11.01], [47.01, 11.0], [47.0, 11.01]])
    write_footprints(path, [made(bow)])
    _, (area,), _ = read(path)
    assert area.geom_type == "MultiPolygon"
    assert area.is_valid
    assert area.area == pytest.approx(0.5 * 1e-4, rel=1e-9)


@pytest.mark.parametrize("suffix", DRIVERS)
def test_attributes_go_along(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"seen{suffix}"
    given = [
        {"image": "a.tif", "strip": 1, "gsd_m": 0.25, "kept": True, "note": None, "count": None},
        {"image": "ü.tif", "strip": np.int32(2), "gsd_m": jnp.asarray(1.0), "kept": False, "note": "late", "count": 7},
    ]
    write_footprints(path, [made(ALPS)] * 2, attributes=given, edges=True)
    _, _, rows = read(path)
    for row in rows:
        one = given[row["index"]]
        assert (row["image"], row["strip"], row["kept"], row["note"]) == tuple(
            one[name] for name in ("image", "strip", "kept", "note")
        )
        assert row["gsd_m"] == one["gsd_m"]
        assert row["count"] == one["count"] or (one["count"] is None and np.isnan(row["count"]))


def test_a_geopackage_is_a_sound_database(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "seen.gpkg"
    write_footprints(path, [made(ALPS)], crs="EPSG:32632")
    with sqlite3.connect(path) as base:
        assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert base.execute("SELECT srs_id, geometry_type_name FROM gpkg_geometry_columns").fetchone() == (
            32632,
            "POLYGON",
        )


WRONG = [
    ({"path": "seen.shp"}, ValueError, r"end in \.geojson, \.json, \.gpkg"),
    ({"path": "seen"}, ValueError, "end in"),
    ({"path": "nowhere/seen.gpkg"}, ValueError, "there is no folder"),
    ({"path": "folder.gpkg"}, ValueError, "this is a folder"),
    ({"footprints": []}, ValueError, "a list of one or more"),
    ({"footprints": made(ALPS)}, ValueError, "a list of one or more; got Footprint"),
    ({"footprints": [ALPS]}, TypeError, "footprints must be a jaxgeo Footprint"),
    ({"crs": "EPSG:0"}, ValueError, "PROJ does not know the crs 'EPSG:0'"),
    ({"crs": "EPSG:5773"}, ValueError, "needs a projected or geographic crs"),
    ({"crs": "EPSG:4978"}, ValueError, "needs a projected or geographic crs"),
    ({"crs": "EPSG:3857", "footprints": [made(ALPS), made(DATE_LINE)]}, ValueError, "tears footprint 1 apart"),
    ({"attributes": [{}, {}]}, ValueError, "one mapping for each of 1 footprints; got 2"),
    ({"footprints": [made(ALPS)] * 2, "attributes": [{"a": 1}, {"b": 1}]}, ValueError, "0 and 1 differ: a, b"),
    ({"attributes": [{"Status": 1}]}, ValueError, "'Status' is one that the file has by itself"),
    ({"attributes": [{"FID": 1}]}, ValueError, "'FID'"),
    ({"attributes": [{"a": [1]}]}, ValueError, "'a' must be all numbers, all texts or all bools; got list"),
    (
        {"footprints": [made(ALPS)] * 2, "attributes": [{"a": 1}, {"a": "x"}]},
        ValueError,
        "'a' must be all numbers, all texts or all bools; got int, str",
    ),
]


@pytest.mark.costly
@pytest.mark.parametrize("suffix", DRIVERS)
@pytest.mark.parametrize("change, error, message", WRONG, ids=[message[:30] for _, _, message in WRONG])
def test_wrong_requests_leave_no_file(tmp_path, change: dict, error: type, message: str, suffix: str) -> None:
    (tmp_path / "folder.gpkg").mkdir()
    given = {"path": f"seen{suffix}", "footprints": [made(ALPS)], **change}
    given["path"] = tmp_path / given["path"]
    with pytest.raises(error, match=message):
        write_footprints(**given)
    assert [other.name for other in tmp_path.iterdir()] == ["folder.gpkg"]


def test_a_failure_keeps_the_file_that_was_there(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "seen.gpkg"
    path.write_text("old")

    def fails(*_, **__) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(raw, "write", fails)
    with pytest.raises(OSError, match=r"seen\.gpkg: it cannot be written: disk full"):
        write_footprints(path, [made(ALPS)])
    assert path.read_text() == "old"
    assert [other.name for other in tmp_path.iterdir()] == ["seen.gpkg"]


@pytest.mark.parametrize("suffix", [".kml", ".kmz"])
def test_kml_has_outlines_and_edges_by_the_names_of_images(tmp_path: pathlib.Path, suffix: str) -> None:
    """Valid by KML's schema; what is incomplete has no outline, and says so by its name."""
    path = tmp_path / f"seen{suffix}"
    seen = [made(ALPS, hidden=(1,)), made(DATE_LINE), made(ALPS, lost={2: Status.rises_away})]
    write_footprints(path, seen, attributes=[{"name": name} for name in "abc"], edges=True)
    text = document(path)
    outlines, edges = ET.fromstring(text).findall("{*}Document/{*}Document")
    names = [mark.findtext("{*}name") for mark in outlines.findall("{*}Placemark")]
    assert names == ["a", "b", "c: crosses_horizon"]
    assert [len(mark.findall(".//{*}Polygon")) for mark in outlines.findall("{*}Placemark")] == [1, 2, 0]
    assert {mark.findtext("{*}name") for mark in edges.findall("{*}Placemark")} == {
        "seen edge of a", "hidden edge of a", "seen edge of b", "seen edge of c"
    }  # fmt: skip
    plain = tmp_path / "plain.kml"
    plain.write_bytes(text)
    assert pytest.importorskip("fastkml.validator").validate(file_to_validate=plain)
    for more, words in (({"crs": "EPSG:32632"}, "KML has longitudes"), ({"style": True}, "KML has a style of its own")):
        with pytest.raises(ValueError, match=words):
            write_footprints(path, seen, **more)
