"""Lines of sight of scenes, for `fetch_dem`: of pixels, of whole images, and to places on the ground."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from pyproj.transformer import Transformer

from jaxgeo._arguments import checked_exposure
from jaxgeo.earth.ray import Ray
from jaxgeo.io.archives.sight import BESIDE, CEILING
from jaxgeo.io.locate_on_disk import lines_of_sight
from jaxgeo.io.located_over_files import rays_of
from jaxgeo.io.observations import Observations
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.uncertainty.sources import AbstractSource

SIDE = 9  # lines of sight along each side of an image
MANY = 200  # images, of more only the edges and the centre are looked at
SIGMAS = 5.0  # standard deviations by which lines of sight are widened
MOST_IMAGES = 600  # of more, so many are looked at


@dataclasses.dataclass(frozen=True)
class View:
    """Lines of sight, ECEF, and by how much they may be wrong: an angle in rad and a distance in m."""

    rays: tuple[Ray, ...]
    spread: float = 0.0
    beside: float = BESIDE

    def joined(self, other: View) -> View:
        """Both."""
        return View((*self.rays, *other.rays), max(self.spread, other.spread), max(self.beside, other.beside))


def view_of(observed: Observations, *, whole: bool = False) -> View:
    """The lines of sight of observed pixels, or with `whole` of all pixels of their images, with their errors."""
    rays: list[Ray] = []
    sources = [one for batch in observed.batches for one in batch.sources]
    for batch in observed.batches:
        if not whole:
            rays.append(rays_of(batch)[0])
            continue
        some = np.unique(np.linspace(0, len(batch) - 1, MOST_IMAGES).astype(int)).tolist()
        exposures = [batch.at(index)[0].exposure for index in some]
        rays += view_of_images([(one.sensor, one.motion, None) for one in exposures]).rays
    return View(tuple(rays), *spread_of(sources))


def view_of_images(images: Sequence[tuple[Sensor, Shot | Trajectory, Any]]) -> View:
    """The lines of sight of lattices over many images, (sensor, motion, time) each."""
    some = images[:: max(1, -(-len(images) // MOST_IMAGES))]
    rays = [_lattice(*image, edges=len(some) > MANY) for image in some]
    each = [(one.origin, one.direction) for one in rays]
    origin, direction = (np.concatenate([np.asarray(one) for one in part]) for part in zip(*each, strict=True))
    return View((Ray(origin, direction),))


def view_of_image(
    sensor: Sensor, motion: Shot | Trajectory, time: Any = None, sources: Sequence[AbstractSource] = ()
) -> View:
    """The lines of sight of a lattice over an image, its outer edges included."""
    return View((_lattice(sensor, motion, time),), *spread_of(sources))


def _lattice(sensor: Sensor, motion: Shot | Trajectory, time: Any, *, edges: bool = False) -> Ray:
    """Lines of sight of a lattice over an image, or of its edges and its centre only."""
    camera: Any = sensor.camera
    u, v = (np.linspace(-0.5, getattr(camera, size) - 0.5, SIDE) for size in ("width", "height"))
    uv = np.stack(np.meshgrid(u, v), axis=-1)
    middle = np.zeros((SIDE, SIDE), bool)
    middle[1:-1, 1:-1] = edges
    middle[SIDE // 2, SIDE // 2] = False
    uv = uv[~middle]
    return lines_of_sight(*checked_exposure(sensor, motion, time), uv)[0]


def view_from(position: Any, lat_deg: float, lon_deg: float) -> View:
    """The line of sight from a position, in rad and m, to a place on the ground of any height, and that place."""
    to_ecef = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    lat, lon, height = (float(np.asarray(one)) for one in (position.lat, position.lon, position.height))
    camera = np.array(to_ecef.transform(np.rad2deg(lon), np.rad2deg(lat), height))
    ends = [np.array(to_ecef.transform(lon_deg, lat_deg, h)) for h in (-400.0, 0.0, 500.0, 2000.0, CEILING)]
    origins = np.array([*([camera] * (len(ends) - 1)), ends[-1]])
    towards = np.array([*(end - camera for end in ends[:-1]), ends[0] - ends[-1]])
    return View((Ray(origins, towards / np.linalg.norm(towards, axis=1, keepdims=True)),))


def spread_of(sources: Iterable[AbstractSource]) -> tuple[float, float]:
    """(angle in rad, distance in m) by which the errors of sources may move lines of sight: five standard deviations
    of angles and of positions."""
    angle, distance = 0.0, 0.0
    for one in sources:
        sigma = np.asarray(getattr(one, "sigma", 0.0), np.float64)
        largest = float(np.max(np.abs(sigma), initial=0.0))
        if one.unit == "rad":
            angle = float(np.hypot(angle, largest))
        elif one.unit == "m":
            distance = float(np.hypot(distance, largest))
    return SIGMAS * angle, BESIDE + SIGMAS * distance
