"""The datum of a block: how it may be shifted, turned and scaled as a whole, and what holds it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._numerics import turned
from jaxgeo.adjust.arrays import Problem, free_columns
from jaxgeo.adjust.equations import Equations
from jaxgeo.adjust.values import Values

MOTIONS = ("shift east", "shift north", "shift up", "turn about east", "turn about north", "turn about up", "scale")
HELD = 1e-9  # of what a motion of the whole would cost part by part: below it nothing holds the motion


def motions(problem: Problem, values: Values) -> tuple[Float[Array, "7 n c"], Float[Array, "7 3 rows"]]:
    """Changes of the images and of the points (rows) by `MOTIONS` about the middle of the points.

    Lengths in m, turns and scale such that points at their median distance from the middle move by 1 m.
    """
    real = problem.free_point.any(axis=1)
    places = jnp.where(real[:, None], values.points, jnp.nan)
    middle = jnp.nanmedian(places, axis=0)  # of points that lie nearly at infinity it does not hang on
    size = jnp.sqrt(jnp.nanmedian(jnp.sum((places - middle[None]) ** 2, axis=1)))
    offsets = jnp.where(real[:, None], values.points - middle[None], 0.0)
    centres, n = values.centre - middle[None], problem.n
    none = jnp.zeros((n, 3))
    poses, points = [], []
    for axis in jnp.eye(3):
        poses.append(jnp.concatenate([none + axis[None], none], axis=1))
        points.append(jnp.broadcast_to(axis, offsets.shape))
    for axis in jnp.eye(3):
        own = jax.vmap(lambda R, axis=axis: turned(R.T, axis))(values.R_frame_from_camera)
        poses.append(jnp.concatenate([jnp.cross(axis[None], centres), own], axis=1) / size)
        points.append(jnp.cross(axis[None], offsets) / size)
    poses.append(jnp.concatenate([centres, none], axis=1) / size)
    points.append(offsets / size)
    of_points = jnp.moveaxis(jnp.stack(points), -1, 1) * problem.free_point.T[None]
    images = jnp.zeros((7, n, problem.of_image)).at[:, :, :6].set(jnp.stack(poses))
    free, _ = free_columns(problem)
    return images * free[None], of_points


def unheld(problem: Problem, values: Values, equations: Equations) -> Float[Array, "7 7"]:
    """Rows: combinations of `MOTIONS` that cost nothing, in order; rows of motions that are held are zero."""
    images, x = motions(problem, values)
    along = jnp.einsum("mnc,ncd->mnd", images, equations.images)
    total = jnp.einsum("mnd,knd->mk", along, images)
    # Each measurement's share is small only when that of its image and of its point are taken together.
    mixed = jnp.zeros((7, 7))
    rows, image = problem.layout.row, problem.layout.image
    for k in range(7):
        moved = jnp.einsum("cio,io->co", equations.coupling, x[k][:, rows])
        mixed = mixed.at[:, k].set(jnp.einsum("mco,co->m", jnp.moveaxis(images[:, image], 1, -1), moved))
    of_points = jnp.einsum("mir,ijr,kjr->mk", x, equations.points * problem.free_point.any(axis=1)[None, None], x)
    cost = total + mixed + mixed.T + of_points
    by_parts = jnp.sqrt(jnp.diagonal(total) + jnp.diagonal(of_points))
    scaled = cost / (by_parts[:, None] * by_parts[None, :])
    values_, vectors = jnp.linalg.eigh(0.5 * (scaled + scaled.T))
    rows_ = vectors.T / by_parts[None, :]
    return jnp.where((values_ < HELD)[:, None], rows_, 0.0)
