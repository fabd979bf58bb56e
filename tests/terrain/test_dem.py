"""A Dem as an array with a place: heights, normals, voids, bounds, and what it refuses."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.scenes import SIZE, flat, hit, local_ray, rough, small_dem

import jaxgeo
from jaxgeo import Dem, Geodetic
from jaxgeo._arguments import check_is, check_terrain
from jaxgeo.earth import WGS84
from jaxgeo.terrain import TangentGrid
from jaxgeo.terrain.patch import Patch
from jaxgeo.terrain.pyramid import Pyramid, build_pyramid
from jaxgeo.terrain.track import make_track


def at(dem: Dem, row: float, col: float) -> Geodetic:
    """The position of (row, col) on the ellipsoid."""
    return _at(dem.grid, jnp.array([row, col]))


@eqx.filter_jit
def _at(grid: TangentGrid, rowcol: jax.Array) -> Geodetic:
    x, y, z = grid.normal(rowcol)
    return Geodetic(lat=jnp.arctan2(z, jnp.hypot(x, y)), lon=jnp.arctan2(y, x), height=jnp.zeros(()))


@eqx.filter_jit
def height_at(dem: Dem, position: Geodetic) -> jax.Array:
    return dem.height_at(position)


@eqx.filter_jit
def slope_and_normal_at(dem: Dem, position: Geodetic) -> tuple[jax.Array, jax.Array]:
    return dem.slope_at(position), dem.normal_at(position)


def test_posts_are_met_and_between_them_the_surface_is_bilinear():
    posts = rough(1)
    dem = small_dem(posts)
    assert float(height_at(dem, at(dem, 5.0, 7.0))) == pytest.approx(posts[5, 7], abs=1e-7)
    u, v = 0.3, 0.8
    expected = np.array([1 - u, u]) @ posts[5:7, 7:9] @ np.array([1 - v, v])
    assert float(height_at(dem, at(dem, 5.0 + u, 7.0 + v))) == pytest.approx(expected, abs=1e-6)
    for row, col in ((0.0, 0.0), (16.0, 16.0), (16.0, 3.5)):
        assert np.isfinite(height_at(dem, at(dem, row, col)))
    for row, col in ((-0.01, 3.0), (16.01, 3.0), (3.0, 17.0)):
        assert np.isnan(height_at(dem, at(dem, row, col)))


def test_slope_and_normal_of_a_plane():
    rise = np.tan(np.deg2rad(25.0))
    posts = 30.0 * rise * np.arange(SIZE)[None, :] * np.ones((SIZE, 1))  # up towards the east
    dem = small_dem(posts)
    slope, (east, north, up) = slope_and_normal_at(dem, at(dem, 8.2, 8.3))
    np.testing.assert_allclose(np.rad2deg(slope), 25.0, rtol=0, atol=1e-2)
    np.testing.assert_allclose(np.rad2deg(np.arctan2(-east, up)), 25.0, rtol=0, atol=1e-2)
    assert abs(float(north)) < 1e-3


def test_height_is_differentiable_in_position_and_posts():
    dem = small_dem(rough(2))
    position = at(dem, 4.4, 9.7)

    @jax.jit
    def gradients(position, posts):
        return jax.grad(lambda position, posts: dem.with_posts(posts).height_at(position), (0, 1))(position, posts)

    gradient, by_posts = gradients(position, dem.posts)
    step = 1e-8
    for name in ("lat", "lon"):
        ahead, behind = (
            height_at(dem, Geodetic(**{**vars_of(position), name: getattr(position, name) + s})) for s in (step, -step)
        )
        np.testing.assert_allclose(getattr(gradient, name), (ahead - behind) / (2 * step), rtol=1e-5)
    weights = np.asarray(by_posts)[4:6, 9:11]
    np.testing.assert_allclose(weights, np.outer([0.6, 0.4], [0.3, 0.7]), rtol=0, atol=1e-6)
    assert np.count_nonzero(by_posts) == 4


def vars_of(position: Geodetic) -> dict:
    return {name: getattr(position, name) for name in ("lat", "lon", "height")}


def test_a_cell_with_one_void_post_has_no_height_and_no_slope():
    posts = rough(3)
    posts[6, 6] = np.nan
    dem = small_dem(posts)
    for row, col in ((5.5, 5.5), (6.5, 6.5), (5.5, 6.5)):
        assert np.isnan(height_at(dem, at(dem, row, col)))
        assert np.isnan(slope_and_normal_at(dem, at(dem, row, col))[0])
    assert np.isfinite(height_at(dem, at(dem, 4.5, 4.5)))
    assert np.all(np.isfinite(np.asarray(dem.posts)))


@pytest.mark.parametrize("offset", range(8))
def test_a_caller_may_go_on_writing_to_the_array(offset):
    """Whatever its alignment in memory, which decides whether JAX would share it."""
    memory = np.zeros(SIZE * SIZE + 8)
    posts = memory[offset : offset + SIZE * SIZE].reshape(SIZE, SIZE)
    posts[:] = rough(1)
    dem = small_dem(posts)
    posts[:] = -1.0
    np.testing.assert_array_equal(dem.posts, rough(1))


SHAPES = [(2, 2), (3, 17), (17, 3), (64, 64), (33, 50)]


@pytest.mark.costly
@pytest.mark.parametrize(
    "shape, kind",
    [(shape, "numpy") for shape in SHAPES]
    + [pytest.param(shape, "jax", marks=[] if shape == (3, 17) else pytest.mark.slow) for shape in SHAPES],
)
def test_every_bound_holds_over_all_cells_that_a_box_can_touch(shape, kind):
    xp = {"numpy": np, "jax": jnp}[kind]
    rng = np.random.default_rng(0)
    posts = rng.uniform(0.0, 3000.0, (shape[0] + 1, shape[1] + 1))
    unknown = rng.uniform(size=posts.shape) < 0.1
    high = np.where(unknown, 3500.0, posts)
    tops = np.maximum(np.maximum(high[1:, 1:], high[1:, :-1]), np.maximum(high[:-1, 1:], high[:-1, :-1]))
    pyramid = build_pyramid(
        xp.asarray(posts), xp.asarray(unknown), ceiling=3500.0, lowest=posts.min(), highest=posts.max(), xp=xp
    )
    levels, corners, largest = [], [], []
    for _ in range(200):
        level = int(rng.integers(0, pyramid.top + 1))
        low = rng.integers(0, shape)
        high = np.minimum(low + rng.integers(0, 2**level + 1, 2), np.array(shape) - 1)
        if np.any(high // 2**level > low // 2**level + 1):
            continue
        levels.append(level)
        corners.append(low // 2**level)
        largest.append(tops[low[0] : high[0] + 1, low[1] : high[1] + 1].max())
    bound = jax.jit(jax.vmap(Pyramid.bound, in_axes=(None, 0, 0, 0)))
    rows, cols = jnp.asarray(np.array(corners)).T
    above = np.asarray(bound(pyramid, jnp.asarray(levels), rows, cols)) - np.array(largest)
    assert np.all(above >= 0.0)
    zero = jnp.asarray(0)
    assert 0.0 <= float(pyramid.bound(jnp.asarray(pyramid.top), zero, zero)) - tops.max() < 0.06  # 3500 m / 65534


@eqx.filter_jit
def track_and_map(ray: jaxgeo.Ray, dem: Dem, length: jax.Array, tau: jax.Array):
    track = make_track(ray, dem, jnp.asarray(0.0), length)
    rowcol, height = jax.vmap(lambda t: dem.over(ray.at(track.range_at(t))))(tau)
    return track, rowcol, height, jax.vmap(track.at)(tau)


@pytest.mark.parametrize("length", [3e3, 2e4, 4e4])
def test_a_track_is_true_to_the_exact_map(length):
    """To a tenth of a micrometre over 40 km, of which the map's own rounding is the larger part."""
    dem = small_dem(flat(0.0))
    origin = WGS84.to_ecef(Geodetic.from_degrees(lat=47.1, lon=10.9, height=9000.0))
    target = WGS84.to_ecef(Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0))
    ray = jaxgeo.Ray(origin, (target - origin) / jnp.linalg.norm(target - origin))
    tau = jnp.linspace(-1.0, 1.0, 101)
    track, rowcol, height, told = track_and_map(ray, dem, jnp.asarray(length), tau)
    values = np.stack(told, axis=1)
    np.testing.assert_allclose(values[:, :2] * 30.0, rowcol * 30.0, rtol=0, atol=1e-7)
    np.testing.assert_allclose(values[:, 2], height, rtol=0, atol=1e-7)
    assert float(track.error) < 1e-7
    steps = np.abs(np.diff(values[:, :2], axis=0)).max() / float(tau[1] - tau[0])
    assert float(track.speed()) >= steps
    assert float(track.speed()) < 1.1 * steps


