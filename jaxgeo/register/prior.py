"""Prior of the navigation errors and the map shift."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import as_float64, check_finite, check_is, concrete
from jaxgeo._compile import one_program
from jaxgeo._numerics import safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Numbers, Scalar
from jaxgeo.register.tie_errors import TieErrors
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sources.base import check_covariance

SHIFT = ("shift: east", "shift: north")
NOTHING = 1e-14  # of the largest eigenvalue of a correlation matrix: smaller ones are rounding


class Prior(Record):
    """Normal distribution of the unknowns: the axes of an error model, and the map shift to the east and north, m.

    `mean` (unknowns,) is relative to the navigation's model inputs; `covariance` (unknowns, unknowns) may be singular.
    """

    mean: Numbers
    covariance: Numbers

    @classmethod
    def of(cls, model: ErrorModel, errors: TieErrors) -> Prior:
        """Prior without an earlier update: zero mean, with the covariance of the sources and of the map shift."""
        return cls(jnp.zeros(model.size + 2), _covariance_of(model, as_float64(errors.shift, "errors.shift")))

    def factor(self) -> Float[Array, "unknowns unknowns"]:
        """F with F F' = covariance, from scaled unknowns; zero columns for directions without uncertainty."""
        covariance = jnp.asarray(self.covariance)
        sigma = safe_sqrt(jnp.diagonal(covariance))
        scale = jnp.where(sigma > 0.0, sigma, 1.0)
        values, vectors = jnp.linalg.eigh(covariance / (scale[:, None] * scale[None, :]))
        values = jnp.where(values > NOTHING * values[-1], values, 0.0)
        return sigma[:, None] * vectors * safe_sqrt(values)[None, :]


@one_program
def _covariance_of(model: ErrorModel, shift: Scalar) -> Float[Array, "unknowns unknowns"]:
    """Covariance of the errors and of the map shift, of which `shift` is the standard deviation in m."""
    count = model.size
    total = jnp.zeros((count + 2, count + 2)).at[:count, :count].set(model.covariance())
    return total.at[count:, count:].set(shift**2 * jnp.eye(2))


def checked_prior(prior: Any, model: ErrorModel) -> Prior:
    """A validated prior of a model in float64.

    Raises `TypeError` for anything else, `ValueError` for a wrong number of unknowns, values that are not finite, and
    an invalid covariance.
    """
    check_is(prior, Prior, "prior")
    prior = as_float64(prior, "prior")
    unknowns = model.size + 2
    for name, shape in (("mean", (unknowns,)), ("covariance", (unknowns, unknowns))):
        if jnp.shape(getattr(prior, name)) != shape:
            raise ValueError(
                f"prior.{name} must have the shape {shape}: the {model.size} axes of the errors and the map's shift; "
                f"got {jnp.shape(getattr(prior, name))}."
            )
    check_finite(prior.mean, "prior.mean", "rad, m, px, s, K or Pa")
    covariance = concrete(prior.covariance)
    if covariance is not None:
        sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        scale = np.where(sigma > 0.0, sigma, 1.0)
        check_covariance(covariance / (scale[:, None] * scale[None, :]), "prior.covariance, scaled to ones,")
    return prior
