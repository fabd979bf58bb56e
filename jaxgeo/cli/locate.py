"""`jaxgeo locate`: the ground points that pixels see."""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Any

import typer
from rich.console import Console

from jaxgeo._destination import destination, is_device
from jaxgeo.cli._common import Traceback, UserError, mistakes_told, name_says
from jaxgeo.cli._inputs import height_datum_of, read_terrain, shot_of
from jaxgeo.cli._options import DemFiles, SceneFile, VerticalDatum
from jaxgeo.cli._screen import fix_table, print_counts, progress_bar

CHUNKS = (16, 1024)  # fixes that are computed at a time: few shapes, so few compilations


class Format(StrEnum):
    """How fixes are written."""

    table = "table"
    csv = "csv"
    geojson = "geojson"


def locate_command(
    scene: SceneFile,
    dem: DemFiles,
    pixel: Annotated[list[str] | None, typer.Option(help="COLUMN,ROW of a pixel; repeat it for more.")] = None,
    shots: Annotated[pathlib.Path | None, typer.Option(help="CSV with a shot and a pixel in each row.")] = None,
    vertical_datum: VerticalDatum = None,
    output_format: Annotated[
        Format | None,
        typer.Option("--format", help="Default: by the name of --output; on the screen table, or csv for shots."),
    ] = None,
    output: Annotated[
        pathlib.Path | None, typer.Option(help="File to write (.csv, .geojson, .json); the screen if left out.")
    ] = None,
    traceback: Traceback = False,
) -> None:
    """The ground points that pixels see, one row for each pixel, whatever became of it."""
    with mistakes_told(traceback), destination("--output", output) as stream:
        chosen = _chosen_format(output_format, output, shots)
        _locate(scene, dem, pixel or [], shots, vertical_datum, chosen, stream)


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
    from jaxgeo.io.scene import read_scene

    enable_x64()
    scene = read_scene(scene_path)
    work = (
        _work_of_pixels(scene, scene_path, pixels)
        if shots_path is None
        else _work_of_shots(scene, scene_path, shots_path)
    )
    terrain = read_terrain(dem_paths, vertical_datum)
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

    shot = shot_of(scene, path, "--pixel")
    uv = np.array([_parsed_pixel(text) for text in pixels])
    shots = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(uv), *np.shape(leaf))), shot)
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

    height_datum = height_datum_of(scene, path, shots_path)
    table = read_shots(shots_path, scene.sensor.gimbal.names)
    try:
        return (*table.as_records(scene.sensor.gimbal.names, height_datum), table.rows)
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
    with progress_bar() as progress:
        task = progress.add_task("locating", total=total)
        for start in range(0, total, size):
            here = np.minimum(np.arange(start, start + size), total - 1)
            fix = located(scene.sensor, _taken(shots, here), uv[here], terrain, scene.atmosphere)
            fix = _taken(fix, np.arange(min(size, total - start)))
            for i, row in enumerate(fix_rows(fix, height_msl(fix)), start):
                counts[row["status"]] = counts.get(row["status"], 0) + 1
                yield {**carried[i], **row}
            progress.update(task, completed=min(start + size, total))
    print_counts(counts, total)


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


def _chosen_format(asked: Format | None, output: pathlib.Path | None, shots: pathlib.Path | None) -> Format:
    if asked is not None:
        return asked
    by_name = {".csv": Format.csv, ".geojson": Format.geojson, ".json": Format.geojson}
    if output is not None and output.suffix.lower() in by_name:
        return by_name[output.suffix.lower()]
    if output is None or is_device(output):
        return Format.table if shots is None else Format.csv
    raise UserError(
        f"--output {output}: {name_says(output)}. Give a name that ends in {', '.join(by_name)}, "
        f"or say --format table, csv or geojson."
    )
