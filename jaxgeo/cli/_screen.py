"""Terminal output: messages, progress and status counts on stderr, tables of fixes."""

from __future__ import annotations

import contextlib
import contextvars
import dataclasses
import pathlib
import sys
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from rich import box
from rich.cells import cell_len
from rich.console import Console as AnyConsole
from rich.console import ConsoleOptions
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from jaxgeo._destination import is_device
from jaxgeo.cli._console import Console

Item = TypeVar("Item")
_quiet: contextvars.ContextVar[bool] = contextvars.ContextVar("quiet", default=False)


def print_message(message: str) -> None:
    """Print a message on stderr, each line prefixed with `jaxgeo:`."""
    text = "\n".join(f"jaxgeo: {line}" for line in message.splitlines())
    stderr().print(text, markup=False, highlight=False, soft_wrap=True)


def print_note(message: str) -> None:
    """`print_message` of what is not an error; nothing with --quiet."""
    if not _quiet.get():
        print_message(message)


def print_written(*places: Any) -> None:
    """Print a note for each file or folder that was written; not for the screen and for devices."""
    for place in places:
        if place is not None and not is_device(pathlib.Path(place)):
            print_note(f"written: {place}")


def set_quiet(is_quiet: bool) -> None:
    """Whether notes, progress and counts are left out, from here on."""
    _quiet.set(is_quiet)


def is_quiet() -> bool:
    """Whether notes, progress and counts are left out."""
    return _quiet.get()


def stderr() -> Console:
    """A new console on stderr, which may have been redirected."""
    return Console(stderr=True)


@contextlib.contextmanager
def working(words: str) -> Iterator[None]:
    """Show a spinner on stderr, if that is a terminal, during the `with` block."""
    console = stderr()
    if console.is_terminal and not is_quiet():
        with console.status(f"{words} ..."):
            yield
    else:
        yield


@contextlib.contextmanager
def bars_on_stderr() -> Iterator[bool]:
    """Redirect the library's progress output to stderr: stdout is for results.

    Yields whether to show progress: whether stderr is a terminal.
    """
    with contextlib.redirect_stdout(sys.stderr):
        yield stderr().is_terminal and not is_quiet()


def track(items: Sequence[Item], words: str) -> Iterator[Item]:
    """Iterate with a progress bar on stderr, labelled `compiling` during the first item."""
    with progress_bar() as progress:
        task = progress.add_task(f"compiling, {words}", total=len(items))
        for count, item in enumerate(items, 1):
            yield item
            progress.update(task, completed=count, description=words)


def progress_bar() -> Progress:
    """A transient progress bar on stderr, disabled if that is no terminal."""
    console = stderr()
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal or is_quiet())


def print_counts(counts: dict[str, int], total: int, noun: str = "pixel", hit: str | None = None) -> None:
    """Print the number of pixels (or `noun`) per status on stderr; `hit` replaces the sentence of that status."""
    from jaxgeo.status import Status

    if is_quiet():
        return
    console = stderr()
    console.print(f"{total} {noun}{'s' if total != 1 else ''}:", highlight=False)
    for name, count in sorted(counts.items(), key=lambda item: Status[item[0]]):
        meaning = hit if hit is not None and name == Status.hit.name else Status[name].message
        console.print(f"  {count:>7}  {name}: {meaning}", highlight=False, soft_wrap=True)


def fix_table(rows: list[dict[str, Any]], title: str | None = None) -> Table:
    """Table of fixes, 80 characters wide."""
    columns = {
        "u": ("u", ".0f"),
        "v": ("v", ".0f"),
        "fix_lat_deg": ("lat, deg", ".6f"),
        "fix_lon_deg": ("lon, deg", ".6f"),
        "fix_height_m": ("height", ".2f"),
        "fix_height_msl_m": ("msl", ".2f"),
        "slant_range_m": ("range", ".1f"),
        "incidence_surface_deg": ("inc.", ".1f"),
        "status": ("status", ""),
    }
    caption = (
        "u, v: column and row; height, msl: m above WGS 84 and EGM96 mean sea level; "
        "range: slant range, m; inc.: incidence angle, deg"
    )
    table = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left")
    table.caption_justify = "left"
    for name, (header, _) in columns.items():
        table.add_column(header, justify="left" if name == "status" else "right", no_wrap=name != "status")
    for row in rows:
        cells = [
            ("" if row[name] is None else _as_text(_plain(row[name]), spec)) for name, (_, spec) in columns.items()
        ]
        table.add_row(*cells, style=None if row["status"] == "hit" else "yellow")
    return table


@dataclasses.dataclass(frozen=True)
class NumberTable:
    """A table of rows that shows every number in full: columns for which a line has no room follow in further tables,
    which repeat the first column if that is a name."""

    rows: Sequence[dict[str, Any]]
    columns: dict[str, tuple[str, str]]
    caption: str

    def fits(self, width: int) -> bool:
        """Whether one table has room for all columns in lines of `width` characters."""
        return len(self._fitting(width)) == 1

    def __rich_console__(self, console: AnyConsole, options: ConsoleOptions) -> Iterator[Table | Text]:
        parts = self._fitting(options.max_width)
        for part in parts[:-1]:
            yield self._table(part, "")
        yield self._table(parts[-1], self.caption if len(parts) == 1 else "")
        if self.caption and len(parts) > 1:
            yield Text(self.caption, style="table.caption")

    def _fitting(self, width: int) -> list[list[str]]:
        """The columns of each table for lines of `width` characters; one that is too long for a line has it alone."""
        names = list(self.columns)
        key = names[:1] if not self.columns[names[0]][1] else []
        needed = {name: max(cell_len(one) for one in self._cells(name)) + 2 for name in names}
        parts: list[list[str]] = [[]]
        for name in names:
            if len(parts[-1]) > len(key) and 1 + sum(needed[one] for one in (*parts[-1], name)) > width:
                parts.append([*key])
            parts[-1].append(name)
        return parts

    def _cells(self, name: str) -> list[str]:
        """The header and the cells of a column."""
        header, spec = self.columns[name]
        return [header, *(_as_text(row[name], spec) for row in self.rows)]

    def _table(self, names: Sequence[str], caption: str) -> Table:
        table = Table(caption=caption or None, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), caption_justify="left")
        cells = {name: self._cells(name) for name in names}
        for name, (header, *_) in cells.items():
            is_text = not self.columns[name][1]
            table.add_column(header, justify="left" if is_text else "right", no_wrap=not is_text, overflow="fold")
        for number, row in enumerate(self.rows, 1):
            is_hit = row.get("status", "hit") == "hit"
            table.add_row(*(Text(cells[name][number]) for name in names), style=None if is_hit else "yellow")
        return table


def _as_text(value: Any, spec: str) -> str:
    """A cell, without the sign of a zero; None is blank."""
    if value is None:
        return ""
    return format(value, f"z{spec}" if spec.endswith("f") and isinstance(value, float | np.floating) else spec)


def number_table(rows: Sequence[dict[str, Any]], columns: dict[str, tuple[str, str]], caption: str = "") -> NumberTable:
    """Table of rows: `columns` maps keys to (header, format); None is blank."""
    return NumberTable(rows, columns, caption)


def _plain(value: Any) -> Any:
    """A CSV cell as a number, if it is one."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return value