GRID = TangentGrid.centred(Geodetic(lat=0.8, lon=0.2, height=0.0), spacing=(30.0, 30.0), shape=(3, 3))
A_SENSOR = jaxgeo.Sensor(jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=100, height=100))
A_SHOT = jaxgeo.Shot(jaxgeo.Pose(Geodetic(lat=0.8, lon=0.2, height=900.0), 0.0, 0.0, 0.0), np.zeros(0), 0.0)
REFUSED = {
    "all void": (lambda: Dem.from_array(np.full((3, 3), np.nan), GRID), ValueError, "all 9 posts are void"),
    "one row": (
        lambda: Dem.from_array(np.zeros((1, 5)), GRID),
        ValueError,
        r"at least 2 x 2 heights; got shape \(1, 5\)",
    ),
    "infinite": (lambda: Dem.from_array(np.array([[0.0, np.inf], [0.0, 0.0]]), GRID), ValueError, "infinite height"),
    "ceiling": (lambda: Dem.from_array(np.zeros((3, 3)), GRID, void_ceiling=np.nan), ValueError, "void_ceiling .* nan"),
    "void of another shape": (
        lambda: Dem.from_array(np.zeros((3, 3)), GRID, void=np.zeros((1, 3), bool)),
        ValueError,
        r"void must be a boolean array of the posts' shape \(3, 3\)",
    ),
    "void as numbers": (
        lambda: Dem.from_array(np.zeros((3, 3)), GRID, void=np.zeros((3, 3))),
        ValueError,
        "void must be a boolean array .* got dtype float64",
    ),
    "extent too large": (
        lambda: Dem.from_array(np.zeros((3, 3)), GRID, extent=(3, 9)),
        ValueError,
        r"extent must be .* got \[3, 9\]",
    ),
    "complex posts": (lambda: Dem.from_array(np.zeros((3, 3), complex), GRID), TypeError, "got dtype complex128"),
    "other shape": (
        lambda: Dem.from_array(np.zeros((3, 3)), GRID).with_posts(np.zeros((4, 3))),
        ValueError,
        "keep the shape",
    ),
    "long direction": (
        lambda: jaxgeo.intersect(jaxgeo.Ray(jnp.zeros(3), jnp.array([0.0, 0.0, 2.0])), jaxgeo.ConstantHeight(0.0)),
        ValueError,
        "unit vector in ECEF; got one of length 2",
    ),
    "float32 ray": (
        lambda: jaxgeo.intersect(
            jaxgeo.Ray(jnp.zeros(3, jnp.float32), jnp.array([0.0, 0.0, 1.0])), jaxgeo.ConstantHeight(0.0)
        ),
        TypeError,
        r"ray\.origin has dtype float32",
    ),
    "an array as terrain": (
        lambda: check_terrain(np.zeros((3, 3)), jaxgeo.FirstHit()),
        TypeError,
        r"terrain must be a jaxgeo terrain; got ndarray. Read one with jaxgeo.io.read_dem",
    ),
    "a class as search": (
        lambda: check_terrain(jaxgeo.ConstantHeight(0.0), jaxgeo.FirstHit),
        TypeError,
        r"Did you mean FirstHit\(\)\?",
    ),
    "many rays": (
        lambda: jaxgeo.intersect(jaxgeo.Ray(jnp.zeros((4, 3)), jnp.zeros((4, 3))), jaxgeo.ConstantHeight(0.0)),
        ValueError,
        r"use jax.vmap\(intersect",
    ),
    "float32 height": (
        lambda: jaxgeo.intersect(small_up(), jaxgeo.ConstantHeight(np.float32(3.0))),
        TypeError,
        "terrain.height has dtype float32",
    ),
    "degrees as radians": (
        lambda: jaxgeo.project(A_SENSOR, A_SHOT, Geodetic(lat=47.0, lon=11.0, height=0.0)),
        ValueError,
        r"^lat must lie within pi/2 rad .* got 47\. .*from_degrees\(lat=47.0, lon=11.0, height=0.0\) takes degrees",
    ),
    "one number as pixel": (
        lambda: jaxgeo.locate(A_SENSOR, A_SHOT, 5.0, jaxgeo.ConstantHeight(0.0)),
        ValueError,
        r"uv must be one pixel .* got shape \(\)",
    ),
    "many pixels": (
        lambda: jaxgeo.locate(A_SENSOR, A_SHOT, np.zeros((7, 2)), jaxgeo.ConstantHeight(0.0)),
        ValueError,
        r"got shape \(7, 2\). For many pixels use jax.vmap",
    ),
    "float32 in a list": (
        lambda: jaxgeo.locate(A_SENSOR, A_SHOT, [np.float32(1.0), 2.0], jaxgeo.ConstantHeight(0.0)),
        TypeError,
        r"uv\[0\] has dtype float32",
    ),
    "shot and sensor exchanged": (
        lambda: check_is(A_SHOT, jaxgeo.Sensor, "sensor"),
        TypeError,
        "sensor must be a jaxgeo Sensor; got Shot",
    ),
    "throw": (
        lambda: jaxgeo.intersect(small_up(), jaxgeo.ConstantHeight(0.0), throw=True),
        ValueError,
        "rises_away: The ray rises above",
    ),
    "throw while traced": (
        lambda: jax.jit(lambda ray: jaxgeo.intersect(ray, jaxgeo.ConstantHeight(0.0), throw=True))(small_up()),
        ValueError,
        "throw=True needs values that are known now",
    ),
}


