"""Whether the error of a fix is nearly normal, although errors of its sources are not."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._typing import Flag
from jaxgeo.uncertainty.linear import OverSlope, Propagation, propagation_of
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix

MOST_SKEWNESS, MOST_EXCESS = 0.5, 1.0  # of the error of a fix, beyond which its quantiles are not those of a normal one
NOTHING = 1e-3  # of the horizontal error: smaller vertical ones are negligible


def is_nearly_normal(propagation: Propagation) -> Flag:
    """Whether skewness and excess kurtosis of the linear error of a fix are small, along the longest horizontal axis of
    its ellipse and vertically. Correlated axes count as if they were independent. A uniform error that makes up 91 % of
    the variance is just not small, nor a Laplace error of 58 %.
    """
    skewness, excess = _of_axes(propagation)
    sigma = jnp.sqrt(jnp.diagonal(propagation.cov_error))
    swept = propagation.jacobian * sigma[None, :]
    _, vectors = jnp.linalg.eigh(propagation.cov_enu[:2, :2])
    along = jnp.stack([vectors[:, 1] @ swept[:2], swept[2]])
    variance = jnp.stack([vectors[:, 1] @ propagation.cov_enu[:2, :2] @ vectors[:, 1], propagation.cov_enu[2, 2]])
    matters = variance > NOTHING**2 * variance[0]
    share = along / jnp.sqrt(jnp.where(matters, variance, 1.0))[:, None]
    third = jnp.sum(_times(share**3, skewness), axis=1)
    fourth = jnp.sum(_times(share**4, excess), axis=1)
    return jnp.all(((jnp.abs(third) <= MOST_SKEWNESS) & (jnp.abs(fourth) <= MOST_EXCESS)) | ~matters)


def is_normal_over(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, found: OverSlope) -> Flag:
    """`is_nearly_normal` of a result over a slope, which may have further axes of zeros."""
    model = model.at(inputs, nominal)
    own = found._replace(jacobian=found.jacobian[:, : model.size])
    return is_nearly_normal(propagation_of(nominal, model, model.covariance(), own))


def _of_axes(propagation: Propagation) -> tuple[Float[Array, " axes"], Float[Array, " axes"]]:
    """(skewness, excess kurtosis) of each axis of the error vector."""
    shapes = [shape for source in propagation.model.sources for shape in source.shapes]
    skewness = [jnp.asarray(0.0 if shape is None else shape.skewness, jnp.float64) for shape in shapes]
    kurtosis = [jnp.asarray(3.0 if shape is None else shape.kurtosis, jnp.float64) for shape in shapes]
    return jnp.stack(skewness), jnp.stack(kurtosis) - 3.0


def _times(share: Float[Array, "2 axes"], moment: Float[Array, " axes"]) -> Float[Array, "2 axes"]:
    """Product; zero for axes that do not move the fix, though their moment may be infinite."""
    return jnp.where(jnp.abs(share) > 1e-12, share * moment[None, :], 0.0)
