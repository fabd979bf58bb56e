"""Fields of height on a terrain: the hit is that on the changed posts, for every ray of a batch with its own field."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import fractal_posts
from support.scenes import hit, local_ray, rough, small_dem

from jaxgeo import Bisection, ConstantHeight, Dem, Geodetic, Ray, Status, intersect
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.terrain import AbstractField, ConstantField, LineField, Segmented, SumField, TargetArea
from jaxgeo.terrain.search import batched

SIDE = 129  # posts
NODES = 65
RAYS = 320
SAME = 5e-9  # m of clearance, as in test_batched
POSTS = 200.0 + fractal_posts(SIDE, spacing=30.0, relief=500.0, exponent=3.0, seed=4)
BIASES = (-30.0, -0.3, 0.0, 12.0)  # m


def with_voids() -> np.ndarray:
    posts = POSTS.copy()
    posts[40:60, 70:95] = np.nan
    return posts


def line(seed: int) -> LineField:
    """Nodes of up to 10 m, some three cells apart on an axis through the terrain."""
    rng = np.random.default_rng(seed)
    azimuth, length = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.0, 4.0)
    step = length * np.array([np.cos(azimuth), np.sin(azimuth)])
    first = 64.0 - 0.5 * (NODES - 1) * step + rng.normal(size=2)
    return LineField(jnp.asarray(rng.uniform(-10.0, 10.0, NODES)), jnp.asarray(first), jnp.asarray(step))


def at_posts(field: LineField, shape: tuple[int, int]) -> np.ndarray:
    """The field at every post, in NumPy."""
    row, col = np.indices(shape)
    first, step = np.asarray(field.first), np.asarray(field.step)
    along = ((row - first[0]) * step[0] + (col - first[1]) * step[1]) / (step @ step)
    return np.interp(along, np.arange(field.values.shape[0]), np.asarray(field.values))


def sum_of(bias: float, seed: int | None) -> SumField:
    """A bias and a line, which is zero without a seed: of one structure, so that one compilation serves all."""
    level = LineField(jnp.zeros(NODES), jnp.zeros(2), jnp.array([1.0, 0.0]))
    return SumField(ConstantField(jnp.asarray(bias)), level if seed is None else line(seed))


def stacked(items: list):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *items)


def some_rays() -> Ray:
    """Steep and grazing ones in bundles of neighbours, and each way to meet nothing."""
    rng = np.random.default_rng(5)
    special = [
        local_ray(0, 0, 2000, elevation=40),
        local_ray(-9000, 0, 1500, azimuth=270, elevation=-30),
        local_ray(1500, 0, 900, azimuth=90, elevation=-10),
        local_ray(0, 0, 150, elevation=-45),
        local_ray(float(30 * (82 - 64)), float(30 * (64 - 50)), 3000, elevation=-90),
        local_ray(-2500, 100, 660, azimuth=90, elevation=-8),
    ]
    leaders = [special[k % len(special)] for k in range(20)]
    while len(leaders) < 70:
        east, north = rng.uniform(-1200.0, 1200.0, 2)
        azimuth, elevation = rng.uniform(0.0, 360.0), -rng.choice([4.0, 10.0, 25.0, 60.0])
        leaders.append(local_ray(east, north, 720.0, azimuth=azimuth, elevation=elevation))
    origin, direction = (np.repeat(x, [1] * 20 + [6] * 50, axis=0) for x in jax.tree.leaves(stacked(leaders)))
    direction[20:] += 1e-3 * rng.normal(size=(RAYS - 20, 3))
    return Ray(jnp.asarray(origin), jnp.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True)))


@pytest.fixture(scope="module")
def rays() -> Ray:
    return some_rays()


@pytest.fixture(scope="module")
def own_fields():
    """Hits of a batch, each ray with its field, in blocks so small that bundles and rounds take part."""

    def one(ray: Ray, field: SumField, dem: Dem):
        return intersect(ray, dem.with_field(field))

    compiled = jax.jit(jax.vmap(one, in_axes=(0, 0, None)))

    def run(rays: Ray, fields: SumField, dem: Dem):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(batched, "LARGE_BLOCK", 128)
            patch.setattr(batched, "SMALL_BLOCK", 64)
            return jax.tree.map(np.asarray, compiled(rays, fields, dem))

    return run


@pytest.fixture(scope="module")
def plain():
    return jax.jit(jax.vmap(intersect, in_axes=(0, None)))


def per_ray(fixes: list, which: np.ndarray):
    """Of several runs of all rays, for each ray the one it belongs to."""
    return jax.tree.map(lambda *leaves: np.stack(leaves)[which, np.arange(which.size)], *fixes)


def assert_same(fix, expected) -> None:
    np.testing.assert_array_equal(fix.status, expected.status)
    apart = np.linalg.norm(fix.ecef - expected.ecef, axis=-1)
    steepness = np.abs(np.cos(expected.incidence_surface))
    np.testing.assert_array_equal(np.isnan(apart), np.isnan(expected.slant_range))
    assert np.nanmax(apart * steepness) < SAME
    np.testing.assert_allclose(fix.slope, expected.slope, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_bias_for_each_ray_is_a_terrain_so_much_higher(rays, own_fields, plain):
    posts = with_voids()
    which = np.random.default_rng(0).integers(0, len(BIASES), RAYS)
    fields = stacked([sum_of(BIASES[k], None) for k in which])
    fix = own_fields(rays, fields, small_dem(posts))
    expected = per_ray([plain(rays, small_dem(posts + b)) for b in BIASES], which)
    assert_same(fix, expected)
    met = {Status(int(code)) for code in fix.status}
    assert met >= {Status.hit, Status.hits_void, Status.leaves_terrain, Status.camera_below_terrain}
    assert met >= {Status.rises_away, Status.ray_misses_terrain, Status.enters_from_side}


@pytest.mark.slow
def test_a_line_for_each_ray_meets_the_first_ground_of_the_posts_so_changed(rays, own_fields, plain):
    """Also with a bias on top; neighbours in a bundle have unlike fields."""
    seeds, bias = (11, 12, 13, 14), (0.0, 25.0, -40.0, 3.0)
    which = np.random.default_rng(1).integers(0, len(seeds), RAYS)
    fields = stacked([sum_of(bias[k], seeds[k]) for k in which])
    fix = own_fields(rays, fields, small_dem(POSTS))
    changed = [small_dem(POSTS + b + at_posts(line(s), POSTS.shape)) for s, b in zip(seeds, bias, strict=True)]
    expected = per_ray([plain(rays, dem) for dem in changed], which)
    differs = np.flatnonzero(fix.status != expected.status)
    print(f"ties: {differs.tolist()}")
    assert_same(fix, expected)
    unchanged = plain(rays, small_dem(POSTS))
    assert np.nanmedian(np.abs(fix.slant_range - unchanged.slant_range)) > 5.0


R = np.asarray(R_ecef_from_enu(Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)))


def hit_of(field: SumField, ray: Ray, dem: Dem):
    """From the origin to the hit in m along east, north and up at the terrain's centre."""
    return R.T @ (intersect(ray, dem.with_field(field)).ecef - ray.origin)


