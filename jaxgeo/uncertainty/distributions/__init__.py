"""Distributions of errors that are not normal: uniform, triangular, arcsine, Laplace, Student-t, truncated normal,
mixture of normals, and quantiles of measured residuals.

A source takes one as its `distribution`, for all of its axes, or a tuple with one for each axis (None: normal). Each
has zero mean and, if its variance is finite, a standard deviation of one: `sigma` of the source remains the standard
deviation of the error.

>>> from jaxgeo.uncertainty import distributions, sources
>>> steps = distributions.Uniform()  # of an encoder
>>> source = sources.GimbalAngles.from_degrees(outer=0.02, inner=0.02, distribution=steps)
>>> print(f"largest error {0.02 * steps.quantile(1.0):.4f} deg")
largest error 0.0346 deg
"""

from jaxgeo.uncertainty.distributions.base import AbstractDistribution
from jaxgeo.uncertainty.distributions.bounded import Arcsine, Triangular, TruncatedNormal, Uniform
from jaxgeo.uncertainty.distributions.empirical import Empirical
from jaxgeo.uncertainty.distributions.laplace import Laplace
from jaxgeo.uncertainty.distributions.mixture import Mixture
from jaxgeo.uncertainty.distributions.student import StudentT

__all__ = [
    "AbstractDistribution",
    "Arcsine",
    "Empirical",
    "Laplace",
    "Mixture",
    "StudentT",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
]
