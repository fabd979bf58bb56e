"""Ground as one function: the first hit against a dense march, derivatives against differences, what is told and
refused."""

from __future__ import annotations

import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import Bisection, ConstantHeight, Geodetic, Ray, Status
from jaxgeo.earth import WGS84
from jaxgeo.terrain import ConstantField, HeightFunction, LineField
from tests.support.hills import BASE, LAT, LON, first_below, geodetic, hills, rays_over, sampled_dem, steepest, terrain
from tests.support.scenes import local_ray, stack

COUNT = 64
SHAPE = hills(seed=3)
GROUND = terrain(SHAPE)


@jax.jit
def met(rays: Ray, ground) -> jaxgeo.Fix:
    return jax.vmap(lambda ray: jaxgeo.intersect(ray, ground))(rays)


@pytest.fixture(scope="module")
def rays() -> Ray:
    origin, direction = rays_over(COUNT, seed=1)
    return Ray(jnp.asarray(origin), jnp.asarray(direction))


@pytest.fixture(scope="module")
def fixes(rays):
    return met(rays, GROUND)


STEP = 0.25  # m


@pytest.mark.costly
def test_the_first_hit_is_that_of_a_dense_march(rays, fixes) -> None:
    """A march in NumPy at every quarter metre; a ridge that it passes between its places is lower than that allows."""
    found, status = np.asarray(fixes.slant_range), np.asarray(fixes.status)
    times = 0
    for k in range(COUNT):
        origin, direction = (np.asarray(x)[k] for x in (rays.origin, rays.direction))
        end = found[k] + 10.0 if np.isfinite(found[k]) else 40_000.0
        first = first_below(SHAPE, origin, direction, end, STEP)
        if not np.isfinite(first):
            assert status[k] == Status.rises_away
            continue
        assert status[k] in (Status.hit, Status.near_tangent)
        assert first - STEP - 1e-6 <= found[k] <= first + 1e-6, k
        beyond = first_below(SHAPE, origin + (first + 200.0) * direction, -direction, 190.0, STEP)
        times += np.isfinite(beyond)
    assert np.mean(status == Status.hit) > 0.9
    assert times > 20


@pytest.mark.costly
def test_a_hit_lies_on_the_ray_and_on_the_ground(rays, fixes) -> None:
    ok = np.asarray(fixes.ok)
    off = np.asarray(fixes.position.height - jax.vmap(GROUND.height_at)(fixes.position))
    np.testing.assert_allclose(off[ok], 0.0, rtol=0, atol=5e-9)
    along = rays.origin + fixes.slant_range[:, None] * rays.direction
    np.testing.assert_allclose(np.asarray(fixes.ecef - along)[ok], 0.0, rtol=0, atol=1e-8)


@pytest.mark.costly
def test_without_a_slope_a_crossing_is_found_but_not_always_the_first(rays, fixes) -> None:
    other = met(rays, terrain(SHAPE, with_slope=False))
    both = np.asarray(fixes.ok & other.ok)
    later = np.asarray(other.slant_range - fixes.slant_range)[both]
    assert np.all(later > -1e-6)
    assert np.mean(later < 1e-6) > 0.9
    off = np.asarray(other.position.height - jax.vmap(GROUND.height_at)(other.position))
    np.testing.assert_allclose(off[both], 0.0, rtol=0, atol=5e-9)


@pytest.mark.slow
def test_a_fine_grid_of_the_same_heights_is_hit_at_the_same_places() -> None:
    """Bilinear patches keep off the waves by an eighth of the square of a cell times their bend."""
    shape, spacing = hills(seed=4, longest=8000.0, slope=0.3), 4.0
    dem = sampled_dem(shape, spacing, 1001)
    origin, direction = rays_over(COUNT, seed=2)
    rays = Ray(jnp.asarray(origin), jnp.asarray(direction))
    smooth, posts = met(rays, terrain(shape)), met(rays, dem)
    both = np.asarray(smooth.ok & posts.ok)
    assert np.sum(both) > COUNT / 3
    bend = float(np.sum(shape.amplitude * (shape.by_lat**2 + shape.by_lon**2 / np.cos(LAT) ** 2))) / 6.33e6**2
    sag = 0.25 * spacing**2 * bend
    sine = np.cos(np.asarray(smooth.incidence_surface))
    off = np.abs(np.asarray(smooth.slant_range - posts.slant_range))
    assert np.mean(off[both] < 2.0 * sag / np.maximum(sine[both], 0.01)) > 0.95
    np.testing.assert_allclose(np.median(off[both]), 0.0, atol=sag)


