"""Outlines of the level sets of an array: marching squares."""

from __future__ import annotations

from typing import Any

import numpy as np


def level_set(values: np.ndarray, level: float) -> Any:
    """Multipolygon (shapely) of the places (row, col) where interpolated values exceed a level.

    Values (rows, cols) are at whole numbers, and below the level outside of the array. Edges are straight between the
    crossings of the lines from value to value; at a saddle the mean of the four values decides. The marching cubes of
    Lorensen and Cline (1987, "Marching cubes"), in two dimensions.
    """
    import shapely  # polygon library, needed by this function only

    padded = np.pad(np.asarray(values, np.float64), 1, constant_values=min(0.0, 2.0 * level - float(values.max())))
    rings = _rings(*_segments(padded, level))
    area: Any = shapely.build_area(shapely.MultiLineString([ring - 1.0 for ring in rings]))
    return area if area.geom_type == "MultiPolygon" else shapely.MultiPolygon([area])


def _segments(values: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """(crossings (m, 2) at (row, col), segments (k, 2) between them, by number)."""
    inside = values > level
    across = inside[:, 1:] != inside[:, :-1]  # crossings of lines along a row
    down = inside[1:] != inside[:-1]
    row, col = np.nonzero(across)
    share = (level - values[row, col]) / (values[row, col + 1] - values[row, col])
    on_rows = np.stack([row, col + share], axis=1)
    row, col = np.nonzero(down)
    share = (level - values[row, col]) / (values[row + 1, col] - values[row, col])
    on_cols = np.stack([row + share, col], axis=1)
    of_row = np.full(across.shape, -1)
    of_row[across] = np.arange(len(on_rows))
    of_col = np.full(down.shape, -1)
    of_col[down] = len(on_rows) + np.arange(len(on_cols))
    sides = np.stack([of_row[:-1], of_col[:, 1:], of_row[1:], of_col[:, :-1]], axis=-1)  # top, right, bottom, left
    number = np.count_nonzero(sides >= 0, axis=-1)
    plain = sides[number == 2]
    segments = [plain[plain >= 0].reshape(-1, 2)]
    saddles = np.argwhere(number == 4)
    for row, col in saddles:
        top, right, bottom, left = sides[row, col]
        is_high = values[row : row + 2, col : col + 2].mean() > level
        # The corners whose side differs from the middle's are cut off.
        pairs = [(top, right), (bottom, left)] if is_high == inside[row, col] else [(top, left), (bottom, right)]
        segments.append(np.array(pairs))
    return np.concatenate([on_rows, on_cols]), np.concatenate(segments)


def _rings(places: np.ndarray, segments: np.ndarray) -> list[np.ndarray]:
    """Closed rings (n, 2); each place is on two segments."""
    order = np.argsort(segments.ravel(), kind="stable").reshape(-1, 2)
    beside = segments.ravel()[order ^ 1].tolist()  # both neighbours of each place
    open_ = [True] * len(places)
    rings = []
    for first in range(len(places)):
        if not open_[first]:
            continue
        ring, before, here = [first], -1, first
        while True:
            open_[here] = False
            one, other = beside[here]
            before, here = here, other if one == before else one
            if here == first:
                break
            ring.append(here)
        rings.append(places[[*ring, first]])
    return rings
