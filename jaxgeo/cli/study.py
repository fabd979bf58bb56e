"""`jaxgeo study`: what papers print, made again."""

from __future__ import annotations

import pathlib
from collections.abc import Callable
from typing import Annotated, Any

import typer
from rich.console import Console

from jaxgeo.cli._common import Traceback, compile_quickly, mistakes_told
from jaxgeo.cli._screen import tell

WIDE = 150  # characters of a line in a file

studies = typer.Typer(help="What papers print, made again.", no_args_is_help=True)

Folder = Annotated[
    pathlib.Path | None,
    typer.Option("--output", help="Folder for tables (CSV, Markdown) and pictures; none if left out."),
]


@studies.command("li2020")
def li2020_command(output: Folder = None, traceback: Traceback = False) -> None:
    """The overlap analysis of Li et al. (2020) beside ours: attitude, compensation, strips in flight, timing.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and with --output the exit code is 1.
    """
    with mistakes_told(traceback):
        _begin(output)
        from jaxgeo.studies import li2020

        _show(li2020, li2020.run, output)


@studies.command("li2023")
def li2023_command(
    output: Folder = None,
    samples: Annotated[int, typer.Option(help="Samples for each row of a table.")] = 50_000,
    seed: Annotated[int, typer.Option(help="Of the samples.")] = 0,
    traceback: Traceback = False,
) -> None:
    """The error analysis of Li et al. (2023) beside ours: pointing, frame angle, targets, their RMS and CEP.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and with --output the exit code is 1.
    """
    with mistakes_told(traceback):
        _begin(output)
        from jaxgeo.studies import li2023

        _show(li2023, lambda: li2023.run(samples=samples, seed=seed), output)


@studies.command("xue2019")
def xue2019_command(
    output: Folder = None,
    size: Annotated[
        float, typer.Option(help="Side of the area, m; the paper's is 5000, with some 1600 images.")
    ] = 1000.0,
    trials: Annotated[int, typer.Option(help="Smaller blocks with other noise, to test the standard deviations.")] = 0,
    seed: Annotated[int, typer.Option(help="Of the noise.")] = 0,
    traceback: Traceback = False,
) -> None:
    """The block of Xue et al. (2019), simulated: direct georeferencing, free net, self-calibration, boresight.

    Takes minutes, most of them to compile. Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and
    with --output the exit code is 1.
    """
    with mistakes_told(traceback):
        _begin(output)
        from jaxgeo.studies import xue2019

        _show(xue2019, lambda: xue2019.run(seed, size, trials=trials), output)


def _begin(folder: pathlib.Path | None) -> None:
    """The folder is made before the work."""
    from jaxgeo._checks import enable_x64

    compile_quickly()
    enable_x64()
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)


def _show(study: Any, run: Callable[[], Any], folder: pathlib.Path | None) -> None:
    """Tables on the screen, and with pictures into a folder."""
    console = Console()
    if not console.is_terminal:  # a file has room for all of a table
        console = Console(width=WIDE)
    with console.status("computing ..."):
        report = run()
    for sheet in study.sheets_of(report):
        console.print(sheet.to_rich(console.width))
    if folder is None:
        return
    study.write_tables(report, folder)
    try:
        study.write_pictures(report, folder)
    except ImportError as error:
        tell(f"there are no pictures, as matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        raise typer.Exit(1) from None
    console.print(f"tables and pictures: {folder}", highlight=False, soft_wrap=True)
