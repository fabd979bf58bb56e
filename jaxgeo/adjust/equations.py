"""Normal equations of a block, in blocks: of images, of points, of what both share; never a dense Jacobian."""

from __future__ import annotations

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._typing import Scalar
from jaxgeo.adjust.collinearity import (
    Observed,
    half_sum,
    navigation_linear,
    navigation_residual,
    pixel_linear,
    pixel_of,
)
from jaxgeo.adjust.layout import Layout
from jaxgeo.adjust.losses import AbstractLoss
from jaxgeo.adjust.values import MOUNT, POSE, STRIP, Step, Values, with_interior
from jaxgeo.rotations import rotation_vector_from_R
from jaxgeo.sensor import FrameCamera

LEAST_WEIGHT = 1e-10  # that a robust loss leaves a measurement: with none at all, a point of few rays has no place


class Known(eqx.Module):
    """What is known of some unknowns beforehand: 1 / sigma (zero where nothing), and 1 where they are free, else 0."""

    information: Float[Array, "some size"]
    free: Float[Array, "some size"]


class Problem(eqx.Module):
    """A block in the order of its layout, and what is unknown of it.

    `active` are the columns of the lenses that are unknown; with `own_lens` each image has a camera, and so a lens, of
    its own, which is eliminated and solved for with the image. `mounts` and `strips` say whether any of these is
    unknown. Control points are `place` (rows, 3) with `known_point` (rows, 3, 3), W with W' W the inverse covariance.
    """

    layout: Layout
    cameras: FrameCamera
    observed: Observed | None
    mount_of: Int[Array, " n"]
    strip_of: Int[Array, " n"]
    start: Values
    place: Float[Array, "rows 3"]
    known_point: Float[Array, "rows 3 3"]
    free_point: Float[Array, "rows 3"]
    free_pose: Float[Array, "n 6"]
    lens: Known
    mount: Known
    strip: Known
    terrain: Any
    active: tuple[int, ...] = eqx.field(static=True)
    own_lens: bool = eqx.field(static=True)
    mounts: bool = eqx.field(static=True)
    strips: bool = eqx.field(static=True)

    @property
    def n(self) -> int:
        """Images."""
        return self.layout.camera.shape[0]

    @property
    def of_image(self) -> int:
        """Columns of an image in the reduced system."""
        return POSE + (len(self.active) if self.own_lens else 0)

    @property
    def of_lenses(self) -> int:
        """Columns of lenses that images share."""
        return 0 if self.own_lens else self.lens.free.shape[0] * len(self.active)

    @property
    def shared(self) -> int:
        """Columns of what images share: lenses, mounts, strips."""
        return self.of_lenses + self.mounts * self.mount.free.size + self.strips * self.strip.free.size


class Equations(eqx.Module):
    """Normal equations at some values, in units of the weights, before anything is eliminated.

    Of the images (n, c, c), of what they share, and of the points (3, 3, rows), with the gradients; `coupling`
    (c, 3, obs) between image and point of each measurement, `shared_coupling` (lenses, 3, rows) between a point and the
    lenses that images share.
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


def cost_of(problem: Problem, values: Values, loss: AbstractLoss) -> Scalar:
    """Half the sum of the loss over image points and of the squared weighted residuals of all else."""
    squared = jnp.sum(image_residuals(problem, values) ** 2, axis=0)
    total = 0.5 * jnp.sum(loss.rho(squared)) + half_sum(_known_points(problem, values))
    if problem.observed is not None:
        total = total + half_sum(navigation_residuals(problem, values))
    if problem.terrain is not None:
        total = total + half_sum(problem.terrain.residuals(values.points))
    for off, known in _known_others(problem, values):
        total = total + half_sum(off * known.information)
    return total


def image_residuals(problem: Problem, values: Values) -> Float[Array, "2 obs"]:
    """Residuals (predicted less measured) of the image points over their standard deviations."""
    layout = problem.layout
    cameras, lens, R, offset = _of_measurements(problem, values)
    ideal = _in_camera(layout, R, offset)

    def one(camera: Any, lens: Any, d: Any, uv: Any, information: Any) -> Array:
        return (pixel_of(with_interior(camera, lens), d) - uv) * information

    return jax.vmap(one, in_axes=(-1, -1, -1, 0, 0), out_axes=-1)(cameras, lens, ideal, layout.uv, layout.information)


@eqx.filter_jit
def in_view(problem: Problem, values: Values) -> Bool[Array, " obs"]:
    """Whether the point of each measurement lies in front of the camera and in its lens's field."""
    cameras, lens, R, offset = _of_measurements(problem, values)

    def one(camera: Any, lens: Any, d: Any) -> Array:
        ahead = d[2] > 0.0
        return ahead & with_interior(camera, lens).distortion.in_field(d[:2] / jnp.where(ahead, d[2], 1.0))

    return jax.vmap(one, in_axes=-1)(cameras, lens, _in_camera(problem.layout, R, offset))


