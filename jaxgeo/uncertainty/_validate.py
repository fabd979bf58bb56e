"""Comparison of actual errors at check points with those that an error model states."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import numpy as np
import scipy  # submodules load lazily, when first used

from jaxgeo._blas_threads import one_thread
from jaxgeo._intersection import FIRST_HIT
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.check_errors import CheckErrors, errors_at
from jaxgeo.uncertainty.check_points import CheckPoints
from jaxgeo.uncertainty.metrics._host import host_radii
from jaxgeo.uncertainty.validation import (
    CONFIDENCE,
    LEVELS,
    Bias,
    Coverage,
    Dependence,
    Size,
    Uniformity,
    Validation,
    is_constant,
)

DRAWS = 4000  # of the errors under the model, for the coverage of points whose errors are shared
LEAST = 3  # pixels with a fix
BINS = 10
RATIOS = 61  # of the axes of an ellipse, between which the radius of its circle is interpolated
SINGULAR = 1e-10  # of the largest eigenvalue: combinations of errors that are zero under the model, and not tested
ROUNDING = 1e-12  # relative: errors that do not scatter
EXACT = 8  # pixels up to which ranks are tested by all their orders: the usual approximation is wrong for few


def validate(
    points: CheckPoints, terrain: AbstractTerrain, errors: Any, *, search: AbstractSearch = FIRST_HIT
) -> Validation:
    """Whether the errors of fixes at surveyed points are as `errors` states them.

    The errors are those of the fixes of `points.observation` over `terrain`, in m east, north and up at each. Their
    joint covariance is that of linear propagation, with what points share of each source (`sharing`), of the survey
    and of the measured pixels. Combinations of errors that are zero under the model, such as height differences of one
    point in two images over a terrain that errs everywhere alike, are not tested. Tests at 5 %, each with a figure in
    words (`str(found)`):

    - size: the normalised squared error (NEES), chi-square; also of the horizontal and the vertical errors alone,
    - shape: the errors made independent by the inverse square root of their covariance are standard normal
      (Kolmogorov-Smirnov test of the probability integral transform),
    - bias: the mean error by axis, by its sigma under the model (z), and Student's t test as if points shared nothing,
    - dependence of the independent errors' size on range, look angle off the vertical, and slope of the ground
      (Spearman's rank test, exact up to 8 pixels),
    - coverage of CE and LE at 50, 90 and 95 %, with Clopper-Pearson intervals for the number of independent points to
      which the points amount (found by simulation of the model's joint errors).

    `is_consistent` combines size, shape, bias and dependence by Holm's method: a true model is refused in 5 % of cases.
    Of errors that are not normal only the variances are used (see `note`). Points without a fix keep a row with their
    status and are in no statistic. Source of NEES: Bar-Shalom, Li and Kirubarajan 2001, "Estimation with Applications
    to Tracking and Navigation", section 5.4.

    Raises `ValueError` for fewer than 3 pixels with a fix, measuring errors of the pixels that are stated twice or
    not at all, a distribution without a finite variance, and as `propagate`.
    """
    needed = f"validate needs {LEAST} or more pixels with a fix, for a statistic to mean anything; "
    if len(points) < LEAST:
        raise ValueError(f"{needed}there are only {len(points)} pixels.")
    found = errors_at(points, terrain, errors, search)
    count = len(found.index)
    if count < LEAST:
        raise ValueError(f"{needed}{count} of {len(points)} have one.")
    return _compared(found)


@one_thread()
def _compared(found: CheckErrors) -> Validation:
    """The tests of errors at check points."""
    points, count = found.points, len(found.index)
    error, joint = found.error, found.covariance()
    scale = np.sqrt(np.diag(joint))
    values, vectors = np.linalg.eigh(joint / scale[:, None] / scale[None, :])
    kept = values > SINGULAR * values[-1]
    values, vectors = values[kept], vectors[:, kept]
    independent = (vectors.T @ (error / scale)) / np.sqrt(values)
    normalised = (vectors @ independent).reshape(-1, 3)
    each = error.reshape(-1, 3)
    own = np.stack([joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(count)])
    nees_each = np.einsum("ia,iab,ib->i", each, np.linalg.inv(own), each)
    size = Size.of(float(independent @ independent), len(values))
    coverage = _coverage(each, own, scale[:, None] * vectors * np.sqrt(values)[None, :])
    return Validation(
        points=points.points,
        images=points.images,
        status=np.asarray(found.seen.status),
        error_enu=np.asarray(found.seen.error_enu),
        index=found.index,
        covariance_enu=own,
        normalised=normalised,
        nees_each=nees_each,
        size=size,
        horizontal=_size_of(error, joint, (0, 1)),
        vertical=_size_of(error, joint, (2,)),
        uniformity=_uniformity(independent),
        bias=_bias(each, joint),
        dependence=_dependence(found, np.sum(normalised**2, axis=1)),
        coverage=coverage,
        note=found.model.left_out,
    )


def _size_of(error: np.ndarray, joint: np.ndarray, axes: tuple[int, ...]) -> Size:
    """NEES of some of the three axes."""
    rows = np.flatnonzero(np.isin(np.arange(len(error)) % 3, axes))
    some, scale = error[rows], np.sqrt(np.diag(joint)[rows])
    values, vectors = np.linalg.eigh(joint[np.ix_(rows, rows)] / scale[:, None] / scale[None, :])
    kept = values > SINGULAR * values[-1]
    independent = (vectors[:, kept].T @ (some / scale)) / np.sqrt(values[kept])
    return Size.of(float(independent @ independent), len(independent))


def _uniformity(independent: np.ndarray) -> Uniformity:
    share = scipy.stats.norm.cdf(independent)
    test = scipy.stats.kstest(share, "uniform")
    counts = np.histogram(share, bins=BINS, range=(0.0, 1.0))[0]
    return Uniformity(counts, float(test.statistic), float(test.pvalue))


def _bias(each: np.ndarray, joint: np.ndarray) -> tuple[Bias, ...]:
    count = len(each)
    found = []
    for axis, name in enumerate(("east", "north", "up")):
        mean = float(each[:, axis].mean())
        sigma = float(np.sqrt(joint[axis::3, axis::3].sum())) / count
        z = mean / sigma
        scatters = np.ptp(each[:, axis]) > ROUNDING * np.abs(each[:, axis]).max()
        t = map(float, scipy.stats.ttest_1samp(each[:, axis], 0.0)) if scatters else (np.nan, np.nan)
        found.append(Bias(name, mean, sigma, z, float(2.0 * scipy.stats.norm.sf(abs(z))), *t))
    return tuple(found)


def _dependence(found: CheckErrors, squared: np.ndarray) -> tuple[Dependence, ...]:
    seen, index = found.seen, found.index
    direction, normal = np.asarray(seen.direction_enu)[index], np.asarray(seen.normal_enu)[index]
    slope = np.arctan(np.hypot(normal[:, 0], normal[:, 1]) / normal[:, 2])
    columns = {
        "range": (np.asarray(seen.slant_range)[index], "m"),
        "look angle": (np.rad2deg(np.arccos(np.clip(-direction[:, 2], -1.0, 1.0))), "deg"),
        "slope": (np.rad2deg(slope), "deg"),
    }
    tests = []
    for name, (values, unit) in columns.items():
        varies = not is_constant(values) and np.ptp(squared) > 0.0
        tests.append(Dependence(name, unit, values, *(_rank_test(values, squared) if varies else (np.nan, np.nan))))
    return tuple(tests)


def _rank_test(values: np.ndarray, squared: np.ndarray) -> tuple[float, float]:
    """(Spearman's rank correlation, its two-sided p-value), exact for few."""
    test: Any = scipy.stats.spearmanr(values, squared)
    if len(values) > EXACT:
        return float(test.statistic), float(test.pvalue)
    one, other = (scipy.stats.rankdata(x) - 0.5 * (len(x) + 1) for x in (values, squared))
    every = np.array(list(itertools.permutations(one))) @ other
    return float(test.statistic), float(np.mean(np.abs(every) >= abs(one @ other) - 1e-9))


def _coverage(each: np.ndarray, own: np.ndarray, root: np.ndarray) -> tuple[Coverage, ...]:
    """Coverage of CE and LE; `root` is a square root of the joint covariance, for simulation."""
    count = len(each)
    draws = (root @ np.random.default_rng(0).standard_normal((root.shape[1], DRAWS))).reshape(count, 3, DRAWS)
    radii = circular_radii(own[:, :2, :2])
    up = np.sqrt(own[:, 2, 2])
    found = []
    for number, level in enumerate(LEVELS):
        height = up * scipy.stats.norm.ppf(0.5 + 0.5 * level)
        of_errors = np.hypot(each[:, 0], each[:, 1]) <= radii[:, number], np.abs(each[:, 2]) <= height
        of_draws = (
            np.hypot(draws[:, 0], draws[:, 1]) <= radii[:, number, None],
            np.abs(draws[:, 2]) <= height[:, None],
        )
        for name, inside, drawn in zip(("CE", "LE"), of_errors, of_draws, strict=True):
            found.append(_covered(f"{name}{100.0 * level:g}", level, inside, drawn.mean(axis=0)))
    return tuple(sorted(found, key=lambda one: one.name))


def _covered(name: str, level: float, inside: np.ndarray, drawn: np.ndarray) -> Coverage:
    """Coverage with its interval; `drawn` are shares of points inside under the model."""
    count, share = len(inside), float(inside.mean())
    variance = max(float(drawn.var()), 1e-12)
    effective = float(np.clip(level * (1.0 - level) / variance, 1.0, count))
    if effective > 0.9 * count:  # as of independent points, but for the noise of the simulation
        effective = float(count)
    successes, tail = share * effective, 0.5 * (1.0 - CONFIDENCE)
    beta = scipy.stats.beta
    low = 0.0 if successes <= 0.0 else float(beta.ppf(tail, successes, effective - successes + 1.0))
    high = 1.0 if share >= 1.0 else float(beta.ppf(1.0 - tail, successes + 1.0, effective - successes))
    below, above = (np.count_nonzero(one) for one in (drawn <= share + 1e-12, drawn >= share - 1e-12))
    p = min(1.0, 2.0 * (min(below, above) + 1.0) / (len(drawn) + 1.0))
    return Coverage(name, level, int(inside.sum()), count, effective, low, high, p)


def circular_radii(cov: np.ndarray) -> np.ndarray:
    """Radii (n, levels) in m of the circles that contain normal errors of covariance `cov` (n, 2, 2), to 1e-5."""
    values = np.sqrt(np.maximum(np.linalg.eigvalsh(cov), 0.0))
    axes = np.where(values[:, 1] > 0.0, values[:, 0] / np.maximum(values[:, 1], 1e-300), 1.0)
    return values[:, 1, None] * _unit_radii()(np.arcsin(np.minimum(axes, 1.0)))


@functools.cache
def _unit_radii() -> Any:
    """Radii for ellipses of the larger semi-axis 1, by the arc sine of the smaller one."""
    angle = 0.5 * np.pi * np.linspace(0.0, 1.0, RATIOS) ** 1.5
    unit = np.zeros((RATIOS, 2, 2))
    unit[:, 0, 0], unit[:, 1, 1] = 1.0, np.sin(angle) ** 2
    known = np.stack([np.asarray(host_radii(unit, level, np.zeros(2))) for level in LEVELS], axis=1)
    return scipy.interpolate.CubicSpline(angle, known)
