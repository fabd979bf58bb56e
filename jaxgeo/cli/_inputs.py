"""Input readers of the commands: terrain, tables of shots and navigation records, with their scene."""

from __future__ import annotations

import pathlib
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import jaxgeo
from jaxgeo._destination import check_no_input
from jaxgeo._text_numbers import number_in, whole_in
from jaxgeo._text_numbers import numbers_in as number_list
from jaxgeo.cli._archive_dem import Look, fetch, is_archive
from jaxgeo.cli._common import UserError
from jaxgeo.cli._option_names import gap_as_typed, translate_dem_errors, translate_reader_errors
from jaxgeo.cli._options import DemOptions
from jaxgeo.cli._screen import print_note, working
from jaxgeo.sensor import AbstractCamera, FrameCamera, Shot, Trajectory
from jaxgeo.terrain import Dem

if TYPE_CHECKING:
    import jaxgeo.io.scene
    from jaxgeo.io import DemFiles
    from jaxgeo.io.archives import View

T = TypeVar("T")


def check_goes_with_dem(options: DemOptions) -> None:
    """Raises `UserError` if an option for the files of --dem is given; call it if there is no --dem."""
    for name in options.of_files:
        raise UserError(f"--{name.replace('_', '-')} needs --dem FILE.")


def bounds_in(options: DemOptions) -> tuple[float, float, float, float] | None:
    """The edges of --dem-bounds."""
    if options.dem_bounds is None:
        return None
    west, south, east, north = numbers_in(
        "--dem-bounds", options.dem_bounds, (4,), "WEST,SOUTH,EAST,NORTH, four numbers in deg"
    )
    return west, south, east, north


def read_terrain(dem: list[str], options: DemOptions, look: Look | None = None, *, padded: bool = True) -> Dem:
    """Elevation model from one file or several tiles, or of an archive for the lines of sight of `look`.

    By default padded to one of a few sizes, so that programs kept from one file serve another.
    """
    from jaxgeo.io import read_dem

    if is_archive(dem):
        found = fetch(dem[0], options, look)
        with working("reading the elevation model"), translate_dem_errors():
            return found.read(**_of_parts(options))
    check_needs_archive(options)
    edges = bounds_in(options)
    with working("reading the elevation model"), translate_dem_errors():
        return read_dem(list(dem), bounds=edges, padded=padded, **_reading_of(options))


def open_terrain(dem: list[str], options: DemOptions, look: Look | None = None) -> DemFiles:
    """Elevation model on disk, of which only the ground in sight is read; `look` as in `read_terrain`."""
    from jaxgeo.io import open_dem

    if is_archive(dem):
        found = fetch(dem[0], options, look)
        with translate_dem_errors():
            return found.open(**_of_parts(options))
    check_needs_archive(options)
    if options.dem_bounds is not None:
        raise UserError("--dem-bounds: of many images only the ground in sight is read; leave it out.")
    with translate_dem_errors():
        return open_dem(list(dem), **_reading_of(options))


def check_needs_archive(options: DemOptions) -> None:
    """Raises `UserError` for an option of archives beside files."""
    for name in ("mirror", "proxy", "offline"):
        if getattr(options, name) is not None:
            raise UserError(f"--{name} is for the archives of --dem, such as --dem copernicus; leave it out.")


def _of_parts(options: DemOptions) -> dict[str, Any]:
    """Options of `read_dem` and `open_dem` for parts of an archive, which have their own datum and one band."""
    found = _reading_of(options)
    return {name: found[name] for name in ("nodata", "height_unit", "assume_wgs84")}


def _reading_of(options: DemOptions) -> dict[str, Any]:
    """Options of `read_dem` and `open_dem`."""
    return {
        "vertical_datum": datum(options.vertical_datum),
        "nodata": options.nodata,
        "height_unit": options.height_unit,
        "band": 1 if options.dem_band is None else options.dem_band,
        "assume_wgs84": bool(options.assume_wgs84),
        "allow_remote": bool(options.allow_remote),
        "allow_outside": bool(options.allow_outside),
    }


def terrain_files(dem: list[str], options: DemOptions) -> list[str]:
    """All files of the elevation model: tiles, sources of a VRT, a geoid grid."""
    from jaxgeo.io.paths import expanded, files_behind

    if is_archive(dem):
        return [] if options.vertical_datum is None else [options.vertical_datum]
    tiles = [file for tile in expanded(list(dem)) for file in files_behind(tile, options.reach)]
    return tiles if options.vertical_datum is None else [*tiles, options.vertical_datum]


def check_no_overwrite(
    option: str,
    output: pathlib.Path | None,
    read: Iterable[pathlib.Path | None],
    dem: list[str] | None = None,
    options: DemOptions = DemOptions(),
) -> None:
    """Raises `ValueError` if an output would overwrite an input."""
    if output is not None:
        tiles = terrain_files(dem, options) if dem else []
        check_no_input(option, [output], [*(path for path in read if path is not None), *tiles])


