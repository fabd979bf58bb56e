"""Robust and least-squares solutions of a block with the navigation as prior, without measurements that do not fit."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust import Adjustment, Block, Blunder, HeightObservations, LeastSquares, Unknowns
from jaxgeo.adjust._reliability import reliability
from jaxgeo.adjust.bundle import adjusted
from jaxgeo.adjust.equations import known_points
from jaxgeo.adjust.hypotheses import of_image_points
from jaxgeo.adjust.kept import Kept, block_of, control_of, masked, set_aside
from jaxgeo.adjust.measurements import image_residuals, in_view
from jaxgeo.adjust.problem import Prepared, prepared
from jaxgeo.adjust.screening import SIGMAS, Screen, screened_of
from jaxgeo.adjust.solve import solve
from jaxgeo.adjust.values import Values
from jaxgeo.ties.block_of_views import free_poses, with_places
from jaxgeo.ties.consensus import agreeing, by_coplanarity, with_points_again
from jaxgeo.ties.control_tests import failing, fitting, named_blunders
from jaxgeo.ties.excess import by_median, excess_of, of_few
from jaxgeo.ties.robust import WIDEST, WIDTH, ScaledCauchy
from jaxgeo.ties.views import Views

OUTLIER = 4.0  # standard deviations: larger residuals are left out
# px: added to the standard deviations of image points in the first robust solution, which starts from the navigation,
# several px off; with less, right measurements are left out there for wrong ones.
FIRST_EXCESS = 1.0
ENOUGH = 0.1  # of it, or 0.01 px: change of the added standard deviation that ends the robust solutions
ROUNDS = 10
TAKEN_BACK = 3  # rounds in which measurements that were left out are taken back, once others are barred
LIMIT = 3.7  # of the statistic of a right measurement, where many are wrong: exceeded by chance in 1e-3
MOST = 0.15  # of the measurements: if tests leave out more, their standard deviations are too small
MEDIAN = 1.177  # of the statistic of right ones: the square root of 2 log 2
WORST = 0.7  # of the largest statistic: smaller ones may be its consequences
LEAST_CHECKED = 0.2  # redundancy of a point in two images: with less, its residual shows too little of its error
MANY = 0.1  # of the measurements of an image: if more are left out, the solution may have followed wrong ones


class Excess(NamedTuple):
    """Standard deviations in px that are added in quadrature to those of tie points, and of pixels of control."""

    ties: float
    control: float

    def less_sure(self, block: Block) -> Block:
        """The block with these added."""
        observed = block.observations
        added = np.where(_of_control(block), self.control, self.ties)
        return replace(block, observations=replace(observed, sigma=np.hypot(observed.sigma, added[:, None])))


def _with_places(block: Block, rows: np.ndarray, control: np.ndarray) -> Kept:
    """The flags without points that a single image, or a single shot, still shows and that are not control."""
    return with_places(block, Kept(rows, control).whole(block))


def _of_control(block: Block) -> np.ndarray:
    """Flags (k,) of the pixels of control points."""
    return np.isin(block.observations.point, control_of(block).name)


class Robust(NamedTuple):
    """The measurements that fit a robust solution, its values, and the standard deviations in px to add to theirs;
    whether it started from what agrees pair by pair (`is_by_pairs`), as many measurements did not fit."""

    kept: Kept
    values: Values | None
    excess: Excess
    is_by_pairs: bool = False


def robust_solution(
    block: Block, unknowns: Unknowns, terrain: HeightObservations | None, views: Views, is_by_pairs: bool = False
) -> Robust:
    """The robust solution of a block, from the navigation.

    If many measurements of an image do not fit, the solution may follow wrong ones: it then starts anew, or at once if
    it `is_by_pairs`, from those that agree pair by pair within the covariance of the navigation (`agreeing`), and takes
    back what fits it.
    """
    first = screened_of(block, unknowns, SIGMAS).kept
    start = Robust(first, None, Excess(FIRST_EXCESS, FIRST_EXCESS))
    if not is_by_pairs:
        found = _settled(block, unknowns, terrain, start, first)
        if not found.is_by_pairs:
            return found
    rows = np.where(_of_control(block), first.rows, agreeing(block, views))
    kept = _with_places(block, rows, first.control)
    by_pairs = start._replace(kept=kept, is_by_pairs=True)
    if not kept.leaves_every_image(block):
        return by_pairs
    return _settled(by_coplanarity(block, views, kept.rows), unknowns, terrain, by_pairs, kept)


def _settled(
    block: Block,
    unknowns: Unknowns,
    terrain: HeightObservations | None,
    found: Robust,
    first: Kept,
    barred: np.ndarray | None = None,
) -> Robust:
    """The robust solution after some rounds, without `barred` (k,) measurements.

    It ends early, with `is_by_pairs`, if many measurements of an image are left out.
    """
    for k in range(ROUNDS):
        before = found
        found = _robust_round(block, unknowns, terrain, found, first)
        if barred is not None:
            may = ~barred if k < TAKEN_BACK else before.kept.rows & ~barred
            found = found._replace(kept=_with_places(block, found.kept.rows & may, found.kept.control))
        if not found.is_by_pairs and _leaves_many_out(block, found.kept):
            return found._replace(is_by_pairs=True)
        is_settled = _same(before.kept, found.kept) and all(
            abs(x - y) <= ENOUGH * max(y, ENOUGH) for x, y in zip(found.excess, before.excess, strict=True)
        )
        if is_settled or not found.kept.leaves_every_image(block):
            break
    return found


def without_unchecked(
    block: Block, unknowns: Unknowns, terrain: HeightObservations | None, found: Robust
) -> tuple[Robust, Final]:
    """(the robust solution without measurements that fail their test or are not checked by others, its least squares).

    A wrong measurement of a point in two images fits wherever the ray of the other image leads, often at another
    height, and turns the images so that it does: its own residual does not show it. Where many measurements are wrong,
    points in two images are kept only if their residual shows a large part of their error, and all measurements are
    tested by their residuals over the standard deviations of these. Tests are by the standard deviations that the
    robust solution needs; where they leave out too many, these are too small, and the tests are by the median of their
    statistics.
    """
    strict = _without_failing(block, unknowns, terrain, found, False)
    kept = strict[0].kept
    if kept.leaves_every_image(block) and np.sum(kept.rows) >= (1.0 - MOST) * np.sum(found.kept.rows):
        return strict
    return _without_failing(block, unknowns, terrain, found, True)


def _without_failing(
    block: Block, unknowns: Unknowns, terrain: HeightObservations | None, found: Robust, is_by_median: bool
) -> tuple[Robust, Final]:
    first, barred = found.kept, np.zeros(len(block.observations), bool)
    while True:
        final = least_squares(block, unknowns, terrain, found)
        new = _failing(block, final, None if is_by_median else found.excess) & ~_of_control(block)
        if not np.any(new):
            return found, final
        barred |= new
        kept = _with_places(block, found.kept.rows & ~barred, found.kept.control)
        found = found._replace(kept=kept)
        if not kept.leaves_every_image(block):
            return found, final
        found = _settled(block, unknowns, terrain, found, first, barred)
        if not found.kept.leaves_every_image(block):
            return found, final


def _failing(block: Block, final: Final, excess: Excess | None) -> np.ndarray:
    """Flags (k,) of kept measurements that fail their test, the worst of them and of each point only, and of the point
    in two images whose redundancy is the lowest, if it is too low.

    Wrong measurements raise the standard deviation that least squares adds to all, and hide behind it: tests are by
    that of the robust solution, `excess`, or by the median of the statistics. The former is too small where points are
    hardly checked, as their residuals are.
    """
    statistic = of_image_points(final.found).statistic
    if excess is None:
        statistic = statistic / min(1.0, float(np.median(statistic[statistic > 0.0])) / MEDIAN)
    else:
        less_sure, more_sure = (one.less_sure(block).observations.sigma for one in (final.excess, excess))
        statistic = statistic * np.mean(less_sure / more_sure, axis=1)[final.kept.rows]
    own = reliability(final.found).redundancy.sum(axis=1)
    names, point = final.found.block.observations.point_numbers
    rays, checked = np.bincount(point, minlength=len(names)), np.bincount(point, own, len(names))
    worst = np.zeros(len(names))
    np.maximum.at(worst, point, statistic)
    fails = (statistic > max(LIMIT, WORST * float(np.max(statistic)))) & (statistic >= 0.999 * worst[point])
    flags = np.zeros(len(block.observations), bool)
    checked = np.where(rays == 2, checked, np.inf)
    unchecked = (checked < LEAST_CHECKED) & (checked == np.min(checked))  # one by one: points check each other
    flags[final.kept.rows] = fails | unchecked[point]
    return flags


def _robust_round(
    block: Block, unknowns: Unknowns, terrain: HeightObservations | None, found: Robust, first: Kept
) -> Robust:
    """The robust solution of what was kept before, what fits it, and the standard deviations to add by its residuals.

    Points without a start begin where the rays of what was kept at `first` meet."""
    before, is_mark = found.kept, _of_control(block)
    less_sure = found.excess.less_sure(block)
    full = prepared(less_sure, unknowns, terrain, set_aside(less_sure, first))
    solution = solve(masked(less_sure, full, before).problem, ScaledCauchy(jnp.asarray(WIDTH)), start=found.values)
    values = with_points_again(less_sure, full, solution.values, before)
    residuals = np.asarray(image_residuals(full.problem, values)).T[full.order.place] * less_sure.observations.sigma
    largest, sigma = _largest(residuals, block.observations.sigma)
    ties, marks = before.rows & ~is_mark, before.rows & is_mark
    of_ties = by_median(largest[ties], sigma[ties]) if np.any(ties) else 0.0
    excess = Excess(of_ties, max(of_ties, of_few(largest[marks], sigma[marks])))
    fits = largest <= OUTLIER * np.hypot(sigma, np.where(is_mark, excess.control, excess.ties))
    fits &= _in_view(full, values)
    known = before.control & _control_fits(block, full, values, fits)
    return Robust(_with_places(block, fits, known), values, excess, found.is_by_pairs)


def _leaves_many_out(block: Block, kept: Kept) -> bool:
    """Whether many of the measurements of an image, and more than one, are not kept."""
    count, left = Kept.all(block).of_images(block), kept.of_images(block)
    return bool(np.any(count - left > np.maximum(MANY * count, 1.0)))


def _control_fits(block: Block, full: Prepared, values: Values, fits: np.ndarray) -> np.ndarray:
    """Flags of the control points whose coordinates are within the limit of outliers, and all of whose pixels fit."""
    row_of = dict(zip(full.names.point.tolist(), full.order.row_of_point.tolist(), strict=True))
    rows = [row_of[name] for name in control_of(block).name.tolist()]
    off = np.max(np.abs(np.asarray(known_points(full.problem, values))[rows]), axis=1, initial=0.0)
    return (off <= OUTLIER) & ~np.isin(control_of(block).name, block.observations.point[~fits])


def _largest(residuals: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The larger of the two residuals of each measurement, in standard deviations, and its standard deviation, px."""
    axis = np.argmax(np.abs(residuals / sigma), axis=1)
    rows = np.arange(len(axis))
    return np.abs(residuals)[rows, axis], sigma[rows, axis]


