"""The update of a navigation by tie points: its laws, Gu's formulas, and simulations of all that errs."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import ConstantHeight, Dem, Geodetic, Sensor, Shot, locate
from jaxgeo.adjust.losses import LeastSquares, Tukey
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.observation import Exposure
from jaxgeo.register import gu2017
from jaxgeo.register._equations import on_surface
from jaxgeo.register.orientation_update import update_orientation
from jaxgeo.register.prior import Prior
from jaxgeo.register.tie_errors import FullJacobian, LevelGround, TieErrors
from jaxgeo.register.ties import TiePoints
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.status import Status
from jaxgeo.uncertainty import ErrorModel, circular_error, gauss_helmert, propagate
from jaxgeo.uncertainty import sources as errors_of
from jaxgeo.uncertainty.model_inputs import ModelInputs
from tests.support import looks
from tests.support.scenes import flat, rough, small_dem

GROUND = ConstantHeight(500.0)
TIE_ERRORS = TieErrors(registration=3.0, terrain=5.0)
MIDDLE = gu2017.MIDDLE
SENSOR, SHOT = gu2017._camera(75.0, 10_000.0, 10.0)
UV = jnp.stack([x.reshape(-1) for x in jnp.meshgrid(jnp.linspace(100.0, 1900.0, 5), jnp.linspace(100.0, 1900.0, 4))], 1)
LOOK = ModelInputs(Exposure(SENSOR, SHOT, jnp.asarray(0.0)), jnp.asarray(MIDDLE), ConstantHeight(jnp.asarray(500.0)))


def navigation(position: float = 10.0, angle: float = 0.05) -> ErrorModel:
    """Three independent errors of the position, m, and three small rotations, deg."""
    rotation = errors_of.CameraMounting.from_degrees(forward=angle, right=angle, down=angle)
    return ErrorModel((errors_of.Position.from_ned(north=position, east=position, down=position), rotation))


@eqx.filter_jit
def seen_from(look: ModelInputs, uv: jax.Array, heights: jax.Array) -> Geodetic:
    """Places that pixels see, each on ground of its own height."""

    def place(uv: jax.Array, height: jax.Array) -> Geodetic:
        return locate(look.sensor, look.motion, uv, ConstantHeight(height)).position

    return jax.vmap(place)(uv, heights)


@eqx.filter_jit
def moved_by(model: ErrorModel, look: ModelInputs, error: jax.Array) -> ModelInputs:
    return model.moved(look, error)


@eqx.filter_jit
def moved_on_map(places: Geodetic, enu: jax.Array) -> Geodetic:
    """Places moved by m to the east and north, (n, 2)."""

    def one(place: Geodetic, en: jax.Array) -> Geodetic:
        return WGS84.to_geodetic(WGS84.to_ecef(place) + R_ecef_from_enu(place)[:, :2] @ en)

    return jax.vmap(one)(places, enu)


def ties_at(error: Any, *, model: ErrorModel | None = None, enu: Any = None, sigma: float = 0.0) -> TiePoints:
    """Ties of an image whose navigation errs by `error`; the map shows places `enu` from the true ones."""
    truth = moved_by(model or navigation(), LOOK, jnp.asarray(error, jnp.float64))
    places = seen_from(truth, UV, jnp.full(len(UV), 500.0))
    places = places if enu is None else moved_on_map(places, jnp.broadcast_to(jnp.asarray(enu, jnp.float64), UV.shape))
    return TiePoints(UV, places, sigma**2 * jnp.broadcast_to(jnp.eye(2), (len(UV), 2, 2)))


def horizontal(here: Geodetic, there: Geodetic) -> np.ndarray:
    """Offset to the east and north, m."""
    R = R_ecef_from_enu(there)
    return np.asarray(R.T @ (WGS84.to_ecef(here) - WGS84.to_ecef(there)))[:2]


def fixed(result) -> Geodetic:
    return locate(result.sensor, result.shot, MIDDLE, GROUND).position


# Figures of Gu's table, of the same geometry in another program (10 deg of view or less; the paper prints none of it).
FIGURES = [(139.0, 19.6), (1334.0, 19.6), (2667.0, 19.7), (2668.0, 78.4), (2669.0, 117.8)]


@pytest.mark.slow
def test_errors_of_an_oblique_image_before_and_after():
    rows = gu2017.error_table()
    for row, figures in zip(rows, FIGURES, strict=True):
        np.testing.assert_allclose(row.rms, figures, rtol=0.01)
        assert row.updated.fix.ok


ERROR = np.array([8.0, -12.0, 5.0, 5e-4, -8e-4, 6e-4])


@pytest.mark.slow
def test_exact_ties_give_back_the_look():
    result = update_orientation(
        SENSOR, SHOT, ties_at(ERROR), GROUND, navigation(), TieErrors(registration=0.001, terrain=0.001)
    )
    assert result.ok
    look = moved_by(navigation(), LOOK, jnp.asarray(ERROR))
    truth = locate(look.sensor, look.motion, MIDDLE, GROUND).position
    np.testing.assert_allclose(horizontal(fixed(result), truth), 0.0, atol=3e-3)  # m
    np.testing.assert_allclose(result.residuals, 0.0, atol=1e-3)  # px
    # what was found moves the navigation's look to the corrected one, to second order in its rotations
    moved: Any = result.shot
    again: Any = moved_by(navigation(), LOOK, result.error)
    np.testing.assert_allclose(again.sensor.mount.R_head_from_camera, result.sensor.mount.R_head_from_camera, atol=1e-8)
    np.testing.assert_allclose(WGS84.to_ecef(again.motion.pose.position), WGS84.to_ecef(moved.pose.position), atol=1e-6)


@pytest.mark.costly
def test_posterior_is_that_of_gu():
    model, tie_errors = navigation(), TieErrors(registration=3.0, terrain=5.0)
    result = update_orientation(SENSOR, SHOT, ties_at(np.zeros(6)), GROUND, model, tie_errors)
    assert result.chi_square_ties < 1e-9
    ground = jax.vmap(lambda p: gu2017.ground_covariance(p, 3.0, 5.0))(seen_from(LOOK, UV, jnp.full(20, 500.0)))
    p_ecef = jax.vmap(WGS84.to_ecef)(seen_from(LOOK, UV, jnp.full(20, 500.0)))
    F, J, B = jax.jit(gu2017.conditions)(LOOK, model, UV, p_ecef, jnp.asarray(500.0))
    np.testing.assert_allclose(F, 0.0, atol=1e-8)
    cov = gu2017.parameter_covariance(J[:, :2], B[:, :2], ground, model.covariance())
    sigma = np.sqrt(np.diagonal(cov))
    np.testing.assert_allclose(result.cov_error / np.outer(sigma, sigma), cov / np.outer(sigma, sigma), atol=2e-12)
    # with the third row, of an exact height, nothing of the terrain's error would be left
    exact = gu2017.parameter_covariance(J, B, ground, model.covariance())
    flat = jax.vmap(lambda p: gu2017.ground_covariance(p, 3.0, 0.0))(seen_from(LOOK, UV, jnp.full(20, 500.0)))
    level = gu2017.parameter_covariance(J[:, :2], B[:, :2], flat, model.covariance())
    np.testing.assert_allclose(exact / np.outer(sigma, sigma), level / np.outer(sigma, sigma), atol=1e-8)


def test_step_of_gu_is_that_of_least_squares():
    rng = np.random.default_rng(3)
    J, F, root = rng.normal(size=(20, 2, 6)), rng.normal(size=(20, 2)), rng.normal(size=(20, 2, 2))
    W = np.einsum("tji,tjk->tik", root, root)
    rows, values = np.einsum("tij,tja->tia", root, J).reshape(40, 6), np.einsum("tij,tj->ti", root, F).reshape(40)
    step = gu2017.parameter_step(*(jnp.asarray(x) for x in (F, J, W)))
    np.testing.assert_allclose(step, -np.linalg.lstsq(rows, values)[0], rtol=1e-10)


@pytest.mark.costly
def test_conditions_and_derivatives_give_one_covariance():
    """Eq 3 of Gu against the derivative of the fix."""
    model = ErrorModel((*navigation().sources, errors_of.TerrainHeight.from_metres(5.0)))
    by_conditions = gauss_helmert(SENSOR, SHOT, MIDDLE, GROUND, model)
    by_fix = propagate(SENSOR, SHOT, MIDDLE, GROUND, model).cov_enu
    np.testing.assert_allclose(by_conditions, by_fix, rtol=0.0, atol=1e-12 * float(jnp.trace(by_fix)))


@pytest.mark.costly
def test_wrong_matches_count_little():
    rng = np.random.default_rng(5)
    enu = rng.normal(0.0, 3.0, (20, 2))
    enu[[2, 9, 14]] += [[400.0, -300.0], [-500.0, 100.0], [60.0, 250.0]]
    result = update_orientation(SENSOR, SHOT, ties_at(ERROR, enu=enu), GROUND, navigation(), TIE_ERRORS)
    others = np.delete(np.arange(20), [2, 9, 14])
    assert result.ok
    assert np.all(np.asarray(result.weights)[[2, 9, 14]] < 0.2)
    assert np.all(np.asarray(result.weights)[others] > 0.5)
    normalised = np.linalg.norm(result.normalised, axis=1)
    assert np.all(normalised[[2, 9, 14]] > 10.0)
    look = moved_by(navigation(), LOOK, jnp.asarray(ERROR))
    offset = horizontal(fixed(result), locate(look.sensor, look.motion, MIDDLE, GROUND).position)
    cov = np.asarray(result.fix(MIDDLE).cov_enu)[:2, :2]
    assert offset @ np.linalg.solve(cov, offset) < 13.8  # 99.9 %


@pytest.mark.costly
def test_map_shifted_as_a_whole():
    """It shifts the fix by as much; not knowing it adds its variance, which only the navigation can make less."""
    model, moved = navigation(1000.0, 1.0), jnp.asarray([30.0, -20.0])
    sharp = TieErrors(registration=0.5, terrain=0.5)
    still = update_orientation(SENSOR, SHOT, ties_at(np.zeros(6)), GROUND, model, sharp)
    shifted = update_orientation(SENSOR, SHOT, ties_at(np.zeros(6), enu=moved), GROUND, model, sharp)
    np.testing.assert_allclose(horizontal(fixed(shifted), fixed(still)), moved, atol=0.05)
    known = np.asarray(still.fix(MIDDLE).cov_enu)[:2, :2]
    for sigma in (10.0, 40.0):
        unsure = update_orientation(SENSOR, SHOT, ties_at(np.zeros(6)), GROUND, model, TieErrors(0.5, 0.5, sigma))
        cov = np.asarray(unsure.fix(MIDDLE).cov_enu)[:2, :2]
        np.testing.assert_allclose(cov - known, sigma**2 * np.eye(2), atol=0.01 * sigma**2)
        np.testing.assert_allclose(unsure.cov_shift, sigma**2 * np.eye(2), atol=0.01 * sigma**2)
    # a navigation that is sure tells the map's shift
    sure = navigation(0.1, 1e-5)
    told = update_orientation(SENSOR, SHOT, ties_at(np.zeros(6), enu=moved), GROUND, sure, TieErrors(0.5, 0.5, 40.0))
    np.testing.assert_allclose(told.shift, moved, atol=0.2)
    np.testing.assert_allclose(horizontal(fixed(told), fixed(still)), 0.0, atol=0.2)


@pytest.mark.costly
def test_residuals_come_to_what_the_errors_say():
    """Squares of ties and prior have their means, in all and each."""
    model, tie_errors, keys = navigation(), TieErrors(registration=3.0, terrain=5.0, shift=4.0), range(20)
    found = [_drawn_update(np.random.default_rng(key), model, tie_errors) for key in keys]
    ties, prior, determined = (
        np.mean([float(getattr(one, name)) for one in found])
        for name in ("chi_square_ties", "chi_square_prior", "redundancy_prior")
    )
    assert 0.85 < ties / (40.0 - determined) < 1.15  # 35 degrees of freedom, 20 times
    assert 0.5 < prior / determined < 1.6
    assert 0.9 < np.mean([float(one.sigma0) for one in found]) < 1.1


def _drawn_update(rng: np.random.Generator, model: ErrorModel, tie_errors: TieErrors):
    error = np.asarray(model.factor()) @ rng.normal(size=6)
    enu = rng.normal(0.0, float(tie_errors.registration), (20, 2)) + rng.normal(0.0, float(tie_errors.shift), 2)
    truth = moved_by(model, LOOK, jnp.asarray(error))
    places = seen_from(truth, UV, jnp.asarray(500.0 + rng.normal(0.0, float(tie_errors.terrain), 20)))
    ties = TiePoints(UV, moved_on_map(places, jnp.asarray(enu)), jnp.zeros((20, 2, 2)))
    return update_orientation(SENSOR, SHOT, ties, GROUND, model, tie_errors)


@eqx.filter_jit
def simulated(key: jax.Array, model: ErrorModel, tie_errors: TieErrors, sensor: Sensor, shot: Shot):
    """(error of the updated fix to the east and north, m; the covariance that the update gives it; whether it is one).

    Navigation, registration, map and heights are drawn, those of ties and target each.
    """

    def draw(key: jax.Array) -> Any:
        keys = jax.random.split(key, 4)
        error = model.factor() @ jax.random.normal(keys[0], (model.size,))
        heights = 500.0 + jnp.asarray(tie_errors.terrain) * jax.random.normal(keys[1], (21,))
        truth = model.moved(ModelInputs(Exposure(sensor, shot, jnp.asarray(0.0)), UV[0], LOOK.terrain), error)
        places = seen_from(truth, jnp.concatenate([UV, jnp.asarray([MIDDLE])]), heights)
        enu = jnp.asarray(tie_errors.registration) * jax.random.normal(keys[2], (20, 2))
        enu = enu + (jnp.asarray(tie_errors.shift) * jax.random.normal(keys[3], (2,)))[None, :]
        ground, target = jax.tree.map(lambda x: x[:20], places), jax.tree.map(lambda x: x[20], places)
        ties = TiePoints(UV, moved_on_map(ground, enu), jnp.zeros((20, 2, 2)))
        result = update_orientation(sensor, shot, ties, LOOK.terrain, model, tie_errors, loss=LeastSquares())
        fix = result.fix(MIDDLE, tie_errors.terrain)
        offset = R_ecef_from_enu(target).T @ (fix.fix.ecef - WGS84.to_ecef(target))
        return offset[:2], fix.cov_enu[:2, :2], result.ok

    return jax.vmap(draw)(jax.random.split(key, 500))


@pytest.mark.parametrize(
    "rounds, tolerance, position, angle, shift",
    [
        pytest.param(1, 0.15, 10.0, 0.05, 4.0, marks=pytest.mark.slow),
        pytest.param(20, 0.03, 10.0, 0.05, 0.0, marks=pytest.mark.slow),
        pytest.param(20, 0.03, 10.0, 0.05, 15.0, marks=pytest.mark.slow),
        pytest.param(20, 0.03, 50.0, 0.5, 0.0, marks=pytest.mark.slow),
    ],
)
def test_covariance_is_that_of_simulations(rounds, tolerance, position, angle, shift):
    tie_errors = TieErrors(jnp.asarray(3.0), jnp.asarray(5.0), jnp.asarray(shift))
    parts = [
        simulated(key, navigation(position, angle), tie_errors, SENSOR, SHOT)
        for key in jax.random.split(jax.random.key(7), rounds)
    ]
    offset, cov, ok = (np.concatenate([np.asarray(part[k]) for part in parts]) for k in range(3))
    assert ok.all()
    sampled, given = offset.T @ offset / len(offset), cov.mean(axis=0)
    root = np.linalg.inv(np.linalg.cholesky(given))
    np.testing.assert_allclose(np.sqrt(np.trace(sampled)), np.sqrt(np.trace(given)), rtol=tolerance)
    spread = np.sqrt(np.linalg.eigvalsh(root @ sampled @ root.T))
    np.testing.assert_allclose(spread, 1.0, atol=tolerance)


# Over an elevation model: ground that rises by 0.4 to the east, seen from the west by 40 degrees off nadir.

RISE = 0.4
SLOPE = small_dem(flat() + RISE * 30.0 * np.arange(17.0)[None, :])
LEVEL = small_dem(flat(172.0))
PLACES = np.stack([x.reshape(-1) for x in np.meshgrid(np.linspace(-110.0, 70.0, 4), np.linspace(-60.0, 60.0, 3))], 1)


def platform(bias: float) -> ErrorModel:
    return ErrorModel(
        (
            errors_of.Attitude.from_degrees(heading=0.1, pitch=0.05, roll=0.05),
            errors_of.Position.from_ned(north=2.0, east=2.0, down=3.0),
            errors_of.TerrainHeight.from_metres(bias),
        )
    )


@jax.jit
def images_of(dem: Dem, places: Geodetic, enu: jax.Array) -> jax.Array:
    """Pixels of places moved over the ground, (n, 2) m to the east and north."""

    def one(place: Geodetic, en: jax.Array) -> jax.Array:
        p_ecef = WGS84.to_ecef(place) + R_ecef_from_enu(place)[:, :2] @ en
        return image_of_point(looks.sensor(), looks.shot(), jnp.asarray(0.0), on_surface(dem, p_ecef), None)[0]

    return jax.vmap(one)(places, enu)


def dem_ties(dem: Dem) -> TiePoints:
    """Ties without error, for the look that the navigation gives."""
    centre = Geodetic.from_degrees(lat=np.full(12, 47.0), lon=np.full(12, 11.0), height=np.full(12, 170.0))
    places = moved_on_map(centre, jnp.asarray(PLACES))
    return TiePoints(images_of(dem, places, jnp.zeros((12, 2))), places, jnp.zeros((12, 2, 2)))


def dem_update(dem: Dem, model: ErrorModel, tie_errors: TieErrors, **options: Any):
    return update_orientation(looks.sensor(), looks.shot(), dem_ties(dem), dem, model, tie_errors, **options)


@pytest.mark.slow
def test_covariance_of_a_tie_is_that_of_samples_on_a_slope():
    only_map = TieErrors(registration=2.0)
    result = dem_update(SLOPE, platform(3.0), only_map)
    places = jax.tree.map(lambda x: jnp.broadcast_to(x[5], (4000,)), dem_ties(SLOPE).ground)
    enu = np.random.default_rng(1).normal(0.0, 2.0, (4000, 2))
    sampled = np.cov(np.asarray(images_of(SLOPE, places, jnp.asarray(enu))).T)
    root = np.linalg.inv(np.linalg.cholesky(result.cov_residuals[5]))
    np.testing.assert_allclose(np.linalg.eigvalsh(root @ sampled @ root.T), 1.0, atol=0.08)


@pytest.mark.slow
def test_ties_on_planes_of_their_own_are_those_on_such_ground():
    """Over ground that rises evenly a tie's own plane is the ground's, whose height errs with the terrain's."""
    tie_errors = TieErrors(registration=1.0, terrain=2.0, shift=3.0)
    ties, rng = dem_ties(SLOPE), np.random.default_rng(3)
    uv = np.asarray(ties.uv) + rng.normal(0.0, 5.0, (12, 2))
    height = np.asarray(jax.vmap(SLOPE.height_at)(ties.ground))
    ground = Geodetic(lat=ties.ground.lat, lon=ties.ground.lon, height=height)
    rise = np.tile([RISE, 0.0], (12, 1))
    of_ground, of_plane = (
        update_orientation(looks.sensor(), looks.shot(), one, SLOPE, platform(3.0), tie_errors)
        for one in (TiePoints(uv, ties.ground, ties.covariance), TiePoints(uv, ground, ties.covariance, rise=rise))
    )
    sigma = np.sqrt(np.diagonal(of_ground.covariance))
    np.testing.assert_allclose(of_plane.error / sigma[:-2], of_ground.error / sigma[:-2], rtol=0, atol=0.01)
    unit = np.outer(sigma, sigma)
    np.testing.assert_allclose(of_plane.covariance / unit, of_ground.covariance / unit, rtol=0, atol=0.01)


