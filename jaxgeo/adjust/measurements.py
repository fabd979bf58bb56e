"""Image point residuals and derivatives of a block, vectorised over all measurements."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import one_program, sized_filter_jit
from jaxgeo.adjust.arrays import Problem
from jaxgeo.adjust.collinearity import pixel_linear, pixel_of
from jaxgeo.adjust.layout import Layout, gathered
from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.adjust.values import Values, with_interior

LEAST_WEIGHT = 1e-10  # lower bound of robust weights: with zero weights, points with few rays would be undetermined


@one_program
def image_residuals(problem: Problem, values: Values) -> Float[Array, "2 obs"]:
    """Residuals (predicted less measured) of the image points over their standard deviations."""
    layout = problem.layout
    cameras, lens, R, offset = _of_measurements(problem, values)
    ideal = _in_camera(layout, R, offset)

    def one(camera: Any, lens: Any, d: Any, uv: Any, information: Any) -> Array:
        return (pixel_of(with_interior(camera, lens), d) - uv) * information

    return jax.vmap(one, in_axes=(-1, -1, -1, 0, 0), out_axes=-1)(cameras, lens, ideal, layout.uv, layout.information)


@sized_filter_jit
def in_view(problem: Problem, values: Values) -> Bool[Array, " obs"]:
    """Flags of measurements whose point lies in front of the camera and in the field of its lens."""
    cameras, lens, R, offset = _of_measurements(problem, values)

    def one(camera: Any, lens: Any, d: Any) -> Array:
        ahead = d[2] > 0.0
        return ahead & with_interior(camera, lens).distortion.in_field(d[:2] / jnp.where(ahead, d[2], 1.0))

    return jax.vmap(one, in_axes=-1)(cameras, lens, _in_camera(problem.layout, R, offset))


def image_points(problem: Problem, values: Values, loss: AbstractLoss) -> tuple[Array, ...]:
    """Weighted residuals (2, obs) and derivatives (2, columns, obs) of image points, and rho; fixed columns are zero.

    Derivatives by the point (3), the pose (6) and the active lens columns. The camera's are by autodiff; those of the
    camera-frame point are closed formulas, since XLA would recompute shared terms for each derivative.
    """
    layout = problem.layout
    image, camera = layout.image, layout.camera[layout.image]
    cameras, lens, R, offset = _of_measurements(problem, values)
    d = _in_camera(layout, R, offset)
    ideal = d[:2] / d[2:]
    linear = jax.vmap(partial(_pixel_linear, problem.active_interior), in_axes=-1, out_axes=-1)
    found = jax.lax.optimization_barrier((R, d, ideal, linear(cameras, lens, ideal)))
    R, d, ideal, (predicted, by_ideal, by_lens) = found
    R, d, ideal = R[:, :, None], d[:, None], ideal[:, None]  # for both axes
    residual = (predicted - layout.uv.T) * layout.information.T
    squared = residual[0] ** 2 + residual[1] ** 2
    root = jnp.sqrt(jnp.maximum(loss.weight(squared), LEAST_WEIGHT))[None]
    weight = layout.information.T * root
    x, y = (by * (weight / d[2]) for by in by_ideal)  # derivatives of both axes by d
    z = -(x * ideal[0] + y * ideal[1])
    by_point = [x * R[i, 0] + y * R[i, 1] + z * R[i, 2] for i in range(3)]
    by_effects = None if problem.effects is None else _by_effects(problem, by_point, offset)
    # # A camera rotation t rotates its view in the opposite sense, d - t x d.
    by_turn = [y * d[2] - z * d[1], z * d[0] - x * d[2], x * d[1] - y * d[0]]
    free_point, free_pose = layout.to_rays(problem.free_point.T), gathered(problem.free_pose, image)
    by_pose = [by * free[None] for by, free in zip((*(-by for by in by_point), *by_turn), free_pose, strict=True)]
    by_point = [by * free[None] for by, free in zip(by_point, free_point, strict=True)]
    free_lens = gathered(problem.lens.free, camera)
    by_lens = [by * weight * free[None] for by, free in zip(by_lens, free_lens, strict=by_effects is None)]
    if by_effects:
        by_lens += [by * free[None] for by, free in zip(by_effects, free_lens[len(by_lens) :], strict=True)]
    by_lens = jnp.stack(by_lens, axis=1) if by_lens else jnp.zeros((2, 0, image.shape[0]))
    return residual * root, jnp.stack(by_point, axis=1), jnp.stack(by_pose, axis=1), by_lens, loss.rho(squared)


def _pixel_linear(active: tuple[int, ...], camera: Any, lens: Any, ideal: Any) -> Any:
    return pixel_linear(camera, lens, active, ideal)


def _of_measurements(problem: Problem, values: Values) -> Any:
    """Camera and lens of each measurement, its R_frame_from_camera, and its point relative to the perspective centre
    (3, obs) in m; measurements are the last axis."""
    layout = problem.layout
    image, camera = layout.image, layout.camera[layout.image]
    cameras = jax.tree.map(lambda x: gathered(x, camera), problem.cameras)
    offset = layout.to_rays(values.points.T) - gathered(values.centre, image)
    given = cameras, gathered(values.lens, camera), gathered(values.R_frame_from_camera, image), offset
    given = jax.lax.optimization_barrier(given)
    if problem.effects is None:
        return given
    cameras, lens, R, offset = given
    return jax.lax.optimization_barrier((cameras, lens, *problem.effects.applied(layout, lens, R, offset)))


def _by_effects(problem: Problem, by_point: list[Array], offset: Float[Array, "3 obs"]) -> list[Float[Array, "2 obs"]]:
    """Weighted derivatives by the unknown entries of `effects`, from those by the point."""
    effects = problem.effects
    assert effects is not None
    shifts = effects.by_entries(problem.layout, offset)
    chosen = [i - effects.first for i in problem.active if i >= effects.first]
    return [_sum(by * shift[None] for by, shift in zip(by_point, shifts[k], strict=True)) for k in chosen]


def _in_camera(layout: Layout, R: Float[Array, "3 3 obs"], offset: Float[Array, "3 obs"]) -> Float[Array, "3 obs"]:
    """R' offset, the point in the camera frame; straight ahead for padding, as zero weights would not remove NaN."""
    found = _sum(R[i] * offset[i][None] for i in range(3))
    there = layout.information[:, 0] > 0.0
    return jnp.where(there[None], found, jnp.array([0.0, 0.0, 1.0])[:, None])


def _sum(parts: Any) -> Array:
    """Sum of a few arrays, in one pass."""
    first, *others = parts
    for part in others:
        first = first + part
    return first
