"""Tiles whose columns are spaced by latitude, as one terrain: every zone as its own posts say, and no step between.

The layout is that of Copernicus DEM GLO-30 (its product handbook): tiles of one degree whose first post lies on the
north-western corner, the southern and eastern borders with the next tile; columns of 1, 1.5, 2, 3 arc seconds from
0, 50, 60, 70 degrees on. Here a degree has 24 rows in place of 3600.
"""

from __future__ import annotations

import itertools
import pathlib

import jax
import numpy as np
import pytest
from rasterio.transform import Affine
from support.rasters import write

from jaxgeo import Dem, Geodetic
from jaxgeo.io import DemError, open_dem, read_dem
from jaxgeo.io.zones import Zones, open_tiles

ROWS = 24  # of a degree; 24, 16, 12 and 8 columns
STEP = 1.0 / ROWS
COLUMNS = {49: 24, 50: 16, 59: 16, 60: 12, 69: 12, 70: 8}
heights_at = jax.jit(jax.vmap(Dem.height_at, in_axes=(None, 0)))


def ground(lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    return 600.0 + 250.0 * np.sin(3.0 * lat) * np.cos(5.0 * lon) + 90.0 * np.sin(11.0 * lon + 2.0 * lat)


def posts(lat0: int, lon0: int, shared: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitudes, longitudes and heights of a tile's posts; with the row of its southern border if that is shared."""
    lat = lat0 + 1.0 - np.arange(ROWS + shared) * STEP
    lon = lon0 + np.arange(COLUMNS[lat0]) / COLUMNS[lat0]
    return lat, lon, np.round(ground(*np.meshgrid(lat, lon, indexing="ij")), 2)


def tile(folder: pathlib.Path, lat0: int, lon0: int, shared: bool = False) -> pathlib.Path:
    width = 1.0 / COLUMNS[lat0]
    corner = Affine(width, 0, lon0 - width / 2, 0, -STEP, lat0 + 1.0 + STEP / 2)
    return write(folder / f"N{lat0}E{lon0:03d}.tif", posts(lat0, lon0, shared)[2], affine=corner, point=True)


def bilinear(lat: np.ndarray, lon: np.ndarray, lat0: int) -> np.ndarray:
    """The surface between the posts of a row of tiles, 9 to 11 degrees east, in NumPy alone."""
    lats, west, one = posts(lat0, 9)
    _, east, other = posts(lat0, 10)
    lons, table = np.concatenate([west, east]), np.concatenate([one, other], axis=1)
    u, v = (lats[0] - lat) / STEP, (lon - 9.0) * COLUMNS[lat0]
    i, j = np.clip(u.astype(int), 0, len(lats) - 2), np.clip(v.astype(int), 0, len(lons) - 2)
    u, v = u - i, v - j
    low, high = (table[i + k, j] * (1 - v) + table[i + k, j + 1] * v for k in (0, 1))
    return low * (1 - u) + high * u


def along(row: np.ndarray, lon: np.ndarray, lat0: int) -> np.ndarray:
    """Heights along one row of posts."""
    return np.interp(lon, 9.0 + np.arange(2 * COLUMNS[lat0]) / COLUMNS[lat0], row)


def at(lat: np.ndarray, lon: np.ndarray) -> Geodetic:
    return Geodetic.from_degrees(lat=lat, lon=lon, height=np.zeros(np.shape(lat)))


@pytest.fixture(params=[50, 60, 70])
def border(request: pytest.FixtureRequest, tmp_path: pathlib.Path) -> tuple[int, list[pathlib.Path]]:
    north = request.param
    return north, [tile(tmp_path, lat0, lon0) for lat0, lon0 in itertools.product((north - 1, north), (9, 10))]


def test_both_zones_are_as_their_own_posts_say(border: tuple[int, list[pathlib.Path]]) -> None:
    north, files = border
    dem, rng = read_dem(files, vertical_datum="ellipsoid"), np.random.default_rng(1)
    lon = rng.uniform(9.0, 10.85, 400)
    for lat0, low, high in ((north - 1, north - 0.95, north), (north, north + STEP, north + 0.99)):
        lat = rng.uniform(low, high, 400)
        found = heights_at(dem, at(lat, lon))
        np.testing.assert_allclose(found, bilinear(lat, lon, lat0), rtol=0, atol=2e-7)  # 1e-9 m of slope times rounding


@pytest.mark.costly
def test_between_them_the_surface_joins_both_rows_without_a_step(border: tuple[int, list[pathlib.Path]]) -> None:
    north, files = border
    dem = read_dem(files, vertical_datum="ellipsoid")
    lon, share = np.linspace(9.0, 10.85, 301), np.linspace(0.0, 1.0, 7)[:, None]
    south_row = np.concatenate([posts(north - 1, lon0)[2][0] for lon0 in (9, 10)])
    north_row = np.concatenate([posts(north, lon0)[2][-1] for lon0 in (9, 10)])
    expected = (1 - share) * along(south_row, lon, north - 1) + share * along(north_row, lon, north)
    lat = np.broadcast_to(north + share * STEP, expected.shape)
    found = np.asarray(heights_at(dem, at(lat.ravel(), np.broadcast_to(lon, lat.shape).ravel())))
    np.testing.assert_allclose(found.reshape(lat.shape), expected, rtol=0, atol=2e-7)
    for seam in (north, north + STEP):
        below, above = (heights_at(dem, at(np.full(301, seam + s * 1e-9), lon)) for s in (-1, 1))
        np.testing.assert_allclose(below, above, rtol=0, atol=1e-4)  # 0.1 mm apart


def test_the_order_of_the_files_does_not_matter(border: tuple[int, list[pathlib.Path]]) -> None:
    _, files = border
    one, other = read_dem(files, vertical_datum=0), read_dem(files[::-1], vertical_datum=0)
    np.testing.assert_array_equal(one.posts, other.posts)
    np.testing.assert_array_equal(one.void, other.void)


@pytest.mark.costly
def test_a_window_and_terrain_on_disk_are_the_same_ground(border: tuple[int, list[pathlib.Path]]) -> None:
    north, files = border
    whole = read_dem(files, vertical_datum=0)
    part = read_dem(files[0].parent, vertical_datum=0, bounds=(9.4, north - 0.3, 10.3, north + 0.3))
    rng = np.random.default_rng(2)
    places = at(rng.uniform(north - 0.3, north + 0.3, 200), rng.uniform(9.4, 10.3, 200))
    expected = heights_at(whole, places)
    np.testing.assert_allclose(heights_at(part, places), expected, rtol=0, atol=1e-6)
    on_disk = open_dem(files, vertical_datum=0)
    assert on_disk.shape == np.asarray(whole.posts).shape
    assert (on_disk.lowest, on_disk.highest) == (float(np.asarray(whole.lowest)), float(np.asarray(whole.highest)))


def test_a_shared_row_is_that_of_the_closer_columns(tmp_path: pathlib.Path) -> None:
    """As DTED has it, whose tiles share their border posts."""
    files = [tile(tmp_path, 50, 9, shared=True), tile(tmp_path, 49, 9)]
    dem = read_dem(files, vertical_datum=0)
    lat, lon, south = posts(49, 9)
    found = heights_at(dem, at(np.full(len(lon), lat[0]), lon))
    np.testing.assert_allclose(found, south[0], rtol=0, atol=1e-6)


def test_a_void_stays_one_and_takes_what_lies_beside_it(tmp_path: pathlib.Path) -> None:
    files = [tile(tmp_path, lat0, 9) for lat0 in (49, 50)]
    values = posts(50, 9)[2]
    values[5, 7] = np.nan
    width = 1.0 / COLUMNS[50]
    write(files[1], values, affine=Affine(width, 0, 9.0 - width / 2, 0, -STEP, 51.0 + STEP / 2), point=True)
    mosaic = open_tiles(files, 1)
    assert isinstance(mosaic, Zones)
    assert sorted(mosaic.factors) == [2, 3]
    _, void = mosaic.read(mosaic.bounds())
    assert np.flatnonzero(void[5, :46]).tolist() == [19, 20, 21, 22, 23]  # what leans on the post of column 21


def test_spacings_without_a_common_one_are_refused(tmp_path: pathlib.Path) -> None:
    a = write(tmp_path / "a.tif", np.full((5, 6), 3.0), affine=Affine(0.01, 0, 5.0, 0, -0.01, 45.0))
    b = write(tmp_path / "b.tif", np.full((5, 6), 3.0), affine=Affine(0.010123, 0, 5.0, 0, -0.01, 45.05))
    with pytest.raises(DemError, match=r"b\.tif: its posts are spaced 0\.010123 x 0\.01, those of .* 0\.01 x 0\.01"):
        read_dem([a, b], vertical_datum=0)


def test_zones_off_each_others_rows_are_refused(tmp_path: pathlib.Path) -> None:
    a = write(tmp_path / "a.tif", np.full((5, 6), 3.0), affine=Affine(0.01, 0, 4.995, 0, -0.01, 45.0))
    b = write(tmp_path / "b.tif", np.full((5, 6), 3.0), affine=Affine(0.02, 0, 4.99, 0, -0.01, 45.055))
    with pytest.raises(DemError, match=r"its first post falls at row -?\d+\.500"):
        read_dem([a, b], vertical_datum=0)
