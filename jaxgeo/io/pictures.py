"""Pictures of image files for a screen: scaled parts in 8 bits, whatever the file's type and size."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from rasterio.enums import Resampling
from rasterio.windows import Window

from jaxgeo.io._gdal import refused_as
from jaxgeo.io.errors import ImageError
from jaxgeo.io.images import CLOSE, chosen_bands, opened
from jaxgeo.io.reach import HERE, Reach

Box = tuple[float, float, float, float]
OVERVIEW = 512  # columns of the image from which the stretch of values is taken
STRETCHED = (0.5, 99.5)  # percentiles of values that are not 8 bits, shown as black and white


def read_picture(
    path: str | os.PathLike[str],
    size: tuple[int, int],
    *,
    box: Box | None = None,
    across: int = 1600,
    reach: Reach = HERE,
) -> np.ndarray:
    """A part of an image scaled to at most `across` columns: (rows, cols, 3), 8 bits.

    `size` is (columns, rows) of the camera; the file may hold the image at another size with the same aspect ratio.
    `box` is (left, top, right, bottom) on the camera's pixel edges, from 0 to `size`; by default all of it. Values of
    other types are stretched linearly between percentiles of the whole image. Pixels are those of the sensor: an
    orientation flag is ignored.

    Raises `ImageError` for a file that is no image, for another aspect ratio, and as `read_image`.
    """
    name = os.fspath(path)
    with opened(name, reach) as data, refused_as(ImageError, name, "it"):
        bands = chosen_bands(name, data, None)
        bands = bands[:3] if len(bands) >= 3 else bands[:1]
        width, height = size
        across_by, down_by = data.width / width, data.height / height
        if abs(across_by / down_by - 1.0) > CLOSE:
            raise ImageError(
                f"{name}: the image has {data.width} columns and {data.height} rows, the camera {width} and {height}; "
                f"it is turned, cut, or of another camera."
            )
        left, top, right, bottom = (0.0, 0.0, float(width), float(height)) if box is None else box
        columns, rows = max((right - left) * across_by, 1.0), max((bottom - top) * down_by, 1.0)
        window: Any = Window(left * across_by, top * down_by, columns, rows)  # pyright: ignore[reportCallIssue]
        scale = min(1.0, across / columns)
        shape = len(bands), max(round(rows * scale), 1), max(round(columns * scale), 1)
        way = Resampling.average if scale < 1.0 else Resampling.nearest
        values = data.read(bands, window=window, out_shape=shape, resampling=way)
    if values.dtype != np.uint8:
        low, high = _value_range(name, reach)
        with np.errstate(invalid="ignore"):
            values = np.nan_to_num((values.astype(np.float64) - low) / max(high - low, 1e-12))
        values = np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
    picture = np.moveaxis(values, 0, -1)
    return np.ascontiguousarray(np.broadcast_to(picture, (*picture.shape[:2], 3)))


def _value_range(name: str, reach: Reach) -> tuple[float, float]:
    """The values shown as black and as white: percentiles of a scaled copy. Raises as `read_image`."""
    with opened(name, reach) as data, refused_as(ImageError, name, "it"):
        bands = chosen_bands(name, data, None)
        scale = min(1.0, OVERVIEW / data.width)
        shape = len(bands), max(round(data.height * scale), 1), max(round(data.width * scale), 1)
        values = data.read(bands, out_shape=shape).astype(np.float64)
        if data.nodata is not None:
            values[values == data.nodata] = np.nan
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = np.percentile(known, STRETCHED)
    return float(low), float(high)
