"""Robust and least-squares solutions of a block with the navigation as prior, without measurements that do not fit."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgeo._typing import Numbers, Scalar
from jaxgeo.adjust import AbstractLoss, Adjustment, Block, Blunder, HeightObservations, LeastSquares, Unknowns
from jaxgeo.adjust.bundle import adjusted
from jaxgeo.adjust.equations import known_points
from jaxgeo.adjust.kept import Kept, block_of, control_of, masked, set_aside
from jaxgeo.adjust.measurements import image_residuals, in_view
from jaxgeo.adjust.problem import Prepared, prepared
from jaxgeo.adjust.screening import SIGMAS, Screen, screened_of
from jaxgeo.adjust.solve import solve
from jaxgeo.adjust.values import Values
from jaxgeo.ties.control_tests import failing, fitting, named_blunders
from jaxgeo.ties.excess import by_median, excess_of

OUTLIER = 4.0  # standard deviations: larger residuals are left out
# px: added to the standard deviations of image points in the first robust solution, which starts from the navigation,
# several px off; with less, right measurements are left out there for wrong ones.
FIRST_EXCESS = 1.0
ENOUGH = 0.1  # of it, or 0.01 px: change of the added standard deviation that ends the robust solutions
ROUNDS = 10
WIDTH, WIDEST = 3.0, 1e6  # standard deviations: of the robust loss, and of one that is least squares


class _Cauchy(AbstractLoss):
    """Cauchy's loss with its width as an array: least squares, by a large width, is then the same program."""

    width: Scalar

    def rho(self, squared: Numbers) -> Numbers:
        return self.width**2 * jnp.log1p(squared / self.width**2)

    def weight(self, squared: Numbers) -> Numbers:
        return 1.0 / (1.0 + squared / self.width**2)


def robust_solution(block: Block, unknowns: Unknowns, terrain: HeightObservations | None) -> tuple[Kept, Values, float]:
    """(the measurements that fit, the robust solution, the standard deviation in px to add to theirs)."""
    first = kept = screened_of(block, unknowns, SIGMAS).kept
    values, excess = None, FIRST_EXCESS
    for _ in range(ROUNDS):
        less_sure = _less_sure(block, excess)
        full = prepared(less_sure, unknowns, terrain, set_aside(less_sure, first))
        solution = solve(masked(less_sure, full, kept).problem, _Cauchy(jnp.asarray(WIDTH)), start=values)
        values = solution.values
        residuals = np.asarray(image_residuals(full.problem, values)).T[full.order.place] * less_sure.observations.sigma
        largest, sigma = _largest(residuals, block.observations.sigma)
        last, excess = excess, by_median(largest[kept.rows], sigma[kept.rows])
        fits = largest <= OUTLIER * np.hypot(sigma, excess)
        before, fits = kept, fits & _in_view(full, values)
        known = before.control & _control_fits(block, full, values, fits)
        kept = Kept(fits, known).whole(block)
        is_settled = (
            np.array_equal(before.rows, kept.rows)
            and np.array_equal(before.control, kept.control)
            and abs(excess - last) <= ENOUGH * max(last, ENOUGH)
        )
        if is_settled or not kept.leaves_every_image(block):
            break
    assert values is not None
    return kept, values, excess


def _control_fits(block: Block, full: Prepared, values: Values, fits: np.ndarray) -> np.ndarray:
    """Flags of the control points whose coordinates are within the limit of outliers, and all of whose pixels fit."""
    row_of = dict(zip(full.names.point.tolist(), full.order.row_of_point.tolist(), strict=True))
    rows = [row_of[name] for name in control_of(block).name.tolist()]
    off = np.max(np.abs(np.asarray(known_points(full.problem, values))[rows]), axis=1, initial=0.0)
    return (off <= OUTLIER) & ~np.isin(control_of(block).name, block.observations.point[~fits])


def _less_sure(block: Block, excess: float) -> Block:
    """The block with a standard deviation in px added to those of its image points."""
    observed = block.observations
    return replace(block, observations=replace(observed, sigma=np.hypot(observed.sigma, excess)))


def _largest(residuals: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The larger of the two residuals of each measurement, in standard deviations, and its standard deviation, px."""
    axis = np.argmax(np.abs(residuals / sigma), axis=1)
    rows = np.arange(len(axis))
    return np.abs(residuals)[rows, axis], sigma[rows, axis]


def _in_view(full: Prepared, values: Values) -> np.ndarray:
    return np.asarray(in_view(full.problem, values))[full.order.place]


class Final(NamedTuple):
    """Least-squares adjustment of the kept measurements of a block, the standard deviation in px added to theirs, and
    the arrays of the whole block."""

    found: Adjustment
    excess: float
    kept: Kept
    full: Prepared


def least_squares(
    block: Block,
    unknowns: Unknowns,
    terrain: HeightObservations | None,
    kept: Kept,
    values: Values,
    excess: float,
) -> Final:
    is_tie = ~np.isin(block.observations.point, control_of(block).name)[kept.rows]
    for last in (False, False, True):
        less_sure = _less_sure(block, excess)
        full = prepared(less_sure, unknowns, terrain, set_aside(less_sure, kept))
        ready = masked(less_sure, full, kept)
        solution = solve(ready.problem, _Cauchy(jnp.asarray(WIDEST)), start=values)
        values = solution.values
        if not last and np.any(is_tie):
            off = np.asarray(image_residuals(ready.problem, values)).T[ready.order.place][is_tie]
            points = len(np.unique(block.observations.point[kept.rows][is_tie]))
            freedom = max(2 * len(off) - 6 * len(block.images) - 3 * points, 1)
            sigma = block.observations.sigma[kept.rows][is_tie]
            excess = excess_of(off * less_sure.observations.sigma[kept.rows][is_tie], sigma, freedom)
    screen = Screen(kept)
    found = adjusted(block_of(less_sure, kept), unknowns, ready, solution, LeastSquares(), None, screen)
    return Final(found, excess, kept, full)


def without_wrong_control(
    block: Block, unknowns: Unknowns, terrain: HeightObservations | None, final: Final
) -> tuple[Final, list[Blunder]]:
    """(the adjustment without control that fails its test, with what passes it; what is left out, the worst first).

    Raises `ValueError` if more than half of the control points do not fit.
    """
    tried: list[Kept] = []
    for _ in range(3 * len(control_of(block))):
        given = final.found, _less_sure(block, final.excess), final.full, final.kept
        kept = failing(*given)
        if _same(kept, final.kept):
            kept = fitting(*given)
        if any(_same(kept, one) for one in (final.kept, *tried)):
            break
        tried.append(final.kept)
        final = least_squares(block, unknowns, terrain, kept, final.found.solution.values, final.excess)
    blunders = named_blunders(final.found, _less_sure(block, final.excess), final.full, final.kept)
    total, left = len(final.kept.control), int(np.sum(final.kept.control))
    if total > 1 and left < 0.5 * total:
        raise ValueError(
            f"{total - left} of {total} control points do not fit the images and their navigation: {blunders[0]}. Are "
            f"their coordinate system and vertical datum those of the images, and the stated errors right?"
        )
    return final, blunders


def _same(one: Kept, other: Kept) -> bool:
    return np.array_equal(one.rows, other.rows) and np.array_equal(one.control, other.control)