@pytest.mark.slow
def test_ends_where_the_slope_of_the_ground_jumps():
    """An unknown shift takes ties over the edges of cells, some of them to and fro."""
    dem, tie_errors = small_dem(rough(seed=5)), TieErrors(registration=1.0, terrain=1.0, shift=5.0)
    ties = dem_ties(dem)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        enu = rng.normal(0.0, 1.0, (12, 2)) + (rng.uniform(size=(12, 1)) < 0.25) * rng.normal(0.0, 60.0, (12, 2))
        moved = TiePoints(
            ties.uv + rng.normal(0.0, 15.0, 2)[None, :], moved_on_map(ties.ground, jnp.asarray(enu)), ties.covariance
        )
        assert update_orientation(looks.sensor(), looks.shot(), moved, dem, platform(3.0), tie_errors).ok


@pytest.mark.slow
def test_ground_taken_for_level():
    """Eq 6 of Gu is right where it is level, and only there."""
    only_map = TieErrors(registration=2.0)
    for dem, is_level in ((SLOPE, False), (LEVEL, True)):
        full = np.asarray(dem_update(dem, platform(3.0), only_map, propagation=FullJacobian()).cov_residuals)
        level = np.asarray(dem_update(dem, platform(3.0), only_map, propagation=LevelGround()).cov_residuals)
        roots = np.linalg.inv(np.linalg.cholesky(full))
        ratios = np.linalg.eigvalsh(roots @ level @ np.swapaxes(roots, 1, 2))
        assert np.all(np.abs(ratios - 1.0) < 1e-3) == is_level
        assert np.all(np.max(np.abs(ratios - 1.0), axis=1) > 0.25) == (not is_level)


