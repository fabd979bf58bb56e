"""`jaxgeo demo`: geolocation example with an oblique camera over real terrain."""

from __future__ import annotations

import importlib
import pathlib
from typing import Annotated, Any

import typer

from jaxgeo._destination import check_place, destination, is_device
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._inputs import check_no_overwrite
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import fix_table, print_counts, print_message, print_written, working

FIGURE = pathlib.Path("jaxgeo-demo.png")
PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")  # written by matplotlib itself


def demo_command(
    output: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Figure file: .png, .pdf, .svg, ... (default: jaxgeo-demo.png)."
        ),
    ] = None,
    write_scene: Annotated[
        pathlib.Path | None,
        typer.Option(metavar="FILE", help="Write the scene file; without --output, nothing else is done."),
    ] = None,
    write_dem: Annotated[
        pathlib.Path | None,
        typer.Option(metavar="FILE", help="Write the elevation model (.tif); without --output, nothing else is done."),
    ] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Geolocation example with an oblique camera over real terrain: a table of fixes and a figure.

    Without matplotlib (pip install 'jaxgeo\\[plot]') only the table is printed, and the exit code is 1.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        files = {"--write-scene": write_scene, "--write-dem": write_dem}
        wanted = {option: path for option, path in files.items() if path is not None}
        _check_files(wanted)
        if output is None and wanted:
            _write_files(wanted)
            if as_json:
                print_json("demo", {"inputs": inputs, "files": [f"{path}" for path in wanted.values()]})
            return
        _demo(output or FIGURE, wanted, inputs if as_json else None)


def _demo(output: pathlib.Path, wanted: dict[str, pathlib.Path], inputs: dict[str, Any] | None) -> None:
    """Run the demo, and write the files of options; with `inputs`, print the result as JSON."""
    for option, path in wanted.items():
        if path.resolve() == output.resolve():
            raise UserError(f"{option} {path}: the figure is written there; name another file.")
    with destination("--output", output, binary=True) as stream:
        picture_format = _picture_format(output)
        _write_files(wanted)
        rows, made, picture = _show_demo(inputs is None)
        if inputs is not None:
            print_json("demo", {"inputs": inputs, **_content(made, rows)})
        if picture is None:
            raise typer.Exit(NO_ANSWER)
        picture.write(made, stream, picture_format)
    print_written(output)


def _picture_format(output: pathlib.Path) -> str:
    if output.suffix.lower() in PICTURES:
        return output.suffix.lower().removeprefix(".")
    if is_device(output):
        return "png"
    raise UserError(f"--output {output}: {name_says(output)}; use {', '.join(PICTURES)}.")


def _sources() -> dict[str, pathlib.Path]:
    """The files of the demo by the options that write them."""
    from jaxgeo import demo

    scene = demo.scene_file()
    return {"--write-scene": scene, "--write-dem": scene.with_name("jacksboro.tif")}


def _check_files(wanted: dict[str, pathlib.Path]) -> None:
    """Raises `UserError` for two options that name one file, and for places that cannot be written or are inputs."""
    places = [path.resolve() for path in wanted.values()]
    if len(set(places)) < len(places):
        raise UserError(f"--write-scene and --write-dem both name {next(iter(wanted.values()))}; name two files.")
    for option, path in wanted.items():
        check_no_overwrite(option, path, [*_sources().values()])
        check_place(option, path)


def _write_files(wanted: dict[str, pathlib.Path]) -> None:
    """Write the files of the demo to the places of the options."""
    for option, path in wanted.items():
        with destination(option, path, binary=True) as stream:
            stream.write(_sources()[option].read_bytes())
        print_written(path)


def _show_demo(shows: bool) -> tuple[list[dict[str, Any]], Any, Any]:
    """(rows of fixes, the demo, its picture with all but the accuracy, None without matplotlib), printed if `shows`."""
    compile_quickly()
    from jaxgeo import demo
    from jaxgeo._checks import enable_x64

    enable_x64()
    console = Console()
    with demo.Making() as making:
        with working("compiling, and locating"):
            can_draw = _can_draw()  # takes Python's time while the first programs are compiled
            seen = making.seen()
        rows = _rows(seen)
        if shows:
            console.print(fix_table(rows, title=seen.title))
        print_counts(
            {name: sum(row["status"] == name for row in rows) for name in {row["status"] for row in rows}}, len(rows)
        )
        with working("compiling for the accuracy of one fix, and drawing"):
            picture = demo.Picture(seen) if can_draw else None
            made = making.whole(seen)
    if shows:
        console.print(f"\nAccuracy of fix {made.errors.number}:", highlight=False)
        for part in (made.errors.checked, made.errors.budget):
            console.print(str(part), highlight=False, soft_wrap=True)
    return rows, made, picture


def _can_draw() -> bool:
    """Whether matplotlib can be imported, with a message if not."""
    try:
        for name in ("matplotlib", "jaxgeo.plot"):
            importlib.import_module(name)
    except ImportError as error:
        print_message(f"no figure: matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        return False
    return True


def _rows(seen: Any) -> list[dict[str, Any]]:
    from jaxgeo.io import height_msl
    from jaxgeo.io.tables import fix_rows

    of_fixes = fix_rows(seen.fix, height_msl(seen.fix))
    return [{"u": u, "v": v, **row} for (u, v), row in zip(seen.uv, of_fixes, strict=True)]


def _content(made: Any, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The fixes, and the accuracy of one of them."""
    errors = made.errors
    sure = {"number": errors.number, "accuracy": str(errors.accuracy), "samples": errors.checked.words}
    return {"title": made.title, "fixes": _numbers(made, rows), "errors": sure | {"budget": errors.budget.to_dict()}}


def _numbers(made: Any, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows with full precision."""
    found = made.fix.to_dict()
    return [
        {"u": row["u"], "v": row["v"], **{name: values[i] for name, values in found.items()}}
        for i, row in enumerate(rows)
    ]
