"""Where the cells of a grid on the ground lie in an image: many at once, for one tile of cells."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, Int8

from jaxgeo._numerics import dot, safe_sqrt
from jaxgeo._typing import Flag, Scalar, Vector3
from jaxgeo.earth import WGS84, Atmosphere
from jaxgeo.locate import sight_along, visibility
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.sensor.camera import IMAGE_PLANE, AbstractCamera, FrameCamera
from jaxgeo.sensor.distortion import AbstractDistortion, NoDistortion
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.sensor.sensor import Sight
from jaxgeo.status import Status, first_failure
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.terrain.grid import AbstractGrid, surface_point

# Nodes along a side of a tile, and their polynomials: over 5 km the Earth curves away from a cubic by 1e-8 m.
NODES = 4
WELL_MAPPED = 1e-4  # pixels, and cells of the terrain, by which the polynomials may be off between their nodes
DIRECTIONS = 64  # about the centre of a lens, in which its field is looked at
APART = 1000.0  # m between two heights above one place: a straight line through them is exact

Field = Float[Array, "*shape"]


class View(eqx.Module):
    """All that the image of a place on the ground depends on."""

    sensor: Sensor
    motion: Shot | Trajectory
    time: Scalar
    terrain: AbstractTerrain
    grid: AbstractGrid
    air: Atmosphere | None = None


class Cells(NamedTuple):
    """Cells on the ground, arrays of one shape: their pixels (column, row), place (row, col) on the terrain's own grid,
    the sine of the angle at which the line of sight rises there, and a `Status` that knows nothing of hidden ground."""

    u: Field
    v: Field
    terrain_row: Field
    terrain_col: Field
    sine: Field
    status: Int8[Array, "*shape"]


class Chart(NamedTuple):
    """The map of a tile: polynomials of row and column through `columns` (nodes, k) at the nodes, which are places in
    the camera frame at some heights (m), and on the terrain's grid."""

    columns: Float[Array, "nodes k"]
    last: Float[Array, "2"]
    """(row, col) of the tile's last cell, counted from its first."""


class Charted(NamedTuple):
    """A chart and what it is like."""

    chart: Chart
    error: Scalar
    """The larger of pixels and of cells of the terrain by which it is off between the nodes."""
    on_terrain: Float[Array, "2 2"]
    """First and last (row, col) on the terrain's grid."""
    lattice: Cells
    """Some cells spread over the tile, (n, 3): each, and those that are one row and one column on, at its height."""


def height_on(terrain: AbstractTerrain, normal: Vector3) -> tuple[Scalar, Float[Array, "2"], Int8[Array, ""]]:
    """(ellipsoidal height in m of the ground, its (row, col) on the terrain's grid, `hit` or why it is unknown)."""
    if not isinstance(terrain, Dem):
        return _level(terrain), jnp.zeros(2), Status.hit.code
    rowcol = terrain.grid.rowcol(normal)
    height, status = _surface(terrain, rowcol[0], rowcol[1])
    return height, rowcol, status


@eqx.filter_jit
def charted(view: View, corner: Float[Array, "2"], last: Float[Array, "2"]) -> Charted:
    """The chart of a tile whose first cell is at `corner`, (row, col) of the grid, and its last so many further on.

    The place of a cell seen from the camera is a polynomial of its row and column, and linear in its height (with air,
    of second degree): that is the exact map but for the error, which is measured.
    """
    assert isinstance(view.motion, Shot)
    sight = view.sensor.sight(view.motion)
    columns = _columns(view, sight, corner[None, :] + jnp.asarray(_AT_NODES) * last[None, :])
    between = jnp.asarray(_BETWEEN)
    exact = _columns(view, sight, corner[None, :] + between * last[None, :])
    error = _error(view, _spread(columns, between), exact)
    on_terrain = jnp.stack([jnp.min(exact[:, -2:], axis=0), jnp.max(exact[:, -2:], axis=0)])
    here = jnp.asarray(_LATTICE)
    step = 1.0 / jnp.maximum(last, 1.0)
    corners = [here, here + jnp.array([[1.0, 0.0]]) * step[None, :], here + jnp.array([[0.0, 1.0]]) * step[None, :]]
    at = [_spread(columns, places).T for places in corners]
    height, status = _ground(view, at[0][-2], at[0][-1])
    lattice = [_seen_cells(view, part, height, status) for part in at]
    stacked = jax.tree.map(lambda *parts: jnp.stack(parts, axis=1), *lattice)
    return Charted(Chart(columns, last), error, on_terrain, stacked)