def datum(text: str | None) -> str | float | None:
    """A DEM datum from the command line: a small number is an undulation in m, a larger whole one an EPSG code."""
    if text is None:
        return None
    whole, number = whole_in(text), number_in(text)
    if number is None:
        return text
    return whole if whole is not None and text.isdigit() else number


def as_datum(text: str) -> str | float:
    """A datum from the command line, as in scene files: a number is an undulation in m."""
    from jaxgeo.io.datum_names import known_datum

    number = number_in(text)
    return known_datum(text) if number is None else number


def shot_of(scene: jaxgeo.io.scene.Scene, path: pathlib.Path, needed_by: str) -> Shot:
    """The shot of a scene; raises `SceneError` if it has none."""
    from jaxgeo.io.scene import SceneError

    if scene.shot is None:
        raise SceneError(f"{path}: [pose] is missing; {needed_by} needs it.")
    return scene.shot


def shots_of(
    scene: jaxgeo.io.scene.Scene, path: pathlib.Path, table: pathlib.Path, given: str | None
) -> tuple[Shot, list[dict[str, Any]]]:
    """(batch of shots, rows as text) of a table without pixels."""
    from jaxgeo.io.errors import OutsideDatum, VerticalDatumError
    from jaxgeo.io.observation_reader import check_reference, datum_of_shots
    from jaxgeo.io.scene import SceneError
    from jaxgeo.io.tables import read_shots

    names = scene.sensor.gimbal.names
    found = read_shots(table, names, pixels=False)
    with translate_reader_errors():
        stated = datum_of_shots(found, table, scene, path, None if given is None else as_datum(given))
    check_reference(found, table, scene.sensor.gimbal)
    try:
        return found.shots(names, stated), found.rows
    except (OutsideDatum, VerticalDatumError) as error:
        raise SceneError(f"{path}, with the heights of {table}: {error}") from error


def trajectory_of(
    scene: jaxgeo.io.scene.Scene, path: pathlib.Path, table: pathlib.Path, given: str | None
) -> Trajectory:
    """Trajectory from a file of navigation records; without gimbal columns the scene's readings are held.

    Raises `UserError` if the scene has none either.
    """
    from jaxgeo.io import read_navigation
    from jaxgeo.io._csv import POSE_COLUMNS, gimbal_columns, read_csv
    from jaxgeo.io._unread_columns import unread_columns
    from jaxgeo.io.errors import TableError
    from jaxgeo.io.navigation import TIME, VELOCITY
    from jaxgeo.io.observation_reader import height_datum_of

    names = scene.sensor.gimbal.names
    columns = list(gimbal_columns(names))
    header = read_csv(table, "file of navigation records", ()).header
    for one in unread_columns(header, {*TIME, *POSE_COLUMNS, *VELOCITY, *columns}):
        print_note(f"{table}: {one}")
    held = None
    if columns and not set(columns) & set(header):
        if scene.shot is None:
            raise UserError(
                f"{table}: no column {', '.join(columns)}, and {path} has no [pose] with readings in [gimbal] to hold."
            )
        held = scene.shot.gimbal_readings
    stated = height_datum_of(scene, path, table) if given is None else as_datum(given)
    try:
        return read_navigation(table, names, height_datum=stated, gimbal_readings=held)
    except TableError as error:
        raise UserError(gap_as_typed(f"{error}")) from error


def view_of_shots(sensor: Any, motions: Sequence[Any]) -> View:
    """The lines of sight of images of shots, or of (trajectory, time)."""
    from jaxgeo.io.archives.views import view_of_images

    pairs = [one if isinstance(one, tuple) else (one, None) for one in motions]
    return view_of_images([(sensor, motion, time) for motion, time in pairs])


def single(batch: T) -> Iterator[T]:
    """The items of a batch of records, one by one, as JAX arrays."""
    import jax
    import jax.numpy as jnp

    leaves, form = jax.tree.flatten(batch)
    for items in zip(*(jnp.asarray(leaf) for leaf in leaves), strict=True):
        yield jax.tree.unflatten(form, items)


def numbers_in(option: str, text: str, counts: tuple[int, ...], form: str) -> list[float]:
    """Comma-separated numbers; raises `UserError` for other text, or if their number is not in `counts`."""
    found = number_list(text.split(","))
    if found is None or len(found) not in counts:
        raise UserError(f"{option} {text!r}: expected {form}.")
    return found


def check_on_image(text: str, uv: Sequence[float], camera: AbstractCamera) -> None:
    """Raises `UserError` for a pixel (`text` as typed) outside the image of a camera."""
    assert isinstance(camera, FrameCamera)
    column, row = uv
    if not (-0.5 <= column <= camera.width - 0.5 and -0.5 <= row <= camera.height - 0.5):
        raise UserError(
            f"--pixel {text}: outside the image of {camera.width} x {camera.height} pixels; columns go from 0 to "
            f"{camera.width - 1}, rows from 0 to {camera.height - 1}."
        )
