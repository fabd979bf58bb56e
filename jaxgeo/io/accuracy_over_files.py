"""Accuracy maps over a DEM on disk, of which only the ground in sight and that of errors is read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo._compile import long_run_filter_jit
from jaxgeo._numerics import safe_norm
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.earth.ray import Ray
from jaxgeo.io.accuracy_map import bands_of, tags_of
from jaxgeo.io.errors import WindowTooLarge
from jaxgeo.io.files import MAX_POSTS, DemFiles
from jaxgeo.io.ground_of_image import POSTS, load_window, window_of_image
from jaxgeo.io.located_over_files import LARGEST, SMALLEST, WIDER, check_straight, reaches_beyond
from jaxgeo.io.map_raster import MapRaster, raster_of, terrain_spacing
from jaxgeo.io.windows import Bounds, Window, square_shape
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.sensor.exposure import line_of_sight
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.uncertainty import accuracy_map
from jaxgeo.uncertainty._accuracy_map import checked_map, projected
from jaxgeo.uncertainty.map_cells import BLOCK, Cell, MapContext

DIRECTIONS = 64  # in which the outermost cells are looked for
Motion = Shot | Trajectory | Pose


class MapBands(NamedTuple):
    """Bands (4, n) of `write_accuracy_map`, the probability, and the tags of the file."""

    bands: np.ndarray
    probability: float
    tags: Mapping[str, str]


def area_raster(
    name: str,
    sensor: Sensor,
    shot: Motion,
    terrain: AbstractTerrain | DemFiles,
    crs: Any,
    bounds: Bounds | None,
    resolution: Any,
    how: Mapping[str, Any],
) -> MapRaster:
    """The raster of `write_accuracy_map`, of any number of cells, also over a DEM on disk; raises as it does."""
    ground: Any = terrain
    if isinstance(terrain, DemFiles) and bounds is None and not isinstance(shot, Pose):
        files = terrain.forgetful()
        _, window, whole = window_of_image(files, name, sensor, shot, how.get("time"))
        ground = load_window(files, window, whole, name, MAX_POSTS)
    return raster_of(
        name,
        sensor,
        shot,
        ground,
        crs,
        bounds,
        resolution,
        how,
        lambda: terrain_spacing(name, terrain)._replace(most_cells=math.inf),
    )


def check_map(sensor: Sensor, shot: Motion, terrain: AbstractTerrain | DemFiles, errors: Any, how: Any) -> None:
    """Raises as `accuracy_map` for its arguments, and `ValueError` for an atmosphere over a DEM on disk."""
    check_straight(terrain, how.get("atmosphere"))
    if isinstance(terrain, DemFiles):
        terrain = terrain.forgetful().load(Window(0, 0, 2, 2), whole_ceiling=False)
    checked_map(sensor, shot, terrain, errors, **how)


def map_in_memory(
    ground: Geodetic, sensor: Sensor, shot: Motion, terrain: AbstractTerrain, errors: Any, how: Mapping[str, Any]
) -> MapBands:
    """The accuracy map of ground points (n,) as bands."""
    found = accuracy_map(sensor, shot, terrain, errors, ground, **how)
    return MapBands(bands_of(found), float(found.probability), tags_of(found))


def map_over_files(
    ground: Geodetic,
    sensor: Sensor,
    shot: Motion,
    files: DemFiles,
    errors: Any,
    how: Mapping[str, Any],
    *,
    margin: float,
    max_posts: int = MAX_POSTS,
) -> MapBands:
    """The accuracy map of ground points (n,) over a DEM on disk: the same as over the whole, except for rounding.

    One window holds the ground of all points, their lines of sight, and `margin` in m on each side for errors; points
    whose errors may reach farther are computed again over larger ones, up to 20 km. Points whose window would have more
    than `max_posts` are computed in halves. Raises `WindowTooLarge` for one that is too large for a single point.
    """
    files = files.forgetful()
    lat, lon = (np.asarray(x, np.float64) for x in (ground.lat, ground.lon))
    bands = np.full((4, len(lat)), np.nan, np.float32)
    told: list[MapBands] = []
    waiting = [(np.arange(len(lat)), margin)]
    while waiting:
        index, margin = waiting.pop()
        rows = np.concatenate([index, np.repeat(index[-1:], max(BLOCK - len(index), 0))])  # few sizes are compiled for
        here = Geodetic(lat=lat[rows], lon=lon[rows], height=np.zeros(len(rows)))
        try:
            dem, is_largest = _ground_of(here, sensor, shot, files, errors, how, margin, max_posts)
        except WindowTooLarge:
            if len(index) == 1:
                raise
            waiting += [(half, margin) for half in np.array_split(index, 2)]
            continue
        found = accuracy_map(sensor, shot, dem, errors, here, **how)
        own = jax.tree.map(np.asarray, found.accuracy)
        bands[:, index] = bands_of(found)[:, : len(index)]
        told.append(MapBands(bands, float(found.probability), tags_of(found)))
        beyond = reaches_beyond(own, margin)[: len(index)]
        if not is_largest and margin < LARGEST and beyond.any():
            waiting.append((index[beyond], WIDER * max(margin, SMALLEST)))
    return told[0]


def _ground_of(
    ground: Geodetic,
    sensor: Sensor,
    shot: Motion,
    files: DemFiles,
    errors: Any,
    how: Mapping[str, Any],
    margin: float,
    max_posts: int,
) -> tuple[Dem, bool]:
    """The terrain that a map of ground points needs, and whether a wider margin makes no larger one."""
    lat, lon = np.asarray(ground.lat), np.asarray(ground.lon)
    area = files.window_of_places(np.degrees(lon), np.degrees(lat))
    if area is None:  # outside the mosaic
        return load_window(files, Window(0, 0, 2, 2), False, "the map", max_posts, square_shape), True
    dem = load_window(files, area, False, "the ground of the map", max_posts, square_shape)
    context, _, request = checked_map(sensor, shot, dem, errors, **how)
    cells = projected(lat, lon, context, request)
    seen = np.flatnonzero(cells.status == Status.hit)
    if not len(seen):
        return dem, True
    path = files.follow(_lowest_rays(cells, seen, files, context))
    for posts in (files.posts_of(area, margin) + POSTS, POSTS):
        window, whole = files.window_under(path, area, posts)
        window = files.wider(area, posts) if window is None else window
        if not files.too_large(window, max_posts):
            is_largest = posts == POSTS or window.shape == files.shape
            return load_window(files, window, whole, "the map", max_posts, square_shape), is_largest
    raise files.refuse(window, max_posts, "lines of sight to the map's ground")


def _lowest_rays(cells: Cell, seen: np.ndarray, files: DemFiles, context: MapContext) -> Ray:
    """Rays from the camera to the outermost of the cells in sight, lowered to the lowest ground of all.

    From a common origin, a line of sight to lower ground is over the ground for longer: those to all cells lie between
    these rays and the cells.
    """
    assert cells.ground is not None
    lat, lon, height = (np.asarray(x)[seen] for x in (cells.ground.lat, cells.ground.lon, cells.ground.height))
    places = np.stack(files.source.mapping.rowcol(np.degrees(lon), np.degrees(lat)), axis=1)
    angle = 2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS)
    outer = np.argmax(places @ np.stack([np.cos(angle), np.sin(angle)]), axis=0)
    some = jax.tree.map(lambda leaf: np.asarray(leaf)[seen[outer]], cells)
    lowest = Geodetic(lat=lat[outer], lon=lon[outer], height=np.full(DIRECTIONS, height.min()))
    origin, direction = (np.asarray(x) for x in _rays_to(some, lowest, context))
    return Ray(origin, direction)


@long_run_filter_jit
def _rays_to(cells: Cell, ground: Geodetic, context: MapContext) -> tuple[jax.Array, jax.Array]:
    """Origins of the lines of sight of cells (n,), and directions from there to ground points."""

    def one(cell: Cell, place: Geodetic) -> tuple[jax.Array, jax.Array]:
        motion = Shot(context.motion, cell.readings) if isinstance(context.motion, Pose) else context.motion
        origin, _, _ = line_of_sight(context.sensor, motion, context.time, cell.uv)
        line = WGS84.to_ecef(place) - origin
        return origin, line / safe_norm(line)

    return jax.vmap(one)(cells, ground)
