"""Terrain height errors averaged over the blocks of ties, against fields sampled with NumPy."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import locate
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.register import TieErrors, TiePoints, update_orientation
from jaxgeo.register.block_means import covariances_of_means, variances_of_means
from jaxgeo.register.comparison import sides_on_ground
from jaxgeo.terrain import ConstantHeight
from jaxgeo.uncertainty import ErrorModel, sources
from jaxgeo.uncertainty.sources import TerrainField
from tests.support import looks

PLACE = Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0)
AXES = np.asarray(R_ecef_from_enu(PLACE))
SIGMA = 3.0
# Parallelograms of 800 by 500 m, as those of an oblique image, and a square
SIDES = np.array([[[800.0, 100.0], [0.0, 500.0]], [[640.0, -200.0], [480.0, 400.0]], [[500.0, 0.0], [0.0, 500.0]]])
CENTRES = np.array([[-500.0, 200.0], [300.0, -150.0], [450.0, 600.0]])


def gaussian(length: float) -> TerrainField:
    return TerrainField.of_variograms(gaussian=[(SIGMA, length)])


def spherical(length: float) -> TerrainField:
    return TerrainField.of_variograms(spherical=[(SIGMA, length)])


def square(side: float) -> np.ndarray:
    return side * np.eye(2)[None]


def covariances(field: TerrainField, centres: np.ndarray, sides: np.ndarray) -> np.ndarray:
    p_ecef = np.asarray(WGS84.to_ecef(PLACE)) + centres @ AXES[:, :2].T
    return np.asarray(covariances_of_means(field, jnp.asarray(p_ecef), jnp.asarray(AXES[:, :2] @ sides)))


def of_uniform_blocks(field: TerrainField, centres: np.ndarray, sides: np.ndarray, steps: int = 24) -> np.ndarray:
    """The double sum over the points of a fine lattice in each block, without the library's windows."""
    t = (np.arange(steps) + 0.5) / steps - 0.5
    lattice = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    points = centres[:, None, :] + np.einsum("nij,kj->nki", sides, lattice)
    result = np.zeros((len(centres), len(centres)))
    for i, here in enumerate(points):
        for j, there in enumerate(points):
            away = np.linalg.norm(here[:, None, :] - there[None], axis=2)
            result[i, j] = np.mean(np.asarray(field.variance_at(jnp.asarray(away))))
    return result


@pytest.mark.parametrize("length", [200.0, 400.0, 1000.0, 3000.0])
def test_means_over_parallelograms_are_those_of_a_fine_lattice(length: float) -> None:
    field = gaussian(length)
    found, expected = covariances(field, CENTRES, SIDES), of_uniform_blocks(field, CENTRES, SIDES)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.005 * SIGMA**2)
    np.testing.assert_allclose(np.diagonal(found), np.diagonal(expected), rtol=0.06)
    np.testing.assert_allclose(variances_of_means(field, jnp.asarray(SIDES)), np.diagonal(found), rtol=1e-7)


@pytest.mark.parametrize("length", [400.0, 1000.0, 3000.0])
def test_means_of_a_spherical_variogram(length: float) -> None:
    field = spherical(length)
    found, expected = covariances(field, CENTRES, SIDES), of_uniform_blocks(field, CENTRES, SIDES)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=0.025 * SIGMA**2)


@pytest.mark.parametrize("made", [gaussian, spherical])
def test_a_field_much_longer_than_the_block_counts_whole(made) -> None:
    assert float(variances_of_means(made(1e6), jnp.asarray(square(300.0)))[0]) == pytest.approx(SIGMA**2, rel=5e-3)


@pytest.mark.parametrize("made, area", [(gaussian, np.pi), (spherical, 0.2 * np.pi)])
def test_a_field_much_shorter_than_the_block_counts_by_its_integral(made, area: float) -> None:
    """The integral of the covariance over the plane is pi a^2 s^2 (Gaussian), and a fifth of it (spherical)."""
    length, side = 2.0, 1000.0
    found = float(variances_of_means(made(length), jnp.asarray(square(side)))[0])
    assert found == pytest.approx(area * length**2 * SIGMA**2 / side**2, rel=0.05)


def test_white_noise_of_posts_averages_by_their_number() -> None:
    """A Gaussian variogram of h / sqrt(pi) against the means of independent posts, 20 by 30 of them 10 m apart."""
    spacing, counts = 10.0, (20, 30)
    sides = np.diag([counts[0] * spacing, counts[1] * spacing])[None]
    found = float(variances_of_means(gaussian(spacing / np.sqrt(np.pi)), jnp.asarray(sides))[0])
    sampled = np.random.default_rng(3).normal(0.0, SIGMA, (4000, *counts)).mean(axis=(1, 2)).var()
    assert found == pytest.approx(sampled, rel=0.1)  # 4000 draws: 2.2 % in a variance, times four


