"""Ground cells of a rectified image: terrain heights and projection into the image, in batches."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Float32, Int8

from jaxgeo._accelerator import by_device
from jaxgeo._compile import batch_filter_jit, long_run_filter_jit
from jaxgeo._intersection import sight_along, visibility
from jaxgeo._numerics import dot, safe_sqrt
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Scalar, Vector3
from jaxgeo.earth import WGS84, Atmosphere
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.camera import IMAGE_PLANE, AbstractCamera, FrameCamera
from jaxgeo.sensor.distortion import AbstractDistortion, NoDistortion
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.status import Status, first_failure
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.terrain.grid import AbstractGrid, surface_point

DIRECTIONS = 64  # about the lens centre, in which the valid field is sampled
Field = Float[Array, "*shape"]


class View(Record):
    """Inputs of the projection of a ground point into the image."""

    sensor: Sensor
    motion: Shot | Trajectory
    time: Scalar
    terrain: AbstractTerrain
    grid: AbstractGrid
    air: Atmosphere | None = None


class Cells(NamedTuple):
    """Cells on the ground, arrays of one shape: pixels (column, row), (row, col) on the terrain's grid, sine of the
    elevation angle of the line of sight, and a `Status` that does not consider occlusion."""

    u: Field
    v: Field
    terrain_row: Field
    terrain_col: Field
    sine: Field
    status: Int8[Array, "*shape"]


def height_on(terrain: AbstractTerrain, normal: Vector3) -> tuple[Scalar, Float[Array, "2"], Int8[Array, ""]]:
    """(ellipsoidal height of the ground in m, its (row, col) on the terrain's grid, `hit` or why it is unknown)."""
    if not isinstance(terrain, Dem):
        return level_of(terrain), jnp.zeros(2), Status.hit.code
    rowcol = terrain.grid.rowcol(normal)
    height, status = _surface(terrain, rowcol[0], rowcol[1])
    return height, rowcol, status


def where_any(some: Flag, stage: Callable[..., Any], *given: Array) -> Any:
    """Result of a stage on arrays, or zeros if `some` is false. The conditional keeps the stage a separate program;
    XLA would otherwise fuse it with its consumers and recompute parts of it for every use."""
    shapes = jax.eval_shape(stage, *given)
    return jax.lax.cond(some, stage, lambda *_: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes), *given)


@long_run_filter_jit
def cells_one_by_one(view: View, corner: Float[Array, "2"], shape: tuple[int, int]) -> Cells:
    """Cells of a tile by exact projection of each: for moving sensors, and where the polynomials are not accurate
    enough."""

    def one(rowcol: Float[Array, "2"]) -> tuple:
        normal = view.grid.normal(rowcol)
        height, place, status = height_on(view.terrain, normal)
        p_ecef = surface_point(normal) + height * normal
        uv, image_status, origin = image_of_point(view.sensor, view.motion, view.time, p_ecef, view.air)
        line = origin - p_ecef
        sine = dot(line, normal) / safe_sqrt(dot(line, line))
        return *uv, *place, sine, first_failure(status, image_status)

    rows, cols = shape
    row, col = jnp.meshgrid(jnp.arange(float(rows)), jnp.arange(float(cols)), indexing="ij")
    rowcol = corner[None, :] + jnp.stack([row.reshape(-1), col.reshape(-1)], axis=1)
    found = jax.lax.map(one, rowcol, batch_size=by_device(1024, 2**18))
    return Cells(*(leaf.reshape(shape) for leaf in found))


def may_be_hidden(cells: Cells, least_sine: Float32[Array, "rows cols"]) -> Bool[Array, "*shape"]:
    """Flags of cells on the image that `OpenSight` does not prove visible."""
    rows, cols = least_sine.shape
    row, col = (jnp.floor(jnp.nan_to_num(x)).astype(jnp.int32) for x in (cells.terrain_row, cells.terrain_col))
    facet = jnp.clip(row, 0, rows - 1) * cols + jnp.clip(col, 0, cols - 1)
    least = least_sine.reshape(-1).at[facet].get(mode="promise_in_bounds")
    return (cells.status == Status.hit) & ~(cells.sine > least)


@batch_filter_jit
def hidden(view: View, rowcol: Float[Array, "n 2"], tolerance: Scalar) -> Int8[Array, " n"]:
    """Status of cells on known ground at (row, col) of the grid, by first-hit search along the line of sight: `hit`,
    `hidden_by_terrain`, or why it is unknown."""

    def one(rowcol: Float[Array, "2"]) -> Array:
        normal = view.grid.normal(rowcol)
        height, _, _ = height_on(view.terrain, normal)
        p_ecef = surface_point(normal) + height * normal
        if isinstance(view.motion, Shot):
            origin = view.sensor.perspective_centre(view.motion)
        else:
            _, _, origin = image_of_point(view.sensor, view.motion, view.time, p_ecef, view.air)
        if view.air is not None:
            return visibility(origin, p_ecef, view.terrain, tolerance, view.air)
        return sight_along(origin, p_ecef, view.terrain, tolerance)

    return jax.vmap(one)(rowcol)


