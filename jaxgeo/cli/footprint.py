"""`jaxgeo footprint`: image footprints on the ground."""

from __future__ import annotations

import math
import pathlib
from collections.abc import Iterable
from typing import Annotated, Any

import typer

from jaxgeo._destination import check_place
from jaxgeo._text_numbers import numbers_or_texts
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._exposures import ExposureOrShotOptions, GivenExposure, GivenExposures
from jaxgeo.cli._far_crs import note_far_crs
from jaxgeo.cli._inputs import check_no_overwrite, read_terrain
from jaxgeo.cli._known_heights import has_no_datum, with_known_heights
from jaxgeo.cli._level_ground import check_ground, level_at, with_ground
from jaxgeo.cli._locate_options import GroundOptions
from jaxgeo.cli._results import AsJson, given_options, print_json, status_words
from jaxgeo.cli._screen import number_table, print_counts, print_written, track
from jaxgeo.cli._unseen_ground import print_unseen

HIT = "hit"  # the status of a whole footprint
COVERED = "covered_share"  # column of a file
STYLED = (".geojson", ".json", ".gpkg")
ENDINGS = (*STYLED, ".kml", ".kmz")
COLUMNS = {
    "shot": ("shot", "d"),
    "name": ("image", ""),
    "area_km2": ("area, km2", ".3f"),
    "covered_area_km2": ("partial, km2", ".3f"),
    "covered_share": ("of image", ".1%"),
    "hidden_m": ("hidden, m", ".1f"),
    "columns_m": ("columns", ".3f"),
    "rows_m": ("rows", ".3f"),
    "along_m": ("along", ".3f"),
    "across_m": ("across", ".3f"),
    "status": ("status", ""),
}
PARTIAL = (
    "partial: area of the part of the image that sees known ground, where the footprint is incomplete; of image: its "
    "share of the image; "
)
CAPTION = (
    "hidden: length of the outline over ground hidden by terrain; columns, rows, along, across: GSD (m) per column, "
    "per row, along and across the line of sight, at the image centre"
)


