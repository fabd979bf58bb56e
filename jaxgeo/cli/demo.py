"""`jaxgeo demo`: an oblique camera over real terrain."""

from __future__ import annotations

import pathlib
from typing import Annotated, Any

import typer
from rich.console import Console

from jaxgeo._destination import destination, is_device
from jaxgeo.cli._common import Traceback, UserError, compile_quickly, mistakes_told, name_says
from jaxgeo.cli._screen import fix_table, print_counts, tell

PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")  # that matplotlib writes by itself


def demo_command(
    output: Annotated[pathlib.Path, typer.Option(help="The picture: .png, .pdf, .svg, ...")] = pathlib.Path(
        "jaxgeo-demo.png"
    ),
    write_scene: Annotated[pathlib.Path | None, typer.Option(help="Also write the scene file, to start from.")] = None,
    traceback: Traceback = False,
) -> None:
    """An oblique camera over real terrain: a table of fixes and a picture.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there is the table only, and the exit code is 1.
    """
    with mistakes_told(traceback):
        _demo(output, write_scene)


def _demo(output: pathlib.Path, write_scene: pathlib.Path | None) -> None:
    with destination("--output", output, binary=True) as stream:
        picture_format = _picture_format(output)
        if write_scene is not None:
            _write_demo_scene(write_scene)
        _show_demo(stream, picture_format)
    Console().print(f"picture: {output}", highlight=False, soft_wrap=True)


def _picture_format(output: pathlib.Path) -> str:
    if output.suffix.lower() in PICTURES:
        return output.suffix.lower().removeprefix(".")
    if is_device(output):
        return "png"
    raise UserError(f"--output {output}: {name_says(output)}. Give a name that ends in {', '.join(PICTURES)}.")


def _write_demo_scene(path: pathlib.Path) -> None:
    from jaxgeo import demo

    with destination("--write-scene", path) as stream:
        stream.write(demo.scene_file().read_text(encoding="utf-8"))


def _show_demo(stream: Any, picture_format: str) -> None:
    """The table on the screen, the picture into a stream; without matplotlib a message and exit code 1."""
    from jaxgeo import demo
    from jaxgeo._checks import enable_x64
    from jaxgeo.io import height_msl
    from jaxgeo.io.tables import fix_rows

    compile_quickly()
    enable_x64()
    console = Console()
    with console.status("compiling, locating and sampling ..."):
        made = demo.make_demo()
    rows = [
        {"u": u, "v": v, **row} for (u, v), row in zip(made.uv, fix_rows(made.fix, height_msl(made.fix)), strict=True)
    ]
    console.print(fix_table(rows, title=made.title))
    print_counts(
        {name: sum(row["status"] == name for row in rows) for name in {row["status"] for row in rows}}, len(rows)
    )
    console.print(f"\nHow sure fix {made.errors.number} of them is, by every method:", highlight=False)
    for part in (made.errors.comparison, made.errors.accuracy, made.errors.budget):
        console.print(str(part), highlight=False, soft_wrap=True)
    try:
        demo.draw(made, stream, picture_format)
    except ImportError as error:
        tell(f"there is no picture, as matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        raise typer.Exit(1) from None
