"""Accuracy of fixes by the selected linear propagation, without samples; unchecked functions for `jit` and `vmap`."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from jaxgeo._typing import Index, IndexField, Matrix3Field, Numbers, Scalar, Vector3Field
from jaxgeo.status import counts_as_fix
from jaxgeo.uncertainty.method_selection import NO_FIX, Diagnosed, Diagnostics, Method, diagnose, select_method
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.normality import is_nearly_normal
from jaxgeo.uncertainty.radii import circular_radius, linear_radius, spherical_radius


class LinearAccuracy(NamedTuple):
    """Selected method at a fix, with the covariance in m2 and bias in m (east, north, up) of linear propagation."""

    method: IndexField
    cov_enu: Matrix3Field
    bias_enu: Vector3Field
    diagnostics: Diagnostics


def assess_fix(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> LinearAccuracy:
    """Method selected by the diagnostics of an observation."""
    return select_linear(diagnose(inputs, nominal, model), nominal)


def select_linear(found: Diagnosed, nominal: NominalFix) -> LinearAccuracy:
    """Method selected by diagnostics."""
    diagnostics, facet, footprint, _ = found
    method = method_of(found)
    either = lambda a, b: jnp.where(method == Method.footprint, b, a)  # noqa: E731
    cov, bias = either(facet.cov_enu, footprint.cov_enu), either(facet.bias_enu, footprint.bias_enu)
    method = jnp.where(counts_as_fix(jnp.asarray(nominal.fix.status)), method, NO_FIX)
    return LinearAccuracy(method, cov, bias, diagnostics)


def method_of(found: Diagnosed) -> Index:
    """The method selected by diagnostics: samples also where the error of the fix is not nearly normal."""
    method = select_method(found.diagnostics)
    if found.facet.model.is_normal:
        return method
    normal = jnp.where(method == Method.footprint, is_nearly_normal(found.footprint), is_nearly_normal(found.facet))
    return jnp.where(normal, method, Method.samples.value)


def linear_radii(one: LinearAccuracy, probability: Scalar) -> tuple[Numbers, Numbers, Numbers]:
    """Circular, linear and spherical error of one or many fixes; NaN where linear propagation is not valid."""
    is_linear = (one.method == Method.facet) | (one.method == Method.footprint)
    cov, bias = one.cov_enu, one.bias_enu
    radii = (
        circular_radius(cov, probability, bias),
        linear_radius(cov, probability, bias),
        spherical_radius(cov, probability, bias),
    )
    circular, linear, spherical = (jnp.where(is_linear, radius, jnp.nan) for radius in radii)
    return circular, linear, spherical
