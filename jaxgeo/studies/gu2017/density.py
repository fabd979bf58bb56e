"""How many ties, and of how large blocks: what accuracy that gives, and what is foretold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxgeo.earth import Geodetic
from jaxgeo.register import PoseConsensus, TieErrors, TiePoints, Update, update
from jaxgeo.sensor import Shot
from jaxgeo.studies.gu2017.fixes import Spread, fixes_of, spread, truth
from jaxgeo.studies.gu2017.mapped import Mapped, blocks, mapped, ties_of, unknowns
from jaxgeo.studies.gu2017.scene import Imaged, disturbed, navigation, seen_again

SIZES = (64, 100, 150, 300)  # cells
COUNTS = (5, 10, 20, 40)
LEFT = (3.0, 0.03)  # m, deg: errors as a first pass may leave them
ROUNDS, MORE = 4, 1.02
SUBSETS = 3


class Dense(NamedTuple):
    """Updates by ties of blocks of a size: how many blocks and ties, and how far off fixes are; means over trials."""

    size: int
    trials: int
    blocks: float
    ties: float
    registration: float
    spread: Spread


def by_size(im: Imaged, seeds: Sequence[int], sizes: Sequence[int] = SIZES) -> tuple[list[Dense], list[Dense]]:
    """(by the size of blocks, by the number of ties of the smallest): other noise, light, terrain and pose each time.

    The image is rectified with a pose as a first pass leaves it, matched once, and the navigation updated by all ties.
    Empty for an image whose true shot is not known.
    """
    if im.true is None or im.ground is None:
        return [], []
    whole: dict[int, list[Dense]] = {size: [] for size in sizes}
    fewer: dict[int, list[Dense]] = {count: [] for count in COUNTS}
    for seed in seeds:
        again = seen_again(im, seed)
        rng = np.random.default_rng([seed, 9])
        shot = disturbed(im.true, rng, metres=LEFT[0], degrees=LEFT[1])
        here = mapped(again, shot, navigation(*LEFT))
        for size in sizes:
            found = _ties(here, size)
            if found is None:
                continue
            number, ties = found
            done = _updated(again, shot, size, number, ties)
            whole[size] += [] if done is None else [done]
            if size != min(sizes):
                continue
            for count in COUNTS:
                for _ in range(SUBSETS if count < ties.count else 0):
                    some = rng.choice(ties.count, count, replace=False)
                    done = _updated(again, shot, size, count, _of(ties, some))
                    fewer[count] += [] if done is None else [done]
    return [_mean(rows) for rows in whole.values() if rows], [_mean(rows) for rows in fewer.values() if rows]


def _ties(here: Mapped, size: int) -> tuple[int, TiePoints] | None:
    """(number of blocks, ties of those that agree); None where too few do."""
    found = blocks(here, size, 0.999)
    chosen = PoseConsensus().choose(found.matches, found.jacobian, unknowns(here.errors))
    ties = ties_of(here, found, chosen)
    return (len(found.true), ties) if ties.count >= 3 else None


def _updated(im: Imaged, shot: Shot, size: int, number: int, ties: TiePoints) -> Dense | None:
    """The update of the navigation by ties; registration is as uncertain as their residuals show, if there are enough.

    None where it does not converge.
    """
    found, registration = _with(im, shot, ties, float(im.tie_errors.registration))
    for _ in range(ROUNDS if ties.count >= 10 else 0):
        sigma0 = float(found.sigma0_ties)
        if not sigma0 > MORE:
            break
        own = float(np.sqrt(0.5 * np.median(np.trace(np.asarray(ties.covariance), axis1=1, axis2=2))))
        registration = float(np.hypot(registration, np.sqrt(sigma0**2 - 1.0) * np.hypot(own, registration)))
        found, registration = _with(im, shot, ties, registration)
    if not isinstance(found.shot, Shot) or not bool(found.ok):
        return None
    fixes = fixes_of(im, found.shot, found.cov_error, found.sensor)
    return Dense(size, 1, number, ties.count, registration, spread(fixes, truth(im)))


def _with(im: Imaged, shot: Shot, ties: TiePoints, registration: float) -> tuple[Update, float]:
    errors = TieErrors(registration=registration, terrain=im.tie_errors.terrain)
    return update(im.sensor, shot, ties, im.terrain, im.errors, errors), registration


def _of(ties: TiePoints, rows: np.ndarray) -> TiePoints:
    """Some of the ties."""
    lat, lon, uv, cov = (np.asarray(x)[rows] for x in (ties.ground.lat, ties.ground.lon, ties.uv, ties.covariance))
    height = np.asarray(ties.ground.height)[rows]
    rise = None if ties.rise is None else np.asarray(ties.rise)[rows]
    return TiePoints(uv, Geodetic(lat=lat, lon=lon, height=height), cov, rise=rise)


def _mean(rows: Sequence[Dense]) -> Dense:
    """Over trials: root mean squares, and means of the rest."""
    each = np.array([[np.nan if x is None else x for x in row.spread] for row in rows], float)
    rms, sigma = (float(np.sqrt(np.mean(each[:, k] ** 2))) for k in (0, 2))
    ce90, foretold, squares = (float(np.mean(each[:, k])) for k in (1, 3, 4))
    blocks_, ties, registration = (
        float(np.mean([getattr(r, n) for r in rows])) for n in ("blocks", "ties", "registration")
    )
    return Dense(
        rows[0].size,
        len(rows),
        blocks_,
        ties,
        registration,
        Spread(rms, ce90, sigma, foretold, squares, round(float(np.mean(each[:, 5])))),
    )
