"""Derivatives through the terrain hit: against differences, forward against reverse, and finite whatever fails."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from support.scenes import local_ray, rough, small_dem, stack
from test_locate import a_sensor, a_shot, over_terrain  # noqa: F401

import jaxgeo
from jaxgeo import Dem, Gimbal, Status
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.rotations import R_from_rotation_vector


@dataclass(frozen=True)
class Forward:
    """The hit in m along east, north and up as a function of one vector: sensor, shot and pixel, and then the posts."""

    hit: Callable[[jax.Array], jax.Array]
    J_and_hit: Callable[[jax.Array], tuple[jax.Array, jax.Array]]  # compiled
    z: jax.Array
    count: int  # of numbers before the posts
    J: np.ndarray  # in reverse, (3, all)

    def by_numbers(self, x: jax.Array) -> jax.Array:
        return self.hit(jnp.concatenate([x, self.z[self.count :]]))

    @property
    def x(self) -> jax.Array:
        return self.z[: self.count]


@pytest.fixture(scope="module")
def forward(over_terrain):  # noqa: F811
    """The mount's two rotations enter as small rotation vectors, so that differences stay among rotations."""
    sensor, shot, dem = over_terrain
    uv = jnp.array([2500.0, 1900.0])
    small = (jnp.array([1e-3, -2e-3, 3e-3]), jnp.array([-2e-3, 1e-3, 1e-3]))
    numbers = (
        sensor.camera,
        sensor.gimbal.gain,
        sensor.gimbal.offset,
        sensor.mount.lever_body,
        sensor.mount.lever_head,
    )
    x, unravel = ravel_pytree(jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), (numbers, small, shot, uv)))

    def rebuilt(x):
        (camera, gain, offset, lever_body, lever_head), (base, head), shot, uv = unravel(x)
        turned = (
            camera,
            gain,
            offset,
            R_from_rotation_vector(base) @ sensor.mount.R_body_from_base,
            R_from_rotation_vector(head) @ sensor.mount.R_head_from_camera,
            lever_body,
            lever_head,
        )
        places = lambda s: (  # noqa: E731
            s.camera,
            s.gimbal.gain,
            s.gimbal.offset,
            s.mount.R_body_from_base,
            s.mount.R_head_from_camera,
            s.mount.lever_body,
            s.mount.lever_head,
        )
        return eqx.tree_at(places, sensor, turned), shot, uv

    centre = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    R, middle = R_ecef_from_enu(centre).T, WGS84.to_ecef(centre)
    shape, count = np.shape(dem.posts), x.size

    def hit(z):
        fix = jaxgeo.locate(*rebuilt(z[:count]), dem.with_posts(z[count:].reshape(shape)))
        return R @ (jnp.where(fix.ok, fix.ecef, jnp.nan) - middle)

    z = jnp.concatenate([x, jnp.ravel(jnp.asarray(dem.posts, jnp.float64))])
    J_and_hit = jax.jit(jax.jacrev(lambda z: (hit(z),) * 2, has_aux=True))
    return Forward(hit, J_and_hit, z, count, np.asarray(J_and_hit(z)[0]))


