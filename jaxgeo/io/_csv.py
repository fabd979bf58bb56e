"""CSV tables with validated columns: every error names the file, the row, the column and the reason."""

from __future__ import annotations

import difflib
import os
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo._text_numbers import BLANKS, no_number, number_in
from jaxgeo.io._dialect import layout_of
from jaxgeo.io._text import read_text
from jaxgeo.io.errors import TableError
from jaxgeo.io.limits import COLUMNS

Limits = tuple[float, float, str]  # lowest and highest value of a column, and its unit
Row = dict[str, Any]

# Columns of a pose.
POSE_COLUMNS: dict[str, Limits] = {
    "lat_deg": (-90.0, 90.0, "deg"),
    "lon_deg": (-360.0, 360.0, "deg"),
    "height_m": (-2000.0, 2_000_000.0, "m"),
    "heading_deg": (-360.0, 360.0, "deg"),
    "pitch_deg": (-90.0, 90.0, "deg"),
    "roll_deg": (-180.0, 180.0, "deg"),
}

ABOVE_TAKEOFF = "height_above_takeoff_m"  # of a camera, where the height of the take-off is unknown
NO_DATUM = (
    f" Its heights are in {ABOVE_TAKEOFF}, above no datum: add the height of the take-off above the WGS 84 ellipsoid, "
    "and name the column height_m."
)

# Markers of unknown values: words, and numbers that no column of this package can hold.
UNKNOWN_WORDS = frozenset({"", "nan", "na", "n/a", "#n/a", "none", "null", "nil", "unknown", "-", "--", "?"})
UNKNOWN_NUMBERS = frozenset({-9999.0, -99999.0, -999999.0, -32767.0, -32768.0})


CUT = "; the file ends within the row: copy or export it again, or delete the row"


def check_not_shares(path: Any, uv: np.ndarray) -> None:
    """Raises `TableError` for columns and rows of pixels (n, 2) that are shares of the image: between 0 and 1, some not
    whole."""
    known = uv[np.isfinite(uv)]
    if known.size and np.all((known >= 0.0) & (known <= 1.0)) and np.any(known != np.floor(known)):
        raise TableError(
            f"{path}: its columns and rows are from {known.min():g} to {known.max():g}, which look like shares of the "
            f"image; pixels are expected. Multiply columns by its width, rows by its height."
        )


@dataclass(frozen=True)
class CsvTable:
    """The header and rows of a CSV file, and the line in which each row ends; every row is complete.

    Cells are as written, but with decimal points; `comments` are the lines above that begin with #.
    """

    path: str | os.PathLike[str]
    header: list[str]
    lines: list[int]
    cells: list[list[str]]
    comments: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def rows(self) -> list[Row]:
        """Every row by column, as written."""
        return [dict(zip(self.header, row, strict=True)) for row in self.cells]

    def numbers(self, name: str, limits: Limits, *, unknown_too: bool = False) -> np.ndarray:
        """A column as floats; `unknown_too` reads unknown values (`nan`, an empty cell, -9999 and so on) as NaN.

        Raises `TableError` for a cell that is not a number, is unknown, or is outside the limits.
        """
        low, high, unit = limits
        index, values = self.header.index(name), np.empty(len(self))
        for i, row in enumerate(self.cells):
            cell = row[index].strip(BLANKS)
            values[i] = self._number(i, name, cell, unit, unknown_too=unknown_too)
            if values[i] < low or values[i] > high:
                raise self.wrong(i, name, f"{cell[:60]} is outside [{low:g}, {high:g}] {unit}.")
            if np.isnan(values[i]) and not unknown_too:
                raise self.wrong(i, name, f"unknown ({cell or 'empty'}); expected {unit}.")
        return values

    def _number(self, row: int, name: str, cell: str, unit: str, *, unknown_too: bool) -> float:
        """A cell as a number, NaN if it is a marker of an unknown value."""
        if cell.lower() in UNKNOWN_WORDS:
            return np.nan
        value = number_in(cell)
        if value is None:
            hint = f"expected {unit} (nan if unknown)." if unknown_too else f"expected {unit}."
            if "," in cell and any(mark.isdigit() for mark in cell):
                hint += (
                    " Decimals are read with commas if all of the file have them, and semicolons or tabs stand between "
                    "columns."
                )
            raise self.wrong(row, name, f"{no_number(cell)}; {hint}")
        return np.nan if value in UNKNOWN_NUMBERS else value

    def wrong(self, index: int, name: str, reason: str) -> TableError:
        """An error that names the cell."""
        return TableError(f"{self.path}, row {self.lines[index]}, column {name}: {reason}")


