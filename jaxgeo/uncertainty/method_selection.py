"""Selection of the cheapest valid error propagation method at a fix, without sampling."""

from __future__ import annotations

import enum
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._checks import by_numpy_if_known, is_known
from jaxgeo._compile import quick_filter_jit
from jaxgeo._record import portable
from jaxgeo._typing import Scalar
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty._figures import figure
from jaxgeo.uncertainty.linear import (
    FACET,
    OverSlope,
    Propagation,
    Shared,
    derivatives,
    over_slope,
    propagation_of,
)
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix, Sweep
from jaxgeo.uncertainty.profile import Profile, profile_of
from jaxgeo.uncertainty.radii import circular_radius, linear_radius
from jaxgeo.uncertainty.slopes import Footprint

FOOTPRINT = Footprint()
# Thresholds tuned on synthetic terrain, validated on other terrain (benchmarks/verdict.py).
AGREEMENT = 0.1  # largest log ratio at which two circular errors agree
AGREEMENT_UP = 0.15  # the same for linear errors
NOTHING = 1e-3  # of the circular error: smaller linear errors, as on level ground of known height, are negligible
UPRIGHT = 2e-3  # of the linear error: smaller circular errors are those of a fix that moves up and down alone
FEW = 0.01  # probability: a larger share of lines of sight that jump or fail affects a 90 % figure
SAME_GROUND = 0.1  # m: largest offset of the probed ground from the fix for the two to agree
NO_FIX = -1  # in place of a `Method`, without a fix
LEVEL = 0.9  # probability of the figures that are compared
# 95 % of exact circular errors are within these logarithms of that by linear propagation (benchmarks/verdict.py).
MARGIN, MARGIN_OF_SPREAD, SPREAD = 0.014, 0.45, 0.1
MARGIN_OF_JUMPS, FEWEST_JUMPS = 0.08, 1e-6  # where lines of sight jump or fail with a probability
GRAZING = 0.01  # sine of the angle between ray and surface
PLANAR = 0.01  # of the larger of two figures: smaller differences by two slopes are those of planar ground
CLOSE = 0.05  # largest difference of circular errors, as a share, that the reason gives as one number
SAME = 5e-4  # difference of two figures, of their size, that is not worth a word


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

    diagnostics: Diagnostics
    facet: Propagation
    footprint: Propagation
    profile: Profile


def diagnose(inputs: ModelInputs, nominal: NominalFix, model: ErrorModel) -> Diagnosed:
    """Diagnostics of a fix, without samples."""
    if is_known((inputs, nominal, model)):
        errors = derivatives(inputs, nominal, model)
        found = _examine_shared(inputs.terrain, nominal, errors.shared)
        facet, footprint = (errors.propagation(nominal, one) for one in (found.facet, found.footprint))
    else:
        model = model.at(inputs, nominal)
        sweep, cov_error = model.sweep(inputs, nominal), model.covariance()
        found = examine(inputs.terrain, nominal, sweep, cov_error)
        facet, footprint = (propagation_of(nominal, model, cov_error, one) for one in (found.facet, found.footprint))
    return Diagnosed(_diagnostics(found), facet, footprint, found.profile)


class Examined(NamedTuple):
    """What the diagnostics come from: linear propagation over facet and footprint, the terrain profile and its circular
    and linear error, the covariances (2, 3, 3) and biases (2, 3) over facet and footprint."""

    facet: OverSlope
    footprint: OverSlope
    profile: Profile
    over_profile: tuple[Scalar, Scalar]
    cov_enu: Float[Array, "2 3 3"]
    bias_enu: Float[Array, "2 3"]
    grazing: Scalar


@quick_filter_jit
def _examine_shared(terrain: AbstractTerrain, nominal: NominalFix, shared: Shared) -> Examined:
    return examine(terrain, nominal, shared.sweep(terrain, nominal), shared.cov_error)


def examine(
    terrain: AbstractTerrain, nominal: NominalFix, sweep: Sweep, cov_error: Float[Array, "axes axes"]
) -> Examined:
    facet, footprint = (over_slope(terrain, nominal, sweep, cov_error, slope) for slope in (FACET, FOOTPRINT))
    profile = profile_of(terrain, nominal, sweep, cov_error, footprint.surface.normal)
    return Examined(
        facet,
        footprint,
        profile,
        (profile.circular_error(LEVEL), profile.linear_error(LEVEL)),
        jnp.stack([facet.cov_enu, footprint.cov_enu]),
        jnp.stack([facet.bias_enu, footprint.bias_enu]),
        jnp.abs(jnp.cos(jnp.asarray(nominal.fix.incidence_surface))),
    )


