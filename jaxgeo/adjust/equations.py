"""Sparse normal equations of a block: image, point and shared-parameter parts, without a dense Jacobian."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._compile import sized_filter_jit
from jaxgeo._record import Record
from jaxgeo._typing import Scalar
from jaxgeo.adjust.arrays import Known, Problem
from jaxgeo.adjust.collinearity import (
    half_sum,
    navigation_linear,
    navigation_residual,
)
from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.adjust.measurements import LEAST_WEIGHT, image_points, image_residuals
from jaxgeo.adjust.values import MOUNT, POSE, Values
from jaxgeo.rotations import rotation_vector_from_R


class Equations(Record):
    """Normal equations at given values, in units of the weights, before elimination.

    Blocks of the images (n, c, c), of the shared parameters, and of the points (3, 3, rows), with the gradients;
    `coupling` (c, 3, obs) between image and point of each measurement, `shared_coupling` (lenses, 3, rows) between
    points and shared lenses. `control_root` is the square root of the loss weight of each control point.
    """

    cost: Scalar
    images: Float[Array, "n c c"]
    images_shared: Float[Array, "n c s"]
    shared: Float[Array, "s s"]
    points: Float[Array, "3 3 rows"]
    coupling: Float[Array, "c 3 obs"]
    shared_coupling: Float[Array, "lenses 3 rows"]
    image_gradient: Float[Array, "n c"]
    shared_gradient: Float[Array, " s"]
    point_gradient: Float[Array, "3 rows"]
    control_root: Float[Array, " rows"]


def cost_of(problem: Problem, values: Values, loss: AbstractLoss) -> Scalar:
    """Half the sum of the loss over image points and control and of all other squared weighted residuals."""
    squared = jnp.sum(image_residuals(problem, values) ** 2, axis=0)
    off = known_points(problem, values)
    total = 0.5 * (jnp.sum(loss.rho(squared)) + jnp.sum(loss.rho(jnp.sum(off * off, axis=1))))
    if problem.observed is not None:
        total = total + half_sum(navigation_residuals(problem, values))
    if problem.terrain is not None:
        total = total + half_sum(problem.terrain.residuals(values.points))
    for off, known in _known_others(problem, values):
        total = total + half_sum(off * known.information)
    return total


def navigation_residuals(problem: Problem, values: Values) -> Float[Array, "n rows"]:
    """Weighted residuals of positions and attitudes (6), then those of further observations of the orientations."""
    assert problem.observed is not None
    return jax.vmap(navigation_residual)(problem.observed, *of_images(problem, values))


def linearised(problem: Problem, values: Values, loss: AbstractLoss) -> Equations:
    """Normal equations at given values; a robust loss reweights each image point and control point.

    Split into three programs: as one, XLA recomputes intermediate results, and it takes twice as long.
    """
    linear = _image_points(problem, values, loss)
    return _normal(problem, values, loss, linear, _by_image(problem, linear))


@sized_filter_jit
def _image_points(problem: Problem, values: Values, loss: AbstractLoss) -> tuple[Array, ...]:
    return image_points(problem, values, loss)


@sized_filter_jit
def _by_image(problem: Problem, linear: tuple[Array, ...]) -> list[Float[Array, "rows width columns"]]:
    """Derivatives by pose and lens, and residuals, of the measurements of each image, for both axes."""
    residual, _, by_pose, by_lens, _ = linear
    found = []
    for axis in range(2):
        rows = jnp.concatenate([by_pose[axis], by_lens[axis], residual[axis][None]])
        found.append(rows.T.at[problem.layout.of_image].get(mode="promise_in_bounds"))
    return found


@sized_filter_jit
def _normal(
    problem: Problem, values: Values, loss: AbstractLoss, linear: tuple[Array, ...], by_image: list[Array]
) -> Equations:
    layout = problem.layout
    residual, by_point, by_pose, by_lens, rho = linear
    own = jnp.concatenate([by_pose, by_lens], axis=1) if problem.own_lens else by_pose
    coupling = own[0][:, None] * by_point[0][None] + own[1][:, None] * by_point[1][None]
    x, y = by_point
    products = _of_points(
        problem, [x[i] * x[j] + y[i] * y[j] for i, j in ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))]
    )
    gradients = _of_points(problem, [x[i] * residual[0] + y[i] * residual[1] for i in range(3)])
    shared_coupling = []
    for group in layout.groups if problem.of_lenses else ():
        part = slice(group.first, group.first + group.rays * group.rows)
        shape = (group.rays, group.rows)
        lens, own = by_lens[:, :, part].reshape(2, -1, *shape), by_point[:, :, part].reshape(2, 3, *shape)
        shared_coupling.append(_of_lenses(problem, layout.camera[layout.image[part]].reshape(shape), lens, own))
    rows = values.points.shape[0]
    off = known_points(problem, values)
    squared = jnp.sum(off * off, axis=1)
    root = jnp.sqrt(jnp.maximum(loss.weight(squared), LEAST_WEIGHT))
    known, off = problem.known_point * root[:, None, None], off * root[:, None]
    V = products[jnp.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])] + jnp.einsum("rki,rkj->ijr", known, known)
    g = gradients + jnp.einsum("rki,rk->ir", known, off)
    if problem.terrain is not None:
        height, slope = problem.terrain.linearised(values.points)
        V, g = V + slope.T[:, None] * slope.T[None, :], g + slope.T * height[None, :]
    free = problem.free_point.T
    V, g = V * free[:, None] * free[None, :] + jnp.eye(3)[:, :, None] * (1.0 - free)[:, None], g * free
    sums = _of_images_and_shared(problem, values, by_image)
    cost = 0.5 * (jnp.sum(rho) + jnp.sum(loss.rho(squared))) + sums.pop("cost")
    if problem.terrain is not None:
        cost = cost + half_sum(height)
    return Equations(
        cost=cost,
        points=V,
        coupling=coupling,
        shared_coupling=jnp.concatenate(shared_coupling, axis=-1) if shared_coupling else jnp.zeros((0, 3, rows)),
        point_gradient=g,
        control_root=root,
        **sums,
    )


def of_images(problem: Problem, values: Values) -> tuple[Any, ...]:
    mount, strip = problem.mount_of, problem.strip_of
    return (
        values.centre,
        values.R_frame_from_camera,
        values.boresight[mount],
        values.lever[mount],
        values.strip[strip],
        jnp.broadcast_to(values.common, (problem.n, values.common.shape[0])),
        (values.lens - problem.start.lens)[problem.layout.camera],
    )


def _of_points(problem: Problem, terms: list[Float[Array, " obs"]]) -> Float[Array, "k rows"]:
    """Sums of k terms over the measurements of each point."""
    found = []
    for group in problem.layout.groups:
        part = slice(group.first, group.first + group.rays * group.rows)
        found.append(jnp.stack([jnp.sum(term[part].reshape(group.rays, group.rows), axis=0) for term in terms]))
    return jnp.concatenate(found, axis=-1)


def _of_lenses(problem: Problem, camera: Any, lens: Any, x: Any) -> Array:
    """Coupling (cameras * active, 3, rows) between points and lenses: sums over a point's rays, camera by camera."""
    found = []
    for number in range(problem.lens.free.shape[0]):
        mine = jnp.where(camera == number, lens, 0.0) if problem.lens.free.shape[0] > 1 else lens
        found.append(jnp.sum(mine[:, :, None] * x[:, None], axis=(0, 3)))
    return jnp.concatenate(found)