def navigation_residuals(problem: Problem, values: Values) -> Float[Array, "n 6"]:
    """Weighted residuals of positions and attitudes."""
    assert problem.observed is not None
    return jax.vmap(navigation_residual)(problem.observed, *_of_images(problem, values))


def linearised(problem: Problem, values: Values, loss: AbstractLoss) -> Equations:
    """The normal equations at some values. With a robust loss each image point has the weight that it leaves it.

    In three programs: one of all of it makes many things again where they are used, and takes twice as long.
    """
    seen = _image_points(problem, values, loss)
    return _normal(problem, values, seen, _by_image(problem, seen))


@eqx.filter_jit
def _image_points(problem: Problem, values: Values, loss: AbstractLoss) -> tuple[Array, ...]:
    return image_points(problem, values, loss)


@eqx.filter_jit
def _by_image(problem: Problem, seen: tuple[Array, ...]) -> list[Float[Array, "n most columns"]]:
    """Derivatives by pose and lens, and residuals, of the measurements of each image, for both axes."""
    residual, _, by_pose, by_lens, _ = seen
    found = []
    for axis in range(2):
        rows = jnp.concatenate([by_pose[axis], by_lens[axis], residual[axis][None]])
        found.append(rows.T.at[problem.layout.of_image].get(mode="promise_in_bounds"))
    return found


@eqx.filter_jit
def _normal(problem: Problem, values: Values, seen: tuple[Array, ...], by_image: list[Array]) -> Equations:
    layout = problem.layout
    residual, by_point, by_pose, by_lens, rho = seen
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
    off = _known_points(problem, values)
    known = problem.known_point
    V = products[jnp.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])] + jnp.einsum("rki,rkj->ijr", known, known)
    g = gradients + jnp.einsum("rki,rk->ir", known, off)
    if problem.terrain is not None:
        height, slope = problem.terrain.linearised(values.points)
        V, g = V + slope.T[:, None] * slope.T[None, :], g + slope.T * height[None, :]
    free = problem.free_point.T
    V, g = V * free[:, None] * free[None, :] + jnp.eye(3)[:, :, None] * (1.0 - free)[:, None], g * free
    sums = _of_images_and_shared(problem, values, by_image)
    cost = 0.5 * jnp.sum(rho) + half_sum(off) + sums.pop("cost")
    if problem.terrain is not None:
        cost = cost + half_sum(height)
    return Equations(
        cost=cost,
        points=V,
        coupling=coupling,
        shared_coupling=jnp.concatenate(shared_coupling, axis=-1) if shared_coupling else jnp.zeros((0, 3, rows)),
        point_gradient=g,
        **sums,
    )


def image_points(problem: Problem, values: Values, loss: AbstractLoss) -> tuple[Array, ...]:
    """Residual (2, obs) and derivatives (2, columns, obs) of image points, weighted, and rho; fixed columns zero.

    By the point (3), the pose (6) and the lens's active columns. Of the camera by autodiff; how a point lies in it
    follows at once, all measurements together, as a compiler would make again for each derivative what they share.
    """
    layout = problem.layout
    image, camera = layout.image, layout.camera[layout.image]
    cameras, lens, R, offset = _of_measurements(problem, values)
    d = _in_camera(layout, R, offset)
    ideal = d[:2] / d[2:]
    linear = jax.vmap(partial(_pixel_linear, problem.active), in_axes=-1, out_axes=-1)
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
    # A turn t of the camera turns what it sees the other way, d - t x d.
    by_turn = [y * d[2] - z * d[1], z * d[0] - x * d[2], x * d[1] - y * d[0]]
    free_point, free_pose = layout.to_rays(problem.free_point.T), gathered(problem.free_pose, image)
    by_pose = [by * free[None] for by, free in zip((*(-by for by in by_point), *by_turn), free_pose, strict=True)]
    by_point = [by * free[None] for by, free in zip(by_point, free_point, strict=True)]
    by_lens = [by * weight * free[None] for by, free in zip(by_lens, gathered(problem.lens.free, camera), strict=True)]
    by_lens = jnp.stack(by_lens, axis=1) if by_lens else jnp.zeros((2, 0, image.shape[0]))
    return residual * root, jnp.stack(by_point, axis=1), jnp.stack(by_pose, axis=1), by_lens, loss.rho(squared)


