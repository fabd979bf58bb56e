"""Accuracy map of a large area in tiles, a file each, with a mosaic and a STAC catalogue."""

from __future__ import annotations

import functools
import os
import pathlib
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import check_is, require_x64
from jaxgeo._digest import digest_of
from jaxgeo._parallel import Work
from jaxgeo.cluster.catalogue import (
    CELLS,
    KNOWN,
    compute_and_list,
    mosaic_file,
    write_catalogue,
    write_item,
    write_mosaics,
)
from jaxgeo.cluster.frames import MARGIN, Ground, check_seen
from jaxgeo.cluster.parts import Parts, Run
from jaxgeo.io.accuracy_map import UNITS, band_names, centres_of, write_bands
from jaxgeo.io.accuracy_over_files import area_raster, check_map, map_in_memory, map_over_files
from jaxgeo.io.files import DemFiles
from jaxgeo.io.map_raster import MapRaster
from jaxgeo.io.vrt_writer import Bands
from jaxgeo.io.windows import Bounds
from jaxgeo.sensor import Pose, Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.uncertainty import ErrorModel
from jaxgeo.uncertainty.sampling import accepts_sampling_options

KIND = "accuracy map"
TILE = 512  # cells on a side


class Setting(NamedTuple):
    """What all tiles have in common."""

    folder: pathlib.Path
    sensor: Sensor
    shot: Shot | Trajectory | Pose
    ground: Ground
    errors: Any
    options: dict[str, Any]
    margin: float
    cog: bool
    taken: datetime | None


@accepts_sampling_options
def accuracy_map(
    folder: str | os.PathLike[str],
    sensor: Sensor,
    shot: Shot | Trajectory | Pose,
    terrain: Ground,
    errors: ErrorModel | Any,
    *,
    client: Any = None,
    crs: Any = None,
    bounds: Bounds | None = None,
    resolution: float | int | tuple[float | int, float | int] | None = None,
    tile: int = TILE,
    margin: float = MARGIN,
    cog: bool = True,
    taken: datetime | None = None,
    progress: bool = False,
    **how: Any,
) -> Run:
    """The map of `jaxgeo.io.write_accuracy_map` in tiles, each a GeoTIFF in `folder`, with a mosaic and a catalogue.

    - `terrain`: in memory, or a DEM on disk (`jaxgeo.io.open_dem`): each tile reads a window of it, with the ground of
      its cells, the lines of sight to them, and `margin` in m on each side for errors. Where errors may reach farther,
      the window of these cells is enlarged, up to 20 km; samples that leave it count as samples without a fix.
    - `client`: a Dask `Client` (`connect`), any `concurrent.futures.Executor`, or None for this process. The results do
      not depend on it, except that rounding may differ between kinds of processors.
    - `crs`, `bounds`, `resolution`, `cog`: as for `write_accuracy_map`, of any number of cells.
    - `tile`: cells on a side of a tile, at most.
    - `taken`: time of the image, with a time zone, for the catalogue.
    - `how`: other options of `jaxgeo.uncertainty.accuracy_map`: `probability`, `sampling`, `time`, ...

    The tile of row i and column j is `tile-0000i-0000j.tif`, beside its STAC item (.json); all have the bands of
    `write_accuracy_map`. `mosaic.vrt` is the whole map; `collection.json` and `items.json` list all items. A Dask
    client needs the extra `cluster`.

    Figures are those of `write_accuracy_map` except for rounding; a cell whose centre lies on the edge of two facets of
    the terrain, as many do at its own spacing, may take the slope of either.

    Workers write into `folder`, which all must see. A later call with the same arguments computes only missing tiles.
    `Run.counts` counts cells by status. Raises `PartsFailed` if tiles could not be computed, after the others are;
    `ValueError` for arguments that contradict each other, and a folder that holds something else; otherwise as
    `write_accuracy_map`.
    """
    require_x64()
    check_is(sensor, Sensor, "sensor")
    if isinstance(tile, bool) or not isinstance(tile, int | np.integer) or tile < 1:
        raise ValueError(f"tile must be a whole number of cells, 1 or more; got {tile!r}.")
    if not (np.isfinite(margin) and margin >= 0.0):
        raise ValueError(f"margin must be a distance in m, 0 or more; got {margin!r}.")
    if taken is not None and taken.tzinfo is None:
        raise ValueError(f"taken must have a time zone; got {taken}.")
    where = pathlib.Path(folder).absolute()
    check_map(sensor, shot, terrain, errors, how)
    raster = area_raster(f"{where}", sensor, shot, terrain, crs, bounds, resolution, how)
    setting = Setting(where, sensor, shot, terrain, errors, how, float(margin), cog, taken)
    each = tiles_of(raster, int(tile))
    parts = Parts(where, KIND, _identity(setting, raster, int(tile)), tuple(each))
    missing = parts.open()
    given = {name: each[name] for name in missing}
    finish = functools.partial(_finish, where, raster.crs)
    work = Work(_tiles, setting)
    return compute_and_list(parts, given, work, client, progress, finish, lambda one: int(np.prod(one.shape)))


