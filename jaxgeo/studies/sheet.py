"""Tables of a study: each one list of rows, for the screen, for a spreadsheet and for a text."""

from __future__ import annotations

import csv
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TextIO

from rich import box
from rich.table import Table

Cell = str | int | float | None
WORDS = 24  # characters that a column of words needs at least, if it has so many


@dataclass(frozen=True)
class Sheet:
    """A table: `columns` with their formats (of `format`, "" for words), rows of cells, and a note on what they are."""

    name: str
    title: str
    columns: dict[str, str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    def texts(self) -> list[list[str]]:
        """The cells as they are shown; a number that there is not is a dash."""
        formats = list(self.columns.values())
        return [[_shown(cell, spec) for cell, spec in zip(row, formats, strict=True)] for row in self.rows]

    def to_rich(self, width: int) -> Table:
        """For a screen of so many characters. Numbers are never cut; where long remarks, the last column, would have no
        room beside them, they stand below."""
        names, rows = list(self.columns), self.texts()
        # Names of numbers stand in as many lines as they have words, those of words in one.
        heads = [name.replace(" ", "\n") if spec else name for name, spec in self.columns.items()]
        widths = [
            max(len(line) for cell in (head, *(row[i] for row in rows)) for line in cell.split("\n")) + 1
            for i, head in enumerate(heads)
        ]
        needed = [w if spec else min(w, WORDS) for w, spec in zip(widths, self.columns.values(), strict=True)]
        notes = [self.note] if self.note else []
        if widths[-1] > WORDS and not self.columns[names[-1]] and sum(needed) > width:
            said = [row[-1] for row in rows]
            rows = [[*row[:-1], str(i) if row[-1] else ""] for i, row in enumerate(rows, 1)]
            notes += [f"{i}: {remark}" for i, remark in enumerate(said, 1) if remark]
        table = Table(title=self.title, caption="\n".join(notes), box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.title_justify = table.caption_justify = "left"
        for head, spec in zip(heads, self.columns.values(), strict=True):
            table.add_column(head, justify="right" if spec else "left", no_wrap=bool(spec))
        for row in rows:
            table.add_row(*row)
        return table

    def to_markdown(self) -> str:
        """For a text."""
        head = [list(self.columns), ["---:" if spec else "---" for spec in self.columns.values()]]
        lines = ["| " + " | ".join(row) + " |" for row in head + self.texts()]
        return "\n".join([f"## {self.title}", "", *lines, "", self.note, ""])

    def write_csv(self, stream: TextIO) -> None:
        """For a spreadsheet, with all digits."""
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)


def write_sheets(title: str, sheets: Sequence[Sheet], folder: pathlib.Path, *, beside: Sequence[Sheet] = ()) -> None:
    """Every table as CSV, and all under a title as one Markdown text, into a folder that is there; those `beside` as
    CSV only."""
    for sheet in (*sheets, *beside):
        with (folder / f"{sheet.name}.csv").open("w", newline="", encoding="utf-8") as stream:
            sheet.write_csv(stream)
    text = f"# {title}\n\n" + "\n".join(sheet.to_markdown() for sheet in sheets)
    (folder / "tables.md").write_text(text, encoding="utf-8")


def _shown(cell: Cell, spec: str) -> str:
    if cell is None:
        return "–"
    return format(cell, spec) if spec else str(cell)
