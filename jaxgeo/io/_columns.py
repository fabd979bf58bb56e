"""Tables of other programs: columns under several names and in any case, between commas or white space."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from jaxgeo.io._csv import SEPARATORS, CsvTable, Limits, read_csv
from jaxgeo.io.errors import TableError

Aliases = Mapping[str, tuple[str, ...]]  # our name of a column: what else it is called


@dataclass(frozen=True)
class Columns:
    """A table, and what its columns are called in the file, by our names."""

    table: CsvTable
    called: dict[str, str]

    def __len__(self) -> int:
        return len(self.table)

    def __contains__(self, name: str) -> bool:
        return name in self.called

    def numbers(self, name: str, limits: Limits) -> np.ndarray:
        """A column as floats; raises as `CsvTable.numbers`."""
        return self.table.numbers(self.called[name], limits)

    def names(self, name: str) -> np.ndarray:
        """A column of names; raises as `names_of`."""
        return names_of(self.table, self.called[name])

    def require(self, names: Iterable[str], aliases: Aliases, why: str = "") -> None:
        """Raises `TableError` unless all columns are there; `why` is a sentence for the message."""
        missing = [name for name in names if name not in self.called]
        if missing:
            others = [f"{name} (or {', '.join(aliases[name])})" if aliases.get(name) else name for name in missing]
            found = ", ".join(self.table.header)
            hint = next((f" Columns separated by {shown} are not read." for mark, shown in SEPARATORS.items()
                         if mark in found), "")  # fmt: skip
            raise TableError(f"{self.table.path}: no column {', '.join(others)}; found {found}.{hint}{why}")


def read_columns(path: str | os.PathLike[str], what: str, aliases: Aliases) -> Columns:
    """A CSV file, or one with white space between its columns, where names in quotes may hold some.

    Capitals do not matter in the header. Columns that `aliases` do not name are passed over. Raises as `read_csv`, and
    `TableError` for two columns that mean the same.
    """
    first = _first_line(path)
    table = _read_words(path, what) if len(first.split()) > 1 and "," not in first else read_csv(path, what, ())
    meant = {other.lower(): name for name, others in aliases.items() for other in (name, *others)}
    called: dict[str, str] = {}
    for written in table.header:
        name = meant.get(written.lower())
        if name in called:
            raise TableError(f"{path}: columns {called[name]} and {written} both mean {name}; leave one out.")
        if name is not None:
            called[name] = written
    return Columns(table, called)


def names_of(table: CsvTable, column: str) -> np.ndarray:
    """A column as an array of names, white space around them taken off; raises `TableError` for an empty cell."""
    index = table.header.index(column)
    names = [row[index].strip() for row in table.cells]
    if "" in names:
        raise table.wrong(names.index(""), column, "the name is empty.")
    return np.array(names, dtype=str)


def refuse_doubles(table: CsvTable, keys: Iterable[object], what: str) -> None:
    """Raises `TableError` with both rows for a key that stands in two; `what` is said of it, `{}` is its name."""
    seen: dict[object, int] = {}
    for key, line in zip(keys, table.lines, strict=True):
        if key in seen:
            shown = key if isinstance(key, tuple) else (key,)
            raise TableError(f"{table.path}, rows {seen[key]} and {line}: {what.format(*shown)}; keep one of them.")
        seen[key] = line


def _first_line(path: str | os.PathLike[str]) -> str:
    """The first line that is not blank; empty where the file cannot be read, which reading it then tells."""
    try:
        with open(path, encoding="utf-8-sig") as file:
            return next((line for line in file if line.strip()), "")
    except (OSError, UnicodeDecodeError):
        return ""


def _read_words(path: str | os.PathLike[str], what: str) -> CsvTable:
    """A table with white space between columns; quotes, single or double, are those that words begin with."""
    try:
        with open(path, encoding="utf-8-sig") as file:
            lines = [(i, line.strip().replace("\t", " ")) for i, line in enumerate(file, start=1) if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: the {what} cannot be read: {error}.") from error
    quote = re.search(r"(?:^|\s)(['\"])", "\n".join(line for _, line in lines))
    quotechar = quote[1] if quote else '"'
    try:
        rows = csv.reader((line for _, line in lines), delimiter=" ", quotechar=quotechar, skipinitialspace=True)
        header, *cells = list(rows)
    except csv.Error as error:
        raise TableError(f"{path}: not a table of words in UTF-8: {error}.") from error
    if not cells:
        raise TableError(f"{path}: no rows below the header.")
    table = CsvTable(path, header, [i for i, _ in lines[1:]], cells)
    for line, row in zip(table.lines, cells, strict=True):
        if len(row) != len(header):
            raise TableError(
                f"{path}, row {line}: {len(row)} words, but the header has {len(header)}; names with white space need "
                f"quotes."
            )
    return table