OBLIQUE = local_ray(0.0, 0.0, 900.0, azimuth=40.0, elevation=-25.0)


def unravelled(x, shape):
    """A ray and hills from their own, moved by a vector: m, rad, and shares of the amplitudes."""
    ray = OBLIQUE
    direction = ray.direction + x[3:6]
    moved = eqx.tree_at(
        lambda s: (s.amplitude, s.phase), shape, (shape.amplitude * (1.0 + x[6:13]), shape.phase + x[13])
    )
    return Ray(ray.origin + x[:3], direction / jnp.linalg.norm(direction)), moved


def hit_of(x):
    ray, shape = unravelled(x, SHAPE)
    ground = HeightFunction(shape, BASE - 500.0, BASE + 500.0, lipschitz=2.0)
    fix = jaxgeo.intersect(ray, ground)
    return jnp.concatenate([fix.ecef - ray.origin, jnp.stack([fix.slope, fix.incidence_surface])])


ZERO, STEPS = jnp.zeros(14), np.array([1e-2] * 3 + [1e-5] * 3 + [1e-4] * 8)


@pytest.mark.costly
def test_derivatives_of_a_hit_are_those_of_differences() -> None:
    """By the ray and by the parameters of the function, forward and in reverse."""
    moves = jnp.asarray(np.diag(STEPS))
    around = jnp.concatenate([moves, -moves, 2.0 * moves, -2.0 * moves, ZERO[None]])
    slopes, values = jax.jit(jax.vmap(jax.jacfwd(lambda x: (hit_of(x),) * 2, has_aux=True)))(around)
    J = np.asarray(slopes[-1])
    np.testing.assert_allclose(jax.jit(jax.jacrev(hit_of))(ZERO), J, rtol=1e-9, atol=1e-9)
    near, back, far, farther = np.asarray(values[:-1]).reshape(4, 14, 5)
    differences = (8.0 * (near - back) - (far - farther)) / 12.0
    np.testing.assert_allclose(J.T * STEPS[:, None], differences, rtol=1e-5, atol=1e-7)
    assert np.all(np.abs(J[:3, 6:]).max(axis=0) > 1e-3)


@pytest.mark.slow
def test_second_derivatives_of_a_hit_are_those_of_differences() -> None:
    along = jnp.asarray(np.random.default_rng(0).normal(size=14) * STEPS)
    slope = jax.jit(lambda x: jax.jvp(hit_of, (x,), (along,))[1])
    bend = np.asarray(jax.jit(lambda x: jax.jvp(slope, (x,), (along,))[1])(ZERO))
    differences = np.asarray((slope(ZERO + along) - slope(ZERO - along)) / 2.0)
    np.testing.assert_allclose(bend, differences, rtol=1e-4, atol=1e-9)
    assert np.max(np.abs(bend[:3])) > 1e-6
    backwards = jax.jit(jax.grad(lambda x: jax.grad(lambda x: hit_of(x)[0])(x) @ along))(ZERO)
    assert float(backwards @ along) == pytest.approx(bend[0], rel=1e-8)


class Shelf(eqx.Module):
    """Level ground in m that rises, m per rad of longitude, to the east of 11 degrees; unknown beyond an edge, rad."""

    level: jax.Array
    rise: jax.Array
    edge: jax.Array

    def __call__(self, position: Geodetic):
        height = self.level + self.rise * jnp.maximum(position.lon - LON, 0.0)
        return jnp.where(position.lon < self.edge, height, jnp.nan)


def shelf(rise: float = 0.0, edge_deg: float = 180.0) -> Shelf:
    return Shelf(*(jnp.asarray(x) for x in (300.0, rise, np.deg2rad(edge_deg))))


