"""Fixes as files: read back they lie where they were, in the CRS and above the datum that the file names."""

from __future__ import annotations

import csv
import json
import pathlib
import sqlite3
from typing import Any

import jax
import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from pyogrio import raw

import jaxgeo
from jaxgeo import Fix, Status
from jaxgeo.io import VerticalDatumError, _fix_columns, _map_crs
from jaxgeo.io.fix_files import write_fixes
from jaxgeo.uncertainty import Accuracy, Method, accuracy
from jaxgeo.uncertainty.method_selection import Diagnostics
from jaxgeo.uncertainty.metrics import circular_error, linear_error, spherical_error
from tests.support import looks
from tests.support.made_fixes import ALPS, DATE_LINE, LEVEL, made

SUFFIXES = [".csv", ".geojson", ".JSON", ".gpkg", ".parquet"]
MAPS = [".geojson", ".gpkg", ".parquet"]


def read(path: pathlib.Path) -> tuple[list[dict[str, Any]], list[Any], list[Any]]:
    """Rows, points and outlines of a file, by the library of its format; of a CSV all texts."""
    if path.suffix == ".csv":
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        places = [[row[f"map_{axis}"] for axis in "xyz"] for row in rows]
        return rows, [shapely.Point(*map(float, place)) if all(place) else None for place in places], []
    if path.suffix.lower() in (".geojson", ".json"):
        features = json.loads(path.read_text(encoding="utf-8"))["features"]
        fixes = [one for one in features if one["properties"]["kind"] == "fix"]
        shapes = [
            [one["geometry"] and shapely.geometry.shape(one["geometry"]) for one in some] for some in (fixes, features)
        ]
        return [one["properties"] for one in fixes], shapes[0], shapes[1][len(fixes) :]
    if path.suffix == ".gpkg":
        _, points, rows = layer(path, "fixes")
        outlines = layer(path, "ellipses")[1] if len(pyogrio.list_layers(path)) > 1 else []
        return rows, points, outlines
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = parquet.read_table(path).to_pylist()
    shapes = [
        [one and shapely.from_wkb(one) for one in (row.pop(name, None) for row in rows)]
        for name in ("geometry", "ellipse")
    ]
    return rows, shapes[0], [one for one in shapes[1] if one is not None]


def layer(path: pathlib.Path, name: str) -> tuple[dict, list, list[dict]]:
    """What GDAL knows of a layer, its geometries, and their attributes."""
    known, _, shapes, columns = raw.read(path, layer=name)
    rows = [dict(zip(known["fields"], row, strict=True)) for row in zip(*columns, strict=True)]
    return known, [None if shape is None else shapely.from_wkb(shape) for shape in shapes], rows


def crs_of(path: pathlib.Path) -> pyproj.CRS:
    """The CRS of the points."""
    if path.suffix == ".parquet":
        told = json.loads(pytest.importorskip("pyarrow.parquet").read_schema(path).metadata[b"geo"])
        return pyproj.CRS.from_json_dict(told["columns"]["geometry"]["crs"])
    return pyproj.CRS(pyogrio.read_info(path, **({"layer": "fixes"} if path.suffix == ".gpkg" else {}))["crs"])


def metadata_of(path: pathlib.Path) -> dict[str, Any]:
    """What a map says of all its fixes."""
    if path.suffix == ".parquet":
        return json.loads(pytest.importorskip("pyarrow.parquet").read_schema(path).metadata[b"jaxgeo"])
    if path.suffix == ".geojson":
        return json.loads(path.read_text(encoding="utf-8"))["jaxgeo"]
    return pyogrio.read_info(path, layer="fixes")["layer_metadata"]