def _pixel_linear(active: tuple[int, ...], camera: Any, lens: Any, ideal: Any) -> Any:
    return pixel_linear(camera, lens, active, ideal)


def _of_measurements(problem: Problem, values: Values) -> Any:
    """Camera and lens of each measurement, its R_frame_from_camera, and where its point is from the perspective centre
    (3, obs) in m; the measurements are the last axis of all."""
    layout = problem.layout
    image, camera = layout.image, layout.camera[layout.image]
    cameras = jax.tree.map(lambda x: gathered(x, camera), problem.cameras)
    offset = layout.to_rays(values.points.T) - gathered(values.centre, image)
    given = cameras, gathered(values.lens, camera), gathered(values.R_frame_from_camera, image), offset
    return jax.lax.optimization_barrier(given)


def gathered(table: Float[Array, "some ..."], at: Int[Array, " obs"]) -> Float[Array, "... obs"]:
    """Entries of a short table, with the crowd last: number by number, which is quicker than row by row."""
    columns = table.reshape(table.shape[0], -1).T
    found = [column.at[at].get(mode="promise_in_bounds") for column in columns]
    return jnp.stack(found).reshape(*table.shape[1:], at.shape[0]) if found else jnp.zeros((0, at.shape[0]))


def _in_camera(layout: Layout, R: Float[Array, "3 3 obs"], offset: Float[Array, "3 obs"]) -> Float[Array, "3 obs"]:
    """R' offset: a place in the camera frame; straight ahead where there is no measurement, as any number may be there
    that a weight of zero would not take away."""
    found = _sum(R[i] * offset[i][None] for i in range(3))
    there = layout.information[:, 0] > 0.0
    return jnp.where(there[None], found, jnp.array([0.0, 0.0, 1.0])[:, None])


def _of_images(problem: Problem, values: Values) -> tuple[Any, ...]:
    mount, strip = problem.mount_of, problem.strip_of
    return (
        values.centre,
        values.R_frame_from_camera,
        values.boresight[mount],
        values.lever[mount],
        values.strip[strip],
    )


def _of_points(problem: Problem, terms: list[Float[Array, " obs"]]) -> Float[Array, "k rows"]:
    """Sums of k numbers over the measurements of each point."""
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
    """Sums over the measurements of each image, what the navigation and priors add, and their cost."""
    layout, n, c, active = problem.layout, problem.n, problem.of_image, len(problem.active)
    sums = _sum(jnp.einsum("nla,nlb->nab", rows, rows) for rows in by_image)
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
        off, by = jax.vmap(navigation_linear)(problem.observed, *_of_images(problem, values))
        cost = half_sum(off)
        by_pose, by_shared = by[..., :POSE] * problem.free_pose[:, None, :], _navigation_columns(problem, by)
        images = images.at[:, :POSE, :POSE].add(jnp.einsum("nka,nkb->nab", by_pose, by_pose))
        image_gradient = image_gradient.at[:, :POSE].add(jnp.einsum("nka,nk->na", by_pose, off))
        images_shared = images_shared.at[:, :POSE].add(jnp.einsum("nka,nkb->nab", by_pose, by_shared))
        shared = shared + jnp.einsum("nka,nkb->ab", by_shared, by_shared)
        shared_gradient = shared_gradient + jnp.einsum("nka,nk->a", by_shared, off)
    (off_lens, lens), (off_mount, mount), (off_strip, strip) = _known_others(problem, values)
    cost = cost + half_sum(off_lens * lens.information) + half_sum(off_mount * mount.information)
    cost = cost + half_sum(off_strip * strip.information)
    if problem.own_lens and active:
        squared = lens.information[layout.camera] ** 2
        images = images.at[:, POSE:, POSE:].add(squared[:, :, None] * jnp.eye(active)[None])
        image_gradient = image_gradient.at[:, POSE:].add(squared * off_lens[layout.camera])
    diagonal, gradient = _priors(problem, off_lens, off_mount, off_strip)
    return {
        "cost": cost,
        "images": images,
        "images_shared": images_shared,
        "shared": shared + jnp.diag(diagonal),
        "image_gradient": image_gradient,
        "shared_gradient": shared_gradient + gradient,
    }


