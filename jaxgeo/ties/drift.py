"""Navigation errors of images that come one after another: constant, fading in time, and independent parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxgeo.adjust import LocalFrame
from jaxgeo.observation import Exposure
from jaxgeo.ties.shared import OfImage, effects_of
from jaxgeo.ties.views import oriented
from jaxgeo.uncertainty import PerFlight, PerImage, Systematic, TimeCorrelated
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sharing import PerMeasurement

LEAST_LEFT = 1e-8  # variance that a process gains between images of one time: lower bound


@dataclass(frozen=True)
class Drifting:
    """An image of a sequence with its navigation, which errs: pose = navigation + own + by_constant c + by_fading g.

    `centre` (3,) in m and `R_frame_from_camera` (3, 3) by the navigation. `own` (6, 6) is the covariance of the errors
    of this image alone, centre in m, rotation about the camera's axes in rad; c (m,) are constant numbers and g (q,)
    first-order Gauss-Markov processes, all of zero mean and unit variance. `constant` and `fading` are their names,
    `duration` (q,) s the correlation times: the correlation of g between two images is exp(-dt / duration).
    """

    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    own: np.ndarray
    by_constant: np.ndarray
    by_fading: np.ndarray
    constant: tuple[str, ...]
    fading: tuple[str, ...]
    duration: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (6, 6) of all errors."""
        return self.own + self.by_constant @ self.by_constant.T + self.by_fading @ self.by_fading.T


def drifting(frame: LocalFrame, exposure: Exposure, model: ErrorModel, name: str) -> Drifting:
    """An image of a sequence, from its exposure and the sources that move its pose.

    `PerFlight` and `Systematic` errors are constant. Of a `TimeCorrelated` one with strength A and asymptotic part
    alpha, the share A (1 - alpha) fades, A alpha is constant, and 1 - A is independent. Raises `ValueError` for
    `TimeCorrelated` with a beta, whose process has no finite state, and for other classes of sharing.
    """
    centre, R, by_error, covariance = map(np.asarray, oriented(frame, exposure, model))
    image = OfImage(model.sources, by_error, covariance)
    own, constant, fading, duration = np.zeros((6, 6)), {}, {}, []
    first, seen = 0, {}
    for source in model.sources:
        effects = effects_of(image, slice(first, first + len(source.axes)))
        first += len(source.axes)
        seen[source.label] = seen.get(source.label, 0) + 1
        label = source.label if seen[source.label] == 1 else f"{source.label} {seen[source.label]}"
        steady, drift, alone, seconds = _shares(source.sharing, f"image {name}: {source.label}")
        own += alone * effects @ effects.T
        for k, axis in enumerate(source.axes):
            if steady:
                constant[f"{label}: {axis}"] = np.sqrt(steady) * effects[:, k]
            if drift:
                fading[f"{label}: {axis}, fading"] = np.sqrt(drift) * effects[:, k]
                duration.append(seconds)
    return Drifting(
        centre,
        R,
        own,
        np.array(list(constant.values())).reshape(-1, 6).T,
        np.array(list(fading.values())).reshape(-1, 6).T,
        tuple(constant),
        tuple(fading),
        np.array(duration),
    )


def _shares(sharing: object, what: str) -> tuple[float, float, float, float]:
    """Shares of the variance of an error that are constant, that fade, and that are independent between images; and the
    correlation time in s of what fades."""
    if isinstance(sharing, PerImage | PerMeasurement):
        return 0.0, 0.0, 1.0, np.inf
    if isinstance(sharing, PerFlight | Systematic):
        return 1.0, 0.0, 0.0, np.inf
    if not isinstance(sharing, TimeCorrelated):
        raise ValueError(
            f"{what}: an error with sharing {type(sharing).__name__} has no recursion; use PerImage, PerFlight, "
            "Systematic or TimeCorrelated."
        )
    sharing.check()
    strength, alpha, beta = (float(np.asarray(x)) for x in (sharing.strength, sharing.alpha, sharing.beta))
    if beta != 0.0:
        raise ValueError(
            f"{what}: TimeCorrelated with beta = {beta:g} is no first-order Gauss-Markov process; give beta=0."
        )
    return strength * alpha, strength * (1.0 - alpha), 1.0 - strength, float(np.asarray(sharing.duration))


def transition(duration: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """(factors (q,), gained standard deviations (q,)) of unit processes after a time in s."""
    factor = np.exp(-seconds / duration)
    return factor, np.sqrt(np.maximum(1.0 - factor**2, LEAST_LEFT))
