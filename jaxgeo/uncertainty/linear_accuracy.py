"""Accuracy of fixes by the selected linear propagation, without samples; unchecked functions for `jit` and `vmap`."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxgeo._numerics import safe_sqrt
from jaxgeo._typing import IndexField, Matrix3Field, Numbers, Scalar, Vector3Field
from jaxgeo.status import counts_as_fix
from jaxgeo.uncertainty.method_selection import (
    AGREEMENT,
    AGREEMENT_UP,
    NO_FIX,
    Diagnosed,
    Diagnostics,
    Method,
    diagnose,
    select_method,
)
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.radii import circular_radius, linear_radius, spherical_radius

STEPS = 0.002  # of the logarithm: figures over the profile of a plane are off by less, for its steps


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
    method = select_method(diagnostics)
    either = lambda a, b: jnp.where(method == Method.footprint, b, a)  # noqa: E731
    cov, bias = either(facet.cov_enu, footprint.cov_enu), either(facet.bias_enu, footprint.bias_enu)
    method = jnp.where(counts_as_fix(jnp.asarray(nominal.fix.status)), method, NO_FIX)
    return LinearAccuracy(method, cov, bias, diagnostics)


def linear_radii(one: LinearAccuracy, probability: Scalar) -> tuple[Numbers, Numbers, Numbers]:
    """Circular, linear and spherical error of one or many fixes; NaN where linear propagation is not valid."""
    is_linear = (one.method == Method.facet) | (one.method == Method.footprint)
    cov, bias = one.cov_enu, one.bias_enu
    radii = (
        circular_radius(cov, probability, bias),
        linear_radius(cov, probability, bias),
        spherical_radius(cov, probability, bias),
    )
    circular, linear, spherical = over_profile(radii, one.diagnostics, one.method)
    circular, linear, spherical = (jnp.where(is_linear, radius, jnp.nan) for radius in (circular, linear, spherical))
    return circular, linear, spherical


def over_profile(
    radii: tuple[Numbers, Numbers, Numbers], diagnostics: Diagnostics, method: IndexField
) -> tuple[Numbers, Numbers, Numbers]:
    """Radii of linear propagation by `method`, in proportion to what the terrain profile makes of them at 90 %.

    The profile follows the ground along the line of sight, which facet and footprint take for a plane. Derivatives are
    those of linear propagation.
    """
    circular, linear, spherical = radii
    is_footprint = method == Method.footprint
    plane = jnp.where(is_footprint, diagnostics.footprint, diagnostics.facet)
    plane_up = jnp.where(is_footprint, diagnostics.footprint_up, diagnostics.facet_up)
    across = _factor(diagnostics.profile, plane, AGREEMENT)
    up = _factor(diagnostics.profile_up, plane_up, AGREEMENT_UP)
    beyond = jnp.maximum(spherical**2 - circular**2, 0.0)  # of the height
    level = spherical**2 - beyond
    return circular * across, linear * up, safe_sqrt(level * across**2 + beyond * up**2)


def _factor(profile: Numbers, plane: Numbers, most: float) -> Numbers:
    """Ratio of two figures, 1 where they are the same within the profile's steps, and at most the agreement asked."""
    profile, plane = jax.lax.stop_gradient((profile, plane))
    both = (profile > 0.0) & (plane > 0.0) & jnp.isfinite(profile) & jnp.isfinite(plane)
    off = jnp.log(jnp.where(both, profile, 1.0) / jnp.where(both, plane, 1.0))
    return jnp.exp(jnp.clip(off - jnp.clip(off, -STEPS, STEPS), -most, most))