def _diagnostics(found: Examined) -> Diagnostics:
    radii = (radius(found.cov_enu, LEVEL, found.bias_enu) for radius in (circular_radius, linear_radius))
    both = [by_numpy_if_known(lambda _, x: (x[0], x[1]), x) for x in radii]
    return diagnostics_of(found, (*both[0], *both[1]))


def diagnostics_of(found: Examined, radii: tuple[Any, Any, Any, Any]) -> Diagnostics:
    """Diagnostics with given radii of `LEVEL`: circular errors over (facet, footprint), then linear errors."""
    profile, profile_up = found.over_profile
    facet, footprint, facet_up, footprint_up = radii
    return Diagnostics(
        facet,
        footprint,
        profile,
        facet_up,
        footprint_up,
        profile_up,
        found.profile.jumps,
        found.profile.fails,
        found.profile.clearance,
        found.grazing,
        found.footprint.surface.known,
        found.profile.off,
    )


class Method(enum.IntEnum):
    """Cheapest valid error propagation method at a fix."""

    facet = 0
    footprint = 1
    samples = 2

    @property
    def words(self) -> str:
        """Display name of the method."""
        return ("linear propagation", "linear propagation over the footprint", "samples")[self]


def select_method(diagnostics: Diagnostics) -> Int[Array, "..."]:
    """The valid method according to the diagnostics of one or many fixes, as a `Method` code."""
    return by_numpy_if_known(_select_method, diagnostics)


def _select_method(xp: Any, diagnostics: Any) -> Any:
    calm = (diagnostics.jumps + diagnostics.fails <= FEW) & (diagnostics.known == 1.0) & (diagnostics.grazing > GRAZING)
    calm &= diagnostics.off <= SAME_GROUND
    least = NOTHING * diagnostics.profile
    upright = _is_upright(xp, diagnostics)
    facet = _agree(xp, diagnostics.facet, diagnostics.profile, AGREEMENT)
    facet &= _agree(xp, diagnostics.facet, diagnostics.footprint, AGREEMENT)
    facet |= upright
    facet &= _agree(xp, diagnostics.facet_up + least, diagnostics.profile_up + least, AGREEMENT_UP)
    footprint = _agree(xp, diagnostics.footprint, diagnostics.profile, AGREEMENT) | upright
    footprint &= _agree(xp, diagnostics.footprint_up + least, diagnostics.profile_up + least, AGREEMENT_UP)
    code = xp.where(calm & footprint, Method.footprint.value, Method.samples.value)
    return xp.where((calm & facet) | _is_exact(diagnostics), Method.facet.value, code)


def _is_exact(diagnostics: Any) -> Any:
    """Whether no error moves the fix, as where all standard deviations are zero."""
    return (diagnostics.facet == 0.0) & (diagnostics.facet_up == 0.0)


def _is_upright(xp: Any, diagnostics: Any) -> Any:
    """Whether errors move the fix up and down alone, as those of the ground's height along a vertical line of sight."""
    across = xp.maximum(xp.maximum(diagnostics.facet, diagnostics.footprint), diagnostics.profile)
    return across <= UPRIGHT * diagnostics.facet_up


def relative_margin(xp: Any, diagnostics: Any) -> Any:
    """Half the width of a 95 % interval of the circular error by linear propagation, as a difference of logarithms.

    What facet and footprint differ by from the terrain profile tells how far from planar the ground is, and the
    probability of lines of sight that jump how far from one slope. For fixes that are not sent to samples. `xp` is
    NumPy or jax.numpy.
    """
    spread = xp.maximum(
        xp.abs(xp.log(diagnostics.facet / diagnostics.profile)),
        xp.abs(xp.log(diagnostics.footprint / diagnostics.profile)),
    )
    spread = xp.where(xp.isfinite(spread), xp.minimum(spread, SPREAD), SPREAD)
    jumps = diagnostics.jumps + diagnostics.fails
    return MARGIN + MARGIN_OF_SPREAD * spread + xp.where(jumps > FEWEST_JUMPS, MARGIN_OF_JUMPS, 0.0)


def _agree(xp: Any, one: Any, other: Any, tolerance: float) -> Any:
    """Whether two figures differ by less than a log ratio; infinite, zero or NaN figures do not agree."""
    return xp.abs(xp.log(one / other)) <= tolerance


