"""Search area of a block in the reference, and its correlation peaks."""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Scalar
from jaxgeo.register.correlation import Block, Known, KnownWindow, Surface, Window, correlation

MARGIN = 1.0  # cells added to the semi-axes of the search ellipse
HALF_WIDTHS = tuple(
    width for power in range(2, 11) for width in (2**power, 3 * 2 ** (power - 1))
)  # 4, 6, 8, 12, 16 ...

MOST_ADDED = 4_000_000  # cells that take about half a second

Cells = Float[Array, "shifts_down shifts_across"]
Inside = Bool[Array, "shifts_down shifts_across"]


class Peaks(NamedTuple):
    """The best local maxima of a block's correlation: whole shifts (row, col), scores (NaN for none), and counts.

    `offset` is the sub-cell maximum of a paraboloid fitted to the nine scores, relative to the whole shift; `inside` is
    the number of shifts in the ellipse, `overlapping` of those with enough known cells, `searched` of those with a
    score; `level` is the best score expected by chance in a search of that size.
    """

    shift: Int[Any, "*batch peaks 2"]
    offset: Float[Any, "*batch peaks 2"]
    score: Float[Any, "*batch peaks"]
    inside: Int[Any, "*batch"]
    overlapping: Int[Any, "*batch"]
    searched: Int[Any, "*batch"]
    level: Float[Any, "*batch"]


def ellipses(
    covariance: Float[np.ndarray, "n 2 2"], probability: float
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, "n 2"]]:
    """(W, half extents in cells): shifts d with |W d| <= 1 are searched; they contain the true one with `probability`.

    d' covariance^-1 d <= -2 ln(1 - probability), semi-axes one cell longer.
    """
    values, axes = np.linalg.eigh(covariance)
    longest = math.sqrt(-2.0 * math.log1p(-probability)) * np.sqrt(np.maximum(values, 0.0)) + MARGIN
    whitening = np.swapaxes(axes, 1, 2) / longest[:, :, None]
    return whitening, np.sqrt(np.sum((axes * longest[:, None, :]) ** 2, axis=2))