@pytest.mark.slow
def test_errors_of_heights_that_are_alike():
    """Over no distance they are each tie's own; over any distance they are a bias of the whole terrain."""
    field = lambda length: errors_of.TerrainField.of_variograms(gaussian=[(4.0, length)])  # noqa: E731
    own = dem_update(SLOPE, platform(0.0), TieErrors(registration=1.0, terrain=5.0))
    apart = dem_update(SLOPE, platform(0.0), TieErrors(1.0, 3.0, 0.0, field(1e-3)))
    scale = np.sqrt(np.diagonal(own.cov_error)[:6])
    unit = np.outer(scale, scale)
    np.testing.assert_allclose(apart.cov_error[:6, :6] / unit, own.cov_error[:6, :6] / unit, atol=1e-9)
    bias = dem_update(SLOPE, platform(4.0), TieErrors(registration=1.0, terrain=3.0))
    alike = dem_update(SLOPE, platform(0.0), TieErrors(1.0, 3.0, 0.0, field(1e7)))
    np.testing.assert_allclose(alike.cov_error[:6, :6] / unit, bias.cov_error[:6, :6] / unit, atol=1e-4)
    assert np.linalg.det(bias.cov_error[:6, :6] / unit) > 1.5 * np.linalg.det(own.cov_error[:6, :6] / unit)