@pytest.mark.parametrize("length", [60.0, 200.0, 600.0])
def test_means_are_those_of_sampled_fields(length: float) -> None:
    """Fields with a Gaussian variogram, made by smoothing white noise, averaged over four squares of 300 m."""
    cell, block, shape = 20.0, 15, (512, 512)
    frequency = [2.0 * np.pi * np.fft.fftfreq(n, cell) for n in shape]
    power = np.exp(-0.25 * length**2 * (frequency[0][:, None] ** 2 + frequency[1][None] ** 2))  # of exp(-(d/a)^2)
    root = np.sqrt(power / power.mean())
    rng, means = np.random.default_rng(7), []
    for _ in range(40):
        field = SIGMA * np.fft.ifft2(np.fft.fft2(rng.normal(size=shape)) * root).real
        cut = field[: shape[0] // block * block, : shape[1] // block * block]
        blocks = cut.reshape(shape[0] // block, block, -1, block).mean(axis=(1, 3))
        four = [blocks[:-1, :-1], blocks[:-1, 1:], blocks[1:, :-1], blocks[1:, 1:]]
        means.append(np.stack([one.ravel() for one in four]))
    samples = np.concatenate(means, axis=1)
    sampled = samples @ samples.T / samples.shape[1]
    side = block * cell
    centres = side * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0], [1.0, -1.0]])
    found = covariances(gaussian(length), centres, np.repeat(square(side), 4, axis=0))
    np.testing.assert_allclose(found, sampled, rtol=0.0, atol=0.06 * sampled[0, 0] + 0.004 * SIGMA**2)


@pytest.mark.parametrize("made", [gaussian, spherical])
@pytest.mark.parametrize("length", [1.0, 50.0, 500.0, 5e4])
def test_covariances_are_positive_semi_definite(made, length: float) -> None:
    """Also of blocks that overlap, of different sizes, one of them twice."""
    rng = np.random.default_rng(5)
    sides = rng.uniform(10.0, 900.0, (25, 1, 1)) * (np.eye(2) + 0.4 * rng.normal(size=(25, 2, 2)))
    centres = rng.uniform(-1500.0, 1500.0, (25, 2))
    sides[-1], centres[-1] = sides[0], centres[0]
    found = covariances(made(length), centres, sides)
    np.testing.assert_allclose(found, found.T, rtol=0.0, atol=1e-9)
    assert np.linalg.eigvalsh(found).min() > -1e-10 * SIGMA**2 * len(found)


GROUND = ConstantHeight(jnp.asarray(0.0))
FIRM = ErrorModel((sources.Position.from_ned(north=30.0, east=30.0, down=30.0),))


@jax.jit
def places_of(uv: jax.Array) -> tuple[jax.Array, jax.Array]:
    def one(pixel: jax.Array) -> tuple[jax.Array, jax.Array]:
        there = WGS84.to_geodetic(locate(looks.sensor(), looks.shot(), pixel, GROUND).ecef)
        return jnp.asarray(there.lat), jnp.asarray(there.lon)

    return jax.vmap(one)(uv)


def updated(length: float, side: float | None) -> float:
    """Standard deviation in m of the position after an update by four ties, of heights that err over a length."""
    uv = jnp.asarray([[300.0, 300.0], [900.0, 300.0], [300.0, 800.0], [900.0, 800.0]])
    lat, lon = places_of(uv)
    ties = TiePoints(uv, Geodetic(lat=lat, lon=lon, height=jnp.zeros(4)), jnp.zeros((4, 2, 2)))
    if side is not None:
        ties = dataclasses.replace(ties, sides=np.repeat(square(side), 4, axis=0))
    errors = TieErrors(registration=0.1, terrain_field=gaussian(length))
    found = update_orientation(looks.sensor(), looks.shot(), ties, GROUND, FIRM, errors)
    assert bool(found.ok)
    return float(np.sqrt(np.trace(np.asarray(found.cov_residuals[0]))))


@pytest.mark.slow
def test_an_update_averages_the_field_over_the_blocks_of_its_ties() -> None:
    of_points, of_long, of_short = updated(100.0, None), updated(1e7, 200.0), updated(100.0, 200.0)
    assert of_long == pytest.approx(of_points, rel=1e-3)
    share = np.sqrt(of_uniform_blocks(gaussian(100.0), np.zeros((1, 2)), square(200.0), 60)[0, 0]) / SIGMA
    assert of_short == pytest.approx(share * of_points, rel=0.03)


def test_sides_of_another_shape_are_refused() -> None:
    ties = TiePoints(
        np.zeros((2, 2)), jax.tree.map(lambda x: np.zeros(2), PLACE), np.tile(np.eye(2), (2, 1, 1)), sides=np.eye(2)
    )
    with pytest.raises(ValueError, match=r"ties.sides must have the shape \(2, 2, 2\); got \(2, 2\)"):
        update_orientation(looks.sensor(), looks.shot(), ties, GROUND, FIRM, TieErrors(registration=1.0))


def test_sides_of_blocks_of_a_map_to_the_north() -> None:
    """Cells of 2 m, rows to the south and columns to the east: 30 rows are 60 m to the south, 20 columns 40 m east."""
    cells_per_metre = np.array([[[0.0, -0.5], [0.5, 0.0]]])
    np.testing.assert_allclose(sides_on_ground((30, 20), cells_per_metre)[0], [[0.0, 40.0], [-60.0, 0.0]], atol=1e-12)
