"""Number of tie points and size of blocks: actual and predicted accuracy."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxgeo.earth import Geodetic
from jaxgeo.register import PoseConsensus, TiePoints, Update, update_orientation
from jaxgeo.sensor import Shot
from jaxgeo.studies.gu2017.fixes import Spread, alike, fixes_of, pose_error, predicted_pose_error, spread, truth
from jaxgeo.studies.gu2017.intervals import mean
from jaxgeo.studies.gu2017.mapped import Mapped, allowed, blocks, mapped, ties_of, unknowns
from jaxgeo.studies.gu2017.scene import Imaged, disturbed, navigation, seen_again

SIZES = (64, 100, 150, 300, 600)  # cells
COUNTS = (5, 10, 20, 40, 80)
LEFT = (3.0, 0.03)  # m, deg: typical errors after a first pass
NOISES = (0.1, 2.0)  # image noise, times the image's own standard deviation
ROUNDS, MORE = 4, 1.02
SUBSETS = 3
MOST_TIES = 512  # in one update
PEAKS = 2  # candidates per block


class Dense(NamedTuple):
    """Updates by ties from blocks of one size, in an image with the given noise: means over trials of the number of
    blocks and ties, and of the share of blocks whose best candidate is wrong or that have none; the errors of fixes,
    and that of the `pose`, in px (`pose_error`), with half of its 95 % interval, and that of `each` trial; `sigma_pose`
    is its predicted value, `squares_pose` the mean square of both's quotient: 1 if the prediction is right."""

    size: int
    noise: float
    trials: int
    blocks: float
    failed: float
    ties: float
    registration: float
    spread: Spread
    pose: float
    half: float
    each: tuple[float, ...]
    sigma_pose: float
    squares_pose: float


class _Matched(NamedTuple):
    """Ties of the consistent blocks, the number of blocks, and the share that failed."""

    number: int
    failed: float
    ties: TiePoints


def by_size(
    im: Imaged, seeds: Sequence[int], sizes: Sequence[int] = SIZES, noises: Sequence[float] = NOISES
) -> tuple[list[Dense], list[Dense]]:
    """(by noise and block size, by the number of ties of the smallest blocks at low noise).

    Each trial has other noise, illumination, elevation model and pose errors. The image is rectified with a pose as
    after a first pass, matched once, and the navigation updated by all ties. Empty for an image whose true shot is
    unknown.
    """
    if im.true is None or im.ground is None:
        return [], []
    whole: dict[tuple[float, int], list[Dense]] = {(noise, size): [] for noise in noises for size in sizes}
    fewer: dict[int, list[Dense]] = {count: [] for count in COUNTS}
    windows: dict[int, np.ndarray] = {}
    for noise, seed in itertools.product(noises, seeds):
        again = seen_again(im, seed, noise)
        rng = np.random.default_rng([seed, 9])
        shot = disturbed(im.true, rng, metres=LEFT[0], degrees=LEFT[1])
        here = mapped(again, shot, navigation(*LEFT))
        for size in sizes:
            windows.setdefault(size, allowed(here, size))
            found = _ties(here, size, windows[size])
            if found.ties.count < 3:
                continue
            whole[noise, size] += _updated(again, shot, (size, noise), found)
            if size != min(sizes) or noise != min(noises):
                continue
            for count in COUNTS:
                of_trial: list[Dense] = []
                for _ in range(SUBSETS if count < found.ties.count else 0):
                    some = rng.choice(found.ties.count, count, replace=False)
                    of_trial += _updated(again, shot, (size, noise), found._replace(ties=_of(found.ties, some)))
                fewer[count] += [_mean(of_trial)] if of_trial else []
    return [_mean(rows) for rows in whole.values() if rows], [_mean(rows) for rows in fewer.values() if rows]