def _of_images_and_shared(problem: Problem, values: Values, by_image: list[Array]) -> dict[str, Any]:
    """Sums over the measurements of each image, the contributions of navigation and priors, and their cost."""
    layout, n, c, active = problem.layout, problem.n, problem.of_image, len(problem.active)
    first, second = (jnp.einsum("nla,nlb->nab", rows, rows) for rows in by_image)
    sums = first + second
    if len(layout.owner) > n:
        sums = jnp.zeros((n, *sums.shape[1:])).at[layout.owner].add(sums)
    matrix, gradient = sums[:, :-1, :-1], sums[:, :-1, -1]
    images, image_gradient = matrix[:, :c, :c], gradient[:, :c]
    s = problem.shared
    images_shared, shared, shared_gradient = jnp.zeros((n, c, s)), jnp.zeros((s, s)), jnp.zeros(s)
    if problem.of_lenses:
        camera = jax.nn.one_hot(layout.camera, problem.lens.free.shape[0], dtype=jnp.float64)  # (n, cameras)
        lenses = problem.of_lenses
        mixed = camera[:, None, :, None] * matrix[:, :c, None, c:]
        images_shared = images_shared.at[:, :, :lenses].set(mixed.reshape(n, c, lenses))
        own = jnp.einsum("nk,nab->kab", camera, matrix[:, c:, c:])
        shared = shared.at[:lenses, :lenses].set(_block_diagonal(own))
        shared_gradient = shared_gradient.at[:lenses].set((camera.T @ gradient[:, c:]).reshape(-1))
    cost = jnp.zeros(())
    if problem.observed is not None:
        off, by = jax.vmap(navigation_linear)(problem.observed, *of_images(problem, values))
        cost = half_sum(off)
        by_pose, by_shared = by[..., :POSE] * problem.free_pose[:, None, :], navigation_columns(problem, by)
        images = images.at[:, :POSE, :POSE].add(jnp.einsum("nka,nkb->nab", by_pose, by_pose))
        image_gradient = image_gradient.at[:, :POSE].add(jnp.einsum("nka,nk->na", by_pose, off))
        images_shared = images_shared.at[:, :POSE].add(jnp.einsum("nka,nkb->nab", by_pose, by_shared))
        shared = shared + jnp.einsum("nka,nkb->ab", by_shared, by_shared)
        shared_gradient = shared_gradient + jnp.einsum("nka,nk->a", by_shared, off)
    (off_lens, lens), (off_mount, mount), (off_strip, strip), (off_common, common) = _known_others(problem, values)
    cost = cost + half_sum(off_lens * lens.information) + half_sum(off_mount * mount.information)
    cost = cost + half_sum(off_strip * strip.information) + half_sum(off_common * common.information)
    if problem.own_lens and active:
        squared = lens.information[layout.camera] ** 2
        images = images.at[:, POSE:, POSE:].add(squared[:, :, None] * jnp.eye(active)[None])
        image_gradient = image_gradient.at[:, POSE:].add(squared * off_lens[layout.camera])
    diagonal, gradient = _priors(problem, off_lens, off_mount, off_strip, off_common)
    return {
        "cost": cost,
        "images": images,
        "images_shared": images_shared,
        "shared": shared + jnp.diag(diagonal),
        "image_gradient": image_gradient,
        "shared_gradient": shared_gradient + gradient,
    }


