"""Errors of an elevation model from a better one or from check points: fields that were drawn are found again."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo.earth import WGS84
from jaxgeo.studies.scenes import tangent_dem
from jaxgeo.terrain.grid import surface_point
from jaxgeo.uncertainty import HeightErrors, height_errors
from jaxgeo.uncertainty._height_errors import nmad

SIZE, SPACING = 256, 20.0
TURN = 2.0 * np.pi * np.arange(SIZE) / SIZE
# Waves that are long against the posts: facets have the slope of the surface.
GROUND = 400.0 + 120.0 * np.sin(2.0 * TURN)[:, None] + 120.0 * np.cos(3.0 * TURN)[None, :]
GENTLE = np.hypot(*np.gradient(GROUND, SPACING))


@functools.cache
def drawn(kind: str, length: float, seed: int) -> np.ndarray:
    """A periodic Gaussian field (SIZE, SIZE) of unit variance with this covariance, by its spectrum."""
    away = np.minimum(np.arange(SIZE), SIZE - np.arange(SIZE)) * SPACING
    ratio = np.hypot(away[:, None], away[None, :]) / length
    cov = np.exp(-(ratio**2)) if kind == "gaussian" else np.where(ratio < 1.0, 1.0 - 1.5 * ratio + 0.5 * ratio**3, 0.0)
    spectrum = np.maximum(np.fft.fft2(cov).real, 0.0)
    noise = np.random.default_rng(seed).standard_normal((SIZE, SIZE))
    return np.fft.ifft2(np.sqrt(spectrum) * np.fft.fft2(noise)).real


def compared(errors: np.ndarray, **options: int) -> HeightErrors:
    return height_errors(tangent_dem(GROUND + errors, SPACING), tangent_dem(GROUND, SPACING), **options)


@functools.cache
def found() -> HeightErrors:
    return compared(1.5 + 3.0 * drawn("spherical", 400.0, 1))


@pytest.mark.parametrize(
    "kind, length, seed", [("spherical", 400.0, 1), ("spherical", 300.0, 2), ("gaussian", 200.0, 0)]
)
def test_a_field_that_was_drawn_is_found_again(kind: str, length: float, seed: int) -> None:
    errors = 1.5 + 3.0 * drawn(kind, length, seed)
    one = compared(errors)
    assert one.bias == pytest.approx(np.median(errors), abs=0.1)
    assert one.nmad == pytest.approx(nmad(errors.ravel()), rel=0.03)
    assert one.level == pytest.approx(errors.std(), rel=0.06)
    assert one.steep < 0.1 * one.level
    parts = getattr(one, kind)
    assert sum(share for share, _ in parts) > 0.9
    assert max(parts)[1] == pytest.approx(length, rel=0.15)
    assert one.missing <= len(one.errors) / 50  # at most those of the last row and column


def test_errors_that_have_nothing_in_common_have_a_level_variogram() -> None:
    one = compared(2.0 * np.random.default_rng(0).standard_normal((SIZE, SIZE)))
    np.testing.assert_allclose(one.variogram.semivariance, 1.0, rtol=0.15)  # four standard deviations of 5000 pairs
    assert np.mean(one.variogram.semivariance) == pytest.approx(1.0, rel=0.05)
    assert sum(length <= 2.0 * SPACING for _, length in (*one.gaussian, *one.spherical)) >= 1
    assert one.sigma_at(0.0) == pytest.approx(2.0, rel=0.03)


def test_figures_follow_the_scale_and_the_bias_of_errors() -> None:
    one, other = found(), compared(5.0 - 2.0 * (1.5 + 3.0 * drawn("spherical", 400.0, 1)))
    assert other.bias == pytest.approx(5.0 - 2.0 * one.bias, abs=1e-6)
    np.testing.assert_allclose((other.level, other.nmad), (2.0 * one.level, 2.0 * one.nmad), rtol=1e-6)
    np.testing.assert_allclose(other.variogram.semivariance, one.variogram.semivariance, rtol=1e-6)
    np.testing.assert_allclose(np.array(other.spherical), np.array(one.spherical), rtol=1e-4)


def test_a_spread_that_grows_with_the_slope_is_found() -> None:
    one = compared(np.hypot(1.0, 6.0 * GENTLE) * drawn("spherical", 300.0, 5))
    assert one.level == pytest.approx(1.0, rel=0.15)
    assert one.steep == pytest.approx(6.0, rel=0.15)
    assert one.sigma_at(np.arctan(0.5)) == pytest.approx(np.hypot(one.level, 0.5 * one.steep))
    assert np.all(np.diff(one.sigma_at(np.radians([0.0, 20.0, 45.0, 80.0]))) > 0.0)
    assert one.sigma_at(np.radians(85.0)) == one.sigma_at(np.radians(80.0))


@pytest.mark.costly
def test_check_points_tell_what_the_posts_do() -> None:
    true = tangent_dem(GROUND, SPACING)
    rowcol = jnp.asarray(np.random.default_rng(3).uniform(2.0, SIZE - 3.0, (900, 2)))
    position = jax.vmap(lambda at: WGS84.to_geodetic(surface_point(true.grid.normal(at))))(rowcol)
    points = jaxgeo.Geodetic(lat=position.lat, lon=position.lon, height=jax.vmap(true.height_at)(position))
    one = height_errors(tangent_dem(GROUND + 1.5 + 3.0 * drawn("spherical", 400.0, 1), SPACING), points)
    assert (len(one.errors), one.missing) == (900, 0)
    assert one.bias == pytest.approx(found().bias, abs=0.5)
    assert one.nmad == pytest.approx(found().nmad, rel=0.15)
    assert max((*one.gaussian, *one.spherical))[1] == pytest.approx(400.0, rel=0.4)


def test_the_source_has_the_variance_and_the_covariance_that_were_found() -> None:
    one = found()
    for slope in (None, 0.0, 0.4):
        field = one.field(slope)
        sigma = np.sqrt(np.mean(one.sigma_at(one.slope) ** 2)) if slope is None else one.sigma_at(slope)
        assert float(field.variance_at(jnp.asarray(0.0))) == pytest.approx(float(sigma) ** 2, rel=1e-12)
    distance = one.variogram.distance[one.variogram.distance < 400.0]
    semivariance = 1.0 - np.asarray(one.field(0.0).variance_at(jnp.asarray(distance))) / one.level**2
    np.testing.assert_allclose(semivariance, one.variogram.semivariance[: len(distance)], atol=0.1)
    assert one.field(nodes=9).nodes == 9
    assert str(one).startswith(f"{len(one.errors)} heights")
    assert f"bias {one.bias:.3g} m" in str(one)


def test_what_cannot_be_compared_is_refused() -> None:
    true = tangent_dem(GROUND, SPACING)
    with pytest.raises(TypeError, match=r"read_dem"):
        height_errors(GROUND, true)  # pyright: ignore
    with pytest.raises(TypeError, match=r"a Dem, or check points as a Geodetic; got ndarray"):
        height_errors(true, GROUND)  # pyright: ignore
    with pytest.raises(ValueError, match="30 heights or more; got 3"):
        height_errors(true, true, count=3)
    with pytest.raises(ValueError, match="the two hold the same heights"):
        height_errors(true, true)
    far = jaxgeo.Geodetic(lat=jnp.full(50, 0.1), lon=jnp.full(50, 0.2), height=jnp.zeros(50))
    with pytest.raises(ValueError, match=r"0 of 50 heights are known in both; 30 are needed"):
        height_errors(true, far)
