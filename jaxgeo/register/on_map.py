"""Comparison in map space: the image rectified onto cells of the reference."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.ortho.orthoimage import cell_side
from jaxgeo.ortho.rectification import Rectifier
from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import Chosen
from jaxgeo.register.comparison import AbstractComparison, on_ground, tied
from jaxgeo.register.images import Images, RegistrationFailed
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.prediction import Shifts, in_chunks, shifts_of
from jaxgeo.register.ties import TiePoints
from jaxgeo.sensor import Shot
from jaxgeo.terrain.grid import AbstractGrid, surface_point
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

TILE = 256  # cells on a side; one size, so that other windows need no compilation


class MapPlace(NamedTuple):
    """Cells of `factor` reference cells, and the image `window` in them (first row, first col, last row + 1, last
    col + 1)."""

    factor: int
    window: tuple[int, int, int, int]


class OnMap(AbstractComparison):
    """Comparison for near-vertical images, as in Gu and Qiao (2017): a pose error only shifts the blocks."""

    def __init__(self, inputs: ModelInputs, model: ErrorModel, images: Images, place: MapPlace, block: int) -> None:
        level = images.level(place.factor)
        top, left, bottom, right = window = _wider(place.window, level.known.shape, 4 * block)
        self._inputs, self._model, self.block = inputs, model, block
        self._grid = level.grid.window(float(top), float(left))
        grey, self.known = _rectified(inputs, images, self._grid, place.window, window)
        if not self.known.any():
            raise RegistrationFailed(Outcome.unknown_ground)
        part = np.s_[top:bottom, left:right]
        self.grey, self.known = images.compared(grey, self.known)
        self.reference, self.known_reference = level.grey[(..., *part)], level.known[part]
        self.cell = cell_side(self._grid)

    def shifts(self, places: np.ndarray, reach: float) -> Shifts:
        return shifts_of(self._inputs, self._model, self._grid, places, reach)

    def ties(self, matches: Matches, chosen: Chosen, shifts: Shifts) -> TiePoints:
        kept = tied(chosen, shifts)
        shift, per_metre = chosen.of(matches.shift)[kept], np.asarray(shifts.cells_per_metre)[kept]
        lat, lon = in_chunks(lambda part: _lat_lon(self._grid, part), np.asarray(matches.centre)[kept] + shift)
        rise, away = np.asarray(shifts.rise)[kept], np.linalg.solve(per_metre, shift[:, :, None])[:, :, 0]
        height = np.asarray(shifts.height)[kept] + np.sum(rise * away, axis=1)
        covariance = on_ground(chosen.of(matches.covariance)[kept], per_metre)
        ground = Geodetic(lat=lat, lon=lon, height=height)
        return TiePoints(np.asarray(shifts.uv)[kept], ground, covariance, rise=rise, sides=self.sides(per_metre))


def _wider(window: tuple[int, int, int, int], shape: tuple[int, ...], aside: int) -> tuple[int, int, int, int]:
    """A window with a margin, clipped to the reference."""
    return (
        max(window[0] - aside, 0),
        max(window[1] - aside, 0),
        min(window[2] + aside, shape[0]),
        min(window[3] + aside, shape[1]),
    )


def _rectified(
    inputs: ModelInputs,
    images: Images,
    grid: AbstractGrid,
    inner: tuple[int, int, int, int],
    outer: tuple[int, int, int, int],
) -> tuple[np.ndarray, np.ndarray]:
    """(grey, known) of the image on the outer window, with the grid relative to it; rectified in the inner window
    only."""
    shape = outer[2] - outer[0], outer[3] - outer[1]
    time = None if isinstance(inputs.motion, Shot) else inputs.time
    rectifier = Rectifier(
        inputs.sensor, inputs.motion, images.grey, images.known, inputs.terrain, grid, time=time, atmosphere=inputs.air
    )
    grey, known = np.zeros(shape, np.float32), np.zeros(shape, bool)
    first, last = np.array(inner[:2]) - outer[:2], np.array(inner[2:]) - outer[:2]
    for row in range(int(first[0]), int(last[0]), TILE):
        for col in range(int(first[1]), int(last[1]), TILE):
            tile = rectifier.tile(row, col, (TILE, TILE))
            here = np.s_[row : min(row + TILE, shape[0]), col : min(col + TILE, shape[1])]
            cut = np.s_[: here[0].stop - row, : here[1].stop - col]
            grey[here], known[here] = tile.values[0][cut], tile.known[cut]
    return grey, known


@eqx.filter_jit
def _lat_lon(grid: AbstractGrid, places: Float[Array, "n 2"]) -> tuple[Array, Array]:
    def one(place: Float[Array, "2"]) -> tuple[Array, Array]:
        position = WGS84.to_geodetic(surface_point(grid.normal(place)))
        return jnp.asarray(position.lat), jnp.asarray(position.lon)

    return jax.vmap(one)(places)
