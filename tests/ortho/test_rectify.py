"""Rectified images hold, cell by cell, what `project` says that the camera sees there; and orthoimages as such."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import pytest
from support.fractal import fractal_posts

from jaxgeo import (
    Atmosphere,
    ConstantHeight,
    Dem,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Pose,
    RollingShutterCamera,
    Sensor,
    Shot,
    Status,
    Trajectory,
    _accelerator,
    project,
)
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.mapping import file_map
from jaxgeo.ortho.cells import cells_one_by_one, may_be_hidden
from jaxgeo.ortho.interpolation import Bilinear, Cubic, Nearest
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.ortho.rectification import STRIP, Rectifier, rectify
from jaxgeo.ortho.visibility_bounds import OpenSight
from jaxgeo.sensor import BrownConrady
from jaxgeo.terrain import ConstantField, FittedGrid, GeographicGrid, TangentGrid, TransverseMercatorGrid
from jaxgeo.terrain.grid import AbstractGrid, surface_point

LAT, LON = 47.0, 11.0
CENTRE = Geodetic.from_degrees(lat=LAT, lon=LON, height=0.0)
POSTS, SPACING = 49, 30.0  # m
CELLS, CELL, COARSE = (32, 32), 14.0, 28.0  # m
WIDTH, HEIGHT = 96, 72
BATCH = 512
PLAIN = FrameCamera.from_pixels(focal_px=100.0, width=WIDTH, height=HEIGHT)
LENS = FrameCamera.from_pixels(
    focal_px=(98.0, 101.0), principal_px=(50.0, 33.0), width=WIDTH, height=HEIGHT,
    distortion=BrownConrady(k1=-0.1, k2=0.02, p1=1e-3, p2=-8e-4),
)  # fmt: skip
PICTURES = np.stack(np.meshgrid(np.arange(float(WIDTH)), np.arange(float(HEIGHT))))  # of the column and of the row


def ground(seed: int = 0, relief: float = 400.0, voids: bool = False) -> Dem:
    """Steep mountains in the west that become a plain towards the east."""
    posts = fractal_posts(POSTS, spacing=SPACING, relief=relief, exponent=2.6, seed=seed)
    posts = 100.0 + posts * np.linspace(1.0, 0.0, POSTS)[None, :] ** 2
    if voids:
        posts[20:24, 15:18] = posts[35, 30] = np.nan
    return Dem.from_array(posts, TangentGrid.centred(CENTRE, spacing=(SPACING, SPACING), shape=posts.shape))


def shot(pitch: float = 60.0, height: float = 900.0, away: float = 1200.0) -> Shot:
    """From the south, looking north so many degrees off nadir."""
    lat = LAT - np.rad2deg(away / 6.37e6)
    return Shot(Pose.from_degrees(lat=lat, lon=LON, height=height, heading=2.0, pitch=pitch, roll=1.0))


def cells_about(east: float = 0.0, north: float = 0.0, cell: float = CELL) -> TangentGrid:
    lat, lon = LAT + np.rad2deg(north / 6.37e6), LON + np.rad2deg(east / 6.37e6) / np.cos(np.deg2rad(LAT))
    middle = Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    return TangentGrid.centred(middle, spacing=(cell, cell), shape=CELLS, heading=0.3)


def on_map(crs: Any, cell: tuple[float, float] = (CELL, CELL)) -> AbstractGrid:
    """Cells of a size in the CRS's unit about the same place."""
    crs = pyproj.CRS(crs)
    x, y = pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(LON, LAT)
    affine = (cell[1], 0.0, x - 15.5 * cell[1], 0.0, -cell[0], y + 15.5 * cell[0])
    return make_grid("cells", file_map("cells", crs, affine, CELLS))[0]


def sensor_of(camera: Any) -> Sensor:
    return Sensor(camera, Gimbal.fixed(), Mount.nadir())


