"""Image reader: bands of a raster file in its own dtype, and the mask of known pixels."""

from __future__ import annotations

import operator
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.io import DatasetReader
from rasterio.windows import Window

from jaxgeo.io._deflate import damaged_block
from jaxgeo.io._gdal import refused_as
from jaxgeo.io._memory_at_hand import check_fits
from jaxgeo.io._rasters import open_raster
from jaxgeo.io.errors import ImageError
from jaxgeo.io.reach import HERE, Reach
from jaxgeo.sensor.camera import AbstractCamera

Bands = int | Sequence[int] | Any | None
BESIDE_VALUES = 3  # bytes per pixel for the masks of known pixels
CLOSE = 0.005  # relative tolerance of the aspect ratio of resized images


def read_image(
    path: str | os.PathLike[str], bands: Bands = None, *, allow_remote: bool = False, allow_outside: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """An image in sensor orientation: values (bands, rows, cols) in the file's dtype, and known pixels (rows, cols).

    `bands` count from 1; by default all but an alpha band. A pixel is unknown where a mask or an alpha band marks it,
    where all colours have the file's nodata value, and where a value is NaN or infinite, which is then read as
    zero. A dark pixel, zero in one band of several, is known.

    Georeferencing in the file is ignored: frames often carry a rough or wrong geotransform. So is an orientation flag
    of EXIF or TIFF, since pixels are counted in the sensor's axes.

    `allow_remote` and `allow_outside`: as in `read_dem`.

    Raises `ImageError` for a folder, a file that is damaged or not an image, missing bands, complex numbers,
    a palette, and an image without known pixels; `FileNotFoundError`.
    """
    name = os.fspath(path)
    with opened(name, Reach(allow_remote, allow_outside)) as data, refused_as(ImageError, name, "it"):
        return read_bands(name, data, chosen_bands(name, data, bands))


def check_size(name: str, shape: Sequence[int], camera: AbstractCamera | Any) -> None:
    """Raises `ImageError` unless an image (..., rows, cols) has the size of a camera; `name` is the file's.

    Cameras without a size accept any image.
    """
    width, height = (getattr(camera, side, None) for side in ("width", "height"))
    rows, cols = shape[-2:]
    if width is None or height is None or (rows, cols) == (height, width):
        return
    across, down = cols / width, rows / height
    mismatch = f"{name}: the image has {cols} columns and {rows} rows, the camera of the scene {width} and {height}"
    if abs(across / down - 1.0) < CLOSE:
        raise ImageError(
            f"{mismatch}. If it is the camera's image at {across:.6g} times its size, scale the camera too: width, "
            f"height, focal length and principal point in pixels; else it belongs to another scene."
        )
    if abs((rows / width) / (cols / height) - 1.0) < CLOSE:
        raise ImageError(f"{mismatch}: it seems to be turned by a quarter. Give the image as the sensor has it.")
    raise ImageError(f"{mismatch}. It is cut, or belongs to another scene; name the scene of this image.")


def opened(name: str, reach: Reach = HERE) -> DatasetReader:
    """Open an image file. Raises as `read_image`."""
    if os.path.isdir(name):
        raise ImageError(f"{name}: this is a folder; give the image in it.")
    return open_raster(name, reach, ImageError, "an image")


def chosen_bands(name: str, data: DatasetReader, bands: Bands) -> list[int]:
    """The numbers of the requested bands, from 1. Raises `ImageError`."""
    if not data.count:
        inside = f"it holds {len(data.subdatasets)} images; name one: {data.subdatasets[0]}" if data.subdatasets else ""
        raise ImageError(f"{name}: there are no bands; {inside or 'it is no image'}.")
    chosen = _numbers(name, data, bands)
    for band in chosen:
        if not 1 <= band <= data.count:
            raise ImageError(f"{name}: there is no band {band}; the file has bands 1 to {data.count}.")
        if "complex" in data.dtypes[band - 1]:
            raise ImageError(
                f"{name}: band {band} holds complex numbers ({data.dtypes[band - 1]}); write their amplitude first."
            )
        if data.colorinterp[band - 1] == ColorInterp.palette:
            raise ImageError(
                f"{name}: band {band} holds numbers of a palette, not brightness; expand it first "
                f"(gdal_translate -expand rgb)."
            )
    kinds = sorted({data.dtypes[band - 1] for band in chosen})
    if len(kinds) > 1:
        raise ImageError(
            f"{name}: its bands are of different types ({', '.join(kinds)}); choose those of one with bands=."
        )
    return chosen


def read_bands(
    name: str, data: DatasetReader, bands: Sequence[int], window: Window | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Values and known mask, as in `read_image`, of a window of an open file. Raises `ImageError`."""
    part = _part(window) if window else "it"
    _check_fits(name, data, bands, window)
    with refused_as(ImageError, name, part):
        damaged = damaged_block(data, bands, window, set())
        if damaged:
            raise ImageError(f"{name}: the file is damaged: {damaged}.")
        values = data.read(list(bands), window=window)
        known = _known(data, window)
    if values.dtype.kind == "f":
        finite = np.isfinite(values)
        _check_bands(name if window is None else f"{name}: {_part(window)}", bands, finite)
        known &= finite.all(axis=0)
        values[~finite] = 0.0
    if not known.any():
        where = _part(window) if window else "the whole image"
        raise ImageError(
            f"{name}: {where}: no pixel is known; all are nodata ({data.nodata}), masked or not finite. If they are an "
            f"image all the same, correct the nodata value of the file (gdal_edit -unsetnodata)."
        )
    return values, known


def _check_fits(name: str, data: DatasetReader, bands: Sequence[int], window: Window | None) -> None:
    """Raises `ImageError` where values and known mask do not fit into memory."""
    rows, cols = data.shape if window is None else (window.height, window.width)
    each = np.dtype(data.dtypes[bands[0] - 1])
    beside = BESIDE_VALUES + (len(bands) if each.kind == "f" else 0)
    check_fits(
        rows * cols * (len(bands) * each.itemsize + beside),
        ImageError,
        f"{name}: too large: {rows:,} x {cols:,} pixels of {len(bands)} bands",
        "Choose fewer bands with bands=; of an orthoimage, a part with bounds=, or cut one out (gdal_translate "
        "-projwin).",
    )


def _part(window: Window) -> str:
    rows = f"rows {window.row_off} to {window.row_off + window.height}"
    return f"{rows}, columns {window.col_off} to {window.col_off + window.width}"


def _check_bands(name: str, bands: Sequence[int], finite: np.ndarray) -> None:
    """Raises `ImageError` if some bands, but not all, have no finite value: they would make all pixels unknown."""
    sound = [band for band, is_finite in zip(bands, finite, strict=True) if is_finite.any()]
    empty = [band for band in bands if band not in sound]
    if not (sound and empty):
        return
    bands_are = f"band {empty[0]} is" if len(empty) == 1 else f"bands {', '.join(map(str, empty))} are"
    wish = " ".join(f"--band {band}" for band in sound)
    raise ImageError(
        f"{name}: {bands_are} nowhere finite, and a pixel is known only where all its bands are. Choose the others: "
        f"bands={sound}, on the command line {wish} (of a reference --reference-band)."
    )


def _numbers(name: str, data: DatasetReader, bands: Bands) -> list[int]:
    colours = _colours(data)
    if bands is None:
        if not colours:
            raise ImageError(f"{name}: its only band is an alpha band; there is no image in it.")
        return colours
    try:
        chosen = [operator.index(band) for band in (bands if isinstance(bands, Sequence | np.ndarray) else [bands])]
    except TypeError as error:
        raise ImageError(f"{name}: bands must be whole numbers from 1; got {bands!r}.") from error
    if not chosen:
        raise ImageError(f"{name}: no band is asked for; bands= takes one or more of 1 to {data.count}, or None.")
    return chosen


def _colours(data: DatasetReader) -> list[int]:
    """The bands that are not alpha."""
    return [band for band, kind in zip(data.indexes, data.colorinterp, strict=True) if kind != ColorInterp.alpha]


def _known(data: DatasetReader, window: Window | None) -> np.ndarray:
    """Known pixels: nodata must be in all colours, whichever of them are read."""
    shape = data.shape if window is None else (window.height, window.width)
    known = np.zeros(shape, bool)
    for band in _colours(data) or data.indexes:
        known |= data.read_masks(band, window=window) != 0
        if MaskFlags.nodata not in data.mask_flag_enums[band - 1]:  # one mask for all, or none
            break
    for band, kind in zip(data.indexes, data.colorinterp, strict=True):
        if kind == ColorInterp.alpha:  # GDAL's mask uses it for 8- and 16-bit files only
            known &= data.read(band, window=window) != 0
    return known