@pytest.fixture(scope="module")
def derivatives():
    """Jacobian of the hit by everything in a field, in reverse."""
    return jax.jit(jax.vmap(jax.jacrev(hit_of), in_axes=(0, 0, None)))


def slanted(count: int = 3) -> Ray:
    """Rays of 30 degrees incidence into the rough."""
    return stacked([local_ray(100.0 * k, -50.0, 1500, azimuth=40.0, elevation=-60.0) for k in range(count)])


@pytest.mark.slow
def test_derivatives_by_the_field_are_differences_and_reach_the_nodes_that_matter(derivatives, own_fields):
    dem, sights = small_dem(POSTS), slanted()
    field = sum_of(2.0, 11)
    jacobians = derivatives(stacked([field] * 3), sights, dem)

    ray = jax.tree.map(lambda x: x[1], sights)
    leaves, structure = jax.tree.flatten(field)
    step = 1e-4
    moved = []  # two lanes for each number of the field
    for k, leaf in enumerate(leaves):
        for i in range(leaf.size):
            for sign in (1.0, -1.0):
                change = sign * step * (np.arange(leaf.size) == i).reshape(leaf.shape)
                moved.append(jax.tree.unflatten(structure, [*leaves[:k], leaf + change, *leaves[k + 1 :]]))
    lanes = len(moved)
    assert lanes == 2 * (1 + NODES + 4)
    fix = own_fields(stacked([ray] * RAYS), stacked(moved + [field] * (RAYS - lanes)), dem)
    change = fix.ecef[:lanes:2] - fix.ecef[1:lanes:2]
    differences = change @ R / (2.0 * step)
    jacobian = np.concatenate([np.asarray(x)[1].reshape(3, -1).T for x in jax.tree.leaves(jacobians)])
    np.testing.assert_allclose(jacobian, differences, rtol=0, atol=2e-5)
    by_nodes = jacobian[1 : 1 + NODES]
    reached = np.flatnonzero(np.any(by_nodes != 0.0, axis=1))
    assert 2 <= reached.size <= 3
    np.testing.assert_allclose(by_nodes.sum(axis=0), jacobian[0], rtol=0, atol=1e-9)  # all nodes at once are a bias