def charted_cells(view: View, chart: Chart, by_row: Array, by_col: Array, sound: Flag) -> Cells:
    """The cells (rows, cols) of a part of a chart's tile; `by_row` and `by_col` as `basis` gives them for its rows and
    columns. Meaningless unless the chart is `sound`: by this the work is cut up."""
    at_rows = jnp.einsum("ri,ijk->krj", by_row, chart.columns.reshape(NODES, NODES, -1))
    parts = [at_rows[:, :, j, None] * by_col[None, None, :, j] for j in range(NODES)]
    spread = tuple(parts[0] + parts[1] + parts[2] + parts[3])
    height, status = where_any(sound, lambda row, col: _ground(view, row, col), *spread[-2:])
    some = jnp.any(status == Status.hit)
    return where_any(some, lambda *given: _seen_cells(view, given[2:], *given[:2]), height, status, *spread)


def basis(cells: Float[Array, " n"], last: Scalar) -> Float[Array, "n nodes"]:
    """What the nodes count for at cells along one side of a tile."""
    return _basis(cells / jnp.maximum(last, 1.0))


def where_any(some: Flag, stage: Callable[..., Any], *given: Array) -> Any:
    """What a stage makes of arrays, or zeros unless there are `some` for it: it is a program of its own, while XLA
    would else merge it with those that follow, and work parts of it out again for every use."""
    shapes = jax.eval_shape(stage, *given)
    return jax.lax.cond(some, stage, lambda *_: jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes), *given)


@eqx.filter_jit
def cells_one_by_one(view: View, corner: Float[Array, "2"], shape: tuple[int, int]) -> Cells:
    """The cells of a tile by the exact map of each: for sensors that move, and where polynomials do not hold."""

    def one(rowcol: Float[Array, "2"]) -> tuple:
        normal = view.grid.normal(rowcol)
        height, place, status = height_on(view.terrain, normal)
        p_ecef = surface_point(normal) + height * normal
        uv, seen, origin = image_of_point(view.sensor, view.motion, view.time, p_ecef, view.air)
        line = origin - p_ecef
        sine = dot(line, normal) / safe_sqrt(dot(line, line))
        return *uv, *place, sine, first_failure(status, seen)

    rows, cols = shape
    row, col = jnp.meshgrid(jnp.arange(float(rows)), jnp.arange(float(cols)), indexing="ij")
    rowcol = corner[None, :] + jnp.stack([row.reshape(-1), col.reshape(-1)], axis=1)
    found = jax.lax.map(one, rowcol, batch_size=1024)
    return Cells(*(leaf.reshape(shape) for leaf in found))


def may_be_hidden(cells: Cells, least_sine: Float32[Array, "rows cols"]) -> Bool[Array, "*shape"]:
    """Which of the cells that are on the image are not proven to be in sight by `OpenSight`."""
    rows, cols = least_sine.shape
    row, col = (jnp.floor(jnp.nan_to_num(x)).astype(jnp.int32) for x in (cells.terrain_row, cells.terrain_col))
    facet = jnp.clip(row, 0, rows - 1) * cols + jnp.clip(col, 0, cols - 1)
    least = least_sine.reshape(-1).at[facet].get(mode="promise_in_bounds")
    return (cells.status == Status.hit) & ~(cells.sine > least)


