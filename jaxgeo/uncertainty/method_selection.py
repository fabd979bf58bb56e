"""Selection of the cheapest valid error propagation method at a fix, without sampling."""

from __future__ import annotations

import enum
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxgeo._record import portable
from jaxgeo._typing import Flag, Scalar
from jaxgeo.uncertainty.linear import FACET, Propagation, swept_over
from jaxgeo.uncertainty.metrics import circular_error, linear_error
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix
from jaxgeo.uncertainty.profile import Profile, profile_of
from jaxgeo.uncertainty.slopes import Footprint

FOOTPRINT = Footprint()
# Thresholds tuned on synthetic terrain, validated on other terrain (benchmarks/verdict.py).
AGREEMENT = 0.1  # largest log ratio at which two circular errors agree
AGREEMENT_UP = 0.15  # the same for linear errors
NOTHING = 1e-3  # of the circular error: smaller linear errors, as on level ground of known height, are negligible
FEW = 0.01  # probability: a larger share of lines of sight that jump or fail affects a 90 % figure
SAME_GROUND = 0.1  # m: largest offset of the probed ground from the fix for the two to agree
GRAZING = 0.01  # sine of the angle between ray and surface


@portable
class Diagnostics(NamedTuple):
    """Diagnostics of a fix computed without samples: 90 % figures in m, and the terrain around it.

    `facet`, `footprint` and `profile` are circular errors for the slope under the fix, for the plane fitted to the
    footprint, and for the terrain profile along the line of sight; `facet_up`, `footprint_up` and `profile_up` are the
    linear errors. `jumps` and `fails` are probabilities, `clearance` the number of sigmas at which they begin;
    `grazing` is the sine of the angle between ray and surface, `known` the share of the footprint over known ground,
    `off` the distance in m between the ground probed at the fix and the fix, infinite if the ground is unknown there.
    """

    facet: Scalar
    footprint: Scalar
    profile: Scalar
    facet_up: Scalar
    footprint_up: Scalar
    profile_up: Scalar
    jumps: Scalar
    fails: Scalar
    clearance: Scalar
    grazing: Scalar
    known: Scalar
    off: Scalar


@portable
class Diagnosed(NamedTuple):
    """Diagnostics of a fix with their sources: linear propagation over facet and footprint, and the terrain profile."""

    signs: Diagnostics
    facet: Propagation
    footprint: Propagation
    profile: Profile


@eqx.filter_jit
def diagnose(look: ModelInputs, aim: NominalFix, model: ErrorModel) -> Diagnosed:
    """Diagnostics of a fix, without samples."""
    model = model.at(look, aim)
    sweep = model.sweep(look, aim)
    facet, footprint = (swept_over(look, aim, model, sweep, slope) for slope in (FACET, FOOTPRINT))
    grazing = jnp.abs(jnp.cos(jnp.asarray(aim.fix.incidence_surface)))
    cov = jnp.stack([facet.cov_enu, footprint.cov_enu])  # stacked: the inverse of the integral is compiled once
    bias = jnp.stack([facet.bias_enu, footprint.bias_enu])
    facet_ce, footprint_ce = circular_error(cov[:, :2, :2], 0.9, bias[:, :2])
    facet_le, footprint_le = linear_error(cov[:, 2, 2], 0.9, bias[:, 2])
    profile = profile_of(look.terrain, aim, sweep, facet.cov_error, footprint.surface.normal)
    signs = Diagnostics(
        facet_ce,
        footprint_ce,
        profile.circular_error(0.9),
        facet_le,
        footprint_le,
        profile.linear_error(0.9),
        profile.jumps,
        profile.fails,
        profile.clearance,
        grazing,
        footprint.surface.known,
        profile.off,
    )
    return Diagnosed(signs, facet, footprint, profile)


class Method(enum.IntEnum):
    """Cheapest valid error propagation method at a fix."""

    facet = 0
    footprint = 1
    samples = 2

    @property
    def words(self) -> str:
        """Display name of the method."""
        return ("linear propagation", "linear propagation over the footprint", "samples")[self]


def method_of(signs: Diagnostics) -> Int[Array, ""]:
    """The valid method according to the diagnostics, as a `Method` code; use `vmap` for many fixes."""
    calm = (signs.jumps + signs.fails <= FEW) & (signs.known == 1.0) & (signs.grazing > GRAZING)
    calm &= signs.off <= SAME_GROUND
    least = NOTHING * signs.profile
    facet = _agree(signs.facet, signs.profile, AGREEMENT) & _agree(signs.facet, signs.footprint, AGREEMENT)
    facet &= _agree(signs.facet_up + least, signs.profile_up + least, AGREEMENT_UP)
    footprint = _agree(signs.footprint, signs.profile, AGREEMENT)
    footprint &= _agree(signs.footprint_up + least, signs.profile_up + least, AGREEMENT_UP)
    code = jnp.where(calm & footprint, Method.footprint.value, Method.samples.value)
    return jnp.where(calm & facet, Method.facet.value, code)


def _agree(one: Scalar, other: Scalar, tolerance: float) -> Flag:
    """Whether two figures differ by less than a log ratio; infinite, zero or NaN figures do not agree."""
    return jnp.abs(jnp.log(one / other)) <= tolerance
