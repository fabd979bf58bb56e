"""`jaxgeo report`: ground coordinates of pixels and their accuracy, as one self-contained HTML page."""

from __future__ import annotations

import pathlib
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
from jaxgeo.cli._locate_results import LocateResults, leave_without_a_fix, located
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
from jaxgeo.cli._screen import print_counts, working

ENDINGS = (".html", ".htm")


def report_command(
    output: Annotated[
        pathlib.Path,
        typer.Option("--output", "-o", metavar="FILE", help="HTML page to write (.html).", rich_help_panel=WRITING),
    ],
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
    title: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Page title (default: from the scene or file).", rich_help_panel=WRITING),
    ] = None,
    details: Annotated[
        int,
        typer.Option(
            metavar="COUNT",
            help="Number of fixes shown in detail (median, worst, best CE90 first).",
            rich_help_panel=WRITING,
        ),
    ] = 3,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Write a self-contained HTML page: map, fixes and their accuracy, error budgets, and assumptions."""
    with report_errors(debug):
        _check_report(output, probability, details)
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
        pixels, exposures = pixel or [], exposure or []
        seen = (files or [], scene, shots, pixels, exposures, dem or [], ground, vertical_datum, refraction)
        reading = DemReading(nodata, height_unit, dem_band, dem_bounds, assume_wgs84, allow_remote, allow_outside)
        asked = LocateOptions(*seen, how, sigmas, reading)
        with destination("--output", output) as stream_of_page:
            question, found = _report(asked, probability, (output, stream_of_page), (title, details), as_json)
        leave_without_a_fix(question, found)


def _check_report(output: pathlib.Path, probability: float, details: int) -> None:
    if not is_device(output):
        check_place("--output", output)
        if output.suffix.lower() not in ENDINGS:
            raise UserError(f"--output {output}: {name_says(output)}; use .html.")
    if not 0.0 < probability < 1.0:
        raise UserError(f"--probability {probability:g}: must be between 0 and 1.")
    if details < 0:
        raise UserError(f"--details {details}: must be a number of fixes, 0 or more.")


def _report(
    asked: LocateOptions,
    probability: float,
    where: tuple[pathlib.Path, Any],
    drawn: tuple[str | None, int],
    as_json: bool,
) -> tuple[LocateInputs, LocateResults]:
    from jaxgeo._checks import enable_x64

    output, stream = where
    title, most = drawn
    with working("starting"):
        from jaxgeo.report import ReportHeader, details_of, report_html
    compile_quickly(asked.samples_of_field)
    enable_x64()
    question = told_question(asked, _errs(asked), output)
    found = located(question, probability)
    subject = _subject(question, found, probability)
    with working("computing details"):
        details = details_of(subject, most=most)
    told = ReportHeader(title or _title(asked), _inputs(asked, question), [*question.assumed, *_unread(question)])
    with working("drawing"):
        stream.write(report_html(subject, header=told, details=details))
    rows = found.rows("report", question)
    names = [row["status"] for row in rows]
    print_counts({name: names.count(name) for name in names}, len(names))
    if as_json:
        content = {"fixes": rows, "details": [detail.to_dict() for detail in details]}
        print_json("report", {"inputs": question.inputs, "assumed": question.assumed, **content})
    return question, found


def _subject(question: LocateInputs, found: LocateResults, probability: float) -> Any:
    """Report data of the pixels whose file was read."""
    import jax
    import numpy as np

    from jaxgeo.report import ReportData
    from jaxgeo.sensor import Shot

    first, rows = question.batches[0], question.read
    shots, uv, axes, looks = first.shots, first.uv, first.axes, None
    if len(question.batches) > 1:
        given = [question.look(int(row)) for row in rows]
        pose = jax.tree.map(lambda *leaves: np.stack(leaves), *(shot.pose for _, shot, _, _, _ in given))
        shots, uv = Shot(pose, np.zeros((len(rows), 0))), np.stack([one[2] for one in given])
        axes, looks = (0, *axes[1:]), given.__getitem__
    here = found.part(rows)
    return ReportData(
        first.sensor,
        shots,
        uv,
        first.terrain,
        first.errors,
        here.fixes,
        here.accuracy,
        axes,
        question.atmosphere,
        probability,
        [question.carried[row] for row in rows],
        looks,
    )


def _unread(question: LocateInputs) -> list[str]:
    return [f"Not read: {reason}" for reason in question.reasons or () if reason is not None]


def _errs(asked: LocateOptions) -> bool | None:
    """For a table of shots, whether its scene or an option states error sources; None for other inputs."""
    from jaxgeo.io.scene import read_scene

    if asked.shots is None or asked.scene is None:
        return None
    return asked.sigmas.are_given or read_scene(asked.scene).errors is not None


def _title(asked: LocateOptions) -> str:
    """Title of the scene, or one with the file name."""
    from jaxgeo.io.scene import read_scene

    if not asked.is_scene:
        more = f" and {len(asked.files) - 1} more" if len(asked.files) > 1 else ""
        return f"Ground coordinates and accuracy: {asked.files[0].name}{more}"
    path = asked.scene_file
    assert path is not None
    return read_scene(path).title or f"Ground coordinates and accuracy: {path.name}"


def _inputs(asked: LocateOptions, question: LocateInputs) -> dict[str, Any]:
    """The options as typed, with pixels and exposures."""
    named = {"pixel": " and ".join(asked.pixels), "exposure": ", ".join(asked.exposures)}
    return question.inputs | {name: text for name, text in named.items() if text}