def _in_view(full: Prepared, values: Values) -> np.ndarray:
    return np.asarray(in_view(full.problem, values))[full.order.place]


class Final(NamedTuple):
    """Least-squares adjustment of the kept measurements of a block, the standard deviations in px added to theirs, and
    the arrays of the whole block."""

    found: Adjustment
    excess: Excess
    kept: Kept
    full: Prepared


def least_squares(block: Block, unknowns: Unknowns, terrain: HeightObservations | None, start: Robust) -> Final:
    """Least squares of what is kept, with the excess by its residuals. Raises as `jaxgeo.adjust.adjust`."""
    kept, values, excess = start[:3]
    is_mark, given = _of_control(block)[kept.rows], block.observations.sigma[kept.rows]
    for last in (False, False, True):
        less_sure = excess.less_sure(block)
        full = prepared(less_sure, unknowns, terrain, set_aside(less_sure, kept))
        ready = masked(less_sure, full, kept)
        solution = solve(ready.problem, ScaledCauchy(jnp.asarray(WIDEST)), start=values)
        values = solution.values
        if not last:
            off = np.asarray(image_residuals(ready.problem, values)).T[ready.order.place]
            excess = _excess_of(block, kept, off * less_sure.observations.sigma[kept.rows], given, is_mark)
    screen = Screen(kept)
    found = adjusted(block_of(less_sure, kept), unknowns, ready, solution, LeastSquares(), None, screen)
    return Final(found, excess, kept, full)


