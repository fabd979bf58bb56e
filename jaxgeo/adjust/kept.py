"""Subsets of a block's measurements and control points in arrays of unchanged shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust.block import Block
from jaxgeo.adjust.ground_points import GroundPoints
from jaxgeo.adjust.layout import Order
from jaxgeo.adjust.problem import Prepared


@dataclass(frozen=True)
class Kept:
    """Flags of the measurements (k,) and control points (m,) of a block that are used."""

    rows: np.ndarray
    control: np.ndarray

    @classmethod
    def all(cls, block: Block) -> Kept:
        """All measurements and control points."""
        return cls(np.ones(len(block.observations), bool), np.ones(len(control_of(block)), bool))

    def whole(self, block: Block) -> Kept:
        """Without the measurements of points that have a single ray left and are not control."""
        names, point = block.observations.point_numbers
        often = np.bincount(point, weights=self.rows, minlength=len(names)) >= 2
        known = np.isin(names, control_of(block).name[self.control])
        return Kept(self.rows & (often | known)[point], self.control)

    def of_images(self, block: Block) -> np.ndarray:
        """Number of measurements left in each image that has any in the block."""
        names, image = block.observations.image_numbers
        return np.bincount(image, weights=self.rows, minlength=len(names))

    def leaves_every_image(self, block: Block) -> bool:
        """Whether each image has measurements left."""
        return int(np.sum(self.of_images(block) > 0)) == len(block.images)


def control_of(block: Block) -> GroundPoints:
    """Control points of a block, possibly empty."""
    return GroundPoints(np.zeros(0, str), np.zeros((0, 3))) if block.control is None else block.control


def block_of(block: Block, kept: Kept) -> Block:
    """The block with the kept measurements and control only."""
    if np.all(kept.rows) and np.all(kept.control):
        return block
    control = None if block.control is None else block.control.of(block.control.name[kept.control].tolist())
    return replace(block, observations=block.observations.of(kept.rows), control=control)


def set_aside(block: Block, kept: Kept) -> tuple[np.ndarray, np.ndarray] | None:
    """Flags of the measurements and names of the control that are excluded; None if there are none."""
    if np.all(kept.rows) and np.all(kept.control):
        return None
    return ~kept.rows, control_of(block).name[~kept.control]


def masked(block: Block, ready: Prepared, kept: Kept) -> Prepared:
    """The arrays of `block_of(block, kept)` from those of the block, with zero weight for everything excluded.

    The shapes do not depend on the selection, so that compiled programs are reused.
    """
    if np.all(kept.rows) and np.all(kept.control):
        return ready
    problem, names, order = ready
    observations, control = block.observations, control_of(block)
    information = np.asarray(problem.layout.information).copy()
    information[order.place[~kept.rows]] = 0.0
    there = np.isin(names.point, observations.point[kept.rows])
    row_of = dict(zip(names.point.tolist(), order.row_of_point.tolist(), strict=True))
    freed = np.array([row_of[name] for name in control.name[~kept.control].tolist() if name in row_of], int)
    gone = order.row_of_point[~there]
    known, free = np.asarray(problem.known_point).copy(), np.asarray(problem.free_point).copy()
    known[np.concatenate([freed, gone])], free[freed], free[gone] = 0.0, 1.0, 0.0
    changed = (jnp.asarray(information), jnp.asarray(known), jnp.asarray(free))
    problem = eqx.tree_at(lambda p: (p.layout.information, p.known_point, p.free_point), problem, changed)
    if problem.terrain is not None and len(gone):
        tied = np.asarray(problem.terrain.information).copy()
        tied[gone] = 0.0
        problem = eqx.tree_at(lambda p: p.terrain.information, problem, jnp.asarray(tied))
    order = Order(order.row_of_point[there], order.place[kept.rows], order.rows)
    return Prepared(problem, names._replace(point=names.point[there]), order)