SURE = ErrorModel(
    (
        errors_of.Attitude.from_degrees(heading=1e-4, pitch=1e-4, roll=1e-4),
        errors_of.Position.from_ned(north=0.01, east=0.01, down=0.01),
        errors_of.TerrainHeight.from_metres(3.0),
    )
)


def raised():
    """The update over a terrain that lies 2.5 m too low."""
    low = small_dem(np.asarray(SLOPE.posts) - 2.5)
    return update_orientation(
        looks.sensor(), looks.shot(), dem_ties(SLOPE), low, SURE, TieErrors(registration=0.05, terrain=0.05)
    )


@pytest.mark.slow
def test_bias_of_the_terrain_is_estimated():
    """A sure navigation tells that the terrain lies too low."""
    result: Any = raised()
    np.testing.assert_allclose(result.error[6], 2.5, atol=0.05)
    here = jax.tree.map(lambda x: x[5], dem_ties(SLOPE).ground)
    np.testing.assert_allclose(result.terrain.height_at(here), SLOPE.height_at(here), atol=0.05)


@pytest.mark.slow
def test_bias_of_the_terrain_goes_on_to_the_fix():
    result = raised()
    truth = locate(looks.sensor(), looks.shot(), (700.0, 420.0), SLOPE)
    fix = result.fix((700.0, 420.0))
    np.testing.assert_allclose(fix.fix.ecef, truth.ecef, atol=0.05)
    assert float(fix.cov_enu[2, 2]) < 0.05**2 < float(result.fix((700.0, 420.0), 2.0).cov_enu[2, 2])


