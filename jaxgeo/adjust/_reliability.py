"""Reliability: redundancy numbers, standardised residuals and blunders."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # submodules load lazily

from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.hypotheses import UNCHECKED, Hypotheses, limit, of_control, of_image_points
from jaxgeo.adjust.kept import control_of
from jaxgeo.adjust.posterior import leverages
from jaxgeo.adjust.screening import CONTROL_POINT, IMAGE_POINT

POWER = 0.8
ALIKE = 1e-3  # smallest difference between the statistics of a point's measurements that identifies the wrong one


@dataclass(frozen=True)
class Reliability:
    """Reliability of each image point, along columns and rows (k, 2), in the order of the observations.

    `redundancy` is the share of an error that shows in its own residual (Baarda 1968; 0: unchecked, 1: fully),
    `standardised` the residual over its standard deviation with sigma0 = 1, NaN if unchecked, and `detectable` the
    smallest error in px that the test at `alpha` detects with a probability of 0.8.
    """

    redundancy: np.ndarray
    standardised: np.ndarray
    detectable: np.ndarray
    alpha: float

    @property
    def critical(self) -> float:
        """Critical value of the absolute standardised residual, exceeded by chance with probability `alpha`."""
        return critical_value(self.alpha)


@dataclass(frozen=True)
class Blunder:
    """A rejected measurement: an `image point` with its image, or a `control point` (then `image` is empty), its row of
    the observations or of the control, standardised residual, and estimated error, assuming all others correct: (u, v)
    in px, or (x, y, z) in m of the block's frame; NaN where there is nothing to compare with.

    `standardised` is the length of the residual over its covariance; for one or three directions, the equally
    improbable length with two, so that all are comparable. `instead` are the images in which the point may equally be
    wrong: with two rays that do not intersect, the wrong one cannot be identified. `or_control`: the point's control
    may be wrong instead.
    """

    image: str
    point: str
    row: int
    standardised: float
    error: tuple[float, ...]
    instead: tuple[str, ...] = ()
    kind: str = IMAGE_POINT
    or_control: bool = False

    def __str__(self) -> str:
        where = f"point {self.point} in image {self.image}" if self.image else f"{self.kind} {self.point}"
        text = f"{where} (row {self.row}): standardised residual {self.standardised:.1f}"
        if all(math.isfinite(x) for x in self.error):
            digits, unit = (1, "px") if self.kind == IMAGE_POINT else (2, "m")
            text += f", error about ({', '.join(f'{x:+.{digits}f}' for x in self.error)}) {unit}"
        if self.instead:
            text += f"; or as well in image {' or '.join(self.instead)}"
        return f"{text}; or as well the control of this point" if self.or_control else text


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
    """Image points and control points whose residuals, all axes together, fail the test at level `alpha`.

    The largest first. A large error affects neighbouring residuals too: `without_blunders` removes one after the other.
    Unchecked measurements (redundancy of 0 in `reliability`) are never listed, nor is control with a sigma of zero,
    which is taken as correct.
    """
    control = control_of(adjustment.block)
    return named(adjustment.block, of_image_points(adjustment), of_control(adjustment, control), limit(alpha))


def named(block: Block, points: Hypotheses, control: Hypotheses, least: float) -> list[Blunder]:
    """Image points and control points whose statistics exceed `least`, the largest first."""
    observations, known = block.observations, control_of(block)
    statistic = np.concatenate([points.statistic, control.statistic])
    length = np.concatenate([points.length, control.length])
    point = np.concatenate([observations.point, known.name])
    image = np.concatenate([observations.image, np.full(len(known), "")])
    found, k = [], len(observations)
    if not np.any(statistic > least):
        return found
    rows_of = _rows_of(point)
    for at in np.argsort(-statistic, kind="stable"):
        if statistic[at] <= least:
            break
        others = rows_of[str(point[at])]
        others = others[others != at]
        alike = others[np.abs(length[others] - length[at]) < ALIKE * length[at]]
        instead = tuple(image[alike[alike < k]].tolist())
        of_image = at < k
        error = points.error[at] * observations.sigma[at] if of_image else control.error[at - k]
        found.append(
            Blunder(
                str(image[at]),
                str(point[at]),
                int(at if of_image else at - k),
                float(statistic[at]),
                tuple(error.tolist()),
                instead,
                IMAGE_POINT if of_image else CONTROL_POINT,
                bool(np.any(alike >= k)),
            )
        )
    return found


def _rows_of(names: np.ndarray) -> dict[str, np.ndarray]:
    """The indices of each name."""
    unique, number = np.unique(names, return_inverse=True)
    order = np.argsort(number, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(number))[:-1])
    return dict(zip(unique.tolist(), parts, strict=True))


def critical_value(alpha: float) -> float:
    """Critical value of the absolute value of a normal variable, exceeded with probability `alpha`: 3.29 for 0.001."""
    return float(-scipy.special.ndtri(0.5 * alpha))


def _left(adjustment: Adjustment) -> np.ndarray:
    """Covariance (k, 2, 2) of the weighted residuals: identity less the leverage."""
    ready, values = adjustment.prepared, adjustment.solution.values
    h = np.asarray(leverages(ready.problem, values, adjustment.loss, adjustment.posterior))
    return np.eye(2) - h[ready.order.place]
