"""Interface of keypoints with descriptors, and the keypoints of whole images."""

from __future__ import annotations

import abc
from collections import OrderedDict
from typing import Any, NamedTuple

import numpy as np

from jaxgeo.ties.interest import cell_of
from jaxgeo.ties.pictures import Level, Pictures

TILE, BORDER = 1024, 64  # px: sides of the parts of an image that are searched at a time, and what is added around them
IN_CELL = 40  # keypoints kept of each cell of the grid of points, the strongest
HELD = 64  # images whose keypoints are kept in memory
SAME = 1e-3  # px: a point and a keypoint no further apart are the same


class Keypoints(NamedTuple):
    """n keypoints: `uv` (n, 2) in px, (column, row) with pixel centres at integers; `descriptors` (n, d), numbers or
    bit strings (d bytes as uint8, compared bit by bit); `strength` (n,), larger for those to prefer."""

    uv: np.ndarray
    descriptors: np.ndarray
    strength: np.ndarray


class AbstractFeatures(abc.ABC):
    """Detector and descriptor of keypoints, for `find_ties(..., features=...)`.

    A detector of one's own, such as a learned one, is a class with one method. Make it a frozen dataclass:
    `KeptMatches` tells results of different settings apart by its `repr`, and keeps none of a class that has no `repr`
    of its own.

    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from jaxgeo.ties import AbstractFeatures, Keypoints
    >>> @dataclass(frozen=True)
    ... class Brightest(AbstractFeatures):
    ...     "Brightest pixels, with the grey values around them: a stand-in for a network."
    ...     side: int = 7
    ...
    ...     def find(self, grey, known):
    ...         windows = np.lib.stride_tricks.sliding_window_view(grey, (self.side, self.side))
    ...         half = self.side // 2
    ...         centre = windows[:, :, half, half]
    ...         rows, cols = np.nonzero((centre == windows.max(axis=(2, 3))) & (centre > 0.0))
    ...         descriptors = windows[rows, cols].reshape(len(rows), -1)
    ...         return Keypoints(np.stack([cols, rows], axis=1) + half, descriptors, centre[rows, cols])
    >>> grey = np.zeros((32, 48), np.float32)
    >>> grey[12, 20] = 5.0
    >>> found = Brightest().find(grey, np.ones((32, 48), bool))
    >>> found.uv.tolist(), found.strength.tolist(), found.descriptors.shape
    ([[20, 12]], [5.0], (1, 49))
    """

    @abc.abstractmethod
    def find(self, grey: np.ndarray, known: np.ndarray) -> Keypoints:
        """Keypoints of a part of an image: `grey` (rows, cols) float32, zero where it is not `known` (rows, cols)."""


class ImageKeypoints:
    """Keypoints of the images of a block, found when needed; the strongest in each cell of a grid of about `points`
    cells, in descending order."""

    def __init__(self, pictures: Pictures, features: AbstractFeatures, points: int) -> None:
        self.features = features
        self._pictures, self._points = pictures, points
        self._held: OrderedDict[int, Keypoints] = OrderedDict()

    def of(self, row: int) -> Keypoints:
        """Those of an image, in its pixels; descriptors are unit vectors, whose products are correlations.

        Raises `ValueError` for what are no keypoints.
        """
        if row in self._held:
            self._held.move_to_end(row)
            return self._held[row]
        while len(self._held) >= HELD:
            self._held.popitem(last=False)
        self._held[row] = self._found(self._pictures.level(row, 0))
        return self._held[row]

    def points(self, row: int) -> tuple[np.ndarray, np.ndarray]:
        """(pixels (n, 2), number (n,) of the cell of each) of the strongest keypoint of each cell."""
        uv, shape = self.of(row).uv, self._pictures.level(row, 0).grey.shape
        cells, first = np.unique(cell_of(uv, shape, self._points), return_index=True)
        return uv[first], cells

    def _found(self, level: Level) -> Keypoints:
        rows, cols = level.grey.shape
        parts = [
            _of_tile(self.features, level, top, left) for top in range(0, rows, TILE) for left in range(0, cols, TILE)
        ]
        parts = [one for one in parts if len(one.uv)]
        if not parts:
            return Keypoints(np.zeros((0, 2)), np.zeros((0, 1), np.float32), np.zeros(0))
        uv, descriptors, strength = (np.concatenate(one) for one in zip(*parts, strict=True))
        order = np.argsort(-strength, kind="stable")
        kept = order[_rank(cell_of(uv[order], (rows, cols), self._points)) < IN_CELL]
        return Keypoints(uv[kept], unit_vectors(descriptors[kept]), strength[kept])


