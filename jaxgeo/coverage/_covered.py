"""Part of an image that sees known ground: its area, and its share of the image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jaxgeo._arguments import check_terrain, checked_air
from jaxgeo._intersection import FIRST_HIT
from jaxgeo._record import portable
from jaxgeo.coverage._footprint import Looked, located_points, sees_ground
from jaxgeo.coverage.exposure import Image, checked_image, image_size, local_projection
from jaxgeo.earth import Atmosphere, TransverseMercator
from jaxgeo.sensor import Sensor
from jaxgeo.terrain import AbstractTerrain

CELLS = 96  # along the longer side of the image


@portable
class CoveredPart(NamedTuple):
    """Part of an image that sees known ground: its `area` on the map in m2, hidden ground included, and its `share` of
    the image, 0 to 1."""

    area: float
    share: float


def covered_part(
    sensor: Sensor,
    image: Image,
    terrain: AbstractTerrain,
    *,
    cells: int = CELLS,
    atmosphere: Atmosphere | None = None,
    projection: TransverseMercator | None = None,
) -> CoveredPart:
    """Area of the ground that an image sees, and the share of the image that sees it: for an incomplete `footprint`.

    The image is divided into cells, `cells` along its longer side, whose corners are located on the terrain. A cell of
    which some corners see ground counts by their share, with the mean area of its whole neighbours, so that the edge of
    the ground is located to half a cell. Not traceable. Raises `ValueError` for fewer than one cell.

    >>> from jaxgeo import coverage
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=1000.0, width=1000, height=500)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    >>> shot = jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=1600.0))
    >>> part = coverage.covered_part(sensor, shot, jaxgeo.ConstantHeight(600.0))
    >>> print(f"{part.area / 1e6:.2f} km2, {100.0 * part.share:.0f} % of the image")
    0.50 km2, 100 % of the image
    """
    sensor, image = checked_image(sensor, image)
    check_terrain(terrain, FIRST_HIT)
    if cells < 1:
        raise ValueError(f"cells must be at least 1; got {cells}.")
    projection = local_projection(image) if projection is None else projection
    size = image_size(sensor)
    counts = [max(1, round(cells * side / max(size))) for side in size]
    columns, rows = (np.linspace(-0.5, side - 0.5, count + 1) for side, count in zip(size, counts, strict=True))
    uv = np.stack(np.meshgrid(columns, rows), axis=-1)  # (rows, columns, 2)
    fix, places = located_points(Looked(sensor, image, terrain, checked_air(atmosphere), projection), uv.reshape(-1, 2))
    shape = uv.shape[:2]
    return _summed(places.reshape(*shape, 2), sees_ground(fix).reshape(shape))


def _summed(places: np.ndarray, seen: np.ndarray) -> CoveredPart:
    """Sums over the cells of a grid of points on a map (rows, columns, 2), of which some are `seen`."""
    corners = [np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]]
    share = np.mean([seen[corner] for corner in corners], axis=0)
    a, b, c, d = (places[corner] for corner in corners)
    (x, y), (x_other, y_other) = (c - a).transpose(2, 0, 1), (d - b).transpose(2, 0, 1)
    is_whole = share == 1.0
    area = np.where(is_whole, 0.5 * np.abs(x * y_other - y * x_other), 0.0)
    count, near = (_neighbours(one) for one in (is_whole.astype(float), area))
    area = np.where(is_whole, area, near / np.maximum(count, 1.0))
    return CoveredPart(float(np.sum(share * area)), float(np.mean(share)))


def _neighbours(values: np.ndarray) -> np.ndarray:
    """Sums over 3 by 3 cells."""
    padded = np.pad(values, 1)
    rows, columns = values.shape
    return sum((padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)), np.zeros_like(values))