def tiles_of(raster: MapRaster, side: int) -> dict[str, MapRaster]:
    """The tiles of a raster by file name, of `side` cells on a side, fewer at its end."""
    rows, cols = raster.shape
    found = {}
    for i, row in enumerate(range(0, rows, side)):
        for j, col in enumerate(range(0, cols, side)):
            shape = min(side, rows - row), min(side, cols - col)
            found[f"tile-{i:05d}-{j:05d}.tif"] = raster.part(row, col, shape)
    return found


def _identity(setting: Setting, raster: MapRaster, side: int) -> dict[str, str]:
    """What results depend on, by name."""
    ground, (rows, cols) = setting.ground, raster.shape
    return {
        "view": digest_of((setting.sensor, setting.shot)),
        "errors": digest_of(setting.errors),
        "terrain": digest_of(ground.identity if isinstance(ground, DemFiles) else ground),
        "crs": raster.crs.to_string(),
        "cells": f"{rows} x {cols}, transform {tuple(raster.transform[:6])}",
        "options": digest_of((setting.options, setting.cog, setting.taken and setting.taken.isoformat())),
        "tile": f"{side}",
        "margin": f"{setting.margin:g} m",
    }


def _tiles(setting: Setting) -> Callable[[tuple[str, MapRaster]], dict[str, int]]:
    return functools.partial(_map_tile, setting)


def _map_tile(setting: Setting, item: tuple[str, MapRaster]) -> dict[str, int]:
    """Compute and write the item of a tile, then its file; returns the count of each status by name."""
    name, raster = item
    check_seen(setting.folder)
    path = setting.folder / name
    cells = centres_of(f"{path}", raster)
    ground = jax.tree.map(jnp.ravel, cells)
    view = setting.sensor, setting.shot
    if isinstance(setting.ground, DemFiles):
        found = map_over_files(ground, *view, setting.ground, setting.errors, setting.options, margin=setting.margin)
    else:
        found = map_in_memory(ground, *view, setting.ground, setting.errors, setting.options)
    counts = Counter(Status(int(code)).name for code in found.bands[3])
    bands = Bands(4, "float32", float("nan"), band_names(found.probability), UNITS)
    told = {CELLS: dict(counts), KNOWN: int(np.isfinite(found.bands[:2]).all(axis=0).sum())}
    item_path = path.with_suffix(".json")
    write_item(item_path, {"accuracy": (name, bands)}, raster, told, setting.taken, cog=setting.cog)
    write_bands(path, found.bands.reshape(4, *raster.shape), raster, found.probability, found.tags, setting.cog)
    return dict(counts)


def _finish(folder: pathlib.Path, crs: Any, names: Sequence[str]) -> None:
    """Write the catalogue and the mosaic."""
    items = [pathlib.Path(name).with_suffix(".json").name for name in names]
    each = write_catalogue(folder, items, "Accuracy map by jaxgeo, in tiles.")
    write_mosaics(folder, [found for one in each if (found := mosaic_file(one, "accuracy", crs)) is not None])
