"""The command line: `jaxgeo locate` for pixels and tables of shots, `jaxgeo demo` for a first look, `jaxgeo study`."""

from __future__ import annotations

import contextlib
import functools
import os
import pathlib
import subprocess
import sys
from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from jaxgeo._destination import destination, is_device

app = typer.Typer(
    help="Where is what this pixel sees? Geolocation of aerial images on real terrain.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
studies = typer.Typer(help="What papers print, made again.", no_args_is_help=True)
app.add_typer(studies, name="study")
PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")  # that matplotlib writes by itself
QUICK_TO_COMPILE = "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
CHUNKS = (16, 1024)  # fixes that are computed at a time: few shapes, so few compilations


class Format(StrEnum):
    """How fixes are written."""

    table = "table"
    csv = "csv"
    geojson = "geojson"


class UserError(Exception):
    """A mistake of the caller's, told in one message."""


def main() -> None:
    """Entry point of the command `jaxgeo`."""
    app()


@contextlib.contextmanager
def _mistakes_told(show_traceback: bool) -> Iterator[None]:
    """Callers' mistakes as one message on stderr and exit code 2."""
    try:
        yield
    except (UserError, ValueError, OSError) as error:
        if show_traceback:
            raise
        _tell(str(error) or type(error).__name__)
        raise typer.Exit(2) from None


def _tell(message: str) -> None:
    text = "\n".join(f"jaxgeo: {line}" for line in message.splitlines())
    _stderr().print(text, markup=False, highlight=False, soft_wrap=True)


def _stderr() -> Console:
    return Console(stderr=True)


_Traceback = Annotated[bool, typer.Option("--traceback", help="Show where an error was raised.")]


@app.command("locate")
def locate_command(
    scene: Annotated[pathlib.Path, typer.Option(help="Scene file (TOML): camera, gimbal, mount and pose.")],
    dem: Annotated[list[pathlib.Path], typer.Option(help="Elevation model; repeat it for several tiles.")],
    pixel: Annotated[list[str] | None, typer.Option(help="COLUMN,ROW of a pixel; repeat it for more.")] = None,
    shots: Annotated[pathlib.Path | None, typer.Option(help="CSV with a shot and a pixel in each row.")] = None,
    vertical_datum: Annotated[
        str | None, typer.Option(help='What the DEM heights are above: "EPSG:5773", "ellipsoid", metres, a geoid grid.')
    ] = None,
    output_format: Annotated[
        Format | None,
        typer.Option("--format", help="Default: by the name of --output; on the screen table, or csv for shots."),
    ] = None,
    output: Annotated[
        pathlib.Path | None, typer.Option(help="File to write (.csv, .geojson, .json); the screen if left out.")
    ] = None,
    traceback: _Traceback = False,
) -> None:
    """The ground points that pixels see, one row for each pixel, whatever became of it."""
    with _mistakes_told(traceback), destination("--output", output) as stream:
        chosen = _chosen_format(output_format, output, shots)
        _locate(scene, dem, pixel or [], shots, vertical_datum, chosen, stream)


@app.command("demo")
def demo_command(
    output: Annotated[pathlib.Path, typer.Option(help="The picture: .png, .pdf, .svg, ...")] = pathlib.Path(
        "jaxgeo-demo.png"
    ),
    write_scene: Annotated[pathlib.Path | None, typer.Option(help="Also write the scene file, to start from.")] = None,
    traceback: _Traceback = False,
) -> None:
    """An oblique camera over real terrain: a table of fixes and a picture.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there is the table only, and the exit code is 1.
    """
    with _mistakes_told(traceback):
        _demo(output, write_scene)


@studies.command("li2023")
def li2023_command(
    output: Annotated[
        pathlib.Path | None, typer.Option(help="Folder for tables (CSV, Markdown) and pictures; none if left out.")
    ] = None,
    samples: Annotated[int, typer.Option(help="Samples for each row of a table.")] = 50_000,
    seed: Annotated[int, typer.Option(help="Of the samples.")] = 0,
    traceback: _Traceback = False,
) -> None:
    """The error analysis of Li et al. (2023) beside ours: pointing, frame angle, targets, their RMS and CEP.

    Without matplotlib (pip install 'jaxgeo\\[plot]') there are no pictures, and with --output the exit code is 1.
    """
    with _mistakes_told(traceback):
        _study_li2023(output, samples, seed)


# -------------------------------------------------------------------------------------------------------------- locate


def _locate(
    scene_path: pathlib.Path,
    dem_paths: list[pathlib.Path],
    pixels: list[str],
    shots_path: pathlib.Path | None,
    vertical_datum: str | None,
    output_format: Format,
    stream: Any,
) -> None:
    if bool(pixels) == (shots_path is not None):
        raise UserError("give either --pixel COLUMN,ROW (once or more) or --shots FILE.")
    from jaxgeo._checks import enable_x64
    from jaxgeo.io import read_dem
    from jaxgeo.io.scene import read_scene

    enable_x64()
    scene = read_scene(scene_path)
    work = (
        _work_of_pixels(scene, scene_path, pixels)
        if shots_path is None
        else _work_of_shots(scene, scene_path, shots_path)
    )
    terrain = read_dem([str(path) for path in dem_paths], vertical_datum=_datum(vertical_datum))
    _write_rows(_located_rows(scene, *work, terrain), scene.sensor.gimbal.names, output_format, stream)


def _write_rows(rows: Iterator[dict[str, Any]], readings: tuple[str, ...], output_format: Format, stream: Any) -> None:
    from jaxgeo.io.tables import number_columns, write_csv, write_geojson

    if output_format is Format.csv:
        write_csv(rows, stream)
    elif output_format is Format.geojson:
        write_geojson(rows, stream, number_columns(readings))
    else:
        table = fix_table(list(rows))
        Console(file=stream, width=None if stream.isatty() else 160).print(table)


def _work_of_pixels(scene: Any, path: pathlib.Path, pixels: list[str]) -> tuple[Any, Any, list[dict[str, Any]]]:
    """(shots, pixels, rows to carry through) of one shot and pixels from the command line."""
    import jax
    import numpy as np

    from jaxgeo.io.scene import SceneError

    if scene.shot is None:
        raise SceneError(f"{path}: [pose] is missing; --pixel needs it (a table of poses is given with --shots).")
    uv = np.array([_parsed_pixel(text) for text in pixels])
    shots = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(uv), *np.shape(leaf))), scene.shot)
    return shots, uv, [{"u": float(u), "v": float(v)} for u, v in uv]


