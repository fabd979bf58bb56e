"""Grey images of a block at several resolutions, of which a limited number stays in memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy  # submodules load lazily
from jaxtyping import Bool, Float

Read = Callable[[int], tuple[Any, Any]]


class Level(NamedTuple):
    """Grey values and known pixels of an image, each the mean of 2^k x 2^k pixels."""

    grey: Float[np.ndarray, "rows cols"]
    known: Bool[np.ndarray, "rows cols"]


class Pictures:
    """Images of a block, read when needed: `read(row)` gives grey values (rows, cols) or bands (bands, rows, cols), of
    any dtype, and the mask of known pixels, or None if all are. At most `most` images are kept."""

    def __init__(self, read: Read, most: int = 12) -> None:
        if most < 2:
            raise ValueError(f"most must be 2 images or more, those of a pair; got {most}.")
        self._read, self._most = read, most
        self._held: OrderedDict[int, list[Level]] = OrderedDict()

    def level(self, row: int, power: int) -> Level:
        """An image reduced by 2^power, or by as much as leaves 16 pixels on its shorter side.

        Raises `ValueError` for an array that is no image.
        """
        levels = self._levels(row)
        while len(levels) <= power and min(levels[-1].grey.shape) >= 32:
            levels.append(_halved(levels[-1]))
        return levels[min(power, len(levels) - 1)]

    def _levels(self, row: int) -> list[Level]:
        if row in self._held:
            self._held.move_to_end(row)
            return self._held[row]
        while len(self._held) >= self._most:
            self._held.popitem(last=False)
        self._held[row] = [_whole(*self._read(row))]
        return self._held[row]


def _whole(values: Any, known: Any) -> Level:
    values = np.asarray(values)
    if values.ndim == 3 and len(values) > 0:
        values = np.mean(values[:3], axis=0, dtype=np.float32)
    if values.ndim != 2 or min(values.shape) < 16:
        raise ValueError(f"an image must be (rows, cols) or (bands, rows, cols), 16 px or more; got {values.shape}.")
    known = np.ones(values.shape, bool) if known is None else np.asarray(known, bool)
    if known.shape != values.shape:
        raise ValueError(f"known must have the shape {values.shape} of its image; got {known.shape}.")
    known = known & np.isfinite(values)
    return Level(np.where(known, values, 0).astype(np.float32), known)


def _halved(level: Level) -> Level:
    rows, cols = (side // 2 for side in level.grey.shape)
    parts = (slice(0, 2 * rows, 2), slice(1, 2 * rows, 2)), (slice(0, 2 * cols, 2), slice(1, 2 * cols, 2))
    grey, known = np.zeros((rows, cols), np.float32), np.ones((rows, cols), bool)
    for down in parts[0]:
        for across in parts[1]:
            grey += level.grey[down, across]
            known &= level.known[down, across]
    return Level(0.25 * grey, known)


def sample(level: Level, uv: Float[np.ndarray, "*shape 2"], power: int) -> tuple[np.ndarray, np.ndarray]:
    """(bilinear grey values, known) at pixels of the whole image, of a level reduced by 2^power; zero where unknown."""
    where = [(uv[..., axis] + 0.5) / 2**power - 0.5 for axis in (1, 0)]
    rows, cols = level.grey.shape
    on = (where[0] >= 0.0) & (where[0] <= rows - 1.0) & (where[1] >= 0.0) & (where[1] <= cols - 1.0)  # False for NaN
    where = [np.where(on, one, 0.0) for one in where]
    values = scipy.ndimage.map_coordinates(level.grey, where, order=1)
    if not level.known.all():
        on &= scipy.ndimage.map_coordinates(level.known.astype(np.float32), where, order=1) > 0.999
    return np.where(on, values, 0.0), on
