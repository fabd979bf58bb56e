"""Errors of a camera given by its focal length for 35 mm film."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxgeo.io.acquisitions.record import Acquisition, for_each
from jaxgeo.io.given_camera import AS_GIVEN, Lens, given_camera, sigma_of_film
from jaxgeo.sensor import FrameCamera
from jaxgeo.uncertainty.sources import InteriorOrientation

WITHOUT_ERROR = (AS_GIVEN, "The camera is the one given, not that of the packets")


def with_film_errors(read: Callable[..., Acquisition], camera: Any) -> Callable[..., Acquisition]:
    """A reader whose exposures have the focal length error of the rule of 35 mm film, if `camera` is a lens by it."""
    if not isinstance(camera, str) or "film" not in camera.lower() or "=" not in camera:
        return read
    lens = given_camera(camera)
    if not isinstance(lens, Lens) or lens.film_mm is None:
        return read
    film_mm = lens.film_mm

    @functools.wraps(read)
    def wrapped(*args: Any, **how: Any) -> Acquisition:
        found = read(*args, **how)
        if found.sensor is None:
            return found
        assert isinstance(found.sensor.camera, FrameCamera)
        focal = np.asarray(found.sensor.camera.focal_px)[0, 0]
        share = sigma_of_film(found.sensor.camera.width, found.sensor.camera.height)
        source = InteriorOrientation.from_pixels(focal=share * focal, principal_column=0.0, principal_row=0.0)
        notes = (
            f"The focal length for 35 mm film, {film_mm:g} mm, is in proportion to the diagonals of image and film.",
            f"Focal length sigma: {100.0 * share:g} %, {share * focal:.3g} pixels (default for its source).",
        )
        kept = (one for one in found.assumed if not one.startswith(WITHOUT_ERROR))
        sources = (*found.sources, *for_each((source,), len(found)))
        return dataclasses.replace(found, sources=sources, assumed=(*kept, *notes))

    return wrapped
