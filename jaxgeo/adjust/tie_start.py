"""Start orientations from tie points only, for poor initial orientations and for the screening of control."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust.block import Block, Images
from jaxgeo.adjust.control_consensus import Motion
from jaxgeo.adjust.initial_points import started
from jaxgeo.adjust.kept import Kept, control_of, masked
from jaxgeo.adjust.losses import AbstractLoss, LeastSquares
from jaxgeo.adjust.problem import Prepared
from jaxgeo.adjust.ray_effects import READOUT
from jaxgeo.adjust.screening import CONTROL_POINT, IMAGE_POINT, Screen, screened_again
from jaxgeo.adjust.solve import Solver, solve
from jaxgeo.adjust.values import Values, with_interior


class TieStart(NamedTuple):
    """A screening with better orientations, and the start values; None if the block's own start is as good."""

    screen: Screen
    values: Values | None


def start_by_ties(
    block: Block,
    full: Prepared,
    screened: Screen,
    sigmas: float,
    losses: tuple[AbstractLoss, ...] = (LeastSquares(),),
    solver: Solver | None = None,
) -> TieStart:
    """Adjust a block without its control, with the losses in sequence, and repeat the screening from there.

    A block without another datum is aligned with the control by a consensus similarity.
    """
    kept = Kept(screened.kept.rows, np.zeros(len(control_of(block)), bool)).whole(block)
    if not kept.leaves_every_image(block):
        return TieStart(screened, None)
    problem, values = masked(block, full, kept).problem, None
    for loss in losses:
        values = solve(problem, loss, solver, start=values).values
        if not all(bool(np.all(np.isfinite(np.asarray(x)))) for x in (values.centre, values.points, values.lens)):
            return TieStart(screened, None)
    assert values is not None
    again, motion = screened_from(block, full, values, sigmas)
    held = block.navigation is not None or not np.all(np.asarray(problem.free_pose) > 0.0)
    if motion is not None and not held:
        values = _moved(values, motion)
    return TieStart(again, values)


def screened_from(block: Block, full: Prepared, values: Values, sigmas: float) -> tuple[Screen, Motion | None]:
    """Screening of a block with adjusted orientations and interiors, and the motion that aligns it with its control."""
    return screened_again(adjusted_start(block, full, values), sigmas)


def taken_back(block: Block, full: Prepared, values: Values, screened: Screen, sigmas: float) -> Screen:
    """The screening without measurements that agree once the others are adjusted."""
    again = screened_from(block, full, values, sigmas)[0].kept
    kept = Kept(screened.kept.rows | again.rows, screened.kept.control | again.control).whole(block)
    flags = {IMAGE_POINT: kept.rows, CONTROL_POINT: kept.control}
    return replace(screened, kept=kept, aside=tuple(one for one in screened.aside if not flags[one.kind][one.row]))


def placed(block: Block, full: Prepared, values: Values, before: Kept, kept: Kept) -> Values:
    """Values where points without any ray `before` lie where those now `kept` meet, by adjusted orientations."""
    observations = block.observations
    names, point = observations.point_numbers
    new = np.bincount(point, weights=before.rows, minlength=len(names)) == 0
    new &= np.bincount(point, weights=kept.rows, minlength=len(names)) > 0
    new &= ~np.isin(names, control_of(block).name[before.control])
    if not np.any(new):
        return values
    places = np.array(values.points)
    places[full.order.row_of_point[new]] = np.nan
    image = block.images.rows_of(observations.image)
    row, used = full.order.row_of_point[point], kept.rows & new[point]
    places = started(adjusted_start(block, full, values), places, row, image, used)
    return eqx.tree_at(lambda v: v.points, values, jnp.asarray(places))


def adjusted_start(block: Block, full: Prepared, values: Values) -> Block:
    """The block with adjusted orientations and interiors to start from."""
    centre, R = np.asarray(values.centre), np.asarray(values.R_frame_from_camera)
    images = Images(block.images.name, block.images.camera, centre, _nearest_rotations(R))
    lenses = zip(full.names.camera, values.lens, strict=True)
    cameras = {name: with_interior(block.cameras[name], lens) for name, lens in lenses}
    effects, readout = full.problem.effects, block.readout
    if effects is not None and READOUT in effects.names:
        readout = dict(zip(full.names.camera, effects.entry(values, READOUT).tolist(), strict=True))
    return replace(block, images=images, cameras=cameras, readout=readout)


def _moved(values: Values, motion: Motion) -> Values:
    """Values of the whole block moved onto the control."""
    centre, points = motion(np.asarray(values.centre)), motion(np.asarray(values.points))
    R = motion.R @ np.asarray(values.R_frame_from_camera)
    changed = (jnp.asarray(centre), jnp.asarray(R), jnp.asarray(points))
    return eqx.tree_at(lambda v: (v.centre, v.R_frame_from_camera, v.points), values, changed)


def _nearest_rotations(R: np.ndarray) -> np.ndarray:
    """Nearest rotations; products of many rotations accumulate rounding errors."""
    U, _, Vt = np.linalg.svd(R)
    return U @ Vt
