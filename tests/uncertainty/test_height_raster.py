"""Terrain height errors from a raster of standard deviations: the value at the fix, and none where it is unknown.

Held against: bilinear interpolation by SciPy, and `TerrainHeight` with the same value.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage

import jaxgeo
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.terrain import TangentGrid
from jaxgeo.uncertainty import ErrorModel, PerMeasurement, budget, joint_covariance, sample, sources
from jaxgeo.uncertainty.distributions import Laplace
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import Occasion
from jaxgeo.uncertainty.sources.height_raster import RasterField, sigma_at
from tests.support import looks

SHAPE = 31, 21
SCENE = looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL
ATTITUDE = sources.Attitude.from_degrees(heading=0.05, pitch=0.02, roll=0.03)


@pytest.fixture(scope="module")
def grid() -> TangentGrid:
    """Posts 50 m and 80 m apart about the fix, turned by 30 deg."""
    fix = jax.jit(jaxgeo.locate)(*SCENE)
    return TangentGrid.centred(fix.position, spacing=(50.0, 80.0), shape=SHAPE, heading=0.5)


@pytest.fixture(scope="module")
def posts() -> np.ndarray:
    return np.random.default_rng(1).uniform(1.0, 9.0, SHAPE)


def errors(height: sources.AbstractSource) -> ErrorModel:
    return ErrorModel((ATTITUDE, height))


def test_values_are_bilinear_between_posts(grid: TangentGrid, posts: np.ndarray) -> None:
    places = np.random.default_rng(2).uniform(-0.5, np.array(SHAPE) - 0.5, (400, 2))
    posts = np.where(np.random.default_rng(3).random(SHAPE) < 0.05, np.nan, posts)

    def at(rowcol: jax.Array) -> jax.Array:
        x, y, z = grid.normal(rowcol)
        p_ecef = WGS84.to_ecef(Geodetic(lat=jnp.arcsin(z), lon=jnp.arctan2(y, x), height=jnp.asarray(500.0)))
        return jnp.stack([sigma_at(jnp.asarray(posts), grid, p_ecef), *grid.rowcol(WGS84.normal_and_height(p_ecef)[0])])

    found, *rowcol = np.asarray(jax.jit(jax.vmap(at))(jnp.asarray(places))).T
    wanted = scipy.ndimage.map_coordinates(posts, rowcol, order=1, mode="constant", cval=np.nan)
    place = np.array(rowcol)
    outside = ((place < 0.0) | (place > np.array([SHAPE]).T - 1.0)).any(axis=0)
    corners = np.floor(rowcol).astype(int)
    four = [
        posts[tuple(np.clip(corners + np.array([[i], [j]]), 0, np.array([SHAPE]).T - 1))]
        for i in (0, 1)
        for j in (0, 1)
    ]
    unknown = outside | np.isnan(four).any(axis=0)
    assert 20 < unknown.sum() < 200
    np.testing.assert_array_equal(np.isnan(found), unknown)
    np.testing.assert_allclose(found[~unknown], wanted[~unknown], rtol=1e-12)


@pytest.fixture(scope="module")
def constant(grid: TangentGrid) -> ErrorModel:
    return errors(sources.TerrainHeightRaster.from_array(np.full(SHAPE, 3.7), grid))


@pytest.mark.costly
def test_a_constant_raster_is_a_terrain_height(constant: ErrorModel) -> None:
    """To the bit: in propagation, budgets and samples."""
    plain = errors(sources.TerrainHeight.from_metres(3.7))
    ours, theirs = (jaxgeo.propagate(*SCENE, model) for model in (constant, plain))
    np.testing.assert_array_equal(ours.cov_enu, theirs.cov_enu)
    assert str(budget(ours)) == str(budget(theirs))
    assert "terrain height: height" in str(budget(ours))
    drawn = [sample(*SCENE, model, count=64, keep=True).errors_enu for model in (constant, plain)]
    np.testing.assert_array_equal(drawn[0], drawn[1])


def test_twice_the_raster_is_twice_the_error(grid: TangentGrid, posts: np.ndarray) -> None:
    one, two, scaled = (
        jaxgeo.propagate(*SCENE, (sources.TerrainHeightRaster.from_array(times * posts, grid, scale=scale),))
        for times, scale in ((1.0, 1.0), (2.0, 1.0), (1.0, 2.0))
    )
    value = posts[SHAPE[0] // 2, SHAPE[1] // 2]  # the fix is on the middle post
    assert float(np.sqrt(one.cov_enu[2, 2])) == pytest.approx(value, rel=1e-3)
    np.testing.assert_allclose(np.asarray(one.model.sources[0].sigma), [value], rtol=1e-9)
    np.testing.assert_array_equal(two.cov_enu, 4.0 * one.cov_enu)
    np.testing.assert_array_equal(scaled.cov_enu, two.cov_enu)


def test_where_it_is_unknown_functions_of_one_fix_say_so(grid: TangentGrid, posts: np.ndarray) -> None:
    holed = posts.copy()
    holed[SHAPE[0] // 2, SHAPE[1] // 2] = np.nan
    model = errors(sources.TerrainHeightRaster.from_array(holed, grid))
    for function in (jaxgeo.propagate, jaxgeo.sample, jaxgeo.accuracy):
        with pytest.raises(ValueError, match=r"no standard deviation is known at the fix, 46\.9\d+ deg, 10\.9\d+ deg"):
            function(*SCENE, model)


@pytest.mark.slow
def test_where_it_is_unknown_figures_of_many_are_not_numbers(grid: TangentGrid, posts: np.ndarray) -> None:
    uv = np.array([looks.LEVEL_UV, (1300.0, 1500.0), (0.0, 0.0), (2399.0, 3199.0)])
    model = errors(sources.TerrainHeightRaster.from_array(posts[:, : SHAPE[1] // 2 + 2], grid))
    found = jaxgeo.accuracy(*SCENE[:2], uv, SCENE[3], model)
    values = np.array([float(jaxgeo.propagate(*SCENE[:2], uv[0], SCENE[3], model).circular_error(0.9))])
    assert float(found.circular[0]) == pytest.approx(values[0], rel=0.02)
    lost = ~np.isfinite(np.asarray(found.circular))
    assert lost.tolist() == [False, False, True, True]
    assert np.all(~np.isfinite(np.asarray(found.linear)[lost]))
    np.testing.assert_array_equal(np.asarray(found.failed)[lost], 1.0)
    traced = jax.jit(jaxgeo.propagate)(*SCENE[:2], uv[2], SCENE[3], model)
    assert np.isnan(np.asarray(traced.cov_enu)).all()


@pytest.mark.costly
def test_shared_errors_of_two_fixes_are_one_number_times_the_value_at_each(
    grid: TangentGrid, posts: np.ndarray
) -> None:
    pixels = looks.LEVEL_UV, (1250.0, 1650.0)
    for sharing, correlation in ((None, 1.0), (PerMeasurement(), 0.0)):
        options: dict[str, Any] = {} if sharing is None else {"sharing": sharing}
        source = sources.TerrainHeightRaster.from_array(posts, grid, **options)
        both = [jaxgeo.propagate(*SCENE[:2], uv, SCENE[3], (source,)) for uv in pixels]
        a, b = (float(one.model.sources[0].sigma[0]) for one in both)
        assert abs(a - b) > 0.5
        found = (
            both[0]
            .model.sources[0]
            .cross_covariance(
                both[1].model.sources[0],
                (Occasion(0, 0, 0, 0.0), Occasion(1, 1, 0, 0.0)),
            )
        )
        np.testing.assert_allclose(found, [[correlation * a * b]], rtol=1e-14)
        joint = np.asarray(joint_covariance(both).cov_ecef)
        np.testing.assert_allclose(np.trace(joint[:3, :3]), np.trace(both[0].cov_enu), rtol=1e-9)


def test_without_a_fix_it_raises_each_post_by_one_number_times_the_value_there(posts: np.ndarray) -> None:
    """On the posts of a terrain on the same grid by the values themselves, and not at all where they are unknown."""
    grid = TangentGrid.centred(Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0), spacing=(50.0, 80.0), shape=SHAPE)
    holed = np.where(np.arange(SHAPE[1]) > 15, np.nan, posts)
    source = sources.TerrainHeightRaster.from_array(holed, grid)
    field = RasterField(jnp.asarray(-1.5), source.posts, grid, grid)
    at = jax.jit(jax.vmap(jax.vmap(field.at, in_axes=(None, 0)), in_axes=(0, None)))
    found = np.asarray(at(jnp.arange(SHAPE[0], dtype=float), jnp.arange(SHAPE[1], dtype=float)))
    known = np.broadcast_to(np.arange(SHAPE[1]) <= 14, SHAPE)
    np.testing.assert_allclose(found[known], -1.5 * posts[known], rtol=1e-9)
    np.testing.assert_array_equal(found[:, 16:], 0.0)
    low, high = (float(x) for x in field.bounds())
    assert low == pytest.approx(-1.5 * np.nanmax(holed))
    assert high == 0.0
    exposure = jaxgeo.Exposure(SCENE[0], SCENE[1], jnp.zeros(()))
    with pytest.raises(
        TypeError, match=r"a raster of standard deviations raises the posts of a Dem; this terrain is a"
    ):
        source.moved(ModelInputs(exposure, jnp.zeros(2), looks.LEVEL), jnp.ones(1))


def test_a_distribution_is_kept(grid: TangentGrid, posts: np.ndarray) -> None:
    source = sources.TerrainHeightRaster.from_array(posts, grid, distribution=Laplace())
    (found,) = jaxgeo.propagate(*SCENE, (source,)).model.sources
    assert found.shapes == (Laplace(),)


@pytest.mark.parametrize(
    "posts, message",
    [
        (np.ones(4), r"\(rows, cols\), 2 x 2 or more; got shape \(4,\)"),
        (np.ones((1, 4)), r"got shape \(1, 4\)"),
        (np.array([[1.0, 2.0], [-3.0, 1.0]]), "got -3.0 at row 1, column 0"),
        (np.array([[1.0, np.inf], [3.0, 1.0]]), "got inf at row 0, column 1"),
    ],
)
def test_what_is_no_standard_deviation_is_refused(grid: TangentGrid, posts: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sources.TerrainHeightRaster.from_array(posts, grid)