STEEP, LEVEL, ENDING, NOWHERE = shelf(rise=4.35e6), shelf(), shelf(edge_deg=11.01), shelf(edge_deg=-180.0)  # 45 degrees
WIDE, NARROW = (200.0, 900.0, 1.1), (200.0, 400.0, 0.1)
# function, (lowest, highest, steepest), what differs from a ray at 600 m that looks east and down, what is told
TOLD = {
    "hits": (STEEP, WIDE, {"elevation": -20.0}, Status.hit),
    "over the highest, upwards": (STEEP, WIDE, {"height": 1000.0, "elevation": 3.0}, Status.rises_away),
    "below the highest, upwards": (STEEP, WIDE, {"elevation": 50.0, "azimuth": 270.0}, Status.rises_away),
    "begins below": (STEEP, WIDE, {"height": 290.0}, Status.camera_below_terrain),
    "on the ground, upwards": (LEVEL, NARROW, {"height": 300.0, "elevation": 40.0}, Status.rises_away),
    "steeper than that": (STEEP, (200.0, 900.0, 0.1), {"elevation": -20.0}, Status.invalid_input),
    "lower than that": (STEEP, (310.0, 900.0, 1.1), {"elevation": -20.0, "azimuth": 270.0}, Status.invalid_input),
    "below the lowest": (LEVEL, (400.0, 500.0, 1.0), {}, Status.invalid_input),
    "above the highest": (LEVEL, (100.0, 200.0, 1.0), {}, Status.invalid_input),
    "known nowhere": (NOWHERE, NARROW, {}, Status.hits_void),
    "into the unknown": (ENDING, NARROW, {"elevation": -15.0}, Status.hits_void),
    "short of the unknown": (ENDING, NARROW, {"elevation": -45.0}, Status.hit),
}


@pytest.mark.costly
@pytest.mark.parametrize("case", TOLD)
@pytest.mark.parametrize("with_slope", [True, False])
def test_what_is_told(case: str, with_slope: bool) -> None:
    function, (low, high, slope), ray, expected = TOLD[case]
    if case == "steeper than that" and not with_slope:
        expected = Status.hit
    ground = HeightFunction(function, low, high, lipschitz=slope if with_slope else None)
    fix = jaxgeo.intersect(local_ray(0.0, 0.0, **({"height": 600.0, "azimuth": 90.0} | ray)), ground)
    assert Status(int(fix.status)) is expected
    assert bool(jnp.isfinite(fix.slant_range)) == (expected in (Status.hit, Status.hits_void))
    if case == "into the unknown":
        assert float(fix.position.lon) == pytest.approx(np.deg2rad(11.01), abs=2e-9)  # 1 cm


@pytest.mark.costly
def test_gradients_are_finite_whatever_is_told() -> None:
    rays = stack([local_ray(0.0, 0.0, 600.0, azimuth=90.0, elevation=e) for e in (-45.0, -15.0, -3.0, 0.0, 20.0)])

    def mean_height(level, rays):
        ground = HeightFunction(eqx.tree_at(lambda s: s.level, ENDING, level), 200.0, 400.0, lipschitz=0.1)
        fix = jax.vmap(lambda ray: jaxgeo.intersect(ray, ground))(rays)
        return jnp.sum(jnp.where(fix.ok, fix.position.height, 0.0)), fix.status

    (_, status), (by_level, by_rays) = jax.jit(jax.value_and_grad(mean_height, (0, 1), has_aux=True))(
        jnp.asarray(300.0), rays
    )
    assert {Status(int(s)) for s in status} == {Status.hit, Status.hits_void, Status.rises_away}
    assert float(by_level) == pytest.approx(1.0)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(by_rays))


@pytest.mark.costly
def test_a_parameter_that_is_no_number_is_invalid_input(rays, fixes) -> None:
    broken = eqx.tree_at(lambda s: s.phase, SHAPE, SHAPE.phase.at[2].set(jnp.nan))
    for ground in (terrain(broken), eqx.tree_at(lambda g: g.highest, GROUND, jnp.full_like(GROUND.highest, jnp.inf))):
        np.testing.assert_array_equal(met(rays, ground).status, Status.invalid_input)


