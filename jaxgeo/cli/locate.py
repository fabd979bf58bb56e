"""`jaxgeo locate`: ground coordinates of pixels and their accuracy."""

from __future__ import annotations

import functools
import pathlib
from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Any

import typer

from jaxgeo._destination import check_place, destination, is_device
from jaxgeo.cli._acquisitions import (
    CameraName,
    GimbalAngles,
    InteriorFile,
    KeepDamaged,
    NoVelocities,
    PositionsFile,
    SbetErrors,
    SourceCrs,
    SourceDatum,
    Stream,
    TakeoffHeight,
    Upright,
    VideoSize,
    how_to_read,
)
from jaxgeo.cli._common import Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._errors import (
    AttitudeSigma,
    DemCorrelation,
    DemSigma,
    FocalSigma,
    GimbalSigma,
    PositionSigma,
    PrincipalSigma,
    Sigmas,
)
from jaxgeo.cli._exposures import ExposureSet
from jaxgeo.cli._inputs import DemReading
from jaxgeo.cli._locate_inputs import LocateInputs, told_question
from jaxgeo.cli._locate_options import (
    Exposures,
    Ground,
    GroundDatum,
    GroundDem,
    LocateOptions,
    Pixels,
    Refraction,
    SceneOption,
    Source,
    TableOfShots,
)
from jaxgeo.cli._locate_results import LocateResults, fixes_in_parts, fixes_table, leave_without_a_fix, located
from jaxgeo.cli._options import (
    SURE,
    WRITING,
    AllowOutside,
    AllowRemote,
    AssumeWgs84,
    DemBand,
    DemBounds,
    HeightUnit,
    Nodata,
)
from jaxgeo.cli._results import AsJson, print_json
from jaxgeo.cli._screen import print_counts

ENDINGS = (".csv", ".geojson", ".json", ".gpkg", ".parquet", ".kml", ".kmz")


class Format(StrEnum):
    """Output format for the terminal, a pipe, or a file of any name."""

    table = "table"
    csv = "csv"
    geojson = "geojson"


OF_FORMAT = {Format.table: (".csv",), Format.csv: (".csv",), Format.geojson: (".geojson", ".json")}