UNEVEN = np.tile(np.linspace(0.5, 4.0, 17), (17, 1)) + np.linspace(0.0, 1.0, 17)[:, None]


def uneven(posts: Any) -> ErrorModel:
    """A sure navigation, and heights of the terrain with the standard deviations of a raster."""
    return ErrorModel((*SURE.sources[:2], errors_of.TerrainHeightRaster.from_array(posts, SLOPE.grid)))


@pytest.mark.slow
def test_a_raster_of_standard_deviations_is_one_number_times_the_value_at_each_tie():
    """The terrain is too low by 1.5 times the raster: found, corrected everywhere, and carried to the fix."""
    low = small_dem(np.asarray(SLOPE.posts) - 1.5 * UNEVEN)
    tie_errors = TieErrors(registration=0.05, terrain=0.05)
    result: Any = update_orientation(looks.sensor(), looks.shot(), dem_ties(SLOPE), low, uneven(UNEVEN), tie_errors)
    np.testing.assert_allclose(result.error[6], 1.5, atol=0.02)
    assert 0.0 < float(result.cov_error[6, 6]) < 0.05**2
    for tie in (0, 5, 11):
        here = jax.tree.map(lambda x: x[tie], dem_ties(SLOPE).ground)  # noqa: B023
        np.testing.assert_allclose(result.terrain.height_at(here), SLOPE.height_at(here), atol=0.05)
    truth = locate(looks.sensor(), looks.shot(), (700.0, 420.0), SLOPE)
    np.testing.assert_allclose(result.fix((700.0, 420.0)).fix.ecef, truth.ecef, atol=0.05)


