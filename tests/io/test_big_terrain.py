"""Terrain that stays on disk: first hits over folders of tiles and VRTs are those over the whole, in little memory."""

from __future__ import annotations

import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine
from support.fractal import ecef
from support.mosaics import (
    NORTH,
    SIZE,
    STEP,
    WEST,
    answers,
    corner,
    cut,
    first_crossing,
    mixed_rays,
    rays_to,
    ridge_before_plain,
    same,
    whole,
)
from support.rasters import write

import jaxgeo
from jaxgeo import Fix, Ray, Status
from jaxgeo.io import DemError, intersect_files, locate_files, locate_on_disk, open_dem, read_dem

pytestmark = [pytest.mark.costly, pytest.mark.usefixtures("small_blocks")]


@pytest.mark.parametrize(
    "kind", ["whole.tif", "shared", pytest.param("beside/*.tif", marks=pytest.mark.slow), "mosaic.vrt"]
)
def test_every_answer_is_that_over_the_whole(
    ridge: pathlib.Path, expected: Fix, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """250 rays of every kind, over each kind of file, in few large windows and in many small ones."""
    rays = mixed_rays()
    splittings = [(10**9, 1.0), (500, 0.6)]
    if kind == "beside/*.tif":
        splittings.append((300, 99.0))  # almost a window for every ray
    for smallest, saving in splittings:
        monkeypatch.setattr(locate_on_disk, "WORTH_SPLITTING", smallest)
        monkeypatch.setattr(locate_on_disk, "SAVING", saving)
        files = open_dem(f"{ridge / kind}", vertical_datum="ellipsoid")
        same(intersect_files(rays, files), expected)
    counts = jaxgeo.status.count_statuses(expected.status)
    print(counts)
    wanted = ("hit", "enters_from_side", "leaves_terrain", "ray_misses_terrain", "rises_away", "enters_below_terrain")
    assert all(counts.get(Status[name], 0) > 2 for name in wanted)


def test_a_ridge_in_the_first_tile_hides_the_plain_in_the_second(ridge: pathlib.Path) -> None:
    """Against a march over the array: zero wrong, of rays of which many would reach the plain without the ridge."""
    rng = np.random.default_rng(3)
    rays = rays_to(
        rng.uniform(10, 190, 200), rng.uniform(22, 90, 200), 105.0, rng.uniform(1.3, 1.8, 200),
        np.radians(rng.uniform(60, 82, 200)), 9000.0,
    )  # fmt: skip
    fix = intersect_files(rays, open_dem(ridge / "shared", vertical_datum="ellipsoid"))
    march, closest = first_crossing(ridge_before_plain(), rays).T
    clear = closest > 0.2  # m: what a march of 4 m may pass over is no comparison
    assert clear.sum() > 150
    found = np.asarray(fix.found)
    np.testing.assert_array_equal(found[clear], np.isfinite(march[clear]))
    np.testing.assert_allclose(np.asarray(fix.slant_range)[clear & found], march[clear & found], rtol=0, atol=1e-5)
    on_ridge = (np.degrees(np.asarray(fix.position.lon)) - WEST) / STEP < 13.0
    assert 20 < np.sum(on_ridge & clear) < 180


def test_the_window_of_a_corridor_has_no_edge_for_its_rays(ridge: pathlib.Path, expected: Fix) -> None:
    """`corridor` for each kind of ray alone, used with plain `intersect`; its grid lies where the mosaic's does."""
    rays = mixed_rays()
    files = open_dem(ridge / "shared", vertical_datum="ellipsoid")
    smallest = SIZE**2
    kinds = (Status.hit, 4), (Status.enters_from_side, 3), (Status.enters_below_terrain, 1)
    for index in np.concatenate([np.flatnonzero(expected.status == kind)[-n:] for kind, n in kinds]):
        one = Ray(rays.origin[index], rays.direction[index])
        dem = files.corridor(one)
        smallest = min(smallest, int(np.prod(np.asarray(dem.extent))))
        fix = answers(Ray(one.origin[None], one.direction[None]), dem)
        assert fix.status[0] == expected.status[index]
        np.testing.assert_allclose(fix.slant_range[0], expected.slant_range[index], rtol=0, atol=1e-7)
    assert smallest < 0.05 * SIZE**2
    plumb = rays_to([100.0], [100.0], 110.0, 0.0, 0.0, 500.0)
    narrow, wide = (np.asarray(files.corridor(plumb, margin=margin).extent) for margin in (0, 5))
    np.testing.assert_array_equal(wide, narrow + 10)


def test_a_missing_tile_is_never_hit(ridge: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """Unknown ground, with its ceiling the same for every window: that of the highest post anywhere, or as stated."""
    posts = ridge_before_plain()
    cut(tmp_path / "tiles", posts, shared=False, leave_out=(44, 45, 54, 55))
    holed = posts.copy()
    holed[80:120, 80:120] = np.nan
    path, rays = write(tmp_path / "holed.tif", holed, affine=corner(0, 0)), mixed_rays()
    into = rays_to(np.linspace(85, 115, 30), 100.0, 0.0, np.linspace(0, 6.2, 30), np.radians(40.0), 4000.0)
    for ceiling in (None, 120.0):
        files = open_dem(tmp_path / "tiles", vertical_datum="ellipsoid", void_ceiling=ceiling)
        reference = answers(rays, whole(path, void_ceiling=ceiling))
        same(intersect_files(rays, files), reference)
        assert np.sum(reference.status == Status.hits_void) > 5
        fix = intersect_files(into, files)
        assert set(np.asarray(fix.status).tolist()) == {Status.hits_void.value}
        same(fix, answers(into, whole(path, void_ceiling=ceiling)))


def test_pixels_of_a_shot_see_the_same_ground(ridge: pathlib.Path) -> None:
    """`locate_files` is `locate` over the whole, pixels beside the image included."""
    camera = jaxgeo.FrameCamera.from_pixels(focal_px=800.0, width=640, height=480)
    sensor = jaxgeo.Sensor(camera, mount=jaxgeo.Mount.forward())
    lat, lon = NORTH - 100 * STEP, WEST + 90 * STEP
    shot = jaxgeo.Shot(
        jaxgeo.Pose.from_degrees(lat=lat, lon=lon, height=2500.0, heading=80.0, pitch=-40.0, roll=3.0), jnp.zeros(0)
    )
    uv = np.array([[[0.0, 0.0], [639.0, 0.0], [320.0, 240.0]], [[0.0, 479.0], [639.0, 479.0], [-50.0, 10.0]]])
    files = open_dem(ridge / "shared", vertical_datum="ellipsoid")
    fix = locate_files(sensor, shot, uv, files)
    assert fix.status.shape == (2, 3)
    assert Status(int(fix.status[1, 2])) is Status.outside_image
    assert np.isnan(float(fix.slant_range[1, 2]))
    assert np.all(np.asarray(fix.ok).reshape(-1)[:5])
    origin, direction, _ = locate_on_disk._lines_of_sight(sensor, shot, jnp.zeros(()), jnp.asarray(uv.reshape(-1, 2)))
    expected = answers(Ray(np.asarray(origin)[:5], np.asarray(direction)[:5]), whole(ridge / "whole.tif"))
    np.testing.assert_allclose(np.asarray(fix.ecef).reshape(-1, 3)[:5], expected.ecef, rtol=0, atol=1e-7)


def test_rays_too_far_apart_are_refused_or_grouped(ridge: pathlib.Path) -> None:
    files = open_dem(ridge / "shared", vertical_datum="ellipsoid")
    rays = rays_to(np.array([20.0, 180.0]), np.array([60.0, 180.0]), 110.0, 1.0, 0.5, 2000.0)
    with pytest.raises(DemError, match=r"these 2 rays together can touch \d+ x \d+ posts, more than max_posts=5000"):
        files.corridor(rays, max_posts=5000)
    assert np.all(np.asarray(intersect_files(rays, files, max_posts=5000).ok))
    low = rays_to(np.array([100.0, 100.0]), np.array([100.0, 100.0]), 110.0, 1.5, np.array([0.0, 1.3]), 2000.0)
    with pytest.raises(DemError, match=r"ray 1 alone can touch \d+ x \d+ posts, more than max_posts=20\."):
        intersect_files(low, files, max_posts=20)


def test_rays_that_have_no_answer(ridge: pathlib.Path) -> None:
    files = open_dem(ridge / "shared", vertical_datum="ellipsoid")
    rays = rays_to(np.full(5, 100.0), np.full(5, 100.0), 110.0, 0.0, 0.5, 2000.0)
    origin, direction = rays.origin.copy(), rays.direction.copy()
    origin[0, 1] = np.nan
    direction[1] *= 1.1
    direction[2] *= -1.0
    origin[2] *= 1.01  # up and away
    fix = intersect_files(Ray(origin, direction), files)
    names = [Status(int(code)).name for code in np.asarray(fix.status)]
    assert names == ["invalid_input", "invalid_input", "rises_away", "hit", "hit"]
    assert np.all(np.isnan(np.asarray(fix.ecef)[:3]))
    batch = jax.tree.map(lambda x: np.asarray(x)[3:].reshape(2, 1, 3), Ray(origin, direction))
    assert intersect_files(batch, files).slant_range.shape == (2, 1)
    with pytest.raises(DemError, match="none of the 1 rays can touch the ground of these files"):
        files.corridor(Ray(origin[2], direction[2]))
    with pytest.raises(ValueError, match=r"one shape \(\.\.\., 3\)"):
        intersect_files(Ray(origin, direction[:2]), files)


def test_the_seam_of_a_mosaic_around_the_earth_is_no_edge(tmp_path: pathlib.Path) -> None:
    """A world in columns of 1 degree: a ray over the date line meets the hill on the other side."""
    posts = np.full((180, 360), 100.0)
    posts[:, 0] = 8000.0
    path = write(tmp_path / "world.tif", posts, affine=Affine(1.0, 0, -180.0, 0, -1.0, 90.0))
    files = open_dem(path, vertical_datum="ellipsoid")
    assert files.blocks.turn == 360
    lat, lon = np.radians(0.5), np.radians(179.0)
    east, up = np.array([-np.sin(lon), np.cos(lon), 0.0]), np.array([np.cos(lon), np.sin(lon), 0.0])
    fix = intersect_files(Ray(ecef(lat, lon, 4000.0), east), files)
    assert Status(int(fix.status)) is Status.hit
    assert -179.9 < np.degrees(float(fix.position.lon)) < -179.5
    down = intersect_files(Ray(ecef(lat, np.radians(179.9), 9000.0), -up), files)
    assert Status(int(down.status)) is Status.hit
    np.testing.assert_allclose(down.position.height, 100.0 + 0.4 * 7900.0, rtol=0, atol=40.0)  # the slope to the hill


def test_real_ground_cut_into_tiles(jaxgeo_test_data: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """Alps with voids and EGM96, cut into tiles of several sizes, against the same ground in one piece."""
    rows, cols = slice(200, 400), slice(900, 1100)
    with rasterio.open(jaxgeo_test_data / "dem" / "N44E005.hgt") as data:
        stored, t = data.read(1), data.transform
    (tmp_path / "tiles").mkdir()
    for r in (*range(rows.start, rows.stop, 73),):
        for c in (*range(cols.start, cols.stop, 41),):
            part = stored[r : min(r + 74, rows.stop), c : min(c + 42, cols.stop)]
            here = Affine(t.a, 0, t.c + c * t.a, 0, t.e, t.f + r * t.e)
            write(tmp_path / "tiles" / f"{r}_{c}.tif", part, affine=here, nodata=-32768)
    here = Affine(t.a, 0, t.c + cols.start * t.a, 0, t.e, t.f + rows.start * t.e)
    one = write(tmp_path / "one.tif", stored[rows, cols], affine=here, nodata=-32768)
    assert 20 < np.sum(stored[rows, cols] == -32768) < 10_000
    dem = read_dem(one, vertical_datum="EPSG:5773", bounds=(-180, -90, 180, 90))
    rng = np.random.default_rng(2)
    row, col = rng.uniform(0, 200, (2, 200))
    row, col = row + (NORTH - t.f) / STEP + rows.start, col + (t.c - WEST) / STEP + cols.start
    rays = rays_to(row, col, rng.uniform(500, 3000, 200), rng.uniform(0, 6.3, 200), rng.uniform(0, 1.4, 200), 5000.0)
    expected = answers(rays, dem)
    limits = float(np.asarray(dem.lowest)), float(np.asarray(dem.highest))
    files = open_dem(tmp_path / "tiles", vertical_datum="EPSG:5773", height_range=limits)
    same(intersect_files(rays, files), expected)
    for name in ("hit", "hits_void", "leaves_terrain", "enters_from_side"):
        assert np.sum(expected.status == Status[name]) > 3, name


def test_a_mosaic_on_a_fitted_map(tmp_path: pathlib.Path) -> None:
    """Lambert 93: the corridor holds the mosaic's posts where the mosaic has them, under the rays."""
    posts = ridge_before_plain()
    path = write(tmp_path / "dem.tif", posts, crs="EPSG:2154", affine=Affine(90, 0, 900000, 0, -90, 6400000))
    dem = whole(path)
    up = np.asarray(dem.grid.normal(jnp.array([100.0, 100.0])))
    lat, lon = np.arcsin(up[2]), np.arctan2(up[1], up[0])
    direction = np.sin(1.3) * np.array([-np.sin(lon), np.cos(lon), 0.0]) - np.cos(1.3) * up
    target = ecef(lat, lon, 110.0)
    files = open_dem(path, vertical_datum="ellipsoid")
    part = files.corridor(Ray(target - 4000.0 * direction, direction))
    rows, cols = np.asarray(part.extent)
    assert rows * cols < 0.2 * SIZE**2
    row, col = (int(n) for n in np.round(100.0 - np.asarray(part.grid.rowcol(jnp.asarray(up)))))
    np.testing.assert_allclose(part.grid.rowcol(jnp.asarray(up)), [100 - row, 100 - col], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(np.asarray(part.posts)[:rows, :cols], posts[row : row + rows, col : col + cols])
