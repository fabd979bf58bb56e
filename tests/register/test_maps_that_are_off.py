"""Images from above, and maps that are off as a whole or in part, or repeat themselves; and lenses and terrains that
are not those that made the image."""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from support.rendered import noisy, spoilt, textured
from support.unlike_images import folded

from jaxgeo._locate import locate
from jaxgeo.earth import Geodetic, R_ecef_from_enu
from jaxgeo.io import example_dem
from jaxgeo.ortho import Orthoimage, render
from jaxgeo.register import Outcome, Prior, TieErrors, register_image
from jaxgeo.register.registration import Registration
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Sensor, Shot
from jaxgeo.studies.gu2017.scene import disturbed, looking_at, moved
from jaxgeo.terrain import Dem, TangentGrid
from jaxgeo.uncertainty import ErrorModel, sources

pytestmark = pytest.mark.slow

DEM = example_dem()
SIZE, SIDE, CELL = 320, 512, 10.0  # px, cells, m
TARGET = Geodetic.from_degrees(lat=36.29, lon=-84.26, height=0.0)
SENSOR = Sensor(FrameCamera.from_pixels(focal_px=400.0, width=SIZE, height=SIZE), Gimbal.fixed(), Mount.nadir())
PIXELS = jnp.array([[159.5, 159.5], [20.0, 20.0], [300.0, 20.0], [20.0, 300.0], [300.0, 300.0]])


@functools.cache
def shot() -> Shot:
    """The image's true orientation."""
    return looking_at(
        Geodetic(lat=TARGET.lat, lon=TARGET.lon, height=DEM.height_at(TARGET)),
        off_nadir=3.0,
        azimuth=10.0,
        above=4000.0,
    )


@pytest.fixture(scope="module")
def reference() -> Orthoimage:
    return textured(DEM, TARGET, (SIDE, SIDE), CELL)


@pytest.fixture(scope="module")
def image(reference: Orthoimage) -> np.ndarray:
    return spoilt(np.asarray(render(SENSOR, shot(), reference, DEM).values), 5)


def errors(metres: float, degrees: float) -> ErrorModel:
    return ErrorModel(
        (
            sources.Position.from_ned(north=metres, east=metres, down=metres),
            sources.Attitude.from_degrees(heading=degrees, pitch=degrees, roll=degrees),
        )
    )


def map_errors(shift: float) -> TieErrors:
    return TieErrors(registration=0.5, terrain=1.0, shift=shift)


def off(found: Registration) -> tuple[np.ndarray, np.ndarray]:
    """Of the pixels, the offset to the east and north in m, and its standard deviations."""
    there = jax.vmap(lambda uv: locate(SENSOR, shot(), uv, DEM).ecef)(PIXELS)
    fixes = [found.fix(np.asarray(uv)) for uv in PIXELS]
    R = np.asarray(R_ecef_from_enu(shot().pose.position))
    offset = np.array([np.asarray(fix.fix.ecef) for fix in fixes]) - np.asarray(there)
    return (offset @ R)[:, :2], np.array([np.sqrt(np.diagonal(np.asarray(fix.cov_enu)))[:2] for fix in fixes])


def test_a_map_that_is_off_by_many_cells_is_followed(reference: Orthoimage, image: np.ndarray) -> None:
    """With good navigation the map's shift is found, however many cells it is, and it does not shift the result."""
    given = disturbed(shot(), np.random.default_rng(3), metres=2.0, degrees=0.02)
    for cells in (3, 6):
        there = Orthoimage.of(np.roll(np.asarray(reference.values)[0], cells, 1), reference.grid)
        found = register_image(SENSOR, given, image, there, DEM, errors(2.0, 0.02), map_errors(30.0))
        assert found.accepted, str(found)
        assert found.update is not None
        sigma = np.sqrt(np.diagonal(np.asarray(found.update.cov_shift)))
        assert np.all(np.abs(np.asarray(found.update.shift) - [cells * CELL, 0.0]) < 3.0 * sigma)
        assert np.all(sigma < 5.0)
        apart, sigmas = off(found)
        assert np.all(np.abs(apart) < 3.0 * sigmas)


def test_a_map_of_another_sensor_is_followed_by_orientations(reference: Orthoimage, image: np.ndarray) -> None:
    """Its contrast is inverted in the bright half: by grey values nothing, or too little, agrees."""
    given = disturbed(shot(), np.random.default_rng(3), metres=20.0, degrees=0.2)
    there = Orthoimage.of(folded(np.asarray(reference.values)[0]), reference.grid)
    grey, orientation = (
        register_image(SENSOR, given, image, there, DEM, errors(20.0, 0.2), map_errors(1.0), measure=measure)
        for measure in ("grey", "orientation")
    )
    assert not grey.accepted
    assert orientation.accepted, str(orientation)
    apart, sigmas = off(orientation)
    assert np.all(np.abs(apart) < 3.0 * sigmas)
    assert np.all(np.hypot(*apart.T) < 0.5 * CELL)
    with pytest.raises(ValueError, match="measure must be one of grey, orientation"):
        register_image(SENSOR, given, image, there, DEM, errors(20.0, 0.2), map_errors(1.0), measure="gray")


