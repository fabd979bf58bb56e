"""Conservative visibility bounds from terrain slopes, so that only uncertain lines of sight need a search.

For every terrain facet, a tangent of elevation is computed above which lines of sight from the facet to the camera meet
no terrain. The path to the camera is divided into intervals. In each, the terrain height above the start of the line is
bounded by the accumulated steepest slopes of the intervals so far, and by the interval's highest post. The smaller
bound, over the shortest distance, gives the tangent.
"""

from __future__ import annotations

import dataclasses
import threading
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32, Int

from jaxgeo._compile import long_run_filter_jit, sized_filter_jit
from jaxgeo._numerics import safe_sqrt
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.earth import WGS84
from jaxgeo.ortho.cells import View
from jaxgeo.sensor import Shot
from jaxgeo.terrain import ConstantField, Dem
from jaxgeo.terrain.grid import surface_point

NEAR = 8  # intervals of one cell in which slopes are accumulated; later intervals grow
GROWTH = 1.25
FARTHEST = 4096.0  # cells; beyond, the terrain maximum is used
WINDOW = 4  # cells on a side: largest extent of an interval near the facet
BENT_BY_AIR = 2e-3  # rad: bound of atmospheric refraction
LEAST_ELEVATION = 1e-3  # rad; flatter lines of sight are always searched
LEAST_WAY = 3.0  # cells; nearer to the nadir point lines of sight have no common direction
WIDER = 1.01  # margin for grid steps between the sampled ones, and for height above the ellipsoid
STRAIGHT = 1e-3  # of its length: minimum allowance for a line of sight's deviation from a straight grid line
MOST_BENT = 1e-2  # of its length: largest accepted deviation (convergence of meridians, from tens of km)
ROUNDED = 1e-5  # rounding of a tangent
BLOCKS = 16  # along the longer side of a large terrain; only visible blocks are computed
LEAST_BLOCK = 256  # cells


class Ground(NamedTuple):
    """Terrain properties relative to one camera position, flattened over facets.

    `rise` is the steepest slope towards the camera in the `WINDOW` starting at a facet, m per m; `tops` is the highest
    post in that window in m, followed by the maxima over squares of 2, 4, 8, ... facets and their next neighbours.
    """

    rise: Float32[Array, " facets"]
    rise_at_foot: Scalar
    """Steepest slope in any direction near the nadir point, m per m."""
    tops: Float32[Array, " squares"]
    lowest: Float32[Array, "rows cols"]
    ceiling: Scalar
    metric: Float[Array, "places 3"]
    """Squared lengths and inner product of grid steps along rows and columns, m2."""
    bend: Scalar
    nadir: Float[Array, "2"]
    extent: Int[Array, "2"]


