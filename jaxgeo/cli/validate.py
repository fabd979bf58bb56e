"""`jaxgeo validate`: whether stated errors are those at surveyed check points, and calibrated ones."""

from __future__ import annotations

import contextlib
import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
import typer

from jaxgeo._destination import check_no_input, check_place, destination, is_device
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import Debug, UserError, name_says, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._errors import Sigmas, checked_sigma
from jaxgeo.cli._inputs import as_datum, numbers_in
from jaxgeo.cli._locate_inputs import LocateInputs, read_inputs
from jaxgeo.cli._locate_options import GroundOptions, LocateOptions, ObservationOptions, Refraction
from jaxgeo.cli._options import SEEN, SURE, WRITING, OptionGroup, SceneOfFiles
from jaxgeo.cli._results import AsJson, print_json
from jaxgeo.cli._screen import print_note, print_written, working

if TYPE_CHECKING:
    from jaxgeo.io import SurveyedPixels

PICTURES = (".png", ".pdf", ".svg")
USUAL_SURVEY, USUAL_PIXEL = 0.05, 1.0  # m, pixels


@dataclasses.dataclass(frozen=True, kw_only=True)
class PointOptions(OptionGroup):
    """Images, and points with their pixels."""

    panel: ClassVar[str | None] = SEEN

    files: Annotated[
        list[pathlib.Path] | None,
        typer.Argument(
            metavar="FILE",
            help="Drone images or folders, table, reconstruction, or others that jaxgeo locate reads; or a scene.",
            show_default=False,
        ),
    ] = None
    points: Annotated[
        pathlib.Path,
        typer.Option(
            "--points",
            metavar="FILE",
            help="Surveyed points with their pixels: gcp_list.txt of OpenDroneMap, or CSV (image, point, u, v, "
            "lat_deg, lon_deg, height_m).",
        ),
    ]
    points_datum: Annotated[
        str | None,
        typer.Option(
            "--points-datum",
            metavar="DATUM",
            help='Vertical datum of the --points: "EPSG:5773", "ellipsoid", an undulation in m.',
        ),
    ] = None
    pixel_origin: Annotated[
        str,
        typer.Option(
            "--pixel-origin", metavar="ORIGIN", help="Pixel (0, 0) of --points: the centre or corner of the first."
        ),
    ] = "centre"
    scene: SceneOfFiles = None
    survey: Annotated[
        str | None,
        typer.Option(
            "--point-sigma",
            metavar="SIGMA",
            help="Standard deviation of the survey, m: one number, or EAST,NORTH,UP (default 0.05).",
            rich_help_panel=SURE,
        ),
    ] = None
    pixel: Annotated[
        float | None,
        typer.Option(
            "--pixel-sigma",
            metavar="SIGMA",
            help="Standard deviation of the measured pixels (default: of the scene, or 1).",
            rich_help_panel=SURE,
        ),
    ] = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class CalibrationOptions(OptionGroup):
    """Calibrated sigmas."""

    panel: ClassVar[str | None] = WRITING

    file: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--calibrate",
            metavar="FILE",
            help="Also estimate the sigmas from the points, and write them as the [errors] table of a scene (.toml).",
        ),
    ] = None
    each_axis: Annotated[
        bool, typer.Option("--each-axis", help="With --calibrate: a factor for each axis of a source.")
    ] = False


