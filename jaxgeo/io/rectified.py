"""Orthorectification from file to file, tile by tile, for results larger than memory."""

from __future__ import annotations

import inspect
import os
import pathlib
import sys
from typing import Any, NamedTuple

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo._destination import check_no_input
from jaxgeo.io.errors import NothingSeen
from jaxgeo.io.images import Bands, check_size, read_image
from jaxgeo.io.map_raster import MapRaster, checked_target, grid_of, image_spacing, raster_of
from jaxgeo.io.ortho_writer import OrthoWriter
from jaxgeo.io.orthoimages import raster_of_file
from jaxgeo.io.paths import files_behind
from jaxgeo.io.reach import Reach
from jaxgeo.io.windows import Bounds
from jaxgeo.ortho.interpolation import AbstractInterpolation
from jaxgeo.ortho.rectification import BILINEAR, TILE, Rectifier, Tile, tiles_of
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.host_arrays import with_bar


class RectifiedFile(NamedTuple):
    """Result of `rectify_file`: the raster, the number of cells with image data, and the count of each `Status`."""

    path: str
    raster: MapRaster
    known: int
    counts: dict[Status, int]


class _Counts:
    """Counts of cells by status, and of known cells."""

    def __init__(self) -> None:
        self.known, self.codes = 0, np.zeros(256, np.int64)

    def add(self, tile: Tile) -> None:
        self.known += int(np.count_nonzero(tile.known))
        self.codes += np.bincount(np.asarray(tile.status).astype(np.uint8).ravel(), minlength=256)

    def named(self) -> dict[Status, int]:
        return {one: int(self.codes[int(one)]) for one in Status if self.codes[int(one)]}


def status_file(target: pathlib.Path) -> pathlib.Path:
    """The status file beside an orthoimage, with the codes of its cells."""
    return target.with_name(f"{target.stem}_status{target.suffix}")


def rectify_file(
    path: str | os.PathLike[str],
    image: str | os.PathLike[str],
    sensor: Sensor,
    shot: Shot | Trajectory,
    terrain: AbstractTerrain,
    *,
    crs: Any = None,
    bounds: Bounds | None = None,
    resolution: float | int | tuple[float | int, float | int] | None = None,
    like: str | os.PathLike[str] | MapRaster | None = None,
    bands: Bands = None,
    interpolation: AbstractInterpolation = BILINEAR,
    cog: bool = False,
    status: bool = False,
    progress: bool = False,
    allow_remote: bool = False,
    allow_outside: bool = False,
    **how: Any,
) -> RectifiedFile:
    """Orthorectify an image file and write it to a GeoTIFF, in the image's dtype.

    - `crs`: anything pyproj takes; by default the UTM zone, or UPS, at the centre of the visible ground.
    - `bounds`: (west, south, east, north) in the unit of that CRS; by default the visible ground of the image.
    - `resolution`: cell size, or (across, down), in the same unit; by default the GSD at the
      image centre.
    - `like`: the file or raster of another orthoimage, whose cells to use instead of the three.
    - `bands` of the image, by default all but alpha; `cog` makes a cloud-optimised GeoTIFF.
    - `status`: also a file `*_status.tif` beside it, with the code of the `Status` of each cell: `hit` where the image
      shows it (unless the image is unknown there), or the reason why not. Its tags list the codes.
    - `progress` shows a bar, on a terminal. `allow_remote`, `allow_outside`: of the rasters read, as in `read_dem`.

    Others (`hidden_tolerance`, `mask_hidden`, `time`, `atmosphere`) and errors as for `jaxgeo.ortho.rectify`. Cells
    on hidden ground and outside the image are unknown. Files appear only when complete.
    Raises `ImageError` for the image, also if its size is not the camera's; `ValueError` for a raster that
    is invalid, contains nothing of the image, or is too large for a file, and if the image or `like` would be
    overwritten; `FileNotFoundError`, `OSError` where it cannot be written.
    """
    target = checked_target(path, "an orthoimage")
    check_is(sensor, Sensor, "sensor")
    check_is(interpolation, AbstractInterpolation, "interpolation")
    inspect.signature(Rectifier).bind(sensor, shot, None, None, terrain, None, **how)  # `TypeError` for other options
    beside = status_file(target)
    reach = Reach(allow_remote, allow_outside)
    read = [image] if like is None or isinstance(like, MapRaster) else [image, like]
    check_no_input(
        "path", [target, beside] if status else [target], [file for one in read for file in files_behind(one, reach)]
    )
    values, known = read_image(image, bands, allow_remote=allow_remote, allow_outside=allow_outside)
    check_size(os.fspath(image), values.shape, sensor.camera)
    raster = _raster(f"{target}", sensor, shot, terrain, (crs, bounds, resolution), like, how, reach)
    grid = grid_of(raster, f"{target}")
    rectifier = Rectifier(sensor, shot, values, known, terrain, grid, interpolation=interpolation, **how)
    tags = {"INTERPOLATION": type(interpolation).__name__, "IMAGE": pathlib.Path(image).name}
    with OrthoWriter(target, raster, bands=values.shape[0], dtype=values.dtype, cog=cog, tags=tags) as sink:
        if status:
            codes = {"STATUS_CODES": " | ".join(f"{int(one)}: {one.message.rstrip('.')}" for one in Status)}
            with OrthoWriter(beside, raster, bands=1, dtype=np.int8, cog=cog, tags=codes) as codes_sink:
                counts = _written(rectifier, raster, progress, sink, codes_sink)
        else:
            counts = _written(rectifier, raster, progress, sink, None)
    return RectifiedFile(f"{target}", raster, counts.known, counts.named())


def _raster(
    name: str,
    sensor: Sensor,
    shot: Shot | Trajectory,
    terrain: AbstractTerrain,
    asked: tuple[Any, Any, Any],
    like: Any,
    how: dict[str, Any],
    reach: Reach,
) -> MapRaster:
    if like is None:
        return raster_of(
            name, sensor, shot, terrain, *asked, how, lambda: image_spacing(name, sensor, shot, terrain, how)
        )
    if any(one is not None for one in asked):
        raise ValueError(f"{name}: like= says where the cells are; leave out crs=, bounds= and resolution=.")
    return like if isinstance(like, MapRaster) else raster_of_file(like, reach)


def _written(
    rectifier: Rectifier, raster: MapRaster, progress: bool, sink: OrthoWriter, codes_sink: OrthoWriter | None
) -> _Counts:
    """Write all tiles. Raises `NothingSeen` if none contains anything of the image."""
    counts = _Counts()
    total = int(np.prod([-(-n // TILE) for n in raster.shape]))
    tiles = tiles_of(rectifier, raster.shape)
    for (rows, cols), tile in with_bar(tiles, total, "rectifying", progress and sys.stdout.isatty()):
        counts.add(tile)
        sink.write(rows.start, cols.start, tile.values, tile.known)
        if codes_sink is not None:
            codes_sink.write(rows.start, cols.start, tile.status[None])
    if not counts.known:
        why = ", ".join(f"{count} {one.name}" for one, count in counts.named().items())
        raise NothingSeen(
            f"{sink.target}: the image shows none of the {raster.shape[0]} x {raster.shape[1]} cells ({why}); nothing "
            f"is written. Look at the pose, and at bounds= or like=."
        )
    return counts