def locate_command(
    files: Source = None,
    scene: SceneOption = None,
    shots: TableOfShots = None,
    pixel: Pixels = None,
    exposure: Exposures = None,
    dem: GroundDem = None,
    vertical_datum: GroundDatum = None,
    ground: Ground = None,
    nodata: Nodata = None,
    height_unit: HeightUnit = None,
    dem_band: DemBand = None,
    dem_bounds: DemBounds = None,
    assume_wgs84: AssumeWgs84 = None,
    allow_remote: AllowRemote = None,
    allow_outside: AllowOutside = None,
    accuracy: Annotated[
        bool | None,
        typer.Option(
            "--accuracy/--no-accuracy",
            help="Report CE/LE/SE; on by default if the input states errors, except for --shots.",
            show_default=False,
            rich_help_panel=SURE,
        ),
    ] = None,
    probability: Annotated[
        float,
        typer.Option(metavar="SHARE", help="Confidence level of CE/LE/SE.", rich_help_panel=SURE),
    ] = 0.9,
    position_sigma: PositionSigma = None,
    attitude_sigma: AttitudeSigma = None,
    gimbal_sigma: GimbalSigma = None,
    focal_sigma: FocalSigma = None,
    principal_sigma: PrincipalSigma = None,
    dem_sigma: DemSigma = None,
    dem_correlation: DemCorrelation = None,
    refraction: Refraction = False,
    height_datum: SourceDatum = None,
    takeoff_height: TakeoffHeight = None,
    source_crs: SourceCrs = None,
    camera: CameraName = None,
    gimbal: GimbalAngles = None,
    image_size: VideoSize = None,
    upright: Upright = False,
    keep_damaged: KeepDamaged = False,
    stream: Stream = None,
    errors: SbetErrors = None,
    no_velocities: NoVelocities = False,
    interior: InteriorFile = None,
    positions: PositionsFile = None,
    output: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help=f"File to write ({', '.join(ENDINGS)}); default: the terminal.",
            rich_help_panel=WRITING,
        ),
    ] = None,
    output_format: Annotated[
        Format | None,
        typer.Option(
            "--format",
            help="Terminal format (default: table, or csv for --shots).",
            show_default=False,
            rich_help_panel=WRITING,
        ),
    ] = None,
    crs: Annotated[
        str,
        typer.Option(
            metavar="CRS", help='CRS of the --output: "EPSG:4326", "EPSG:32616", ...', rich_help_panel=WRITING
        ),
    ] = "EPSG:4326",
    heights: Annotated[
        str | None,
        typer.Option(
            metavar="DATUM",
            help='Vertical datum of the --output: "ellipsoid", "EPSG:5773", ...',
            rich_help_panel=WRITING,
        ),
    ] = None,
    mgrs: Annotated[
        bool,
        typer.Option("--mgrs", help="With --output: also MGRS coordinates.", rich_help_panel=WRITING),
    ] = False,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Ground coordinates of pixels and their accuracy: one row per pixel, with a status."""
    with report_errors(debug):
        how = how_to_read(
            height_datum,
            takeoff_height,
            source_crs,
            camera,
            image_size,
            (upright, keep_damaged, stream),
            errors,
            interior,
            no_velocities,
            gimbal,
            positions=positions,
        )
        sigmas = Sigmas(
            position_sigma, attitude_sigma, gimbal_sigma, focal_sigma, dem_sigma, dem_correlation, principal_sigma
        )
        asked = LocateOptions(
            files or [],
            scene,
            shots,
            pixel or [],
            exposure or [],
            dem or [],
            ground,
            vertical_datum,
            refraction,
            how,
            sigmas,
            DemReading(nodata, height_unit, dem_band, dem_bounds, assume_wgs84, allow_remote, allow_outside),
        )
        if not 0.0 < probability < 1.0:
            raise UserError(f"--probability {probability:g}: must be between 0 and 1.")
        if accuracy is False and sigmas.are_given:
            raise UserError("--no-accuracy contradicts standard deviations (--...-sigma); leave one out.")
        is_file = _is_file(output, output_format)
        if not is_file and (crs != "EPSG:4326" or heights is not None or mgrs):
            raise UserError(f"--crs, --heights and --mgrs need --output FILE ({', '.join(ENDINGS)}).")
        _locate(asked, accuracy, probability, (output, is_file, output_format), (crs, heights, mgrs), as_json)


def _is_file(output: pathlib.Path | None, asked: Format | None) -> bool:
    """Whether the output is a file whose extension determines its format."""
    if output is None or is_device(output):
        return False
    check_place("--output", output)
    if asked is None and output.suffix.lower() not in ENDINGS:
        raise UserError(
            f"--output {output}: {name_says(output)}; use {', '.join(ENDINGS)}, or give --format table, csv or geojson."
        )
    if asked is not None and output.suffix.lower() in ENDINGS and output.suffix.lower() not in OF_FORMAT[asked]:
        raise UserError(f"--format {asked.value} conflicts with --output {output}; leave one out.")
    return asked is None


def _format(output: pathlib.Path | None, asked: Format | None, shots: pathlib.Path | None) -> Format:
    """Format of rows on the terminal or a pipe, whose name may have an extension."""
    by_name = {".csv": Format.csv, ".geojson": Format.geojson, ".json": Format.geojson}
    usual = Format.table if shots is None else Format.csv
    return asked or (usual if output is None else by_name.get(output.suffix.lower(), usual))


def _locate(
    asked: LocateOptions,
    accuracy: bool | None,
    probability: float,
    where: tuple[pathlib.Path | None, bool, Format | None],
    drawn: tuple[str, str | None, bool],
    as_json: bool,
) -> None:
    from jaxgeo._checks import enable_x64

    output, is_file, output_format = where
    if is_file or as_json:
        compile_quickly(asked.samples_of_field)
        enable_x64()
        check = functools.partial(_check_file, output, drawn, probability) if output is not None and is_file else None
        question = told_question(asked, accuracy, output, check)
        found = located(question, probability)
        _finish(question, found, probability, output if is_file else None, drawn, as_json)
        return
    with destination("--output", output) as stream:
        compile_quickly(asked.samples_of_field)
        enable_x64()
        question = told_question(asked, accuracy, output)
        chosen = _format(output, output_format, asked.shots)
        counts: dict[str, int] = {}
        if chosen is Format.table or question.has_errors or question.is_each:
            found = located(question, probability)
            rows = found.rows("--output", question)
            counts |= _counts(rows)
        else:
            found, rows = None, _rows(question, counts)
            if stream.isatty():  # a progress bar on the same terminal would break the rows
                rows = list(rows)
        if chosen is Format.table:
            print_counts(counts, len(question.carried))
        _write_rows(rows, question, probability if found and found.accuracy is not None else None, chosen, stream)
        stream.flush()
    if chosen is not Format.table:  # after the rows, not between them
        print_counts(counts, len(question.carried))
    if found is not None:
        leave_without_a_fix(question, found)


def _check_file(
    output: pathlib.Path, drawn: tuple[str, str | None, bool], probability: float, views: ExposureSet, has_errors: bool
) -> None:
    """Raises if the output file cannot be written as requested, before the ground is read."""
    from jaxgeo.io.fix_files import check_fix_file

    crs, heights, mgrs = drawn
    check_fix_file(
        output,
        crs,
        heights,
        views.position,
        attributes=_typed(views.carried, views.readings),
        mgrs=mgrs,
        reasons=views.reasons,
        probability=probability if has_errors else None,
    )


def _finish(
    question: LocateInputs,
    found: LocateResults,
    probability: float,
    output: pathlib.Path | None,
    drawn: tuple[str, str | None, bool],
    as_json: bool,
) -> None:
    """Write the file, then the terminal output."""
    rows = found.rows("locate", question)
    if output is not None:
        from jaxgeo.io import write_fixes

        crs, heights, mgrs = drawn
        carried = _typed(question.carried, question.readings)
        level = probability if found.accuracy is not None else None
        write_fixes(
            output,
            found.fixes,
            accuracy=found.accuracy,
            probability=level,
            crs=crs,
            heights=heights,
            attributes=carried,
            mgrs=mgrs,
            reasons=question.reasons,
        )
    print_counts(_counts(rows), len(rows))
    if as_json:
        print_json("locate", {"inputs": question.inputs, "assumed": question.assumed, "fixes": rows})
    leave_without_a_fix(question, found)


def _typed(carried: list[dict[str, Any]], readings: tuple[str, ...]) -> list[dict[str, Any]]:
    """Carried columns; numeric columns of a table of shots as numbers, NaN as None."""
    from jaxgeo.io.tables import number_columns

    numbers = number_columns(readings)
    return [{name: _number(value) if name in numbers else value for name, value in row.items()} for row in carried]


def _number(value: Any) -> float | None:
    import math

    number = math.nan if value is None else float(value)
    return number if math.isfinite(number) else None


def _rows(question: LocateInputs, counts: dict[str, int]) -> Iterator[dict[str, Any]]:
    """Rows of fixes without accuracy, as they are computed; statuses are counted in `counts`."""
    from jaxgeo.io import height_msl
    from jaxgeo.io.tables import fix_rows

    for start, fixes in fixes_in_parts(question):
        for i, row in enumerate(fix_rows(fixes, height_msl(fixes)), start):
            counts[row["status"]] = counts.get(row["status"], 0) + 1
            yield {**question.carried[i], **row}


def _counts(rows: list[dict[str, Any]]) -> dict[str, int]:
    names = [row["status"] for row in rows]
    return {name: names.count(name) for name in dict.fromkeys(names)}


def _write_rows(
    rows: Any, question: LocateInputs, probability: float | None, output_format: Format, stream: Any
) -> None:
    from jaxgeo.io.tables import number_columns, write_csv, write_geojson

    if output_format is Format.csv:
        write_csv(rows, stream)
    elif output_format is Format.geojson:
        write_geojson(rows, stream, number_columns(question.readings))
    else:
        console = Console(file=stream, width=None if stream.isatty() else 160, highlight=False)
        console.print(fixes_table(rows, probability, console.width))
        if len(rows) == 1 and rows[0].get("accuracy_text"):
            console.print(rows[0]["accuracy_text"], markup=False, soft_wrap=True)
