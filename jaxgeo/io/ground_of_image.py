"""The part of a DEM on disk that the orthorectification of an image needs, and its cells."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jaxgeo._arguments import checked_exposure
from jaxgeo.io.files import MAX_POSTS, DemFiles
from jaxgeo.io.locate_on_disk import lines_of_sight
from jaxgeo.io.map_raster import MapRaster, image_spacing, lattice_of, map_of, nothing_seen, raster_of
from jaxgeo.io.sightlines import Sightlines
from jaxgeo.io.windows import Window, padded_shape
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractTerrain, Dem

ALONG = 65  # places along the sides of a raster, by which its window is known
POSTS, SHARE = 2, 0.02  # posts, and share of a window, beside it: for lines of sight between those of the lattice


def image_raster(
    name: str,
    sensor: Sensor,
    shot: Shot | Trajectory,
    terrain: AbstractTerrain | DemFiles,
    crs: Any = None,
    resolution: Any = None,
    how: Any = None,
    *,
    max_posts: int = MAX_POSTS,
) -> tuple[MapRaster, AbstractTerrain]:
    """The cells of an image's orthoimage, and the terrain that it needs: of a DEM on disk a window.

    `crs`, `resolution`, and their defaults are those of `rectify_file`, `how` are options of `locate`, `name` is that
    of the image for messages. An orthoimage over the window is the same as over the whole: it holds the ground of all
    cells, and of all lines of sight of the image up to there. Raises `NothingSeen`; `WindowTooLarge`; `DemError`.
    """
    options = dict(how or {})

    def raster(ground: AbstractTerrain) -> MapRaster:
        return raster_of(
            name,
            sensor,
            shot,
            ground,
            crs,
            None,
            resolution,
            options,
            lambda: image_spacing(name, sensor, shot, ground, options),
        )

    if not isinstance(terrain, DemFiles):
        return raster(terrain), terrain
    files = terrain.forgetful()
    path, first, whole = window_of_image(files, name, sensor, shot)
    found = raster(load_window(files, first, whole, name, max_posts))
    area = files.window_of_places(*_places(name, found))
    margin = POSTS + math.ceil(SHARE * max(first.shape if area is None else first.joined(area).shape))
    window, whole = files.window_under(path, area, margin)
    assert window is not None
    return found, load_window(files, window, whole, name, max_posts)


def window_of_image(
    files: DemFiles, name: str, sensor: Sensor, shot: Shot | Trajectory, time: Any = None
) -> tuple[Sightlines, Window, bool]:
    """(lines of sight of a lattice of an image, their window, whether it needs the whole mosaic's ceiling).

    Raises `NothingSeen`.
    """
    rays, _ = lines_of_sight(*checked_exposure(sensor, shot, time), lattice_of(sensor.camera))
    path = files.follow(rays)
    window, whole = files.window_under(path)
    if window is None:
        raise nothing_seen(name, shot, files)
    return path, window, whole


def load_window(
    files: DemFiles, window: Window, whole: bool, name: str, max_posts: int, sizes: Any = padded_shape
) -> Dem:
    """A window as a `Dem`, in arrays of a size that depends on the window only: `sizes` of its (rows, cols).

    Raises `WindowTooLarge`.
    """
    if files.too_large(window, max_posts):
        raise files.refuse(window, max_posts, name)
    return files.load(window, whole_ceiling=whole, max_posts=max_posts, size=sizes(window.shape))


def _places(name: str, raster: MapRaster) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes in deg of a lattice over all cells of a raster, its outer ones included."""
    row, col = np.meshgrid(*(np.linspace(0.0, n - 1.0, ALONG) for n in raster.shape), indexing="ij")
    return map_of(name, raster).lonlat(row.ravel(), col.ravel())