def _parsed_pixel(text: str) -> tuple[float, float]:
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise UserError(f"--pixel {text!r}: expected COLUMN,ROW, two numbers, e.g. --pixel 100,200.") from None
    return u, v


def _work_of_shots(scene: Any, path: pathlib.Path, shots_path: pathlib.Path) -> tuple[Any, Any, list[dict[str, Any]]]:
    """(shots, pixels, rows to carry through) of a table of shots."""
    from jaxgeo.io.scene import SceneError
    from jaxgeo.io.tables import read_shots

    if scene.height_datum is None:
        raise SceneError(
            f"{path}: what are the heights of {shots_path} measured from? Say it in the scene file: "
            f'[shots] height_datum = "ellipsoid", "EPSG:5773" (EGM96 mean sea level), or an undulation in m.'
        )
    table = read_shots(shots_path, scene.sensor.gimbal.names)
    try:
        return (*table.as_records(scene.sensor.gimbal.names, scene.height_datum), table.rows)
    except ValueError as error:  # the datum's grid does not reach a shot
        raise SceneError(f"{path}, with the heights of {shots_path}: {error}") from error


def _located_rows(
    scene: Any, shots: Any, uv: Any, carried: list[dict[str, Any]], terrain: Any
) -> Iterator[dict[str, Any]]:
    """A row for each pixel, in chunks of one size; a progress bar and the count of statuses go to stderr."""
    import numpy as np

    from jaxgeo.io import height_msl
    from jaxgeo.io.tables import fix_rows

    total = len(carried)
    size = next((size for size in CHUNKS if size >= total), CHUNKS[-1])
    located = _batched_locate()
    counts: dict[str, int] = {}
    with _progress() as progress:
        task = progress.add_task("locating", total=total)
        for start in range(0, total, size):
            here = np.minimum(np.arange(start, start + size), total - 1)
            fix = located(scene.sensor, _taken(shots, here), uv[here], terrain, scene.atmosphere)
            fix = _taken(fix, np.arange(min(size, total - start)))
            for i, row in enumerate(fix_rows(fix, height_msl(fix)), start):
                counts[row["status"]] = counts.get(row["status"], 0) + 1
                yield {**carried[i], **row}
            progress.update(task, completed=min(start + size, total))
    _print_counts(counts, total)


@functools.cache
def _batched_locate() -> Any:
    import jax

    from jaxgeo.locate import locate

    def through_the_air(sensor: Any, shot: Any, uv: Any, terrain: Any, atmosphere: Any) -> Any:
        return locate(sensor, shot, uv, terrain, atmosphere=atmosphere)

    return jax.jit(jax.vmap(through_the_air, in_axes=(None, 0, 0, None, None)))


def _taken(tree: Any, index: Any) -> Any:
    """Items of every leaf, as NumPy arrays."""
    import jax
    import numpy as np

    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


