"""Blocks of a rectified image and their matching outcomes."""

from __future__ import annotations

import enum
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from jaxgeo._record import Record

SIZE = 300  # cells: Gu and Qiao (2017), section 2.2


class BlockOutcome(enum.IntEnum):
    """Matching outcome of one block. Records hold it as an int8 array; `BlockOutcome(code).message` is the sentence."""

    matched = 0
    outside_image = 1
    no_texture = 2
    off_reference = 3
    no_peak = 4
    not_refined = 5

    @property
    def message(self) -> str:
        """The outcome as a full sentence."""
        return _MESSAGES[self]


_MESSAGES = {
    BlockOutcome.matched: "The block has one place or more in the reference where it may lie.",
    BlockOutcome.outside_image: "Less than half of the block's cells are known in the rectified image.",
    BlockOutcome.no_texture: "The block, or the part of the reference that was searched, is too even to be matched.",
    BlockOutcome.off_reference: "The reference is unknown over most of the places where the block may lie.",
    BlockOutcome.no_peak: "No place in the searched part correlates better than chance, or the best lies on its rim.",
    BlockOutcome.not_refined: "Least squares found no place near any peak, or left it more uncertain than is allowed.",
}


class Matches(Record):
    """Match candidates of image blocks in the reference: up to `peaks` per block, the best first.

    Positions are (row, col) in cells of the grid that both images share. `centre` (n, 2) is the mean position of a
    block's known cells. `shift` (n, peaks, 2) is reference minus rectified: the content at p in the rectified image is
    at p + shift in the reference. `score` (n, peaks) is the normalised correlation in [-1, 1] at the nearest whole
    shift, `covariance` (n, peaks, 2, 2) that of the shift in cells2. `outcome` (n,) is an int8 `BlockOutcome`,
    `searched` (n,) the number of whole shifts compared. Missing candidates have NaN.
    """

    centre: Float[Any, "n 2"]
    shift: Float[Any, "n peaks 2"]
    score: Float[Any, "n peaks"]
    covariance: Float[Any, "n peaks 2 2"]
    outcome: Int8[Any, " n"]
    searched: Int[Any, " n"]

    @property
    def is_candidate(self) -> Bool[np.ndarray, "n peaks"]:
        """Flags of the entries that hold a candidate."""
        return np.isfinite(np.asarray(self.score))

    def only(self, kept: Bool[np.ndarray, "n peaks"]) -> Matches:
        """A copy in which candidates that are not `kept` are NaN; blocks keep their outcomes."""
        return Matches(
            self.centre,
            np.where(kept[..., None], self.shift, np.nan),
            np.where(kept, self.score, np.nan),
            np.where(kept[..., None, None], self.covariance, np.nan),
            self.outcome,
            self.searched,
        )


def count_outcomes(codes: Any) -> dict[BlockOutcome, int]:
    """Count of each outcome in an array of codes; outcomes that do not occur are left out."""
    values, counts = np.unique(np.asarray(codes), return_counts=True)
    return {BlockOutcome(int(value)): int(count) for value, count in zip(values, counts, strict=True)}


def block_shape(shape: tuple[int, ...], size: int) -> tuple[int, int]:
    """(rows, cols) of a block: `size`, or the image size where that is smaller. Raises `ValueError` under 8 cells."""
    if size < 8:
        raise ValueError(f"size must be 8 cells or more; got {size}. Gu and Qiao (2017) take {SIZE}.")
    return min(size, shape[0]), min(size, shape[1])


def blocks_of(known: Any, size: int = SIZE, step: int | None = None) -> Float[np.ndarray, "n 2"]:
    """Centres (n, 2), (row, col), of square blocks that cover an image and have at least half of their cells known.

    `known` (rows, cols) flags valid cells; `size` and `step` (by default `size`) are in cells. Blocks are evenly spaced
    by about `step`, the outermost at the edges; they are clipped where the image is smaller than a block. The centre of
    a block of even size lies between two cells. Raises `ValueError` for another shape, a size under 8 cells and a step
    under 1.
    """
    known = np.asarray(known, bool)
    if known.ndim != 2:
        raise ValueError(f"known must be (rows, cols); got shape {known.shape}.")
    step = size if step is None else step
    if step < 1:
        raise ValueError(f"step must be 1 cell or more; got {step}.")
    if 0 in known.shape:
        return np.zeros((0, 2))
    sides = block_shape(known.shape, size)
    tops, lefts = (_starts(whole, side, step) for whole, side in zip(known.shape, sides, strict=True))
    corners = np.stack(np.meshgrid(tops, lefts, indexing="ij"), axis=-1).reshape(-1, 2)
    share = [known[top : top + sides[0], left : left + sides[1]].mean() for top, left in corners]
    return (corners + (np.array(sides) - 1) / 2)[np.array(share) >= 0.5]


def _starts(whole: int, side: int, step: int) -> Int[np.ndarray, " n"]:
    """First cells of blocks along one axis, from edge to edge."""
    count = 1 + -(-(whole - side) // step)
    return np.rint(np.linspace(0, whole - side, count)).astype(int)


def cut(values: np.ndarray, corner: Int[np.ndarray, "2"], shape: tuple[int, int]) -> np.ndarray:
    """The part of an array (..., rows, cols) that starts at `corner` (row, col); zero (False) beyond its edges."""
    part = np.zeros((*values.shape[:-2], *shape), values.dtype)
    start, stop = np.maximum(corner, 0), np.minimum(corner + shape, values.shape[-2:])
    if np.all(start < stop):
        (top, left), (bottom, right) = start - corner, stop - corner
        part[..., top:bottom, left:right] = values[..., start[0] : stop[0], start[1] : stop[1]]
    return part
