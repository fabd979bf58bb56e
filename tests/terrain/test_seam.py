"""Grids in longitude that reach far round the Earth, or all of it: what rays meet there is that of a march in NumPy."""

from __future__ import annotations

import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rasterio.transform import Affine
from support.rasters import write
from support.statuses import Marched, aimed, differences, hits, stored

from jaxgeo import Dem, Geodetic, Ray, Status
from jaxgeo.io import read_dem
from jaxgeo.io.extent import extent_deg, place_beside
from jaxgeo.terrain import GeographicGrid

STEP, TURN = 0.5, 720  # deg between posts of a row, and how many go round
ROWS = 13
POLAR, MIDDLE = (89.4, 0.005), (45.0, 0.5)  # latitude of the first row, deg between rows
EXACT = 0.05  # m: nearer to another outcome, either may be told; cells are 40 km long
RAYS = 60

GRIDS = {
    # longitude of the first post, posts in a row
    "-180..180 with its last column the first": (-180.0, TURN + 1),
    "0..360 with its last column the first": (0.0, TURN + 1),
    "-180..180 with a gap of a cell": (-180.0 + STEP / 2, TURN),
    "-179..179": (-179.0, TURN - 3),
    "-130..130": (-130.0, 521),
    "0..300": (0.0, 601),
    "170..190": (170.0, 41),
}
QUICK = ("-180..180 with its last column the first", "-179..179", "-130..130")


def posts_of(cols: int) -> np.ndarray:
    posts = np.random.default_rng(1).uniform(0.0, 900.0, (ROWS, TURN + 1))
    posts[:, TURN] = posts[:, 0]
    return posts[:, :cols]


def grid_of(west: float, cols: int, band: tuple[float, float]) -> GeographicGrid:
    top, down = band
    return GeographicGrid.from_affine((STEP, 0.0, west, 0.0, -down, top), (ROWS, cols))


def dem_of(west: float, cols: int, band: tuple[float, float]) -> Dem:
    return Dem.from_array(stored(posts_of(cols)), grid_of(west, cols, band), extent=(ROWS, cols))


def march_of(west: float, cols: int, band: tuple[float, float], *, wraps: bool = False) -> Marched:
    top, down = band
    place = lambda lon, lat: ((top - lat) / down, (lon - west) / STEP)  # noqa: E731
    posts = posts_of(TURN) if wraps else posts_of(cols)
    return Marched(posts, place, 111e3 * down, turn=TURN, wraps=wraps)


