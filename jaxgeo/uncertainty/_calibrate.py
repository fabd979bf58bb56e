"""Variance components of an error model from check points, by restricted maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily, when first used

from jaxgeo._blas_threads import one_thread
from jaxgeo._intersection import FIRST_HIT
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty._reml import LARGEST, ZERO, Likelihood, Minimum
from jaxgeo.uncertainty.calibration import Calibration, Component, FixedEffect
from jaxgeo.uncertainty.check_errors import CheckErrors, Part, errors_at
from jaxgeo.uncertainty.check_points import CheckPoints
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sources.base import AbstractSource

AXES = ("east", "north", "up")
ONE_REALISATION = 1e-6  # 1 - correlation between all pixels: they share one error
SAME_WAY = 0.8  # correlation of what two sources do to the pixels, above which one realisation cannot be told apart
WEAK = 0.1  # eigenvalue of the information, scaled to a diagonal of ones: the scales of parts there are not separable
FREEDOM = 1.0  # degrees of freedom below which a scale is not determined
SINGULAR = 1e-10  # of the largest eigenvalue
ROUNDING = 1e-6  # of a logarithm


def calibrate_errors(
    points: CheckPoints,
    terrain: AbstractTerrain,
    errors: Any,
    *,
    each_axis: bool = False,
    remove_mean: bool = True,
    hold: Collection[type[AbstractSource]] | Any = (),
    confidence: float = 0.95,
    search: AbstractSearch = FIRST_HIT,
) -> Calibration:
    """Factors of the standard deviations of `errors` that the errors at surveyed points call for.

    The errors of the fixes of `points` have the covariance sum_k s_k^2 J_k C_k J_k' + N: J_k C_k J_k' is that of source
    k by linear propagation, with what pixels share of it (`sharing`), N that of survey and measured pixels, which stay
    as stated. The factors s_k, one for each source (with `each_axis` for each axis of sources with independent axes),
    maximise the restricted likelihood: that of the combinations of errors which fixed effects do not change. These are
    the mean error in east, north and up (`remove_mean`), and the errors of sources of which the points hold one
    realisation only, such as a boresight in one flight; their sigmas stay as stated, as do those of the classes `hold`.

    Confidence intervals are those of the profile likelihood, which is not symmetric if there are few realisations; a
    factor of zero has the lower limit zero. `standard_error` is that of the logarithm of a
    factor, from the expected information, whose eigenvectors show what the points cannot tell apart. Of errors that
    are not normal the variances are used.

    Source: Patterson and Thompson 1971, "Recovery of inter-block information when block sizes are unequal"; Koch 1999,
    "Parameter Estimation and Hypothesis Testing in Linear Models", section 3.6. Raises as `validate`; `ValueError` if
    no source is left to calibrate, if there are too few errors for the factors, if a factor is above 8103, for a
    confidence outside (0, 1), and for a class to `hold` that the model does not have; `TypeError` for what is none.
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence must be between 0 and 1; got {confidence!r}.")
    hold = _checked_hold(hold)
    found = errors_at(points, terrain, errors, search)
    return _calibrate(found, errors, each_axis, remove_mean, hold, confidence)


def _checked_hold(hold: Any) -> tuple[type[AbstractSource], ...]:
    """The classes to hold; raises `TypeError` for anything else."""
    several: tuple[Any, ...] = tuple(hold) if isinstance(hold, Collection) and not isinstance(hold, str) else (hold,)
    for one in several:
        if not (isinstance(hold, Collection) and isinstance(one, type) and issubclass(one, AbstractSource)):
            raise TypeError(f"hold must be classes of error sources, as hold=(sources.Attitude,); got {one!r}.")
    return several


