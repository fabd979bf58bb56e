"""Many rays at once: the answers do not depend on how they are batched, only the time they take."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.scenes import flat, hit, local_ray, rough, small_dem, stack

from jaxgeo import Dem, Geodetic, Ray, Status, _accelerator, intersect
from jaxgeo._native import SWITCH
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.terrain import TangentGrid
from jaxgeo.terrain.search import batched, first_hit

pytestmark = pytest.mark.costly

SAME = 5e-9  # m of clearance: what the rounding of an ECEF position leaves open, and other batches round otherwise


hit_all = jax.jit(jax.vmap(intersect, in_axes=(0, None)))


def assert_same(one, other) -> None:
    np.testing.assert_array_equal(one.status, other.status)
    apart = np.abs(np.asarray(one.slant_range) - np.asarray(other.slant_range))
    steepness = np.abs(np.cos(np.asarray(one.incidence_surface)))
    np.testing.assert_array_less(apart * steepness, SAME)


@pytest.fixture(scope="module")
def together(mountains):
    return hit_all(mountains.rays, mountains.dem)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 10, 1000])
def test_a_part_of_a_batch_is_answered_like_the_whole(mountains, together, count):
    part = hit_all(jax.tree.map(lambda x: x[:count], mountains.rays), mountains.dem)
    assert_same(part, jax.tree.map(lambda x: x[:count], together))


@pytest.mark.slow
def test_a_part_in_small_blocks_many_rounds_and_bundles_is_answered_like_the_whole(mountains, together, monkeypatch):
    """The sizes of blocks are read when a number of rays is first traced, so no other test has as many."""
    count, made = 700, []
    monkeypatch.setenv(SWITCH, "0")
    monkeypatch.setattr(batched, "LARGE_BLOCK", 512)
    monkeypatch.setattr(batched, "SMALL_BLOCK", 64)
    monkeypatch.setattr(batched, "_first_pass", lambda *args, first=batched._first_pass: made.append(0) or first(*args))
    part = hit_all(jax.tree.map(lambda x: x[700 : 700 + count], mountains.rays), mountains.dem)
    assert made
    assert_same(part, jax.tree.map(lambda x: x[700 : 700 + count], together))


@pytest.mark.slow
def test_batches_of_an_accelerator_are_answered_like_those_of_a_cpu(mountains, together, monkeypatch):
    """Compiled for a CPU: parts of one large block each, and rounds of two blocks and more. No other test has as many
    rays."""
    count = 1201
    monkeypatch.setattr(_accelerator, "on_accelerator", lambda *_: True)
    monkeypatch.setattr(first_hit, "AT_ONCE_ACCELERATOR", 640)
    monkeypatch.setattr(batched, "SMALL_BLOCK", 64)  # from here on there is a first pass
    monkeypatch.setattr(batched, "SMALL_ACCELERATOR", 64)
    part = hit_all(jax.tree.map(lambda x: x[700 : 700 + count], mountains.rays), mountains.dem)
    assert_same(part, jax.tree.map(lambda x: x[700 : 700 + count], together))


@pytest.mark.slow
def test_a_bundle_is_its_rays_in_any_order(mountains):
    """Rays through one corridor start together; shuffled among unrelated ones they start alone."""
    count = mountains.rays.origin.shape[0]
    rng = np.random.default_rng(8)
    leader = np.repeat(np.arange(0, count, 60), 60)[:count]
    origin = np.asarray(mountains.rays.origin)[leader] + rng.normal(size=(count, 3))
    direction = np.asarray(mountains.rays.direction)[leader] + 1e-4 * rng.normal(size=(count, 3))
    rays = Ray(jnp.asarray(origin), jnp.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True)))
    order = rng.permutation(count)
    shuffled = hit_all(jax.tree.map(lambda x: x[order], rays), mountains.dem)
    bundled = hit_all(rays, mountains.dem)
    assert np.mean(np.asarray(bundled.ok)) > 0.9
    assert_same(jax.tree.map(lambda x: x[order], bundled), shuffled)


RAYS = stack([local_ray(-60.0, -80.0, 400.0, azimuth=a, elevation=-55.0) for a in range(0, 80, 10)])


def all_of(dem: Dem):
    """As a plain batch, the one that other tests compile too."""
    return hit([jax.tree.map(lambda x, k=k: x[k], RAYS) for k in range(8)], dem)


def alone(dem):
    one = jax.jit(intersect)
    fixes = [one(jax.tree.map(lambda x, k=k: x[k], RAYS), dem) for k in range(8)]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *fixes)


def nested(dem):
    rays = jax.tree.map(lambda x: x.reshape(2, 4, 3), RAYS)
    fix = jax.vmap(jax.vmap(intersect, in_axes=(0, None)), in_axes=(0, None))(rays, dem)
    return jax.tree.map(lambda x: x.reshape(8, *x.shape[2:]), fix)


def nested_the_other_way(dem):
    rays = jax.tree.map(lambda x: x.reshape(2, 4, 3), RAYS)
    fix = jax.vmap(jax.vmap(intersect, in_axes=(0, None)), in_axes=(1, None))(rays, dem)
    return jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1).reshape(8, *x.shape[2:]), fix)


def one_origin_shared(dem):
    return jax.vmap(lambda d, dem: intersect(Ray(RAYS.origin[0], d), dem), in_axes=(0, None))(RAYS.direction, dem)


def in_parts(dem):
    return jax.lax.map(lambda ray: intersect(ray, dem), RAYS, batch_size=4)


def scanned(dem):
    return jax.lax.scan(lambda _, ray: (0, intersect(ray, dem)), 0, RAYS)[1]


def checkpointed(dem):
    return jax.vmap(jax.checkpoint(intersect), in_axes=(0, None))(RAYS, dem)


def sharded(dem):
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:1]), ("rays",))
    rays, everywhere = jax.sharding.PartitionSpec("rays"), jax.sharding.PartitionSpec()
    all_ = jax.vmap(intersect, in_axes=(0, None))
    return jax.shard_map(all_, mesh=mesh, in_specs=(rays, everywhere), out_specs=rays)(RAYS, dem)


def on_an_explicit_mesh(dem):
    mesh = jax.make_mesh((1,), ("rays",), axis_types=(jax.sharding.AxisType.Explicit,))
    spec = jax.sharding.PartitionSpec("rays")
    with jax.set_mesh(mesh):
        rays = jax.device_put(RAYS, jax.sharding.NamedSharding(mesh, spec))
        all_ = jax.sharding.auto_axes(jax.vmap(intersect, in_axes=(0, None)), out_sharding=spec)
        return jax.tree.map(np.asarray, jax.jit(all_)(rays, dem))


WAYS = {
    f.__name__: f
    for f in (
        alone,
        nested,
        nested_the_other_way,
        one_origin_shared,
        in_parts,
        scanned,
        checkpointed,
        sharded,
        on_an_explicit_mesh,
    )
}
WITHOUT_JIT = {"alone", "on_an_explicit_mesh"}

SLOW = set(WAYS) - {"alone"}  # each compiles for seconds


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in WAYS])
def test_every_way_to_batch_gives_the_same_answers(name):
    dem = small_dem(rough(5))
    fixes = all_of(dem)
    assert np.all(np.asarray(fixes.ok))
    way = WAYS[name] if name in WITHOUT_JIT else jax.jit(WAYS[name])
    assert_same(way(dem), fixes)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["all rays each", "a ray each", "rays first"])
def test_a_batch_of_terrains(way):
    dems = [small_dem(rough(seed)) for seed in (5, 6)]
    together = jax.tree.map(lambda *leaves: jnp.stack(leaves), *dems)
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(all_of, dems))
    if way == "a ray each":
        fix = jax.jit(jax.vmap(intersect))(jax.tree.map(lambda x: x[:2], RAYS), together)
        both = jax.tree.map(lambda x: jnp.stack([x[0, 0], x[1, 1]]), both)
    elif way == "all rays each":
        fix = jax.jit(jax.vmap(jax.vmap(intersect, in_axes=(0, None)), in_axes=(None, 0)))(RAYS, together)
    else:
        fix = jax.jit(jax.vmap(jax.vmap(intersect, in_axes=(None, 0)), in_axes=(0, None), out_axes=1))(RAYS, together)
    assert_same(fix, both)


def test_an_empty_batch_is_empty():
    fix = hit_all(jax.tree.map(lambda x: x[:0], RAYS), small_dem(rough(5)))
    assert fix.ecef.shape == (0, 3)
    assert fix.status.shape == (0,)


@pytest.mark.slow
def test_a_ray_that_skims_a_plain_and_one_over_several_tracks_are_met_where_geometry_says():
    """Level ground at 100 m: rays just below the horizon sink into it after some 16, 54 and 81 km."""
    lat, lon = 47.0, 11.0
    centre = Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    shape = (9, 9001)
    grid = TangentGrid.centred(centre, spacing=(200.0, 30.0), shape=shape)
    dem = Dem.from_array(flat(100.0)[:1, :1] * np.ones(shape), grid)
    R = np.asarray(R_ecef_from_enu(centre))
    rays = []
    for east, height, dip in ((-100_000.0, 920.0, 0.0165), (-9_000.0, 131.0, 0.0032), (-60_000.0, 400.0, 0.0098)):
        start = np.asarray(WGS84.to_ecef(centre)) + R @ np.array([east, 5.0, 0.0])
        up, h = (np.asarray(x) for x in WGS84.normal_and_height(jnp.asarray(start)))
        forward = R[:, 0] - up * (R[:, 0] @ up)
        line = forward / np.linalg.norm(forward) * np.cos(dip) - up * np.sin(dip)
        rays.append(Ray(jnp.asarray(start + (height - h) * up), jnp.asarray(line / np.linalg.norm(line))))
    fix = hit_all(stack(rays), dem)
    for k, ray in enumerate(rays):
        expected, meets = WGS84.range_to_height(ray.origin, ray.direction, jnp.asarray(100.0))
        assert bool(meets)
        assert Status(int(fix.status[k])) in (Status.hit, Status.near_tangent)
        grazing = np.sin(np.pi / 2 - float(fix.incidence_ellipsoid[k]))
        np.testing.assert_allclose(fix.slant_range[k], expected, rtol=0, atol=1e-8 / grazing)
        assert float(expected) > 15_000.0
