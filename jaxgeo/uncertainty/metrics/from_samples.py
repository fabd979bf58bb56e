"""Accuracy statistics of error samples; failed samples count as infinitely far."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp

from jaxgeo._checks import as_array, as_float64, concrete
from jaxgeo._typing import Numbers
from jaxgeo.uncertainty.metrics.exact import check_probability


def radial_errors(errors: Any, failed: Any = None) -> Numbers:
    """Norms in m of errors (n, d) in m; +inf where `failed` (n,) is true or an error is not finite."""
    errors = as_float64(as_array(errors, "errors"), "errors")
    bad = ~jnp.all(jnp.isfinite(errors), axis=-1)
    if failed is not None:
        bad = bad | jnp.asarray(failed, bool)
    return jnp.where(bad, jnp.inf, jnp.sqrt(jnp.sum(jnp.where(bad[..., None], 0.0, errors) ** 2, axis=-1)))


def sample_quantile(distances: Any, probability: float) -> Numbers:
    """The k-th smallest of n distances in m, k = ceil(p n): the smallest that contains the share p of the sample.

    NaN counts as failed, infinitely far, so the quantile is +inf if more than 1 - p failed. Raises `ValueError` for an
    empty sample and a probability outside (0, 1).
    """
    distances = _as_distances(distances)
    share = float(check_probability(probability))
    n = distances.shape[0]
    rank = math.ceil(round(share * n, 9))  # 0.07 * 100 rounds to slightly more than 7
    return jnp.sort(distances)[max(rank, 1) - 1]


def sample_rms(distances: Any) -> Numbers:
    """Root mean square of n distances in m; +inf if any failed."""
    distances = _as_distances(distances)
    return jnp.sqrt(jnp.mean(distances**2))


def sample_mean(distances: Any) -> Numbers:
    """Mean of n distances in m; +inf if any failed."""
    return jnp.mean(_as_distances(distances))


def failed_share(distances: Any) -> Numbers:
    """Share of n distances that are not finite, i.e. failed."""
    return jnp.mean(jnp.where(jnp.isinf(_as_distances(distances)), 1.0, 0.0))


def share_within(distances: Any, radius: Any) -> Numbers:
    """Share of n distances in m that are within a radius in m; failed ones count as outside."""
    return jnp.mean(jnp.where(_as_distances(distances) <= radius, 1.0, 0.0))


def _as_distances(distances: Any) -> Numbers:
    distances = as_float64(as_array(distances, "distances"), "distances")
    if distances.ndim != 1 or distances.shape[0] == 0:
        raise ValueError(f"distances must be a list of at least one; got the shape {distances.shape}.")
    known = concrete(distances)
    if known is not None and (known < 0.0).any():
        raise ValueError(f"distances must not be negative; got {known.min():g} m. Give lengths: see radial_errors.")
    return jnp.where(jnp.isnan(distances), jnp.inf, distances)
