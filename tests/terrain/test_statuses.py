"""Every status of rays over real and made ground with voids, against a march in NumPy that knows only definitions."""

from __future__ import annotations

import pathlib
from collections import Counter

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
import rasterio
from rasterio.transform import Affine
from support.rasters import hills, write
from support.statuses import Marched, Outcome, aimed, differences, hits, stored

from jaxgeo import Dem, Ray, intersect
from jaxgeo.io import intersect_files, open_dem, read_dem
from jaxgeo.status import count_statuses

SIZE = 121  # posts on a side that are taken from each file
NEAREST = 1e-3  # m: rays that come nearer to another outcome may be told either
AREAS = {
    "SRTM": "N44E005.hgt",
    "SRTM in UTM": "N44E005_UTM.tif",
    "SRTM with a hole": "N44E005_big_hole.tif",
    "photogrammetric": "exploradores_aster_AST_L1A_00303182012144228_Z.tif",
}


class Ground:
    """Posts written to a file and read by jaxgeo, and the same in NumPy and PROJ."""

    def __init__(self, path: pathlib.Path, posts: np.ndarray, crs: pyproj.CRS, affine: Affine) -> None:
        self.path = write(path, np.where(np.isnan(posts), -9999.0, posts), crs=crs, affine=affine, nodata=-9999.0)
        self.dem = read_dem(self.path, vertical_datum=0)
        self.affine, self.posts = affine, posts
        self.to_map = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True, allow_ballpark=False)
        metres = 111e3 if crs.is_geographic else 1.0
        self.march = Marched(posts, self._rowcol, abs(affine.e) * metres)

    def _rowcol(self, lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = self.to_map.transform(lon, lat)
        return (y - self.affine.f) / self.affine.e - 0.5, (x - self.affine.c) / self.affine.a - 0.5

    def lonlat(self, row: np.ndarray, col: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y = self.affine.c + self.affine.a * (col + 0.5), self.affine.f + self.affine.e * (row + 0.5)
        return self.to_map.transform(x, y, direction="INVERSE")

    def rays(self, count: int, seed: int) -> Ray:
        """Rays of all kinds, of each about as many."""
        rng, kinds = np.random.default_rng(seed), (self._down, self._over_edges, self._along_edges, self._around)
        each = -(-count // len(kinds))
        parts = [kind(rng, each) for kind in kinds]
        origin, direction = (np.concatenate(side)[:count] for side in zip(*parts, strict=True))
        return Ray(jnp.asarray(origin), jnp.asarray(direction))

    def _heights(self, rng: np.random.Generator, count: int, below: float, above: float) -> np.ndarray:
        low, high = np.nanmin(self.posts), np.nanmax(self.posts)
        return rng.uniform(low - below, high + above, count)

    def _down(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Through places over the area, many over voids, from near, from far and from orbits."""
        void = np.argwhere(np.isnan(self.posts))
        row, col = rng.uniform(0, SIZE - 1, (2, count))
        some = rng.choice(len(void), count // 3)
        row[: count // 3], col[: count // 3] = (void[some] + rng.uniform(-1.5, 1.5, (count // 3, 2))).T
        heights = self._heights(rng, count, 200.0, 100.0)
        elevation, reach = (-85.0, -1.0), 10.0 ** rng.uniform(1.0, 4.5)
        near = aimed(rng, *self.lonlat(row, col), heights, elevation=elevation, back=(0.0, reach))
        far = aimed(rng, *self.lonlat(row, col), heights, elevation=(-85.0, -5.0), back=(5e5, 3e7))
        few = count // 5
        return np.concatenate([near[0][few:], far[0][:few]]), np.concatenate([near[1][few:], far[1][:few]])

    def _over_edges(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Through places over the edges or close to them, from below all posts to above them, up and down."""
        row, col = self._edge(rng, count, 2.0)
        heights = self._heights(rng, count, 3000.0, 200.0)
        return aimed(rng, *self.lonlat(row, col), heights, elevation=(-60.0, 20.0), back=(0.0, 2e4))

    def _along_edges(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Nearly along the lines of posts, most along the outer ones."""
        row, col = self._edge(rng, count, 0.05)
        is_row = (np.abs(row - np.round(row)) < 0.06) & ((row < 1.0) | (row > SIZE - 2.0))
        lon, lat = self.lonlat(row, col)
        far_lon, far_lat = self.lonlat(np.where(is_row, row, row + 1.0), np.where(is_row, col + 1.0, col))
        azimuth, _, _ = pyproj.Geod(ellps="WGS84").inv(lon, lat, far_lon, far_lat)
        azimuth = np.radians(azimuth + 180.0 * rng.integers(0, 2, count)) + rng.normal(0.0, 2e-3, count)
        heights = self._heights(rng, count, 500.0, 100.0)
        return aimed(rng, lon, lat, heights, elevation=(-12.0, 6.0), back=(0.0, 2e4), azimuth=azimuth)

    def _around(self, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        """From over the area, beside it and below it, in all directions."""
        row, col = rng.uniform(-0.5 * SIZE, 1.5 * SIZE, (2, count))
        heights = self._heights(rng, count, 1500.0, 2000.0)
        return aimed(rng, *self.lonlat(row, col), heights, elevation=(-89.0, 89.0), back=(0.0, 1.0))

    def _edge(self, rng: np.random.Generator, count: int, width: float) -> tuple[np.ndarray, np.ndarray]:
        """(row, col) within `width` cells of one of the four edges."""
        along, across = rng.uniform(0.0, SIZE - 1.0, count), rng.uniform(-width, width, count)
        side = rng.integers(0, 4, count)
        across = np.where(side % 2 == 0, across, SIZE - 1.0 + across)
        return np.where(side < 2, across, along), np.where(side < 2, along, across)


def made(folder: pathlib.Path) -> Ground:
    """Rough hills with holes, one of them at an edge and one at a corner."""
    posts = 3.0 * hills((SIZE, SIZE), seed=2) + np.random.default_rng(3).normal(0.0, 15.0, (SIZE, SIZE))
    posts[40:52, 60:75] = posts[:9, 30:80] = posts[100:, 110:] = posts[70, 10] = np.nan
    return Ground(folder / "made.tif", posts, pyproj.CRS("EPSG:4326"), Affine(1 / 1200, 0, 5.0, 0, -1 / 1200, 44.6))


def cut_from(path: pathlib.Path, folder: pathlib.Path) -> Ground:
    """The part of a file that has the most edges of voids, but is known for the most part."""
    with rasterio.open(path) as file:
        values, affine, crs = file.read(1).astype(np.float64), file.transform, file.crs
        unknown = (file.read_masks(1) == 0) | (values < -1000.0)
    values[unknown] = np.nan
    border = (unknown[1:, 1:] != unknown[:-1, 1:]) | (unknown[1:, 1:] != unknown[1:, :-1])
    rows, cols = (range(0, n - SIZE, SIZE // 2) for n in values.shape)
    parts = [(r, c) for r in rows for c in cols if unknown[r : r + SIZE, c : c + SIZE].mean() < 0.4]
    row, col = max(parts, key=lambda p: border[p[0] : p[0] + SIZE, p[1] : p[1] + SIZE].sum())
    posts = values[row : row + SIZE, col : col + SIZE]
    a, _, c, _, e, f = affine[:6]
    return Ground(folder / "cut.tif", posts, pyproj.CRS(crs), Affine(a, 0.0, c + a * col, 0.0, e, f + e * row))


def padded(dem: Dem) -> Dem:
    """The same terrain among more stored posts, as one compiled program takes it."""
    posts = np.where(dem.void, np.nan, dem.posts)
    return Dem.from_array(stored(posts), dem.grid, extent=posts.shape)


def told(ground: Ground, rays: Ray) -> tuple[list[Outcome], np.ndarray, np.ndarray]:
    fix = hits(rays, padded(ground.dem))
    outcomes = ground.march.outcomes(np.asarray(rays.origin), np.asarray(rays.direction))
    return outcomes, np.asarray(fix.status), np.asarray(fix.slant_range)


ALL = ("hit", "enters_from_side", "hits_void", "rises_away", "leaves_terrain", "ray_misses_terrain")
ALL += ("enters_below_terrain", "camera_below_terrain")


def check(ground: Ground, count: int, seed: int, least: int) -> None:
    outcomes, status, distance = told(ground, ground.rays(count, seed))
    counts = Counter({kind.name: n for kind, n in count_statuses(status).items()})
    print(ground.path.name, dict(counts))
    assert sum(outcome.margin < NEAREST for outcome in outcomes) <= 0.01 * count
    assert differences(outcomes, status, distance, NEAREST) == []
    assert all(counts[name] >= least for name in ALL), counts


@pytest.mark.costly
def test_no_ray_over_made_ground_has_a_status_that_is_wrong_by_its_definition(tmp_path):
    check(made(tmp_path), 256, seed=1, least=3)


@pytest.mark.slow
@pytest.mark.parametrize("area", AREAS)
def test_no_ray_over_real_ground_has_a_status_that_is_wrong_by_its_definition(jaxgeo_test_data, tmp_path, area):
    """1000 rays each, with those over made ground 5000."""
    check(cut_from(jaxgeo_test_data / "dem" / AREAS[area], tmp_path), 1000, seed=2, least=10)


@pytest.mark.slow
def test_no_ray_over_made_ground_is_wrong_of_a_thousand(tmp_path):
    check(made(tmp_path), 1000, seed=3, least=10)


@pytest.mark.slow
def test_one_ray_alone_many_together_and_files_on_disk_say_the_same(tmp_path):
    """Of each status some rays: alone, in a batch, batches of batches, and over the file without reading all of it."""
    ground = made(tmp_path)
    rays = ground.rays(256, seed=1)
    together = hits(rays, ground.dem)
    status, distance = np.asarray(together.status), np.asarray(together.slant_range)
    nested = eqx.filter_jit(jax.vmap(jax.vmap(intersect, in_axes=(0, None)), in_axes=(0, None)))(
        jax.tree.map(lambda x: x.reshape(16, 16, 3), rays), ground.dem
    )
    np.testing.assert_array_equal(np.asarray(nested.status).reshape(-1), status)
    np.testing.assert_allclose(np.asarray(nested.slant_range).reshape(-1), distance, rtol=0, atol=1e-6)
    files = open_dem(ground.path, vertical_datum=0)
    on_disk = intersect_files(rays, files)
    np.testing.assert_array_equal(on_disk.status, status)
    np.testing.assert_allclose(on_disk.slant_range, distance, rtol=0, atol=1e-6)
    alone = jax.jit(intersect)
    for code in np.unique(status):
        for k in np.flatnonzero(status == code)[:2]:
            fix = alone(jax.tree.map(lambda x, k=k: x[k], rays), ground.dem)
            assert fix.status == code
            np.testing.assert_allclose(fix.slant_range, distance[k], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_derivatives_are_finite_where_there_is_a_point_and_nothing_where_there_is_none(tmp_path):
    """Also of rays that come in below all ground, where the point is that of the edge of a void."""
    ground = made(tmp_path)
    rays = ground.rays(256, seed=1)

    @eqx.filter_jit
    def slopes(rays: Ray, dem: Dem):
        def one(ray: Ray):
            def distance(origin):
                fix = intersect(Ray(origin, ray.direction), dem)
                return jnp.where(fix.found, fix.slant_range, 0.0), fix.status

            (value, status), slope = jax.value_and_grad(distance, has_aux=True)(ray.origin)
            return value, status, slope

        return jax.vmap(one)(rays)

    value, status, slope = map(np.asarray, slopes(rays, ground.dem))
    fix = hits(rays, ground.dem)
    np.testing.assert_array_equal(status, fix.status)
    assert np.all(np.isfinite(slope))
    found = np.asarray(fix.found)
    assert np.all(value[~found] == 0.0)
    assert np.all(slope[~found] == 0.0)
    assert np.all(np.any(slope[found] != 0.0, axis=1))