def test_a_raster_must_be_known_at_all_ties_and_raise_posts():
    holed = np.where(np.arange(17) < 9, UNEVEN, np.nan)
    with pytest.raises(ValueError, match=r"errors\[2\]: no standard deviation is known at \d+ of 12 ties: \d+"):
        update_orientation(looks.sensor(), looks.shot(), dem_ties(SLOPE), SLOPE, uneven(holed), TIE_ERRORS)
    with pytest.raises(ValueError, match=r"errors\[2\] is a TerrainHeightRaster, .* this terrain is a ConstantHeight"):
        update_orientation(looks.sensor(), looks.shot(), dem_ties(SLOPE), GROUND, uneven(UNEVEN), TIE_ERRORS)


@pytest.mark.slow
def test_trajectory_is_corrected_as_a_shot():
    model, tie_errors = platform(0.5), TieErrors(registration=1.0, terrain=1.0)
    ties = dem_ties(SLOPE)
    ties = TiePoints(ties.uv + jnp.asarray([[3.0, -4.0]]), ties.ground, ties.covariance)
    one = update_orientation(looks.sensor(), looks.shot(), ties, SLOPE, model, tie_errors)
    other = update_orientation(looks.sensor(), looks.trajectory(), ties, SLOPE, model, tie_errors, time=0.0)
    scale = np.sqrt(np.diagonal(one.cov_error))
    np.testing.assert_allclose(other.error / scale, one.error / scale, atol=1e-4)
    here, there = (np.asarray(result.fix((700.0, 420.0)).cov_enu) for result in (one, other))
    np.testing.assert_allclose(there, here, atol=1e-4 * np.max(here))


