"""CSV files whose columns are checked: every refusal names the file, the row, the column and the reason."""

from __future__ import annotations

import csv
import difflib
import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.io.errors import TableError

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

SEPARATORS = {";": "';'", "\t": "tabs", "|": "'|'"}  # that other programs write, and their names in a message


@dataclass(frozen=True)
class CsvTable:
    """The header and the rows of a CSV file as written, and the line that each row ends in; every row is complete."""

    path: str | os.PathLike[str]
    header: list[str]
    lines: list[int]
    cells: list[list[str]]

    def __len__(self) -> int:
        return len(self.cells)

    @property
    def rows(self) -> list[Row]:
        """Every row by column, as it was written."""
        return [dict(zip(self.header, row, strict=True)) for row in self.cells]

    def numbers(self, name: str, limits: Limits, *, unknown_too: bool = False) -> np.ndarray:
        """A column as floats; `unknown_too` lets `nan` pass.

        Raises `TableError` for a cell that is no number or lies outside the limits.
        """
        low, high, unit = limits
        index, values = self.header.index(name), np.empty(len(self))
        for i, row in enumerate(self.cells):
            try:
                values[i] = float(row[index])
            except ValueError:
                hint = f"expected {unit} (nan if unknown)" if unknown_too else f"expected {unit}"
                raise self.wrong(i, name, f"{row[index]!r} is not a number; {hint}.") from None
            if values[i] < low or values[i] > high:
                raise self.wrong(i, name, f"{row[index].strip()} is outside [{low:g}, {high:g}] {unit}.")
            if np.isnan(values[i]) and not unknown_too:
                raise self.wrong(i, name, f"unknown ({row[index].strip()}); expected {unit}.")
        return values

    def wrong(self, index: int, name: str, reason: str) -> TableError:
        """The error of a cell."""
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
) -> CsvTable:
    """A CSV file with commas in UTF-8, its columns and the lengths of its rows checked; blank rows are skipped.

    `what` it is, for messages; `needed` are columns that it must have, `taken` those that it may not. `hints` say for
    some columns what to do where they are missing. Raises `TableError`, and `FileNotFoundError`.
    """
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, strict=True)
            header = [name.strip() for name in next(reader, [])]
            _check_header(path, header, needed, taken, hints or {})
            found = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such {what}.") from None
    except IsADirectoryError:
        raise TableError(f"{path}: this is a folder; give the CSV file in it.") from None
    except OSError as error:
        raise TableError(f"{path}: the {what} cannot be read: {error.strerror}.") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise TableError(f"{path}: not a CSV file in UTF-8: {error}.") from error
    if not found:
        raise TableError(f"{path}: no rows below the header.")
    for line, row in found:
        if len(row) != len(header):
            raise TableError(f"{path}, row {line}: {len(row)} cells, but the header has {len(header)}.")
    return CsvTable(path, header, [line for line, _ in found], [row for _, row in found])


def _check_header(
    path: str | os.PathLike[str],
    header: list[str],
    needed: Collection[str],
    taken: Collection[str],
    hints: Mapping[str, str],
) -> None:
    doubled = sorted({name for name in header if header.count(name) > 1})
    if doubled:
        raise TableError(f"{path}: column {doubled[0]} stands twice in the header.")
    missing = [name for name in needed if name not in header]
    if missing:
        _check_separator(path, header, needed)
        advice = dict.fromkeys(f" {hints[name]}" for name in missing if name in hints)
        raise TableError(
            f"{path}: no column {', '.join(missing)}.{_near_names(missing, header, needed)}{''.join(advice)} "
            f"The columns needed are {', '.join(needed)}; found {', '.join(header) or 'none'}."
        )
    reserved = [name for name in taken if name in header]
    if reserved:
        raise TableError(f"{path}: column {reserved[0]} is one that the answer writes; rename it.")


def _check_separator(path: str | os.PathLike[str], header: list[str], needed: Collection[str]) -> None:
    for separator, shown in SEPARATORS.items():
        names = {name.strip(" \"'").lower() for name in ",".join(header).split(separator)}
        if len(names & set(needed)) > 1:
            raise TableError(
                f"{path}: the columns are separated by {shown}; use commas between columns, and points in decimals."
            )


def _near_names(missing: list[str], header: list[str], needed: Collection[str]) -> str:
    """A question for each missing column that another one, which nobody asks for, may stand for."""
    spare = {name.lower(): name for name in header if name not in needed}
    found = {name: difflib.get_close_matches(name, spare, n=1, cutoff=0.8) for name in missing}
    pairs = [f"{name} by {spare[near[0]]!r}" for name, near in found.items() if near]
    return f" Did you mean {', '.join(pairs)}? Rename the column; capitals matter." if pairs else ""