@one_thread()
def _calibrate(
    found: CheckErrors,
    errors: Any,
    each_axis: bool,
    remove_mean: bool,
    hold: tuple[type[AbstractSource], ...],
    confidence: float,
) -> Calibration:
    """Calibration from errors at check points."""
    for one in hold:
        if not any(isinstance(source, one) for source in found.model.sources):
            raise ValueError(f"hold: the error model has no {one.__name__}; leave it out.")
    parts = found.parts(each_axis)
    held = [_reason_to_hold(part, found.model, hold) for part in parts]
    single = [why is None and _is_one(part) for part, why in zip(parts, held, strict=True)]
    free = [number for number in range(len(parts)) if held[number] is None and not single[number]]
    if not free:
        told = "; ".join(_why_not(part, why) for part, why in zip(parts, held, strict=True))
        raise ValueError(f"calibrate_errors has no source to calibrate: {told}.")
    columns, names = _fixed(found, parts, single, remove_mean)
    known = found.noise + sum((parts[k].covariance for k in range(len(parts)) if held[k]), np.zeros(found.noise.shape))
    basis = _contrasts(columns, known, [parts[k].covariance for k in free])
    if basis.shape[1] <= len(free):
        raise ValueError(
            f"calibrate_errors has {basis.shape[1]} independent errors for {len(free)} factors, after "
            f"{columns.shape[1]} fixed effects; give more check points."
        )
    y = basis.T @ found.error  # standard normal for the stated sigmas
    likelihood = Likelihood.of(y, basis.T @ known @ basis, [basis.T @ parts[k].root() for k in free])
    best = likelihood.best(float(np.clip(0.5 * math.log(max(float(np.mean(y**2)), 1e-6)), -2.0, 4.0)))
    beyond = [parts[k].label for x, k in zip(best.x, free, strict=True) if x >= LARGEST - ROUNDING]
    if beyond:
        raise ValueError(
            f"the errors are more than {math.exp(LARGEST):.0f} times as large as stated for {' and '.join(beyond)}, "
            "the most that is tried; look at them by validate: the units of the sigmas, the datum of the heights, or "
            "points may be wrong."
        )
    goal = math.sqrt(float(scipy.stats.chi2.ppf(confidence, 1)))
    intervals = [likelihood.limits(best, number, goal) for number in range(len(free))]
    joint = known + sum(float(np.exp(2.0 * x)) * parts[k].covariance for x, k in zip(best.x, free, strict=True))
    deviations, unclear = _deviations(best, len(free))
    values = {k: (_scale(best.x[n]), *intervals[n], deviations[n]) for n, k in enumerate(free)}
    components = [_component(found.model, part, held[k], values.get(k)) for k, part in enumerate(parts)]
    at_stated = likelihood.at(np.zeros(len(free))).misfit
    return Calibration(
        components=tuple(components),
        fixed_effects=_effects(columns, names, found.error, joint),
        not_separable=(*_alone(parts, single, free), *(tuple(parts[free[k]].label for k in one) for one in unclear)),
        errors=_calibrated(errors, found.model, parts, [one.scale for one in components]),
        confidence=confidence,
        contrasts=basis.shape[1],
        gain=2.0 * (at_stated - best.misfit),
        pixels=len(found.index),
        note=found.model.left_out,
        without_fix=_without_fix(found),
    )


def _scale(x: float) -> float:
    return 0.0 if x <= ZERO else math.exp(x)


def _component(
    model: ErrorModel, part: Part, held: str | None, values: tuple[float, float, float, float] | None
) -> Component:
    """The record of a part; `values` are its factor, its limits and its standard error, if it is estimated."""
    source = model.sources[part.source]
    axes = source.sigma_axes if part.axis is None else (source.axes[part.axis],)
    sigma = np.asarray(source.sigma, np.float64)
    stated = sigma if part.axis is None else sigma[[part.axis]]
    if values is not None:
        return Component(part.label, axes, source.unit, stated, *values, None)
    why = held or "the points hold one realisation of it: a fixed effect"
    return Component(part.label, axes, source.unit, stated, 1.0, 1.0, 1.0, math.nan, why)


def _without_fix(found: CheckErrors) -> tuple[str, ...]:
    """Names of the points that have no fix, each with its status."""
    points = found.points
    rows = np.setdiff1d(np.arange(len(points)), found.index)
    return tuple(f"{points.points[row]} ({Status(int(found.seen.status[row])).name})" for row in rows)


def _reason_to_hold(part: Part, model: ErrorModel, hold: tuple[type[AbstractSource], ...]) -> str | None:
    """Why the factor of a part is one, None if it is to be estimated."""
    if isinstance(model.sources[part.source], hold):
        return "held as asked"
    if not np.any(part.covariance):
        return "its stated sigma is zero, or it does not move the fixes"
    return None


def _is_one(part: Part) -> bool:
    return bool(part.effects.shape[1] and np.all(part.correlation > 1.0 - ONE_REALISATION))


def _why_not(part: Part, why: str | None) -> str:
    return f"{part.label}: {why or 'the points hold one realisation of it'}"


def _fixed(
    found: CheckErrors, parts: list[Part], single: list[bool], remove_mean: bool
) -> tuple[np.ndarray, list[tuple[str, str]]]:
    """(columns of the fixed effects, the name and unit of each)."""
    count = len(found.index)
    columns = [np.tile(np.eye(3), (count, 1))] if remove_mean else []
    names = [(f"mean error {axis}", "m") for axis in AXES] if remove_mean else []
    for part, is_one in zip(parts, single, strict=True):
        if is_one:
            columns.append(part.effects)
            axes = _axes_of(found.model, part)
            names += [(f"{part.label} {axis}" if part.axis is None else part.label, "stated sigmas") for axis in axes]
    return np.concatenate(columns, axis=1) if columns else np.zeros((3 * count, 0)), names