def _progress() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=_stderr(), transient=True)


def _print_counts(counts: dict[str, int], total: int) -> None:
    from jaxgeo.status import Status

    console = _stderr()
    console.print(f"{total} pixel{'s' if total != 1 else ''}:", highlight=False)
    for name, count in sorted(counts.items(), key=lambda item: Status[item[0]]):
        console.print(f"  {count:>7}  {name}: {Status[name].message}", highlight=False, soft_wrap=True)


def _chosen_format(asked: Format | None, output: pathlib.Path | None, shots: pathlib.Path | None) -> Format:
    if asked is not None:
        return asked
    by_name = {".csv": Format.csv, ".geojson": Format.geojson, ".json": Format.geojson}
    if output is not None and output.suffix.lower() in by_name:
        return by_name[output.suffix.lower()]
    if output is None or is_device(output):
        return Format.table if shots is None else Format.csv
    raise UserError(
        f"--output {output}: {_name_says(output)}. Give a name that ends in {', '.join(by_name)}, "
        f"or say --format table, csv or geojson."
    )


def _name_says(output: pathlib.Path) -> str:
    return f"the ending {output.suffix} is not one that is known" if output.suffix else "the name has no ending"


def _datum(text: str | None) -> str | float | None:
    """A datum from the command line: a small number is an undulation in m, a larger whole one an EPSG code."""
    try:
        return None if text is None else float(text) if not text.isdigit() else int(text)
    except ValueError:
        return text


def fix_table(rows: list[dict[str, Any]], title: str | None = None) -> Table:
    """Fixes as a table for the screen, 80 columns wide."""
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
        "u, v: column and row; height, msl: m above WGS 84 and above EGM96 mean sea level; "
        "range: slant range, m; inc.: incidence at the surface, deg"
    )
    table = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), title_justify="left")
    table.caption_justify = "left"
    for name, (header, _) in columns.items():
        table.add_column(header, justify="left" if name == "status" else "right", no_wrap=name != "status")
    for row in rows:
        cells = [("" if row[name] is None else format(_plain(row[name]), spec)) for name, (_, spec) in columns.items()]
        table.add_row(*cells, style=None if row["status"] == "hit" else "yellow")
    return table


def _plain(value: Any) -> Any:
    """A cell of a CSV file as a number, if it is one."""
    try:
        return float(value)
    except ValueError:
        return value


# ---------------------------------------------------------------------------------------------------------------- demo


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
    raise UserError(f"--output {output}: {_name_says(output)}. Give a name that ends in {', '.join(PICTURES)}.")


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

    _compile_quickly()
    enable_x64()
    console = Console()
    with console.status("compiling, locating and sampling ..."):
        made = demo.make_demo()
    rows = [
        {"u": u, "v": v, **row} for (u, v), row in zip(made.uv, fix_rows(made.fix, height_msl(made.fix)), strict=True)
    ]
    console.print(fix_table(rows, title=made.title))
    _print_counts(
        {name: sum(row["status"] == name for row in rows) for name in {row["status"] for row in rows}}, len(rows)
    )
    console.print(f"\nHow sure fix {made.errors.number} of them is, by every method:", highlight=False)
    for part in (made.errors.comparison, made.errors.accuracy, made.errors.budget):
        console.print(str(part), highlight=False, soft_wrap=True)
    try:
        demo.draw(made, stream, picture_format)
    except ImportError as error:
        _tell(f"there is no picture, as matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        raise typer.Exit(1) from None


# --------------------------------------------------------------------------------------------------------------- study


def _study_li2023(folder: pathlib.Path | None, samples: int, seed: int) -> None:
    """Tables on the screen, files into a folder that is made before the work."""
    from jaxgeo._checks import enable_x64
    from jaxgeo.studies import li2023

    _compile_quickly()
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
        _tell(f"there are no pictures, as matplotlib cannot be imported ({error}); pip install 'jaxgeo[plot]'")
        raise typer.Exit(1) from None
    console.print(f"tables and pictures: {folder}", highlight=False, soft_wrap=True)


def _compile_quickly() -> None:
    """Have XLA compile in half the time what is computed only a few times; before anything is computed.

    A version of XLA that does not know the flags would end the process, so another process tries them first.
    """
    if "XLA_FLAGS" in os.environ:
        return
    environment = {**os.environ, "XLA_FLAGS": QUICK_TO_COMPILE}
    probe = [sys.executable, "-c", "import jax; jax.devices()"]
    if subprocess.run(probe, env=environment, capture_output=True, check=False).returncode == 0:
        os.environ["XLA_FLAGS"] = QUICK_TO_COMPILE


if __name__ == "__main__":
    main()