@pytest.mark.slow
def test_forward_agrees_with_reverse_and_second_derivatives_are_differences(derivatives, own_fields):
    dem, sights = small_dem(POSTS), slanted()
    fields = stacked([sum_of(2.0, seed) for seed in (11, 12, 13)])
    forward = jax.jit(jax.vmap(jax.jacfwd(hit_of), in_axes=(0, 0, None)))(fields, sights, dem)
    reverse = derivatives(fields, sights, dem)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=0, atol=1e-8), forward, reverse)

    def by_bias(bias, field, ray):
        return hit_of(SumField(ConstantField(bias), field.b), ray, dem)

    hessian = jax.jit(jax.vmap(jax.hessian(by_bias)))(fields.a.height, fields, sights)
    wide = 0.05
    moved = [jax.tree.map(lambda x: x[0], fields)] * RAYS
    moved[:3] = [sum_of(2.0 + change, 11) for change in (wide, 0.0, -wide)]
    fix = own_fields(stacked([jax.tree.map(lambda x: x[0], sights)] * RAYS), stacked(moved), dem)
    differences = (fix.ecef[0] - 2.0 * fix.ecef[1] + fix.ecef[2]) @ R / wide**2
    np.testing.assert_allclose(hessian[0], differences, rtol=0, atol=2e-5)


@pytest.mark.slow
def test_a_bias_moves_the_hit_on_a_plain_by_the_tangent_of_the_incidence(derivatives):
    plain_ground, sights = small_dem(np.full_like(POSTS, 300.0)), slanted()
    jacobians = derivatives(stacked([sum_of(0.0, None)] * 3), sights, plain_ground)
    moved = np.asarray(jacobians.a.height)
    incidence = intersect(jax.tree.map(lambda x: x[0], sights), ConstantHeight(300.0)).incidence_ellipsoid
    np.testing.assert_allclose(np.linalg.norm(moved[0, :2]), np.tan(incidence), rtol=0, atol=2e-4)
    np.testing.assert_allclose(np.linalg.norm(moved[0]), 1.0 / np.cos(incidence), rtol=0, atol=1e-6)


def not_finite() -> list[SumField]:
    bad = line(11)
    bad = LineField(bad.values.at[64].set(jnp.nan), bad.first, bad.step)  # a node that no ray comes near
    return [sum_of(jnp.nan, None), SumField(ConstantField(jnp.asarray(0.0)), bad), sum_of(jnp.inf, 11)]


@pytest.mark.slow
def test_derivatives_by_a_field_that_is_not_finite_are_zero(derivatives):
    for leaf in jax.tree.leaves(derivatives(stacked(not_finite()), slanted(), small_dem(POSTS))):
        np.testing.assert_array_equal(leaf, 0.0)


@pytest.mark.slow
def test_a_field_that_is_not_finite_is_invalid_input(rays, own_fields):
    fix = own_fields(rays, stacked(not_finite() + [sum_of(1.0, 11)] * (RAYS - 3)), small_dem(POSTS))
    assert [Status(int(code)) for code in fix.status[:3]] == [Status.invalid_input] * 3
    assert np.all(np.isnan(fix.ecef[:3]))
    assert not np.any(fix.status[3:] == Status.invalid_input)