@eqx.filter_jit
def _places(grid: AbstractGrid, terrain: Dem) -> tuple[Any, Any]:
    """Latitude, longitude and the terrain's height (NaN where there is none) of all cells, one after another."""
    row, col = jnp.meshgrid(*(jnp.arange(float(n)) for n in CELLS), indexing="ij")

    def one(rowcol: jax.Array) -> Any:
        normal = grid.normal(rowcol)
        rc = terrain.grid.rowcol(normal)
        cell = jnp.clip(jnp.floor(rc), 0, POSTS - 2).astype(jnp.int32)
        s, t = rc - cell
        a, b, c, d = (terrain.posts[cell[0] + i, cell[1] + j] for i in (0, 1) for j in (0, 1))
        void = jnp.stack([terrain.void[cell[0] + i, cell[1] + j] for i in (0, 1) for j in (0, 1)])
        height = (1 - s) * ((1 - t) * a + t * b) + s * ((1 - t) * c + t * d)
        inside = jnp.all((rc >= 0) & (rc <= POSTS - 1))
        status = jnp.where(inside, jnp.where(jnp.any(void), int(Status.hits_void), 0), int(Status.leaves_terrain))
        return (
            jnp.arctan2(normal[2], jnp.hypot(normal[0], normal[1])),
            jnp.arctan2(normal[1], normal[0]),
            height,
            status,
        )

    lat, lon, height, status = jax.vmap(one)(jnp.stack([row.ravel(), col.ravel()], axis=1))
    return (lat, lon, jnp.where(status == 0, height, 0.0)), status


class Seen(NamedTuple):
    """By `project`: pixels (rows, cols, 2), status, and where that does not hang on a tie with the tolerance."""

    uv: np.ndarray
    status: np.ndarray
    sure: np.ndarray


def _projected(sensor: Sensor, shot: Any, point: Any, **how: Any) -> tuple[np.ndarray, np.ndarray]:
    def one(lat: Any, lon: Any, height: Any) -> Any:
        found = project(sensor, shot, Geodetic(lat=lat, lon=lon, height=height), **how)
        return found.uv, found.status

    uv, status = jax.vmap(one)(*point)
    return np.asarray(uv), np.asarray(status)


@pytest.fixture(autouse=True)
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["jaxgeo.ortho.rectification"], "SEARCHED", BATCH)


def expected(sensor: Sensor, shot: Any, terrain: Any, grid: AbstractGrid, *, mask: bool = True, **how: Any) -> Seen:
    point, known = _places(grid, terrain if isinstance(terrain, Dem) else ground())
    if not isinstance(terrain, Dem):
        level = -terrain.clearance(jnp.array([6378137.0, 0.0, 0.0]), jnp.zeros(2, jnp.int32))
        point, known = (*point[:2], jnp.full_like(point[2], level)), jnp.zeros_like(known)
    answers = [
        _projected(sensor, shot, point, terrain=terrain if mask else None, hidden_tolerance=tolerance, **how)
        for tolerance in ((0.01, 0.005, 0.02) if mask else (0.01,))
    ]
    uv, status = answers[0]
    sure = np.all([other[1] == status for other in answers], axis=0)
    status = np.where(np.asarray(known) == 0, status, np.asarray(known))
    return Seen(*(x.reshape(*CELLS, *x.shape[1:]) for x in (uv, status, sure)))


def check(found: Any, seen: Seen, atol: float = 1e-6) -> None:
    """Statuses are the same, and cells hold the picture at the pixel, or nothing."""
    agree = found.status == seen.status
    assert np.all(agree | ~seen.sure), np.argwhere(~agree & seen.sure)[:5]
    assert np.mean(seen.sure) > 0.995
    both = agree & (seen.status == Status.hit)
    assert both.mean() > 0.2
    np.testing.assert_array_equal(found.orthoimage.known, found.status == Status.hit)
    pixels = np.clip(seen.uv[both], 0.0, [WIDTH - 1.0, HEIGHT - 1.0])  # beyond the last pixel's middle, that pixel
    np.testing.assert_allclose(found.orthoimage.values[:, both].T, pixels, rtol=0, atol=atol)  # px
    assert np.all(found.orthoimage.values[:, ~found.orthoimage.known] == 0)


