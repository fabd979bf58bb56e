"""Orientations of the aerial triangulation programs PAT-B and BINGO, as a table of positions and angles in a map.

- PAT-B (Inpho), the file of orientations (`.ori`), as in PCI Geomatics, "Using Pat-B in OrthoEngine": of each image
  its number, 16 blank columns, X, Y and Z of the projection centre (I16, 16X, 3F16.5), and nine elements of its
  rotation matrix, row by row, in lines of five and four (F16.12). Numbers are read between blanks. Names of images for
  numbers, a focal length in the blank columns (not read) and lines of three elements are read, too. The matrix is
  taken to be R_map_from_image, from image axes (x right, y up, z out of the scene) to easting, northing and height.
- BINGO (Kruck, GIP), records ORIA of `itera.dat`: image, X, Y, Z, phi, omega, kappa in gon, and words that are not
  read. R_map_from_image = Ry(phi) Rx(omega) Rz(kappa). Layout and rotation as in S. Turek, "Implementation of bundle
  block adjustment method for determination of exterior orientation into GRASS GIS" (CTU in Prague, 2014), which
  compares with orientations of BINGO. Other records and comments (lines that begin with `*` or `C `) are not read.

Lists of image, X, Y, Z and three angles without the names of their columns are not read: neither the unit nor the order
of the angles is in them.
"""

from __future__ import annotations

import os

import numpy as np

from jaxgeo._text_numbers import number_in, numbers_in, words_of
from jaxgeo.io._columns import Columns
from jaxgeo.io._csv import CsvTable
from jaxgeo.io._json import shown
from jaxgeo.io._rotations import rotation_near
from jaxgeo.io._text import read_text
from jaxgeo.io.errors import TableError
from jaxgeo.rotations import omega_phi_kappa_from_R

PATB, BINGO = "PAT-B", "BINGO"
HEADER = ("image", "x_m", "y_m", "z_m", "omega_deg", "phi_deg", "kappa_deg")
FIRST = 65_536  # characters looked at for the program
FIRST_LINES = 60  # at which a record of PAT-B is looked for
ORIA = "ORIA"  # begins BINGO's record of an orientation
ELEMENT = 1.0 + 1e-3  # largest element of a rotation matrix, rounded
HALF_TURN = 200.0  # gon
TURN = 400.0  # gon
OF_PATB = (
    "The rotation matrices of PAT-B are taken to turn image axes (right, up and out of the scene) into those of the "
    "map."
)
NO_FOCAL = "Focal lengths in the file are not read: it does not say how large the images are."
OF_BINGO = (
    "Angles of BINGO are taken as phi, omega and kappa in gon: Ry(phi) Rx(omega) Rz(kappa) turns image axes (right, up "
    "and out of the scene) into those of the map."
)

Line = tuple[int, list[str]]  # number of a line, from 1, and its words


def program_of(text: str) -> str | None:
    """The program, PAT-B or BINGO, whose orientations the first lines of a file are; None for other files."""
    lines = _lines(text)
    if any(words[0].upper() == ORIA and len(words) >= 8 and numbers_in(words[2:8]) for _, words in lines):
        return BINGO
    if lines and _begins_with_patb(lines):
        return PATB
    starts = range(min(len(lines), FIRST_LINES))
    return PATB if any(_is_whole_record(lines[k : k + 4]) for k in starts) else None


def _begins_with_patb(lines: list[Line]) -> bool:
    """Whether the first lines are PAT-B's of an image, perhaps cut off or with a number that is damaged or missing."""
    if not _is_first_record(lines[0][1]):
        return False
    elements: list[float] = []
    for _, words in lines[1:4]:
        numbers = numbers_in(words)
        if numbers is None or max(map(abs, numbers)) > ELEMENT:
            return len(elements) == 5  # a damaged second line
        elements += numbers
        if len(elements) >= 9:
            break
    if len(elements) in (3, 5, 6, 9):  # fewer than 9: the file was cut off
        return True
    position = numbers_in(lines[0][1][-3:]) or [0.0]  # of one image, whose matrix lacks an element or two
    return len(lines) == 3 and len(elements) in (7, 8) and max(map(abs, position)) > ELEMENT


def _is_whole_record(lines: list[Line]) -> bool:
    """Whether lines begin with PAT-B's of an image, whose matrix is a rotation: one in the file is enough, as records
    before it may lack a number."""
    if len(lines) < 3 or not _is_first_record(lines[0][1]):
        return False
    elements: list[float] = []
    for _, words in lines[1:]:
        if len(elements) < 9:
            elements += numbers_in(words) or [np.inf]
    if len(elements) != 9 or max(map(abs, elements)) > ELEMENT:
        return False
    R = np.reshape(elements, (3, 3))
    return bool(np.max(np.abs(R @ R.T - np.eye(3))) < ELEMENT - 1.0)