SHORT = LineField(jnp.array([0.0, 8.0, -5.0, 6.0]), jnp.array([2.0, 3.0]), jnp.array([3.0, 2.5]))


OTHERS = {
    "bisection": Bisection(),
    "area": Segmented(start=120.0, window=TargetArea(height=120.0, half=2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bisection", pytest.param("area", marks=pytest.mark.slow)])
def test_the_other_searches_see_the_field_too(name):
    search = OTHERS[name]
    posts = rough(5)
    sights = [local_ray(-60.0, -80.0, 400.0, azimuth=a, elevation=-65.0) for a in range(0, 80, 10)]
    fix = hit(sights, small_dem(posts).with_field(SHORT), search)
    expected = hit(sights, small_dem(posts + at_posts(SHORT, posts.shape)), search)
    np.testing.assert_array_equal(fix.status, expected.status)
    np.testing.assert_allclose(fix.ecef, expected.ecef, rtol=0, atol=1e-6)
    assert np.all(fix.ok)


@pytest.mark.slow
def test_heights_normals_and_bounds_are_those_of_the_surface_with_its_field():
    posts = rough(5)
    posts[12, 12] = np.nan
    dem = small_dem(posts, void_ceiling=180.0).with_field(SHORT).with_field(ConstantField(-7.0))
    changed = posts + at_posts(SHORT, posts.shape) - 7.0
    other = small_dem(changed)
    for row, col in ((4.3, 5.6), (0.0, 16.0), (9.5, 8.5)):
        x, y, z = dem.grid.normal(jnp.array([row, col]))
        place = Geodetic(lat=jnp.arctan2(z, jnp.hypot(x, y)), lon=jnp.arctan2(y, x), height=jnp.zeros(()))
        np.testing.assert_allclose(dem.height_at(place), other.height_at(place), rtol=0, atol=1e-9)
        np.testing.assert_allclose(dem.normal_at(place), other.normal_at(place), rtol=0, atol=1e-9)
    assert float(dem.void_top) == 180.0 + 8.0 - 7.0
    assert float(dem.floor) <= np.nanmin(changed)
    assert float(dem.ceiling) == max(np.nanmax(posts), 180.0) + 8.0 - 7.0
    again = dem.with_posts(np.where(np.isnan(posts), 0.0, posts) + 1.0)
    assert float(again.floor) == pytest.approx(float(dem.floor) + 1.0, abs=1e-9)
    assert float(again.void_top) == float(dem.void_top)


def test_a_terrain_of_one_height_takes_a_bias_and_nothing_else():
    assert float(ConstantHeight(100.0).with_field(ConstantField(-3.0)).height) == 97.0
    with pytest.raises(TypeError, match="no posts for a field that varies"):
        ConstantHeight(100.0).with_field(SHORT)


class FiveAtOnce(AbstractField):
    """A mistake: many heights at a post."""

    def at(self, row, col):
        return jnp.zeros(5)

    def bounds(self):
        return jnp.zeros(5), jnp.zeros(5)


def test_what_is_no_field_of_one_terrain_is_refused():
    dem = small_dem(rough(5))
    with pytest.raises(TypeError, match="field"):
        dem.with_field(3.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeError, match="float32"):
        dem.with_field(ConstantField(np.float32(3.0)))
    with pytest.raises(ValueError, match="vmap"):
        dem.with_field(FiveAtOnce())
    with pytest.raises(ValueError, match="at least one node"):
        dem.with_field(LineField(np.zeros(0), np.zeros(2), np.ones(2)))


def test_a_line_of_one_node_or_without_a_direction_is_a_bias():
    one = LineField(jnp.array([4.0]), jnp.zeros(2), jnp.ones(2))
    still = LineField(jnp.array([4.0, 9.0]), jnp.zeros(2), jnp.zeros(2))
    for field in (one, still):
        assert float(field.at(jnp.asarray(3.0), jnp.asarray(5.0))) == 4.0
