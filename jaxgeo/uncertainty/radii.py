"""Circular, linear and spherical errors of results, which hold NaN instead of a covariance without a fix."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from jaxgeo._compile import is_direct, quick_jit
from jaxgeo._typing import Numbers
from jaxgeo.uncertainty.metrics import circular_error, linear_error, spherical_error
from jaxgeo.uncertainty.metrics._host import MOST, host_radii

# Under `jit` an invalid covariance gives NaN instead of an exception.
_circular_error, _linear_error, _spherical_error = map(quick_jit, (circular_error, linear_error, spherical_error))


def circular_radius(cov_enu: Any, probability: ArrayLike, bias_enu: Any) -> Numbers:
    """`circular_error` of a covariance (..., 3, 3) and a bias (..., 3); NaN if they are invalid."""
    cov, bias = _at_hand(cov_enu, bias_enu)
    cov, bias = cov[..., :2, :2], bias[..., :2]
    found = host_radii(cov, probability, bias)
    return _circular_error(cov, probability, bias) if found is None else jax.device_put(found)


def linear_radius(cov_enu: Any, probability: ArrayLike, bias_enu: Any) -> Numbers:
    """`linear_error` of the third component of a covariance (..., 3, 3) and a bias (..., 3); NaN if invalid."""
    cov, bias = _at_hand(cov_enu, bias_enu)
    found = host_radii(cov[..., 2:, 2:], probability, bias[..., 2:])
    return _linear_error(cov[..., 2, 2], probability, bias[..., 2]) if found is None else jax.device_put(found)


def spherical_radius(cov_enu: Any, probability: ArrayLike, bias_enu: Any) -> Numbers:
    """`spherical_error` of a covariance (..., 3, 3) and a bias (..., 3); NaN if they are invalid."""
    found = host_radii(cov_enu, probability, bias_enu)
    return _spherical_error(cov_enu, probability, bias_enu) if found is None else jax.device_put(found)


def _at_hand(cov: Any, bias: Any) -> tuple[Any, Any]:
    """A few numbers that are not traced as NumPy arrays, of which taking a part compiles nothing."""
    if is_direct() and bias.size <= 3 * MOST:
        return np.asarray(cov), np.asarray(bias)
    return cov, bias