def read_triangulation(path: str | os.PathLike[str], what: str) -> Columns | None:
    """The columns image, x_m, y_m, z_m, omega_deg, phi_deg, kappa_deg of a file of PAT-B or BINGO; None for others.

    Raises `TableError` with the row for records that are incomplete, numbers that are none, and a matrix that is no
    rotation; `FileNotFoundError`.
    """
    text = read_text(path, what)
    program = program_of(text[:FIRST])
    if program is None:
        return None
    records, notes = (_of_patb if program == PATB else _of_bingo)(path, _lines(text))
    numbers, names, centres, rotations = zip(*records, strict=True)
    angles = np.rad2deg(omega_phi_kappa_from_R(np.array(rotations)))
    cells = [
        [name, *(repr(float(one)) for one in (*centre, *turn))]
        for name, centre, turn in zip(names, centres, angles, strict=True)
    ]
    return Columns(CsvTable(path, [*HEADER], [*numbers], cells), {name: name for name in HEADER}, notes)


Record = tuple[int, str, list[float], np.ndarray]  # row, image, X, Y and Z in m, R_map_from_image


def _of_patb(path: object, lines: list[Line]) -> tuple[list[Record], tuple[str, ...]]:
    records: list[Record] = []
    has_focal = False
    k = 0
    while k < len(lines):
        row, words = lines[k]
        if not _is_first_record(words):
            raise TableError(
                f"{path}, row {row}: PAT-B: expected an image, X, Y and Z, with a focal length before X or not; got "
                f"{shown(' '.join(words)[:80])}."
            )
        elements: list[float] = []
        k += 1
        while len(elements) < 9:
            if k == len(lines):
                raise TableError(f"{path}: the file ends within the rotation matrix of image {words[0]} (row {row}); "
                                 f"copy or export it again.")  # fmt: skip
            at, cells = lines[k]
            more = numbers_in(cells)
            is_next = more is not None and _is_first_record(cells) and max(map(abs, more)) > ELEMENT
            if more is None or is_next or len(elements) + len(more) > 9:
                raise TableError(
                    f"{path}, row {at}: PAT-B: expected {9 - len(elements)} more elements of the rotation matrix of "
                    f"image {words[0]} (row {row}); got {shown(' '.join(cells)[:80])}."
                )
            elements += more
            k += 1
        R = rotation_near(f"{path}, row {row}, rotation matrix of image {words[0]}", np.reshape(elements, (3, 3)))
        records.append((row, words[0], [float(one) for one in words[-3:]], R))
        has_focal |= len(words) == 5
    return records, (OF_PATB, NO_FOCAL) if has_focal else (OF_PATB,)


def _of_bingo(path: object, lines: list[Line]) -> tuple[list[Record], tuple[str, ...]]:
    records: list[Record] = []
    for row, words in lines:
        if words[0].upper() != ORIA:
            continue
        numbers = numbers_in(words[2:8])
        if len(words) < 8 or numbers is None:
            raise TableError(f"{path}, row {row}: expected ORIA, an image, X, Y, Z, phi, omega and kappa; got "
                             f"{shown(' '.join(words)[:80])}.")  # fmt: skip
        large = next((angle for angle in numbers[3:] if abs(angle) > TURN), None)
        if large is not None:
            raise TableError(f"{path}, row {row}: the angle {large:g} of image {words[1]} is outside [-400, 400] gon.")
        phi, omega, kappa = (np.pi / HALF_TURN * angle for angle in numbers[3:])
        R = _about(1, phi) @ _about(0, omega) @ _about(2, kappa)
        records.append((row, words[1], numbers[:3], R))
    return records, (OF_BINGO,)


def _lines(text: str) -> list[Line]:
    """The lines that are not blank, in words."""
    return [(number, words_of(line)) for number, line in enumerate(text.splitlines(), 1) if words_of(line)]


def _is_first_record(words: list[str]) -> bool:
    """Whether a line is PAT-B's first of an image: its name, a focal length or none, and its position."""
    if len(words) not in (4, 5) or numbers_in(words[1:]) is None:
        return False
    return len(words) == 4 or (number_in(words[1]) or 0.0) > 0.0


def _about(axis: int, angle: float) -> np.ndarray:
    """Rotation (3, 3) about an axis by an angle in rad."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[[one, other], [one, other]] = np.cos(angle)
    R[one, other], R[other, one] = -np.sin(angle), np.sin(angle)
    return R
