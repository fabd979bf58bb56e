"""Images that look 75 degrees off nadir over real relief: registered to a few metres, or refused with the reason."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.ngi import Flight
from support.rendered import clouded, noisy, spoilt, textured
from support.unlike_images import folded

from jaxgeo import Dem, ErrorModel, FrameCamera, Geodetic, Gimbal, Mount, Sensor, Shot, Status, locate
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.io import example_dem
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.ortho.rendering import render
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.registration import Registration, register_image
from jaxgeo.register.tie_errors import TieErrors
from jaxgeo.studies.gu2017.scene import disturbed, looking_at
from jaxgeo.terrain.grid import surface_point
from jaxgeo.uncertainty import sources

pytestmark = pytest.mark.slow

METRES, DEGREES = 20.0, 1.0  # standard deviations of the navigation
ROWS, COLS, FIELD = 160, 320, 16.0  # px, deg across
SIDE, CELL = 400, 10.0  # cells of the map, m
OFF_NADIR, ABOVE = 75.0, 900.0  # deg, m
MODEL = ErrorModel(
    (
        sources.Position.from_ned(north=METRES, east=METRES, down=METRES),
        sources.Attitude.from_degrees(heading=DEGREES, pitch=DEGREES, roll=DEGREES),
    )
)
TIE_ERRORS = TieErrors(registration=0.5, terrain=1.0)


@dataclass(frozen=True)
class Scene:
    """A map over a terrain, and an image of it from a known shot."""

    sensor: Sensor
    shot: Shot
    terrain: Dem
    reference: Orthoimage
    image: np.ndarray
    known: np.ndarray


@cache
def scene() -> Scene:
    """The Jacksboro Fault from the south, shaded and with fields and woods that are none."""
    terrain = example_dem()
    target = Geodetic.from_degrees(lat=36.29, lon=-84.26, height=0.0)
    ground = Geodetic(lat=target.lat, lon=target.lon, height=terrain.height_at(target))
    camera = FrameCamera.from_pixels(focal_px=0.5 * COLS / np.tan(np.deg2rad(FIELD / 2)), width=COLS, height=ROWS)
    sensor = Sensor(camera, Gimbal.fixed(), Mount.nadir())
    shot = looking_at(ground, off_nadir=OFF_NADIR, azimuth=0.0, above=ABOVE)
    reference = textured(terrain, target, (SIDE, SIDE), CELL)
    seen = render(sensor, shot, reference, terrain)
    return Scene(sensor, shot, terrain, reference, seen.values, seen.known)


def registered(
    image: np.ndarray, reference: Orthoimage, seed: int, here: Scene | None = None
) -> tuple[Registration, Shot]:
    """What becomes of an image by a navigation disturbed at random, and that."""
    here = scene() if here is None else here
    shot = disturbed(here.shot, np.random.default_rng(seed), metres=METRES, degrees=DEGREES)
    found = register_image(here.sensor, shot, image, reference, here.terrain, MODEL, TIE_ERRORS, known=here.known)
    return found, shot


_located = jax.jit(jax.vmap(locate, in_axes=(None, None, 0, None)))


def missed_by(found: Registration, here: Scene) -> np.ndarray:
    """(n, 2) by how much fixes of a lattice of pixels miss what the true shot sees there, m to the east and north."""
    rows, cols = here.known.shape
    u, v = np.meshgrid(np.linspace(20, cols - 20, 7), np.linspace(20, rows - 20, 7))
    uv = jnp.asarray(np.stack([u.ravel(), v.ravel()], axis=1))
    true, ours = (_located(one.sensor, one.shot, uv, here.terrain) for one in (here, found))
    ok = (np.asarray(true.status) == Status.hit) & (np.asarray(ours.status) == Status.hit)
    assert ok.mean() > 0.9
    R = np.asarray(R_ecef_from_enu(here.shot.pose.position))
    return ((np.asarray(ours.ecef) - np.asarray(true.ecef))[ok] @ R)[:, :2]


def check_right(found: Registration, here: Scene | None = None) -> None:
    """Registered, within 20 m all over the image, and at its middle within three of its standard deviations."""
    here = scene() if here is None else here
    assert found.accepted, str(found)
    missed = np.hypot(*missed_by(found, here).T)
    assert np.median(missed) < 5.0
    assert np.quantile(missed, 0.95) < 20.0
    middle = 0.5 * here.known.shape[1], 0.5 * here.known.shape[0]
    centre = found.fix(middle)
    true = locate(here.sensor, here.shot, middle, here.terrain)
    R = np.asarray(centre.nominal.R_ecef_from_enu)
    away = (R.T @ (np.asarray(centre.fix.ecef) - np.asarray(true.ecef)))[:2]
    assert away @ np.linalg.solve(np.asarray(centre.cov_enu)[:2, :2], away) < 3.0**2


def test_an_oblique_image_is_registered() -> None:
    found, _ = registered(spoilt(scene().image, seed=5), scene().reference, seed=1)
    check_right(found)


def test_an_oblique_image_is_registered_to_a_map_of_another_sensor() -> None:
    here, seed = scene(), 1
    given = disturbed(here.shot, np.random.default_rng(seed), metres=METRES, degrees=DEGREES)
    there = _of(folded(_map()))
    image = spoilt(here.image, seed=5)
    arguments = (here.sensor, given, image, there, here.terrain, MODEL, TIE_ERRORS)
    assert not register_image(*arguments, known=here.known).accepted
    check_right(register_image(*arguments, known=here.known, measure="orientation"))


@pytest.mark.parametrize("seed", range(2, 7))
def test_an_oblique_image_is_registered_from_anywhere_near(seed: int) -> None:
    found, _ = registered(spoilt(scene().image, seed=seed), scene().reference, seed=seed)
    check_right(found)


def _of(values: np.ndarray) -> Orthoimage:
    return Orthoimage.of(values, scene().reference.grid)


def _map() -> np.ndarray:
    return np.asarray(scene().reference.values)[0]


def _elsewhere() -> Orthoimage:
    """The map, but it lies 20 km to the south."""
    return Orthoimage.of(_map(), scene().reference.grid.window(-2000.0, 0.0))


def _another() -> Orthoimage:
    centre = Geodetic.from_degrees(lat=36.35, lon=-84.20, height=0.0)
    return _of(np.asarray(textured(scene().terrain, centre, (SIDE, SIDE), CELL, seed=8).values)[0])


def _sea() -> np.ndarray:
    return noisy(np.full_like(scene().image, 100.0) + 1e-3 * scene().image, np.random.default_rng(2), 30.0)


def _clouds() -> np.ndarray:
    return clouded(scene().image, np.random.default_rng(3), 0.85)


def _image() -> np.ndarray:
    return spoilt(scene().image, seed=5)


def _same() -> Orthoimage:
    return scene().reference


UNALIKE = (Outcome.no_agreement, Outcome.few_agree)
EVEN = (Outcome.no_texture, *UNALIKE)
CASES: dict[str, tuple[Callable[[], np.ndarray], Callable[[], Orthoimage], tuple[Outcome, ...]]] = {
    "another area": (_image, _another, UNALIKE),
    "no overlap": (_image, _elsewhere, (Outcome.no_overlap,)),
    "mirrored": (_image, lambda: _of(_map()[:, ::-1]), UNALIKE),
    "turned": (_image, lambda: _of(np.rot90(_map())), UNALIKE),
    "even reference": (_image, lambda: _of(np.full((SIDE, SIDE), 80.0)), (Outcome.no_texture,)),
    "even image": (lambda: np.full_like(scene().image, 80.0), _same, (Outcome.no_texture,)),
    "sea": (_sea, _same, EVEN),
    "clouds": (_clouds, _same, UNALIKE),
    "unknown": (
        _image,
        lambda: Orthoimage.of(_map(), scene().reference.grid, _corner()),
        (Outcome.no_overlap, Outcome.off_reference, Outcome.too_small),
    ),
}


def _corner() -> np.ndarray:
    """Known in a corner only, far from what the image shows."""
    row, col = np.mgrid[:SIDE, :SIDE]
    return (row > SIDE - 20) & (col < 20)


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_registered_is_said_and_leaves_the_navigation_as_it_is(case: str) -> None:
    image, reference, outcomes = CASES[case]
    found, shot = registered(image(), reference(), seed=1)
    assert found.outcome in outcomes, str(found)
    assert found.update is None
    jax.tree.map(np.testing.assert_array_equal, found.shot, shot)
    with pytest.raises(ValueError, match="not registered"):
        found.fix((0.0, 0.0))


@pytest.mark.parametrize("seed", range(1, 3))
def test_a_texture_that_repeats_itself_is_refused_or_found_right(seed: int) -> None:
    # Near ground shows a period larger than far ground does, so that the right pose can be told in principle.
    row, col = np.mgrid[:SIDE, :SIDE]
    reference = _of(100.0 + 50.0 * np.sin(2.0 * np.pi * row / 24.0) * np.sin(2.0 * np.pi * col / 12.0))
    seen = render(scene().sensor, scene().shot, reference, scene().terrain).values
    found, _ = registered(noisy(seen, np.random.default_rng(seed), 0.1), reference, seed)
    if found.accepted:
        check_right(found)
    else:
        assert found.outcome in (*UNALIKE, Outcome.ambiguous), str(found)


@pytest.fixture(scope="module")
def real(jaxgeo_test_data: pathlib.Path) -> Scene:
    """A real orthophoto of 5 m over valleys 300 m deep, seen from 1.4 km above them."""
    flight = Flight.of(jaxgeo_test_data)
    reference, terrain = flight.reference(2), flight.terrain
    middle = reference.grid.normal(jnp.array([0.45, 0.55]) * jnp.array(reference.shape))
    place = WGS84.to_geodetic(surface_point(middle))
    ground = Geodetic(lat=place.lat, lon=place.lon, height=terrain.height_at(place))
    camera = FrameCamera.from_pixels(focal_px=400 / np.tan(np.deg2rad(5.0)), width=800, height=400)
    sensor = Sensor(camera, Gimbal.fixed(), Mount.nadir())
    shot = looking_at(ground, off_nadir=75.0, azimuth=0.0, above=1400.0)
    seen = render(sensor, shot, reference, terrain, supersampling=2)
    assert seen.known.mean() > 0.9
    return Scene(sensor, shot, terrain, reference, seen.values, seen.known)


@pytest.mark.parametrize("seed", range(2))
def test_an_oblique_image_of_a_real_orthophoto_is_registered(real: Scene, seed: int) -> None:
    found, _ = registered(spoilt(real.image, seed=seed), real.reference, seed=seed, here=real)
    check_right(found, real)
