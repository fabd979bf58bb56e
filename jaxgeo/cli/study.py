"""`jaxgeo study`: what papers print, made again."""

from __future__ import annotations

import pathlib
from typing import Annotated

import typer
from rich.console import Console

from jaxgeo.cli._common import Traceback, compile_quickly, mistakes_told
from jaxgeo.cli._screen import tell

studies = typer.Typer(help="What papers print, made again.", no_args_is_help=True)


@studies.command("li2023")
def li2023_command(
    output: Annotated[
        pathlib.Path | None, typer.Option(help="Folder for tables (CSV, Markdown) and pictures; none if left out.")
    ] = None,
    samples: Annotated[int, typer.Option(help="Samples for each row of a table.")] = 50_000,
    seed: Annotated[int, typer.Option(help="Of the samples.")] = 0,
    traceback: Traceback = False,
) -> None:
    """The error analysis of Li et al. (2023) beside ours: pointing, frame angle, targets, their RMS and CEP.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and with --output the exit code is 1.
    """
    with mistakes_told(traceback):
        _study_li2023(output, samples, seed)


def _study_li2023(folder: pathlib.Path | None, samples: int, seed: int) -> None:
    """Tables on the screen, files into a folder that is made before the work."""
    from jaxgeo._checks import enable_x64
    from jaxgeo.studies import li2023

    compile_quickly()
    enable_x64()
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    console = Console()
    with console.status("compiling and sampling ..."):
        report = li2023.run(samples=samples, seed=seed)
    for sheet in li2023.sheets_of(report):
        console.print(sheet.to_rich())
    if folder is None:
        return
    li2023.write_tables(report, folder)
    try:
        li2023.write_pictures(report, folder)
    except ImportError as error:
        tell(f"there are no pictures, as matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        raise typer.Exit(1) from None
    console.print(f"tables and pictures: {folder}", highlight=False, soft_wrap=True)
