"""Vertical datums: said by the file or the caller, shifted post by post, and never silently zero."""

from __future__ import annotations

import json
import pathlib
import subprocess
import sys
from typing import Any

import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
from rasterio.transform import Affine
from support.rasters import DEGREE, hills, write

from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io import VerticalDatumError, height_msl, read_dem, read_dem_and_report, undulation
from jaxgeo.io._proj import DATA

FIXTURE = Affine(DEGREE, 0, 5.0, 0, -DEGREE, 45.0)
TIBET = (29.36, 88.90, 3800.0, 3766.3742425842)  # lat, lon, EGM96 height and its ellipsoidal height by PROJ 9.5.1


def posts(path: pathlib.Path, **options: Any) -> np.ndarray:
    return np.asarray(read_dem(path, **options).posts)


def undulations_at_posts(shape: tuple[int, int]) -> np.ndarray:
    """EGM96 at the posts of `FIXTURE`, bilinear by hand from the grid's own nodes, without PROJ."""
    import rasterio

    with rasterio.open(DATA / "us_nga_egm96_15.tif") as data:
        nodes = data.read(1).astype(np.float64)
    lon = 5.0 + (np.arange(shape[1]) + 0.5) * DEGREE
    lat = 45.0 - (np.arange(shape[0]) + 0.5) * DEGREE
    row, col = np.meshgrid((90.0 - lat) * 4.0, (lon + 180.0) * 4.0, indexing="ij")
    r, c = row.astype(int), col.astype(int)
    u, v = row - r, col - c
    top = (1 - v) * nodes[r, c] + v * nodes[r, c + 1]
    return (1 - u) * top + u * ((1 - v) * nodes[r + 1, c] + v * nodes[r + 1, c + 1])


def test_undulations_equal_those_of_proj(jaxgeo_test_data: pathlib.Path) -> None:
    known = json.loads((jaxgeo_test_data / "geoid" / "geoid_check_values.json").read_text())["points"]
    lat, lon, N = (np.array([point[key] for point in known]) for key in ("lat", "lon", "undulation_m"))
    np.testing.assert_allclose(undulation(lat, lon), N, rtol=0, atol=1e-9)
    np.testing.assert_allclose(undulation(lat, lon + 360.0 * (lon < 0)), N, rtol=0, atol=1e-9)


