"""Circular, linear and spherical errors of results, which hold NaN instead of a covariance without a fix."""

from __future__ import annotations

import math
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._accelerator import by_device
from jaxgeo._compile import batch_filter_jit, is_direct, quick_jit
from jaxgeo._typing import Numbers
from jaxgeo.uncertainty.host_arrays import blocks_of
from jaxgeo.uncertainty.metrics import circular_error, linear_error, spherical_error
from jaxgeo.uncertainty.metrics._host import MOST, host_radii
from jaxgeo.uncertainty.metrics.exact import level_of

AT_ONCE, AT_ONCE_ACCELERATOR = 128, 1024  # radii of one call of a program

# Under `jit` an invalid covariance gives NaN instead of an exception.
_circular_error, _linear_error, _spherical_error = map(quick_jit, (circular_error, linear_error, spherical_error))
_OF_MANY = {
    1: batch_filter_jit(linear_error),
    2: batch_filter_jit(circular_error),
    3: batch_filter_jit(spherical_error),
}


def circular_radius(cov_enu: Any, probability: ArrayLike, bias_enu: Any) -> Numbers:
    """`circular_error` of a covariance (..., 3, 3) and a bias (..., 3); NaN if they are invalid.

    Raises `ValueError` for a probability outside (0, 1 - 1e-10], as the next two.
    """
    cov, bias = _at_hand(cov_enu, bias_enu)
    cov, bias = cov[..., :2, :2], bias[..., :2]
    level_of(probability)
    found = host_radii(cov, probability, bias)
    return _circular_error(cov, probability, bias) if found is None else jax.device_put(found)


def linear_radius(cov_enu: Any, probability: ArrayLike, bias_enu: Any) -> Numbers:
    """`linear_error` of the third component of a covariance (..., 3, 3) and a bias (..., 3); NaN if invalid."""
    cov, bias = _at_hand(cov_enu, bias_enu)
    level_of(probability)
    found = host_radii(cov[..., 2:, 2:], probability, bias[..., 2:])
    return _linear_error(cov[..., 2, 2], probability, bias[..., 2]) if found is None else jax.device_put(found)


def spherical_radius(cov_enu: Any, probability: ArrayLike, bias_enu: Any) -> Numbers:
    """`spherical_error` of a covariance (..., 3, 3) and a bias (..., 3); NaN if they are invalid."""
    level_of(probability)
    found = host_radii(cov_enu, probability, bias_enu)
    return _spherical_error(cov_enu, probability, bias_enu) if found is None else jax.device_put(found)


def _at_hand(cov: Any, bias: Any) -> tuple[Any, Any]:
    """A few numbers that are not traced as NumPy arrays, of which taking a part compiles nothing."""
    if is_direct() and bias.size <= 3 * MOST:
        return np.asarray(cov), np.asarray(bias)
    return cov, bias


def radii_of_many(cov: np.ndarray, probability: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Radii of covariances (..., d, d) and biases (..., d); NaN if they are invalid.

    By NumPy; those of which it has none, and many where there is an accelerator, by a program of one size.
    """
    d, batch = bias.shape[-1], bias.shape[:-1]
    cov, bias = cov.reshape(-1, d, d), bias.reshape(-1, d)
    found: Any = host_radii(cov, probability, bias, by_device(math.inf, MOST))
    if found is not None:
        return found.reshape(batch)
    given: Any = (cov, bias) if d > 1 else (cov[:, 0, 0], bias[:, 0])
    parts = blocks_of(given, by_device(AT_ONCE, AT_ONCE_ACCELERATOR), "computing radii", progress=False)
    found = [np.asarray(_OF_MANY[d](part[0], probability, part[1])) for part in parts]
    return np.concatenate(found)[: len(cov)].reshape(batch)