def unit_vectors(descriptors: np.ndarray) -> np.ndarray:
    """Descriptors (n, d) as unit vectors, float32: of numbers less their mean, or of bits as -1 and 1.

    Their products are correlations; of bits, one less twice the share of bits that differ.
    """
    if descriptors.dtype == np.uint8:
        values = 2.0 * np.unpackbits(descriptors, axis=1).astype(np.float32) - 1.0
    else:
        values = descriptors.astype(np.float32)
        values = values - np.mean(values, axis=1, keepdims=True)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    return values / np.where(length > 0.0, length, 1.0)


def _of_tile(features: AbstractFeatures, level: Level, top: int, left: int) -> Keypoints:
    """Keypoints in a tile, in pixels of the image; the features see a border around it."""
    first = np.array([max(left - BORDER, 0), max(top - BORDER, 0)])
    part = np.s_[first[1] : top + TILE + BORDER, first[0] : left + TILE + BORDER]
    grey, known = level.grey[part], level.known[part]
    found = _checked(features, features.find(np.ascontiguousarray(grey), np.ascontiguousarray(known)), grey.shape)
    col, row = np.rint(found.uv).astype(int).T
    uv = found.uv + first
    inside = np.all((uv >= (left - 0.5, top - 0.5)) & (uv < (left + TILE - 0.5, top + TILE - 0.5)), axis=1)
    inside &= known[np.clip(row, 0, known.shape[0] - 1), np.clip(col, 0, known.shape[1] - 1)]
    return Keypoints(uv[inside], found.descriptors[inside], found.strength[inside])


def _checked(features: AbstractFeatures, found: Any, shape: tuple[int, ...]) -> Keypoints:
    name = type(features).__name__
    if not isinstance(found, Keypoints):
        raise ValueError(f"{name}.find must return jaxgeo.ties.Keypoints; got {type(found).__name__}.")
    uv, descriptors, strength = np.asarray(found.uv, float), np.asarray(found.descriptors), np.asarray(found.strength)
    n = len(uv)
    if uv.shape != (n, 2) or descriptors.ndim != 2 or len(descriptors) != n or strength.shape != (n,):
        raise ValueError(
            f"{name}.find must return uv (n, 2), descriptors (n, d) and strength (n,); got {uv.shape}, "
            f"{descriptors.shape} and {strength.shape}."
        )
    limit = np.array(shape[::-1]) - 0.5
    if not (np.all(np.isfinite(descriptors)) and np.all(np.isfinite(strength))):
        raise ValueError(f"{name}.find returned descriptors or strengths that are not numbers.")
    if not np.all((uv >= -0.5) & (uv <= limit)):
        k = int(np.argmin(np.all((uv >= -0.5) & (uv <= limit), axis=1)))
        raise ValueError(
            f"{name}.find returned the keypoint {uv[k].tolist()} (column, row) outside of its part of {shape[1]} x "
            f"{shape[0]} px."
        )
    return Keypoints(uv, descriptors, strength)


def _rank(cells: np.ndarray) -> np.ndarray:
    """Number of earlier entries (n,) of the same cell."""
    order = np.argsort(cells, kind="stable")
    ordered = cells[order]
    starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]]) if len(cells) else np.zeros(0, int)
    rank = np.empty(len(cells), int)
    rank[order] = np.arange(len(cells)) - np.repeat(starts, np.diff(np.r_[starts, len(cells)]))
    return rank
