"""Tables of a study: lists of rows, written to the terminal, CSV and Markdown."""

from __future__ import annotations

import csv
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TextIO

from rich import box
from rich.console import Group
from rich.table import Table

Cell = str | int | float | None
WORDS = 24  # minimum width in characters of a text column, if its text is that long


@dataclass(frozen=True)
class Sheet:
    """A table: `columns` with their formats (of `format`, "" for text), rows of cells, and an explanatory note."""

    name: str
    title: str
    columns: dict[str, str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    def texts(self) -> list[list[str]]:
        """The cells as text; missing numbers are dashes."""
        formats = list(self.columns.values())
        return [[_shown(cell, spec) for cell, spec in zip(row, formats, strict=True)] for row in self.rows]

    def to_rich(self, width: int) -> Table | Group:
        """Table for a terminal of `width` characters. Numbers and column names are never cut; if long remarks in the
        last column do not fit beside them, they go below, and columns that still do not fit follow in further tables,
        which repeat the first column."""
        names, specs, rows = list(self.columns), list(self.columns.values()), self.texts()
        notes = [self.note] if self.note else []
        cells = [max((len(row[i]) for row in rows), default=0) for i in range(len(names))]
        heads = ["\n".join(name.split()) if spec else name for name, spec in zip(names, specs, strict=True)]
        if not specs[-1] and cells[-1] > WORDS and _needed(heads, cells, specs) > width:
            notes += [f"{i}: {row[-1]}" for i, row in enumerate(rows, 1) if row[-1]]
            rows = [[*row[:-1], str(i) if row[-1] else ""] for i, row in enumerate(rows, 1)]
            heads[-1], cells[-1] = "", 2
        parts: list[list[int]] = [[0]]
        for i in range(1, len(names)):
            some = [*parts[-1], i]
            needed = _needed([heads[k] for k in some], [cells[k] for k in some], [specs[k] for k in some])
            if len(some) > 2 and needed > width:
                parts.append([0])
            parts[-1].append(i)
        tables = [Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)) for _ in parts]
        for table, part in zip(tables, parts, strict=True):
            for i in part:
                spec = specs[i]
                table.add_column(heads[i], justify="right" if spec else "left", no_wrap=bool(spec), overflow="fold")
            for row in rows:
                table.add_row(*(row[i] for i in part))
            table.title_justify = table.caption_justify = "left"
        tables[0].title, tables[-1].caption = self.title, "\n".join(notes)
        return tables[0] if len(tables) == 1 else Group(*tables)

    def to_markdown(self) -> str:
        """The table as Markdown."""
        head = [list(self.columns), ["---:" if spec else "---" for spec in self.columns.values()]]
        lines = ["| " + " | ".join(row) + " |" for row in head + self.texts()]
        return "\n".join([f"## {self.title}", "", *lines, "", self.note, ""])

    def write_csv(self, stream: TextIO) -> None:
        """Write the table as CSV, with all digits."""
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)


def write_sheets(title: str, sheets: Sequence[Sheet], folder: pathlib.Path, *, beside: Sequence[Sheet] = ()) -> None:
    """Write every table as CSV, and all under a title as one Markdown file, to an existing folder; those `beside` as
    CSV only."""
    for sheet in (*sheets, *beside):
        with (folder / f"{sheet.name}.csv").open("w", newline="", encoding="utf-8") as stream:
            sheet.write_csv(stream)
    text = f"# {title}\n\n" + "\n".join(sheet.to_markdown() for sheet in sheets)
    (folder / "tables.md").write_text(text, encoding="utf-8")


def _needed(heads: Sequence[str], cells: Sequence[int], specs: Sequence[str]) -> int:
    """Minimum width of a table in characters."""
    longest = [max(len(line) for line in head.split("\n")) for head in heads]
    widths = [max(cell, line) + 1 for cell, line in zip(cells, longest, strict=True)]
    return 2 + sum(w if spec else min(w, WORDS) for w, spec in zip(widths, specs, strict=True))


def _shown(cell: Cell, spec: str) -> str:
    if cell is None:
        return "–"
    return format(cell, spec) if spec else str(cell)
