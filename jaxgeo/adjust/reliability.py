"""How well observations check each other: redundancy numbers, standardised residuals, and blunders by name."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are asked for

from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.hypotheses import UNCHECKED, Hypotheses, limit, of_control, of_image_points
from jaxgeo.adjust.kept import control_of
from jaxgeo.adjust.posterior import leverages
from jaxgeo.adjust.screening import CONTROL_POINT, IMAGE_POINT

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
    """A measurement that does not fit: an `image point` with its image, or a `control point` (image is empty then), its
    row of the observations or of the control, standardised residual, and error, estimated with all the others held to
    be right: (u, v) in px, or (x, y, z) in m of the block's frame; NaN where nothing is left to compare with.

    `standardised` is the length of the residual over its covariance; of one or three directions, the length of as
    improbable a one of two, so that all compare. `instead` are the images in which the point may as well be wrong: one
    of two rays that do not meet is not to be told from the other; `or_control`: or else the point's control.
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
    """Image points and control points whose residuals, all axes together, are larger than chance lets be with
    probability `alpha`; of each the one test.

    The largest first. A large error shows in its neighbours too: `without_blunders` takes one after the other. What
    nothing checks is never among them, right or wrong: its `reliability` has a redundancy of 0; nor is control of a
    sigma of zero, which is held to be right.
    """
    control = control_of(adjustment.block)
    return named(adjustment.block, of_image_points(adjustment), of_control(adjustment, control), limit(alpha))


def named(block: Block, points: Hypotheses, control: Hypotheses, least: float) -> list[Blunder]:
    """The hypotheses on image points and control whose statistics exceed the `least`, the largest first."""
    seen, known = block.observations, control_of(block)
    statistic = np.concatenate([points.statistic, control.statistic])
    length = np.concatenate([points.length, control.length])
    point = np.concatenate([seen.point, known.name])
    image = np.concatenate([seen.image, np.full(len(known), "")])
    found, k = [], len(seen)
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
        error = points.error[at] * seen.sigma[at] if of_image else control.error[at - k]
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
    """The places of each name."""
    unique, number = np.unique(names, return_inverse=True)
    order = np.argsort(number, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(number))[:-1])
    return dict(zip(unique.tolist(), parts, strict=True))


def critical_value(alpha: float) -> float:
    """What the size of a normal number exceeds with probability `alpha`: 3.29 for 0.001."""
    return float(-scipy.special.ndtri(0.5 * alpha))


def _left(adjustment: Adjustment) -> np.ndarray:
    """Covariance (k, 2, 2) of the weighted residuals: one less the leverage."""
    ready, values = adjustment.prepared, adjustment.solution.values
    h = np.asarray(leverages(ready.problem, values, adjustment.loss, adjustment.posterior))
    return np.eye(2) - h[ready.order.place]
