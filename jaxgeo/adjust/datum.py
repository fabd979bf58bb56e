"""Datum of a block: motions of the whole (shift, rotation, scale) and their constraints."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import sized_filter_jit
from jaxgeo._numerics import matvec
from jaxgeo._record import Record
from jaxgeo._typing import Scalar
from jaxgeo.adjust.arrays import Problem, free_columns
from jaxgeo.adjust.observing import Observing, observing
from jaxgeo.adjust.values import POSE, Values

MOTIONS = ("shift east", "shift north", "shift up", "turn about east", "turn about north", "turn about up", "scale")
HELD = 1e-4  # m per 1 m of motion: smallest effect on an observation that counts as constraint, whatever its sigma


class Whole(Record):
    """The motions of the whole block, and which of them are constrained by observations other than image points.

    `images` (7, n, c) and `points` (7, 3, rows) are changes by `MOTIONS`, about `middle` (3,) with the length `size`.
    `combos` (7, 7) are independent combinations of them: `held` is 1 for those that an observation constrains, `free`
    is 1 for unconstrained ones; the others, all zero, would change fixed parameters.
    """

    images: Float[Array, "7 n c"]
    points: Float[Array, "7 3 rows"]
    middle: Float[Array, "3"]
    size: Scalar
    combos: Float[Array, "7 7"]
    held: Float[Array, "7"]
    free: Float[Array, "7"]


def motions(problem: Problem, values: Values) -> tuple[Float[Array, "7 n c"], Float[Array, "7 3 rows"]]:
    """Changes of images and points (rows) by `MOTIONS` about the median point; zero where fixed.

    Lengths in m; rotations and scale such that points at the median distance from the centre move by 1 m.
    """
    poses, points, _, _ = _motions(problem, values)
    images = jnp.zeros((7, problem.n, problem.of_image)).at[:, :, :POSE].set(poses)
    free, _ = free_columns(problem)
    return images * free[None], points * problem.free_point.T[None]


def _motions(problem: Problem, values: Values) -> tuple[Array, Array, Array, Scalar]:
    """(poses (7, n, 6), points (7, 3, rows), centre, size), including fixed parameters."""
    places = jnp.where(_measured(problem)[:, None], values.points, jnp.nan)
    middle = jnp.nanmedian(places, axis=0)  # robust to points nearly at infinity
    size = jnp.sqrt(jnp.nanmedian(jnp.sum((places - middle[None]) ** 2, axis=1)))
    offsets = jnp.where(_measured(problem)[:, None], values.points - middle[None], 0.0)
    centres, n = values.centre - middle[None], problem.n
    none = jnp.zeros((n, 3))
    poses, points = [], []
    for axis in jnp.eye(3):
        poses.append(jnp.concatenate([none + axis[None], none], axis=1))
        points.append(jnp.broadcast_to(axis, offsets.shape))
    for axis in jnp.eye(3):
        own = jax.vmap(lambda R, axis=axis: matvec(R.T, axis))(values.R_frame_from_camera)
        poses.append(jnp.concatenate([jnp.cross(axis[None], centres), own], axis=1) / size)
        points.append(jnp.cross(axis[None], offsets) / size)
    poses.append(jnp.concatenate([centres, none], axis=1) / size)
    points.append(offsets / size)
    return jnp.stack(poses), jnp.moveaxis(jnp.stack(points), -1, 1), middle, size


def _measured(problem: Problem) -> Array:
    """Flags of point rows that hold a point; the others are padding."""
    there = (problem.layout.information[:, 0] > 0.0).astype(jnp.float64)
    return jnp.zeros(problem.free_point.shape[0]).at[problem.layout.row].max(there) > 0.0


@sized_filter_jit
def observed_whole(problem: Problem, values: Values, control_root: Float[Array, " rows"]) -> tuple[Observing, Whole]:
    """Observations other than image points, and the motions of the whole that they constrain: one program for all that
    asks for either."""
    observed = observing(problem, values, control_root)
    return observed, whole_of(problem, values, observed)


def whole_of(problem: Problem, values: Values, observed: Observing) -> Whole:
    """Motions of the whole that are constrained, from the form of the observations, independent of their weights.

    Image points constrain none of them: pixels do not change when cameras and points move together. A motion is
    constrained if it changes an observed coordinate of control, navigation or terrain, or a fixed parameter.
    """
    poses, points, middle, size = _motions(problem, values)
    to_lengths = jnp.concatenate([jnp.ones(3), jnp.full(3, size)])
    fixed_poses = poses * to_lengths[None, None] * (1.0 - problem.free_pose)[None]
    fixed_points = points * ((1.0 - problem.free_point) * _measured(problem)[:, None]).T[None]
    fixed = jnp.concatenate([fixed_poses.reshape(7, -1), fixed_points.reshape(7, -1)], axis=1)
    combos, moves = _noticed(jnp.eye(7), jnp.ones(7), fixed)
    combos, allowed = combos * (1.0 - moves)[:, None], 1.0 - moves
    images, points = motions(problem, values)
    rows = observed.alike(size).flat(images, points)
    combos, held = _noticed(combos, allowed, rows)
    allowed = jnp.sum(combos**2, axis=1) > 0.5
    held = held * allowed
    return Whole(images, points, middle, size, combos, held, allowed - held)


def _noticed(combos: Float[Array, "7 7"], allowed: Float[Array, "7"], rows: Float[Array, "7 k"]) -> tuple[Array, Array]:
    """(orthogonal combinations of the allowed ones, the least observed first; 1 where a row is affected)."""
    along = combos @ rows
    gram = along @ along.T
    most = 1.0 + jnp.trace(gram)
    gram = gram * allowed[:, None] * allowed[None, :] + jnp.diag((1.0 - allowed) * most)  # disallowed ones come last
    _, vectors = jnp.linalg.eigh(0.5 * (gram + gram.T))
    combos = vectors.T @ combos
    return combos, (jnp.max(jnp.abs(combos @ rows), axis=1, initial=0.0) > HELD).astype(jnp.float64)


def unheld(whole: Whole) -> Float[np.ndarray, "d 7"]:
    """The unconstrained combinations of `MOTIONS`."""
    return np.asarray(whole.combos)[np.asarray(whole.free) > 0.0]
