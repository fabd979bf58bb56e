"""Block matching of a rectified image with a reference, within the search area of the navigation errors."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxgeo._checks import require_x64
from jaxgeo.register.blocks import SIZE, BlockOutcome, Matches, block_shape, cut
from jaxgeo.register.peaks import Peaks, best_peaks, ellipses, half_widths, joined
from jaxgeo.register.refinement import TAPS, refine_all

BATCH = 8  # blocks, or candidates, per call
CELLS = 2_000_000  # of all windows of a batch; about twenty arrays of this size are live at once
EVEN = 0.01  # of the standard deviation of the whole image: a block that varies less has no texture

Image = Float[np.ndarray, "channels rows cols"]
Known = Bool[np.ndarray, "rows cols"]
Corners = Int[np.ndarray, "n 2"]


def match_blocks(
    rectified: Any,
    known: Any,
    reference: Any,
    known_reference: Any,
    centres: Any,
    covariance: Any,
    *,
    size: int = SIZE,
    probability: float = 0.999,
    peaks: int = 4,
    least_overlap: float = 0.5,
    least_score: float = 0.0,
    above_chance: float = 1.0,
    separation: float = 3.0,
    largest_sigma: float = 1.0,
    floor: float = 0.03,
) -> Matches:
    """Match candidates of image blocks in a reference on the same grid.

    `rectified` and `reference` are grey values (rows, cols) in the same cells, `known` and `known_reference` their
    masks: other values have no influence. Both may have several channels (channels, rows, cols), such as those of
    `orientation_channels`: the correlation is then that of all of them, for one shift. Pad the rectified image with
    unknown cells where the reference extends further. `centres` (n, 2) are the centres of blocks of `size` cells
    (`blocks_of`), `covariance` (n, 2, 2) in cells2
    (rows, cols) is that of their zero-mean shifts by the navigation errors. The search covers whole shifts within the
    `probability` ellipse of these errors, plus one cell; `least_overlap` is the share of a block's known cells that
    must be known in the reference. Up to `peaks` local maxima of the normalised correlation, at least `separation`
    cells apart, become candidates if they score at least `least_score` and at least `above_chance` times the best score
    expected by chance in a search of that size (values below 1 keep more candidates for the selection). Each is refined
    by least squares (see `refine`) and rejected if its standard deviation exceeds `largest_sigma` cells in any
    direction; `floor` cells are added to it in quadrature for model errors.

    Raises `RuntimeError` with 64-bit floats off; `ValueError` for shapes that do not fit, images that are not finite
    where they are known, centres outside the image, invalid covariances, searches that are too large, and options out
    of range.
    """
    require_x64()
    rectified, known = _checked_image(rectified, known, "rectified", "known")
    reference, known_reference = _checked_image(reference, known_reference, "reference", "known_reference")
    shape_of_image = known.shape
    if rectified.shape != reference.shape:
        raise ValueError(
            f"rectified and reference must lie on the same grid; got shapes {rectified.shape} and {reference.shape}. "
            f"Cut or pad one, with unknown cells."
        )
    centres, covariance = _checked_blocks(centres, covariance, shape_of_image)
    _check_options(probability, peaks, least_overlap, above_chance, floor)
    shape = block_shape(shape_of_image, size)
    corners = np.rint(centres - (np.array(shape) - 1) / 2).astype(int)
    pair = (rectified, known, reference, known_reference)
    outcome, centre = _looked_at(rectified, known, corners, shape)
    found = _searched(pair, corners, shape, outcome, covariance, (probability, peaks, least_overlap, separation))
    outcome, is_peak = _judged(found, outcome, least_score, above_chance)
    shift, cov = _refined(pair, corners, shape, found, is_peak, (largest_sigma, floor))
    is_candidate = np.isfinite(shift[..., 0])
    lost = (outcome == BlockOutcome.matched) & ~is_candidate.any(axis=1)
    outcome[lost] = BlockOutcome.not_refined
    score = np.where(is_candidate, found.score, np.nan)
    return _best_first(Matches(centre, shift, score, cov, outcome, np.asarray(found.searched)))


def _looked_at(
    image: Image, known: Known, corners: Corners, shape: tuple[int, int]
) -> tuple[np.ndarray, Float[np.ndarray, "n 2"]]:
    """(outcome, mean position of the known cells) of each block before the search."""
    outcome = np.full(len(corners), BlockOutcome.matched, np.int8)
    centre = corners + (np.array(shape) - 1) / 2
    whole = _deviation(image[:, known]) if known.any() else 0.0
    for k, corner in enumerate(corners):
        here = cut(known, corner, shape)
        if np.mean(here) < 0.5:
            outcome[k] = BlockOutcome.outside_image
            continue
        centre[k] = corner + np.array([np.mean(axis) for axis in np.nonzero(here)])
        if _deviation(cut(image, corner, shape)[:, here]) <= EVEN * whole:
            outcome[k] = BlockOutcome.no_texture
    return outcome, centre


def _deviation(values: Float[np.ndarray, "channels n"]) -> float:
    """Standard deviation of all channels together."""
    return float(np.sqrt(np.sum(np.var(values, axis=1))))


def _searched(
    pair: tuple[Image, Known, Image, Known],
    corners: Corners,
    shape: tuple[int, int],
    outcome: np.ndarray,
    covariance: Float[np.ndarray, "n 2 2"],
    options: tuple[float, int, float, float],
) -> Peaks:
    """Peaks of all blocks, in batches of one size; scores are NaN for blocks that are not searched."""
    probability, peaks, least_overlap, separation = options
    found = _no_peaks(len(corners), peaks)
    chosen = np.flatnonzero(outcome == BlockOutcome.matched)
    whitening, extent = ellipses(covariance[chosen], probability)
    widths = joined(half_widths(extent), shape)
    for width in np.unique(widths, axis=0):
        window = (shape[0] + 2 * int(width[0]), shape[1] + 2 * int(width[1]))
        batch = max(1, min(BATCH, CELLS // (window[0] * window[1])))
        same = np.flatnonzero(np.all(widths == width, axis=1))
        for part in _batches(same, batch):
            blocks = chosen[part]
            here, there = corners[blocks], corners[blocks] - width
            arrays = (*_cuts(pair[0], pair[1], here, shape), *_cuts(pair[2], pair[3], there, window))
            numbers = (jnp.asarray(least_overlap, float), jnp.asarray(separation, float))
            tops = best_peaks(*arrays, jnp.asarray(whitening[part]), *numbers, peaks=peaks)
            for all_of_them, some in zip(found, tops, strict=True):
                all_of_them[blocks] = np.asarray(some)
    return found


def _no_peaks(n: int, peaks: int) -> Peaks:
    counts = [np.zeros(n, int) for _ in range(3)]
    shift, score = np.zeros((n, peaks, 2), int), np.full((n, peaks), np.nan)
    return Peaks(shift, np.zeros((n, peaks, 2)), score, counts[0], counts[1], counts[2], np.zeros(n))


def _judged(
    found: Peaks, outcome: np.ndarray, least_score: float, above_chance: float
) -> tuple[np.ndarray, Bool[np.ndarray, "n peaks"]]:
    """(outcome, flags of the peaks to refine) after the search."""
    level = np.maximum(above_chance * found.level, least_score)[:, None]
    with np.errstate(invalid="ignore"):
        is_peak = np.asarray(found.score >= level)
    has_none = ~is_peak.any(axis=1)
    was_searched = outcome == BlockOutcome.matched
    reasons = (
        (2 * found.overlapping < found.inside, BlockOutcome.off_reference),
        (2 * found.searched < found.overlapping, BlockOutcome.no_texture),
        (has_none, BlockOutcome.no_peak),
    )
    outcome = outcome.copy()
    for holds, reason in reasons:
        outcome[was_searched & np.asarray(holds) & (outcome == BlockOutcome.matched)] = reason
    return outcome, is_peak & (outcome == BlockOutcome.matched)[:, None]


def _refined(
    pair: tuple[Image, Known, Image, Known],
    corners: Corners,
    shape: tuple[int, int],
    found: Peaks,
    is_peak: Bool[np.ndarray, "n peaks"],
    sigmas: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """(shifts, covariances) of all candidates by least squares; NaN for missing candidates."""
    (n, peaks), (largest_sigma, floor) = is_peak.shape, sigmas
    shift, cov = np.full((n, peaks, 2), np.nan), np.full((n, peaks, 2, 2), np.nan)
    wide = (shape[0] + 2 * TAPS, shape[1] + 2 * TAPS)
    block, peak = np.nonzero(is_peak)
    for part in _batches(np.arange(len(block)), BATCH):
        b, k = block[part], peak[part]
        here = corners[b] - TAPS
        arrays = (*_cuts(pair[0], pair[1], here, wide), *_cuts(pair[2], pair[3], here + found.shift[b, k], wide))
        refined = refine_all(*arrays, jnp.asarray(found.offset[b, k]))
        covariance = np.asarray(refined.covariance) + floor**2 * np.eye(2)
        is_found = np.array(refined.found)
        is_found &= np.linalg.eigvalsh(np.where(is_found[:, None, None], covariance, 0.0))[:, 1] <= largest_sigma**2
        shift[b[is_found], k[is_found]] = (found.shift[b, k] + np.asarray(refined.shift))[is_found]
        cov[b[is_found], k[is_found]] = covariance[is_found]
    return shift, cov


def _best_first(matches: Matches) -> Matches:
    """Remaining candidates in order of their scores, without gaps; of two that converged to one, the better."""
    shift, is_candidate = np.asarray(matches.shift), matches.is_candidate
    for first in range(shift.shape[1]):
        near = np.nansum((shift - shift[:, first : first + 1]) ** 2, axis=-1) < 1.0
        near &= is_candidate[:, first : first + 1]
        near[:, : first + 1] = False
        is_candidate = is_candidate & ~near
    matches = matches.only(is_candidate)
    order = np.argsort(-np.where(is_candidate, matches.score, -np.inf), axis=1, kind="stable")
    rows = np.arange(len(order))[:, None]
    shift, score, cov = (np.asarray(x)[rows, order] for x in (matches.shift, matches.score, matches.covariance))
    return Matches(matches.centre, shift, score, cov, matches.outcome, matches.searched)


def _batches(indices: Int[np.ndarray, " m"], size: int) -> list[np.ndarray]:
    """Indices in groups of exactly `size`; the last group is padded with its last index."""
    groups = [indices[k : k + size] for k in range(0, len(indices), size)]
    return [np.pad(group, (0, size - len(group)), mode="edge") for group in groups]


def _cuts(image: Image, known: Known, corners: Corners, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Windows (n, channels, rows, cols) of an image, and (n, rows, cols) of its mask."""
    of_image, of_mask = (np.stack([cut(array, corner, shape) for corner in corners]) for array in (image, known))
    return jnp.asarray(of_image), jnp.asarray(of_mask)


