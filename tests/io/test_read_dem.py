"""Reading elevation files: real ones and made-up ones, on every kind of map, whole, in windows and in tiles.

Held against: nine public elevation models as their publishers wrote them (SRTM `.hgt`, lidar, ASTER, national grids),
whose posts rasterio and pyproj put and read apart from the reader (`lonlat_by_pyproj`).
"""

from __future__ import annotations

import json
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
import rasterio
import rasterio.shutil
from rasterio.transform import Affine
from support.rasters import DEGREE, hills, write

from jaxgeo.earth import Geodetic
from jaxgeo.io import DemReport, example_dem, read_dem, read_dem_and_report
from jaxgeo.terrain import Dem, FittedGrid, GeographicGrid, TransverseMercatorGrid

REAL = {
    "N44E005.hgt": (GeographicGrid, 4822),
    "N44E005_UTM.tif": (TransverseMercatorGrid, 74128),
    "N44E005_big_hole.tif": (GeographicGrid, 490473),
    "Rome-30m-DEM.tif": (GeographicGrid, 0),
    "TM1_564_146_nodata.tif": (TransverseMercatorGrid, 500),
    "bigtujunga.tif": (TransverseMercatorGrid, 0),
    "dem_chhota_shigri.tif": (TransverseMercatorGrid, 0),
    "dtm_philondenx_32630_nan.tif": (TransverseMercatorGrid, None),
    "exploradores_aster_AST_L1A_00303182012144228_Z.tif": (TransverseMercatorGrid, 8908),
}
HERE = Affine(DEGREE, 0, 5.0, 0, -DEGREE, 45.0)
heights_at = jax.jit(jax.vmap(Dem.height_at, in_axes=(None, 0)))
rowcols_at = jax.jit(jax.vmap(Dem.rowcol_at, in_axes=(None, 0)))


def places(lon_deg: np.ndarray, lat_deg: np.ndarray) -> Geodetic:
    return Geodetic.from_degrees(lat=lat_deg, lon=lon_deg, height=np.zeros(np.shape(lon_deg)))


def posts_of(dem: Dem) -> np.ndarray:
    return np.asarray(dem.posts)


def extent_of(dem: Dem) -> np.ndarray:
    return np.asarray(dem.extent)


def some_posts(shape: tuple[int, ...], count: int = 50) -> np.ndarray:
    corners = np.array([[0, 0], [0, shape[1] - 1], [shape[0] - 1, 0], [shape[0] - 1, shape[1] - 1]])
    inner = np.random.default_rng(1).integers(0, shape, size=(count - 4, 2))
    return np.concatenate([corners, inner])