class OpenSight:
    """Sines of elevation above which lines of sight from terrain facets are proven free; computed on demand,
    thread-safe."""

    def __init__(self, view: View) -> None:
        assert isinstance(view.terrain, Dem)
        self._ground = _ground_of(view)
        self._slack = jnp.asarray(0.0 if view.air is None else BENT_BY_AIR)
        shape = self._ground.lowest.shape
        side = max(LEAST_BLOCK, -(-max(shape) // BLOCKS))
        self._block = (min(side, shape[0]), min(side, shape[1]))
        self._found = np.zeros([-(-n // side) for n, side in zip(shape, self._block, strict=True)], bool)
        self._least_sine = jnp.full(shape, 2.0, jnp.float32)
        self._lock = threading.Lock()

    @classmethod
    def of(cls, view: View) -> OpenSight | None:
        """Bounds for a view, or None where they do not apply: no `Dem`, a spatially varying field, or a moving
        camera."""
        if not (isinstance(view.terrain, Dem) and isinstance(view.motion, Shot)):
            return None
        return cls(view) if isinstance(view.terrain.field, ConstantField | None) else None

    def least_sine(self, first: np.ndarray, last: np.ndarray) -> Float32[Array, "rows cols"]:
        """Sine bound of all facets between two (row, col) positions of the terrain's grid, possibly more: lines of
        sight with a greater sine of elevation are free. Greater than 1 where unknown."""
        shape, side = np.array(self._found.shape), np.array(self._block)
        low, high = (np.clip(np.floor(np.nan_to_num(x) / side), 0, shape - 1).astype(int) for x in (first, last))
        with self._lock:
            for row in range(low[0], high[0] + 1):
                for col in range(low[1], high[1] + 1):
                    if not self._found[row, col]:
                        corner = jnp.array([row * side[0], col * side[1]])
                        self._least_sine = _with_block(self._least_sine, self._ground, self._slack, corner, self._block)
                        self._found[row, col] = True
            return self._least_sine


@sized_filter_jit
def _ground_of(view: View) -> Ground:
    assert isinstance(view.terrain, Dem)
    assert isinstance(view.motion, Shot)
    terrain = dataclasses.replace(view.terrain, field=None)  # a common height offset does not affect occlusion
    foot, _ = WGS84.normal_and_height(view.sensor.perspective_centre(view.motion))
    metric, bend, nadir = _map_of(foot, terrain)
    posts, void = jnp.asarray(terrain.posts), jnp.asarray(terrain.void)
    extent = jnp.asarray(terrain.extent)
    corners = [(posts[i, j], void[i, j]) for i in (np.s_[:-1], np.s_[1:]) for j in (np.s_[:-1], np.s_[1:])]
    (a, no_a), (b, no_b), (c, no_c), (d, no_d) = corners
    row, col = jnp.arange(a.shape[0])[:, None], jnp.arange(a.shape[1])[None, :]
    is_known = (row < extent[0] - 1) & (col < extent[1] - 1) & ~(no_a | no_b | no_c | no_d)
    ceiling = _up(jnp.asarray(terrain.ceiling))

    top = _up(jnp.maximum(jnp.maximum(a, b), jnp.maximum(c, d)))
    lowest = -_up(-jnp.minimum(jnp.minimum(a, b), jnp.minimum(c, d)))
    a, b, c, d = (x.astype(jnp.float64) for x in (a, b, c, d))
    towards_row, towards_col, length = _way(nadir, row + 0.5, col + 0.5)
    metres, aside = _metres(metric, bend, towards_row, towards_col, length)
    rise = jnp.maximum(towards_row * (c - a), towards_row * (d - b))
    rise += jnp.maximum(towards_col * (b - a), towards_col * (d - c))
    steepest = jnp.hypot(jnp.maximum(jnp.abs(c - a), jnp.abs(d - b)), jnp.maximum(jnp.abs(b - a), jnp.abs(d - c)))
    rise = jnp.maximum(rise + aside * steepest, 0.0) / jnp.where(metres > 0.0, metres, 1.0)
    in_any_direction = steepest / _least_metres(metric)
    rise = jnp.where(metres > 0.0, jnp.minimum(rise, in_any_direction), in_any_direction)
    rise = jnp.where(is_known, _up(rise), jnp.inf)
    near_foot = length < LEAST_WAY + 2.0
    rise_at_foot = jnp.max(jnp.where(near_foot, _up(jnp.where(is_known, in_any_direction, jnp.inf)), 0.0))
    top = jnp.where(is_known, top, ceiling)

    near = top
    for step in (1, 2):  # over WINDOW cells
        near, rise = _with_later(near, step, ceiling), _with_later(rise, step, jnp.inf)
    tops, square = [near.reshape(-1)], top
    for _ in _strides(top.shape)[1:]:
        square = _halved(square, ceiling)
        tops.append(_with_later(square, 1, ceiling).reshape(-1))
    return Ground(rise.reshape(-1), rise_at_foot, jnp.concatenate(tops), lowest, ceiling, metric, bend, nadir, extent)


def _map_of(foot: Vector3, terrain: Dem) -> tuple[Array, Array, Array]:
    """(squared lengths and inner products of grid steps at sample positions, m2; relative deviation of lines of
    sight from straight grid lines; (row, col) of the nadir point)."""
    grid = terrain.grid
    last = (jnp.asarray(terrain.extent) - 1).astype(jnp.float64)
    places = jnp.array([[r, c] for r in (0.0, 0.5, 1.0) for c in (0.0, 0.5, 1.0)]) * last[None, :]
    steps = jax.vmap(jax.jacfwd(lambda place: surface_point(grid.normal(place))))(places)
    squared = jnp.einsum("nki,nkj->nij", steps, steps)
    nadir = grid.rowcol(foot)

    def leaves_line(place: Float[Array, "2"]) -> Scalar:
        middle = grid.normal(place) + foot
        off = grid.rowcol(middle / safe_sqrt(middle @ middle)) - 0.5 * (place + nadir)
        way = nadir - place
        return jnp.abs(off[0] * way[1] - off[1] * way[0]) / jnp.maximum(way @ way, 1e-9)

    off = jnp.max(jax.vmap(leaves_line)(places))  # the end slope of an arc is four times its relative height
    return jnp.stack([squared[:, 0, 0], squared[:, 1, 1], squared[:, 0, 1]], axis=1), STRAIGHT + 8.0 * off, nadir


def _way(nadir: Array, row: Array, col: Array) -> tuple[Array, Array, Array]:
    """(direction from grid positions to the nadir point, along rows and columns; distance in cells)."""
    down, across = nadir[0] - row, nadir[1] - col
    length = jnp.sqrt(down * down + across * across)
    return down / jnp.maximum(length, 1e-9), across / jnp.maximum(length, 1e-9), length


def _least_metres(metric: Array) -> Scalar:
    """Smallest length in m of a step of one cell."""
    middle, half = 0.5 * (metric[:, 0] + metric[:, 1]), jnp.hypot(0.5 * (metric[:, 0] - metric[:, 1]), metric[:, 2])
    return jnp.sqrt(jnp.min(middle - half)) / WIDER


def _metres(metric: Array, bend: Array, by_row: Array, by_col: Array, length: Array) -> tuple[Array, Array]:
    """(smallest length in m of a one-cell step in a direction, for lines from anywhere on a facet; their spread in
    direction, rad). The length is not positive where there is no bound."""
    row2, col2, both = (metric[:, k] for k in range(3))
    middle, half = 0.5 * (row2 + col2), jnp.hypot(0.5 * (row2 - col2), both)
    longest = jnp.sqrt(jnp.max(middle + half))
    squared = [row2[k] * by_row**2 + col2[k] * by_col**2 + 2.0 * both[k] * by_row * by_col for k in range(len(row2))]
    least = squared[0]
    for other in squared[1:]:
        least = jnp.minimum(least, other)
    aside = bend + 1.0 / jnp.maximum(length, 1e-9)
    metres = jnp.sqrt(jnp.maximum(least, 0.0)) / WIDER - longest * aside
    return jnp.where(length > LEAST_WAY, metres, -1.0), aside


def _up(values: Array) -> Array:
    """Round up to single precision."""
    single = values.astype(jnp.float32)
    return jnp.where(single.astype(jnp.float64) < values, jnp.nextafter(single, jnp.float32(jnp.inf)), single)


def _with_later(values: Array, step: int, beyond: Any) -> Array:
    """Maximum of each value and the one `step` later, along both axes."""
    for axis in (0, 1):
        count = min(step, values.shape[axis])
        shape = list(values.shape)
        shape[axis] = count
        later = [jax.lax.slice_in_dim(values, count, None, axis=axis), jnp.full(shape, beyond, values.dtype)]
        values = jnp.maximum(values, jnp.concatenate(later, axis=axis))
    return values


def _halved(values: Array, beyond: Array) -> Array:
    """Maxima of 2 x 2 squares."""
    rows, cols = values.shape
    values = jnp.pad(values, ((0, rows % 2), (0, cols % 2)), constant_values=beyond)
    return jnp.maximum(
        jnp.maximum(values[::2, ::2], values[1::2, ::2]), jnp.maximum(values[::2, 1::2], values[1::2, 1::2])
    )


def _strides(shape: tuple[int, ...]) -> list[tuple[int, int, int]]:
    """(side of a square in facets, squares per row, start index) of the arrays in `Ground.tops`."""
    rows, cols, start, side, found = *shape, 0, 1, []
    while True:
        found.append((side, cols, start))
        if (side >= 2 and max(rows, cols) == 1) or side >= FARTHEST:
            return found
        start, side = start + rows * cols, 2 * side
        rows, cols = -(-rows // 2), -(-cols // 2)


def _stretches(strides: list[tuple[int, int, int]]) -> np.ndarray:
    """First and last end in cells of the intervals beyond the near ones, and side, row length and start index of the
    squares used for lookup; the squares cover at least the interval."""
    rows, first = [], float(NEAR)
    while first < FARTHEST:
        last = first + max(1.0, (GROWTH - 1.0) * first)
        reach = 1.0 + (last - first) + 2.0 * MOST_BENT * last
        fitting = [k for k, (side, _, _) in enumerate(strides) if k and side >= reach]
        rows.append([first, last, *strides[fitting[0] if fitting else -1]])
        if not fitting:
            return np.array(rows)[:-1]
        first = last
    return np.array(rows)


@long_run_filter_jit
def _with_block(
    least_sine: Float32[Array, "rows cols"],
    ground: Ground,
    slack: Scalar,
    corner: Int[Array, "2"],
    shape: tuple[int, int],
) -> Float32[Array, "rows cols"]:
    """The sine bounds with a block of facets from (row, col) computed."""
    rows, cols = least_sine.shape
    corner = jnp.minimum(corner, jnp.array([rows - shape[0], cols - shape[1]]))  # the last blocks overlap others
    row = (corner[0] + jnp.arange(shape[0]))[:, None].astype(jnp.float64) + jnp.zeros(shape)
    col = (corner[1] + jnp.arange(shape[1]))[None, :].astype(jnp.float64) + jnp.zeros(shape)
    lowest = jax.lax.dynamic_slice(ground.lowest, corner, shape)
    tangent = _least_tangent(ground, row, col, lowest)
    angle = jnp.arctan(tangent * (1.0 + ROUNDED) + ROUNDED) + slack
    sine = jnp.where(angle < 0.5 * jnp.pi, jnp.sin(jnp.maximum(angle, LEAST_ELEVATION)), 2.0)
    sine = jnp.where(jnp.isfinite(tangent), _up(sine), 2.0).astype(jnp.float32)
    return jax.lax.dynamic_update_slice(least_sine, sine, corner)


def _least_tangent(ground: Ground, row: Array, col: Array, lowest: Array) -> Array:
    """Tangent of elevation above which lines of sight from facets are free."""
    by_row, by_col, length = _way(ground.nadir, row + 0.5, col + 0.5)
    metres, _ = _metres(ground.metric, ground.bend, by_row, by_col, length)
    metres = jnp.where((metres > 0.0) & (ground.bend < MOST_BENT), metres, jnp.nan)
    last_row, last_col = (ground.extent - 1).astype(jnp.float64)
    all_cols = ground.lowest.shape[1]

    def looked_up(first: Any, last: Any, squares: tuple[Any, Any, Any]) -> tuple[Array, Array, Array]:
        """(array index of the interval, whether it leaves the terrain, its highest ground)."""
        side, across, start = squares
        aside = ground.bend * last
        row0 = row + jnp.minimum(by_row * first, by_row * last) - aside
        col0 = col + jnp.minimum(by_col * first, by_col * last) - aside
        row1 = row + 1.0 + jnp.maximum(by_row * first, by_row * last) + aside
        col1 = col + 1.0 + jnp.maximum(by_col * first, by_col * last) + aside
        leaves = (row0 < 0.0) | (col0 < 0.0) | (row1 > last_row) | (col1 > last_col)
        low_row, low_col = (jnp.floor(jnp.where(leaves, 0.0, x) / side).astype(jnp.int32) for x in (row0, col0))
        place = jnp.asarray(start, jnp.int32) + low_row * jnp.asarray(across, jnp.int32) + low_col
        top = ground.tops.at[place].get(mode="promise_in_bounds")
        return place, leaves, jnp.where(leaves, ground.ceiling, top)

    def near(k: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        tangent, total, before = state
        first = k.astype(jnp.float64)
        place, leaves, top = looked_up(first, first + 1.0, (1, all_cols, 0))
        rise = jnp.where(leaves, jnp.inf, ground.rise.at[place].get(mode="promise_in_bounds"))
        total = total + rise
        after = total / (first + 1.0)
        by_height = jnp.where(first > 0.0, (top - lowest) / (jnp.maximum(first, 1.0) * metres), jnp.inf)
        need = jnp.minimum(jnp.maximum(before, after), by_height)
        return jnp.where(first < length, jnp.maximum(tangent, need), tangent), total, after

    def far(k: Array, tangent: Array) -> Array:
        first, last = stretches[k, 0], stretches[k, 1]
        _, _, top = looked_up(first, last, (stretches[k, 2], stretches[k, 3], stretches[k, 4]))
        return jnp.where(first < length, jnp.maximum(tangent, (top - lowest) / (first * metres)), tangent)

    zero = jnp.zeros(row.shape)
    tangent, _, _ = jax.lax.fori_loop(0, NEAR, near, (zero, zero, zero))
    listed = _stretches(_strides(ground.lowest.shape))
    end = float(NEAR)
    if len(listed):
        stretches = jnp.asarray(listed)
        tangent = jax.lax.fori_loop(0, len(listed), far, tangent)
        end = float(listed[-1, 1])
    beyond = (ground.ceiling - lowest) / (end * metres)
    tangent = jnp.where(end < length, jnp.maximum(tangent, beyond), tangent)
    return jnp.where(length > LEAST_WAY, tangent, jnp.where(ground.bend < MOST_BENT, ground.rise_at_foot, jnp.nan))
