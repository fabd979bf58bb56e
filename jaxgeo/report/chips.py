"""Chips of image files around located pixels, embedded in a page."""

from __future__ import annotations

import base64
import io
import os
from typing import NamedTuple

import numpy as np
from PIL import Image

from jaxgeo.io.errors import ImageError
from jaxgeo.io.pictures import read_picture

SIDE = 240  # pixels of a chip
QUALITY = 80
MOST = 6  # chips of a page, so that its size is bounded: 20 kB each


class Chip(NamedTuple):
    """A part of an image: `source` is a data URI, the pixel is at `left` and `top` in percent of its size."""

    source: str
    width: int
    height: int
    left: float
    top: float


def chip_of(path: str | os.PathLike[str], size: tuple[int, int], uv: tuple[float, float]) -> Chip | None:
    """The image around a pixel; None for one outside it, and for a file that cannot be shown.

    `size` is (columns, rows) of the camera.
    """
    place = np.asarray(uv, np.float64) + 0.5  # on pixel edges
    whole = np.asarray(size, np.float64)
    if not np.all((place >= 0.0) & (place <= whole)):
        return None
    extent = np.minimum(SIDE, whole)
    low = np.clip(np.round(place - 0.5 * extent), 0.0, whole - extent)
    left, top, right, bottom = (float(edge) for edge in (*low, *(low + extent)))
    try:
        picture = read_picture(path, size, box=(left, top, right, bottom), across=SIDE)
    except (ImageError, OSError):
        return None
    buffer = io.BytesIO()
    Image.fromarray(picture, "RGB").save(buffer, "JPEG", quality=QUALITY)
    source = f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode()}"
    across, down = 100.0 * (place - low) / extent
    return Chip(source, int(extent[0]), int(extent[1]), float(across), float(down))
