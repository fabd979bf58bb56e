"""Image and reference of a registration, resampled to cells of any size."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._record import portable
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.register.flattening import remove_illumination
from jaxgeo.register.gradient_orientation import check_measure, orientation_channels
from jaxgeo.register.outcome import Outcome
from jaxgeo.terrain.grid import AbstractGrid, surface_point


@portable
class RegistrationFailed(Exception):
    """Registration cannot continue; `outcome` is the reason."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome.message)
        self.outcome = outcome


class Level(NamedTuple):
    """The reference resampled by a factor: what is compared of it (see `Images.compared`), and its known cells."""

    grey: np.ndarray
    known: np.ndarray
    grid: AbstractGrid


class Images:
    """The image, grey (1, rows, cols), and the reference in cells of any size, corrected for a map `shift` to the
    east and north, m. `measure` is one of `MEASURES`."""

    def __init__(
        self, grey: np.ndarray, known: Any, reference: Orthoimage, flatten: int | None, measure: str = "grey"
    ) -> None:
        check_measure(measure)
        self.grey, self.known, self.flatten, self.measure = grey, known, flatten, measure
        self.shift = np.zeros(2)
        self._reference = reference
        self._coarse: dict[int, Orthoimage] = {}
        self._levels: dict[int, Level] = {}

    def less(self, shift: np.ndarray) -> Images:
        """The same images with another map shift."""
        moved = copy.copy(self)  # resampled levels are shared
        moved.shift = np.asarray(shift, np.float64)
        return moved

    @property
    def reference(self) -> Orthoimage:
        """The whole reference at its corrected position."""
        return self._placed(self._reference)

    def _placed(self, given: Any) -> Any:
        """An orthoimage or level with its grid corrected for the shift."""
        if not np.any(self.shift):
            return given
        middle = 0.5 * (np.array(np.shape(given.known)) - 1.0)
        row, col = np.asarray(_cells_of(given.grid, jnp.asarray(middle), jnp.asarray(self.shift)))
        grid = given.grid.window(-row, -col)
        return given._replace(grid=grid) if isinstance(given, Level) else Orthoimage(given.values, given.known, grid)

    def coarse(self, factor: int) -> Orthoimage:
        """The whole reference, grey, reduced by a factor."""
        return self._placed(self._coarser(factor))

    def _coarser(self, factor: int) -> Orthoimage:
        if factor not in self._coarse:
            coarse = self._reference.coarser(factor)
            self._coarse[factor] = Orthoimage(np.asarray(coarse.grey())[None], coarse.known, coarse.grid)
        return self._coarse[factor]

    def level(self, factor: int) -> Level:
        """The whole reference, reduced by a factor, as it is compared."""
        if factor not in self._levels:
            coarse = self._coarser(factor)
            known = np.asarray(coarse.known)
            self._levels[factor] = Level(*self.compared(np.asarray(coarse.values)[0], known), coarse.grid)
        return self._placed(self._levels[factor])

    def shrunk(self, factor: int) -> tuple[np.ndarray, np.ndarray]:
        """(the image reduced by a factor, mask of pixels that are fully known)."""
        known = np.all(np.isfinite(self.grey), axis=0)
        known = known if self.known is None else known & np.asarray(self.known, bool)
        rows, cols = (side // factor for side in known.shape)
        squares = (rows, factor, cols, factor)
        values = np.where(known, self.grey[0], 0.0)[: rows * factor, : cols * factor].astype(np.float64)
        whole = known[: rows * factor, : cols * factor].reshape(squares).all(axis=(1, 3))
        return values.reshape(squares).mean(axis=(1, 3)), whole

    def compared(self, grey: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(values that are compared, their known cells): grey values, locally normalised if requested, or the channels
        of the orientation."""
        if self.measure == "orientation":
            return orientation_channels(grey, known)
        if self.flatten is None:
            return np.asarray(grey, np.float64), known
        return np.asarray(remove_illumination(grey, known, self.flatten)), known


@eqx.filter_jit
def _cells_of(grid: AbstractGrid, rowcol: Float[Array, "2"], enu: Float[Array, "2"]) -> Float[Array, "2"]:
    """Step in rows and columns of a grid for a step on the ground, east and north in m."""
    p_ecef = surface_point(grid.normal(rowcol))
    moved = p_ecef + R_ecef_from_enu(WGS84.to_geodetic(p_ecef))[:, :2] @ enu
    return grid.rowcol(WGS84.normal_and_height(moved)[0]) - rowcol
