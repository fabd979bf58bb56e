"""Pointing errors of the line of sight: section 5.1 and Fig. 12 of Li et al. (2023)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._numerics import safe_angle
from jaxgeo._typing import Vector3
from jaxgeo.sensor import Shot
from jaxgeo.sensor.exposure import line_of_sight
from jaxgeo.studies.li2023 import printed
from jaxgeo.uncertainty import ErrorModel, Random, presets
from jaxgeo.uncertainty.metrics import circular_probability
from jaxgeo.uncertainty.model_inputs import ModelInputs

LIMITS = (printed.LOS_BAND[0], printed.LOS_BAND[1], *printed.LOS_WITHIN)  # deg
GRID = np.linspace(0.0, 0.25, 126)  # deg, abscissae of the linear distribution
RANDOM = Random()


@dataclass(frozen=True)
class Pointing:
    """Pointing errors of one line of sight: the angle in space between the nominal and the perturbed direction.

    `linear_rms` and `sampled_rms` in deg, `standard_error` that of the latter; the shares below an angle in deg are
    those of the linear Gaussian and of the samples `angles` (deg); `chance` is the linear share below each of `GRID`.
    """

    setting: str
    linear_rms: float
    sampled_rms: float
    standard_error: float
    linear_within: dict[float, float]
    sampled_within: dict[float, float]
    axis_ratio: float
    angles: np.ndarray
    chance: np.ndarray

    @property
    def in_band(self) -> tuple[float, float]:
        """Shares (linear, sampled) in the band that the paper says contains more than half."""
        low, high = printed.LOS_BAND
        return (
            self.linear_within[high] - self.linear_within[low],
            self.sampled_within[high] - self.sampled_within[low],
        )


def pointing_errors(setting: str, shot: Shot, *, samples: int, key: Array) -> Pointing:
    """Pointing errors of a shot under Table 1: to first order, and from `samples` draws."""
    inputs = ModelInputs.of(printed.sensor(), shot, printed.UV, printed.level_ground(0.0))
    model = presets.li_2023()
    variances, angles = _errors(inputs, model, key, samples)
    variances, angles = np.rad2deg(np.rad2deg(np.asarray(variances))), np.rad2deg(np.asarray(angles))
    chance = np.asarray(circular_probability(np.diag(variances), np.concatenate([LIMITS, GRID])))
    squares = angles**2
    rms = float(np.sqrt(squares.mean()))
    return Pointing(
        setting=setting,
        linear_rms=float(np.sqrt(variances.sum())),
        sampled_rms=rms,
        standard_error=float(squares.std() / math.sqrt(samples) / (2.0 * rms)),
        linear_within=dict(zip(LIMITS, chance.tolist(), strict=False)),
        sampled_within={limit: float(np.mean(angles < limit)) for limit in LIMITS},
        axis_ratio=float(np.sqrt(variances[0] / variances[1])),
        angles=angles,
        chance=chance[len(LIMITS) :],
    )


@eqx.filter_jit
def _errors(
    inputs: ModelInputs, model: ErrorModel, key: Array, samples: int
) -> tuple[Float[Array, "2"], Float[Array, " n"]]:
    """(variances in rad2 along the axes of the error across the line of sight, angles in rad of the samples)."""
    nominal, factor = _direction(inputs), model.factor()
    swept = jax.jacfwd(lambda error: _direction(model.moved(inputs, error)))(jnp.zeros(model.size))
    cov = swept @ model.covariance() @ swept.T

    def angle(number: Array) -> Array:
        error = factor @ RANDOM.standard_normal(key, number, model.size)
        return safe_angle(nominal, _direction(model.moved(inputs, error)))

    return jnp.linalg.eigvalsh(cov)[1:], jax.vmap(angle)(jnp.arange(samples))


def _direction(inputs: ModelInputs) -> Vector3:
    """Direction of the line of sight in ECEF; no error of this study moves the aircraft, so any fixed frame works."""
    return line_of_sight(inputs.sensor, inputs.motion, jnp.asarray(inputs.time), inputs.uv)[1]
