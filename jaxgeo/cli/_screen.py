"""Terminal output: messages, progress and status counts on stderr, tables of fixes."""

from __future__ import annotations

import contextlib
import contextvars
import sys
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

from rich import box
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

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
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
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
        cells = [("" if row[name] is None else format(_plain(row[name]), spec)) for name, (_, spec) in columns.items()]
        table.add_row(*cells, style=None if row["status"] == "hit" else "yellow")
    return table


def number_table(rows: list[dict[str, Any]], columns: dict[str, tuple[str, str]], caption: str = "") -> Table:
    """Table of rows: `columns` maps keys to (header, format); None is blank."""
    table = Table(caption=caption or None, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), caption_justify="left")
    for header, spec in columns.values():
        table.add_column(header, justify="right" if spec else "left", no_wrap=True)
    for row in rows:
        cells = ["" if row[name] is None else format(row[name], spec) for name, (_, spec) in columns.items()]
        table.add_row(*cells, style=None if row.get("status", "hit") == "hit" else "yellow")
    return table


def _plain(value: Any) -> Any:
    """A CSV cell as a number, if it is one."""
    try:
        return float(value)
    except ValueError:
        return value
