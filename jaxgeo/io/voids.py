"""Detection of untagged voids among stored raster values, before scale and unit.

A value counts as a void, and is refused, if it is a usual void marker far from all other values; if single posts or
whole patches are far below or above every post around them; or if it is outside the range of heights on Earth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxgeo.io.errors import DemError
from jaxgeo.io.height_units import CHOICES

if TYPE_CHECKING:
    from jaxgeo.io.tiles import Tile

Stored = Any
"""A number of the dtype of the stored values."""
Nodata = float | int | Sequence[float | int] | None

USUAL_MARKS = (
    -32768, -32767, -9999, -9999.9, -9999.99, -9998, -10000, -999, -999.9, -99999, -99999.9, -999999, -8888,
    32767, 65535, 9999, 99999, 999999, -2147483648, -2147483647, 2147483647, 4294967295,
)  # fmt: skip
APART = 50.0  # m, and `ROUGH` times the usual step between neighbours: usual markers this far from others are voids
ROUGH = 3.0
PIT = 500.0  # m, and `STEEP` times the spacing of posts: posts this far below all neighbours are not ground
STEEP = 3.0
FARTHEST = 11_400.0  # m; limit of any height or depth, including the geoid undulation
LEAST_AROUND = 3  # minimum known neighbours of a pit
MOST_NAMED = 20
EARTH = 6.4e6  # m
ROWS = 256  # at once


def marks_of(name: str, nodata: Nodata) -> tuple[float, ...]:
    """The caller's void values. Raises `DemError` for anything but numbers."""
    given: Any = () if nodata is None else nodata if isinstance(nodata, list | tuple) else (nodata,)
    wrong = [one for one in given if isinstance(one, bool | str) or not isinstance(one, float | int | np.number)]
    if wrong:
        raise DemError(f"{name}: nodata={nodata!r} is no stored value; give a number, or several in a list.")
    return tuple(float(one) for one in given)


def marked(values: np.ndarray, nodata: float) -> np.ndarray:
    """Mask of values equal to `nodata`, rounded to their dtype."""
    if math.isnan(nodata):
        return np.isnan(values)
    mark = _as_stored(nodata, values.dtype)
    return np.zeros(values.shape, bool) if mark is None else values == mark


def check_untagged(tile: Tile, values: np.ndarray, void: np.ndarray, first: tuple[int, int], unit: float) -> None:
    """Raises `DemError` if stored values that are not `void` cannot be heights.

    `first` is the (row, col) of the first value in the file, `unit` m per unit of height.
    """
    metres = abs(tile.scale) * unit
    known = ~void
    if not known.any():
        return
    marks = _usual_marks(values, known, metres)
    if marks:
        raise _of_marks(tile, values, known, marks, first)
    _check_possible(tile, values, known, first, unit)
    depth = max(PIT, STEEP * _spacing(tile)) / metres
    pits = _single_pits(values, known, depth)
    pits |= _patch(values, known, depth, lowest=True) | _patch(values, known, depth, lowest=False)
    if pits.any():
        raise _of_pits(tile, values, pits, first, depth * metres)


def as_typed(value: Stored) -> str:
    """A stored value in its shortest decimal representation."""
    number = value.item() if isinstance(value, np.integer) else value
    text = str(np.asarray(number)[()]) if isinstance(number, np.floating) else repr(number)
    return text.removesuffix(".0")


def _as_stored(mark: float | int, dtype: np.dtype) -> Stored:
    """A number in the array's dtype; None if it cannot hold it."""
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return dtype.type(mark)
    limits = np.iinfo(dtype)
    return dtype.type(int(mark)) if mark == int(mark) and limits.min <= mark <= limits.max else None


def _extremes(values: np.ndarray, known: np.ndarray) -> tuple[Stored, Stored]:
    """The lowest and the highest known value, of which there is at least one."""
    found = []
    for top in range(0, len(values), ROWS):  # in chunks, since copying is many times faster than `where=`
        part, here = values[top : top + ROWS], known[top : top + ROWS]
        part = part if here.all() else part[here]
        if part.size:
            found += [part.min(), part.max()]
    return min(found), max(found)


def _usual_marks(values: np.ndarray, known: np.ndarray, metres: float) -> list[Stored]:
    """Stored values that are usual void markers far from all others, the farthest first."""
    usual = {mark for mark in (_as_stored(one, values.dtype) for one in USUAL_MARKS) if mark is not None}
    found: list[Stored] = []
    while True:
        low, high = _extremes(values, known)
        ends = [end for end in (low, high) if end in usual]
        taken = next((end for end in ends if _is_apart(values, known, end, metres)), None)
        if taken is None:
            return found
        found.append(taken)
        known = known & (values != taken)
        if not known.any():
            return found


def _is_apart(values: np.ndarray, known: np.ndarray, end: Stored, metres: float) -> bool:
    """Whether the lowest or highest value is far from all others."""
    others = known & (values != end)
    if not others.any():
        return True
    low, high = _extremes(values, others)
    gap = metres * min(abs(float(end) - float(low)), abs(float(end) - float(high)))
    return gap >= APART and gap >= ROUGH * metres * _usual_step(values, others)