def difference(function, x: np.ndarray, inputs: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Derivative of `function` by each of `inputs`, by central differences of fourth order: (inputs, ...)."""
    shifts = np.zeros((inputs.size, x.size))
    shifts[np.arange(inputs.size), inputs] = step
    points = np.concatenate([shifts, -shifts, 2.0 * shifts, -2.0 * shifts]) + x
    values = np.stack([function(point) for point in points])
    near_ahead, near_behind, far_ahead, far_behind = values.reshape(4, inputs.size, *values.shape[1:])
    width = step.reshape(-1, *[1] * (values.ndim - 1))
    return (8.0 * (near_ahead - near_behind) - (far_ahead - far_behind)) / (12.0 * width)


def steps_for(J: np.ndarray, move: float) -> tuple[np.ndarray, np.ndarray]:
    """The inputs that move the hit at all, and for each the step that moves it by `move` m."""
    strength = np.linalg.norm(J, axis=0)
    moving = np.flatnonzero(strength > 1e-3)
    return moving, move / strength[moving]


@pytest.mark.costly
def test_the_jacobian_equals_central_differences_and_gradients_reach_exactly_the_four_posts_under_the_hit(forward):
    z, J = np.asarray(forward.z), forward.J
    touched = np.flatnonzero(np.any(J[:, forward.count :] != 0.0, axis=0))
    assert touched.size == 4
    assert np.ptp(np.unravel_index(touched, (17, 17)), axis=1).tolist() == [1, 1]
    moving, step = steps_for(J, 0.02)
    assert set(forward.count + touched) <= set(moving)
    # 10 of the camera, 4 of the gimbal, 12 of the mount, 6 of the pose, 2 readings, 2 of the pixel
    assert moving.size >= 35 + 4
    numeric = difference(lambda z: forward.J_and_hit(z)[1], z, moving, step).T
    error = np.linalg.norm(numeric - J[:, moving], axis=0) / np.linalg.norm(J[:, moving], axis=0)
    print(f"{moving.size} inputs, worst relative error {error.max():.1e}")
    assert error.max() < 1e-6


@pytest.mark.slow
def test_forward_equals_reverse(forward):
    J = forward.J[:, : forward.count]
    ahead = np.asarray(jax.jit(jax.jacfwd(forward.by_numbers))(forward.x))
    np.testing.assert_allclose(J, ahead, rtol=1e-12, atol=1e-11 * np.abs(ahead).max())


@pytest.mark.slow
def test_the_second_derivative_equals_differences_of_the_first(forward):
    moving, step = steps_for(forward.J[:, : forward.count], 0.1)
    weights = jnp.array([0.6, -0.3, 0.7])

    def gradient(x):
        return jax.jacrev(lambda x: weights @ forward.by_numbers(x))(x)

    x = forward.x
    H = np.asarray(jax.jit(jax.jacfwd(gradient))(x))[np.ix_(moving, moving)]
    numeric = difference(jax.jit(gradient), np.asarray(x), moving, step)[:, moving]
    scale = np.outer(step, step)  # each entry as what it adds, in m, over one step of both inputs
    error = np.abs(H - numeric) * scale
    print(f"largest second derivative {np.abs(H * scale).max():.1e} m, largest error {error.max():.1e} m")
    assert error.max() < 1e-4 * np.abs(H * scale).max()
    np.testing.assert_allclose(H, H.T, rtol=1e-9, atol=1e-9 * np.abs(H).max())


FAILING = {
    "rises": local_ray(0, 0, 300, elevation=30.0),
    "leaves": local_ray(0, 0, 900, elevation=-45.0),
    "misses": local_ray(2000, 0, 500),
    "from the side": local_ray(-1000, -75, 178, azimuth=90, elevation=-2.0),
    "buried": local_ray(0, 0, 20),
    "hits": local_ray(20, 10, 500, azimuth=20, elevation=-60.0),
    "over the void": local_ray(95, 0, 500),
    "not a number": jaxgeo.Ray(jnp.array([jnp.nan, 0.0, 0.0]), jnp.array([0.0, 0.0, -1.0])),
    "not a unit vector": jaxgeo.Ray(WGS84.to_ecef(jaxgeo.Geodetic(lat=0.8, lon=0.2, height=9.0)), jnp.zeros(3)),
    "under the edge": local_ray(-1000, 10, 60, azimuth=90, elevation=1e-2),
}


MIDDLE = jnp.array([8.0, 8.0])  # row and column of the posts' middle


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1, 2), has_aux=True)
def mean_height(rays, posts, rowcol0):
    """Mean height of the hits, and all statuses, with gradients by everything."""
    dem = Dem.from_array(posts, eqx.tree_at(lambda grid: grid.rowcol0, small_dem(rough(4)).grid, rowcol0))
    fix = jax.vmap(lambda ray: jaxgeo.intersect(ray, dem))(rays)
    return jnp.sum(jnp.where(fix.ok, fix.position.height, 0.0)) / jnp.maximum(jnp.sum(fix.ok), 1), fix.status


@pytest.mark.slow
def test_the_gradient_of_a_masked_mean_is_finite_whatever_the_rays_do():
    posts = rough(4)
    posts[8, 11] = np.nan
    rays = stack(list(FAILING.values()), len(FAILING))
    (mean, status), gradient = mean_height(rays, jnp.asarray(posts), MIDDLE)
    assert {int(code) for code in status} == set(range(10)) - {Status.near_tangent}
    assert np.isfinite(mean)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))

    slope = np.tan(np.deg2rad(20.0))
    along = local_ray(0, 0, 100.01, azimuth=180, elevation=-20.02)
    graze = stack([along, FAILING["hits"]], len(FAILING))
    plane = jnp.asarray(100.0 - 30.0 * slope * (np.arange(17.0)[:, None] - 8.0) * np.ones(17))
    (_, grazing), steep = mean_height(graze, plane, MIDDLE)
    assert int(grazing[0]) == Status.near_tangent
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(steep))
    alive = np.any(np.asarray(gradient[0].origin) != 0.0, axis=1)
    assert alive.tolist() == [int(code) == Status.hit for code in status]


@pytest.mark.slow
def test_the_gradient_of_a_masked_mean_is_finite_whatever_the_shots_are(over_terrain):  # noqa: F811
    sensor, shot, dem = over_terrain
    uv = jnp.array([[2000.0, 1500.0], [-900.0, 10.0], [2000.0, jnp.nan], [2000.0, 1500.0], [2000.0, 1500.0]])
    heading = jnp.array([shot.pose.heading, shot.pose.heading, shot.pose.heading, jnp.nan, shot.pose.heading + 3.0])

    def mean_height(sensor, heading, uv):
        def one(heading, uv):
            posed = eqx.tree_at(lambda s: s.pose.heading, shot, heading)
            return jaxgeo.locate(sensor, posed, uv, dem)

        fix = jax.vmap(one)(heading, uv)
        return jnp.sum(jnp.where(fix.ok, fix.position.height, 0.0)) / jnp.sum(fix.ok), fix.status

    as_float = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), sensor)
    (_, status), gradient = jax.jit(jax.value_and_grad(mean_height, argnums=(0, 1, 2), has_aux=True))(
        as_float, heading, uv
    )
    words = [Status(int(code)).name for code in status]
    assert words[:4] == ["hit", "outside_image", "invalid_input", "invalid_input"]
    for leaf in jax.tree.leaves(gradient):
        assert np.all(np.isfinite(leaf))


@pytest.mark.slow
def test_nested_maps_and_maps_over_terrains():
    dems = [small_dem(rough(seed)) for seed in range(3)]
    rays = stack([local_ray(e, 0, 500, azimuth=30, elevation=-60) for e in (-40, 0, 40, 55)], 4)
    stacked: Dem = jax.tree.map(lambda *leaves: jnp.stack(leaves), *dems)
    grid = jax.jit(jax.vmap(jax.vmap(jaxgeo.intersect, in_axes=(0, None)), in_axes=(None, 0)))(rays, stacked)
    alone = jax.jit(jax.vmap(jaxgeo.intersect, in_axes=(0, None)))
    for k, dem in enumerate(dems):
        np.testing.assert_allclose(grid.ecef[k], alone(rays, dem).ecef, rtol=0, atol=5e-9)


@pytest.mark.costly
def test_a_gimbal_in_local_level_moves_the_hit_by_its_own_angles():
    """The body's attitude then only carries the lever arm."""
    rng = np.random.default_rng(3)
    gimbal = Gimbal.three_axis()
    sensor, shot = a_sensor(gimbal, rng), a_shot(gimbal, rng)

    def hit(roll, yaw):
        posed = eqx.tree_at(lambda s: s.pose.roll, shot, np.asarray(roll))
        turned = eqx.tree_at(lambda s: s.gimbal_readings, posed, np.array([yaw, 0.1, 0.0]))
        return np.asarray(jaxgeo.locate(sensor, turned, (2000.0, 1500.0), jaxgeo.ConstantHeight(100.0)).ecef)

    step = 1e-3  # rad
    by_roll = (hit(0.02 + step, 0.3) - hit(0.02 - step, 0.3)) / (2.0 * step)
    by_yaw = (hit(0.02, 0.3 + step) - hit(0.02, 0.3 - step)) / (2.0 * step)
    assert 0.0 < np.linalg.norm(by_roll) < 20.0  # a lever arm of metres
    assert np.linalg.norm(by_yaw) > 50.0


@pytest.fixture(scope="module")
def gradient_of_projection(over_terrain):  # noqa: F811
    sensor, shot, _ = over_terrain

    def seen(point):
        projection = jaxgeo.project(sensor, shot, point)
        return jnp.sum(jnp.where(projection.ok, projection.uv, 0.0)), projection.status

    return jax.jit(jax.grad(seen, has_aux=True))


@pytest.mark.parametrize("point", [(np.nan, 0.2, 100.0), (0.8, np.nan, 100.0), (0.8, 0.2, np.inf), (-0.8, 0.2, 100.0)])
def test_the_gradient_of_a_projection_is_finite_whatever_the_point_is(gradient_of_projection, point):
    where = jaxgeo.Geodetic(**dict(zip(("lat", "lon", "height"), map(np.asarray, point), strict=True)))
    gradient, status = gradient_of_projection(where)
    assert (int(status) == Status.invalid_input) == (not np.all(np.isfinite(point)))
    assert int(status) != Status.hit
    assert all(np.isfinite(leaf) for leaf in jax.tree.leaves(gradient))


@pytest.fixture(scope="module")
def gradient_at_range(over_terrain):  # noqa: F811
    sensor, shot, _ = over_terrain

    def height(shot, uv, distance):
        fix = jaxgeo.at_range(sensor, shot, uv, distance)
        return jnp.where(fix.ok, fix.position.height, 0.0)

    as_float = jax.tree.map(lambda x: np.asarray(x, np.float64), shot)
    return functools.partial(jax.jit(jax.grad(height, argnums=(0, 1, 2))), as_float)


@pytest.mark.costly
@pytest.mark.parametrize("uv, distance", [((1e5, 1e5), 500.0), ((np.nan, 0.0), 500.0), ((2000.0, 1500.0), np.inf)])
def test_the_gradient_at_a_range_is_finite_whatever_fails(gradient_at_range, uv, distance):
    gradient = gradient_at_range(np.array(uv), np.asarray(distance))
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1, 2), has_aux=True)
def height_of_one(ray, posts, rowcol0):
    """Height of one hit, and its status, with gradients by everything."""
    dem = Dem.from_array(posts, eqx.tree_at(lambda grid: grid.rowcol0, small_dem(rough(4)).grid, rowcol0))
    fix = jaxgeo.intersect(ray, dem)
    return jnp.where(fix.ok, fix.position.height, 0.0), fix.status


@pytest.mark.costly
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_terrain_that_is_not_finite_is_told_and_poisons_no_gradient(bad):
    ray, posts, middle = FAILING["hits"], rough(4), np.asarray(MIDDLE)
    (_, status), good = height_of_one(ray, posts, middle)
    assert int(status) == Status.hit
    assert np.count_nonzero(good[1]) == 4
    for broken_post in (True, False):
        broken = (posts.copy(), middle.copy())
        broken[0 if broken_post else 1].flat[3 * 17 + 3 if broken_post else 0] = bad
        (_, status), slopes = height_of_one(ray, *broken)
        is_void = np.isnan(bad) and broken_post
        assert int(status) in ({Status.hits_void, Status.hit} if is_void else {Status.invalid_input})
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slopes))
