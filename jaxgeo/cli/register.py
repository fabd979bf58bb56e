"""`jaxgeo register`: exterior orientation of an image from a map, and the accuracy of its pixels."""

from __future__ import annotations

import contextlib
import dataclasses
import pathlib
import tempfile
import time
from collections.abc import Iterator
from typing import Annotated, Any

import typer

from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._assumed import print_assumed, with_said
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._errors import Sigmas as SigmasOfPixels
from jaxgeo.cli._errors import pixel_pitch_of
from jaxgeo.cli._inputs import read_terrain, shot_of, terrain_files
from jaxgeo.cli._known_heights import with_known_heights
from jaxgeo.cli._option_names import translate_reach_errors, typed
from jaxgeo.cli._options import Compared, DemFiles, DemOptions, DemOptionsBesideBand, Measure
from jaxgeo.cli._register_inputs import Errors, Sigmas, check_folder, check_search, errors_of, new_results, pixels_in
from jaxgeo.cli._register_outputs import Work, print_report, write_results
from jaxgeo.cli._results import AsJson, given_options
from jaxgeo.cli._screen import print_written, working
from jaxgeo.cli.scene import write_scene_of


def register_command(
    image: Annotated[
        pathlib.Path,
        typer.Argument(
            metavar="IMAGE", help="Image file with its own pose (a drone image), or of the size of the scene's camera."
        ),
    ],
    reference: Annotated[pathlib.Path, typer.Option(metavar="FILE", help="Orthoimage of the same area, in any CRS.")],
    dem: DemFiles,
    output: Annotated[
        pathlib.Path,
        typer.Option("--output", "-o", metavar="FOLDER", help="Output folder; created if missing."),
    ],
    sigmas: Sigmas = Sigmas(),
    scene: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--scene",
            metavar="FILE",
            help="Scene file (TOML): camera, gimbal, mount and pose; for an IMAGE that does not state its own.",
        ),
    ] = None,
    reading: DemOptionsBesideBand = DemOptionsBesideBand(),
    how: ReadingOptions = ReadingOptions(),
    block: Annotated[int, typer.Option(help="Largest block size, cells; 32 or more.")] = 300,
    probability: Annotated[
        float, typer.Option(help="Probability that the true shift is inside the search window; between 0.5 and 1.")
    ] = 0.999,
    measure: Measure = Compared.grey,
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
    options = given_options(locals())
    with report_errors(debug):
        from jaxgeo.io.paths import files_behind
        from jaxgeo.io.registration_report import write_registration_report

        check_search(block, probability)
        began = time.perf_counter()
        rasters = [file for one in (image, reference) for file in files_behind(one, reading.reach)]
        own = [one for one in (scene, how.positions) if one is not None]
        check_folder(output, [*rasters, *own, *terrain_files(dem, reading)])
        with _scene_of(image, scene, how, (dem, reading), sigmas) as path:
            files = image, reference, path
            work, errors, pixels = _read(files, dem, reading, sigmas, pixel or [], (band, reference_band))
            output.mkdir(parents=True, exist_ok=True)
            print_assumed(errors.assumed)
            with working("compiling and registering"):
                found = _register(work, errors, block, probability, measure)
            found_by = time.perf_counter() - began
            given = dataclasses.asdict(sigmas)
            inputs = {name: value for name, value in options.items() if name == "dem_correlation" or name not in given}
            inputs |= {"sigmas": given}
            with new_results(output):
                content = write_results(work, errors, pixels, found, output) | {"inputs": inputs}
                content |= {"assumed": with_said(errors.assumed)}
                content["seconds"] = {"registration": found_by, "all": time.perf_counter() - began}
                write_registration_report(output / "report.json", content)
        print_written(output)
        print_report(content, output, found, as_json)
    if not found.accepted:
        raise typer.Exit(NO_ANSWER)


@contextlib.contextmanager
def _scene_of(
    image: pathlib.Path,
    scene: pathlib.Path | None,
    how: ReadingOptions,
    ground: tuple[list[str], DemOptions],
    sigmas: Sigmas,
) -> Iterator[pathlib.Path]:
    """The scene file; of an image that states its own pose one that is written for it. Raises `UserError`."""
    if scene is not None:
        for name in how.arguments:
            raise UserError(f"{typed(name)} is for an IMAGE that states its own pose; leave it out with --scene.")
        yield scene
        return
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / f"{image.name}.toml"
        typed_ones = SigmasOfPixels(position=sigmas.position, dem=sigmas.dem)
        known = with_known_heights(how, [image], None, *ground, typed_ones)
        write_scene_of(image, path, None, None, known)
        yield path


def _read(
    files: tuple[pathlib.Path, pathlib.Path, pathlib.Path],
    dem: list[str],
    reading: DemOptions,
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
    image, reference_path, scene_path = files
    scene = read_scene(scene_path)
    shot = shot_of(scene, scene_path, "a registration")
    pitch = pixel_pitch_of(scene_path)
    known_errors = errors_of(sigmas, scene, scene_path, 1.0, pitch)  # checks the options early
    uv = pixels_in(pixels, scene.sensor.camera)
    reach = reading.reach
    how: dict[str, Any] = {"allow_remote": reach.remote, "allow_outside": reach.outside}
    with translate_reach_errors():
        raster_of_file(reference_path, reach)
        values, known = read_image(image, bands[0], **how)
    check_size(str(image), values.shape, scene.sensor.camera)
    with translate_reach_errors():
        reference, report = read_orthoimage_and_report(reference_path, bands[1], **how)
    terrain = read_terrain(dem, reading, lambda: _view(scene, shot, known_errors))
    errors = errors_of(sigmas, scene, scene_path, reference.ground_sampling, pitch)
    work = Work(image, values, known, scene_path, scene, shot, reference, report.raster, terrain, bands[0])
    return work, errors, uv


def _view(scene: Any, shot: Any, errors: Errors) -> Any:
    from jaxgeo.io.archives import view_of_image

    return view_of_image(scene.sensor, shot, sources=errors.sources)


def _register(work: Work, errors: Errors, block: int, probability: float, measure: Compared) -> Any:
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
        measure=measure.value,
        atmosphere=work.scene.atmosphere,
    )