def _usual_step(values: np.ndarray, known: np.ndarray) -> float:
    """The median difference between row neighbours, over at most some thousands of rows."""
    rows = slice(None, None, max(1, len(values) // 4000))
    some, both = values[rows].astype(np.float64), known[rows, 1:] & known[rows, :-1]
    steps = np.abs(np.diff(some, axis=1))[both]
    return float(np.median(steps)) if steps.size else 0.0


def _check_possible(tile: Tile, values: np.ndarray, known: np.ndarray, first: tuple[int, int], unit: float) -> None:
    low, high = _extremes(values, known)
    height = {end: (float(end) * tile.scale + tile.offset) * unit for end in (low, high)}
    end = max(height, key=lambda end: abs(height[end]))
    if abs(height[end]) <= FARTHEST:
        return
    here = known & (values == end)
    row, col = np.argwhere(here)[0]
    raise DemError(
        f"{tile.path}: at row {row + first[0]}, column {col + first[1]} (and {int(here.sum()) - 1} more) it stores "
        f"{as_typed(end)}, a height of {height[end]:.6g} m, which no place on the Earth has. If that marks a void, "
        f"pass nodata={as_typed(end)}; if the unit is another, pass {CHOICES}."
    )


def _single_pits(values: np.ndarray, known: np.ndarray, depth: float) -> np.ndarray:
    """Posts at least `depth` stored units below, or above, each known neighbour, of which there are at least three."""
    pits = np.zeros(values.shape, bool)
    for top in range(0, len(values), ROWS):
        part = np.s_[top : top + ROWS]
        steps = np.diff(values[part].astype(np.float64), axis=1)
        far = (np.abs(steps) >= depth) & known[part, 1:] & known[part, :-1]
        if far.any():
            for row, col in _alone(steps, far).tolist():
                pits[top + row, col] = _is_pit(values, known, top + row, col, depth)
    return pits


def _alone(steps: np.ndarray, far: np.ndarray) -> np.ndarray:
    """(row, col) of posts far from both row neighbours, on the same side; (n, 2)."""
    none = np.zeros((len(far), 1), bool)
    before, after = np.hstack([none, far]), np.hstack([far, none])
    sides = np.hstack([none, steps > 0.0]), np.hstack([steps < 0.0, none])
    edge = np.zeros_like(before)
    edge[:, [0, -1]] = True
    return np.argwhere((before & after & (sides[0] == sides[1])) | ((before | after) & edge))


def _is_pit(values: np.ndarray, known: np.ndarray, row: int, col: int, depth: float) -> bool:
    around = np.s_[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
    off = values[around][known[around]].astype(np.float64) - float(values[row, col])
    count = int((off != 0.0).sum())
    alone = count == off.size - 1 and count >= LEAST_AROUND
    return alone and (bool((off[off != 0.0] >= depth).all()) or bool((off[off != 0.0] <= -depth).all()))


def _patch(values: np.ndarray, known: np.ndarray, depth: float, *, lowest: bool) -> np.ndarray:
    """The posts that share the lowest (highest) value, if it is far from all others and they touch no edge."""
    low, high = _extremes(values, known)
    end = low if lowest else high
    none = np.zeros(values.shape, bool)
    if float(high) - float(low) < depth:
        return none
    here = known & (values == end)
    others = known & ~here
    if here[[0, -1]].any() or here[:, [0, -1]].any():
        return none
    low, high = _extremes(values, others)
    return here if abs(float(end) - float(low if lowest else high)) >= depth else none


def _spacing(tile: Tile) -> float:
    """m between posts, the larger of both directions."""
    a, b, _, d, e, _ = tile.affine[:6]
    step = max(math.hypot(a, d), math.hypot(b, e))
    return step * tile.map_unit * (EARTH if tile.is_geographic else 1.0)


def _of_marks(
    tile: Tile, values: np.ndarray, known: np.ndarray, marks: list[Stored], first: tuple[int, int]
) -> DemError:
    here = known & np.isin(values, marks)
    row, col = np.argwhere(here)[0] + first
    shown = " or ".join(as_typed(mark) for mark in marks)
    tag = "has no nodata tag for that" if tile.nodata is None else f"has no nodata tag for that ({tile.nodata:g} is it)"
    return DemError(
        f"{tile.path}: {int(here.sum())} posts, the first at row {row}, column {col}, are exactly {shown}, far from "
        f"all others: the usual mark of a void, and the file {tag}. Pass {_advice(marks)}."
    )


def _of_pits(tile: Tile, values: np.ndarray, pits: np.ndarray, first: tuple[int, int], depth: float) -> DemError:
    row, col = np.argwhere(pits)[0] + first
    held = list(np.unique(values[pits]))
    way_out = f"Pass {_advice(held)}" if len(held) <= MOST_NAMED else "Fill or mark them first (gdal_fillnodata)"
    return DemError(
        f"{tile.path}: {int(pits.sum())} posts, the first at row {row}, column {col}, where the file stores "
        f"{as_typed(held[0])}, lie more than {depth:.6g} m below or above every post around them: voids that no tag "
        f"marks, or faults. {way_out}, so that they are voids."
    )


def _advice(marks: list[Stored]) -> str:
    shown = [as_typed(mark) for mark in marks]
    return f"nodata={shown[0]}" if len(shown) == 1 else f"nodata=[{', '.join(shown)}]"
