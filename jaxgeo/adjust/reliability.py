"""How well observations check each other: redundancy numbers, standardised residuals, and blunders by name."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads its parts when they are asked for

from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.bundle import adjust
from jaxgeo.adjust.posterior import leverages
from jaxgeo.adjust.unknowns import Unknowns

UNCHECKED = 1e-6  # redundancy below which nothing checks a measurement
POWER = 0.8
ALIKE = 1e-3  # by which the statistics of one point's measurements must differ to tell which is wrong


@dataclass(frozen=True)
class Reliability:
    """Of each image point, along columns and rows (k, 2), in the order of the observations.

    `redundancy` is the share of an error that shows in its own residual (Baarda 1968; 0: nothing checks it, 1: all
    shows), `standardised` the residual over its standard deviation with sigma0 = 1, NaN where nothing checks it, and
    `detectable` the least error in px that the test at `alpha` finds with a probability of 0.8.
    """

    redundancy: np.ndarray
    standardised: np.ndarray
    detectable: np.ndarray
    alpha: float

    @property
    def critical(self) -> float:
        """What a standardised residual exceeds in size with probability `alpha`."""
        return critical_value(self.alpha)


@dataclass(frozen=True)
class Blunder:
    """A measurement that does not fit: its image and point, standardised residual, and error in px (u, v), estimated
    with all the others held to be right. `instead` are the images in which the point may as well be wrong: one of two
    rays that do not meet is not to be told from the other."""

    image: str
    point: str
    row: int
    standardised: float
    error: tuple[float, float]
    instead: tuple[str, ...] = ()

    def __str__(self) -> str:
        u, v = self.error
        text = (
            f"point {self.point} in image {self.image} (row {self.row}): standardised residual "
            f"{self.standardised:.1f}, error about ({u:+.1f}, {v:+.1f}) px"
        )
        return f"{text}; or as well in image {' or '.join(self.instead)}" if self.instead else text


def reliability(adjustment: Adjustment, alpha: float = 0.001) -> Reliability:
    """Redundancy numbers and standardised residuals of the image points after an adjustment; Baarda (1968).

    Raises `ValueError` for an `alpha` outside (0, 1).
    """
    if not 0.0 < alpha < 1.0:
        raise ValueError(f"alpha must lie between 0 and 1; got {alpha!r}.")
    left = _left(adjustment)
    redundancy = np.clip(np.diagonal(left, axis1=1, axis2=2), 0.0, 1.0)
    sigma = adjustment.block.observations.sigma
    checked = redundancy > UNCHECKED
    root = np.sqrt(np.where(checked, redundancy, 1.0))
    standardised = np.where(checked, adjustment.residuals / sigma / root, np.nan)
    shift = critical_value(alpha) + float(scipy.special.ndtri(POWER))
    detectable = np.where(checked, shift * sigma / root, np.inf)
    return Reliability(redundancy, standardised, detectable, alpha)


def blunders(adjustment: Adjustment, alpha: float = 0.001) -> list[Blunder]:
    """Image points whose residuals, both axes together, are larger than chance lets be with probability `alpha`.

    The largest first. A large error shows in its neighbours too: `without_blunders` takes one after the other. What
    nothing checks is never among them, right or wrong: its `reliability` has a redundancy of 0.
    """
    left, v = _left(adjustment), adjustment.residuals / adjustment.block.observations.sigma
    trace = np.trace(left, axis1=1, axis2=2)
    checked = np.linalg.eigvalsh(left)[:, 0] > UNCHECKED
    safe = np.where(checked[:, None, None], left, np.eye(2))
    error = np.linalg.solve(safe, -v[:, :, None])[:, :, 0]  # v = -R error
    statistic = np.where(checked, np.sqrt(np.maximum(np.sum(-v * error, axis=1), 0.0)), 0.0)
    # Where one axis only is checked, that one is tested by itself.
    single = ~checked & (trace > UNCHECKED)
    if np.any(single):
        axis = np.argmax(np.diagonal(left, axis1=1, axis2=2), axis=1)
        rows = np.arange(len(v))
        r, own = np.maximum(left[rows, axis, axis], UNCHECKED), v[rows, axis]
        statistic = np.where(single, np.abs(own) / np.sqrt(r), statistic)
        alone = np.zeros_like(v)
        alone[rows, axis] = -own / r
        error = np.where(single[:, None], alone, error)
    limit = math.sqrt(float(scipy.special.chdtri(2.0, alpha)))
    seen, found = adjustment.block.observations, []
    for row in np.argsort(-statistic):
        if statistic[row] <= limit:
            break
        size = error[row] * seen.sigma[row]
        given = (str(seen.image[row]), str(seen.point[row]), int(row), float(statistic[row]))
        alike = (seen.point == seen.point[row]) & (statistic > (1.0 - ALIKE) * statistic[row])
        alike[row] = False
        instead = tuple(seen.image[alike & (statistic < (1.0 + ALIKE) * statistic[row])].tolist())
        found.append(Blunder(*given, (float(size[0]), float(size[1])), instead))
    return found


def without_blunders(
    block: Block,
    unknowns: Unknowns | None = None,
    *,
    alpha: float = 0.001,
    most: int = 100,
    told: Callable[[Blunder], Any] | None = None,
    **options: Any,
) -> tuple[Adjustment, list[Blunder]]:
    """(adjustment, blunders): the worst measurement taken out, adjusted again, until none is left (data snooping).

    With many images the worst of each is taken at a time. A point that is left with one ray goes altogether. After
    `most` a `RuntimeWarning` says if more are left.
    `options` are those of `adjust`. `told` hears of each. Raises as `adjust`.
    """
    adjustment, out = adjust(block, unknowns, **options), []
    origin = np.arange(len(block.observations))
    while len(out) < most:
        found = _worst(blunders(adjustment, alpha))[: most - len(out)]
        if not found:
            break
        for blunder in found:
            original = int(origin[blunder.row])
            out.append(replace(blunder, row=original))
            if told is not None:
                told(out[-1])
        keep = np.ones(len(origin), bool)
        keep[[blunder.row for blunder in found]] = False
        keep = block.kept(keep)
        block, origin = block.of(keep), origin[keep]
        adjustment = adjust(block, unknowns, **options)
    if len(out) >= most and (left := blunders(adjustment, alpha)):
        warnings.warn(
            f"{len(out)} blunders are taken out, as many as most={most} allows, and more are left: the next is "
            f"{left[0]}. Allow more, or look at the block.",
            RuntimeWarning,
            stacklevel=2,
        )
    return adjustment, out


def critical_value(alpha: float) -> float:
    """What the size of a normal number exceeds with probability `alpha`: 3.29 for 0.001."""
    return float(-scipy.special.ndtri(0.5 * alpha))


def _worst(found: list[Blunder]) -> list[Blunder]:
    """The worst of all, and those of other images and points that are nearly as bad: they do not make each other."""
    chosen: list[Blunder] = []
    for blunder in found:
        apart = all(blunder.image != other.image and blunder.point != other.point for other in chosen)
        if apart and blunder.standardised > 0.5 * found[0].standardised:
            chosen.append(blunder)
    return chosen


def _left(adjustment: Adjustment) -> np.ndarray:
    """Covariance (k, 2, 2) of the weighted residuals: one less the leverage."""
    ready, values = adjustment.prepared, adjustment.solution.values
    h = np.asarray(leverages(ready.problem, values, adjustment.loss, adjustment.posterior))
    return np.eye(2) - h[ready.order.place]
