"""Accuracy of fixes by the selected linear propagation, without samples; unchecked functions for `jit` and `vmap`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import by_numpy_if_known
from jaxgeo._compile import quick_filter_jit
from jaxgeo._numerics import safe_sqrt
from jaxgeo._typing import Index, IndexField, Matrix3Field, Numbers, Scalar, Vector3Field
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
from jaxgeo.uncertainty.normality import is_nearly_normal
from jaxgeo.uncertainty.profile import Profile
from jaxgeo.uncertainty.radii import circular_radius, linear_radius, spherical_radius
from jaxgeo.uncertainty.sight_plane import along_of

STEPS = 0.002  # of the logarithm: figures over the profile of a plane are off by less, for its steps


class LinearAccuracy(NamedTuple):
    """Selected method at a fix, with the covariance in m2 and bias in m (east, north, up) of linear propagation.

    `factors` are those by which the terrain profile makes circular and linear errors larger than they are over the
    plane of linear propagation.
    """

    method: IndexField
    cov_enu: Matrix3Field
    bias_enu: Vector3Field
    diagnostics: Diagnostics
    factors: Float[Array, "2"]


def assess_fix(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel, probability: Scalar) -> LinearAccuracy:
    """Method selected by the diagnostics of an observation, for radii of a probability."""
    return select_linear(diagnose(inputs, nominal, model), nominal, probability)


def select_linear(found: Diagnosed, nominal: NominalFix, probability: Scalar) -> LinearAccuracy:
    """Method selected by diagnostics, for radii of a probability."""
    diagnostics, facet, footprint, profile = found
    method = method_of(found)
    either = lambda a, b: jnp.where(method == Method.footprint, b, a)  # noqa: E731
    cov, bias = either(facet.cov_enu, footprint.cov_enu), either(facet.bias_enu, footprint.bias_enu)
    factors = jnp.stack(profile_factors(profile, nominal, cov, probability))
    method = jnp.where(counts_as_fix(jnp.asarray(nominal.fix.status)), method, NO_FIX)
    return LinearAccuracy(method, cov, bias, diagnostics, factors)


def select_known(found: Diagnosed, nominal: NominalFix, probability: Scalar) -> LinearAccuracy:
    """`select_linear` of known numbers about a fix, with as few programs to compile as that takes.

    Where samples are needed the factors are 1: no radii are made of them.
    """
    diagnostics, facet, footprint, profile = found
    method = Method(int(select_method(diagnostics) if facet.model.is_normal else _method_of(found)))
    linear = facet if method is Method.facet else footprint
    factors: Any = np.ones(2)
    if method is not Method.samples:
        about_fix = radii_about_fix(linear.cov_enu, probability)
        factors = _factors_of_one(profile, nominal.direction_enu, linear.cov_enu, probability, about_fix)
    return LinearAccuracy(jnp.asarray(int(method)), linear.cov_enu, linear.bias_enu, diagnostics, factors)


def method_of(found: Diagnosed) -> Index:
    """The method selected by diagnostics: samples also where the error of the fix is not nearly normal."""
    method = select_method(found.diagnostics)
    if found.facet.model.is_normal:
        return method
    normal = jnp.where(method == Method.footprint, is_nearly_normal(found.footprint), is_nearly_normal(found.facet))
    return jnp.where(normal, method, Method.samples.value)


def linear_radii(one: LinearAccuracy, probability: Scalar) -> tuple[Numbers, Numbers, Numbers]:
    """Circular, linear and spherical error of one or many fixes, of the probability that their factors are for; NaN
    where linear propagation is not valid."""
    cov, bias = one.cov_enu, one.bias_enu
    radii = (
        circular_radius(cov, probability, bias),
        linear_radius(cov, probability, bias),
        spherical_radius(cov, probability, bias),
    )
    return by_numpy_if_known(valid_over_profile, one.method, radii, one.factors)


def valid_over_profile(xp: Any, method: Any, radii: tuple[Any, Any, Any], factors: Any) -> tuple[Any, Any, Any]:
    """Radii over the terrain profile, NaN where linear propagation is not valid; `xp` is NumPy or jax.numpy."""
    is_linear = (method == Method.facet) | (method == Method.footprint)
    circular, linear, spherical = (xp.where(is_linear, one, xp.nan) for one in over_profile(xp, radii, factors))
    return circular, linear, spherical


def profile_factors(
    profile: Profile, nominal: NominalFix, cov_enu: Matrix3Field, probability: Scalar
) -> tuple[Scalar, Scalar]:
    """(circular, linear) error over the terrain profile, divided by that over the plane of linear propagation.

    Facet and footprint take the ground for a plane; the profile follows it along the line of sight. The figures that
    are divided come from the same lines of sight, so that on a plane the factors are 1. Without derivatives.
    """
    return factors_over(profile, nominal.direction_enu, cov_enu, probability, radii_about_fix(cov_enu, probability))


def radii_about_fix(cov_enu: Matrix3Field, probability: Scalar) -> tuple[Numbers, Numbers]:
    """(circular, linear) error of a covariance without a bias."""
    cov, probability = jax.lax.stop_gradient((cov_enu, probability))
    middle = np.zeros(3)
    return circular_radius(cov, probability, middle), linear_radius(cov, probability, middle)


def factors_over(
    profile: Profile,
    direction_enu: Vector3Field,
    cov_enu: Matrix3Field,
    probability: Scalar,
    radii: tuple[Numbers, Numbers],
) -> tuple[Scalar, Scalar]:
    """`profile_factors` for given `radii_about_fix`."""
    given = jax.lax.stop_gradient((cov_enu, direction_enu, probability, radii))
    cov, direction, probability, radii = given
    along, _ = along_of(direction)
    plane = profile.over_plane(safe_sqrt(along @ cov[:2, :2] @ along), safe_sqrt(cov[2, 2]))
    both = jax.tree.map(lambda *leaves: jnp.stack(leaves), profile, plane)
    circular, linear = _ends(radii[0], AGREEMENT), _ends(radii[1], AGREEMENT_UP)
    across = jax.vmap(lambda one: one.circular_error(probability, circular))(both)
    up = jax.vmap(lambda one: one.linear_error(probability, linear))(both)
    return _factor(across[0], across[1], AGREEMENT), _factor(up[0], up[1], AGREEMENT_UP)


@quick_filter_jit
def _factors_of_one(*given: Any) -> Float[Array, "2"]:
    return jnp.stack(factors_over(*given))


_method_of = quick_filter_jit(method_of)


def _ends(radius: Scalar, most: float) -> tuple[Scalar, Scalar]:
    """Radii about one between which figures that agree lie, both with a margin for the profile's steps."""
    return radius * math.exp(-2.0 * most), radius * math.exp(2.0 * most)


def over_profile(xp: Any, radii: tuple[Any, Any, Any], factors: Any) -> tuple[Any, Any, Any]:
    """Circular, linear and spherical error of linear propagation, times the factors (..., 2) of the terrain profile.

    `xp` is NumPy or jax.numpy.
    """
    circular, linear, spherical = radii
    across, up = factors[..., 0], factors[..., 1]
    beyond = xp.maximum(spherical**2 - circular**2, 0.0)  # of the height
    root = safe_sqrt if xp is jnp else xp.sqrt
    return circular * across, linear * up, root((spherical**2 - beyond) * across**2 + beyond * up**2)


def _factor(profile: Numbers, plane: Numbers, most: float) -> Numbers:
    """Ratio of two figures, 1 where they are the same within the profile's steps, and at most the agreement asked."""
    both = (profile > 0.0) & (plane > 0.0) & jnp.isfinite(profile) & jnp.isfinite(plane)
    off = jnp.log(jnp.where(both, profile, 1.0) / jnp.where(both, plane, 1.0))
    return jnp.exp(jnp.clip(off - jnp.clip(off, -STEPS, STEPS), -most, most))