@eqx.filter_jit
def hidden(view: View, rowcol: Float[Array, "n 2"], tolerance: Scalar) -> Int8[Array, " n"]:
    """Status of cells on known ground at (row, col) of the grid: `hit`, `hidden_by_terrain`, or why it is not known; by
    the first hit of the line of sight."""

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


def _level(terrain: AbstractTerrain) -> Scalar:
    """Height in m of a terrain that is no `Dem`."""
    return -terrain.clearance(jnp.array([WGS84.a, 0.0, 0.0]), jnp.zeros(2, jnp.int32))


def _ground(view: View, row: Array, col: Array) -> tuple[Array, Array]:
    """(heights in m at places of the terrain's grid, `hit` or why they are unknown)."""
    if isinstance(view.terrain, Dem):
        return _surface(view.terrain, row, col)
    return jnp.full(row.shape, _level(view.terrain)), jnp.full(row.shape, Status.hit.code)


def _seen_cells(view: View, spread: Any, height: Array, status: Array) -> Cells:
    """The cells whose places are spread by a chart, on ground at heights."""
    p_camera, up = _seen(spread, _heights(view), height)
    u, v, seen = _projected(view.sensor.camera, p_camera)
    row, col = spread[-2], spread[-1]
    return Cells(u, v, row, col, _sine(p_camera, up), jnp.where(status == Status.hit, seen, status))


def _surface(terrain: Dem, row: Array, col: Array) -> tuple[Array, Array]:
    """(heights in m at places (row, col) of the terrain's grid, of any one shape; `hit` or why they are unknown).

    As `Dem.height_at` one by one, but from arrays of numbers, which for a crowd is several times as quick.
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


def _heights(view: View) -> Float[Array, " k"]:
    """Heights in m at which the place of a node is computed: two, or three about the terrain's through air."""
    if view.air is None:
        return jnp.array([0.0, APART])
    if not isinstance(view.terrain, Dem):
        return _level(view.terrain) + jnp.array([-0.5 * APART, 0.0, 0.5 * APART])
    low, high = view.terrain.known_heights
    high = jnp.maximum(high, low + 1.0)
    return jnp.stack([low, 0.5 * (low + high), high])


def _columns(view: View, sight: Sight, rowcol: Float[Array, "n 2"]) -> Float[Array, "n k"]:
    """For places (row, col): where each lies in the camera frame at every one of the heights, m; and the place on the
    terrain's grid."""
    heights = _heights(view)

    def one(place: Float[Array, "2"]) -> Float[Array, " k"]:
        normal = view.grid.normal(place)
        foot = surface_point(normal)
        seen = jax.vmap(lambda h: sight.to_camera(foot + h * normal, view.air))(heights)
        on_terrain = view.terrain.grid.rowcol(normal) if isinstance(view.terrain, Dem) else jnp.zeros(2)
        return jnp.concatenate([seen.reshape(-1), on_terrain])

    return jax.vmap(one)(rowcol)


def _seen(columns: Any, heights: Float[Array, " k"], height: Array) -> tuple[list[Array], list[Array]]:
    """(places in the camera frame at `height`, their change with height in m per m), components first."""
    low, span = heights[0], heights[-1] - heights[0]
    t = (height - low) / span
    if heights.shape[0] == 2:
        foot, top = columns[0:3], columns[3:6]
        up = [(top[i] - foot[i]) / span for i in range(3)]
        return [foot[i] + (height - low) * up[i] for i in range(3)], up
    a, b, c = columns[0:3], columns[3:6], columns[6:9]
    basis = ((1.0 - t) * (1.0 - 2.0 * t), 4.0 * t * (1.0 - t), t * (2.0 * t - 1.0))
    slope = (4.0 * t - 3.0, 4.0 - 8.0 * t, 4.0 * t - 1.0)
    place = [basis[0] * a[i] + basis[1] * b[i] + basis[2] * c[i] for i in range(3)]
    return place, [(slope[0] * a[i] + slope[1] * b[i] + slope[2] * c[i]) / span for i in range(3)]