def _contrasts(columns: np.ndarray, known: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    """Combinations (3 n, m) of the errors that fixed effects leave alone and that are not zero under the model."""
    whole = known + sum(parts)
    scale = np.sqrt(np.diag(whole))
    left = np.eye(len(scale))
    if columns.shape[1]:
        u, s, _ = np.linalg.svd(columns / scale[:, None], full_matrices=True)
        left = u[:, np.count_nonzero(s > 1e-9 * s[0]) :]
    values, vectors = np.linalg.eigh(left.T @ (whole / scale[:, None] / scale[None, :]) @ left)
    kept = values > SINGULAR * values[-1]
    return (left @ (vectors[:, kept] / np.sqrt(values[kept]))) / scale[:, None]


def _deviations(best: Minimum, count: int) -> tuple[list[float], list[tuple[int, ...]]]:
    """(standard errors of the logarithms; groups of parts that the points cannot tell apart)."""
    there = [k for k in range(count) if best.x[k] > ZERO]
    deviations = [math.nan] * count
    if not there:
        return deviations, []
    information = np.asarray(best.information)[np.ix_(there, there)]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / scale[:, None] / scale[None, :])
    inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T / scale[:, None] / scale[None, :]
    for place, number in enumerate(there):
        deviations[number] = float(np.sqrt(inverse[place, place]))
    groups = []
    for value, vector in zip(values, vectors.T, strict=True):
        members = tuple(there[k] for k in np.flatnonzero(np.abs(vector) > 0.4))
        if value < WEAK and len(members) > 1:
            groups.append(members)
    alone = [(k,) for k in there if deviations[k] > 1.0 / math.sqrt(2.0 * FREEDOM)]
    return deviations, groups + [one for one in alone if not any(one[0] in group for group in groups)]


def _alone(parts: list[Part], single: list[bool], free: list[int]) -> list[tuple[str, ...]]:
    """For each part of one realisation, itself and the calibrated parts that act on the pixels in the same way."""
    found = []
    for part, is_one in zip(parts, single, strict=True):
        if is_one:
            alike = [parts[k].label for k in free if _likeness(part, parts[k]) > SAME_WAY]
            found.append((part.label, *alike))
    return found


def _likeness(one: Part, other: Part) -> float:
    """Correlation of the covariances of single pixels that two parts make."""
    count = len(one.correlation)
    rows = np.arange(count)
    blocks = [x.covariance.reshape(count, 3, count, 3)[rows, :, rows, :].reshape(-1) for x in (one, other)]
    return float(blocks[0] @ blocks[1] / np.sqrt((blocks[0] @ blocks[0]) * (blocks[1] @ blocks[1])))


def _effects(
    columns: np.ndarray, names: list[tuple[str, str]], error: np.ndarray, joint: np.ndarray
) -> tuple[FixedEffect, ...]:
    """Fixed effects by generalised least squares; NaN where the points do not determine one."""
    if not names:
        return ()
    weighted = np.linalg.solve(joint, columns)
    normal = columns.T @ weighted
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal / scale[:, None] / scale[None, :])
    kept = values > 1e-9
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / scale[:, None] / scale[None, :]
    estimate = inverse @ (weighted.T @ error)
    known = np.sum(vectors[:, ~kept] ** 2, axis=1) < 1e-6
    sigma = np.where(known, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.nan)
    rows = zip(names, np.where(known, estimate, np.nan), sigma, strict=True)
    return tuple(FixedEffect(name, unit, float(value), float(s)) for (name, unit), value, s in rows)


def _axes_of(model: ErrorModel, part: Part) -> tuple[str, ...]:
    source = model.sources[part.source]
    return source.sigma_axes if part.axis is None else (source.axes[part.axis],)


def _calibrated(errors: Any, model: ErrorModel, parts: list[Part], scales: list[float]) -> ErrorModel:
    """The error model as given, with calibrated sigmas."""
    sources = errors.sources if isinstance(errors, ErrorModel) else errors
    sources = list((sources,) if isinstance(sources, AbstractSource) else sources)
    for number, source in enumerate(sources):
        factor = np.ones(len(model.sources[number].sigma_axes))
        for part, scale in zip(parts, scales, strict=True):
            if part.source == number:
                factor[slice(None) if part.axis is None else part.axis] = scale
        sources[number] = eqx.tree_at(lambda one: one.sigma, source, jnp.asarray(np.asarray(source.sigma) * factor))
    return ErrorModel(tuple(sources))