def gimbal_columns(readings: Iterable[str]) -> dict[str, Limits]:
    """The columns of a gimbal's readings, by their names from base to head."""
    return {f"gimbal_{name}_deg": (-360.0, 360.0, "deg") for name in readings}


def read_csv(
    path: str | os.PathLike[str],
    what: str,
    needed: Collection[str],
    *,
    taken: Collection[str] = (),
    hints: Mapping[str, str] | None = None,
    known: Collection[str] = (),
) -> CsvTable:
    """A table with validated columns and row lengths; blank rows and comments (#) are skipped.

    Columns are separated by commas, semicolons, tabs, bars or white space, decimals have points or commas, and the text
    is UTF-8, UTF-16 or Windows 1252: all detected from the content. `what` describes it in messages; `needed` are
    required columns, `taken` forbidden ones. `hints` are remedies for some missing columns;
    `known` are further names for recognising a header. Raises `TableError`, and `FileNotFoundError`.
    """
    text = read_text(path, what)
    layout = layout_of(path, text, {name.lower() for name in (*needed, *known)})
    header = layout.header
    _check_header(path, header, needed, taken, hints or {})
    if not layout.cells:
        raise TableError(f"{path}: no rows below the header.")
    for line, row in zip(layout.lines, layout.cells, strict=True):
        if [cell.strip() for cell in row] == [name.strip() for name in header]:
            raise TableError(f"{path}, row {line}: the header again: the file is several tables; give each alone.")
        if len(row) != len(header):
            is_cut = line == layout.lines[-1] and len(row) < len(header) and not text.endswith(("\n", "\r"))
            raise TableError(
                f"{path}, row {line}: {len(row)} {'words' if layout.separator == ' ' else 'cells'}, but the header has "
                f"{len(header)}{CUT if is_cut else _why_longer(layout.separator, len(row) > len(header))}."
            )
    return CsvTable(path, header, layout.lines, layout.cells, tuple(layout.comments))


def _why_longer(separator: str, longer: bool) -> str:
    if not longer or separator not in ", ":
        return ""
    if separator == " ":
        return "; names with white space need quotes"
    return "; if decimals are written with commas, put semicolons or tabs between the columns"


def _check_header(
    path: str | os.PathLike[str],
    header: list[str],
    needed: Collection[str],
    taken: Collection[str],
    hints: Mapping[str, str],
) -> None:
    COLUMNS.check(path, len(header))
    doubled = sorted(name for name, count in Counter(header).items() if count > 1)
    if doubled:
        raise TableError(f"{path}: column {doubled[0]} stands twice in the header.")
    missing = [name for name in needed if name not in header]
    if missing:
        advice = dict.fromkeys(f" {hints[name]}" for name in missing if name in hints)
        near = NO_DATUM if has_no_datum(missing, header) else _near_names(missing, header, needed)
        raise TableError(
            f"{path}: no column {', '.join(missing)}.{near}{''.join(advice)} "
            f"The columns needed are {', '.join(needed)}; found {', '.join(header) or 'none'}."
        )
    reserved = [name for name in taken if name in header]
    if reserved:
        raise TableError(f"{path}: column {reserved[0]} is one that the answer writes; rename it.")


def has_no_datum(missing: Collection[str], header: Collection[str]) -> bool:
    """Whether a missing column of heights is there as heights above the take-off."""
    return "height_m" in missing and ABOVE_TAKEOFF in header


def _near_names(missing: list[str], header: list[str], needed: Collection[str]) -> str:
    """A hint for each missing column that an unused one may stand for."""
    spare = {name.lower(): name for name in header if name not in needed}
    found = {name: difflib.get_close_matches(name, spare, n=1, cutoff=0.8) for name in missing}
    pairs = [f"{name} by {spare[near[0]]!r}" for name, near in found.items() if near]
    return f" Did you mean {', '.join(pairs)}? Rename the column; capitals matter." if pairs else ""
