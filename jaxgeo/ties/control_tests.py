"""Tests of control points and of their pixels in an adjusted block."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxgeo.adjust import Adjustment, Block, Blunder
from jaxgeo.adjust._reliability import named
from jaxgeo.adjust.hypotheses import Hypotheses, limit, of_control, of_image_points
from jaxgeo.adjust.kept import Kept, control_of
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.screening import CONTROL_POINT, IMAGE_POINT

ALPHA = 1e-4  # of each test of a right measurement


def failing(found: Adjustment, block: Block, full: Prepared, kept: Kept) -> Kept:
    """What is kept without the worst control point, or pixel of one, that fails its test; the same if none fails.

    Of a pixel that fails, the control point is left out at first: the pixels test each other then, and `fitting` takes
    the point back if it was a pixel.
    """
    points, control = _tests(found, block, full, kept)
    points = replace(points, statistic=np.where(kept.rows & _of_control(block), points.statistic, 0.0))
    control = replace(control, statistic=np.where(kept.control, control.statistic, 0.0))
    wrong = named(block, points, control, limit(ALPHA))
    row_of = {str(name): row for row, name in enumerate(control_of(block).name)}
    for worst in wrong:
        rows, known = kept.rows.copy(), kept.control.copy()
        if known[row_of[worst.point]]:
            known[row_of[worst.point]] = False
        else:
            rows[worst.row] = False
        less = Kept(rows, known).whole(block)
        if less.leaves_every_image(block):
            return less
    return kept


def fitting(found: Adjustment, block: Block, full: Prepared, kept: Kept) -> Kept:
    """What is kept, with the control points and their pixels that were set aside and pass their test."""
    points, control = _tests(found, block, full, kept)
    passing = (points.statistic > 0.0) & (points.statistic <= limit(ALPHA)) & _of_control(block)
    rows = kept.rows | passing
    known = kept.control | ((control.statistic > 0.0) & (control.statistic <= limit(ALPHA)))
    return Kept(rows, known).whole(block)


def named_blunders(found: Adjustment, block: Block, full: Prepared, kept: Kept) -> list[Blunder]:
    """The control points, and their pixels, that are not kept, with their test by all others; the worst first.

    One that has nothing to be tested by, such as a point without other pixels, has a standardised residual of NaN.
    """
    points, control = _tests(found, block, full, kept)
    lost, gone = ~kept.rows & _of_control(block), ~kept.control
    gone_names = set(control_of(block).name[gone].tolist())
    lost &= ~np.isin(block.observations.point, list(gone_names))  # named with their point
    alone = points.alone(np.flatnonzero(lost).tolist()), control.alone(np.flatnonzero(gone).tolist())
    described = named(block, *alone, 0.0)
    there = {(one.kind, one.row) for one in described}
    nan = float("nan")
    for row in np.flatnonzero(gone).tolist():
        if (CONTROL_POINT, row) not in there:
            described.append(
                Blunder("", str(control_of(block).name[row]), row, nan, (nan, nan, nan), (), CONTROL_POINT)
            )
    for row in np.flatnonzero(lost).tolist():
        if (IMAGE_POINT, row) not in there:
            image, point = str(block.observations.image[row]), str(block.observations.point[row])
            described.append(Blunder(image, point, row, nan, (nan, nan), (), IMAGE_POINT))
    return described


def _of_control(block: Block) -> np.ndarray:
    return np.isin(block.observations.point, control_of(block).name)


def _tests(found: Adjustment, block: Block, full: Prepared, kept: Kept) -> tuple[Hypotheses, Hypotheses]:
    """Tests of all image points and control points of a block, kept or not."""
    points = of_image_points(found, full, kept.rows)
    control = of_control(found, control_of(block), full, kept)
    there = np.isin(block.observations.point, found.prepared.names.point)
    return replace(points, statistic=np.where(there, points.statistic, 0.0)), control
