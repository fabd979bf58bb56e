"""Accuracy of many fixes by linear propagation.

Only the derivatives by the errors are a program of the sensor and of the error model (`linear.derivatives`). The
slopes and the terrain profile are programs that all of them share, and the radii are computed by NumPy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._accelerator import by_device
from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Scalar
from jaxgeo.status import have_fix
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.host_arrays import block_size, concatenate
from jaxgeo.uncertainty.linear import OverSlope, Shared
from jaxgeo.uncertainty.linear_accuracy import LinearAccuracy, factors_over, valid_over_profile
from jaxgeo.uncertainty.method_selection import (
    LEVEL,
    NO_FIX,
    Examined,
    Method,
    diagnostics_of,
    examine,
    select_method,
)
from jaxgeo.uncertainty.model_inputs import NominalFix
from jaxgeo.uncertainty.profile import Profile
from jaxgeo.uncertainty.radii import radii_of_many

FEW = 128  # fixes
AT_ONCE = 16, 128  # of up to `FEW` fixes and of more, in a block on a CPU: more are not faster

# Whether the errors of fixes are nearly normal over (facet, footprint).
Normality = Callable[[NominalFix, OverSlope, OverSlope], tuple[Any, Any]]


class Perturbed(NamedTuple):
    """Nominal fixes of n observations, and the derivatives of their lines of sight by the errors."""

    nominal: NominalFix
    shared: Shared


class Assessed(NamedTuple):
    """Accuracy of n fixes with their radii in m (circular, linear, spherical), NaN where linear propagation is not
    valid."""

    nominal: NominalFix
    accuracy: LinearAccuracy
    radii: tuple[np.ndarray, np.ndarray, np.ndarray]


def size_of_blocks(count: int, most: int) -> int:
    """How many of `count` fixes to assess at a time, at most `most`: one of two sizes, so that two are compiled."""
    return min(most, by_device(AT_ONCE[count > FEW], block_size(count, most)))


def assess_blocks(
    blocks: Iterable[tuple[Perturbed, AbstractTerrain, Normality | None]],
    count: int,
    terrain_axis: int | None,
    probability: Scalar,
) -> Assessed:
    """Accuracy of the first `count` fixes of blocks, as NumPy arrays: of each `linear_accuracy.assess_fix`.

    A block is observations, their terrain (of each one with `terrain_axis` 0), and a test of their errors, None if
    these are all normal.
    """
    level = np.asarray(probability)
    nominals, found, radii = concatenate(
        [_assess(*block, terrain_axis, level) for block in blocks],
        count,
    )
    spherical = radii_of_many(found.cov_enu, level, found.bias_enu)
    with np.errstate(all="ignore"):
        return Assessed(nominals, found, valid_over_profile(np, found.method, (*radii, spherical), found.factors))


def _assess(
    perturbed: Perturbed,
    terrain: AbstractTerrain,
    normality: Normality | None,
    terrain_axis: int | None,
    probability: np.ndarray,
) -> tuple[NominalFix, LinearAccuracy, tuple[np.ndarray, np.ndarray]]:
    """(nominal fixes, accuracy, circular and linear error over the plane of the method) of a block."""
    nominal = perturbed.nominal
    found = examine_block(perturbed, terrain, terrain_axis)
    cov, bias = np.asarray(found.cov_enu), np.asarray(found.bias_enu)
    circular, linear = _in_plane(cov, np.asarray(LEVEL), bias)
    diagnostics = diagnostics_of(found, (*circular.T, *linear.T))
    method = np.asarray(select_method(diagnostics))
    is_facet = (method != Method.footprint)[:, None]
    if normality is not None:
        over_facet, over_footprint = normality(nominal, found.facet, found.footprint)
        normal = np.where(is_facet[:, 0], over_facet, over_footprint)
        method = np.where(normal, method, Method.samples.value)
    cov, bias = np.where(is_facet[..., None], cov[:, 0], cov[:, 1]), np.where(is_facet, bias[:, 0], bias[:, 1])
    about_fix = _in_plane(cov, probability, np.zeros_like(bias))
    factors = _factors_block(found.profile, nominal.direction_enu, cov, jnp.asarray(probability), about_fix)
    found_by: Any = np.where(have_fix(nominal.fix.status), method, NO_FIX), cov, bias, diagnostics, np.asarray(factors)
    if probability == LEVEL:
        circular, linear = (np.where(is_facet[:, 0], one[:, 0], one[:, 1]) for one in (circular, linear))
    else:
        circular, linear = _in_plane(cov, probability, bias)
    return nominal, LinearAccuracy(*found_by), (circular, linear)


@batch_filter_jit
def examine_block(perturbed: Perturbed, terrain: AbstractTerrain, terrain_axis: int | None) -> Examined:
    """What selects the method of each of n fixes."""

    def one(each: Perturbed, terrain: AbstractTerrain) -> Examined:
        nominal, shared = each
        return examine(terrain, nominal, shared.sweep(terrain, nominal), shared.cov_error)

    return jax.vmap(one, in_axes=(0, terrain_axis))(perturbed, terrain)


@batch_filter_jit
def _factors_block(
    profile: Profile, direction: Any, cov: Any, probability: Scalar, radii: tuple[Any, Any]
) -> Float[Array, "fixes 2"]:
    def one(profile: Profile, direction: Any, cov: Any, radii: tuple[Any, Any]) -> Any:
        return jnp.stack(factors_over(profile, direction, cov, probability, radii))

    return jax.vmap(one)(profile, direction, cov, radii)


def _in_plane(cov: np.ndarray, probability: np.ndarray, bias: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(circular, linear) errors of covariances (..., 3, 3) and biases (..., 3)."""
    circular = radii_of_many(cov[..., :2, :2], probability, bias[..., :2])
    return circular, radii_of_many(cov[..., 2:, 2:], probability, bias[..., 2:])
