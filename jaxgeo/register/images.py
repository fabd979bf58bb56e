"""The image and the reference of a registration, in cells of any size."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from jaxgeo.register.flattening import flattened
from jaxgeo.register.orthoimage import Orthoimage
from jaxgeo.register.outcome import Outcome
from jaxgeo.terrain.grid import AbstractGrid


class Stopped(Exception):
    """A registration that cannot go on."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome.message)
        self.outcome = outcome


class Level(NamedTuple):
    """The reference in cells so many times as large: grey values, brightness made even, and where it is known."""

    grey: np.ndarray
    known: np.ndarray
    grid: AbstractGrid


class Images:
    """The image, grey (1, rows, cols), and the reference in cells of any size."""

    def __init__(self, grey: np.ndarray, known: Any, reference: Orthoimage, flatten: int | None) -> None:
        self.grey, self.known, self.reference, self.flatten = grey, known, reference, flatten
        self._coarse: dict[int, Orthoimage] = {}
        self._levels: dict[int, Level] = {}

    def coarse(self, factor: int) -> Orthoimage:
        """The whole reference, grey and made coarser by a factor."""
        if factor not in self._coarse:
            coarse = self.reference.coarser(factor)
            self._coarse[factor] = Orthoimage(np.asarray(coarse.grey())[None], coarse.known, coarse.grid)
        return self._coarse[factor]

    def level(self, factor: int) -> Level:
        """The whole reference, made coarser by a factor, brightness and contrast made even."""
        if factor not in self._levels:
            coarse = self.coarse(factor)
            known = np.asarray(coarse.known)
            self._levels[factor] = Level(self.even(np.asarray(coarse.values)[0], known), known, coarse.grid)
        return self._levels[factor]

    def shrunk(self, factor: int) -> tuple[np.ndarray, np.ndarray]:
        """(the image in pixels so many times as large, which of these are known wholly)."""
        known = np.all(np.isfinite(self.grey), axis=0)
        known = known if self.known is None else known & np.asarray(self.known, bool)
        rows, cols = (side // factor for side in known.shape)
        squares = (rows, factor, cols, factor)
        values = np.where(known, self.grey[0], 0.0)[: rows * factor, : cols * factor].astype(np.float64)
        whole = known[: rows * factor, : cols * factor].reshape(squares).all(axis=(1, 3))
        return values.reshape(squares).mean(axis=(1, 3)), whole

    def even(self, grey: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Grey values with brightness and contrast made even, if that is wanted."""
        if self.flatten is None:
            return np.asarray(grey, np.float64)
        return np.asarray(flattened(grey, known, self.flatten))