def lonlat_by_pyproj(path: pathlib.Path, rowcol: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rasterio and pyproj put posts, written apart from the reader."""
    with rasterio.open(path) as data:
        a, b, c, d, e, f = data.transform[:6]
        crs = pyproj.CRS.from_wkt(data.crs.to_wkt())
    row, col = rowcol.T + 0.5
    x, y = a * col + b * row + c, d * col + e * row + f
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    return pyproj.Transformer.from_crs(flat, "EPSG:4326", always_xy=True).transform(x, y)


@pytest.fixture(params=REAL, scope="module")
def real(request: pytest.FixtureRequest, jaxgeo_test_data: pathlib.Path) -> tuple[pathlib.Path, Dem, DemReport]:
    path = jaxgeo_test_data / "dem" / request.param
    return path, *read_dem_and_report(path, vertical_datum="EPSG:5773")


def test_real_files_open_and_their_map_is_true(real: tuple[pathlib.Path, Dem, DemReport]) -> None:
    path, dem, report = real
    print(report)
    grid, voids = REAL[path.name]
    assert isinstance(dem.grid, grid)
    assert report.map_error_metres < 1e-3
    assert report.map_error_cells < 1e-3
    assert voids is None or report.voids == voids == int(np.sum(dem.void))


def test_real_posts_lie_where_pyproj_says_and_are_as_high(real: tuple[pathlib.Path, Dem, DemReport]) -> None:
    path, dem, _ = real
    rowcol = some_posts(posts_of(dem).shape)
    lon, lat = lonlat_by_pyproj(path, rowcol)
    # PROJ's own datum step may differ from a plain WGS 84 by 0.1 mm (GRS 80); these posts are 1 m apart at least.
    np.testing.assert_allclose(rowcols_at(dem, places(lon, lat)), rowcol, rtol=0, atol=1e-6)
    with rasterio.open(path) as data:
        stored, valid = data.read(1), data.read_masks(1) > 0
    stored, valid = stored[tuple(rowcol.T)], valid[tuple(rowcol.T)] & np.isfinite(stored[tuple(rowcol.T)])
    msl = pyproj.Transformer.from_crs("EPSG:4326+5773", "EPSG:4979", always_xy=True, allow_ballpark=False)
    height = msl.transform(lon, lat, stored.astype(np.float64))[2]
    np.testing.assert_array_equal(~np.asarray(dem.void)[tuple(rowcol.T)], valid)
    np.testing.assert_allclose(np.asarray(dem.posts)[tuple(rowcol.T)][valid], height[valid], rtol=0, atol=1e-9)


def test_the_surface_holds_the_hits_of_two_other_programs(jaxgeo_test_data: pathlib.Path) -> None:
    """Rays over Mont Ventoux, intersected elsewhere: where they hit, our surface is as high."""
    rays = json.loads((jaxgeo_test_data / "rays" / "ventoux_rays.json").read_text())["rays"]
    hits = np.array([ray["hit"] for ray in rays if ray["hit"] is not None and not ray["hit_cell_has_void"]])
    assert len(hits) > 20
    dem = read_dem(jaxgeo_test_data / "dem" / "N44E005.hgt", vertical_datum=5773)
    heights = heights_at(dem, places(hits[:, 0], hits[:, 1]))
    print(f"{len(hits)} hits, largest height difference {np.abs(heights - hits[:, 2]).max():.1e} m")
    np.testing.assert_allclose(heights, hits[:, 2], rtol=0, atol=1e-3)  # m; the other two agree to 1.5 mm along the ray


def test_voids_of_a_tag_and_of_nan_are_both_taken(jaxgeo_test_data: pathlib.Path) -> None:
    path = jaxgeo_test_data / "dem" / "dtm_philondenx_32630_nan.tif"
    with rasterio.open(path) as data:
        stored = data.read(1)
        assert data.nodata == 0.0
    dem = read_dem(path, vertical_datum=50.0)
    np.testing.assert_array_equal(dem.void, np.isnan(stored) | (stored == 0.0))
    assert np.isnan(stored).any()


def test_the_example_is_cross_mountain() -> None:
    dem = example_dem()
    row, col = np.unravel_index(np.argmax(dem.posts), posts_of(dem).shape)
    rowcol = dem.rowcol_at(Geodetic.from_degrees(lat=36.19833, lon=-84.23056, height=0.0))
    np.testing.assert_allclose(rowcol, [row, col], rtol=0, atol=1.0)  # the summit's published position, to a cell
    assert posts_of(dem).dtype == jnp.float64
    msl = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4326+5773", always_xy=True, allow_ballpark=False)
    assert msl.transform(-84.23056, 36.19833, float(posts_of(dem)[row, col]))[2] == pytest.approx(1076.0, abs=2e-3)


MAPS = {
    "geographic": ("EPSG:4326", HERE, GeographicGrid),
    "geographic, sheared": ("EPSG:4326", Affine(1e-3, 2e-4, 5.0, -3e-4, -1e-3, 45.0), GeographicGrid),
    "geographic, south up": ("EPSG:4326", Affine(DEGREE, 0, 5.0, 0, DEGREE, 44.0), GeographicGrid),
    "geographic across the date line": ("EPSG:4326", Affine(1e-3, 0, 179.98, 0, -1e-3, -16.0), GeographicGrid),
    "geographic, 0 to 360": ("EPSG:4326", Affine(1e-3, 0, 275.0, 0, -1e-3, 36.0), GeographicGrid),
    "ETRS89": ("EPSG:4258", HERE, GeographicGrid),
    "UTM": ("EPSG:32631", Affine(30, 0, 657596, 0, -30, 4987377), TransverseMercatorGrid),
    "UTM across the date line": ("EPSG:32701", Affine(30, 0, 178000, 0, -30, 8229000), TransverseMercatorGrid),
    "Slovenia, GRS 80": ("EPSG:3794", Affine(1, 0, 563999.5, 0, -1, 146999.5), TransverseMercatorGrid),
    "Lo27, south-orientated": ("EPSG:2052", Affine(-25, 0, 60000, 0, 25, 3700000), TransverseMercatorGrid),
    "British, a Helmert datum": ("EPSG:27700", Affine(50, 0, 300000, 0, -50, 400000), FittedGrid),
    "Swiss oblique Mercator": ("EPSG:21781", Affine(25, 0, 600000, 0, -25, 200000), FittedGrid),
    "French, Paris meridian": ("EPSG:27572", Affine(25, 0, 600000, 0, -25, 2200000), FittedGrid),
    "Lambert 93": ("EPSG:2154", Affine(25, 0, 900000, 0, -25, 6400000), FittedGrid),
    "Antarctic polar stereographic, pole inside": ("EPSG:3031", Affine(500, 0, -20000, 0, -500, 15000), FittedGrid),
    "Arctic, far across": ("EPSG:3413", Affine(40000, 0, -1.6e6, 0, -40000, 1.2e6), FittedGrid),
}  # fmt: skip


@pytest.fixture(params=MAPS, scope="module")
def mapped(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):
    crs, affine, grid = MAPS[request.param]
    path = write(tmp_path_factory.mktemp("map") / "dem.tif", hills((60, 80)), crs=crs, affine=affine)
    return path, grid, *read_dem_and_report(path, vertical_datum="ellipsoid")


@pytest.mark.costly
def test_every_map_is_followed(mapped) -> None:
    path, grid, dem, report = mapped
    print(report)
    assert isinstance(dem.grid, grid)
    assert report.map_error_metres < 1e-3
    assert report.map_error_cells < 1e-3
    rowcol = some_posts(posts_of(dem).shape)
    lon, lat = lonlat_by_pyproj(path, rowcol)
    cell = float(np.min(report.cell_size))
    np.testing.assert_allclose(
        rowcols_at(dem, places(lon, lat)), rowcol, rtol=0, atol=1e-3 * min(1.0, 1.0 / cell)
    )  # 1 mm
    back = jax.vmap(dem.grid.rowcol)(jax.vmap(dem.grid.normal)(jnp.asarray(rowcol, jnp.float64)))
    np.testing.assert_allclose(back, rowcol, rtol=0, atol=1e-8)


@pytest.mark.costly
def test_heights_between_posts_are_bilinear_on_every_map(mapped) -> None:
    _, _, dem, _ = mapped
    fraction = np.random.default_rng(2).uniform(size=(40, 2))
    cell = np.random.default_rng(4).integers(0, np.array(posts_of(dem).shape) - 1, size=(40, 2))
    normal = np.asarray(jax.vmap(dem.grid.normal)(jnp.asarray(cell + fraction)))
    lon, lat = np.degrees(np.arctan2(normal[:, 1], normal[:, 0])), np.degrees(np.arcsin(normal[:, 2]))
    posts, (r, c), (u, v) = hills((60, 80)), cell.T, fraction.T
    expected = (1 - u) * ((1 - v) * posts[r, c] + v * posts[r, c + 1]) + u * (
        (1 - v) * posts[r + 1, c] + v * posts[r + 1, c + 1]
    )
    np.testing.assert_allclose(heights_at(dem, places(lon, lat)), expected, rtol=0, atol=1e-4)


def test_pixel_is_point_and_pixel_is_area_are_half_a_cell_apart(tmp_path: pathlib.Path) -> None:
    """A point file's tie point is the first post itself; rasterio's transform always maps the corner."""
    heights = hills((20, 30))
    area = read_dem(write(tmp_path / "area.tif", heights), vertical_datum=0)
    point = read_dem(write(tmp_path / "point.tif", heights, point=True), vertical_datum=0)
    first = Geodetic.from_degrees(lat=45.0 - DEGREE / 2, lon=5.0 + DEGREE / 2, height=0.0)
    for dem in (area, point):  # rasterio wrote both so that the corner is the same: so are the posts
        np.testing.assert_allclose(dem.rowcol_at(first), [0.0, 0.0], rtol=0, atol=1e-6)
    with rasterio.Env(GTIFF_POINT_GEO_IGNORE=True), rasterio.open(tmp_path / "point.tif") as data:
        tie = data.transform.c, data.transform.f  # what the file itself stores
    np.testing.assert_allclose(tie, [5.0 + DEGREE / 2, 45.0 - DEGREE / 2], rtol=0, atol=1e-9)


def test_hgt_posts_are_at_whole_seconds(jaxgeo_test_data: pathlib.Path) -> None:
    bounds = (5.19, 44.19, 5.21, 44.21)
    dem = read_dem(jaxgeo_test_data / "dem" / "N44E005.hgt", vertical_datum=0, bounds=bounds)
    rowcol = np.asarray(dem.rowcol_at(Geodetic.from_degrees(lat=44.2, lon=5.2, height=0.0)))
    np.testing.assert_allclose(rowcol, np.round(rowcol), rtol=0, atol=1e-6)


@pytest.mark.parametrize("bounds", [(5.01, 44.96, 5.04, 44.99), (4.0, 44.96, 5.02, 46.0), (4.9, 44.9, 5.1, 45.1)])
def test_a_window_is_the_same_ground(tmp_path: pathlib.Path, bounds: tuple[float, float, float, float]) -> None:
    path = write(tmp_path / "dem.tif", hills((60, 80)))
    whole = read_dem(path, vertical_datum="ellipsoid")
    part, report = read_dem_and_report(path, vertical_datum="ellipsoid", bounds=bounds)
    west, south, east, north = bounds
    rng = np.random.default_rng(8)
    lon = rng.uniform(max(west, 5.0 + DEGREE), min(east, 5.0 + 79 * DEGREE), 50)
    lat = rng.uniform(max(south, 45 - 59 * DEGREE), min(north, 45.0 - DEGREE), 50)
    inside = heights_at(part, places(lon, lat))
    assert np.all(np.isfinite(inside))
    np.testing.assert_allclose(inside, heights_at(whole, places(lon, lat)), rtol=0, atol=1e-6)
    assert report.shape == tuple(np.asarray(part.extent))


def test_windows_share_their_shape_and_hold_little_more_than_asked(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((300, 300)))
    a = read_dem(path, vertical_datum=0, bounds=(5.03, 44.83, 5.06, 44.86))
    b = read_dem(path, vertical_datum=0, bounds=(5.10, 44.80, 5.145, 44.835))
    assert posts_of(a).shape == posts_of(b).shape
    assert jax.tree.structure(a) == jax.tree.structure(b)
    assert tuple(np.asarray(a.extent)) != tuple(np.asarray(b.extent))
    assert int(extent_of(a)[0]) <= 0.03 / DEGREE + 5


def test_padded_files_of_about_one_size_share_their_programs_and_keep_their_ground(tmp_path: pathlib.Path) -> None:
    """Posts, edges and voids are those of the file; what lies beyond is no ground."""
    found = []
    for shape in ((40, 50), (61, 33)):
        heights = hills(shape)
        heights[10:12, 20:25] = np.nan
        path = write(tmp_path / f"{shape[0]}.tif", heights)
        whole, padded = (read_dem(path, vertical_datum=0, padded=one) for one in (False, True))
        assert tuple(extent_of(padded)) == shape == posts_of(whole).shape
        np.testing.assert_array_equal(posts_of(padded)[: shape[0], : shape[1]], posts_of(whole))
        row = np.array([0.0, 5.5, 10.5, shape[0] - 1.0, shape[0] - 0.5])
        there = places(np.full(5, 5.0 + DEGREE * 23.0), 45.0 - DEGREE * (row + 0.5))
        np.testing.assert_array_equal(heights_at(padded, there), heights_at(whole, there))
        assert np.isnan(heights_at(padded, there)).tolist() == [False, False, True, False, True]
        for name in ("lowest", "highest", "void_ceiling", "has_void"):
            np.testing.assert_array_equal(getattr(padded, name), getattr(whole, name))
        found.append(padded)
    forms = [jax.tree.map(lambda x: (np.shape(x), np.asarray(x).dtype), one) for one in found]
    assert forms[0] == forms[1]


def test_bounds_cross_the_date_line(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((60, 80)), affine=Affine(1e-3, 0, 179.96, 0, -1e-3, -16.0))
    whole = read_dem(path, vertical_datum=0)
    part = read_dem(path, vertical_datum=0, bounds=(179.99, -16.03, -179.98, -16.01))
    lon, lat = np.array([179.995, 179.9999, -179.9999, -179.985, 180.01]), np.array([-16.02] * 5)
    expected = heights_at(whole, places(lon, lat))
    assert np.all(np.isfinite(expected))
    np.testing.assert_allclose(heights_at(part, places(lon, lat)), expected, rtol=0, atol=1e-6)
    assert int(extent_of(part)[1]) < 40


@pytest.mark.parametrize("west", [-180.0, 0.0])
def test_a_global_file_is_cut_across_its_own_edge(tmp_path: pathlib.Path, west: float) -> None:
    posts = 500.0 + np.arange(180.0)[:, None] + np.arange(360.0)[None, :]
    path = write(tmp_path / "dem.tif", posts, affine=Affine(1.0, 0, west, 0, -1.0, 90.0))
    dem = read_dem(path, vertical_datum=0, bounds=(west - 5.0, 10.0, west + 5.0, 20.0))
    lon = west + np.array([-3.5, -0.5, 0.5, 3.5])
    expected = posts[75, [356, 359, 0, 3]]
    np.testing.assert_allclose(heights_at(dem, places(lon, np.full(4, 14.5))), expected, rtol=0, atol=1e-6)


@pytest.mark.costly
@pytest.mark.parametrize("repeated", [0, 1])
@pytest.mark.parametrize("west", [-180.0, 0.0])
def test_a_grid_round_the_earth_is_read_as_a_whole_or_in_parts(
    tmp_path: pathlib.Path, west: float, repeated: int
) -> None:
    """A part may lie across the seam where its ends meet, and the whole has ground there; also if a column repeats."""
    posts = 500.0 + np.arange(180.0)[:, None] + 100.0 * np.sin(np.radians(np.arange(360.0 + repeated)))[None, :]
    posts[80:85, 0] = posts[80:85, 360 * repeated] = -9999.0
    path = write(tmp_path / "dem.tif", posts, affine=Affine(1.0, 0, west, 0, -1.0, 90.0), nodata=-9999.0)
    lon, lat = west + np.array([-0.5, 0.0, 0.5]), np.full(3, 0.5)
    expected = [posts[89, 359], (posts[89, 359] + posts[89, 0]) / 2, posts[89, 0]]
    for bounds in (None, (-180, -90, 180, 90), (0, -90, 360, 90), (west - 10, -60, west + 10, 60)):
        dem, report = read_dem_and_report(path, vertical_datum=0, bounds=bounds)
        np.testing.assert_allclose(heights_at(dem, places(lon, lat)), expected, rtol=0, atol=1e-6)
        if report.shape[1] > 100:
            assert (report.shape, report.voids) == ((180, 360 + repeated), 5 * (1 + repeated))
            assert int(np.asarray(dem.extent)[1]) == 362
            assert report.map_error_metres < 1e-4


@pytest.mark.parametrize("bounds", [(-170, 10, 170, 20), (-180, 10, 180, 20), (150, 10, 250, 20), (-90, 10, -70, 20)])
def test_bounds_are_cut_from_a_file_in_0_to_360_wherever_they_lie_in_it(tmp_path: pathlib.Path, bounds) -> None:
    """The file reaches from 0 to 300 deg; what lies west of Greenwich within the bounds is not left out."""
    posts = 500.0 + np.arange(180.0)[:, None] + np.arange(300.0)[None, :]
    path = write(tmp_path / "dem.tif", posts, affine=Affine(1.0, 0, 0.0, 0, -1.0, 90.0))
    dem = read_dem(path, vertical_datum=0, bounds=bounds)
    lon = np.arange(0.5, 299.6)
    west, _, east, _ = bounds
    wanted = lon[((lon - west) % 360.0) < east - west]
    found = heights_at(dem, places(wanted, np.full(wanted.shape, 14.5)))
    np.testing.assert_allclose(found, posts[75, np.floor(wanted).astype(int)], rtol=0, atol=1e-6)


def test_bounds_of_the_whole_earth_are_the_whole_file(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", hills((60, 80)), crs="EPSG:32631", affine=Affine(30, 0, 657596, 0, -30, 4987377))
    report = read_dem_and_report(path, vertical_datum=0, bounds=(-180, -90, 180, 90))[1]
    assert report.shape == (60, 80)


def test_bounds_around_a_pole(tmp_path: pathlib.Path) -> None:
    affine = Affine(1000, 0, -200000, 0, -1000, 200000)
    path = write(tmp_path / "dem.tif", hills((400, 400)), crs="EPSG:3031", affine=affine)
    dem, report = read_dem_and_report(path, vertical_datum=0, bounds=(-180, -90, 180, -89.5))
    assert 110 < report.shape[0] < 120  # 1 degree is 111.7 km, times the map's scale of 0.973
    lon, lat = np.array([-170.0, -60.0, 0.0, 45.0, 180.0]), np.array([-89.99, -89.7, -90.0, -89.51, -89.6])
    assert np.all(np.isfinite(heights_at(dem, places(lon, lat))))


def test_tiles_are_one_ground(tmp_path: pathlib.Path) -> None:
    """Four tiles that share their border posts, named in any order, equal the one file they were cut from."""
    posts = hills((61, 81))
    whole = read_dem(write(tmp_path / "whole.tif", posts), vertical_datum="ellipsoid")
    tiles = []
    for r, c in ((30, 40), (0, 0), (30, 0), (0, 40)):
        part = posts[r : r + 31, c : c + 41].copy()
        affine = Affine(DEGREE, 0, 5.0 + c * DEGREE, 0, -DEGREE, 45.0 - r * DEGREE)
        tiles.append(write(tmp_path / f"{r}_{c}.tif", part, affine=affine))
    joined, report = read_dem_and_report(tiles, vertical_datum="ellipsoid")
    np.testing.assert_array_equal(joined.posts, whole.posts)
    np.testing.assert_allclose(joined.grid.rowcol(whole.grid.normal(jnp.zeros(2))), 0.0, rtol=0, atol=1e-6)
    assert report.first_post == (-30, -40)
    assert len(report.files) == 4
    window = {"vertical_datum": "ellipsoid", "bounds": (5.02, 44.96, 5.05, 44.99)}
    np.testing.assert_array_equal(read_dem(tiles, **window).posts, read_dem(tmp_path / "whole.tif", **window).posts)


def test_tiles_meet_at_the_date_line_and_leave_voids_where_none_is(tmp_path: pathlib.Path) -> None:
    east = write(tmp_path / "E179.tif", np.full((10, 10), 100.0), affine=Affine(0.01, 0, 179.9, 0, -0.01, 1.0))
    west = write(tmp_path / "W180.tif", np.full((10, 10), 200.0), affine=Affine(0.01, 0, -180.0, 0, -0.01, 0.95))
    dem = read_dem([east, west], vertical_datum=0)
    assert posts_of(dem).shape == (15, 20)
    assert int(np.sum(dem.void)) == 100
    np.testing.assert_array_equal(np.asarray(dem.posts)[7, [0, 9, 10, 19]], [100.0, 100.0, 200.0, 200.0])


def test_voids_of_one_tile_are_filled_by_another(tmp_path: pathlib.Path) -> None:
    a, b = np.full((5, 5), 7.0), np.full((5, 5), 9.0)
    a[2, 2], b[1, 1] = np.nan, np.nan
    dem = read_dem([write(tmp_path / "a.tif", a), write(tmp_path / "b.tif", b)], vertical_datum=0)
    assert not np.any(dem.void)
    assert posts_of(dem)[2, 2] == 9.0
    assert posts_of(dem)[1, 1] == 7.0


VOIDS = {
    "tag": {"nodata": -9999.0},
    "NaN tag": {"nodata": np.nan},
    "mask band": {},
    "wrong tag, said by the caller": {"nodata": 0.0},
}


@pytest.mark.parametrize("kind", VOIDS)
def test_any_kind_of_void(tmp_path: pathlib.Path, kind: str) -> None:
    heights, unknown = hills((12, 14)).astype(np.float32), np.zeros((12, 14), bool)
    unknown[3:5, 6:9] = True
    heights[unknown] = {"NaN tag": np.nan, "mask band": 1.0}.get(kind, -9999.0)
    heights[0, 0] = np.nan  # NaN is a void in spite of any tag
    unknown[0, 0] = True
    mask = np.where(unknown, 0, 255).astype(np.uint8) if kind == "mask band" else None
    path = write(tmp_path / "dem.tif", heights, mask=mask, **VOIDS[kind])
    dem = read_dem(path, vertical_datum=0, nodata=-9999.0 if "caller" in kind else None)
    np.testing.assert_array_equal(dem.void, unknown)
    assert np.all(np.isfinite(dem.posts))


def test_an_alpha_band_masks_too(tmp_path: pathlib.Path) -> None:
    alpha = np.full((6, 7), 255.0, np.float32)
    alpha[2, 3] = 0.0
    bands = np.stack([hills((6, 7)).astype(np.float32), alpha])
    path = write(tmp_path / "dem.tif", bands, photometric="minisblack", alpha="yes")
    assert np.argwhere(read_dem(path, vertical_datum=0).void).tolist() == [[2, 3]]


def test_scale_offset_and_band(tmp_path: pathlib.Path) -> None:
    stored = np.stack([np.zeros((5, 6)), np.arange(30.0).reshape(5, 6)]).astype(np.int16)
    path = write(tmp_path / "dem.tif", stored, scale=0.5, offset=100.0)
    dem = read_dem(path, vertical_datum=10.0, band=2)
    np.testing.assert_allclose(dem.posts, 110.0 + 0.5 * stored[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "unit, height_unit, metres",
    [(None, None, 1.0), ("ft", None, 0.3048), ("us-ft", None, 1200 / 3937), (None, "ft", 0.3048), ("ft", "m", 1.0)],
)
def test_units_of_height(tmp_path: pathlib.Path, unit: str | None, height_unit: str | None, metres: float) -> None:
    path = write(tmp_path / "dem.tif", hills((5, 6)), unit=unit)
    dem = read_dem(path, vertical_datum="ellipsoid", height_unit=height_unit)
    np.testing.assert_allclose(dem.posts, hills((5, 6)) * metres, rtol=0, atol=1e-9)


def test_posts_in_memory_have_the_dtype_asked_for(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", np.round(hills((5, 6))).astype(np.int16))
    assert posts_of(read_dem(path, vertical_datum="ellipsoid")).dtype == jnp.float64
    assert posts_of(read_dem(path, vertical_datum="EPSG:5773", dtype=np.float32)).dtype == jnp.float32
    assert posts_of(read_dem(path, vertical_datum="ellipsoid", dtype=np.int16)).dtype == jnp.int16


def test_other_formats(tmp_path: pathlib.Path) -> None:
    """SRTM .hgt, DTED, a VRT and a cloud-optimised GeoTIFF hold the same posts."""
    posts = np.round(hills((1201, 1201))).astype(np.int16)
    affine = Affine(DEGREE, 0, 5.0 - DEGREE / 2, 0, -DEGREE, 45.0 + DEGREE / 2)
    tif = write(tmp_path / "dem.tif", posts, affine=affine, nodata=-32768)
    with rasterio.open(tif) as data:
        for name, driver in (("N44E005.hgt", "SRTMHGT"), ("e005n44.dt1", "DTED"), ("dem.vrt", "VRT"), ("c.tif", "COG")):
            rasterio.shutil.copy(data, tmp_path / name, driver=driver)
    window = {"vertical_datum": 0, "bounds": (5.2, 44.2, 5.24, 44.24)}
    expected = read_dem(tif, **window)
    for name in ("N44E005.hgt", "e005n44.dt1", "dem.vrt", "c.tif"):
        dem = read_dem(tmp_path / name, **window)
        np.testing.assert_array_equal(dem.posts, expected.posts)
        np.testing.assert_allclose(
            dem.grid.rowcol(expected.grid.normal(jnp.array([3.0, 4.0]))), [3.0, 4.0], rtol=0, atol=1e-5
        )


def test_void_ceiling_is_passed_on(tmp_path: pathlib.Path) -> None:
    heights = hills((6, 7))
    heights[2, 2] = np.nan
    dem = read_dem(write(tmp_path / "dem.tif", heights), vertical_datum=0, void_ceiling=2000.0)
    assert float(np.asarray(dem.void_ceiling)) == 2000.0


def test_a_file_beside_that_is_no_auxiliary_file_of_gdal_is_passed_over(tmp_path: pathlib.Path) -> None:
    """LaTeX writes map.aux beside map.tif; GDAL opens such a file only if its first bytes are those of Imagine."""
    write(tmp_path / "map.tif", hills((9, 11)))
    alone = read_dem(tmp_path / "map.tif", vertical_datum="ellipsoid")
    (tmp_path / "map.aux").write_text("\\relax \n")
    np.testing.assert_array_equal(read_dem(tmp_path / "map.tif", vertical_datum="ellipsoid").posts, alone.posts)