def _sine(p_camera: list[Array], up: list[Array]) -> Array:
    """Sine of the angle at which lines of sight rise from places in the camera frame."""
    sine = -sum(a * b for a, b in zip(up, p_camera, strict=True))
    squared = sum(a * a for a in p_camera) * sum(a * a for a in up)
    return sine / jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))


def _projected(camera: AbstractCamera, p_camera: list[Array]) -> tuple[Array, Array, Array]:
    """(columns, rows, statuses) of places in the camera frame, of any one shape."""
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
    """The formula of a lens for places that are known to lie in its field: to look for folds takes most of the time."""

    lens: AbstractDistortion

    def distort(self, ideal: Float[Array, "2"]) -> Float[Array, "2"]:
        return self.lens.distort(ideal)


def _are_in_field(lens: AbstractDistortion, x: Array, y: Array, z: Array) -> Flag:
    """Whether all places lie ahead and in the lens's field: there it holds none but unfolded directions about its
    centre, so that a circle around them all tells."""
    ahead = z > IMAGE_PLANE * jnp.maximum(jnp.abs(x), jnp.abs(y))  # False for NaN
    z = jnp.where(ahead, z, 1.0)
    radius = 1.01 * jnp.sqrt(jnp.max(jnp.where(ahead, (x * x + y * y) / (z * z), 0.0)))
    angle = 2.0 * jnp.pi / DIRECTIONS * jnp.arange(DIRECTIONS)
    circle = radius * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1)
    return jnp.all(ahead) & jnp.all(jax.vmap(lens.in_field)(circle))


def _error(view: View, columns: Array, exact: Array) -> Scalar:
    """By how much a chart's columns (n, k) are off the exact ones, the larger of pixels and cells of the terrain, at
    any height; infinite where one of the two ways knows no pixel and the other does."""
    worst = jnp.max(jnp.abs((columns - exact)[:, -2:]))
    for first in range(0, columns.shape[1] - 2, 3):
        parts = [[x[:, first + i] for i in range(3)] for x in (columns, exact)]
        (u, v, seen), (u0, v0, seen0) = (_projected(view.sensor.camera, part) for part in parts)
        both = (seen == Status.hit) & (seen0 == Status.hit)
        off = jnp.where(both, jnp.abs(u - u0) + jnp.abs(v - v0), 0.0)
        differ = (seen == Status.hit) & ~jnp.isfinite(u0) | (seen0 == Status.hit) & ~jnp.isfinite(u)
        worst = jnp.maximum(worst, jnp.max(jnp.where(differ, jnp.inf, off)))
    return jnp.where(jnp.isnan(worst), jnp.inf, worst)


def _spread(columns: Float[Array, "nodes k"], places: Float[Array, "n 2"]) -> Float[Array, "n k"]:
    """A chart's columns at places in the tile, each of 0 to 1."""
    weights = _basis(places[:, 0])[:, :, None] * _basis(places[:, 1])[:, None, :]
    return weights.reshape(len(places), -1) @ columns


def _basis(t: Array) -> Array:
    """Lagrange's polynomials of the nodes at places t in [0, 1], (n, nodes)."""
    places = [float(place) for place in _PLACES]
    columns = []
    for i, here in enumerate(places):
        product = jnp.ones_like(t, jnp.float64)
        for j, other in enumerate(places):
            if i != j:
                product = product * (t - other) / (here - other)
        columns.append(product)
    return jnp.stack(columns, axis=1)


def _squared(along: np.ndarray) -> np.ndarray:
    """All places (n, 2) of which both coordinates are among those."""
    return np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)


_PLACES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
_BETWEEN = np.array(
    [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [0.5, 0.0], [0.0, 0.5], [1.0, 0.5], [0.5, 1.0], [0.5, 0.5]]
)
_AT_NODES = _squared(_PLACES)
_LATTICE = _squared(np.linspace(0.0, 1.0, 8))