@pytest.mark.slow
def test_loss_that_falls_to_nothing_starts_from_one_that_does_not():
    enu = np.random.default_rng(6).normal(0.0, 3.0, (20, 2))
    enu[::4] += [[900.0, -300.0], [-500.0, 100.0], [60.0, 250.0], [0.0, 90.0], [-700.0, 700.0]]
    ties, tie_errors = ties_at(ERROR * 20.0, enu=enu), TieErrors(registration=3.0, terrain=5.0)
    result = update_orientation(SENSOR, SHOT, ties, GROUND, navigation(200.0, 1.0), tie_errors, loss=Tukey())
    assert result.ok
    np.testing.assert_array_equal(np.flatnonzero(~np.asarray(result.used)), np.arange(0, 20, 4))
    look = moved_by(navigation(), LOOK, jnp.asarray(20.0 * ERROR))
    offset = horizontal(fixed(result), locate(look.sensor, look.motion, MIDDLE, GROUND).position)
    cov = np.asarray(result.fix(MIDDLE).cov_enu)[:2, :2]
    assert offset @ np.linalg.solve(cov, offset) < 13.8  # 99.9 %


def test_circle_of_a_round_error_is_2_146_standard_deviations():
    np.testing.assert_allclose(circular_error(jnp.eye(2), 0.9), np.sqrt(-2.0 * np.log(0.1)), rtol=1e-9)
    np.testing.assert_allclose(circular_error(jnp.diag(jnp.asarray([278.0, 68.0]) ** 2), 0.9), 462.5, atol=0.1)


