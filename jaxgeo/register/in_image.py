"""Comparison in image space: the reference rendered into the camera."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import batch_filter_jit
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.ortho.rendering import met, seen_at
from jaxgeo.register._equations import on_surface
from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import Chosen
from jaxgeo.register.comparison import AbstractComparison, on_ground, tied
from jaxgeo.register.images import Images, RegistrationFailed
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.prediction import Shifts, in_chunks
from jaxgeo.register.ties import TiePoints
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.status import Status
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

FLATTEST = 0.02  # smaller over larger ground scale: below it, the image does not determine the map position


class ImagePlace(NamedTuple):
    """Cells of `factor` pixels and the reference reduced by `coarser`; `aside` (rows, cols) cells are added as a
    margin around the image."""

    factor: int
    coarser: int
    aside: tuple[int, int]
    ground_sampling: float


class InImage(AbstractComparison):
    """Comparison for oblique images. In image space an attitude error shifts and rotates the image as a whole, whatever
    the relief; on the map it would stretch it, by a different amount on each slope. Only a position error shifts near
    and far ground differently.

    Terrain occlusions are not rendered and so have no influence. The tie of a block is the reference ground at the
    matched position of the block's centre: the rendering orientation images it exactly there, in front of or behind an
    occluding edge.
    """

    def __init__(self, inputs: ModelInputs, model: ErrorModel, images: Images, place: ImagePlace, block: int) -> None:
        self._inputs, self._model, self.block = inputs, model, block
        self._factor, (down, across) = place.factor, place.aside
        self._first = np.array([-down, -across])
        grey, known = images.shrunk(place.factor)
        rows, cols = known.shape
        inner = np.s_[down : down + rows, across : across + cols]
        shape = rows + 2 * down, cols + 2 * across
        grey, known = images.compared(grey, known)
        self.grey, self.known = np.zeros((*grey.shape[:-2], *shape)), np.zeros(shape, bool)
        self.grey[(..., *inner)], self.known[inner] = grey, known
        cells = np.stack(np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij"), axis=-1)
        source = images.coarse(place.coarser)
        values, visible, status = seen_at(inputs, source, self._pixels(cells.reshape(-1, 2)))
        if not np.any(status == Status.hit):
            raise RegistrationFailed(Outcome.unknown_ground)
        if not visible.any():
            raise RegistrationFailed(Outcome.no_overlap)
        self.reference, self.known_reference = images.compared(values[0].reshape(shape), visible.reshape(shape))
        self.cell = place.ground_sampling * place.factor

    def shifts(self, places: np.ndarray, reach: float) -> Shifts:
        del reach
        return shifts_in_image(self._inputs, self._model, self._pixels(places), self._factor)

    def ties(self, matches: Matches, chosen: Chosen, shifts: Shifts) -> TiePoints:
        kept = tied(chosen, shifts)
        there = (np.asarray(matches.centre) + chosen.of(matches.shift))[kept]
        found, at = met(self._inputs, self._pixels(there)), self.shifts(there, 0.0)
        if np.any(found.status != Status.hit):
            raise RegistrationFailed(Outcome.unknown_ground)
        here = np.asarray(shifts.cells_per_metre)[kept]
        per_metre = np.where(np.asarray(at.visible)[:, None, None], np.asarray(at.cells_per_metre), here)
        ground = Geodetic(lat=found.lat, lon=found.lon, height=found.height)
        covariance = on_ground(chosen.of(matches.covariance)[kept], per_metre)
        return TiePoints(np.asarray(shifts.uv)[kept], ground, covariance, sides=self.sides(per_metre))

    def _pixels(self, places: np.ndarray) -> np.ndarray:
        """Pixels (n, 2), (column, row), of places (row, col)."""
        return pixels_of(places + self._first[None, :], self._factor)


def pixels_of(places: np.ndarray, factor: int) -> np.ndarray:
    """Pixels (n, 2), (column, row), of (row, col) in cells of `factor` pixels."""
    return (np.asarray(places, np.float64)[:, ::-1] + 0.5) * factor - 0.5


def shifts_in_image(inputs: ModelInputs, model: ErrorModel, uv: np.ndarray, factor: int) -> Shifts:
    """Shifts of the ground seen at pixels (n, 2), in cells of `factor` pixels, on the terrain facets hit; pixels may
    lie outside the image."""
    ground = met(inputs, uv)
    rows = np.concatenate([uv, ground.p_ecef, ground.height[:, None], ground.cell], axis=1)
    found = Shifts(*in_chunks(lambda part: _shifts(inputs, model, part), rows))
    visible = found.visible & (ground.status == Status.hit)
    return found._replace(
        by_error=found.by_error / factor, cells_per_metre=found.cells_per_metre / factor, visible=visible
    )


@batch_filter_jit
def _shifts(inputs: ModelInputs, model: ErrorModel, rows: Float[Array, "n 8"]) -> Shifts:
    """Shifts for rows of a pixel, the ECEF point in m that it sees, its height and its terrain cell."""

    def one(row: Float[Array, "8"]) -> tuple[Array, ...]:
        pixel, p_ecef, height, cell = row[:2], row[2:5], row[5], row[6:].astype(jnp.int32)
        R = R_ecef_from_enu(WGS84.to_geodetic(p_ecef))

        def image(error: Array, step: Array) -> Array:
            there = model.moved(inputs, error)
            on_terrain = on_surface(there.terrain, p_ecef + R[:, :2] @ step, cell)
            rowcol = image_of_point(there.sensor, there.motion, jnp.asarray(there.time), on_terrain, there.air)[0]
            return rowcol[::-1]

        by_error, along = jax.jacfwd(image, argnums=(0, 1))(jnp.zeros(model.size), jnp.zeros(2))
        squared, det = jnp.sum(along**2), jnp.abs(jnp.linalg.det(along))
        rest = jnp.sqrt(jnp.maximum(squared**2 - 4.0 * det**2, 0.0))
        larger, smaller = jnp.sqrt(0.5 * (squared + rest)), det / jnp.sqrt(jnp.maximum(0.5 * (squared + rest), 1e-300))
        sound = jnp.all(jnp.isfinite(by_error)) & (smaller > FLATTEST * larger)
        shift = jnp.concatenate([-by_error, along], axis=1)
        safe = jnp.where(sound, smaller, 1.0)
        return (
            pixel,
            shift,
            along,
            1.0 / jnp.sqrt(larger * safe),
            larger / safe,
            sound,
            height,
            jnp.zeros(2),
        )

    return Shifts(*jax.vmap(one)(rows))