def footprint_command(
    given: ExposureOrShotOptions,
    ground: GroundOptions,
    how: ReadingOptions = ReadingOptions(),
    output: Annotated[
        pathlib.Path | None,
        typer.Option("--output", "-o", metavar="FILE", help=f"File to write ({', '.join(ENDINGS)}); default: none."),
    ] = None,
    crs: Annotated[
        str, typer.Option(metavar="CRS", help='CRS of the file: "EPSG:4326", "EPSG:32616", ...')
    ] = "EPSG:4326",
    tolerance: Annotated[float, typer.Option(help="Tolerance of the outline, m.")] = 1.0,
    edges: Annotated[bool, typer.Option("--edges", help="Also write lines along visible and over hidden ground.")] = (
        False
    ),
    style: Annotated[
        bool, typer.Option("--style", help="With --output: also a style for QGIS, in a .gpkg, or beside it (.qml).")
    ] = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Image footprints on the terrain: outlines for a map, areas, and ground sample distance (GSD) at the centre."""
    inputs = with_ground(given_options(locals()))
    with report_errors(debug):
        if output is not None:
            _check_output(output)
        if style and (output is None or output.suffix.lower() not in STYLED):
            raise UserError(f"--style needs --output FILE ({', '.join(STYLED)}).")
        if not tolerance > 0.0:
            raise UserError(f"--tolerance {tolerance:g}: must be above 0 m.")
        given.check(how)
        check_ground(ground)
        check_no_overwrite("--output", output, given.inputs(how), ground.dem, ground)
        exposures, rows, outlines, terrain = _footprint((given, how), ground, output, (crs, tolerance, edges, style))
        height = "height_above_takeoff_m" if has_no_datum(how, ground) else "height_m"
        _show(exposures, rows, outlines, inputs if as_json else None, height)
    if not any(row["status"] == HIT for row in rows):
        print_unseen("no footprint is complete", terrain, exposures.exposures[0].shot)
        raise typer.Exit(NO_ANSWER)


def _check_output(output: pathlib.Path) -> None:
    if output.suffix.lower() not in ENDINGS:
        raise UserError(f"--output {output}: {name_says(output)}; use {', '.join(ENDINGS)}.")
    check_place("--output", output)


def _footprint(
    of: tuple[ExposureOrShotOptions, ReadingOptions],
    ground: GroundOptions,
    output: pathlib.Path | None,
    drawn: tuple[str, float, bool, bool],
) -> tuple[GivenExposures, list[dict[str, Any]], list[Any], Any]:
    """(exposures, table rows, footprints, terrain), written to `output` if given."""
    from jaxgeo._checks import enable_x64
    from jaxgeo.io import write_footprints
    from jaxgeo.io.footprints import check_footprint_file, check_is_flat

    compile_quickly()
    enable_x64()
    crs, tolerance, edges, style = drawn
    given, how = of
    how = with_known_heights(how, given.files or [], given.scene, ground.dem or [], ground)
    found = given.read(how, "a footprint without --shots", ground)
    attributes = _attributes([{"name": one.name} if found.are_named else one.cells for one in found.exposures])
    if output is not None:
        if has_no_datum(how, ground):
            check_is_flat(output, crs)
        note_far_crs(crs, found.exposures[0].shot)
        check_footprint_file(output, crs, attributes, len(found.exposures))
    terrain = None if ground.level is not None else read_terrain(ground.dem or [], ground, found.view)
    outlines, rows = [], []
    for index, one in enumerate(track(found.exposures, "computing footprints")):
        outline, row = _footprint_of(one, level_at(one.shot, ground) if terrain is None else terrain, tolerance)
        outlines.append(outline)
        rows.append({"shot": index, **({"name": one.name} if found.are_named else {}), **row})
    if output is not None:
        attributes = [one | {COVERED: _covered(row)} for one, row in zip(attributes, rows, strict=True)]
        write_footprints(output, outlines, crs=crs, attributes=attributes, edges=edges, style=style)
        print_written(output)
    return found, rows, outlines, terrain


def _show(
    exposures: GivenExposures,
    rows: list[dict[str, Any]],
    outlines: list[Any],
    inputs: dict[str, Any] | None,
    height: str,
) -> None:
    """Print a table, or with `inputs` the full result as JSON, with heights by a name; status counts on stderr."""
    from jaxgeo.io.footprints import WHOLE

    names = [row["status"] for row in rows]
    print_counts({name: names.count(name) for name in names}, len(names), "footprint", WHOLE)
    if inputs is not None:
        each = zip(rows, outlines, strict=True)
        content = [{**row, **status_words(one.status, WHOLE), "outline": _places(one, height)} for row, one in each]
        print_json("footprint", {"inputs": inputs, "footprints": content, "unread": exposures.unread})
        return
    other = "shot" if exposures.are_named else "name"
    is_partial = any(row["covered_share"] is not None for row in rows)
    left_out = {other} if is_partial else {other, "covered_area_km2", "covered_share"}
    columns = {name: column for name, column in COLUMNS.items() if name not in left_out}
    caption = f"{PARTIAL}{CAPTION}" if is_partial else CAPTION
    Console(width=None if Console().is_terminal else 160).print(number_table(rows, columns, caption))


def _places(outline: Any, height: str) -> list[dict[str, Any]]:
    """Ground points of the image edge: clockwise in the image, from its upper left corner; `height` names theirs."""
    import numpy as np

    numbers = zip(*(np.asarray(one) for one in outline.fix.position.to_degrees()), strict=True)
    each = zip(np.asarray(outline.uv), numbers, np.asarray(outline.hidden), strict=True)
    names = ("lat_deg", "lon_deg", height)
    return [
        {"u": u, "v": v, **dict(zip(names, place, strict=True)), "jumps_to_next": bool(hidden)}
        for (u, v), place, hidden in each
    ]


def _footprint_of(one: GivenExposure, terrain: Any, tolerance: float) -> tuple[Any, dict[str, Any]]:
    """(footprint of an exposure, its table row)."""
    from jaxgeo.coverage import covered_part, footprint, ground_sample_distance
    from jaxgeo.io.observations import frame_camera_of
    from jaxgeo.status import Status

    camera, air = frame_camera_of(one.sensor), one.atmosphere
    middle = [0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]
    outline = footprint(one.sensor, one.shot, terrain, tolerance=tolerance, atmosphere=air)
    pixel = ground_sample_distance(one.sensor, one.shot, middle, terrain, atmosphere=air)
    sizes = {f"{name}_m": _known(getattr(pixel, name)) for name in ("columns", "rows", "along", "across")}
    area = _known(1e-6 * outline.area)
    row = {"area_km2": area, "covered_area_km2": None, COVERED: None}
    if not outline.ok:
        part = covered_part(one.sensor, one.shot, terrain, atmosphere=air, projection=outline.projection)
        row |= {"covered_area_km2": 1e-6 * part.area, "covered_share": part.share} if part.share else {}
    row |= {"hidden_m": _known(outline.hidden_length), **sizes}
    return outline, {**row, "status": Status(int(outline.status)).name}


def _covered(row: dict[str, Any]) -> float:
    """Share of an image that sees known ground, 0 to 1."""
    return 1.0 if row["status"] == HIT else row[COVERED] or 0.0


def _known(number: Any) -> float | None:
    return float(number) if math.isfinite(number) else None


def _attributes(carried: Iterable[dict[str, str]]) -> list[dict[str, Any]]:
    """Columns of a table of shots, except names used by the file itself; numeric if all cells are."""
    from jaxgeo.io.footprints import TAKEN

    rows = list(carried)
    kept = [name for name in rows[0] if name.lower() not in (*TAKEN, COVERED)]
    columns = {name: numbers_or_texts([row[name] for row in rows]) for name in kept}
    return [{name: columns[name][index] for name in kept} for index in range(len(rows))]
