"""Shifts between parts of two pictures, in NumPy: windowed phase correlation with an upsampled peak.

Guizar-Sicairos, Thurman and Fienup (2008), "Efficient subpixel image registration algorithms"; the spectrum is whitened
partly, because pictures with different sampling agree only in their coarser detail.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

MARGIN = 8  # largest shift of a tile, cells
FINEST = 0.25  # cycles per cell
STEPS = (1.5 * np.arange(-50, 51) / 50, 0.03 * np.arange(-10, 11) / 10)  # cells about the peak: 0.003 in the end
ROUNDS = 3


class Shifts(NamedTuple):
    """Tile shifts (row, col) in cells of the second picture against the first, their correlation coefficients after
    the shift is removed, and the tile centres, (row, col)."""

    shift: np.ndarray
    likeness: np.ndarray
    middle: np.ndarray

    def of(self, chosen: np.ndarray) -> Shifts:
        return Shifts(*(x[chosen] for x in self))


def shifts_of_tiles(a: np.ndarray, b: np.ndarray, known: np.ndarray, side: int, step: int) -> Shifts:
    """Shifts of all tiles, `step` apart, that are fully known, including a border of `MARGIN`."""
    found, whole = [], side + 2 * MARGIN
    for row in range(0, a.shape[0] - whole + 1, step):
        for col in range(0, a.shape[1] - whole + 1, step):
            here = np.s_[row : row + whole, col : col + whole]
            told = shift_between(a[here], b[here]) if known[here].all() else None
            if told is not None:
                found.append((*told, (row + whole / 2 - 0.5, col + whole / 2 - 0.5)))
    shift, likeness, middle = zip(*found, strict=True)
    return Shifts(np.array(shift), np.array(likeness), np.array(middle))


def shift_between(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, float] | None:
    """((row, col) shift of b against a, correlation coefficient with it removed) of the centres of two squares; None
    if it exceeds `MARGIN`. The second is cut again at the matched position, to avoid bias by the window."""
    side = a.shape[0] - 2 * MARGIN
    frequency = np.fft.fftfreq(side)
    kept = np.hypot(frequency[:, None], frequency[None, :]) < FINEST
    A, start, place = _spectrum(a, MARGIN, MARGIN, side), np.zeros(2, int), np.zeros(2)
    for turn in range(ROUNDS):
        if np.any(np.abs(start) > MARGIN):
            return None
        B = _spectrum(b, *(MARGIN + start), side)
        power = np.where(kept, B * np.conj(A), 0.0)
        power = power / np.sqrt(np.maximum(np.abs(power), 1e-12))
        place = _peak(power, frequency, is_first=turn == 0)
        nearest = np.rint(start + place).astype(int)
        if np.array_equal(nearest, start):
            break
        if turn < ROUNDS - 1:
            start = nearest
    shifted = np.exp(2j * np.pi * (place[0] * frequency[:, None] + place[1] * frequency[None, :]))
    together = float(np.sum(np.real(B * shifted * np.conj(A))[kept]))
    alone = float(np.sqrt(np.sum(np.abs(A[kept]) ** 2) * np.sum(np.abs(B[kept]) ** 2)))
    return start + place, together / max(alone, 1e-9)


def _spectrum(picture: np.ndarray, row: int, col: int, side: int) -> np.ndarray:
    line = np.hanning(side + 2)[1:-1]
    window = line[:, None] * line[None, :]
    part = picture[row : row + side, col : col + side]
    return np.fft.fft2((part - np.sum(part * window) / np.sum(window)) * window)


def _peak(power: np.ndarray, frequency: np.ndarray, is_first: bool) -> np.ndarray:
    """(row, col) of the maximum of a spectrum's transform: anywhere if `is_first`, else near zero."""
    place = np.zeros(2)
    if is_first:
        coarse = np.real(np.fft.ifft2(power))
        place = np.array(np.unravel_index(np.argmax(coarse), coarse.shape), float)
        place = np.where(place > len(frequency) / 2, place - len(frequency), place)
    for steps in STEPS:
        by_row, by_col = (np.exp(2j * np.pi * np.outer(at + steps, frequency)) for at in place)
        near = np.real(by_row @ power @ by_col.T)
        place = place + steps[np.array(np.unravel_index(np.argmax(near), near.shape))]
    return place
