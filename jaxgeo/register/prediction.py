"""Predicted block shifts on the map: derivatives by the navigation errors and the map shift."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.ortho.cells import height_on
from jaxgeo.sensor.exposure import image_of_point, line_of_sight
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.terrain.grid import AbstractGrid, surface_point
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

CHUNK = 128  # positions per call: one size, so that other counts need no compilation
ACROSS = 5  # positions along a side of a block, to which a plane is fitted
LATTICE = 17  # pixels along a side of the image, from which its extent on the map is computed


class Shifts(NamedTuple):
    """Predicted shifts at map positions: pixels `uv` (n, 2); `by_error` (n, 2, axes + 2), derivatives of the shift
    in cells (rows, cols) by the navigation errors and the map shift to the east and north, m; `cells_per_metre` (n,
    2, 2), rows and cols by east and north; `ground_sampling` (n,), the side of a pixel on the ground in m; `stretch`
    (n,), length over width of a pixel on the ground; `visible`, whether the position is visible. `height` (n,),
    ellipsoidal, and `rise` (n, 2) to the east and north describe the best-fitting plane of the ground there.
    """

    uv: Float[Any, "n 2"]
    by_error: Float[Any, "n 2 unknowns"]
    cells_per_metre: Float[Any, "n 2 2"]
    ground_sampling: Float[Any, " n"]
    stretch: Float[Any, " n"]
    visible: Bool[Any, " n"]
    height: Float[Any, " n"]
    rise: Float[Any, "n 2"]

    @property
    def seen(self) -> Any:
        """Deprecated name of `visible`."""
        warnings.warn("Shifts.seen is now Shifts.visible; the old name goes with version 0.3.", DeprecationWarning, 2)
        return self.visible

    def covariance(self, cov: Float[Any, "unknowns unknowns"]) -> Float[np.ndarray, "n 2 2"]:
        """Covariance of the shifts in cells2 from the joint covariance of the errors and the map shift."""
        return np.einsum("nia,ab,njb->nij", self.by_error, cov, self.by_error)


def shifts_of(inputs: ModelInputs, model: ErrorModel, grid: AbstractGrid, places: np.ndarray, reach: float) -> Shifts:
    """Shifts at (n, 2) = (row, col) on a grid, on the plane that best fits the ground within `reach` cells to each
    side: it represents the block better than the facet at its centre."""
    found = in_chunks(lambda part: _shifts(inputs, model, grid, part, jnp.asarray(float(reach))), places)
    return Shifts(*found)


def in_chunks(function: Callable[[Array], Any], places: np.ndarray) -> list[np.ndarray]:
    """Output arrays of a function of rows, such as positions (n, 2), called on `CHUNK` rows at a time."""
    count, width = places.shape
    padded = np.resize(places, (max(-(-count // CHUNK), 1) * CHUNK, width)) if count else np.zeros((CHUNK, width))
    parts = [function(jnp.asarray(padded[k : k + CHUNK])) for k in range(0, len(padded), CHUNK)]
    return [np.concatenate([np.asarray(x) for x in column])[:count] for column in zip(*parts, strict=True)]


@batch_filter_jit
def _shifts(
    inputs: ModelInputs, model: ErrorModel, grid: AbstractGrid, places: Float[Array, "n 2"], reach: Scalar
) -> Shifts:
    def one(place: Float[Array, "2"]) -> tuple[Array, ...]:
        normal = grid.normal(place)
        height, by_cell, known = _plane(inputs.terrain, grid, place, reach)
        p_ecef = surface_point(normal) + height * normal
        R = R_ecef_from_enu(WGS84.to_geodetic(p_ecef))
        uv, status = _image(inputs, p_ecef)
        by_enu = jax.jacfwd(lambda p: _image(inputs, p)[0])(p_ecef) @ R
        per_metre = jax.jacfwd(lambda p: grid.rowcol(WGS84.normal_and_height(p)[0]))(p_ecef) @ R[:, :2]
        slope = by_cell @ per_metre
        along = by_enu[:, :2] + by_enu[:, 2:] * slope[None, :]  # derivative by a step over the terrain

        def moved(error: Float[Array, " axes"]) -> Float[Array, "2"]:
            there = model.moved(inputs, error)
            lifted = p_ecef + (_lift(there.terrain, p_ecef) - _lift(inputs.terrain, p_ecef)) * normal
            return _image(there, lifted)[0]

        by_error = jax.jacfwd(moved)(jnp.zeros(model.size))
        (a, b), (c, d) = along
        det = a * d - b * c
        sound = jnp.isfinite(det) & (jnp.abs(det) > 1e-300)
        inverse = jnp.array([[d, -b], [-c, a]]) / jnp.where(sound, det, 1.0)
        shift = jnp.concatenate([-inverse @ by_error, jnp.eye(2)], axis=1)
        visible = (status == Status.hit) & known & sound
        size = jnp.abs(jnp.where(sound, det, 1.0))
        squared = jnp.sum(along**2)
        stretch = 0.5 * (squared + jnp.sqrt(jnp.maximum(squared**2 - 4.0 * size**2, 0.0))) / size
        return uv, per_metre @ shift, per_metre, 1.0 / jnp.sqrt(size), stretch, visible, height, slope

    return Shifts(*jax.vmap(one)(places))


def window_of(inputs: ModelInputs, grid: AbstractGrid, shape: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """(first row, first col, last row + 1, last col + 1) of the image's extent on a grid; None if outside.

    Computed without a terrain search, from the intersections of lines of sight with the lowest and highest heights.
    """
    rowcol, visible = (np.asarray(x) for x in _passed(inputs, grid))
    if not visible.any():
        return None
    low, high = rowcol[visible].min(axis=0), rowcol[visible].max(axis=0)
    aside = 0.02 * (high - low) + 2.0
    first = np.maximum(np.floor(low - aside), 0.0)
    last = np.minimum(np.ceil(high + aside) + 1.0, np.array(shape))
    if np.any(last - first < 2.0):
        return None
    return int(first[0]), int(first[1]), int(last[0]), int(last[1])


@batch_filter_jit
def _passed(inputs: ModelInputs, grid: AbstractGrid) -> tuple[Float[Array, "n 2"], Bool[Array, " n"]]:
    """(row, col) where lines of sight of a pixel lattice intersect the lowest and the highest height; flags whether
    they do.

    Lines of sight that intersect neither end at the horizon.
    """
    camera = inputs.sensor.camera
    t = jnp.linspace(0.0, 1.0, LATTICE)
    u, v = jnp.meshgrid(t * getattr(camera, "width") - 0.5, t * getattr(camera, "height") - 0.5)  # noqa: B009
    uv = jnp.stack([u.reshape(-1), v.reshape(-1)], axis=1)
    if isinstance(inputs.terrain, Dem):
        low, high = inputs.terrain.known_heights
    else:
        low = high = -inputs.terrain.clearance(jnp.array([WGS84.a, 0.0, 0.0]), jnp.zeros(2, jnp.int32))

    def one(pixel: Float[Array, "2"], height: Scalar) -> tuple[Array, Array]:
        origin, direction, status = line_of_sight(inputs.sensor, inputs.motion, jnp.asarray(inputs.time), pixel)
        near, _, meets = WGS84.ranges_to_height(origin, direction, height)
        ahead = (status == Status.hit) & meets & (near > 0.0)
        p_ecef = jnp.where(ahead, origin + jnp.where(ahead, near, 0.0) * direction, jnp.array([WGS84.a, 0.0, 0.0]))
        return grid.rowcol(WGS84.normal_and_height(p_ecef)[0]), ahead

    places, ahead = jax.vmap(jax.vmap(one, (0, None)), (None, 0))(uv, jnp.stack([low, high]))
    return places.reshape(-1, 2), ahead.reshape(-1)


def _image(inputs: ModelInputs, p_ecef: Vector3) -> tuple[Float[Array, "2"], Array]:
    uv, status, _ = image_of_point(inputs.sensor, inputs.motion, jnp.asarray(inputs.time), p_ecef, inputs.air)
    return uv, status


def _plane(
    terrain: AbstractTerrain, grid: AbstractGrid, place: Float[Array, "2"], reach: Scalar
) -> tuple[Scalar, Float[Array, "2"], Bool[Array, ""]]:
    """(height in m at a position, rise in m per cell down and across, whether it is known) of the plane that best
    fits the ground within `reach` cells; at least half of the ground must be known."""
    t = reach * jnp.linspace(-1.0, 1.0, ACROSS)
    steps = jnp.stack([x.reshape(-1) for x in jnp.meshgrid(t, t, indexing="ij")], axis=1)

    def at(step: Float[Array, "2"]) -> tuple[Scalar, Bool[Array, ""]]:
        height, _, status = height_on(terrain, grid.normal(place + step))
        return height, status == Status.hit

    heights, known = jax.vmap(at)(steps)
    share = known.astype(jnp.float64)
    rows = jnp.concatenate([jnp.ones((ACROSS**2, 1)), steps / reach], axis=1)
    normal = (rows * share[:, None]).T @ rows + 1e-9 * jnp.eye(3)
    plane = jnp.linalg.solve(normal, rows.T @ (share * heights))
    return plane[0], plane[1:] / reach, jnp.sum(share) >= 0.5 * ACROSS**2


def _lift(terrain: AbstractTerrain, p_ecef: Vector3) -> Scalar:
    """Height of the terrain surface above a point, m."""
    return -terrain.clearance(p_ecef, _cell(terrain, p_ecef))


def _cell(terrain: AbstractTerrain, p_ecef: Vector3) -> Array:
    if not isinstance(terrain, Dem):
        return jnp.zeros(2, jnp.int32)
    return terrain.cell_of(jax.lax.stop_gradient(terrain.over(p_ecef)[0]))