def validate_command(
    of_points: PointOptions,
    ground: GroundOptions,
    *,
    sigmas: Sigmas,
    refraction: Refraction = False,
    reading: ReadingOptions,
    output: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Page of charts (.png, .pdf, .svg).", rich_help_panel=WRITING
        ),
    ] = None,
    calibration: CalibrationOptions,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Compare stated errors with the actual ones at surveyed points: their size, shape, bias and coverage."""
    with report_errors(debug):
        _ = reading.arguments  # raises for wrong values
        given = ObservationOptions(files=of_points.files, scene=of_points.scene)
        options = LocateOptions(given, ground, reading, sigmas, refraction)
        _check(of_points, options, output, calibration)
        with contextlib.ExitStack() as stack:
            stream = None if output is None else stack.enter_context(destination("--output", output, binary=True))
            _run(of_points, options, output, stream, calibration, as_json)
        print_written(calibration.file, output)


def _check(
    of_points: PointOptions, options: LocateOptions, output: pathlib.Path | None, calibration: CalibrationOptions
) -> None:
    options.check()
    inputs = [*options.input_files, of_points.points]
    if output is not None and not is_device(output):
        check_place("--output", output)
        check_no_input("--output", [output], inputs)
        if output.suffix.lower() not in PICTURES:
            raise UserError(f"--output {output}: {name_says(output)}; use {', '.join(PICTURES)}.")
    if calibration.file is not None:
        check_place("--calibrate", calibration.file)
        check_no_input("--calibrate", [calibration.file], inputs)
        if calibration.file.suffix.lower() != ".toml":
            raise UserError(f"--calibrate {calibration.file}: {name_says(calibration.file)}; use .toml.")
    elif calibration.each_axis:
        raise UserError("--each-axis is for the calibrated sigmas; give --calibrate FILE too.")
    if of_points.pixel_origin not in ("centre", "corner"):
        raise UserError(f"--pixel-origin {of_points.pixel_origin}: expected centre or corner.")


def _run(
    of_points: PointOptions,
    options: LocateOptions,
    output: pathlib.Path | None,
    stream: Any,
    calibration: CalibrationOptions,
    as_json: bool,
) -> None:
    from jaxgeo._checks import enable_x64
    from jaxgeo.io import check_points_of
    from jaxgeo.uncertainty import calibrate_errors, validate

    compile_quickly(options.has_terrain_field)
    enable_x64()
    surveyed = _surveyed(of_points, options)
    for one in surveyed.unread:
        print_note(f"{of_points.points}: {one}")

    def check(observed: Any, _: bool) -> None:
        """Raise for images that are not there, before the ground is read."""
        check_points_of(observed, surveyed, sigma_enu=1.0, sigma_px=1.0)

    inputs = read_inputs(options, True, output, check)
    assumed = list(inputs.assumed)
    survey, pixel = _sigmas(of_points, surveyed, inputs.observed, assumed)
    print_assumed(assumed[len(inputs.assumed) :])
    points, errors, rows = check_points_of(inputs.observed, surveyed, sigma_enu=survey, sigma_px=pixel)
    ground = _ground(inputs, rows)
    with working("comparing"):
        found = validate(points, ground, errors)
    told: dict[str, Any] = {"validation": found.to_dict()}
    lines = [found.words]
    if calibration.file is not None:
        with working("calibrating"):
            calibrated = calibrate_errors(points, ground, errors, each_axis=calibration.each_axis)
        _write(calibration.file, calibrated)
        told["calibration"] = calibrated.to_dict()
        lines += ["", calibrated.words]
    if stream is not None:
        _draw(found, stream, output)
    if as_json:
        typed = {"points": f"{of_points.points}", "points_datum": of_points.points_datum}
        print_json("validate", {"inputs": options.inputs | typed, "assumed": assumed, **told})
    else:
        Console(soft_wrap=True).print("\n".join(lines), highlight=False, markup=False)


def _ground(inputs: LocateInputs, rows: np.ndarray) -> Any:
    """The elevation model, or level ground of each pixel's image."""
    places = [inputs.observed.place(int(row)) for row in rows]
    ground = inputs.grounds[places[0][0]]
    if not np.ndim(getattr(ground, "height", 0.0)):
        return ground
    return dataclasses.replace(ground, height=np.asarray(ground.height)[[index for _, index in places]])


def _surveyed(of_points: PointOptions, options: LocateOptions) -> SurveyedPixels:
    from jaxgeo.io import VerticalDatumError, read_check_points

    datum = of_points.points_datum
    if datum is None:
        raise UserError(
            f"--points {of_points.points}: state the vertical datum of its heights with --points-datum: "
            "EPSG:5773, ellipsoid, or an undulation in m."
        )
    try:
        return read_check_points(of_points.points, height_datum=as_datum(datum), pixel_origin=of_points.pixel_origin)
    except VerticalDatumError as error:
        raise UserError(f"{error}".replace("height_datum=", "--points-datum ")) from error


def _sigmas(of_points: PointOptions, surveyed: SurveyedPixels, observed: Any, assumed: list[str]) -> tuple[Any, Any]:
    """(sigma of the survey in m, of the pixels, or None for those of the file or scene); assumptions are appended."""
    from jaxgeo.uncertainty.sources import PixelMeasurement

    form = "one number in m, or EAST,NORTH,UP"
    survey: Any = None
    if of_points.survey is not None:
        survey = numbers_in("--point-sigma", of_points.survey, (1, 3), form)
        survey = survey[0] if len(survey) == 1 else survey
    elif surveyed.sigma_enu is None:
        survey = USUAL_SURVEY
        assumed.append(f"Survey sigma: {USUAL_SURVEY:g} m (default). (--point-sigma)")
    pixel = of_points.pixel
    stated = any(isinstance(one, PixelMeasurement) for batch in observed.batches for one in batch.sources)
    if pixel is None and surveyed.sigma_px is None and not stated:
        pixel = USUAL_PIXEL
        assumed.append(f"Pixel sigma: {USUAL_PIXEL:g} (default). (--pixel-sigma)")
    for option, value in (("--point-sigma", survey), ("--pixel-sigma", pixel)):
        for one in np.atleast_1d([] if value is None else value):
            if checked_sigma(option, float(one)) == 0.0:
                raise UserError(
                    f"{option} {one:g}: must be above 0, since a measurement without any error has no test."
                )
    return survey, pixel


def _write(path: pathlib.Path, calibrated: Any) -> None:
    from jaxgeo.io import write_errors

    write_errors(path, calibrated.errors, comment=calibrated.words)


def _draw(found: Any, stream: Any, output: pathlib.Path | None) -> None:
    try:
        from jaxgeo.plot import validation_figure
    except ImportError as error:
        raise UserError(f"--output {output}: {error}") from error
    suffix = "png" if output is None or is_device(output) else output.suffix.lower().removeprefix(".")
    validation_figure(found).savefig(stream, format=suffix)