GRIDS = {
    "tangent": (cells_about, TangentGrid),
    "geographic": (lambda: on_map("EPSG:4326", (CELL / 111e3, CELL / 76e3)), GeographicGrid),
    "transverse Mercator": (lambda: on_map("EPSG:32632"), TransverseMercatorGrid),
    "fitted": (lambda: on_map("EPSG:3035"), FittedGrid),
}


# One map compiles for every run; cells in a tangent plane are also those of most tests below.
@pytest.mark.costly
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "transverse Mercator" else pytest.mark.slow) for name in GRIDS]
)
def test_cells_hold_what_project_sees_through_a_lens(name: str) -> None:
    make, kind = GRIDS[name]
    grid, sensor, terrain = make(), sensor_of(LENS), ground(1)
    assert isinstance(grid, kind)
    found = rectify(sensor, shot(), PICTURES, terrain, grid, CELLS, mask_hidden=False)
    check(found, expected(sensor, shot(), terrain, grid, mask=False))


@pytest.mark.slow
def test_tiles_of_an_accelerator_are_those_of_a_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled for a CPU: other tiles, blocks within them, and lines of sight at once."""
    pitch, height, away, east, voids = LOOKS["flat, over voids"]
    given = sensor_of(PLAIN), shot(pitch, height, away), PICTURES, ground(voids=voids), cells_about(east, 0.0, COARSE)
    usual = rectify(*given, CELLS)
    monkeypatch.setattr(_accelerator, "on_accelerator", lambda *_: True)
    for name, size in {"TILE_ACCELERATOR": 64, "SIDE_ACCELERATOR": 16, "SEARCHED_ACCELERATOR": 777}.items():
        monkeypatch.setattr(sys.modules["jaxgeo.ortho.rectification"], name, size)
    found = rectify(*given, CELLS)
    assert {Status.hit, Status.hidden_by_terrain, Status.hits_void} <= set(np.unique(usual.status).tolist())
    np.testing.assert_array_equal(found.status, usual.status)
    np.testing.assert_allclose(found.orthoimage.values, usual.orthoimage.values, rtol=0, atol=1e-6)  # px


@pytest.mark.slow
def test_through_the_air() -> None:
    sensor, terrain, grid = sensor_of(LENS), ground(1), cells_about()
    found = rectify(sensor, shot(), PICTURES, terrain, grid, CELLS, atmosphere=Atmosphere())
    check(found, expected(sensor, shot(), terrain, grid, atmosphere=Atmosphere()))


@pytest.mark.costly
def test_level_ground() -> None:
    sensor, terrain = sensor_of(PLAIN), ConstantHeight(120.0)
    found = rectify(sensor, shot(), PICTURES, terrain, cells_about(), CELLS)
    check(found, expected(sensor, shot(), terrain, cells_about(), mask=False))  # nothing is hidden


# Steep ground seen flatly, voids, and the terrain's edge on either side: (pitch, camera's height, its distance, east).
LOOKS = {
    "flat": (72.0, 560.0, 1200.0, 0.0, False),
    "flat, over voids": (72.0, 560.0, 1200.0, 0.0, True),
    "over the edge": (62.0, 900.0, 1200.0, 500.0, True),
    "from above": (5.0, 1500.0, 0.0, 100.0, True),
}


@pytest.mark.costly
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("name", LOOKS)
def test_hidden_cells_are_those_that_a_search_of_every_line_of_sight_finds(name: str, seed: int) -> None:
    pitch, height, away, east, voids = LOOKS[name]
    sensor, terrain, grid = sensor_of(PLAIN), ground(seed, voids=voids), cells_about(east, 100.0 * seed, COARSE)
    seen_from = shot(pitch, height, away)
    seen, found = expected(sensor, seen_from, terrain, grid), rectify(sensor, seen_from, PICTURES, terrain, grid, CELLS)
    np.testing.assert_array_equal(found.status[seen.sure], seen.status[seen.sure])
    assert np.mean(seen.sure) > 0.98
    missing = {"over the edge": Status.leaves_terrain, "flat": Status.hidden_by_terrain}
    assert np.any(found.status == missing.get(name, Status.hits_void))


@pytest.mark.costly
@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(6, 60), marks=pytest.mark.slow)])
def test_slopes_prove_much_open_and_nothing_hidden_so(seeds: range) -> None:
    """Parts of tiles over the plain, or seen from above, are not searched; those with hidden ground always are."""
    sensor, proven, hidden = sensor_of(PLAIN), [], 0
    for seed in seeds:
        pitch, voids = 30.0 + 40.0 * (seed % 6) / 5.0, seed % 4 == 3
        terrain, grid = ground(seed, 100.0 + 50.0 * (seed % 5), voids), cells_about(40.0 * (seed % 7 - 3), cell=COARSE)
        seen_from = shot(pitch, 1500.0 - 12.0 * pitch, 15.0 * pitch + 350.0)
        view = Rectifier(sensor, seen_from, PICTURES, None, terrain, grid).view
        cells = cells_one_by_one(view, jnp.zeros(2), CELLS)
        chosen = np.asarray(cells.status) == Status.hit
        told = OpenSight.of(view)
        assert told is not None
        least_sine = told.least_sine(np.zeros(2), np.array(terrain.posts.shape))
        free = chosen & ~np.asarray(may_be_hidden(cells, least_sine))
        status = expected(sensor, seen_from, terrain, grid).status
        assert np.all(status[free] == Status.hit)
        proven.append(free.sum() / chosen.sum())
        hidden += np.sum(status == Status.hidden_by_terrain)
        lifted = OpenSight.of(eqx.tree_at(lambda v: v.terrain, view, terrain.with_field(ConstantField(7.0))))
        assert lifted is not None
        np.testing.assert_array_equal(lifted.least_sine(np.zeros(2), np.ones(2)), least_sine)
    assert max(proven) > 0.2
    assert np.mean(proven) > 0.03
    assert hidden > 8 * len(seeds)


@pytest.mark.costly
def test_tiles_of_any_size_give_the_same() -> None:
    sensor, terrain, grid = sensor_of(PLAIN), ground(2, voids=True), cells_about()
    whole, parts = (rectify(sensor, shot(), PICTURES, terrain, grid, CELLS, tile=n) for n in (32, 16))
    np.testing.assert_array_equal(whole.status, parts.status)
    np.testing.assert_allclose(whole.orthoimage.values, parts.orthoimage.values, rtol=0, atol=1e-7)
    cut = rectify(sensor, shot(), PICTURES, terrain, grid, (20, 25), tile=16)
    np.testing.assert_array_equal(cut.status, whole.status[:20, :25])
    np.testing.assert_array_equal(cut.orthoimage.values, parts.orthoimage.values[:, :20, :25])


@pytest.mark.slow
@pytest.mark.parametrize("masked", [False, True])
def test_images_in_motion_go_by_the_exact_path(masked: bool) -> None:
    sensor = sensor_of(RollingShutterCamera.from_readout(LENS, readout_time=0.05))
    flight = Trajectory.steady(shot(), velocity_ned=[60.0, -5.0, 2.0], before=1.0, after=1.0)
    terrain, grid = ground(voids=True), cells_about()
    found = rectify(sensor, flight, PICTURES, terrain, grid, CELLS, mask_hidden=masked, time=0.1)
    check(found, expected(sensor, flight, terrain, grid, mask=masked, time=0.1))


# Pictures.


def picture(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return 100.0 + 50.0 * np.sin(u / 9.0) * np.cos(v / 7.0)


SMOOTH = [(Bilinear(), 0.25), (Cubic(), 0.03)]  # of the picture's second and third derivatives, about


@pytest.mark.costly
@pytest.mark.parametrize("how, atol", SMOOTH)
def test_a_smooth_picture_comes_back(how: Any, atol: float) -> None:
    sensor, terrain, grid = sensor_of(PLAIN), ground(), cells_about()
    found = rectify(sensor, shot(), np.stack([picture(*PICTURES)] * 2), terrain, grid, CELLS, interpolation=how)
    u, v = np.moveaxis(expected(sensor, shot(), terrain, grid, mask=False).uv, -1, 0)
    inner = found.orthoimage.known & (u > 1) & (v > 1) & (u < WIDTH - 2) & (v < HEIGHT - 2)
    np.testing.assert_allclose(found.orthoimage.values[0][inner], picture(u, v)[inner], rtol=0, atol=atol)


@pytest.mark.costly
def test_cubic_keeps_quadratics_and_nearest_classes() -> None:
    sensor, terrain, grid = sensor_of(PLAIN), ground(), cells_about()
    u, v = PICTURES
    where = np.moveaxis(expected(sensor, shot(), terrain, grid, mask=False).uv, -1, 0)
    quadratic = [3.0 + 0.2 * x - 0.1 * y + 0.01 * x * y - 0.02 * x * x + 0.03 * y * y for x, y in ((u, v), where)]
    image = np.stack([quadratic[0]] * 2)
    found = rectify(sensor, shot(), image, terrain, grid, CELLS, interpolation=Cubic()).orthoimage
    inner = found.known & np.all((where > 1.0) & (where < np.array([WIDTH, HEIGHT])[:, None, None] - 2.0), axis=0)
    np.testing.assert_allclose(found.values[0][inner], quadratic[1][inner], rtol=0, atol=1e-6)
    classes = (1000 * np.arange(HEIGHT)[:, None] % 65521 + np.arange(WIDTH)[None, :]).astype(np.uint16)
    found = rectify(sensor, shot(), classes, terrain, grid, CELLS, interpolation=Nearest()).orthoimage
    col, row = np.rint(where[:, found.known]).astype(int)
    away_from_half = np.all(np.abs(where[:, found.known] % 1.0 - 0.5) > 1e-5, axis=0)
    assert found.values.dtype == np.uint16
    np.testing.assert_array_equal(found.values[0][found.known][away_from_half], classes[row, col][away_from_half])


@pytest.mark.costly
def test_what_the_image_does_not_know_the_map_does_not() -> None:
    sensor, terrain, grid = sensor_of(PLAIN), ground(), cells_about()
    known = np.ones((HEIGHT, WIDTH), bool)
    known[30:40, 40:60] = False
    holed = np.where(known, PICTURES, np.nan)
    u, v = np.moveaxis(expected(sensor, shot(), terrain, grid, mask=False).uv, -1, 0)
    touched = (u > 39.0) & (u < 60.0) & (v > 29.0) & (v < 40.0)
    for found in (
        rectify(sensor, shot(), PICTURES, terrain, grid, CELLS, known=known),
        rectify(sensor, shot(), holed, terrain, grid, CELLS),
    ):
        shown = found.status == Status.hit
        np.testing.assert_array_equal(found.orthoimage.known, shown & ~touched)
        assert np.sum(shown & touched) > 12
        assert np.all(np.isfinite(found.orthoimage.values))


@pytest.mark.costly
@pytest.mark.parametrize("dtype", [np.uint8, pytest.param(np.int16, marks=pytest.mark.slow), np.float32])
def test_dtypes_are_kept_and_whole_numbers_rounded(dtype: Any) -> None:
    sensor, terrain, grid = sensor_of(PLAIN), ground(), cells_about()
    values = np.stack([PICTURES[0] * 2.5, PICTURES[1] * 3.5]).astype(dtype)
    exact = rectify(sensor, shot(), values.astype(float), terrain, grid, CELLS).orthoimage.values
    found = rectify(sensor, shot(), values, terrain, grid, CELLS).orthoimage.values
    assert found.dtype == dtype
    assert np.max(np.abs(found - exact)) <= (0.501 if np.dtype(dtype).kind in "ui" else 1e-4)


@pytest.mark.slow
def test_cells_larger_than_pixels_hold_means() -> None:
    """A checkerboard goes grey, and a plane stays where it was; by `Nearest` nothing is mixed."""
    camera = FrameCamera.from_pixels(focal_px=600.0, width=512, height=384)
    sensor, terrain, grid = sensor_of(camera), ConstantHeight(100.0), cells_about(cell=20.0)
    row, col = np.meshgrid(np.arange(384), np.arange(512), indexing="ij")
    board = np.where((row + col) % 2 == 0, 200, 0).astype(np.uint8)
    from_above = shot(0.0, 1600.0, 0.0)
    found = rectify(sensor, from_above, board, terrain, grid, CELLS).orthoimage
    assert found.known.mean() > 0.3
    assert np.all(found.values[0][found.known] == 100)
    found = rectify(sensor, from_above, board, terrain, grid, CELLS, interpolation=Nearest()).orthoimage
    assert set(np.unique(found.values[0][found.known])) == {0, 200}
    planes = rectify(sensor, from_above, np.stack([col, row]).astype(float), terrain, grid, CELLS).orthoimage
    uv = expected(sensor, from_above, terrain, grid).uv
    inner = planes.known & np.all((uv > 16.0) & (uv < np.array([495.0, 367.0])), axis=-1)
    np.testing.assert_allclose(planes.values[:, inner].T, uv[inner], rtol=0, atol=1e-3)


SCENE = (sensor_of(PLAIN), shot(), PICTURES)
REFUSED: dict[str, tuple[tuple[Any, Any, Any], dict[str, Any], str]] = {
    "the image's size": ((SCENE[0], SCENE[1], PICTURES[:, 1:]), {}, "71 rows of 96 pixels, the camera 72 of 96"),
    "its kind": ((SCENE[0], SCENE[1], PICTURES > 3), {}, "an image must be real numbers"),
    "the mask's shape": (SCENE, {"known": np.ones((3, 3), bool)}, r"known must have the image's shape \(72, 96\)"),
    "a word for how": (SCENE, {"interpolation": "cubic"}, "interpolation"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case: str) -> None:
    given, how, words = REFUSED[case]
    with pytest.raises((ValueError, TypeError), match=words):
        rectify(*given, ConstantHeight(0.0), cells_about(), CELLS, **how)


# Orthoimages.


def orthoimage(dtype: Any = np.uint8) -> Orthoimage:
    values = np.arange(3 * 9 * 11).reshape(3, 9, 11).astype(dtype)
    known = np.ones((9, 11), bool)
    known[:2, :2], known[4, 4] = False, False
    return Orthoimage.of(values, cells_about(), known)


def test_a_window_is_the_same_ground() -> None:
    whole = orthoimage()
    part = whole.window(-2, 8, (6, 7))
    assert part.shape == (6, 7)
    np.testing.assert_array_equal(part.values[:, 2:, :3], whole.values[:, :4, 8:])
    np.testing.assert_array_equal(part.known, np.pad(whole.known[:4, 8:], ((2, 0), (0, 4))))
    np.testing.assert_allclose(
        part.grid.normal(jnp.array([3.0, 1.0])), whole.grid.normal(jnp.array([1.0, 9.0])), rtol=0, atol=1e-15
    )
    assert not whole.window(20, 0, (2, 2)).known.any()


@eqx.filter_jit
def places(grid: AbstractGrid, rowcol: jax.Array) -> jax.Array:
    return jax.vmap(lambda one: surface_point(grid.normal(one)))(rowcol)


@pytest.mark.costly
@pytest.mark.parametrize("name", GRIDS)
def test_coarser_cells_lie_amid_their_squares(name: str) -> None:
    whole = Orthoimage.of(np.arange(99.0).reshape(9, 11), GRIDS[name][0]())
    half = whole.coarser(2)
    assert half.shape == (4, 5)
    assert half.values[0, 1, 2] == whole.values[0, 2:4, 4:6].mean()
    four = places(whole.grid, jnp.array([[2.0 + i, 4.0 + j] for i in (0, 1) for j in (0, 1)]))
    here = places(half.grid, jnp.array([[1.0, 2.0]] * 4))[0]
    np.testing.assert_allclose(here, np.mean(four, axis=0), rtol=0, atol=1e-4)  # m: the Earth is bent
    assert half.ground_sampling == pytest.approx(2.0 * whole.ground_sampling, rel=1e-4)


def test_coarser_means_are_of_what_is_known() -> None:
    whole = orthoimage()
    half = whole.coarser(2)
    assert not half.known[0, 0]
    assert half.known[2, 2]
    squares = whole.values[:, 4:6, 4:6].astype(float)
    np.testing.assert_allclose(half.values[:, 2, 2], (squares.sum(axis=(1, 2)) - squares[:, 0, 0]) / 3.0, rtol=1e-15)
    assert whole.coarser(1) is whole
    with pytest.raises(ValueError, match="cannot be made 10 times as coarse"):
        whole.coarser(10)


def test_grey_is_the_mean_of_bands_and_level_where_unknown() -> None:
    whole = orthoimage()
    grey, mean = np.asarray(whole.grey()), whole.values.astype(float).mean(axis=0)
    np.testing.assert_allclose(grey[whole.known], mean[whole.known], rtol=1e-15)
    np.testing.assert_allclose(grey[~whole.known], mean[whole.known].mean(), rtol=1e-14)


def test_orthoimages_that_cannot_be() -> None:
    grid = cells_about()
    with pytest.raises(ValueError, match=r"got shape \(4,\)"):
        Orthoimage.of(np.zeros(4), grid)
    with pytest.raises(ValueError, match="no cell of this orthoimage is known"):
        Orthoimage.of(np.full((3, 3), np.nan), grid)
    with pytest.raises(ValueError, match=r"known must have the shape \(3, 3\)"):
        Orthoimage.of(np.zeros((3, 3)), grid, np.ones((2, 3), bool))


@pytest.mark.costly
@pytest.mark.parametrize("mask_hidden", [False, True])
def test_cells_beside_the_terrain_are_never_filled(mask_hidden: bool) -> None:
    """Also where a whole block, as cells are filled together, has no ground."""
    shape, terrain = (2 * STRIP, 2 * STRIP), ground()
    middle = Geodetic.from_degrees(lat=LAT + np.rad2deg(1050.0 / 6.37e6), lon=LON, height=0.0)
    grid = TangentGrid.centred(middle, spacing=(14.0, 14.0), shape=shape, heading=0.3)
    found = rectify(sensor_of(PLAIN), shot(), PICTURES, terrain, grid, shape, mask_hidden=mask_hidden)
    rowcol = jnp.asarray(np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1, dtype=float))
    place = np.asarray(jax.jit(jax.vmap(jax.vmap(lambda at: terrain.grid.rowcol(grid.normal(at)))))(rowcol))
    beside = np.any((place < -1e-3) | (place > POSTS - 1 + 1e-3), axis=-1)
    assert beside[:STRIP].all()
    assert not beside[STRIP:].all()
    assert np.all(found.status[beside] == Status.leaves_terrain)
    assert not found.orthoimage.known[beside].any()
    assert np.any(found.status == Status.hit)
