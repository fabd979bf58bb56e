"""End-to-end run of the method on one image: rectification, registration, and fixes by the updated pose."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgeo.observation import Exposure
from jaxgeo.ortho import Orthoimage, rectify
from jaxgeo.register import Registration, register_image
from jaxgeo.register.prediction import window_of
from jaxgeo.sensor import Shot
from jaxgeo.studies.gu2017.fixes import Spread, direct, height_sigma, spread, truth, updated
from jaxgeo.studies.gu2017.scene import SIGMA_ATTITUDE, SIGMA_POSITION, Imaged, disturbed
from jaxgeo.uncertainty import Propagation, propagate
from jaxgeo.uncertainty.model_inputs import ModelInputs

MARGIN = 0.05  # of the window's side


class Run(NamedTuple):
    """One registration, its time in s, and fixes of a lattice of pixels by the navigation and after the
    registration."""

    seed: int
    given: Shot
    registration: Registration
    seconds: float
    before: Spread
    after: Spread | None


class Flow(NamedTuple):
    """Runs with different navigation errors, the first of them for figures: the part of the map around the image,
    the image rectified by the navigation and after registration, and the centre pixel's fixes."""

    runs: list[Run]
    reference: Orthoimage
    by_navigation: Orthoimage
    registered: Orthoimage | None
    direct: Propagation
    updated: Propagation | None


def flow(im: Imaged, others: int = 2, seed: int = 0) -> Flow:
    """Register an image, and again with `others` draws of the navigation errors if the true shot is known."""
    runs = [one_run(im, seed)]
    if im.true is not None:
        for number in range(1, others + 1):
            rng = np.random.default_rng([seed, number])
            given = disturbed(im.true, rng, metres=SIGMA_POSITION, degrees=SIGMA_ATTITUDE)
            runs.append(one_run(im._replace(given=given), number))
    return _pictured(im, runs)


def one_run(im: Imaged, seed: int) -> Run:
    """Register an image and evaluate its fixes."""
    began = time.perf_counter()
    arguments: Any = im.sensor, im.given, im.image, im.reference, im.terrain, im.errors, im.tie_errors
    found = register_image(*arguments, known=im.known)
    seconds, true = time.perf_counter() - began, truth(im)
    after = spread(updated(im, found), true) if found.accepted else None
    return Run(seed, im.given, found, seconds, spread(direct(im), true), after)


def middle(im: Imaged) -> tuple[float, float]:
    """The centre pixel."""
    camera: Any = im.sensor.camera
    return 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)


def _pictured(im: Imaged, runs: list[Run]) -> Flow:
    from jaxgeo.uncertainty import ErrorModel, PerMeasurement, sources

    found = runs[0].registration
    reference = part_of(im)
    place: Any = reference.grid, reference.shape
    before = rectify(im.sensor, im.given, im.image, im.terrain, *place, known=im.known).orthoimage
    after, fix = None, None
    if found.accepted:
        after = rectify(found.sensor, found.shot, im.image, found.terrain, *place, known=im.known).orthoimage
        fix = found.fix(middle(im), height_sigma(im))
    height = sources.TerrainHeight.from_metres(height_sigma(im), sharing=PerMeasurement())
    model = ErrorModel((*im.errors.sources, height))
    return Flow(runs, reference, before, after, propagate(im.sensor, im.given, middle(im), im.terrain, model), fix)


def part_of(im: Imaged) -> Orthoimage:
    """The part of the map that contains the image by the navigation, with a margin."""
    inputs = ModelInputs(Exposure(im.sensor, im.given, jnp.asarray(0.0)), terrain=im.terrain)
    window = window_of(inputs, im.reference.grid, im.reference.shape)
    if window is None:
        return im.reference
    top, left, bottom, right = window
    aside = int(MARGIN * max(bottom - top, right - left))
    top, left = max(top - aside, 0), max(left - aside, 0)
    bottom, right = (min(end + aside, n) for end, n in zip((bottom, right), im.reference.shape, strict=True))
    return im.reference.window(top, left, (bottom - top, right - left))