def half_widths(extent: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
    """Half widths (rows, cols) of the search windows, from a few sizes to limit compilation.

    At least one cell wider than the ellipse, as the peak test needs all neighbours. Raises `ValueError` if the extent
    exceeds the largest size.
    """
    most = HALF_WIDTHS[-2]
    if extent.size and np.max(extent) + 1 > most:
        worst = int(np.argmax(np.max(extent, axis=1)))
        raise ValueError(
            f"block {worst} would have to be searched {np.max(extent):.0f} cells far, beyond the {most - 1} allowed; "
            f"match coarser images first, and use what that gives as the prediction."
        )
    return np.asarray(HALF_WIDTHS)[np.searchsorted(HALF_WIDTHS, np.floor(extent) + 1)]


def joined(widths: Int[np.ndarray, "n 2"], shape: tuple[int, int]) -> Int[np.ndarray, "n 2"]:
    """Half widths of fewer sizes, none smaller than given, for blocks of a shape: two sizes become one where that costs
    no more cells than are searched while another program compiles."""
    if not len(widths):
        return widths
    sizes, which, counts = np.unique(widths, axis=0, return_inverse=True, return_counts=True)
    groups = {k: (size, int(count)) for k, (size, count) in enumerate(zip(sizes, counts, strict=True))}
    group_of = list(range(len(sizes)))

    def cells(size: np.ndarray) -> int:
        return int(np.prod(np.asarray(shape) + 2 * size))

    def added(pair: tuple[int, int]) -> int:
        both = cells(np.maximum(*(groups[k][0] for k in pair)))
        return sum(groups[k][1] * (both - cells(groups[k][0])) for k in pair)

    while len(groups) > 1:
        i, j = pair = min(itertools.combinations(groups, 2), key=added)
        if added(pair) > MOST_ADDED:
            break
        (size, count), (other, others) = groups.pop(i), groups.pop(j)
        groups[i] = np.maximum(size, other), count + others
        group_of = [i if k == j else k for k in group_of]
    return np.array([groups[k][0] for k in group_of]).reshape(-1, 2)[which.reshape(-1)]


@batch_filter_jit
def best_peaks(
    blocks: Float[Array, "n *channels rows cols"],
    known: Bool[Array, "n rows cols"],
    windows: Float[Array, "n *channels more_rows more_cols"],
    known_windows: Bool[Array, "n more_rows more_cols"],
    whitening: Float[Array, "n 2 2"],
    least_overlap: Scalar,
    separation: Scalar,
    *,
    peaks: int,
) -> Peaks:
    """Peaks of each block in its window, inside its ellipse (see `ellipses`), at least `separation` cells apart."""

    def of_one(block: Block, known: Known, window: Window, known_window: KnownWindow, W: Float[Array, "2 2"]) -> Peaks:
        surface = correlation(block, known, window, known_window, least_overlap)
        return highest(surface, W, separation, peaks)

    return jax.vmap(of_one)(blocks, known, windows, known_windows, whitening)


def highest(surface: Surface, whitening: Float[Array, "2 2"], separation: Scalar, peaks: int) -> Peaks:
    """The highest local maxima inside an ellipse about the window's centre. Cells without eight scored neighbours do
    not count, nor do cells at the ellipse's edge with a higher score outside."""
    down, across = (jnp.arange(side) - side // 2 for side in surface.score.shape)
    places = jnp.stack(jnp.broadcast_arrays(down[:, None], across[None, :]), axis=-1).astype(float)
    inside = jnp.sum((places @ whitening.T) ** 2, axis=-1) <= 1.0
    searched = inside & ~jnp.isnan(surface.score)
    left = jnp.where(inside & _is_local_maximum(surface.score), surface.score, -jnp.inf)

    def taken(left: Cells, _: None) -> tuple[Cells, tuple[Int[Array, "2"], Float[Array, "2"], Scalar]]:
        row, col = jnp.unravel_index(jnp.argmax(left), left.shape)
        top = left[row, col]
        shift = jnp.stack([down[row], across[col]])
        apart = jnp.sum((places - shift[None, None, :]) ** 2, axis=-1) >= separation**2
        offset = _top_of_paraboloid(surface.score, row, col)
        return jnp.where(apart, left, -jnp.inf), (shift, offset, jnp.where(jnp.isfinite(top), top, jnp.nan))

    _, (shift, offset, score) = jax.lax.scan(taken, left, None, length=peaks)
    count = jnp.sum(searched)
    several = jnp.maximum(count / jnp.maximum(surface.area, 1.0), 2.0)  # number of shifts with independent scores
    level = jnp.tanh(surface.chance * jnp.sqrt(2.0 * jnp.log(several)))
    return Peaks(shift, offset, score, jnp.sum(inside), jnp.sum(inside & surface.overlaps), count, level)


def _is_local_maximum(score: Cells) -> Inside:
    """Flags of cells whose eight neighbours all have scores, none of them higher."""
    rows, cols = score.shape
    padded = jnp.pad(score, 1, constant_values=jnp.nan)
    steps = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    neighbours = jnp.stack([padded[i : i + rows, j : j + cols] for i, j in steps])
    return jnp.all(score[None, :, :] >= neighbours, axis=0)  # False if a score is NaN


def _top_of_paraboloid(score: Cells, row: Int[Array, ""], col: Int[Array, ""]) -> Float[Array, "2"]:
    """Maximum of the least-squares paraboloid through nine scores, limited to half a cell from the centre."""
    nine = jax.lax.dynamic_slice(jnp.nan_to_num(score), (row - 1, col - 1), (3, 3))
    by_row, by_col = jnp.sum(nine, axis=1), jnp.sum(nine, axis=0)
    slope = jnp.stack([by_row[2] - by_row[0], by_col[2] - by_col[0]]) / 6.0
    bend = jnp.stack([by_row[2] - 2.0 * by_row[1] + by_row[0], by_col[2] - 2.0 * by_col[1] + by_col[0]]) / 3.0
    return jnp.clip(-slope / jnp.where(bend < 0.0, bend, -jnp.inf), -0.5, 0.5)
