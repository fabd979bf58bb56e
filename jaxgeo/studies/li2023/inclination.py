"""RMS of a target's position by frame angle and height error: Fig. 5 of Li et al. (2023)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxgeo.studies.li2023 import printed
from jaxgeo.uncertainty import presets, propagate


@dataclass(frozen=True)
class Inclination:
    """RMS in space in m, rows by `sigmas` (m) of height, columns by `frames` (deg of the outer frame angle).

    `height_only` is the effect of a height error alone, `full` adds the ten angles of Table 1.
    """

    frames: np.ndarray
    sigmas: np.ndarray
    height_only: np.ndarray
    full: np.ndarray


def fig_5(frames: Sequence[float], sigmas: Sequence[float]) -> Inclination:
    """Fig. 5 at the given frame angles in deg and standard deviations of height in m, by linear propagation.

    The variance is a sum of squares, so one propagation for each frame angle serves all standard deviations.
    """
    model, ground = presets.li_2023(terrain_height=printed.DEM_SIGMA), printed.level_ground(printed.FIG_5_GROUND)
    angles, height = [], []
    for frame in frames:
        found = propagate(printed.sensor(), printed.level_shot(frame), printed.UV, ground, model)
        jacobian, variances = np.asarray(found.jacobian), np.diag(np.asarray(found.cov_error))
        squares = np.sum(jacobian**2, axis=0)  # the last axis of the error vector is the height
        angles.append(squares[:-1] @ variances[:-1])
        height.append(squares[-1])
    raised = np.outer(np.square(sigmas), height)
    return Inclination(
        frames=np.asarray(frames, float),
        sigmas=np.asarray(sigmas, float),
        height_only=np.sqrt(raised),
        full=np.sqrt(raised + np.asarray(angles)),
    )
