"""Points of an image for matching: the best texture of each cell of a grid."""

from __future__ import annotations

import numpy as np
import scipy  # submodules load lazily

from jaxgeo.ties.pictures import Level

SIDE = 512  # px: longer side, at least, of the reduced image in which texture is measured
SMOOTH = 1.5  # px of it: standard deviation of the window of the structure tensor
EDGE = 0.15  # of a cell: points keep this distance from its sides, and so from each other


def power_for(shape: tuple[int, int]) -> int:
    """Power of two by which an image is reduced to measure its texture."""
    return max(int(np.floor(np.log2(max(shape) / SIDE))), 0)


def grid_shape(shape: tuple[int, int], points: int) -> tuple[int, int]:
    """(rows, cols) of a grid of nearly square cells, about `points` of them."""
    rows = max(round(np.sqrt(points * shape[0] / shape[1])), 1)
    return rows, max(round(points / rows), 1)


def interest_points(level: Level, power: int, shape: tuple[int, int], points: int) -> tuple[np.ndarray, np.ndarray]:
    """(pixels (n, 2) of the whole image, the number (n,) of the cell of each), the best of each cell with texture.

    `level` is the image reduced by 2^power, `shape` the (rows, cols) of the whole. Texture is the smaller eigenvalue of
    the structure tensor, after Shi and Tomasi (1994), "Good features to track"; cells without any have no point.
    """
    texture = _texture(level)
    grid = grid_shape(shape, points)
    edges = [np.linspace(0, side, count + 1) for side, count in zip(level.grey.shape, grid, strict=True)]
    found, cells = [], []
    for i in range(grid[0]):
        for j in range(grid[1]):
            (top, bottom), (left, right) = (_inner(e, k) for e, k in zip(edges, (i, j), strict=True))
            part = texture[top:bottom, left:right]
            if part.size == 0 or not part.max() > 0.0:
                continue
            row, col = np.unravel_index(int(np.argmax(part)), part.shape)
            found.append(((left + col + 0.5) * 2**power - 0.5, (top + row + 0.5) * 2**power - 0.5))
            cells.append(i * grid[1] + j)
    return np.array(found, float).reshape(-1, 2), np.array(cells, int)


def cell_of(uv: np.ndarray, shape: tuple[int, int], points: int) -> np.ndarray:
    """Number (n,) of the grid cell of pixels (n, 2)."""
    grid = grid_shape(shape, points)
    where = [
        np.clip(((uv[:, axis] + 0.5) / side * count).astype(int), 0, count - 1)
        for axis, side, count in zip((1, 0), shape, grid, strict=True)
    ]
    return where[0] * grid[1] + where[1]


def _inner(edges: np.ndarray, k: int) -> tuple[int, int]:
    aside = EDGE * (edges[k + 1] - edges[k])
    return int(np.ceil(edges[k] + aside)), int(np.floor(edges[k + 1] - aside))


def _texture(level: Level) -> np.ndarray:
    down, across = np.gradient(level.grey)
    a, b, c = (scipy.ndimage.gaussian_filter(x, SMOOTH) for x in (down * down, down * across, across * across))
    least = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
    edge = np.ones_like(level.known)
    edge[2:-2, 2:-2] = False
    return np.where(scipy.ndimage.binary_dilation(~level.known, iterations=3) | edge, 0.0, np.maximum(least, 0.0))