def navigation_columns(problem: Problem, by: Float[Array, "n rows columns"]) -> Float[Array, "n rows s"]:
    """Derivatives of the navigation by the shared parameters, in the columns of the reduced system."""
    n, rows = by.shape[:2]
    parts = [jnp.zeros((n, rows, problem.of_lenses))]
    if problem.of_lenses and problem.observed is not None and problem.observed.rows is not None:
        own = problem.observed.rows.by_lens[:, :, jnp.array(problem.active, int)]
        camera = jax.nn.one_hot(problem.layout.camera, problem.lens.free.shape[0], dtype=jnp.float64)
        own = own[:, :, None, :] * (camera[:, :, None] * problem.lens.free[None])[:, None]
        parts[0] = parts[0].at[:, -own.shape[1] :].set(own.reshape(n, own.shape[1], -1))
    of_strip = problem.strip.free.shape[1]
    both = ((problem.mounts, problem.mount, problem.mount_of, POSE, MOUNT),)
    both += ((problem.strips, problem.strip, problem.strip_of, POSE + MOUNT, of_strip),)
    for there, known, number, first, size in both:
        if there:
            of = jax.nn.one_hot(number, known.free.shape[0], dtype=jnp.float64)
            own = by[:, :, first : first + size] * known.free[number][:, None, :]
            parts.append((of[:, None, :, None] * own[:, :, None, :]).reshape(n, rows, -1))
    parts.append(by[:, :, POSE + MOUNT + of_strip :])
    return jnp.concatenate(parts, axis=-1)


def _priors(problem: Problem, off_lens: Any, off_mount: Any, off_strip: Any, off_common: Any) -> tuple[Array, Array]:
    """Diagonal and gradient that priors add to the shared parameters."""
    parts = []
    if problem.of_lenses:
        parts.append((problem.lens, off_lens))
    if problem.mounts:
        parts.append((problem.mount, off_mount))
    if problem.strips:
        parts.append((problem.strip, off_strip))
    parts.append((problem.common, off_common))
    squares = [known.information**2 for known, _ in parts]
    diagonal = [jnp.zeros(0), *(square.ravel() for square in squares)]
    gradient = [jnp.zeros(0), *((square * off).ravel() for square, (_, off) in zip(squares, parts, strict=True))]
    return jnp.concatenate(diagonal), jnp.concatenate(gradient)


def known_points(problem: Problem, values: Values) -> Float[Array, "rows 3"]:
    """Weighted residuals of control points."""
    return jnp.einsum("rki,ri->rk", problem.known_point, values.points - problem.place)


def _known_others(problem: Problem, values: Values) -> list[tuple[Array, Known]]:
    """Lenses, mounts, strips and common errors less their prior values."""
    columns = jnp.array(problem.active, int)
    lens = values.lens[:, columns] - problem.start.lens[:, columns]
    mount = jnp.concatenate([jax.vmap(rotation_vector_from_R)(values.boresight), values.lever - problem.start.lever], 1)
    own = [(lens, problem.lens), (mount, problem.mount), (values.strip, problem.strip)]
    return [*own, (values.common[None], problem.common)]


def _block_diagonal(blocks: Float[Array, "k a a"]) -> Float[Array, "ka ka"]:
    k, a, _ = blocks.shape
    return (jnp.eye(k)[:, None, :, None] * blocks[:, :, None, :]).reshape(k * a, k * a)
