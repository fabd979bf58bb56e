"""Outlier tests of single image points and control points, each assuming that all others are correct."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily

from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.equations import known_points
from jaxgeo.adjust.ground_points import GroundPoints
from jaxgeo.adjust.kept import Kept
from jaxgeo.adjust.measurements import image_residuals
from jaxgeo.adjust.posterior import covariance_of_points, leverages
from jaxgeo.adjust.problem import Prepared

UNCHECKED = 1e-6  # redundancy below which a measurement counts as unchecked


@dataclass(frozen=True)
class Hypotheses:
    """Test results of k measurements: `length` of the residual over its covariance (Mahalanobis distance), number of
    checked `directions`, `statistic` (the equally improbable length with two directions), and the estimated `error`
    (k, axes) in its own unit. Unchecked measurements have a statistic of zero.
    """

    length: np.ndarray
    directions: np.ndarray
    statistic: np.ndarray
    error: np.ndarray

    def alone(self, rows: list[int]) -> Hypotheses:
        """A copy with a statistic of zero for all measurements except `rows`."""
        statistic = np.zeros_like(self.statistic)
        statistic[rows] = self.statistic[rows]
        return replace(self, statistic=statistic)


def limit(alpha: float) -> float:
    """Critical value of the statistic, exceeded by chance with probability `alpha`: 3.72 for 0.001."""
    return float(np.sqrt(scipy.special.chdtri(2.0, alpha)))


def of_image_points(adjustment: Adjustment, full: Prepared | None = None, kept: np.ndarray | None = None) -> Hypotheses:
    """Tests of the image points of an adjustment, or of those (k,) of the block `full`, of which some are `kept`.

    Measurements that were not kept are tested against their prediction without them. Errors are in standard deviations.
    """
    ready = adjustment.prepared if full is None else full
    values, loss = adjustment.solution.values, adjustment.loss
    h = np.asarray(leverages(ready.problem, values, loss, adjustment.posterior))[ready.order.place]
    v = np.asarray(image_residuals(ready.problem, values)).T[ready.order.place]
    return _hypotheses(h, v, np.ones(len(v), bool) if kept is None else kept)


def of_control(
    adjustment: Adjustment, control: GroundPoints, full: Prepared | None = None, kept: Kept | None = None
) -> Hypotheses:
    """Tests of control points (m,); errors in m along the frame's axes. Coordinates with sigma zero are not tested."""
    ready = adjustment.prepared if full is None else full
    row_of = dict(zip(ready.names.point.tolist(), ready.order.row_of_point.tolist(), strict=True))
    there = np.isin(control.name, adjustment.prepared.names.point)
    rows = np.array([row_of.get(name, 0) for name in control.name.tolist()], int)
    values, loss = adjustment.solution.values, adjustment.loss
    Q = np.asarray(covariance_of_points(adjustment.prepared.problem, adjustment.posterior))[rows]
    W = np.asarray(ready.problem.known_point)[rows] * there[:, None, None]
    v = np.asarray(known_points(ready.problem, values))[rows] * there[:, None]
    weight = np.asarray(loss.weight(jnp.asarray(np.sum(v * v, axis=1))))
    known = np.any(W != 0.0, axis=2)
    found = _hypotheses(
        weight[:, None, None] * (W @ Q @ np.swapaxes(W, 1, 2)),
        v,
        np.ones(len(rows), bool) if kept is None else kept.control,
        known,
    )
    error = np.einsum("mij,mj->mi", np.linalg.pinv(W), found.error)
    return Hypotheses(found.length, found.directions, found.statistic, error)


def _hypotheses(h: np.ndarray, v: np.ndarray, kept: np.ndarray, known: np.ndarray | None = None) -> Hypotheses:
    """Test results from leverages (k, d, d) and whitened residuals (k, d), adjusted less measured."""
    d = v.shape[1]
    known = np.ones(v.shape, bool) if known is None else known
    left = np.where(kept[:, None, None], np.eye(d) - h, np.eye(d) + h)
    left = left * known[:, :, None] * known[:, None, :]
    value, vector = np.linalg.eigh(0.5 * (left + np.swapaxes(left, 1, 2)))
    checked = value > UNCHECKED
    along = np.einsum("kij,ki->kj", vector, v * known)
    safe = np.where(checked, value, 1.0)
    squared = np.sum(np.where(checked, along**2 / safe, 0.0), axis=1)
    length, directions = np.sqrt(squared), checked.sum(axis=1)
    of_kept = -np.einsum("kij,kj->ki", vector, np.where(checked, along / safe, 0.0))
    error = np.where(kept[:, None], of_kept, -v * known)
    return Hypotheses(length, directions, _as_of_two(length, directions), error)


def _as_of_two(length: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Length with two directions that is as improbable as the given one with one, two or three."""
    scaled = scipy.special.erfcx(length / np.sqrt(2.0))  # tail over exp(-length2 / 2), which does not underflow
    three = scaled + np.sqrt(2.0 / np.pi) * length
    tail = np.select([directions == 1, directions == 3], [scaled, three], 1.0)
    return np.where(directions > 0, np.sqrt(np.maximum(length**2 - 2.0 * np.log(tail), 0.0)), 0.0)
