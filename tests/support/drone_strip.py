"""A strip of drone images over flat textured ground, rendered, with a navigation that errs."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import jax
import numpy as np
import scipy

from jaxgeo import ConstantHeight, Exposure, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.ortho import Orthoimage, render
from jaxgeo.studies.gu2017.scene import disturbed
from jaxgeo.terrain import TangentGrid
from jaxgeo.ties import Pictures, Views
from jaxgeo.uncertainty import sources

GROUND, ABOVE, APART = 100.0, 150.0, 45.0  # m: height of the ground, of the images above it, and between them
SHAPE, CELL = (900, 700), 0.5  # cells, m, of the map
METRES, DEGREES = 1.0, 0.4  # standard deviations of the navigation
ERRORS = (
    sources.Position.from_ned(north=METRES, east=METRES, down=METRES),
    sources.Attitude.from_degrees(heading=DEGREES, pitch=DEGREES, roll=DEGREES),
)
CAMERA = FrameCamera.from_pixels(focal_px=240.0, width=256, height=192)
SENSOR = Sensor(CAMERA, Gimbal.fixed(), Mount.nadir())


@dataclass(frozen=True)
class Strip:
    """n images of a strip to the north, and a last one 3 km away of other ground: true and given shots."""

    true: list[Shot]
    given: list[Shot]
    images: list[np.ndarray]

    @property
    def names(self) -> list[str]:
        return [f"image {k}" for k in range(len(self.given))]

    @property
    def views(self) -> Views:
        return views_of(self.names, self.given)

    @property
    def pictures(self) -> Pictures:
        return Pictures(lambda row: (self.images[row], None))


def views_of(names: list[str], shots: list[Shot]) -> Views:
    return Views.of(names, [Exposure(SENSOR, one) for one in shots], [ERRORS] * len(shots))


def ground(off: float = 0.0) -> ConstantHeight:
    return ConstantHeight(jax.numpy.asarray(GROUND + off))


@functools.cache
def strip(count: int = 4, seed: int = 0) -> Strip:
    """Images with 10 % noise; the strip turns, climbs and tilts a little from image to image."""
    rng = np.random.default_rng(seed)
    centre = Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
    grid = TangentGrid.centred(centre, spacing=(CELL, CELL), shape=SHAPE)
    noise = [scipy.ndimage.gaussian_filter(rng.normal(size=SHAPE), width) for width in (1.0, 2.5, 6.0)]
    values = sum(one / np.std(one) for one in noise)
    reference = Orthoimage.of(100.0 + 30.0 * values, grid)
    true = []
    for k in range(count):
        north = APART * (k - 0.5 * (count - 1))
        height = GROUND + ABOVE + 4.0 * (k % 2)
        lat, lon = 47.0 + np.rad2deg(north / 6.367e6), 11.0 + 1e-4 * (k % 2)
        pose = Pose.from_degrees(lat=lat, lon=lon, height=height, heading=5.0 * k, pitch=4.0 * (-1) ** k, roll=3.0)
        true.append(Shot(pose, np.zeros(0)))
    images = [render(SENSOR, shot, reference, ground()) for shot in true]
    grey = [one.values[0] + 0.1 * np.std(one.values) * rng.normal(size=one.values[0].shape) for one in images]
    given = [disturbed(shot, rng, metres=METRES, degrees=DEGREES) for shot in true]
    far = Shot(Pose.from_degrees(lat=47.03, lon=11.0, height=GROUND + ABOVE, heading=0.0), np.zeros(0))
    return Strip([*true, far], [*given, far], [*grey, rng.normal(size=grey[0].shape)])