def level_of(terrain: AbstractTerrain) -> Scalar:
    """Height in m of a terrain that is not a `Dem`."""
    return -terrain.clearance(jnp.array([WGS84.a, 0.0, 0.0]), jnp.zeros(2, jnp.int32))


def heights_at(view: View, row: Array, col: Array) -> tuple[Array, Array]:
    """(heights in m at (row, col) of the terrain's grid, `hit` or why they are unknown)."""
    if isinstance(view.terrain, Dem):
        return _surface(view.terrain, row, col)
    return jnp.full(row.shape, level_of(view.terrain)), jnp.full(row.shape, Status.hit.code)


def _surface(terrain: Dem, row: Array, col: Array) -> tuple[Array, Array]:
    """(heights in m at (row, col) of the terrain's grid, of any one shape; `hit` or why they are unknown).

    Same values as `Dem.height_at`, but on whole arrays, which is several times faster for a batch.
    """
    last = (jnp.asarray(terrain.extent) - 1).astype(jnp.float64)
    inside = (row >= -1e-9) & (row <= last[0] + 1e-9) & (col >= -1e-9) & (col <= last[1] + 1e-9)
    top = jnp.clip(jnp.floor(jnp.where(inside, row, 0.0)), 0.0, last[0] - 1.0)
    left = jnp.clip(jnp.floor(jnp.where(inside, col, 0.0)), 0.0, last[1] - 1.0)
    s, t = jnp.where(inside, row - top, 0.0), jnp.where(inside, col - left, 0.0)
    width = jnp.shape(terrain.posts)[1]
    first = top.astype(jnp.int32) * width + left.astype(jnp.int32)
    corners = (first, first + 1, first + width, first + width + 1)
    posts, void = jnp.asarray(terrain.posts).reshape(-1), jnp.asarray(terrain.void).reshape(-1)
    a, b, c, d = (posts.at[post].get(mode="promise_in_bounds").astype(jnp.float64) for post in corners)
    if terrain.field is not None:
        at = jnp.vectorize(lambda r, c: jnp.stack(terrain.field.at_corners(r, c)), signature="(),()->(k)")  # pyright: ignore
        more = at(top.astype(jnp.int32), left.astype(jnp.int32))
        a, b, c, d = a + more[..., 0], b + more[..., 1], c + more[..., 2], d + more[..., 3]

    def touched() -> Array:
        parts = [void.at[post].get(mode="promise_in_bounds") for post in corners]
        return parts[0] | parts[1] | parts[2] | parts[3]

    unknown = jax.lax.cond(terrain.has_void, touched, lambda: jnp.zeros(first.shape, bool))
    height = (1.0 - s) * ((1.0 - t) * a + t * b) + s * ((1.0 - t) * c + t * d)
    unknown = unknown | ~jnp.isfinite(height)
    status = jnp.where(unknown, Status.hits_void.code, Status.hit.code)
    status = jnp.where(inside, status, Status.leaves_terrain.code)
    return jnp.where(unknown | ~inside, 0.0, height), status


def projected(camera: AbstractCamera, p_camera: list[Array]) -> tuple[Array, Array, Array]:
    """(columns, rows, statuses) of points in the camera frame, of any one shape."""
    if not isinstance(camera, FrameCamera):
        return _projected_one_by_one(camera, p_camera)
    if isinstance(camera.distortion, NoDistortion):
        return camera.project_many(*p_camera)
    unfolded = eqx.tree_at(lambda camera: camera.distortion, camera, _Unfolded(camera.distortion))
    is_in_field = _are_in_field(camera.distortion, *p_camera)
    quick, careful = (functools.partial(type(one).project_many, one) for one in (unfolded, camera))
    return jax.lax.cond(is_in_field, quick, careful, *p_camera)


def _projected_one_by_one(camera: AbstractCamera, p_camera: list[Array]) -> tuple[Array, Array, Array]:
    def one(x: Scalar, y: Scalar, z: Scalar) -> tuple[Scalar, Scalar, Array]:
        uv, status = camera.project(jnp.stack([x, y, z]))
        return uv[0], uv[1], status

    found = jax.vmap(one)(*(component.reshape(-1) for component in p_camera))
    return tuple(part.reshape(p_camera[0].shape) for part in found)  # pyright: ignore[reportReturnType]


class _Unfolded(NoDistortion):
    """Lens formula without the fold check, for points known to lie in the lens field; the check takes most of the
    time."""

    lens: AbstractDistortion

    def distort(self, ideal: Float[Array, "2"]) -> Float[Array, "2"]:
        return self.lens.distort(ideal)


def _are_in_field(lens: AbstractDistortion, x: Array, y: Array, z: Array) -> Flag:
    """Whether all points lie ahead and in the lens field. The field is free of folds around the centre, so a
    bounding circle of all points is sufficient."""
    ahead = z > IMAGE_PLANE * jnp.maximum(jnp.abs(x), jnp.abs(y))  # False for NaN
    z = jnp.where(ahead, z, 1.0)
    radius = 1.01 * jnp.sqrt(jnp.max(jnp.where(ahead, (x * x + y * y) / (z * z), 0.0)))
    angle = 2.0 * jnp.pi / DIRECTIONS * jnp.arange(DIRECTIONS)
    circle = radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    return jnp.all(ahead) & jnp.all(jax.vmap(lens.in_field)(circle))