def _navigation_columns(problem: Problem, by: Float[Array, "n 6 18"]) -> Float[Array, "n 6 s"]:
    """Derivatives of the navigation by what images share, in the columns of the reduced system."""
    n = problem.n
    parts = [jnp.zeros((n, 6, problem.of_lenses))]
    both = ((problem.mounts, problem.mount, problem.mount_of, POSE, MOUNT),)
    both += ((problem.strips, problem.strip, problem.strip_of, POSE + MOUNT, STRIP),)
    for there, known, number, first, size in both:
        if there:
            of = jax.nn.one_hot(number, known.free.shape[0], dtype=jnp.float64)
            own = by[:, :, first : first + size] * known.free[number][:, None, :]
            parts.append((of[:, None, :, None] * own[:, :, None, :]).reshape(n, 6, -1))
    return jnp.concatenate(parts, axis=-1)


def _priors(problem: Problem, off_lens: Any, off_mount: Any, off_strip: Any) -> tuple[Array, Array]:
    """Diagonal and gradient that priors add to what images share."""
    parts = []
    if problem.of_lenses:
        parts.append((problem.lens, off_lens))
    if problem.mounts:
        parts.append((problem.mount, off_mount))
    if problem.strips:
        parts.append((problem.strip, off_strip))
    squares = [known.information**2 for known, _ in parts]
    diagonal = [jnp.zeros(0), *(square.ravel() for square in squares)]
    gradient = [jnp.zeros(0), *((square * off).ravel() for square, (_, off) in zip(squares, parts, strict=True))]
    return jnp.concatenate(diagonal), jnp.concatenate(gradient)


def _known_points(problem: Problem, values: Values) -> Float[Array, "rows 3"]:
    """Weighted residuals of control points."""
    return jnp.einsum("rki,ri->rk", problem.known_point, values.points - problem.place)


def _known_others(problem: Problem, values: Values) -> list[tuple[Array, Known]]:
    """Lenses, mounts and strips less what was known of them beforehand."""
    columns = jnp.array(problem.active, int)
    lens = values.lens[:, columns] - problem.start.lens[:, columns]
    mount = jnp.concatenate([jax.vmap(rotation_vector_from_R)(values.boresight), values.lever - problem.start.lever], 1)
    return [(lens, problem.lens), (mount, problem.mount), (values.strip, problem.strip)]


def step_of(problem: Problem, images: Any, shared: Any, points: Any) -> Step:
    """The step that solutions (n, c), (s,) and (3, rows) mean."""
    active, first = len(problem.active), problem.of_lenses
    lens = jnp.zeros(problem.lens.free.shape)
    if problem.own_lens and active:
        lens = lens.at[problem.layout.camera].set(images[:, POSE:], unique_indices=True)
    elif first:
        lens = shared[:first].reshape(lens.shape)
    mount, strip = jnp.zeros(problem.mount.free.shape), jnp.zeros(problem.strip.free.shape)
    if problem.mounts:
        mount = shared[first : first + mount.size].reshape(mount.shape)
        first += mount.size
    if problem.strips:
        strip = shared[first:].reshape(strip.shape)
    return Step(pose=images[:, :POSE], points=points.T, lens=lens, mount=mount, strip=strip)


def free_columns(problem: Problem) -> tuple[Array, Array]:
    """1 for each column of the images (n, c) and of what they share (s,) that is free, else 0."""
    images = problem.free_pose
    if problem.own_lens:
        images = jnp.concatenate([images, problem.lens.free[problem.layout.camera]], axis=1)
    shared = [jnp.zeros(0)]
    shared += [problem.lens.free.ravel()] if problem.of_lenses else []
    shared += [problem.mount.free.ravel()] if problem.mounts else []
    shared += [problem.strip.free.ravel()] if problem.strips else []
    return images, jnp.concatenate(shared)


def _sum(parts: Any) -> Array:
    """Sum of a few arrays, in one pass."""
    first, *others = parts
    for part in others:
        first = first + part
    return first


def _block_diagonal(blocks: Float[Array, "k a a"]) -> Float[Array, "ka ka"]:
    k, a, _ = blocks.shape
    return (jnp.eye(k)[:, None, :, None] * blocks[:, :, None, :]).reshape(k * a, k * a)