def explain_method(diagnostics: Diagnostics, method: Method) -> str:
    """Why this method was selected and no cheaper one, with the deciding figures."""
    if method is Method.facet and bool(_is_exact(jax.device_get(diagnostics))):
        return "No error moves the fix: it is as exact as its input."
    if method is not Method.samples and bool(_is_upright(jnp, diagnostics)):
        return (
            "The errors move the fix up and down alone: the line of sight is vertical, and nothing turns or shifts it."
        )
    jumps, fails = 100.0 * float(diagnostics.jumps), 100.0 * float(diagnostics.fails)
    circular = _against_profile("CE90", diagnostics.facet, diagnostics.footprint, diagnostics.profile)
    up = _against_profile("LE90", diagnostics.facet_up, diagnostics.footprint_up, diagnostics.profile_up)
    if method is Method.facet:
        return _planar(diagnostics, circular)
    if method is Method.footprint and _differ(diagnostics.facet, diagnostics.footprint):
        said = "The slope at the fix differs from the mean slope of the error region"
        return f"{said}: {circular}, which the radii follow."
    if method is Method.footprint:
        return f"The heights of the error region differ from a plane through the fix: {up}, which the radii follow."
    obstacle = _obstacle(diagnostics, fails, jumps)
    if obstacle is not None:
        return f"{obstacle}; {circular}."
    if not math.isfinite(float(diagnostics.profile) + float(diagnostics.profile_up)):
        return f"Errors over the ground along the line of sight are unbounded or unknown: {circular}; {up}."
    if _differ(diagnostics.facet, diagnostics.footprint) or _differ(diagnostics.facet_up, diagnostics.footprint_up):
        return f"The ground is not planar within the error region: {circular}; {up}."
    angle = math.degrees(math.asin(min(float(diagnostics.grazing), 1.0)))
    large = f"The errors are too large for linear propagation with a line of sight at {angle:.2g} deg to the ground"
    return f"{large}, though the ground is nearly planar within the error region: {circular}; {up}."


def _planar(diagnostics: Diagnostics, circular: str) -> str:
    """That linear propagation is valid, with the differences of the figures only if these are large."""
    profile = float(diagnostics.profile)
    off = max(abs(float(one) / profile - 1.0) for one in (diagnostics.facet, diagnostics.footprint))
    said = "The ground is nearly planar within the error region"
    if off <= CLOSE:
        percent = max(math.ceil(1e3 * off) / 10.0, 0.1)
        return f"{said}, as linear propagation needs: CE90 found in three ways is the same within {percent:g} %."
    return f"{said}: {circular}, which the radii follow."


def _differ(one: Any, other: Any) -> bool:
    """Whether the figures by the slope at the fix and by the mean slope differ, as they do over ground that is bent."""
    one, other = float(one), float(other)
    return not abs(one - other) <= PLANAR * max(abs(one), abs(other))


def _against_profile(name: str, *figures: Any) -> str:
    """By how much a figure by the slope at the fix, and by the mean slope of the error region, differs from that over
    the ground along the line of sight."""
    *others, profile = map(float, figures)
    if not math.isfinite(profile):
        return f"{name} is unknown over the ground along the line of sight"
    ratios = [one / profile if profile > 0.0 else math.nan for one in others]
    if all(abs(ratio - 1.0) < SAME for ratio in ratios):
        slopes = "by the slope at the fix, by the mean slope of the error region"
        return f"{name} is the same {slopes} and over the ground along the line of sight"
    facet, footprint = map(_larger, ratios)
    by_slopes = f"{facet} by the slope at the fix and {footprint} by the mean slope of the error region"
    return f"{name} is {by_slopes} than over the ground along the line of sight"


def _larger(ratio: float) -> str:
    """A ratio as a difference in percent, or as a factor where it is large."""
    if not math.isfinite(ratio):
        return "incomparably larger"
    if ratio > 3.0:
        return f"{figure(ratio)} times larger"
    percent = abs(100.0 * (ratio - 1.0))
    return f"{percent:.{1 if percent < 10.0 else 0}f} % {'larger' if ratio >= 1.0 else 'smaller'}"


def _obstacle(diagnostics: Diagnostics, fails: float, jumps: float) -> str | None:
    """Condition that rules out linear propagation even if the figures agree, or None; `fails` and `jumps` in %."""
    off, known, grazing = float(diagnostics.off), float(diagnostics.known), float(diagnostics.grazing)
    if not off <= SAME_GROUND:
        where = f"{figure(off)} m from the fix" if math.isfinite(off) else "nowhere near the fix"
        return f"The terrain surface sampled from above lies {where}, so the ground at the fix is unknown"
    if fails + jumps > 100.0 * FEW and fails >= jumps:
        return f"{figure(fails, 2)} % of the perturbed lines of sight meet no known ground ahead of the camera"
    if fails + jumps > 100.0 * FEW:
        clearance = float(diagnostics.clearance)
        other = f"hit a nearer or farther slope (first at {figure(clearance, 2)} sigma)"
        return f"{figure(jumps, 2)} % of the perturbed lines of sight {other}"
    if known != 1.0:
        return f"{figure(100.0 * (1.0 - known), 2)} % of the ground in the footprint is unknown"
    if not grazing > GRAZING:
        return f"The line of sight grazes the surface, at {1e3 * grazing:.2g} mrad"
    return None
