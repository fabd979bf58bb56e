"""Which way of propagating errors can be trusted at a fix, told without drawing a sample."""

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
# Set on made-up terrain, judged on other terrain (benchmarks/verdict.py).
AGREEMENT = 0.1  # of a logarithm: circular errors that differ by more do not agree
AGREEMENT_UP = 0.15  # the same of linear errors
NOTHING = (
    1e-3  # of the circular error: linear errors smaller than this, of level ground that is sure, count for nothing
)
FEW = 0.01  # of chance: more lines of sight that jump or fail show in a figure at 90 %
SAME_GROUND = 0.1  # m: ground that is probed farther from the fix than this is not what the line of sight met
GRAZING = 0.01  # sine of the angle between ray and surface


@portable
class Diagnostics(NamedTuple):
    """What can be known of a fix's error without samples: figures at 90 % in m, and how the ground lies about it.

    `facet`, `footprint` and `profile` are circular errors by the slope under the fix, by that of its footprint, and
    over the profile of the ground along the look; `facet_up`, `footprint_up` and `profile_up` linear errors. `jumps`
    and `fails` are shares of chance, `clearance` how many sigmas off they begin; `grazing` is the sine of the angle
    between ray and surface, `known` the share of the footprint over known ground, `off` how far in m the ground probed
    at the fix lies from it: infinite if it is unknown there.
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
    """The signs of a fix, and what they were read from: linear propagation over its facet and its footprint, and the
    profile of the ground."""

    signs: Diagnostics
    facet: Propagation
    footprint: Propagation
    profile: Profile


@eqx.filter_jit
def diagnose(look: ModelInputs, aim: NominalFix, model: ErrorModel) -> Diagnosed:
    """What can be known of how sure a fix is without samples."""
    model = model.at(look, aim)
    sweep = model.sweep(look, aim)
    facet, footprint = (swept_over(look, aim, model, sweep, slope) for slope in (FACET, FOOTPRINT))
    grazing = jnp.abs(jnp.cos(jnp.asarray(aim.fix.incidence_surface)))
    cov = jnp.stack([facet.cov_enu, footprint.cov_enu])  # both at once: what inverts the integral is compiled once
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
    """The cheapest method that can be trusted at a fix."""

    facet = 0
    footprint = 1
    samples = 2

    @property
    def words(self) -> str:
        """The method, in words."""
        return ("linear propagation", "linear propagation over the footprint", "samples")[self]


def method_of(signs: Diagnostics) -> Int[Array, ""]:
    """Which method the signs trust, as a `Method`; under `vmap` for many fixes."""
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
    """Whether two figures differ by no more than is trusted; those that are infinite, zero or NaN do not agree."""
    return jnp.abs(jnp.log(one / other)) <= tolerance