def _ties(here: Mapped, size: int, cov: np.ndarray) -> _Matched:
    found = blocks(here, size, 0.999, cov, peaks=PEAKS)
    chosen = PoseConsensus().choose(found.matches, found.jacobian, unknowns(here.errors))
    known = np.isfinite(found.true).all(axis=1) & np.asarray(found.shifts.visible)
    right = known & ~found.is_off(np.asarray(found.matches.shift)[:, 0]) & found.matches.is_candidate.any(axis=1)
    ties = ties_of(here, found, chosen, size)
    if ties.count > MOST_TIES:
        ties = _of(ties, np.linspace(0, ties.count - 1, MOST_TIES).astype(int))
    return _Matched(int(known.sum()), 1.0 - float(right.sum()) / max(int(known.sum()), 1), ties)


def _updated(im: Imaged, shot: Shot, case: tuple[int, float], matched: _Matched) -> list[Dense]:
    """Update of the navigation by ties; with enough ties, their residuals give the registration's uncertainty.

    Empty if it does not converge.
    """
    ties = matched.ties
    found, registration = _with(im, shot, ties, float(im.tie_errors.registration))
    for _ in range(ROUNDS if ties.count >= 10 else 0):
        sigma0 = float(found.sigma0_ties)
        if not sigma0 > MORE:
            break
        own = float(np.sqrt(0.5 * np.median(np.trace(np.asarray(ties.covariance), axis1=1, axis2=2))))
        registration = float(np.hypot(registration, np.sqrt(sigma0**2 - 1.0) * np.hypot(own, registration)))
        found, registration = _with(im, shot, ties, registration)
    if not isinstance(found.shot, Shot) or not bool(found.ok):
        return []
    fixes = fixes_of(im, found.shot, found.cov_error, found.sensor)
    spread_ = spread(fixes, truth(im))
    off = pose_error(im, found.sensor, found.shot)
    sigma = predicted_pose_error(im, found.sensor, found.shot, found.cov_error)
    of_pose = off, math.inf, (off,), sigma, (off / sigma) ** 2
    return [Dense(*case, 1, matched.number, matched.failed, ties.count, registration, spread_, *of_pose)]


def _with(im: Imaged, shot: Shot, ties: TiePoints, registration: float) -> tuple[Update, float]:
    errors = dataclasses.replace(im.tie_errors, registration=registration)
    return update_orientation(*alike((im.sensor, shot)), ties, im.terrain, im.errors, errors), registration


def _of(ties: TiePoints, rows: np.ndarray) -> TiePoints:
    """A subset of the ties."""
    lat, lon, uv, cov = (np.asarray(x)[rows] for x in (ties.ground.lat, ties.ground.lon, ties.uv, ties.covariance))
    height = np.asarray(ties.ground.height)[rows]
    rise, sides = (None if x is None else np.asarray(x)[rows] for x in (ties.rise, ties.sides))
    return TiePoints(uv, Geodetic(lat=lat, lon=lon, height=height), cov, rise=rise, sides=sides)


def _mean(rows: Sequence[Dense]) -> Dense:
    """Statistics over trials: root mean squares, and means of the rest."""
    table = np.array([[np.nan if x is None else x for x in row.spread] for row in rows], float)
    rms, sigma = (float(np.sqrt(np.mean(table[:, k] ** 2))) for k in (0, 2))
    ce90, predicted, squares = (float(np.mean(table[:, k])) for k in (1, 3, 4))
    each = tuple(x for row in rows for x in row.each)
    return rows[0]._replace(
        trials=len(rows),
        **{name: float(np.mean([getattr(r, name) for r in rows])) for name in AVERAGED},
        spread=Spread(rms, ce90, sigma, predicted, squares, round(float(np.mean(table[:, 5])))),
        pose=mean(each)[0],
        half=mean(each)[1],
        each=each,
        sigma_pose=float(np.sqrt(np.mean([row.sigma_pose**2 for row in rows]))),
    )


AVERAGED = ("blocks", "failed", "ties", "registration", "squares_pose")