@pytest.mark.costly
def test_a_bias_raises_the_ground(rays, fixes) -> None:
    raised = GROUND.with_field(ConstantField(7.0)).with_field(ConstantField(-4.0))
    place = jax.tree.map(lambda x: x[0], fixes.position)
    assert float(raised.height_at(place) - GROUND.height_at(place)) == pytest.approx(3.0, abs=1e-9)
    found = met(rays, raised)
    off = np.asarray(found.position.height - jax.vmap(GROUND.height_at)(found.position))
    np.testing.assert_allclose(off[np.asarray(found.ok)], 3.0, rtol=0, atol=5e-9)
    with pytest.raises(TypeError, match="no posts for a field that varies"):
        GROUND.with_field(LineField(jnp.zeros(3), jnp.zeros(2), jnp.ones(2)))


@pytest.mark.costly
@pytest.mark.parametrize("air", [None, pytest.param(jaxgeo.Atmosphere(), marks=pytest.mark.slow)])
def test_a_function_that_is_level_is_level_ground(air) -> None:
    level = HeightFunction(lambda position: 250.0 + 0.0 * position.lat, 250.0, 250.0, lipschitz=0.0)
    for elevation in (-80.0, -20.0, -4.0, -2.5, -1.0):
        ray = local_ray(0.0, 0.0, 9000.0, azimuth=70.0, elevation=elevation)
        own, usual = (jaxgeo.intersect(ray, t, atmosphere=air) for t in (level, ConstantHeight(jnp.asarray(250.0))))
        assert own.status == usual.status
        np.testing.assert_allclose(own.ecef, usual.ecef, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_network_learns_the_height_at_which_it_is_seen() -> None:
    """Derivatives reach a module's parameters, whose activation goes through no `jit`."""
    network = eqx.nn.MLP(2, "scalar", 8, 1, jnp.tanh, key=jax.random.key(1))

    class Field(eqx.Module):
        network: eqx.nn.MLP

        def __call__(self, position: Geodetic):
            return 300.0 + 20.0 * jnp.tanh(self.network(6e3 * jnp.stack([position.lat - LAT, position.lon - LON])))

    ray = local_ray(0.0, 0.0, 700.0, azimuth=200.0, elevation=-50.0)

    def slant_range(field):
        return jaxgeo.intersect(ray, HeightFunction(field, 270.0, 330.0, lipschitz=1.0)).slant_range

    field = Field(network)
    value, by_field = eqx.filter_jit(eqx.filter_value_and_grad(slant_range))(field)
    leaves = jax.tree.leaves(eqx.filter(by_field, eqx.is_inexact_array))
    assert len(leaves) == 4
    largest = max(leaves, key=lambda leaf: float(jnp.max(jnp.abs(leaf))))
    assert float(jnp.max(jnp.abs(largest))) > 1.0
    bias = lambda f: f.network.layers[-1].bias  # noqa: E731
    moved = [float(slant_range(eqx.tree_at(bias, field, bias(field) + step))) for step in (1e-5, -1e-5)]
    assert float(jnp.squeeze(bias(by_field))) == pytest.approx((moved[0] - moved[1]) / 2e-5, rel=1e-6)
    assert float(value) > 0.0


REFUSED = {
    "no function": (
        lambda: HeightFunction(300.0, 200.0, 400.0),
        TypeError,
        "must be a function of a Geodetic; got float",
    ),
    "two heights": (
        lambda: HeightFunction(lambda p: jnp.stack([p.lat, p.lon]), 0.0, 1.0),
        ValueError,
        r"must return one height in m for one position; got ShapeDtypeStruct of shape \(2,\)",
    ),
    "float32": (
        lambda: HeightFunction(lambda p: p.lat.astype(jnp.float32), 0.0, 1.0),
        TypeError,
        "must return float64; got float32",
    ),
    "crossed": (lambda: HeightFunction(lambda p: p.lat, 2.0, 1.0), ValueError, "lowest must not exceed highest"),
    "no bound": (lambda: HeightFunction(lambda p: p.lat, 0.0, np.inf), ValueError, "highest must be finite, in m"),
    "falling": (
        lambda: HeightFunction(lambda p: p.lat, 0.0, 1.0, lipschitz=-1.0),
        ValueError,
        "lipschitz must be a slope of 0 or more",
    ),
    "another search": (
        lambda: jaxgeo.intersect(local_ray(0.0, 0.0, 900.0), GROUND, search=Bisection()),
        TypeError,
        r"search must be FirstHit\(\) over a HeightFunction, which has no posts; got Bisection",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_mistakes_are_refused(case: str) -> None:
    build, kind, words = REFUSED[case]
    with pytest.raises(kind, match=words):
        build()


def test_the_steepest_rise_of_the_test_s_own_hills_is_a_bound() -> None:
    places = np.random.default_rng(0).uniform(-0.01, 0.01, (4096, 2))
    gradient = jax.jit(jax.vmap(jax.grad(SHAPE)))(
        Geodetic(lat=LAT + places[:, 0], lon=LON + places[:, 1], height=np.zeros(4096))
    )
    lat = LAT + places[:, 0]
    M, N = (
        np.asarray(jax.vmap(radius)(jnp.asarray(lat)))
        for radius in (WGS84.meridian_radius, WGS84.prime_vertical_radius)
    )
    rise = np.hypot(gradient.lat / M, gradient.lon / (N * np.cos(lat)))
    assert 0.4 * steepest(SHAPE) < np.max(rise) < steepest(SHAPE)


@pytest.mark.costly
def test_parameters_are_what_jax_can_trace_and_the_rest_is_compiled_in() -> None:
    class Steps(eqx.Module):
        levels: np.ndarray
        scale: float
        count: int

        def __call__(self, position: Geodetic):
            step = jnp.clip((1e3 * (position.lat - LAT)).astype(int), 0, self.count - 1)
            return self.scale * self.levels[step]

    ground = HeightFunction(Steps(np.array([100.0, 150.0]), 2.0, 2), 0.0, 500.0)
    assert [np.shape(leaf) for leaf in jax.tree.leaves(ground.parameters)] == [(2,), ()]
    ray = local_ray(0.0, 0.0, 900.0)
    by_ground = jax.jit(jax.grad(lambda ground: jaxgeo.intersect(ray, ground).position.height))(ground)
    np.testing.assert_allclose(by_ground.parameters.levels, [2.0, 0.0], rtol=1e-9)
    assert float(by_ground.parameters.scale) == pytest.approx(100.0)


def test_terrain_survives_pickling() -> None:
    again = pickle.loads(pickle.dumps(GROUND))
    place = Geodetic(lat=jnp.asarray(LAT), lon=jnp.asarray(LON), height=jnp.zeros(()))
    assert float(again.height_at(place)) == float(GROUND.height_at(place))
    assert jax.tree.structure(again) == jax.tree.structure(GROUND)


WALL_AT = LON + 2000.0 / (6.39e6 * np.cos(LAT))  # rad: some 2 km to the east


def wall(position: Geodetic):
    """Level ground with a wall from north to south, 60 m high and some 0.4 m thick."""
    metres = 6.39e6 * np.cos(LAT) * (position.lon - WALL_AT)
    return 300.0 + 60.0 * jnp.exp(-((metres / 0.2) ** 2))


@pytest.mark.costly
def test_a_thin_wall_is_found_by_its_slope_and_may_be_passed_without() -> None:
    """From 500 m, at 5 degrees below the horizon, it is met at half its height; the ground some 300 m behind it."""
    ray = local_ray(0.0, 0.0, 505.0, azimuth=90.0, elevation=-5.0)
    with_slope, without = (
        jaxgeo.intersect(ray, HeightFunction(wall, 300.0, 360.0, lipschitz=slope)) for slope in (260.0, None)
    )
    metres = [6.39e6 * np.cos(LAT) * (float(fix.position.lon) - WALL_AT) for fix in (with_slope, without)]
    assert bool(with_slope.ok)
    assert -0.4 < metres[0] < 0.0
    assert metres[1] > 100.0  # a thousandth of the way is 0.7 m
    assert abs(float(with_slope.position.height) - float(wall(with_slope.position))) < 1e-8
    steps = np.arange(0.0, float(with_slope.slant_range) - 1e-3, 0.01)
    p = np.asarray(ray.origin)[None, :] + steps[:, None] * np.asarray(ray.direction)[None, :]
    _, lon, height = geodetic(p)
    above = height - 300.0 - 60.0 * np.exp(-((6.39e6 * np.cos(LAT) * (lon - WALL_AT) / 0.2) ** 2))
    assert np.min(above) > 0.0