def rays_about(lon: float, band: tuple[float, float], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays of all directions by a meridian: most go down to the ground, some come from below or go up."""
    top, down = band
    rng = np.random.default_rng(7)
    spread = 4.0 if band is POLAR else 1.0
    lons, lats = lon + rng.uniform(-spread, spread, count), top - down * rng.uniform(-1.0, ROWS, count)
    far = 20e3 if band is POLAR else 200e3
    lowest = -40.0 if band is POLAR else -4.0
    down_there = aimed(rng, lons, lats, rng.uniform(-200.0, 1000.0, count), elevation=(lowest, -0.2), back=(0.0, far))
    up = aimed(rng, lons, lats, rng.uniform(-200.0, 1000.0, count), elevation=(-0.2, 10.0), back=(0.0, far))
    few = count // 5
    return np.concatenate([down_there[0][few:], up[0][:few]]), np.concatenate([down_there[1][few:], up[1][:few]])


def held_against(march: Marched, dem: Dem, lon: float, band: tuple[float, float], count: int) -> dict[str, int]:
    origin, direction = rays_about(lon, band, count)
    outcomes = march.outcomes(origin, direction)
    fix = hits(Ray(jnp.asarray(origin), jnp.asarray(direction)), dem)
    nearest = EXACT if band is POLAR else 20.0 * EXACT
    assert sum(outcome.margin < nearest for outcome in outcomes) < 0.06 * count
    assert differences(outcomes, np.asarray(fix.status), np.asarray(fix.slant_range), nearest) == []
    told = [Status(int(code)).name for code in fix.status]
    return {name: told.count(name) for name in told}


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [kind if kind in QUICK else pytest.param(kind, marks=pytest.mark.slow) for kind in GRIDS]
)
@pytest.mark.parametrize("band", [POLAR, pytest.param(MIDDLE, marks=pytest.mark.slow)], ids=["polar", "middle"])
def test_what_rays_meet_by_the_ends_of_a_grid_and_opposite_to_it_is_that_of_a_march(kind, band):
    """Longitude jumps by a turn opposite to a grid's middle; of a wide grid that is close to its ends."""
    west, cols = GRIDS[kind]
    east = west + STEP * (cols - 1)
    dem, march = dem_of(west, cols, band), march_of(west, cols, band, wraps=cols > TURN)
    for lon in (west, east, (west + east) / 2.0 + 180.0):
        counts = held_against(march, dem, lon, band, RAYS)
        if cols > TURN:
            assert counts["hit"] > 0.4 * RAYS


@pytest.mark.costly
@pytest.mark.parametrize(
    "west, repeated, point",
    [(-180.0, 0, False), *(pytest.param(*row, marks=pytest.mark.slow) for row in ((0.0, 1, True), (-180.0, 1, True)))],
)
def test_a_file_that_goes_all_round_the_earth_is_closed(
    tmp_path: pathlib.Path, west: float, repeated: int, point: bool
):
    """Pixels that are areas or points, with or without a column that repeats the first: rays cross the seam."""
    cols, half = TURN + repeated, 0.0 if point else STEP / 2
    top, down = POLAR
    affine = Affine(STEP, 0.0, west + half - STEP / 2, 0.0, -down, top + down / 2)
    path = write(tmp_path / "dem.tif", posts_of(cols), affine=affine, point=point)
    first = west + half
    for bounds in (None, (-180.0, -90.0, 180.0, 90.0)) if repeated else (None,):
        dem = read_dem(path, vertical_datum=0, bounds=bounds)
        assert tuple(np.asarray(dem.extent)) == (ROWS, TURN + 2)
    same = Dem.from_array(stored(np.asarray(dem.posts)[:ROWS, : TURN + 2]), dem.grid, extent=(ROWS, TURN + 2))
    for lon in (first, first + 180.0):
        assert held_against(march_of(first, TURN, POLAR, wraps=True), same, lon, POLAR, RAYS)["hit"] > 0.4 * RAYS
    assert extent_deg(dem)[::2] == (-180.0, 180.0)
    assert place_beside(dem, 89.37, 179.9) is None
    assert place_beside(dem, 80.0, 0.0) is not None


def test_heights_go_on_across_the_seam():
    west, cols = GRIDS["-180..180 with its last column the first"]
    dem, march = dem_of(west, cols, POLAR), march_of(west, cols, POLAR, wraps=True)
    lon, lat = np.array([179.9, -180.0, 180.0, -179.9]), np.full(4, POLAR[0] - 3.4 * POLAR[1])
    found = jax.jit(jax.vmap(dem.height_at))(Geodetic.from_degrees(lat=lat, lon=lon, height=np.zeros(4)))
    row, col = march.to_rowcol(lon, lat)
    i, j, _ = march.cells(row, col)
    z, _ = march.corners(i, j)
    u, v = row - i, col % TURN - j
    expected = z[0] * (1 - u) * (1 - v) + z[1] * (1 - u) * v + z[2] * u * (1 - v) + z[3] * u * v
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_rays_that_pass_a_pole_within_a_hair_meet_the_ground_behind_it():
    """The row at the pole is one place; closer than a millimetre to it columns turn by half a turn within a step."""
    west, cols = GRIDS["-180..180 with its last column the first"]
    dem = Dem.from_array(
        stored(np.full((ROWS, cols), 100.0)), grid_of(west, cols, (90.0, POLAR[1])), extent=(ROWS, cols)
    )
    rng = np.random.default_rng(5)
    away = np.repeat([0.0, 1e-6, 1e-3, 0.1, 5.0, 300.0], 10)
    lat, lon = 90.0 - np.degrees(away / 6.4e6), rng.uniform(-180.0, 180.0, 60)
    origin, direction = aimed(rng, lon, lat, rng.uniform(101.0, 200.0, 60), elevation=(-40.0, -5.0), back=(100.0, 4e3))
    fix = hits(Ray(jnp.asarray(origin), jnp.asarray(direction)), dem)
    assert np.all(np.asarray(fix.ok)), [Status(int(code)).name for code in fix.status]
    np.testing.assert_allclose(fix.position.height, 100.0, rtol=0, atol=1e-5)
