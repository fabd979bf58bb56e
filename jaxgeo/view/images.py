"""The images of observations, and scaled copies of their files for a screen."""

from __future__ import annotations

import io
import pathlib
import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from PIL import Image

from jaxgeo.io.errors import ImageError
from jaxgeo.io.observations import Observations
from jaxgeo.io.pictures import Box, read_picture

MOST_KEPT = 64_000_000  # bytes of scaled copies
MOST_ACROSS = 2400  # columns of a scaled copy
QUALITY = 85


class ViewImage(NamedTuple):
    """An image: `index` of its exposure in a batch, its `rows` in the observations, its camera's size and position.

    `pixels` are those of the rows; `height_m` is above the ellipsoid.
    """

    name: str
    batch: int
    index: int
    rows: tuple[int, ...]
    width: int
    height: int
    lat_deg: float
    lon_deg: float
    height_m: float
    pixels: tuple[tuple[float, float], ...]


def images_of(observed: Observations) -> list[ViewImage]:
    """The images of observations: pixels of one name and pose are of one image."""
    found: dict[tuple[int, str, bytes], list[tuple[int, int]]] = {}
    for number, batch in enumerate(observed.batches):
        count = len(batch)
        leaves = [np.reshape(np.asarray(leaf, np.float64), (count, -1)) for leaf in jax.tree.leaves(batch.shots)]
        poses = np.ascontiguousarray(np.concatenate(leaves, axis=1))
        for index, row in enumerate(batch.rows.tolist()):
            key = number, str(observed.columns[row].get("name") or ""), poses[index].tobytes()
            found.setdefault(key, []).append((row, index))
    images = [_image(observed, number, name, pairs) for (number, name, _), pairs in found.items()]
    return sorted(images, key=lambda one: one.rows)


def _image(observed: Observations, number: int, name: str, pairs: Sequence[tuple[int, int]]) -> ViewImage:
    batch, index = observed.batches[number], pairs[0][1]
    position = batch.shots.pose.position
    lat, lon, height = (float(np.asarray(x)[index]) for x in (position.lat, position.lon, position.height))
    rows = tuple(row for row, _ in pairs)
    shown = name or (f"row {rows[0]}" if len(observed) > len(rows) else pathlib.Path(observed.source).name)
    size = int(batch.camera.width), int(batch.camera.height)
    uv = np.asarray(batch.observation.uv, np.float64)
    pixels = tuple((float(uv[k, 0]), float(uv[k, 1])) for _, k in pairs)
    place = float(np.rad2deg(lat)), float(np.rad2deg(lon)), height
    return ViewImage(shown, number, index, rows, *size, *place, pixels)


class Pictures:
    """Scaled copies of image files as JPEG, kept up to a number of bytes; safe for threads.

    `files` has the file of each image, or None.
    """

    def __init__(self, images: Sequence[ViewImage], files: Sequence[pathlib.Path | None]) -> None:
        self._images, self._files = images, files
        self._kept: OrderedDict[tuple[int, Box | None, int], bytes] = OrderedDict()
        self._lock = threading.Lock()

    def reason(self, image: int) -> str | None:
        """Why an image has no picture; None if it may have one."""
        file = self._files[image]
        if file is None:
            return "No image file belongs to this exposure: its frame is shown with a grid of pixels."
        return None if file.is_file() else f"{file.name}: there is no such file; the frame is shown with a grid."

    def jpeg(self, image: int, box: Box | None = None, across: int = 1600) -> bytes:
        """A part of an image as JPEG, at most `across` columns. Raises `ImageError` if it cannot be shown."""
        across = int(np.clip(across, 16, MOST_ACROSS))
        key = image, box, across
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        content = self._made(image, box, across)
        with self._lock:
            self._kept[key] = content
            while sum(map(len, self._kept.values())) > MOST_KEPT and len(self._kept) > 1:
                self._kept.popitem(last=False)
        return content

    def _made(self, image: int, box: Box | None, across: int) -> bytes:
        reason, file = self.reason(image), self._files[image]
        if reason is not None or file is None:
            raise ImageError(reason or "there is no file.")
        one = self._images[image]
        try:
            picture = read_picture(file, (one.width, one.height), box=box, across=across)
        except OSError as error:
            raise ImageError(f"{file.name}: {error.strerror or error}") from error
        buffer = io.BytesIO()
        Image.fromarray(picture, "RGB").save(buffer, "JPEG", quality=QUALITY)
        return buffer.getvalue()
