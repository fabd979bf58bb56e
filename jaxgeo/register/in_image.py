"""Comparison in the image: the reference is rendered as the camera would see it."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.register._equations import on_surface
from jaxgeo.register.blocks import Matches
from jaxgeo.register.choice import Chosen
from jaxgeo.register.comparison import AbstractComparison, on_ground, tied
from jaxgeo.register.images import Images, RegistrationFailed
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.prediction import Shifts, in_chunks
from jaxgeo.register.render import met, seen_at
from jaxgeo.register.ties import TiePoints
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.status import Status
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

FLATTEST = 0.02  # of the larger scale on the ground, the smaller: beyond, a place on the map is not told by the image


class ImagePlace(NamedTuple):
    """Cells of `factor` pixels, the reference being `coarser` times as coarse as it is; `aside` (rows, cols) of these
    cells are looked at beside the image."""

    factor: int
    coarser: int
    aside: tuple[int, int]
    ground_sampling: float


class InImage(AbstractComparison):
    """For oblique images: an error of the attitude shifts and turns an image as a whole, whatever the relief, while on
    the map it would stretch it, and each slope by another amount. Only an error of the position shifts near ground
    otherwise than far ground.

    What the terrain hides is not rendered, so that it has no part. The tie of a block is the ground that the reference
    shows where the block's middle was found: by the look that it was rendered with it is imaged just there, be it
    before or behind an edge.
    """

    def __init__(self, look: ModelInputs, model: ErrorModel, images: Images, place: ImagePlace, block: int) -> None:
        del block
        self._look, self._model = look, model
        self._factor, (down, across) = place.factor, place.aside
        self._first = np.array([-down, -across])
        grey, known = images.shrunk(place.factor)
        rows, cols = known.shape
        inner = np.s_[down : down + rows, across : across + cols]
        shape = rows + 2 * down, cols + 2 * across
        self.grey, self.known = np.zeros(shape), np.zeros(shape, bool)
        self.grey[inner], self.known[inner] = images.even(grey, known), known
        cells = np.stack(np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij"), axis=-1)
        source = images.coarse(place.coarser)
        values, seen, status = seen_at(look, source, self._pixels(cells.reshape(-1, 2)))
        if not np.any(status == Status.hit):
            raise RegistrationFailed(Outcome.unknown_ground)
        if not seen.any():
            raise RegistrationFailed(Outcome.no_overlap)
        self.known_reference = seen.reshape(shape)
        self.reference = images.even(values[0].reshape(shape), self.known_reference)
        self.cell = place.ground_sampling * place.factor

    def shifts(self, places: np.ndarray, reach: float) -> Shifts:
        del reach
        return shifts_in_image(self._look, self._model, self._pixels(places), self._factor)

    def ties(self, matches: Matches, chosen: Chosen, shifts: Shifts) -> TiePoints:
        kept = tied(chosen, shifts)
        there = (np.asarray(matches.centre) + chosen.of(matches.shift))[kept]
        found, at = met(self._look, self._pixels(there)), self.shifts(there, 0.0)
        if np.any(found.status != Status.hit):
            raise RegistrationFailed(Outcome.unknown_ground)
        here = np.asarray(shifts.cells_per_metre)[kept]
        per_metre = np.where(np.asarray(at.seen)[:, None, None], np.asarray(at.cells_per_metre), here)
        ground = Geodetic(lat=found.lat, lon=found.lon, height=found.height)
        covariance = on_ground(chosen.of(matches.covariance)[kept], per_metre)
        return TiePoints(np.asarray(shifts.uv)[kept], ground, covariance)

    def _pixels(self, places: np.ndarray) -> np.ndarray:
        """Pixels (n, 2), (column, row), of places (row, col)."""
        return pixels_of(places + self._first[None, :], self._factor)


def pixels_of(places: np.ndarray, factor: int) -> np.ndarray:
    """Pixels (n, 2), (column, row), of places (row, col) in cells of so many pixels."""
    return (np.asarray(places, np.float64)[:, ::-1] + 0.5) * factor - 0.5


def shifts_in_image(look: ModelInputs, model: ErrorModel, uv: np.ndarray, factor: int) -> Shifts:
    """Shifts of what is seen at pixels (n, 2), in cells of `factor` pixels, on the facets that they see; pixels may lie
    beside the image."""
    ground = met(look, uv)
    rows = np.concatenate([uv, ground.p_ecef, ground.height[:, None], ground.cell], axis=1)
    found = Shifts(*in_chunks(lambda part: _shifts(look, model, part), rows))
    seen = found.seen & (ground.status == Status.hit)
    return found._replace(by_error=found.by_error / factor, cells_per_metre=found.cells_per_metre / factor, seen=seen)


@eqx.filter_jit
def _shifts(look: ModelInputs, model: ErrorModel, rows: Float[Array, "n 8"]) -> Shifts:
    """Of pixels, the points in ECEF m that they see, their heights and cells of the terrain."""

    def one(row: Float[Array, "8"]) -> tuple[Array, ...]:
        pixel, p_ecef, height, cell = row[:2], row[2:5], row[5], row[6:].astype(jnp.int32)
        R = R_ecef_from_enu(WGS84.to_geodetic(p_ecef))

        def image(error: Array, step: Array) -> Array:
            there = model.moved(look, error)
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