def _excess_of(block: Block, kept: Kept, off: np.ndarray, sigma: np.ndarray, is_mark: np.ndarray) -> Excess:
    """That by residuals `off` (k, 2) in px of what is kept, with their stated standard deviations."""
    ties = 0.0
    if not np.all(is_mark):
        points = len(np.unique(block.observations.point[kept.rows][~is_mark]))
        freedom = max(2 * int(np.count_nonzero(~is_mark)) - 6 * free_poses(block) - 3 * points, 1)
        ties = excess_of(off[~is_mark], sigma[~is_mark], freedom)
    return Excess(ties, max(ties, of_few(*_largest(off[is_mark], sigma[is_mark]))))


def without_wrong_control(
    block: Block, unknowns: Unknowns, terrain: HeightObservations | None, final: Final
) -> tuple[Final, list[Blunder]]:
    """(the adjustment without control that fails its test, with what passes it; what is left out, the worst first).

    Raises `ValueError` if more than half of the control points do not fit.
    """
    tried: list[Kept] = []
    for _ in range(3 * len(control_of(block))):
        given = final.found, final.excess.less_sure(block), final.full, final.kept
        kept = with_places(block, failing(*given))
        if _same(kept, final.kept):
            kept = with_places(block, fitting(*given))
        if any(_same(kept, one) for one in (final.kept, *tried)):
            break
        tried.append(final.kept)
        final = least_squares(block, unknowns, terrain, Robust(kept, final.found.solution.values, final.excess))
    blunders = named_blunders(final.found, final.excess.less_sure(block), final.full, final.kept)
    total, left = len(final.kept.control), int(np.sum(final.kept.control))
    if total > 1 and left < 0.5 * total:
        raise ValueError(
            f"{total - left} of {total} control points do not fit the images and their navigation: {blunders[0]}. Are "
            f"their coordinate system and vertical datum those of the images, and the stated errors right?"
        )
    return final, blunders


def _same(one: Kept, other: Kept) -> bool:
    return np.array_equal(one.rows, other.rows) and np.array_equal(one.control, other.control)
