"""Tables of other programs: case-insensitive columns with aliases, separated by commas or white space."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from jaxgeo._text_numbers import number_in
from jaxgeo.io._csv import NO_DATUM, CsvTable, Limits, has_no_datum, read_csv
from jaxgeo.io.errors import TableError

OUR_UNITS = re.compile(r"\s*[\[(](?:deg|degrees?|°|m|met(?:er|re)s?)[\])]$")  # after a name, in lower case
Aliases = Mapping[str, tuple[str, ...]]  # our column name: its aliases


SHOWN = 2  # aliases shown in a message


@dataclass(frozen=True)
class Columns:
    """A table, and the file's column names by our names; `notes` are sentences on the layout of its file."""

    table: CsvTable
    called: dict[str, str]
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.table)

    def __contains__(self, name: str) -> bool:
        return name in self.called

    def numbers(self, name: str, limits: Limits, *, unknown_too: bool = False) -> np.ndarray:
        """A column as floats; raises as `CsvTable.numbers`."""
        return self.table.numbers(self.called[name], limits, unknown_too=unknown_too)

    def names(self, name: str) -> np.ndarray:
        """A column of names; raises as `names_of`."""
        return names_of(self.table, self.called[name])

    def require(self, names: Iterable[str], aliases: Aliases, why: str = "") -> None:
        """Raises `TableError` unless all columns are present; `why` is a sentence for the message."""
        missing = [name for name in names if name not in self.called]
        if missing:
            others = [
                f"{name} (or {', '.join(aliases[name][:SHOWN])})" if aliases.get(name) else name for name in missing
            ]
            if any(number_in(cell) is not None for cell in self.table.header):
                why += " The first row holds numbers: write the names of the columns above it."
            why += NO_DATUM if has_no_datum(missing, self.table.header) else ""
            raise TableError(
                f"{self.table.path}: no column {', '.join(others)}; found {', '.join(self.table.header)}.{why}"
            )


def read_columns(path: str | os.PathLike[str], what: str, aliases: Aliases, *, weak: Aliases | None = None) -> Columns:
    """A table with column aliases, of any layout that `read_csv` detects; quoted names may contain blanks.

    The header is case-insensitive, and units of ours after a name, "Yaw [deg]", are ignored. Columns that are not in
    `aliases` are ignored; those in `weak` are used if no other column has the same meaning. Raises as `read_csv`,
    and `TableError` for two columns of the same meaning.
    """
    meant = {other.lower(): name for name, others in aliases.items() for other in (name, *others)}
    weakly = {other.lower(): name for name, others in (weak or {}).items() for other in others}
    table = read_csv(path, what, (), known={*meant, *weakly})
    called: dict[str, str] = {}
    for written in table.header:
        name = meant.get(written.lower()) or meant.get(OUR_UNITS.sub("", written.lower()))
        if name in called:
            raise TableError(f"{path}: columns {called[name]} and {written} both mean {name}; leave one out.")
        if name is not None:
            called[name] = written
    for written in table.header:
        name = weakly.get(written.lower())
        if name is not None and name not in called:
            called[name] = written
    return Columns(table, called)


def names_of(table: CsvTable, column: str) -> np.ndarray:
    """A column as an array of names, without surrounding white space; raises `TableError` for an empty cell."""
    index = table.header.index(column)
    names = [row[index].strip() for row in table.cells]
    if "" in names:
        raise table.wrong(names.index(""), column, "the name is empty.")
    return np.array(names, dtype=str)


def refuse_doubles(table: CsvTable, keys: Iterable[object], what: str) -> None:
    """Raises `TableError` with both rows for a repeated key; `what` is the message, with `{}` for the key."""
    seen: dict[object, int] = {}
    for key, line in zip(keys, table.lines, strict=True):
        if key in seen:
            shown = key if isinstance(key, tuple) else (key,)
            raise TableError(f"{table.path}, rows {seen[key]} and {line}: {what.format(*shown)}; keep one of them.")
        seen[key] = line


def refuse_nowhere(table: CsvTable, column: str, lat: np.ndarray, lon: np.ndarray) -> None:
    """Raises `TableError` for a row whose latitude and longitude are zero, as written by GPS without a position."""
    nowhere = (lat == 0.0) & (lon == 0.0)
    if np.any(nowhere):
        reason = "latitude and longitude are zero, which is written where GPS has no position; take the row out."
        raise table.wrong(int(np.argmax(nowhere)), column, reason)