@pytest.mark.costly
def test_ties_behind_the_camera_have_no_update():
    behind = Geodetic.from_degrees(lat=np.full(20, 30.0), lon=np.full(20, 103.5), height=np.zeros(20))
    ties = TiePoints(UV, behind, jnp.zeros((20, 2, 2)))
    result = update_orientation(SENSOR, SHOT, ties, GROUND, navigation(), TieErrors(registration=3.0, terrain=5.0))
    assert int(result.status) == Status.behind_camera
    assert not np.any(np.isfinite(result.error))
    assert not np.any(np.isfinite(result.covariance))
    with pytest.raises(ValueError, match="behind_camera"):
        result.fix(MIDDLE)


def one_tie() -> TiePoints:
    ties = ties_at(np.zeros(6))
    return jax.tree.map(lambda x: x[:1] if jnp.ndim(x) else x, ties)


@pytest.mark.costly
def test_one_tie_needs_a_prior_that_predicts_it():
    tie_errors = TieErrors(registration=3.0, terrain=5.0)
    with pytest.raises(ValueError, match=r"1 tie point, whose pixel the prior predicts to \d"):
        update_orientation(SENSOR, SHOT, one_tie(), GROUND, navigation(200.0, 1.0), tie_errors)
    assert update_orientation(SENSOR, SHOT, one_tie(), GROUND, navigation(3.0, 0.002), tie_errors).ok


def changed(**changes: Any) -> TiePoints:
    ties = ties_at(np.zeros(6))
    given = {"uv": ties.uv, "ground": ties.ground, "covariance": ties.covariance, "pixel_sigma": 0.0} | changes
    return TiePoints(**given)


BENT = jnp.broadcast_to(jnp.asarray([[1.0, 2.0], [2.0, 1.0]]), (20, 2, 2))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"ties": lambda: changed(uv=jnp.zeros((0, 2)))}, "no tie point"),
        ({"ties": lambda: changed(uv=UV[:7])}, r"ties.ground.lat must have the shape \(7,\)"),
        ({"ties": lambda: changed(uv=UV.at[3, 1].set(jnp.nan))}, "ties.uv must be finite"),
        ({"ties": lambda: changed(covariance=BENT)}, "ties.covariance of tie 0"),
        ({"ties": lambda: changed(pixel_sigma=-1.0)}, "ties.pixel_sigma must lie"),
        ({"tie_errors": TieErrors}, "tie 0 has no error"),
        ({"tie_errors": lambda: TieErrors(registration=-3.0)}, "tie_errors.registration must lie"),
        ({"prior": lambda: Prior(jnp.zeros(6), jnp.eye(6))}, r"prior.mean must have the shape \(8,\)"),
        ({"prior": lambda: Prior(jnp.zeros(8), -jnp.eye(8))}, "prior.covariance"),
        (
            {"errors": lambda: ErrorModel((errors_of.TerrainField.of_variograms(gaussian=[(1.0, 9.0)]),))},
            "Use TerrainHeight",
        ),
    ],
)
def test_refusals(change, message):
    given = {"ties": changed, "tie_errors": lambda: TIE_ERRORS, "errors": navigation} | change
    made = {name: make() for name, make in given.items()}
    with pytest.raises(ValueError, match=message):
        update_orientation(SENSOR, SHOT, terrain=GROUND, **made)


@pytest.mark.slow
def test_ties_off_the_terrain_are_named():
    ties = dem_ties(SLOPE)
    lat = ties.ground.lat.at[jnp.asarray([2, 7])].add(0.01)
    away = TiePoints(ties.uv, Geodetic(lat=lat, lon=ties.ground.lon, height=lat), ties.covariance)
    with pytest.raises(ValueError, match="2 of 12 ties lie outside the terrain or over a void: 2, 7"):
        update_orientation(looks.sensor(), looks.shot(), away, SLOPE, platform(3.0), TIE_ERRORS)
    field = ErrorModel((errors_of.TerrainField.of_variograms(gaussian=[(1.0, 90.0)]),))
    with pytest.raises(ValueError, match="TieErrors"):
        update_orientation(looks.sensor(), looks.shot(), ties, SLOPE, field, TIE_ERRORS)