@pytest.mark.costly
def test_the_packaged_grid_serves_plain_pyproj_in_a_fresh_process() -> None:
    lat, lon, height, expected = TIBET
    code = (
        "import jaxgeo.io, pyproj\n"
        "t = pyproj.Transformer.from_crs('EPSG:4326+5773', 'EPSG:4979', always_xy=True, allow_ballpark=False)\n"
        f"print(repr(float(t.transform({lon}, {lat}, {height})[2])))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(expected, abs=1e-9)


def test_heights_above_sea_level_of_positions_and_fixes() -> None:
    lat, lon, msl, height = TIBET
    one = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    assert height_msl(one) == pytest.approx(msl, abs=1e-9)
    batch = Geodetic(
        lat=jnp.deg2rad(jnp.array([[lat, jnp.nan], [0.0, lat]])),
        lon=jnp.deg2rad(jnp.array([[lon, 5.0], [0.0, lon]])),
        height=jnp.array([[height, 100.0], [0.0, jnp.nan]]),
    )
    heights = height_msl(batch)
    assert heights.shape == (2, 2)
    assert heights[0, 0] == pytest.approx(msl, abs=1e-9)
    assert np.isnan(heights[0, 1])
    assert np.isnan(heights[1, 1])
    assert heights[1, 0] == pytest.approx(-17.1615791, abs=1e-6)  # the node of the grid at 0 N 0 E
    fix = Fix(
        position=one,
        ecef=jnp.zeros(3),
        slant_range=jnp.array(1.0),
        incidence_ellipsoid=jnp.array(0.0),
        incidence_surface=jnp.array(0.0),
        slope=jnp.array(0.0),
        status=jnp.array(0, jnp.int8),
    )
    assert height_msl(fix) == pytest.approx(msl, abs=1e-9)
    assert height_msl(one, datum=-33.5) == pytest.approx(height + 33.5, abs=1e-9)
    with pytest.raises(ValueError, match=r"latitudes must lie in \[-90, 90\] deg; got .*91"):
        undulation(91.0, 0.0)


@pytest.mark.parametrize("datum", [5773, "EPSG:5773", "EPSG:4326+5773", pyproj.CRS(5773)])
def test_egm96_is_added_post_by_post(tmp_path: pathlib.Path, datum: Any) -> None:
    heights = hills((20, 30))
    path = write(tmp_path / "dem.tif", heights)
    np.testing.assert_allclose(
        posts(path, vertical_datum=datum), heights + undulations_at_posts((20, 30)), rtol=0, atol=1e-9
    )


def test_longitudes_past_180_are_like_any_other(tmp_path: pathlib.Path) -> None:
    west = write(tmp_path / "west.tif", hills((5, 6)), affine=Affine(1e-3, 0, -85, 0, -1e-3, 36))
    east = write(tmp_path / "east.tif", hills((5, 6)), affine=Affine(1e-3, 0, 275, 0, -1e-3, 36))
    np.testing.assert_allclose(posts(east, vertical_datum=5773), posts(west, vertical_datum=5773), rtol=0, atol=1e-9)
    shift = posts(east, vertical_datum=5773) - hills((5, 6))
    assert np.all((shift > -35.0) & (shift < -25.0))


def test_a_file_that_says_its_datum_needs_no_other(tmp_path: pathlib.Path) -> None:
    heights = hills((20, 30))
    shifted = heights + undulations_at_posts((20, 30))
    for version in ("1.0", "1.1"):
        path = write(tmp_path / f"{version}.tif", heights, crs="EPSG:4326+5773", geotiff_version=version)
        np.testing.assert_allclose(posts(path), shifted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(posts(path, vertical_datum=5773), shifted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(posts(path, vertical_datum=50.0), heights + 50.0, rtol=0, atol=1e-9)
    for name, crs in (("ellipsoid.tif", "EPSG:4979"), ("ellipsoid_etrs.tif", "EPSG:4937")):
        path = write(tmp_path / name, heights, crs=crs)
        np.testing.assert_allclose(posts(path), heights, rtol=0, atol=1e-3)
        np.testing.assert_allclose(posts(path, vertical_datum="ellipsoid"), heights, rtol=0, atol=1e-12)


def test_constant_undulation_and_ellipsoid(tmp_path: pathlib.Path) -> None:
    heights = hills((5, 6))
    path = write(tmp_path / "dem.tif", heights)
    np.testing.assert_array_equal(posts(path, vertical_datum="ellipsoid"), heights)
    np.testing.assert_allclose(posts(path, vertical_datum=28.3), heights + 28.3, rtol=0, atol=1e-12)
    np.testing.assert_allclose(posts(path, vertical_datum=-34), heights - 34.0, rtol=0, atol=1e-12)


def test_a_geoid_grid_by_its_path(tmp_path: pathlib.Path) -> None:
    heights = hills((20, 30))
    path = write(tmp_path / "dem.tif", heights)
    folder = tmp_path / "with a space"
    folder.mkdir()
    grid = folder / "geoid.tif"
    grid.write_bytes((DATA / "us_nga_egm96_15.tif").read_bytes())
    expected = heights + undulations_at_posts((20, 30))
    np.testing.assert_allclose(posts(path, vertical_datum=grid), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(posts(path, vertical_datum=str(grid)), expected, rtol=0, atol=1e-9)


def test_the_french_geoid_by_its_path(tmp_path: pathlib.Path, jaxgeo_test_data: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((5, 6)))
    shift = posts(path, vertical_datum=jaxgeo_test_data / "geoid" / "fr_ign_RAF20.tif") - hills((5, 6))
    assert np.all((shift > 49.0) & (shift < 52.0))
    np.testing.assert_allclose(shift, undulations_at_posts((5, 6)), rtol=0, atol=1.0)  # EGM96 agrees to a metre there


@pytest.mark.parametrize("crs, unit", [("EPSG:4326+6360", 1200 / 3937), ("EPSG:4326+8228", 0.3048)])
def test_a_vertical_crs_in_feet_is_honoured(tmp_path: pathlib.Path, crs: str, unit: float) -> None:
    """The datum's grids are missing here, so the undulation is given; the unit is the file's."""
    path = write(tmp_path / "dem.tif", hills((5, 6)), crs=crs, affine=Affine(DEGREE, 0, -105, 0, -DEGREE, 40))
    np.testing.assert_allclose(posts(path, vertical_datum=-16.0), hills((5, 6)) * unit - 16.0, rtol=0, atol=1e-9)


def test_the_real_file_in_egm2008_is_read_with_one_undulation(jaxgeo_test_data: pathlib.Path) -> None:
    path = jaxgeo_test_data / "ngi_block" / "dem.tif"
    with pytest.raises(VerticalDatumError, match=r"'EGM2008 height' need a geoid grid.*us_nga_egm08_25\.tif"):
        read_dem(path)
    with pytest.raises(VerticalDatumError, match=r"the file says .*'EGM2008 height', the caller says 'EGM96 height'"):
        read_dem(path, vertical_datum="EPSG:5773")
    _, report = read_dem_and_report(path, vertical_datum=28.3)
    assert report.map_error_metres < 1e-3
    assert report.vertical == "constant undulation 28.3 m"


REFUSED = [
    (None, r"dem\.tif: the file does not state the vertical datum of its heights.*EPSG:5773.*ellipsoid.*undulation"),
    ("EPSG:999999", r"'EPSG:999999' is unknown to PROJ; the usual choices"),
    ("egm99", r"'egm99' is unknown to PROJ; the usual choices"),
    ("EPSG:4326", r"'EPSG:4326' \(WGS 84\) says nothing about heights"),
    (3855, r"'EGM2008 height' need a geoid grid.*us_nga_egm08_25\.tif.*`jaxgeo dem --geoid EPSG:3855` downloads it"),
    (5703, r"'NAVD88 height' need a geoid grid.*`pyproj sync --file us_noaa"),
    (5798, r"'EGM84 height' need a geoid grid.*Get it from its publisher"),
    (5773.0, r"5773\.0 would be a constant undulation in m, but the geoid stays within 200 m"),
    (float("nan"), r"nan would be a constant undulation"),
    (True, r"True is not understood"),
    (pathlib.Path("/nowhere/geoid.tif"), r"the geoid grid /nowhere/geoid\.tif does not exist"),
    ("/nowhere/geoid.gtx", r"the geoid grid /nowhere/geoid\.gtx does not exist"),
]


@pytest.mark.parametrize("datum, message", REFUSED)
def test_a_datum_that_is_unknown_or_cannot_be_reached_is_refused(
    tmp_path: pathlib.Path, datum: Any, message: str
) -> None:
    affine = Affine(DEGREE, 0, -105, 0, -DEGREE, 40) if datum == 5703 else FIXTURE
    path = write(tmp_path / "dem.tif", hills((5, 6)), affine=affine)
    with pytest.raises(VerticalDatumError, match="(?s)" + message):
        read_dem(path, vertical_datum=datum)


@pytest.mark.parametrize("crs, datum", [("EPSG:4326+5773", "ellipsoid"), ("EPSG:4326+5773", 3855), ("EPSG:4979", 50.0)])
def test_a_caller_may_not_contradict_the_file(tmp_path: pathlib.Path, crs: str, datum: Any) -> None:
    path = write(tmp_path / "dem.tif", hills((5, 6)), crs=crs)
    with pytest.raises(VerticalDatumError, match=r"dem\.tif: the file says .* the caller says .*gdal_edit"):
        read_dem(path, vertical_datum=datum)


def test_ground_outside_the_geoid_grid_is_refused(tmp_path: pathlib.Path, jaxgeo_test_data: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((5, 6)), affine=Affine(DEGREE, 0, 100, 0, -DEGREE, 45))
    with pytest.raises(VerticalDatumError, match="at row 0, column 0 the vertical datum gives no height"):
        read_dem(path, vertical_datum=jaxgeo_test_data / "geoid" / "fr_ign_RAF20.tif")


def test_a_file_that_is_no_geoid_grid_is_refused(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((5, 6)))
    (tmp_path / "geoid.gtx").write_bytes(b"not a grid")
    with pytest.raises(VerticalDatumError, match=r"PROJ cannot read .*geoid\.gtx as a geoid grid"):
        read_dem(path, vertical_datum=tmp_path / "geoid.gtx")