def small_up() -> jaxgeo.Ray:
    return jaxgeo.Ray(jnp.array([WGS84.a + 100.0, 0.0, 0.0]), jnp.array([1.0, 0.0, 0.0]))


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused_says_what_was_wrong(case):
    call, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        call()


def test_with_64_bit_floats_off_nothing_is_computed():
    with jax.enable_x64(False), pytest.raises(RuntimeError, match=r"jaxgeo\.enable_x64\(\)"):
        Dem.from_array(np.zeros((3, 3)), GRID)
    with jax.enable_x64(False), pytest.raises(RuntimeError, match="64-bit floats"):
        jaxgeo.intersect(small_up(), jaxgeo.ConstantHeight(0.0))


@pytest.mark.parametrize("dtype", [np.int16, np.int32, np.float32, np.float64])
def test_posts_keep_their_dtype_and_are_cast_on_look_up(dtype):
    posts = np.round(rough(6)).astype(dtype)
    dem = small_dem(posts)
    assert dem.posts.dtype == dtype
    height = height_at(dem, at(dem, 3.5, 3.5))
    assert height.dtype == jnp.float64
    assert float(height) == pytest.approx(posts[3:5, 3:5].mean(), abs=1e-3)


def test_the_mask_of_a_masked_array_is_kept():
    posts = np.ma.masked_less(np.array([[1.0, -32768.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]), -1000.0)
    dem = Dem.from_array(posts, GRID)
    assert float(dem.lowest) == 1.0
    np.testing.assert_array_equal(dem.void, np.ma.getmaskarray(posts))


def test_the_gradient_of_a_patch_is_the_difference_of_its_heights() -> None:
    """Along rows and columns: exact for steps of any size, as the surface is linear along each."""
    patch, half = Patch(first=1.0, next_col=2.0, next_row=4.0, last=9.0), 0.5
    for row, col in jnp.array([[0.2, 0.7], [-0.5, 1.5]]):
        differences = (
            patch.at(row + half, col) - patch.at(row - half, col),
            patch.at(row, col + half) - patch.at(row, col - half),
        )
        np.testing.assert_allclose(patch.gradient(row, col), differences, rtol=1e-12)


@pytest.mark.parametrize("axis, azimuths", [(1, (90.0, -90.0)), (0, (0.0, 180.0))])
def test_walls_at_both_ends_stop_level_rays(axis, azimuths):
    """The search leaves out no ground because of that of another place, by rows nor by columns."""
    posts = np.zeros(SIZE)
    posts[[1, -2]] = 400.0
    ground = np.broadcast_to(posts if axis == 1 else posts[:, None], (SIZE, SIZE))
    fix = hit([local_ray(0.0, 0.0, 150.0, azimuth=one, elevation=-0.5) for one in azimuths], small_dem(ground))
    before = 30.0 * (SIZE // 2 - 2)  # m from the centre, where a wall begins
    height = 150.0 - before * np.tan(np.deg2rad(0.5))  # above the ground there
    assert fix.status.tolist() == [0, 0]
    np.testing.assert_allclose(fix.slant_range, before + 30.0 * height / 400.0, atol=0.2)
