"""Lines of sight through the air over terrain: first hits of bent rays, round trips, and what refraction changes."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.fractal import fractal_posts

import jaxgeo
from jaxgeo import Atmosphere, Bisection, Dem, FrameCamera, Geodetic, Gimbal, Mount, Pose, Ray, Sensor, Shot, Status
from jaxgeo._arguments import checked_air
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.terrain import HeightFunction, TangentGrid

SIZE, SPACING = 257, 60.0
CENTRE = Geodetic(lat=0.8, lon=0.15, height=0.0)
AIR = Atmosphere.measured(pressure=93_000.0, temperature=281.0, height=700.0, sea_level=48.0)
RAYS, SAMPLES = 96, 4000


@pytest.fixture(scope="module")
def mountains() -> Dem:
    posts = fractal_posts(SIZE, spacing=SPACING, relief=1800.0, exponent=3.2, seed=11)
    return Dem.from_array(posts, TangentGrid.centred(CENTRE, spacing=(SPACING, SPACING), shape=posts.shape))


@pytest.fixture(scope="module")
def rays() -> Ray:
    """Towards points over the middle of the terrain, from 12 or 6 km above and 25 to 60 km away; half of them a fan."""
    rng = np.random.default_rng(5)
    R, centre = np.asarray(R_ecef_from_enu(CENTRE)), np.asarray(WGS84.to_ecef(CENTRE))
    azimuth, away = rng.uniform(0.0, 2.0 * np.pi, RAYS), rng.uniform(25e3, 60e3, RAYS)
    target = np.stack([*rng.uniform(-4e3, 4e3, (2, RAYS)), rng.uniform(300.0, 1500.0, RAYS)], axis=1)
    fan = RAYS // 2
    azimuth[fan:], away[fan:], target[fan:, :2] = 2.0, 60e3, 0.0
    height = np.where(np.arange(RAYS) < fan, 12e3, 6e3)
    target[fan:, 2] = np.linspace(300.0, 1500.0, fan)
    eye = np.stack([away * np.sin(azimuth), away * np.cos(azimuth), height - away**2 / 12.76e6], axis=1)
    direction = target - eye
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Ray(jnp.asarray(centre + eye @ R.T), jnp.asarray(direction @ R.T))


@pytest.fixture(scope="module")
def fixes(mountains, rays):
    """Through air so thin that nothing bends, which no other program has to be compiled for, and through air."""

    @jax.jit
    def hit(rays, air, dem):
        return jax.vmap(lambda ray: jaxgeo.intersect(ray, dem, atmosphere=air))(rays)

    return [hit(rays, air, mountains) for air in (eqx.tree_at(lambda a: a.sea_level_pressure, AIR, 1e-6), AIR)]


@pytest.mark.slow
def test_a_bent_ray_meets_the_first_ground_on_its_bent_way(mountains, rays, fixes):
    _, bent = fixes
    met = np.asarray(bent.found)
    assert np.mean(met) > 0.9

    def clearances(ray, reach, dem):
        """Above the ground along the bent ray up to a range, at the nearest points of the grid."""
        bent = ray.through(AIR)

        def one(distance):
            rowcol, height = dem.over(bent.at(distance))
            cell = dem.cell_of(rowcol)
            return jnp.where(dem.contains(rowcol), height - dem.surface(rowcol, cell), jnp.inf)

        return jax.vmap(one)(jnp.linspace(0.7, 1.0, SAMPLES) * reach)

    seeming = jax.vmap(lambda ray, p: jnp.dot(p - ray.origin, ray.direction))(rays, bent.ecef)
    above = np.asarray(jax.jit(jax.vmap(clearances, (0, 0, None)))(rays, seeming, mountains))[met]
    assert np.max(np.abs(above[:, -1])) < 1e-6
    assert np.min(above[:, :-1]) > 0.0


@pytest.mark.slow
def test_refraction_brings_the_hit_nearer_and_may_choose_another_hill(fixes):
    straight, bent = fixes
    both = np.asarray(straight.found & bent.found)
    nearer = np.asarray(straight.slant_range - bent.slant_range)[both]
    assert np.all(nearer > -1e-6)
    assert np.sum(nearer > 1000.0) >= 1  # beyond any shift on the same slope
    assert 1.0 < np.median(nearer) < 100.0


@pytest.mark.slow
def test_bisection_lies_on_the_bent_ray_too(mountains, rays, fixes):
    def bisected(ray, dem):
        return jaxgeo.intersect(ray, dem, atmosphere=AIR, search=Bisection())

    some = jax.tree.map(lambda x: x[:16], rays)
    found = jax.jit(jax.vmap(bisected, (0, None)))(some, mountains)
    same = np.abs(np.asarray(found.slant_range) - np.asarray(fixes[1].slant_range)[:16]) < 1e-5
    assert np.mean(same) > 0.6


def a_view() -> tuple[Sensor, Shot]:
    camera = FrameCamera.from_pixels(focal_px=20_000.0, width=4000, height=3000)

    sensor = Sensor(camera, Gimbal.fixed(), Mount.forward())
    pose = Pose.from_degrees(lat=45.5, lon=8.594367, height=11_000.0, heading=0.0, pitch=-13.5, roll=2.0)
    return sensor, Shot(pose)


def waves(position):
    """Hills of 200 m across the look, which no line of sight from 11 km passes twice."""
    return 300.0 + 100.0 * jnp.sin(8e3 * (position.lat + 0.3 * position.lon))


WAVES = HeightFunction(waves, 200.0, 400.0, lipschitz=0.14)


@pytest.mark.costly
@pytest.mark.parametrize(
    "terrain", [*(pytest.param(x, marks=pytest.mark.slow) for x in ("mountains", "waves")), "constant"]
)
def test_pixel_to_ground_to_pixel(terrain, mountains):
    sensor, shot = a_view()
    ground = {"mountains": mountains, "waves": WAVES, "constant": jaxgeo.ConstantHeight(300.0)}[terrain]
    uv = np.random.default_rng(1).uniform([1000.0, 1200.0], [3000.0, 1800.0], (24, 2))

    def there_and_back(uv, ground):
        fix = jaxgeo.locate(sensor, shot, uv, ground, atmosphere=AIR)
        seen = jaxgeo.project(sensor, shot, fix.position, terrain=ground, atmosphere=AIR)
        measured = jaxgeo.at_range(sensor, shot, uv, fix.slant_range, atmosphere=AIR)
        straight = jaxgeo.project(sensor, shot, fix.position)
        return fix, seen, measured, straight

    each = [there_and_back(pixel, ground) for pixel in uv]
    fix, seen, measured, straight = jax.tree.map(lambda *leaves: np.stack(leaves), *each)
    ok = np.asarray(fix.ok)
    assert np.mean(ok) > 0.9
    assert np.all(np.asarray(seen.status)[ok] == Status.hit)
    np.testing.assert_allclose(np.asarray(seen.uv)[ok], np.asarray(uv)[ok], rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.asarray(measured.ecef)[ok], np.asarray(fix.ecef)[ok], rtol=0, atol=1e-7)
    raised = np.asarray(straight.uv - uv)[ok, 1]
    assert np.all((raised > 1.0) & (raised < 20.0))  # px, down the image: without air it would be seen lower


@pytest.mark.slow
def test_derivatives_by_the_air_and_the_pose_over_terrain(mountains, rays, fixes):
    _, bent = fixes
    steady = int(np.argmin(np.where(np.asarray(bent.ok), np.asarray(bent.incidence_surface), np.inf)))
    ray = jax.tree.map(lambda x: x[steady], rays)

    def hit(x, dem):
        air = Atmosphere(temperature_offset=x[0], sea_level_pressure=1e3 * x[1], sea_level=48.0)
        return jaxgeo.intersect(Ray(ray.origin + x[2:5], ray.direction), dem, atmosphere=air).ecef

    x = jnp.array([1.0, 100.0, 0.0, 0.0, 0.0])
    J = np.asarray(jax.jit(jax.jacfwd(hit))(x, mountains))
    np.testing.assert_allclose(np.asarray(jax.jit(jax.jacrev(hit))(x, mountains)), J, rtol=0, atol=1e-9)
    run = jax.jit(hit)
    for k, step in enumerate([1.0, 1.0, 0.05, 0.05, 0.05]):
        move = np.eye(5)[k] * step
        near = run(x + move, mountains) - run(x - move, mountains)
        far = run(x + 2 * move, mountains) - run(x - 2 * move, mountains)
        np.testing.assert_allclose(J[:, k] * step, (8 * near - far) / 12, rtol=0, atol=1e-6)
    assert np.all(np.linalg.norm(J, axis=0) > 1e-3)


@pytest.mark.slow
def test_air_that_is_not_finite_is_told_and_poisons_no_gradient():
    sensor, shot = a_view()

    def mean_height(pressure):
        airs = Atmosphere(sea_level_pressure=pressure)
        locate = lambda air: jaxgeo.locate(sensor, shot, (2000.0, 1500.0), jaxgeo.ConstantHeight(0.0), atmosphere=air)  # noqa: E731
        fix = jax.vmap(lambda p: locate(Atmosphere(sea_level_pressure=p)))(airs.sea_level_pressure)
        return jnp.sum(jnp.where(fix.ok, fix.ecef[:, 0], 0.0)), fix.status

    gradient, status = jax.jit(jax.grad(mean_height, has_aux=True))(jnp.array([1e5, jnp.nan, 1.1e5]))
    assert [Status(int(s)) for s in status] == [Status.hit, Status.invalid_input, Status.hit]
    assert np.all(np.isfinite(gradient))
    assert float(gradient[1]) == 0.0


@pytest.mark.costly
def test_beyond_the_straight_horizon_the_bent_ray_still_comes_down():
    """And a little higher not even that one does."""
    origin = jnp.array([WGS84.a + 10_000.0, 0.0, 0.0])
    dip = np.arccos(WGS84.a / (WGS84.a + 10_000.0))

    def status(elevation, air):
        ray = Ray(origin, jnp.array([jnp.sin(elevation), jnp.cos(elevation), 0.0]))
        return jaxgeo.intersect(ray, jaxgeo.ConstantHeight(0.0), atmosphere=air).status

    lower, upper = -dip + 1e-3, -dip + 8e-3
    assert int(status(lower, None)) == Status.rises_away
    assert int(status(lower, Atmosphere())) == Status.hit
    assert int(status(upper, Atmosphere())) == Status.rises_away


def test_what_is_no_atmosphere_is_refused():
    sensor, shot = a_view()
    with pytest.raises(TypeError, match=r"Atmosphere\.measured"):
        checked_air(288.15)
    with pytest.raises(TypeError, match="float32"):
        jaxgeo.locate(sensor, shot, (0.0, 0.0), jaxgeo.ConstantHeight(0.0), atmosphere=Atmosphere(np.float32(3.0)))
