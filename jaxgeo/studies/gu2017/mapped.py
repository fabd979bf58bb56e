"""Image preparation as in the paper: rectified onto the map's cells and matched in blocks."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.observation import Exposure
from jaxgeo.ortho import Orthoimage, rectify
from jaxgeo.register import Matches, TiePoints, blocks_of, match_blocks, remove_illumination
from jaxgeo.register.choice import Chosen
from jaxgeo.register.prediction import Shifts, in_chunks, shifts_of
from jaxgeo.sensor import Shot
from jaxgeo.studies.gu2017.scene import Imaged, between
from jaxgeo.terrain.grid import AbstractGrid, surface_point
from jaxgeo.uncertainty import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

ASIDE = 1.0  # cells: standard deviation of block shifts from causes other than the navigation errors
LATTICE = 4  # points per block side, from which its true shift is computed


class Mapped(NamedTuple):
    """An image rectified from a `shot` with the given `errors`, on the cells of its map, with equalised brightness."""

    im: Imaged
    shot: Shot
    errors: ErrorModel
    ortho: Orthoimage
    grey: Float[np.ndarray, "rows cols"]
    reference: Float[np.ndarray, "rows cols"]

    def shifts(self, centres: np.ndarray, size: int) -> Shifts:
        """Shifts of blocks by the errors."""
        im = self.im
        inputs = ModelInputs(Exposure(im.sensor, self.shot, jnp.asarray(0.0)), terrain=im.terrain)
        return shifts_of(inputs, self.errors, im.reference.grid, centres, size / 2.0)


class Blocks(NamedTuple):
    """Blocks of a rectified image: their matches, their shifts by the errors, and the `true` shifts (n, 2) in cells,
    NaN if they do not exist or are unknown."""

    matches: Matches
    shifts: Shifts
    true: Float[np.ndarray, "n 2"]

    @property
    def jacobian(self) -> np.ndarray:
        """Derivatives of the shifts by the errors and the map's shift; zero for blocks that are not visible."""
        return np.where(np.asarray(self.shifts.visible)[:, None, None], np.asarray(self.shifts.by_error), 0.0)

    def is_off(self, shift: np.ndarray, cells: float = 3.0) -> Bool[np.ndarray, " n"]:
        """Whether shifts (n, 2) differ by more than `cells` cells from the true ones."""
        with np.errstate(invalid="ignore"):
            return np.linalg.norm(shift - self.true, axis=1) > cells


def mapped(im: Imaged, shot: Shot, errors: ErrorModel) -> Mapped:
    """Rectify an image from a shot with the elevation model."""
    grid, shape = im.reference.grid, im.reference.shape
    ortho = rectify(im.sensor, shot, im.image, im.terrain, grid, shape, known=im.known).orthoimage
    grey = np.asarray(remove_illumination(ortho.values[0], ortho.known, 31))
    known = np.asarray(im.reference.known)
    return Mapped(
        im, shot, errors, ortho, grey, np.asarray(remove_illumination(np.asarray(im.reference.grey()), known, 31))
    )


def blocks(
    here: Mapped,
    size: int,
    probability: float,
    covariance: Float[np.ndarray, "2 2"],
    above_chance: float = 1.0,
    *,
    peaks: int = 4,
    largest_sigma: float = 1.0,
) -> Blocks:
    """Blocks of `size` cells, searched inside the region that a `covariance` of their shifts, cells2, gives at a
    probability: one covariance for all, so that they share one compiled program. Candidates correlate `above_chance`
    times better than expected by chance (see `match_blocks`)."""
    centres = blocks_of(here.ortho.known, size)
    cov = np.broadcast_to(np.asarray(covariance, float), (len(centres), 2, 2))
    pair = here.grey, here.ortho.known, here.reference, np.asarray(here.im.reference.known)
    options: Any = {
        "size": size,
        "probability": probability,
        "above_chance": above_chance,
        "peaks": peaks,
        "largest_sigma": largest_sigma,
    }
    matches = match_blocks(*pair, centres, cov, **options)
    shifts = here.shifts(np.asarray(matches.centre), size)
    return Blocks(matches, shifts, _true(here, np.asarray(matches.centre), size))


def allowed(here: Mapped, size: int) -> Float[np.ndarray, "2 2"]:
    """The smallest multiple of the mean covariance of the blocks' shifts that is at least each block's, cells2."""
    found = here.shifts(blocks_of(here.ortho.known, size), size)
    cov = found.covariance(unknowns(here.errors))[np.asarray(found.visible)] + ASIDE**2 * np.eye(2)
    mean = np.mean(0.5 * (cov + np.swapaxes(cov, 1, 2)), axis=0)
    root = np.linalg.inv(np.linalg.cholesky(mean))
    return float(np.max(np.linalg.eigvalsh(root @ cov @ root.T))) * mean


def unknowns(errors: ErrorModel) -> np.ndarray:
    """Covariance of the errors and of the map's shift, which is known to be zero."""
    size = errors.size
    cov = np.zeros((size + 2, size + 2))
    cov[:size, :size] = errors.covariance()
    return cov


def ties_of(here: Mapped, found: Blocks, chosen: Chosen, size: int) -> TiePoints:
    """Tie points of the chosen blocks of `size` cells: their centre pixels, and the matching map positions."""
    kept = chosen.is_chosen & np.asarray(found.shifts.visible)
    there = (np.asarray(found.matches.centre) + chosen.of(found.matches.shift))[kept]
    metres = np.linalg.inv(np.asarray(found.shifts.cells_per_metre)[kept])
    cov = metres @ chosen.of(found.matches.covariance)[kept] @ np.swapaxes(metres, 1, 2)
    lat, lon = in_chunks(lambda part: _lat_lon(here.im.reference.grid, part), there)
    away = np.einsum("nij,nj->ni", metres, chosen.of(found.matches.shift)[kept])
    rise = np.asarray(found.shifts.rise)[kept]
    ground = Geodetic(lat=lat, lon=lon, height=np.asarray(found.shifts.height)[kept] + np.sum(rise * away, axis=1))
    uv, sides = np.asarray(found.shifts.uv)[kept], size * metres
    return TiePoints(uv, ground, 0.5 * (cov + np.swapaxes(cov, 1, 2)), rise=rise, sides=sides)


def _true(here: Mapped, centres: np.ndarray, size: int) -> np.ndarray:
    """True shifts (n, 2) in cells of the blocks, the medians over a lattice in each; NaN if unknown."""
    im = here.im
    if im.sight is None:
        return np.full((len(centres), 2), np.nan)
    steps = ((np.arange(LATTICE) + 0.5) / LATTICE - 0.5) * size
    lattice = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    places = (centres[:, None, :] + lattice[None, :, :]).reshape(-1, 2)
    on_map = np.clip(np.rint(places).astype(int), 0, np.array(here.ortho.shape) - 1)
    shown = here.ortho.known[on_map[:, 0], on_map[:, 1]]
    there = between(im.sight.places(im.reference.grid), np.asarray(here.shifts(places, 2).uv))
    away = np.where(shown[:, None], there - places, np.nan).reshape(len(centres), -1, 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # from blocks without visible ground
        return np.nanmedian(away, axis=1)


@eqx.filter_jit
def _lat_lon(grid: AbstractGrid, places: Any) -> tuple[Array, Array]:
    def one(place: Array) -> tuple[Array, Array]:
        position = WGS84.to_geodetic(surface_point(grid.normal(place)))
        return jnp.asarray(position.lat), jnp.asarray(position.lon)

    return jax.vmap(one)(places)