def test_a_shift_that_is_known_before_is_used(reference: Orthoimage, image: np.ndarray) -> None:
    given, model = disturbed(shot(), np.random.default_rng(3), metres=2.0, degrees=0.02), errors(2.0, 0.02)
    there = Orthoimage.of(np.roll(np.asarray(reference.values)[0], 12, 1), reference.grid)
    before = Prior.of(model, map_errors(1.0))
    before = Prior(jnp.asarray(before.mean).at[-2].set(12 * CELL), before.covariance)
    found = register_image(SENSOR, given, image, there, DEM, model, map_errors(1.0), prior=before)
    assert found.accepted, str(found)
    apart, sigmas = off(found)
    assert np.all(np.abs(apart) < 3.0 * sigmas)


def test_a_constant_raster_of_height_errors_is_a_terrain_height(reference: Orthoimage, image: np.ndarray) -> None:
    given, navigation = disturbed(shot(), np.random.default_rng(3), metres=2.0, degrees=0.02), errors(2.0, 0.02)
    grid = TangentGrid.centred(TARGET, spacing=(5000.0, 5000.0), shape=(5, 5))
    raster = sources.TerrainHeightRaster.from_array(np.full((5, 5), 4.0), grid)
    both = [
        register_image(SENSOR, given, image, reference, DEM, (*navigation.sources, height), map_errors(1.0))
        for height in (raster, sources.TerrainHeight.from_metres(4.0))
    ]
    assert both[0].accepted, str(both[0])
    (ours, sigmas), (theirs, others) = (off(one) for one in both)
    np.testing.assert_allclose(ours, theirs, atol=0.01)
    np.testing.assert_allclose(sigmas, others, rtol=0.01)


def refused(found: Registration) -> Any:
    assert found.update is None
    assert not found.accepted
    return found.outcome


def test_halves_that_contradict_each_other_are_ambiguous(reference: Orthoimage, image: np.ndarray) -> None:
    """A mosaic with a bad seam: coarser cells, in which both would be one, are no way out."""
    given = disturbed(shot(), np.random.default_rng(1), metres=50.0, degrees=0.5)
    values = np.asarray(reference.values)[0]
    torn = values.copy()
    torn[:, SIDE // 2 :] = np.roll(values, 8, 0)[:, SIDE // 2 :]
    there = Orthoimage.of(torn, reference.grid)
    found = register_image(SENSOR, given, image, there, DEM, errors(50.0, 0.5), map_errors(1.0))
    assert refused(found) is Outcome.ambiguous, str(found)


def test_a_texture_that_repeats_itself_is_ambiguous(reference: Orthoimage) -> None:
    period, rng = 16, np.random.default_rng(16)
    tile = scipy.ndimage.gaussian_filter(rng.normal(size=(period, period)), 1.0, mode="wrap")
    values = 100.0 + 30.0 * np.tile(tile / tile.std(), (SIDE // period, SIDE // period))
    there = Orthoimage.of(values, reference.grid)
    seen = noisy(np.asarray(render(SENSOR, shot(), there, DEM).values), np.random.default_rng(1), 0.1)
    given = moved(shot(), np.array([75.0, -37.5, 0.0]), np.zeros(3))
    found = register_image(SENSOR, given, seen, there, DEM, errors(50.0, 0.05), map_errors(1.0))
    assert refused(found) is Outcome.ambiguous, str(found)


def test_a_lens_or_a_terrain_that_is_not_the_image_s_is_no_noise(reference: Orthoimage, image: np.ndarray) -> None:
    """Ties that are off as their neighbours are say that something else is wrong; as noise they would tell too much."""
    given, model = disturbed(shot(), np.random.default_rng(1), metres=50.0, degrees=0.5), errors(50.0, 0.5)
    lens = eqx.tree_at(lambda s: s.camera.distortion, SENSOR, BrownConrady(k1=-0.05), is_leaf=lambda x: x is None)
    bent = spoilt(np.asarray(render(lens, shot(), reference, DEM).values), 5)
    beside = Dem.from_array(np.roll(np.asarray(DEM.posts, float), 3, 1), DEM.grid)
    for seen, terrain in ((bent, DEM), (image, beside)):
        found = register_image(SENSOR, given, seen, reference, terrain, model, map_errors(1.0))
        assert refused(found) is Outcome.does_not_fit, str(found)
    assert register_image(SENSOR, given, image, reference, DEM, model, map_errors(1.0)).accepted


def test_navigation_of_which_nothing_is_known_is_not_searched(reference: Orthoimage, image: np.ndarray) -> None:
    vague = {(1e6, 0.5): Outcome.too_vague, (2e4, 1.0): Outcome.too_vague, (1000.0, 0.5): Outcome.off_reference}
    for (metres, degrees), outcome in vague.items():
        found = register_image(SENSOR, shot(), image, reference, DEM, errors(metres, degrees), map_errors(1.0))
        assert refused(found) is outcome, str(found)


@pytest.mark.parametrize("change", [{"probability": 0.5}, {"block": 31}])
def test_searches_that_tell_nothing_are_refused(change: dict[str, Any], reference: Orthoimage) -> None:
    blank = np.ones((1, SIZE, SIZE))
    with pytest.raises(ValueError, match=next(iter(change))):
        register_image(SENSOR, shot(), blank, reference, DEM, errors(50.0, 0.5), map_errors(1.0), **change)