def unknown(value: Any) -> bool:
    """Whether nothing stands in a column, as its format has it."""
    return value is None or value == "" or (isinstance(value, float) and np.isnan(value))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_fixes_come_back_and_none_is_lost(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"fixes{suffix}"
    fixes = made(np.insert(ALPS, 1, np.nan, axis=0), {1: Status.rises_away})
    write_fixes(path, fixes)
    rows, points, outlines = read(path)
    assert outlines == []
    assert [int(row["index"]) for row in rows] == [0, 1, 2, 3]
    assert [row["status"] for row in rows] == ["hit", "rises_away", "hit", "hit"]
    assert rows[1]["status_text"] == Status.rises_away.message
    assert {row["vertical_datum"] for row in rows} == {"WGS 84 ellipsoid"}
    assert points[1] is None
    assert all(unknown(rows[1][name]) for name in ("fix_lat_deg", "fix_height_m", "fix_height_msl_m", "slant_range_m"))
    found = np.array([points[i].coords[0] for i in (0, 2, 3)])
    np.testing.assert_allclose(found[:, :2], ALPS[:, [1, 0]], rtol=0.0, atol=1e-10)  # deg
    np.testing.assert_allclose(found[:, 2], ALPS[:, 2], rtol=0.0, atol=5.1e-5)  # m
    for i, (lat, lon, height) in zip((0, 2, 3), ALPS, strict=True):
        row = {name: float(rows[i][name]) for name in rows[i] if name.endswith(("_m", "_deg"))}
        assert row["fix_lat_deg"] == pytest.approx(lat, abs=1e-10)
        assert row["fix_lon_deg"] == pytest.approx(lon, abs=1e-10)
        assert row["fix_height_m"] == pytest.approx(height, abs=5.1e-5)
        assert row["slant_range_m"] == 1000.0 * (i + 0.5)
        assert row["incidence_surface_deg"] == pytest.approx(np.rad2deg(0.2 * (i + 0.5)), abs=1e-6)
        assert 40.0 < row["fix_height_m"] - row["fix_height_msl_m"] < 60.0  # undulation of the Alps
    assert [other.name for other in tmp_path.iterdir()] == [path.name]


def test_attributes_by_columns_are_those_by_rows(tmp_path: pathlib.Path) -> None:
    """Lists, arrays and texts; of one fix single values."""
    columns = {"image": ["a", "b", None], "strip": np.arange(3), "kept": (True, False, None)}
    rows = [{name: list(values)[row] for name, values in columns.items()} for row in range(3)]
    for name, given in (("columns.csv", columns), ("rows.csv", rows)):
        write_fixes(tmp_path / name, made(), attributes=given)
    assert (tmp_path / "columns.csv").read_bytes() == (tmp_path / "rows.csv").read_bytes()
    one = jax.tree.map(lambda leaf: leaf[0], made())
    write_fixes(tmp_path / "one.csv", one, attributes={"image": "abc", "strip": 7})
    assert "abc,7," in (tmp_path / "one.csv").read_text()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_attributes_go_along(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"fixes{suffix}"
    given = [
        {"image": 'a,"b"\nc.tif', "strip": 1, "gsd_m": 0.25, "kept": True, "note": None, "count": None},
        {
            "image": "ü→.tif",
            "strip": np.int32(2),
            "gsd_m": np.float64(1.0 / 3.0),
            "kept": False,
            "note": "",
            "count": 7,
        },
        {"image": None, "strip": -(2**53), "gsd_m": 3, "kept": None, "note": "late", "count": 8},
    ]
    write_fixes(path, made(), attributes=given)
    rows, _, _ = read(path)
    for row, one in zip(rows, given, strict=True):
        for name, value in one.items():
            if value is None or value == "":
                assert unknown(row[name]) or (name == "kept" and row[name] == False)  # noqa: E712  GDAL's bools have no NULL in NumPy
            elif suffix == ".csv":
                assert row[name] == str(value)
            else:
                assert row[name] == value


CASES = [
    ("EPSG:4326", None, "EPSG:4979", "WGS 84 ellipsoid"),
    ("EPSG:4979", "ellipsoid", "EPSG:4979", "WGS 84 ellipsoid"),
    ("EPSG:32632", None, None, "WGS 84 ellipsoid"),
    ("EPSG:32632", "EPSG:5773", None, "EGM96 height"),
    ("EPSG:4326", "EPSG:5773", "EPSG:9707", "EGM96 height"),
    ("EPSG:4326+5773", None, "EPSG:9707", "EGM96 height"),
    ("EPSG:25832+5773", "EPSG:5773", None, "EGM96 height"),
    ("EPSG:4937", None, "EPSG:4937", "ellipsoid of ETRS89"),
    ("EPSG:3857", None, None, "WGS 84 ellipsoid"),
    ("EPSG:2263", "EPSG:5773", None, "EGM96 height"),  # US survey feet, at New York
]


@pytest.mark.costly
@pytest.mark.parametrize("crs, heights, code, datum", CASES)
@pytest.mark.parametrize("suffix", [".csv", *MAPS])
def test_a_crs_and_its_heights(
    tmp_path, suffix: str, crs: str, heights: str | None, code: str | None, datum: str
) -> None:
    """Against PROJ's own way from the 3D WGS 84; where it has steps for EGM96, through its grid."""
    path = tmp_path / f"fixes{suffix}"
    places = ALPS if crs != "EPSG:2263" else ALPS - [[6.3, 85.0, 0.0]]
    write_fixes(path, made(places), crs=crs, heights=heights)
    rows, points, _ = read(path)
    assert {row["vertical_datum"].split(" (")[0] for row in rows} == {datum}
    flat = crs.split("+")[0]
    lat, lon, height = places.T
    x, y = pyproj.Transformer.from_crs("EPSG:4326", flat, always_xy=True).transform(lon, lat)
    if datum == "EGM96 height":
        whole = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:9707", always_xy=True)
        height = whole.transform(lon, lat, height)[2]
        assert np.all(np.abs(height - places[:, 2]) > 20.0)
    found = np.array([point.coords[0] for point in points])
    close = 1e-9 if pyproj.CRS(flat).is_geographic else 1e-3 if flat == "EPSG:2263" else 2e-4  # deg, ft or m
    np.testing.assert_allclose(found[:, :2], np.column_stack([x, y]), rtol=0.0, atol=close)
    np.testing.assert_allclose(found[:, 2], height, rtol=0.0, atol=1e-4)  # m
    if suffix == ".csv":
        named = flat if datum == "WGS 84 ellipsoid" else f"{flat}+5773"
        assert {row["crs"] for row in rows} == {code or named}
        return
    written = crs_of(path)
    assert written.equals(flat, ignore_axis_order=True) or len(written.axis_info) == 3
    if suffix != ".geojson":
        assert len(written.axis_info) == 3
        vertical = written.sub_crs_list[-1].name if written.is_compound else None
        assert vertical == (datum if datum == "EGM96 height" else None)
    if code is not None and suffix == ".parquet":
        assert written.equals(code)
    assert metadata_of(path)["vertical_datum"].startswith(datum)


def test_geojson_names_a_crs_only_if_it_is_not_its_own(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "fixes.geojson"
    write_fixes(path, made())
    assert "crs" not in json.loads(path.read_text())
    write_fixes(path, made(), crs="EPSG:32632", heights="EPSG:5773")
    urn = json.loads(path.read_text())["crs"]["properties"]["name"]
    assert urn == "urn:ogc:def:crs,crs:EPSG::32632,crs:EPSG::5773"
    assert crs_of(path).equals("EPSG:32632+5773")


def test_geopandas_reads_both_geometries_of_a_geoparquet(tmp_path: pathlib.Path) -> None:
    geopandas, path = pytest.importorskip("geopandas"), tmp_path / "fixes.parquet"
    pytest.importorskip("pyarrow")
    write_fixes(path, made(), cov_enu=np.stack([LEVEL] * 3), crs="EPSG:32632", heights="EPSG:5773")
    table = geopandas.read_parquet(path)
    assert table.crs.equals(pyproj.CRS("EPSG:32632+5773")) or table.crs.sub_crs_list[1].to_epsg() == 5773
    assert table.ellipse.crs.equals("EPSG:32632")
    assert shapely.contains(table.ellipse.to_numpy(), table.geometry.to_numpy()).all()
    assert table.ellipse.area.to_numpy() == pytest.approx(np.pi * table.semi_major_m * table.semi_minor_m, rel=5e-3)


def test_a_geopackage_is_a_sound_database(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "fixes.gpkg"
    write_fixes(path, made(), cov_enu=np.stack([LEVEL] * 3))
    with sqlite3.connect(path) as base:
        assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        found = base.execute("SELECT table_name, geometry_type_name, z, srs_id FROM gpkg_geometry_columns").fetchall()
    assert found == [("fixes", "POINT", 1, 4979), ("ellipses", "POLYGON", 0, 4326)]


@pytest.mark.parametrize("suffix", MAPS)
def test_ellipses_lie_as_covariances_say(tmp_path: pathlib.Path, suffix: str) -> None:
    """Every vertex by PROJ's topocentric frame: d' C^-1 d is that of the probability; area, orientation, sense."""
    path, share = tmp_path / f"fixes{suffix}", 0.8
    spread = np.stack([LEVEL, 1e4 * LEVEL, np.diag([1e-4, 1e4, 1.0])])
    bias = np.array([[0.0, 0.0, 0.0], [30.0, -50.0, 4.0], [0.0, 0.0, 0.0]])
    sea = ALPS * [1.0, 1.0, 0.0]
    write_fixes(
        path, made(sea), cov_enu=spread, bias_enu=bias, probability=share, attributes=[{"n": i} for i in range(3)]
    )
    rows, _, outlines = read(path)
    for i, (row, shape) in enumerate(zip(rows, outlines, strict=True)):
        lat, lon, height = sea[i]
        ring = np.asarray(shape.exterior.coords)
        assert ring.shape[1] == 2
        assert len(ring) == 65
        assert shape.exterior.is_ccw
        frame = f"+proj=pipeline +step +proj=cart +step +proj=topocentric +lon_0={lon} +lat_0={lat} +h_0={height}"
        east, north, up = pyproj.Transformer.from_pipeline(f"{frame}").transform(
            *ring.T, np.zeros(len(ring)), radians=False
        )
        scale = 1.0 + up / 6.37e6  # the vertices lie on the level plane, their foots are read
        offsets = np.stack([east / scale, north / scale], axis=-1) - bias[i, :2]
        squared = np.einsum("ni,ij,nj->n", offsets, np.linalg.inv(spread[i, :2, :2]), offsets)
        close = 1e-3 if i == 2 else 1e-5  # the thin one has a minor axis of 18 mm, at a micrometre
        np.testing.assert_allclose(squared, -2.0 * np.log(1.0 - share), rtol=close)
        long, short = row["semi_major_m"], row["semi_minor_m"]
        assert long >= short > 0.0
        area = abs(pyproj.Geod(ellps="WGS84").polygon_area_perimeter(*ring.T)[0])
        assert area == pytest.approx(32.0 * np.sin(2.0 * np.pi / 64.0) * long * short, rel=1e-3)
        tip = offsets[np.argmax(np.linalg.norm(offsets, axis=1))]
        turned = np.rad2deg(np.arctan2(*tip)) - row["azimuth_deg"]
        assert abs((turned + 90.0) % 180.0 - 90.0) < 3.0  # deg: between two vertices
        assert row["probability"] == share


def test_figures_are_those_of_the_metrics(tmp_path: pathlib.Path) -> None:
    path, fixes = tmp_path / "fixes.geojson", made(lost={1: Status.leaves_terrain})
    cov = np.stack([LEVEL, np.full((3, 3), np.nan), 4.0 * LEVEL])
    bias = np.array([[1.0, -2.0, 0.5]] * 3)
    write_fixes(path, fixes, cov_enu=cov, bias_enu=bias, probability=0.95)
    (first, lost, last), points, outlines = read(path)
    assert len(outlines) == 2
    assert points[1] is None
    for row, scale in ((first, 1.0), (last, 4.0)):
        c, b = scale * LEVEL, bias[0]
        expected = (
            circular_error(c[:2, :2], 0.95, b[:2]),
            linear_error(c[2, 2], 0.95, b[2]),
            spherical_error(c, 0.95, b),
        )
        assert [row[f"{kind}95_m"] for kind in ("ce", "le", "se")] == pytest.approx(
            [float(x) for x in expected], abs=1e-4
        )
        names = ("ee", "en", "eu", "nn", "nu", "uu")
        assert [row[f"cov_{name}_m2"] for name in names] == pytest.approx(c[np.triu_indices(3)], rel=1e-11)
        assert [row[f"bias_{axis}_m"] for axis in "enu"] == list(b)
    assert all(
        unknown(lost[name]) for name in lost if name.startswith(("ce", "le", "se", "semi", "cov", "bias", "azi"))
    )


@pytest.mark.costly
def test_no_figure_depends_on_how_many_are_computed_at_a_time(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, cov = tmp_path / "fixes.geojson", np.stack([LEVEL, 4.0 * LEVEL, 9.0 * LEVEL])
    write_fixes(path, made(), cov_enu=cov)
    together = path.read_text()
    monkeypatch.setattr(_fix_columns, "MOST", 2)
    write_fixes(path, made(), cov_enu=cov)
    assert path.read_text() == together


def test_a_grid_that_is_missing_is_told_with_the_file(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_, **__) -> None:
        raise VerticalDatumError("the grid file is missing: some.tif")

    monkeypatch.setattr(_map_crs, "height_shift", fails)
    with pytest.raises(VerticalDatumError, match=r"fixes\.gpkg: the grid file is missing: some\.tif"):
        write_fixes(tmp_path / "fixes.gpkg", made(), heights="EPSG:3855")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.costly
@pytest.mark.parametrize("suffix", MAPS)
def test_the_date_line_cuts_an_ellipse_in_two(tmp_path: pathlib.Path, suffix: str) -> None:
    path = tmp_path / f"fixes{suffix}"
    write_fixes(path, made(DATE_LINE), cov_enu=LEVEL[None])
    _, _, (shape,) = read(path)
    assert shape.geom_type == "MultiPolygon"
    west, east = sorted(shape.geoms, key=lambda part: part.bounds[0])
    assert (west.bounds[0], east.bounds[2]) == (-180.0, 180.0)
    whole = shape.area * 111_320.0 * np.cos(np.deg2rad(17.0)) * 110_660.0
    assert whole == pytest.approx(-2.0 * np.log(0.1) * np.pi * np.sqrt(32.0), rel=2e-2)
    write_fixes(path, made(DATE_LINE), cov_enu=LEVEL[None], crs="EPSG:3832")
    assert read(path)[2][0].geom_type == "Polygon"


@pytest.mark.costly
@pytest.mark.parametrize("lat", [89.99999, -89.99999])
def test_an_ellipse_around_a_pole(tmp_path: pathlib.Path, lat: float) -> None:
    path = tmp_path / "fixes.gpkg"
    write_fixes(path, made(np.array([[lat, 30.0, 10.0]])), cov_enu=LEVEL[None])
    _, _, (shape,) = read(path)
    assert shape.covers(shapely.Point(77.0, np.sign(lat) * 89.999999))
    write_fixes(
        path, made(np.array([[lat, 30.0, 10.0]])), cov_enu=LEVEL[None], crs="EPSG:5041" if lat > 0 else "EPSG:5042"
    )
    _, _, (shape,) = read(path)
    assert shape.contains(shapely.Point(2e6, 2e6))
    assert shape.area == pytest.approx(-2.0 * np.log(0.1) * np.pi * np.sqrt(32.0) * 0.994**2, rel=3e-3)


@pytest.mark.parametrize("suffix", MAPS)
def test_what_has_no_area_has_no_polygon(tmp_path: pathlib.Path, suffix: str) -> None:
    """A covariance of zero, a line, and one so wide that it is no ellipse on the ground; all keep their figures."""
    path = tmp_path / f"fixes{suffix}"
    line, wide = np.diag([4.0, 0.0, 0.0]), np.diag([1e14, 1.0, 1.0])
    write_fixes(path, made(), cov_enu=np.stack([np.zeros((3, 3)), line, wide]))
    rows, points, outlines = read(path)
    assert outlines == []
    assert None not in points
    assert (rows[0]["semi_major_m"], rows[0]["ce90_m"]) == (0.0, 0.0)
    assert rows[1]["semi_major_m"] == pytest.approx(2.0 * np.sqrt(-2.0 * np.log(0.1)), abs=1e-6)
    assert rows[1]["azimuth_deg"] == pytest.approx(90.0)


def test_attributes_go_along_with_ellipses(tmp_path: pathlib.Path) -> None:
    """Also those whose names begin as the file's own do."""
    path, given = tmp_path / "fixes.gpkg", [{"image": "a.tif", "slope_class": i, "cov_by": "survey"} for i in range(3)]
    write_fixes(path, made(), cov_enu=np.stack([LEVEL] * 3), attributes=given)
    rows = layer(path, "ellipses")[2]
    assert [{name: row[name] for name in given[0]} for row in rows] == given
    assert [row["index"] for row in rows] == [0, 1, 2]
    assert "cov_ee_m2" not in rows[0]


def test_ellipses_can_be_left_out(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "fixes.gpkg"
    write_fixes(path, made(), cov_enu=np.stack([LEVEL] * 3), ellipses=False)
    assert pyogrio.list_layers(path)[:, 0].tolist() == ["fixes"]
    assert layer(path, "fixes")[2][0]["semi_major_m"] > 0.0


SENSOR, SHOT, GROUND, MODEL = looks.level_sensor(), looks.level_shot(), looks.LEVEL, looks.level_errors()
UV = np.array([looks.LEVEL_UV, [-900.0, 300.0]])


@pytest.fixture(scope="module")
def located() -> Fix:
    """A fix, and none of a pixel beside the image."""
    return jax.vmap(lambda uv: jaxgeo.locate(SENSOR, SHOT, uv, GROUND))(UV)


@pytest.mark.slow
def test_what_accuracy_tells_is_written(tmp_path: pathlib.Path, located: Fix) -> None:
    """Of each fix, and of all pixels at once: the same radii; of each an ellipse, of a map the circle."""
    path = tmp_path / "fixes.gpkg"
    told = accuracy(SENSOR, SHOT, UV[0], GROUND, MODEL, probability=0.8)
    write_fixes(path, located, accuracy=[told, None], crs="EPSG:32632")
    rows, points, (ellipse,) = read(path)
    assert [row["ce80_m"] for row in rows] == pytest.approx([float(told.circular), np.nan], abs=1e-4, nan_ok=True)
    assert rows[0]["accuracy_method"] == told.words
    assert rows[0]["accuracy_text"] == told.because
    assert unknown(rows[1]["accuracy_text"])
    assert points[1] is None
    assert layer(path, "ellipses")[2][0]["kind"] == "ellipse"
    area = -2.0 * np.log(0.2) * np.pi * np.sqrt(np.linalg.det(told.cov_enu[:2, :2]))
    assert ellipse.area == pytest.approx(area, rel=3e-3)
    everywhere = accuracy(SENSOR, SHOT, UV, GROUND, MODEL, probability=0.8, block=1)
    write_fixes(path, located, accuracy=everywhere, crs="EPSG:32632")
    rows, _, (another,) = read(path)
    assert [row["ce80_m"] for row in rows] == pytest.approx([float(told.circular), np.nan], abs=1e-4, nan_ok=True)
    assert layer(path, "ellipses")[2][0]["kind"] == "ellipse"
    assert another.area == pytest.approx(area, rel=3e-3)
    with pytest.raises(ValueError, match=r"accuracy is of a batch of the shape \(2,\), fixes of 1"):
        write_fixes(path, jax.tree.map(lambda x: x[1:], located), accuracy=everywhere)
    places = np.column_stack([np.asarray(x) for x in located.position.to_degrees()])
    off = made(np.add(places, [[1e-5, 0.0, 0.0]]))
    for other in (everywhere, [told, None]):
        with pytest.raises(ValueError, match=r"accuracy 0 is of another place than fix 0, 1\.11 m off"):
            write_fixes(path, off, accuracy=other)
    with pytest.raises(ValueError, match=r"accuracy has a probability of 0\.8, but 0\.9 is asked for"):
        write_fixes(path, located, accuracy=[told, None], probability=0.9)
    assert len(read(path)[0]) == 2


@pytest.mark.costly
@pytest.mark.parametrize(
    "suffix, written", [(".csv", "inf"), (".geojson", None), (".gpkg", np.inf), (".parquet", np.inf)]
)
def test_an_infinite_radius_is_no_number_where_there_is_none(tmp_path, located: Fix, suffix: str, written: Any) -> None:
    """Too many samples have failed: the radius is not left looking unknown where a format can say infinite."""
    radii = np.array([np.inf, np.nan])
    diagnostics = Diagnostics(*[np.ones(2)] * len(Diagnostics._fields))
    method = np.array([Method.samples, -1], np.int8)
    cov, bias, failed = np.full((2, 3, 3), np.nan), np.full((2, 3), np.nan), np.array([0.2, np.nan])
    told = Accuracy(located, np.full(2, 0.9), radii, radii, radii, method, cov, bias, failed, diagnostics, count=100)
    write_fixes(tmp_path / f"fixes{suffix}", located, accuracy=told)
    rows, _, outlines = read(tmp_path / f"fixes{suffix}")
    assert rows[0]["ce90_m"] == written
    assert unknown(rows[1]["ce90_m"])
    assert outlines == []


def test_squares_of_mgrs(tmp_path: pathlib.Path) -> None:
    """Against UTM by PROJ: the last five digits of whole metres; polar squares by name."""
    pytest.importorskip("mgrs")
    path = tmp_path / "fixes.csv"
    places = np.array([[47.123456, 11.345678, 0.0], [-17.0, 179.99999, 0.0], [np.nan] * 3, [89.9, 30.0, 0.0]])
    write_fixes(path, made(places, {2: Status.rises_away}), mgrs=True)
    squares = [row["mgrs"] for row in read(path)[0]]
    for square, (lat, lon, _), zone, band in zip(squares, places, (32632, 32760), ("32T", "60K"), strict=False):
        x, y = pyproj.Transformer.from_crs("EPSG:4326", zone, always_xy=True).transform(lon, lat)
        assert square[:3] == band
        assert square[5:] == f"{int(x) % 100_000:05d}{int(y) % 100_000:05d}"
    assert squares[2] == ""
    assert squares[3].startswith("Z")


def test_one_fix_is_a_batch_of_one(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "fixes.geojson"
    write_fixes(path, jax.tree.map(lambda x: x[0], made()), cov_enu=LEVEL)
    rows, _, outlines = read(path)
    assert (len(rows), len(outlines)) == (1, 1)


def test_nothing_but_failures_is_written_too(tmp_path: pathlib.Path) -> None:
    lost = dict.fromkeys(range(3), Status.rises_away)
    for suffix in (".csv", *MAPS):
        write_fixes(tmp_path / f"fixes{suffix}", made(lost=lost), cov_enu=np.full((3, 3, 3), np.nan), crs="EPSG:32632")
        rows, points, outlines = read(tmp_path / f"fixes{suffix}")
        assert (len(rows), points, outlines) == (3, [None] * 3, [])


NOT_SYMMETRIC = np.stack([LEVEL + np.triu(np.ones((3, 3)), 1)] * 3)
WRONG = [
    ({"path": "fixes.shp"}, ValueError, r"end in \.csv, \.geojson, \.json, \.gpkg, \.parquet, \.kml, \.kmz, \.gpx"),
    ({"path": "nowhere/fixes.gpkg"}, ValueError, "there is no folder"),
    ({"path": "folder.gpkg"}, ValueError, "this is a folder"),
    ({"fixes": ALPS}, TypeError, "fixes must be a jaxgeo Fix"),
    ({"fixes": jax.tree.map(lambda x: x[None], made())}, ValueError, r"a batch of the shape \(1, 3\)"),
    ({"fixes": jax.tree.map(lambda x: x[:0], made())}, ValueError, r"shape \(0,\)"),
    ({"crs": "EPSG:0"}, ValueError, "PROJ does not know crs = 'EPSG:0'"),
    ({"crs": "EPSG:5773"}, ValueError, "needs a projected or geographic crs"),
    ({"crs": "EPSG:4978"}, ValueError, "needs a projected or geographic crs"),
    ({"crs": "EPSG:4267"}, ValueError, "on the ellipsoid Clarke 1866, above which the heights of fixes are not"),
    ({"heights": 47.5}, ValueError, r"heights = 47\.5 is no vertical CRS that PROJ knows"),
    ({"heights": "geoid.tif"}, ValueError, r"heights = 'geoid\.tif' is no vertical CRS"),
    ({"heights": "EPSG:32632"}, ValueError, "says nothing about heights"),
    ({"crs": "EPSG:4979", "heights": "EPSG:5773"}, ValueError, "has its own; leave heights out"),
    ({"crs": "EPSG:32632+5773", "heights": "ellipsoid"}, ValueError, "has its own; leave heights out"),
    ({"cov_enu": LEVEL}, ValueError, r"cov_enu must have the shape \(3, 3, 3\); got \(3, 3\)"),
    ({"cov_enu": NOT_SYMMETRIC}, ValueError, "cov must be symmetric"),
    ({"cov_enu": np.stack([LEVEL, np.diag([1.0, np.nan, 1.0]), LEVEL])}, ValueError, "of fix 1 must be finite, or NaN"),
    ({"cov_enu": np.stack([LEVEL] * 3), "probability": 90.0}, ValueError, "Write 90 % as 0.9"),
    ({"bias_enu": np.zeros((3, 3))}, ValueError, "whose cov_enu must be given too"),
    ({"accuracy": [None]}, ValueError, "one, or None, for each of 3 fixes; got 1"),
    ({"accuracy": [LEVEL] * 3}, TypeError, r"accuracy\[0\] must be a jaxgeo Accuracy"),
    ({"attributes": [{}]}, ValueError, "one mapping for each of 3 fixes; got 1"),
    ({"attributes": {"a": [1, 2]}}, ValueError, "'a' has 2 values; expected one for each of 3 fixes"),
    ({"attributes": {"a": "xyz"}}, ValueError, "list with a mapping for each of 3 fixes, .*; 'a' has one value, 'xyz'"),
    ({"attributes": [{"a": 1}, {"b": 1}, {"a": 1}]}, ValueError, "fixes 0 and 1 differ: a, b"),
    ({"attributes": [{"Status": 1}] * 3}, ValueError, "'Status' is one that the file has by itself"),
    ({"attributes": [{"FID": 1}] * 3}, ValueError, "'FID' is one that the file has by itself"),
    ({"attributes": [{"a": 1, "A": 1}] * 3}, ValueError, "'a' is there twice but for capitals"),
    ({"attributes": [{"a": [1]}] * 3}, ValueError, "'a' must be all numbers, all texts or all bools; got list"),
    ({"attributes": [{"a": 1}, {"a": "x"}, {"a": 1}]}, ValueError, "all texts or all bools; got int, str"),
    ({"attributes": [{"a": 2**70}] * 3}, ValueError, "more than 64 bits"),
    (
        {"crs": "EPSG:3857", "fixes": made(np.repeat(DATE_LINE, 3, axis=0)), "cov_enu": np.stack([LEVEL] * 3)},
        ValueError,
        "tears the ellipse of fix 0 apart",
    ),
]


@pytest.mark.parametrize("change, error, message", WRONG, ids=[message[:30] for _, _, message in WRONG])
def test_wrong_requests_leave_no_file(tmp_path, change: dict, error: type, message: str) -> None:
    (tmp_path / "folder.gpkg").mkdir()
    given = {"path": "fixes.gpkg", "fixes": made(), **change}
    given["path"] = tmp_path / given["path"]
    with pytest.raises(error, match=message):
        write_fixes(**given)
    assert [other.name for other in tmp_path.iterdir()] == ["folder.gpkg"]


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg"])
def test_a_crs_of_nobody_is_kept_by_a_geopackage_and_refused_by_geojson(tmp_path: pathlib.Path, suffix: str) -> None:
    path, local = tmp_path / f"fixes{suffix}", "+proj=tmerc +lat_0=47 +lon_0=11 +datum=WGS84 +units=m"
    if suffix == ".geojson":
        with pytest.raises(ValueError, match=r"has none that PROJ knows; write a \.gpkg or a \.parquet"):
            write_fixes(path, made(), crs=local)
        return
    write_fixes(path, made(), crs=local)
    assert read(path)[1][0].coords[0] == pytest.approx((0.0, 0.0, 600.0), abs=1e-6)


def test_a_failure_keeps_the_file_that_was_there(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "fixes.gpkg"
    path.write_text("old")

    def fails(*_, **__) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(raw, "write", fails)
    with pytest.raises(OSError, match=r"fixes\.gpkg: it cannot be written: disk full"):
        write_fixes(path, made())
    assert path.read_text() == "old"
    assert [other.name for other in tmp_path.iterdir()] == ["fixes.gpkg"]


def test_an_outline_over_the_date_line_is_cut_there(tmp_path: pathlib.Path) -> None:
    """Clockwise as seen in an image; the file has it anticlockwise, in two parts that meet at 180 degrees."""
    from jaxgeo import ConstantHeight, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot, locate

    sensor = Sensor(FrameCamera.from_pixels(focal_px=100.0, width=9, height=9), Gimbal.fixed(), Mount.nadir())
    fix = locate(sensor, Shot(Pose.from_degrees(lat=0.0, lon=180.0, height=100.0)), (4.0, 4.0), ConstantHeight(0.0))
    ring = np.array([[179.9, 0.1, 0.0], [-179.8, 0.1, 0.0], [-179.8, -0.1, 0.0], [179.9, -0.1, 0.0]])
    write_fixes(tmp_path / "a.geojson", fix, rings=[ring])
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    (shape,) = (shapely.geometry.shape(one["geometry"]) for one in features if one["properties"]["kind"] == "detection")
    assert shape.is_valid
    assert sorted(round(part.area, 9) for part in shape.geoms) == [0.02, 0.04]
    assert all(part.exterior.is_ccw for part in shape.geoms)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_heights_above_a_take_off_of_unknown_height_claim_no_datum(tmp_path: pathlib.Path, suffix: str) -> None:
    """One column that says what it is, two-dimensional points in the horizontal CRS, and no name of a datum."""
    path = tmp_path / f"fixes{suffix}"
    write_fixes(path, made(), crs="EPSG:32632", is_above_takeoff=True)
    if suffix == ".csv":
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        assert "map_z" not in rows[0]
        places = [(float(row["map_x"]), float(row["map_y"])) for row in rows]
    else:
        rows, points, _ = read(path)
        assert not any(point.has_z for point in points)
        places = [(point.x, point.y) for point in points]
    to_map = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True)
    for row, place, (lat, lon, height) in zip(rows, places, ALPS, strict=True):
        assert place == pytest.approx(to_map.transform(lon, lat), abs=1e-3)
        assert float(row["fix_height_above_takeoff_m"]) == pytest.approx(height, abs=1e-4)
        assert not {"fix_height_m", "fix_height_msl_m"} & set(row)
        assert row["vertical_datum"].startswith("unknown")
    if suffix == ".gpkg":
        assert pyogrio.read_info(path, layer="fixes")["geometry_type"] == "Point"
        assert pyproj.CRS(pyogrio.read_info(path, layer="fixes")["crs"]).to_epsg() == 32632


@pytest.mark.parametrize("how", [{"heights": "EPSG:5773"}, {"crs": "EPSG:4979"}, {"crs": "EPSG:9707"}])
@pytest.mark.parametrize("suffix", [".gpkg", ".kml"])
def test_heights_above_no_datum_are_not_brought_to_one(
    tmp_path: pathlib.Path, how: dict[str, str], suffix: str
) -> None:
    with pytest.raises(ValueError, match=r"needs heights above a datum.*give the height of the take-off"):
        write_fixes(tmp_path / f"fixes{suffix}", made(), is_above_takeoff=True, **how)
