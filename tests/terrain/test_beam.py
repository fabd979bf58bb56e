"""A beam tells rays where to begin: nothing stands before that, and no answer changes."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.scenes import SPACING, local_ray

from jaxgeo import Dem, FirstHit, Geodetic, Ray
from jaxgeo.terrain import ConstantField, TangentGrid
from jaxgeo.terrain.search.beam import Beam, Spread

pytestmark = pytest.mark.costly

SIZE = 201  # posts on a side: 6 km
SPREAD = Spread(*jnp.array([2.0, 4e-3, 6.0]))  # arrays: one program serves every spread
MIDDLE = local_ray(-1000.0, -900.0, 2500.0, azimuth=45.0, elevation=-50.0)


def ground(tower: float = 0.0) -> Dem:
    """Rolling ground with bumps, and a tower of so many m under the last part of the approach."""
    row, col = np.mgrid[:SIZE, :SIZE]
    posts = 200.0 + 60.0 * np.sin(row / 17.0) * np.cos(col / 11.0) + np.random.default_rng(3).uniform(0, 15, row.shape)
    posts[89:94, 103:108] += tower
    centre = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    return Dem.from_array(posts, TangentGrid.centred(centre, spacing=(SPACING, SPACING), shape=posts.shape))


@eqx.filter_jit
def brackets(rays: Ray, rise: jax.Array, dem: Dem, search: FirstHit):
    return jax.vmap(lambda ray, rise: dem.with_field(ConstantField(rise)).bracket(ray, search))(rays, rise)


beam_about = eqx.filter_jit(Beam.about)


@pytest.fixture(scope="module")
def dem() -> Dem:
    return ground()


@pytest.fixture(scope="module")
def rays() -> tuple[Ray, np.ndarray]:
    """2100 rays and how far their ground is raised: most of them within the spread, some beyond it."""
    rng = np.random.default_rng(5)
    origin = np.asarray(MIDDLE.origin) + rng.normal(size=(2100, 3)) * 0.6
    direction = np.asarray(MIDDLE.direction) + rng.normal(size=(2100, 3)) * 1.4e-3
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Ray(jnp.asarray(origin), jnp.asarray(direction)), rng.normal(size=2100) * 2.5


def of_no_use(beam: Beam) -> Beam:
    """The beam that starts at the camera."""
    return eqx.tree_at(lambda b: b.start, beam, jnp.zeros_like(beam.start))


@pytest.fixture(scope="module")
def plain(dem, rays):
    """With a beam that starts at the camera: of one program with those of a beam that is of use."""
    return brackets(*rays, dem, FirstHit(of_no_use(beam_about(MIDDLE, jnp.asarray(2000.0), dem, SPREAD))))


@pytest.fixture(scope="module")
def beam(dem, rays, plain) -> Beam:
    return beam_about(MIDDLE, jnp.median(plain.near), dem, SPREAD)


@pytest.fixture(scope="module")
def held(beam, rays, dem) -> np.ndarray:
    directions, rises = rays
    return np.asarray(jax.vmap(lambda r, rise: beam.holds(r, dem.with_field(ConstantField(rise))))(directions, rises))


def test_no_answer_changes(dem, rays, plain, beam, held):
    found = brackets(*rays, dem, FirstHit(beam))
    assert 0.9 < held.mean() < 1.0
    np.testing.assert_array_equal(found.status, plain.status)
    np.testing.assert_array_equal(found.cell, plain.cell)
    np.testing.assert_allclose(found.near, plain.near, rtol=0.0, atol=1e-6)  # of a track; to be polished


@pytest.mark.slow
def test_one_that_is_of_no_use_changes_nothing_either(dem, rays, plain):
    found = brackets(*rays, dem, FirstHit())
    np.testing.assert_array_equal(found.status, plain.status)
    np.testing.assert_allclose(found.near, plain.near, rtol=0.0, atol=1e-6)


def test_nothing_stands_before_its_start(plain, beam, held):
    assert np.all(np.asarray(plain.near)[held] > beam.start)
    assert beam.start > 0.8 * float(jnp.median(plain.near))


def test_only_what_lies_within_is_held(beam, dem):
    def holds(away: float, turn: float, rise: float) -> bool:
        across = jnp.stack([-MIDDLE.direction[1], MIDDLE.direction[0], jnp.asarray(0.0)])
        across = across / jnp.linalg.norm(across)
        direction = MIDDLE.direction + turn * across
        ray = Ray(MIDDLE.origin + away * across, direction / jnp.linalg.norm(direction))
        return bool(beam.holds(ray, dem.with_field(ConstantField(rise))))

    assert holds(0.99 * SPREAD.origin, 0.99 * SPREAD.direction, 0.99 * SPREAD.rise)
    assert not holds(1.01 * SPREAD.origin, 0.0, 0.0)
    assert not holds(0.0, 1.01 * SPREAD.direction, 0.0)
    assert not holds(0.0, 0.0, 1.01 * SPREAD.rise)
    assert not holds(np.nan, 0.0, 0.0)


def test_it_starts_before_a_tower_that_some_rays_may_meet(plain, beam):
    before_tower = beam_about(MIDDLE, jnp.median(plain.near), ground(tower=400.0), SPREAD)
    assert 0.0 < before_tower.start < beam.start - 200.0


@pytest.mark.parametrize("what", ["beside the grid", "wider than the way to the ground"])
def test_where_nothing_is_known_to_be_clear_it_holds_nobody(plain, dem, what):
    outside = local_ray(-9000.0, -9000.0, 220.0, azimuth=45.0, elevation=-1.0)
    wide = SPREAD._replace(origin=jnp.full_like(SPREAD.origin, 4000.0))
    middle, spread = (outside, SPREAD) if what == "beside the grid" else (MIDDLE, wide)
    reach = jnp.median(plain.near)
    found = beam_about(middle, jnp.full_like(reach, 9500.0) if middle is outside else reach, dem, spread)
    assert found.start == 0.0
    assert not found.holds(middle, dem)


def test_its_map_is_true_within_its_box(beam, dem):
    """Along rays of the beam, to the error that it names; the exact map is the oracle."""
    rng = np.random.default_rng(9)

    @jax.jit
    def missed(turn, share):
        direction = MIDDLE.direction + turn
        ray = Ray(MIDDLE.origin, direction / jnp.linalg.norm(direction))
        track, _ = beam.track(ray, jnp.asarray(0.0))
        rowcol, height = dem.over(ray.at(track.range_at(share)))
        row, col, above = track.at(share)
        return jnp.stack([SPACING * (row - rowcol[0]), SPACING * (col - rowcol[1]), above - height])

    turns, shares = rng.uniform(-2e-3, 2e-3, (200, 3)), rng.uniform(-1.0, 1.0, 200)
    worst = float(jnp.max(jnp.abs(jax.vmap(missed)(jnp.asarray(turns), jnp.asarray(shares)))))
    assert worst <= float(beam.map.error) < 1e-6


def test_nothing_is_before_what_each_of_its_rays_is_told(rays, plain, beam, held):
    """Where the bin that it is of says that it may begin lies before its hit, and for most not by much."""
    track, clear_to = jax.vmap(beam.track)(rays[0], jnp.asarray(rays[1]))
    begins = np.asarray(track.middle + track.half * clear_to)[held]
    met = np.asarray(plain.near)[held]
    assert np.all(begins < met)
    ahead = np.asarray(track.middle - track.half)[held]
    assert np.median((met - begins) / (met - ahead)) < 0.5


@pytest.mark.parametrize("elevation", [-89.99, -30.0])
@pytest.mark.parametrize("spread", [Spread(1e-3, 2e-2, 1e-3), Spread(60.0, 1e-3, 20.0)])
def test_it_may_be_wide_or_point_straight_down(dem, elevation, spread):
    """Rays all over the spread, some at its very edge, and some whose ground is lowered by more than it may rise."""
    middle = local_ray(-300.0, -200.0, 2500.0, azimuth=45.0, elevation=elevation)
    rng = np.random.default_rng(11)
    away, turn = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in rng.normal(size=(2, 2100, 3)))
    far = rng.uniform(0.0, 1.0, (2100, 1)) ** 0.2
    origin = np.asarray(middle.origin) + 0.999 * spread.origin * far * away
    direction = np.asarray(middle.direction) + 0.9 * spread.direction * rng.permutation(far) * turn
    rise = rng.uniform(-5.0, 0.999, 2100) * spread.rise
    rays = Ray(jnp.asarray(origin), jnp.asarray(direction / np.linalg.norm(direction, axis=1, keepdims=True)))
    spread = Spread(*jnp.array(spread))
    plain = brackets(rays, rise, dem, FirstHit(of_no_use(beam_about(middle, jnp.asarray(2000.0), dem, spread))))
    beam = beam_about(middle, jnp.median(plain.near), dem, spread)
    found = brackets(rays, rise, dem, FirstHit(beam))
    np.testing.assert_array_equal(found.status, plain.status)
    np.testing.assert_allclose(found.near, plain.near, rtol=0.0, atol=1e-6)
    assert beam.start > 0.0
    assert np.all(jax.vmap(lambda r, h: beam.holds(r, dem.with_field(ConstantField(h))))(rays, jnp.asarray(rise)))
