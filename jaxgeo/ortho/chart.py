"""Polynomial map from the cells of a tile to pixels, with measured approximation error."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import sized_filter_jit
from jaxgeo._typing import Flag, Scalar
from jaxgeo.ortho.cells import Cells, View, heights_at, level_of, projected, where_any
from jaxgeo.sensor import Shot
from jaxgeo.sensor.sensor import Sight
from jaxgeo.status import Status
from jaxgeo.terrain import Dem
from jaxgeo.terrain.grid import surface_point

# # Nodes along a side of a tile. Over 5 km the Earth's curvature deviates from a cubic by 1e-8 m.
NODES = 4
WELL_MAPPED = 1e-4  # pixels, and cells of the terrain: largest error of the polynomials between their nodes
APART = 1000.0  # m between two heights above one place; linear interpolation between them is exact


class Chart(NamedTuple):
    """Polynomial map of a tile in row and column. `columns` (nodes, k) are the node values: positions in the camera
    frame at several heights (m), and (row, col) on the terrain's grid."""

    columns: Float[Array, "nodes k"]
    last: Float[Array, "2"]
    """(row, col) of the tile's last cell, relative to its first."""


class Charted(NamedTuple):
    """A chart, its error, extent and sample cells."""

    chart: Chart
    error: Scalar
    """Approximation error between the nodes: the larger of pixels and cells of the terrain."""
    on_terrain: Float[Array, "2 2"]
    """First and last (row, col) on the terrain's grid."""
    lattice: Cells
    """Sample cells of the tile, (n, 3): each with its neighbours one row and one column on, at its height."""


@sized_filter_jit
def charted(view: View, corner: Float[Array, "2"], last: Float[Array, "2"]) -> Charted:
    """The chart of a tile with its first cell at `corner`, (row, col) of the grid, and its last at `corner + last`.

    The camera-frame position of a cell is a polynomial of its row and column, and linear in its height (quadratic with
    an atmosphere). The approximation error against the exact map is measured.
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
    height, status = heights_at(view, at[0][-2], at[0][-1])
    lattice = [_seen_cells(view, part, height, status) for part in at]
    stacked = jax.tree.map(lambda *parts: jnp.stack(parts, axis=1), *lattice)
    return Charted(Chart(columns, last), error, on_terrain, stacked)


def charted_cells(view: View, chart: Chart, by_row: Array, by_col: Array, sound: Flag) -> Cells:
    """Cells (rows, cols) of a part of a chart's tile; `by_row` and `by_col` are the `basis` of its rows and columns.
    Valid only if the chart is `sound`; that flag also splits the work into separate programs."""
    at_rows = jnp.einsum("ri,ijk->krj", by_row, chart.columns.reshape(NODES, NODES, -1))
    parts = [at_rows[:, :, j, None] * by_col[None, None, :, j] for j in range(NODES)]
    spread = tuple(parts[0] + parts[1] + parts[2] + parts[3])
    height, status = where_any(sound, lambda row, col: heights_at(view, row, col), *spread[-2:])
    some = jnp.any(status == Status.hit)
    cells = where_any(some, lambda *given: _seen_cells(view, given[2:], *given[:2]), height, status, *spread)
    return cells._replace(status=jnp.where(some, cells.status, status))


def basis(cells: Float[Array, " n"], last: Scalar) -> Float[Array, "n nodes"]:
    """Weights of the nodes at cells along one side of a tile."""
    return _basis(cells / jnp.maximum(last, 1.0))


def _seen_cells(view: View, spread: Any, height: Array, status: Array) -> Cells:
    """Cells from interpolated chart columns, at given ground heights."""
    p_camera, up = _in_camera(spread, _heights(view), height)
    u, v, image_status = projected(view.sensor.camera, p_camera)
    row, col = spread[-2], spread[-1]
    return Cells(u, v, row, col, _sine(p_camera, up), jnp.where(status == Status.hit, image_status, status))


def _heights(view: View) -> Float[Array, " k"]:
    """Heights in m at which node positions are computed: two, or three about the terrain's heights with an
    atmosphere."""
    if view.air is None:
        return jnp.array([0.0, APART])
    if not isinstance(view.terrain, Dem):
        return level_of(view.terrain) + jnp.array([-0.5 * APART, 0.0, 0.5 * APART])
    low, high = view.terrain.known_heights
    high = jnp.maximum(high, low + 1.0)
    return jnp.stack([low, 0.5 * (low + high), high])


def _columns(view: View, sight: Sight, rowcol: Float[Array, "n 2"]) -> Float[Array, "n k"]:
    """Node values at (row, col): camera-frame position at each of the heights, m, and (row, col) on the terrain's
    grid."""
    heights = _heights(view)

    def one(place: Float[Array, "2"]) -> Float[Array, " k"]:
        normal = view.grid.normal(place)
        foot = surface_point(normal)
        p_camera = jax.vmap(lambda h: sight.to_camera(foot + h * normal, view.air))(heights)
        on_terrain = view.terrain.grid.rowcol(normal) if isinstance(view.terrain, Dem) else jnp.zeros(2)
        return jnp.concatenate([p_camera.reshape(-1), on_terrain])

    return jax.vmap(one)(rowcol)


def _in_camera(columns: Any, heights: Float[Array, " k"], height: Array) -> tuple[list[Array], list[Array]]:
    """(positions in the camera frame at `height`, their derivatives by height in m per m), components first."""
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
    """Sine of the elevation angle of the lines of sight from points in the camera frame."""
    sine = -sum(a * b for a, b in zip(up, p_camera, strict=True))
    squared = sum(a * a for a in p_camera) * sum(a * a for a in up)
    return sine / jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0))


def _error(view: View, columns: Array, exact: Array) -> Scalar:
    """Largest deviation of chart columns (n, k) from the exact ones, in pixels or terrain cells, at any height;
    infinite where only one of the two has a pixel."""
    worst = jnp.max(jnp.abs((columns - exact)[:, -2:]))
    for first in range(0, columns.shape[1] - 2, 3):
        parts = [[x[:, first + i] for i in range(3)] for x in (columns, exact)]
        (u, v, image_status), (u0, v0, exact_status) = (projected(view.sensor.camera, part) for part in parts)
        both = (image_status == Status.hit) & (exact_status == Status.hit)
        off = jnp.where(both, jnp.abs(u - u0) + jnp.abs(v - v0), 0.0)
        differ = (image_status == Status.hit) & ~jnp.isfinite(u0) | (exact_status == Status.hit) & ~jnp.isfinite(u)
        worst = jnp.maximum(worst, jnp.max(jnp.where(differ, jnp.inf, off)))
    return jnp.where(jnp.isnan(worst), jnp.inf, worst)


def _spread(columns: Float[Array, "nodes k"], places: Float[Array, "n 2"]) -> Float[Array, "n k"]:
    """Chart columns at relative positions in the tile, each 0 to 1."""
    weights = _basis(places[:, 0])[:, :, None] * _basis(places[:, 1])[:, None, :]
    return weights.reshape(len(places), -1) @ columns


def _basis(t: Array) -> Array:
    """Lagrange polynomials of the nodes at t in [0, 1], (n, nodes)."""
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
    """All pairs (n, 2) of the given coordinates."""
    return np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)


_PLACES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
_BETWEEN = np.array(
    [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [0.5, 0.0], [0.0, 0.5], [1.0, 0.5], [0.5, 1.0], [0.5, 0.5]]
)
_AT_NODES = _squared(_PLACES)
_LATTICE = _squared(np.linspace(0.0, 1.0, 8))
