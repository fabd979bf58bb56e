"""`jaxgeo register`: exterior orientation of an image from a map, and the accuracy of its pixels."""

from __future__ import annotations

import pathlib
import time
from typing import Annotated, Any

import typer

from jaxgeo.cli._common import NO_ANSWER, Debug, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._inputs import DemReading, read_terrain, shot_of, terrain_files
from jaxgeo.cli._option_names import reach_as_typed
from jaxgeo.cli._options import (
    AllowOutside,
    AllowRemote,
    AssumeWgs84,
    DemBandBesideBand,
    DemBounds,
    DemFiles,
    HeightUnit,
    Nodata,
    SceneFile,
    VerticalDatum,
)
from jaxgeo.cli._register_inputs import Errors, Sigmas, check_folder, check_search, errors_of, new_results, pixels_in
from jaxgeo.cli._register_outputs import Work, reported, written
from jaxgeo.cli._results import AsJson, asked
from jaxgeo.cli._screen import tell, working


def register_command(
    image: Annotated[
        pathlib.Path, typer.Argument(metavar="IMAGE", help="Image file, same size as the scene's camera.")
    ],
    reference: Annotated[pathlib.Path, typer.Option(metavar="FILE", help="Orthoimage of the same area, in any CRS.")],
    dem: DemFiles,
    scene: SceneFile,
    output: Annotated[
        pathlib.Path,
        typer.Option("--output", "-o", metavar="FOLDER", help="Output folder; created if missing."),
    ],
    position_sigma: Annotated[
        str, typer.Option(metavar="SIGMA", help="Position standard deviation, m, or NORTH,EAST,DOWN.")
    ],
    attitude_sigma: Annotated[
        str, typer.Option(metavar="SIGMA", help="Attitude standard deviation, deg, or HEADING,PITCH,ROLL.")
    ],
    gimbal_sigma: Annotated[
        str | None,
        typer.Option(metavar="SIGMA", help="Gimbal reading standard deviation, deg, or one per axis (default: exact)."),
    ] = None,
    focal_sigma: Annotated[
        str | None,
        typer.Option(metavar="SIGMA", help="Also estimate the focal length, with prior sigma 5px, 0.1mm."),
    ] = None,
    principal_sigma: Annotated[
        str | None,
        typer.Option(
            metavar="SIGMA",
            help="Also estimate the principal point, with prior sigma 5px, 0.1mm, or COLUMN,ROWpx.",
        ),
    ] = None,
    reference_sigma: Annotated[
        float | None,
        typer.Option(
            help="Position sigma of the whole reference, m (default: one cell). It cannot be estimated "
            "from one image: the value is your guarantee."
        ),
    ] = None,
    registration_sigma: Annotated[
        float, typer.Option(help="Minimum sigma of a match besides its own, m; increased by residuals.")
    ] = 0.0,
    dem_sigma: Annotated[float | None, typer.Option(help="DEM height standard deviation, m (default 5).")] = None,
    dem_correlation: Annotated[
        float | None,
        typer.Option(help="Correlation length of DEM errors, m (default 500; 0: uncorrelated)."),
    ] = None,
    vertical_datum: VerticalDatum = None,
    nodata: Nodata = None,
    height_unit: HeightUnit = None,
    dem_band: DemBandBesideBand = None,
    dem_bounds: DemBounds = None,
    assume_wgs84: AssumeWgs84 = None,
    allow_remote: AllowRemote = None,
    allow_outside: AllowOutside = None,
    block: Annotated[int, typer.Option(help="Largest block size, cells; 32 or more.")] = 300,
    probability: Annotated[
        float, typer.Option(help="Probability that the true shift is inside the search window; between 0.5 and 1.")
    ] = 0.999,
    pixel: Annotated[
        list[str] | None,
        typer.Option(metavar="PIXEL", help="COLUMN,ROW of a pixel to locate (repeatable; default: image centre)."),
    ] = None,
    band: Annotated[list[int] | None, typer.Option(help="Image band, from 1 (repeatable).")] = None,
    reference_band: Annotated[list[int] | None, typer.Option(help="Reference band, from 1 (repeatable).")] = None,
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Estimate the exterior orientation of an image from a map, and the accuracy of its pixels' ground points.

    Writes scene.toml, ties.geojson, ortho.tif, report.json and registration.png into the folder. The exit code is 1
    if the image is not registered: then there is no scene and no orthoimage, and the report has the reason.
    """
    typed = asked(locals())
    with report_errors(debug):
        from jaxgeo.io.paths import files_behind
        from jaxgeo.io.registration_report import write_registration_report

        check_search(block, probability)
        began = time.perf_counter()
        sigmas = Sigmas(
            position_sigma,
            attitude_sigma,
            gimbal_sigma,
            focal_sigma,
            reference_sigma,
            registration_sigma,
            dem_sigma,
            dem_correlation,
            principal_sigma,
        )
        ground = (
            dem,
            vertical_datum,
            DemReading(nodata, height_unit, dem_band, dem_bounds, assume_wgs84, allow_remote, allow_outside),
        )
        rasters = [file for one in (image, reference) for file in files_behind(one, ground[2].reach)]
        check_folder(output, [*rasters, scene, *terrain_files(*ground)])
        work, errors, pixels = _read(image, reference, ground, scene, sigmas, pixel or [], (band, reference_band))
        output.mkdir(parents=True, exist_ok=True)
        for one in errors.assumed:
            tell(f"assumed: {one}")
        with working("compiling and registering"):
            found = _registered(work, errors, block, probability)
        found_by = time.perf_counter() - began
        inputs = {name: value for name, value in typed.items() if not name.endswith("_sigma")}
        inputs |= {"sigmas": sigmas._asdict()}
        with new_results(output):
            content = written(work, errors, pixels, found, output) | {"inputs": inputs}
            content["seconds"] = {"registration": found_by, "all": time.perf_counter() - began}
            write_registration_report(output / "report.json", content)
        reported(content, output, found, as_json)
    if not found.accepted:
        raise typer.Exit(NO_ANSWER)


def _read(
    image: pathlib.Path,
    reference_path: pathlib.Path,
    ground: tuple[list[str], str | None, DemReading],
    scene_path: pathlib.Path,
    sigmas: Sigmas,
    pixels: list[str],
    bands: tuple[list[int] | None, list[int] | None],
) -> tuple[Work, Errors, list[list[float]]]:
    """Read all inputs, small and error-prone ones first."""
    from jaxgeo._checks import enable_x64
    from jaxgeo.io import read_image, read_orthoimage_and_report
    from jaxgeo.io.images import check_size
    from jaxgeo.io.orthoimages import raster_of_file
    from jaxgeo.io.scene import read_scene

    compile_quickly()
    enable_x64()
    scene = read_scene(scene_path)
    shot = shot_of(scene, scene_path, "a registration")
    errors_of(sigmas, scene, scene_path, 1.0)  # checks the options early
    uv = pixels_in(pixels, scene.sensor.camera)
    reach = ground[2].reach
    how = {"allow_remote": reach.remote, "allow_outside": reach.outside}
    with reach_as_typed():
        raster_of_file(reference_path, reach)
        values, known = read_image(image, bands[0], **how)
    check_size(str(image), values.shape, scene.sensor.camera)
    with reach_as_typed():
        reference, report = read_orthoimage_and_report(reference_path, bands[1], **how)
    terrain = read_terrain(*ground)
    errors = errors_of(sigmas, scene, scene_path, reference.ground_sampling)
    work = Work(image, values, known, scene_path, scene, shot, reference, report.raster, terrain, bands[0])
    return work, errors, uv


def _registered(work: Work, errors: Errors, block: int, probability: float) -> Any:
    from jaxgeo.register import register_image
    from jaxgeo.uncertainty import ErrorModel

    return register_image(
        work.scene.sensor,
        work.shot,
        work.values,
        work.reference,
        work.terrain,
        ErrorModel(errors.sources),
        errors.tie_errors,
        known=work.known,
        block=block,
        probability=probability,
        atmosphere=work.scene.atmosphere,
    )