def _checked_image(image: Any, known: Any, name: str, name_known: str) -> tuple[Image, Known]:
    image, known = np.asarray(image, np.float64), np.asarray(known, bool)
    if image.ndim not in (2, 3) or image.shape[-2:] != known.shape or 0 in image.shape[:-2]:
        raise ValueError(
            f"{name} must be (rows, cols) or (channels, rows, cols), and {name_known} (rows, cols) alike; got "
            f"{image.shape}, {known.shape}."
        )
    image = image.reshape(-1, *known.shape)
    is_number = np.all(np.isfinite(image), axis=0)
    if not np.all(is_number[known]):
        count = np.count_nonzero(~is_number[known])
        raise ValueError(f"{name} is not a number in {count} cells that {name_known} calls known; mark them unknown.")
    return np.where(known, image, 0.0), known


def _checked_blocks(centres: Any, covariance: Any, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    centres, covariance = np.asarray(centres, np.float64), np.asarray(covariance, np.float64)
    n = len(centres)
    if centres.shape != (n, 2) or covariance.shape != (n, 2, 2):
        raise ValueError(
            f"centres must be (n, 2) and covariance (n, 2, 2), in cells; got {centres.shape} and {covariance.shape}."
        )
    is_on = np.all((centres >= -0.5) & (centres <= np.array(shape) - 0.5), axis=1)
    if not np.all(is_on):
        k = int(np.argmin(is_on))
        raise ValueError(f"centre {k}, (row, col) = {centres[k]}, does not lie on the image of {shape} cells.")
    is_covariance = np.all(np.isfinite(covariance), axis=(1, 2))
    least = np.linalg.eigvalsh(np.where(is_covariance[:, None, None], covariance, 0.0))
    is_covariance &= least[:, 0] >= -1e-9 * np.maximum(least[:, 1], 1e-300)
    is_covariance &= np.abs(covariance[:, 0, 1] - covariance[:, 1, 0]) <= 1e-9 * np.maximum(least[:, 1], 1e-300)
    if not np.all(is_covariance):
        k = int(np.argmin(is_covariance))
        raise ValueError(f"covariance {k} is none: {covariance[k].tolist()} cells2 is not symmetric and positive.")
    return centres, covariance


def _check_options(probability: float, peaks: int, least_overlap: float, above_chance: float, floor: float) -> None:
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability must lie between 0 and 1; got {probability}.")
    if peaks < 1:
        raise ValueError(f"peaks must be 1 or more; got {peaks}.")
    if not 0.0 < least_overlap <= 1.0:
        raise ValueError(f"least_overlap is a share in (0, 1]; got {least_overlap}.")
    if not above_chance >= 0.0:
        raise ValueError(f"above_chance is a factor, zero or more; got {above_chance}.")
    if not floor >= 0.0:
        raise ValueError(f"floor is a standard deviation in cells, zero or more; got {floor}.")
