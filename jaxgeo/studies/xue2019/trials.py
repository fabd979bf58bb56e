"""Monte Carlo test of an adjustment's covariances: the same block adjusted many times with new noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxgeo.adjust import Adjustment, Free, Unknowns, adjust
from jaxgeo.sensor import FrameCamera
from jaxgeo.studies.xue2019.cases import boresight_off
from jaxgeo.studies.xue2019.simulation import Simulated, flown, measured

SIZE, TIES = 300.0, 15  # m and points in an image: 3 strips of 10 images
NAMES = ("focal", "principal column", "principal row", "boresight x", "boresight y", "boresight z")


@dataclass(frozen=True)
class Trials:
    """Errors (trials, 6) of the parameters `NAMES` in px and rad, their covariances (trials, 6, 6) of unit weight, and
    `sigma0` (trials,) with its `redundancy`."""

    errors: np.ndarray
    covariance: np.ndarray
    sigma0: np.ndarray
    redundancy: int

    @property
    def normalised(self) -> np.ndarray:
        """Errors over their standard deviations (trials, 6)."""
        return self.errors / np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def squares(self) -> np.ndarray:
        """Squared errors in the metric of their covariances (trials,): chi-square with 6 degrees of freedom each."""
        return np.einsum("ti,tij,tj->t", self.errors, np.linalg.inv(self.covariance), self.errors)

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the sum of all squares."""
        return self.errors.size

    def bounds(self, level: float = 0.01) -> tuple[float, float]:
        """Interval of the sum of all squares with probability 1 - `level` if the covariances are correct."""
        from scipy.stats import chi2  # imported on first use

        low, high = chi2.ppf([0.5 * level, 1.0 - 0.5 * level], self.degrees_of_freedom)
        return float(low), float(high)

    def holds(self, level: float = 0.01) -> bool:
        """Whether the sum of squares is within `bounds`."""
        low, high = self.bounds(level)
        return bool(low < np.sum(self.squares) < high)


def trials(count: int = 100, *, size: float = SIZE, seed: int = 0) -> Trials:
    """One-step self-calibrations of interior orientation and boresight, of a camera without distortion.

    Only the noise is redrawn, so all trials share one compiled program.
    """
    flight = flown(size, ties=TIES, lens=None, ripple=0.0)
    unknowns = Unknowns(focal=Free(), principal=Free(), boresight=Free())
    errors, covariances, sigma0, redundancy = [], [], [], 0
    for draw in range(count):
        found = measured(flight, seed + draw)
        adjustment = adjust(found.block(), unknowns)
        errors.append(_errors(adjustment, found))
        spread = np.array([p.sigma for p in adjustment.parameters])
        covariances.append(adjustment.correlations * np.outer(spread, spread))
        sigma0.append(adjustment.sigma0)
        redundancy = adjustment.redundancy
    return Trials(np.array(errors), np.array(covariances), np.array(sigma0), redundancy)


def _errors(adjustment: Adjustment, found: Simulated) -> np.ndarray:
    camera, true = adjustment.cameras["camera"], found.true.camera
    assert isinstance(true, FrameCamera)
    focal = np.asarray(camera.focal_px)[:1] - np.asarray(true.focal_px)[:1]
    principal = np.asarray(camera.principal_px) - np.asarray(true.principal_px)
    return np.concatenate([focal, principal, boresight_off(adjustment.mounts["camera"], found.true)])
