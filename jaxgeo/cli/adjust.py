"""`jaxgeo adjust`: mutual correction of overlapping images by tie points, without a map or with some on a map."""

from __future__ import annotations

import filecmp
import pathlib
import time
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import typer

from jaxgeo._destination import check_no_input
from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._adjust_control import ControlOptions
from jaxgeo.cli._adjust_map import MapOptions, rows_to_register
from jaxgeo.cli._adjust_map import on_map as registered_to
from jaxgeo.cli._adjust_mosaic import MosaicOptions
from jaxgeo.cli._adjust_motion import MotionOptions
from jaxgeo.cli._adjust_outputs import (
    FILES,
    check_report,
    content_of,
    locate_command,
    print_summary,
    write_files,
    write_page,
)
from jaxgeo.cli._adjust_rigs import Groups, RigOptions, as_options
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import NO_ANSWER, Debug, UserError, check_writable, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._inputs import read_terrain, terrain_files, view_of_shots
from jaxgeo.cli._option_names import as_typed, translate_reach_errors
from jaxgeo.cli._options import WRITING, Compared, DemFiles, DemOptions, Measure
from jaxgeo.cli._oriented_images import OrientedImages
from jaxgeo.cli._results import AsJson, given_options, print_json
from jaxgeo.cli._screen import print_note, print_written, progress_bar, working

if TYPE_CHECKING:
    from jaxgeo.adjust import Unknowns
    from jaxgeo.ties import AbstractFeatures, Control, Correction, KeptMatches, MapControl, Matching, Ties, Views

MATCHES = "matches"  # folder in that of the results, with those of the pairs
INTERIOR = 0.005, 0.002, 0.002  # of the focal length: sigmas of focal length and principal point, if none is stated


def adjust_command(
    files: Annotated[
        list[pathlib.Path],
        typer.Argument(metavar="FILE", help="Drone images, a folder of them, or a file with the poses of --images."),
    ],
    dem: DemFiles,
    output: Annotated[
        pathlib.Path,
        typer.Option(
            "--output", "-o", metavar="FOLDER", help="Output folder; created if missing.", rich_help_panel=WRITING
        ),
    ],
    *,
    images: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--images", metavar="FOLDER", help="Images by name, if FILE is a file of poses (a reconstruction, a table)."
        ),
    ] = None,
    dem_sigma: Annotated[
        float, typer.Option("--dem-sigma", metavar="METRES", help="Height sigma of --dem, m; limits the search.")
    ] = 5.0,
    points: Annotated[int, typer.Option("--points", metavar="COUNT", help="Points of each image to match.")] = 150,
    least_correlation: Annotated[
        float | None,
        typer.Option(
            "--least-correlation",
            metavar="SCORE",
            help="Smallest correlation of a match (default: 0.5; 0.3 with --measure orientation).",
        ),
    ] = None,
    measure: Measure = Compared.grey,
    features: Annotated[
        Features | None,
        typer.Option("--features", help="Match keypoints of OpenCV (SIFT or ORB) instead of areas."),
    ] = None,
    self_calibrate: Annotated[
        bool,
        typer.Option(
            "--self-calibrate/--no-self-calibrate",
            help="Adjust focal length and principal point of each camera too, by the sigmas stated for them; without, "
            "their errors are not in the results.",
        ),
    ] = True,
    crs: Annotated[
        str | None,
        typer.Option(
            "--crs", metavar="CRS", help="Map of the orientations (x, y, z, omega, phi, kappa); default: lat, lon."
        ),
    ] = None,
    report: Annotated[
        bool,
        typer.Option(
            "--report",
            help="Also write report.html: residual maps, corrections, check points, map of the block.",
            rich_help_panel=WRITING,
        ),
    ] = False,
    of_mosaic: MosaicOptions = MosaicOptions(),
    of_control: ControlOptions = ControlOptions(),
    on_map: MapOptions = MapOptions(),
    in_motion: MotionOptions = MotionOptions(),
    of_rigs: RigOptions = RigOptions(),
    reading_dem: DemOptions = DemOptions(),
    reading: ReadingOptions = ReadingOptions(),
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Correct positions and attitudes of overlapping images by tie points among them; no map is needed.

    The navigation is the prior, with the errors that the files state; surveyed points (--gcp) are control, or checks.
    With --reference, images are registered to a map too, and tie points carry it to the others. Writes
    orientations.csv, ties.csv, control.csv, and models of OpenSfM, COLMAP and Metashape.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        given = OrientedImages(files, None, images, reading)
        given.check()
        of_control.check_options()
        of_mosaic.check_options(output)
        _check_map(crs)
        on_map.check()
        in_motion.check(on_map.reference)
        of_rigs.check_options()
        _check_features(features, measure, on_map)
        if report:
            check_report()
        _check_several(given)
        _check_outputs(given, dem, output, of_mosaic, of_control, on_map, reading_dem)
        began = time.perf_counter()
        compile_quickly()
        how = _matching(dem_sigma, least_correlation, points, measure if features is None else Compared.grey)
        from jaxgeo._checks import enable_x64

        enable_x64()
        from jaxgeo.ties import KeptMatches as Kept

        surveyed = of_control.read()
        block = _read(given.on(dem, reading_dem, Sigmas(dem=dem_sigma)), of_rigs)
        known = len(block.assumed)
        views, paths = in_motion.moving(block.views, block.paths, block.assumed), block.paths
        print_assumed(block.assumed[known:])
        of_mosaic.check_no_input(paths)
        _check_images(block, output, reading_dem)
        control = None if surveyed is None else of_control.control(surveyed, views, block.assumed)
        chosen = [] if on_map.reference is None else rows_to_register(views, on_map)
        exposures = views.exposure
        terrain = read_terrain(
            dem, reading_dem, lambda: view_of_shots(exposures[0].sensor, [one.motion for one in exposures])
        )
        of_mosaic.check_cells(views, paths, terrain, crs, reading_dem.reach)
        kept = Kept(output / MATCHES, lambda row: stamp(paths[row]))
        ties = _tied(in_motion.searched(views), terrain, paths, reading_dem, how, points, kept, _features(features))
        if kept.reused:
            print_note(f"{kept.reused} of {len(ties.pairs)} pairs were read from {kept.folder}")
        found, written, more = None, [], {}
        if control is not None or (ties.observations is not None and len(ties.parts[0]) > 1):
            of_map = None
            if chosen:
                read = partial(_image, paths, reading_dem)
                of_map = registered_to(
                    views, chosen, read, block.errors, terrain, dem_sigma, on_map, reading_dem.reach, measure
                )
                more["registrations"] = of_map.outcomes
                block.assumed.extend(of_map.assumed)
                print_assumed(of_map.assumed)
            with working("adjusting"):
                unknowns = in_motion.unknowns(_interior(views, block.errors) if self_calibrate else None)
                found = _corrected(views, ties, unknowns, control, None if of_map is None else of_map.control)
            written = write_files(output, found, crs)
            if report:
                written.append(write_page(output, found, terrain, inputs, block.assumed))
            more["locate"] = locate_command(output, written, crs)
            written = [f"{output / name}" for name in written]
            if of_mosaic.mosaic is not None:
                more["mosaic"] = of_mosaic.write(found, paths, terrain, crs, reading_dem.reach)
                written.append(more["mosaic"]["file"])
        print_written(*([output] if written else []), of_mosaic.mosaic if found is not None else None)
        content = content_of(views, ties, found, written, time.perf_counter() - began) | block.groups.content | more
        if as_json:
            print_json("adjust", {"inputs": inputs, "assumed": block.assumed, **content})
        else:
            print_summary(content, found)
    if found is None:
        raise typer.Exit(NO_ANSWER)


class Features(StrEnum):
    """Keypoints of OpenCV."""

    sift = "sift"
    orb = "orb"


class Block(NamedTuple):
    """The images with their navigation, their files, what is assumed of them, their errors, shots and flights."""

    views: Views
    paths: list[pathlib.Path]
    assumed: list[str]
    errors: list[Any]
    groups: Groups


def _check_several(given: OrientedImages) -> None:
    """Raises `UserError` for one image."""
    first = given.files[0]
    if given.are_several:
        return
    if not first.exists() and ":" not in f"{first}":
        raise UserError(f"{first}: there is no such file or folder.")
    raise UserError(
        f"{first}: adjust needs two images or more; give a folder of images, or a file of poses with --images FOLDER."
    )


def _check_outputs(
    given: OrientedImages,
    dem: list[Any],
    output: pathlib.Path,
    of_mosaic: MosaicOptions,
    of_control: ControlOptions,
    on_map: MapOptions,
    reading_dem: DemOptions,
) -> None:
    """Raises `UserError` for results that would overwrite an input, or cannot be written."""
    from jaxgeo.io.paths import files_behind

    maps = [] if on_map.reference is None else files_behind(on_map.reference, reading_dem.reach)
    read_files = [*given.inputs, *maps, *terrain_files(dem, reading_dem), *of_control.files]
    check_no_input("--output", [output / name for name in FILES], read_files)
    of_mosaic.check_no_input(read_files)
    check_writable(output)


def _check_map(crs: str | None) -> None:
    """Raises `UserError` for a --crs that is no map in metres, before any image is matched."""
    from jaxgeo.io._map_grid import metric_map
    from jaxgeo.io.errors import TableError

    if crs is None:
        return
    try:
        metric_map("", crs)
    except TableError as error:
        raise UserError(f"{error}".removeprefix(": ").replace("crs = ", "--crs ", 1)) from error


def _read(given: OrientedImages, of_rigs: RigOptions) -> Block:
    """The images, without copies. Raises `UserError` for fewer than two."""
    from jaxgeo.ties import Views

    observed, paths = given.read()
    assumed = [as_typed(one) for one in observed.assumed]
    print_assumed([one for one in assumed if "sigma" in one])
    rows = _without_copies(observed.read_rows.tolist(), paths)
    if len(rows) < 2:
        raise UserError(f"{observed.source}: adjust needs two images or more with positions; got {len(rows)}.")
    each = [observed.at(row) for row in rows]
    names = [str(observed.columns[row].get("name", row)) for row in rows]
    paths, exposures = [paths[row] for row in rows], [one.exposure for one, _ in each]
    groups = of_rigs.groups(given.files, names, paths, exposures)
    errors, of_mounting = of_rigs.with_mounting(groups, exposures, [errors for _, errors in each])
    if groups.words():
        print_note(groups.words())
    print_assumed(of_mounting)
    try:
        views = Views.of(names, exposures, errors, groups.flight, shot=groups.shot, camera=groups.camera)
    except (TypeError, ValueError) as error:
        raise UserError(f"{observed.source}: {as_options(f'{error}', groups)}") from error
    return Block(views, paths, [*assumed, *of_mounting], errors, groups)


def _without_copies(rows: list[int], paths: list[pathlib.Path]) -> list[int]:
    """The rows whose files equal none of an earlier row, byte by byte; a note for each of the others.

    A copy has no parallax with its original, and would count the navigation of one image twice.
    """
    by_size: dict[int, list[int]] = {}
    kept = []
    for row in rows:
        path = paths[row]
        alike = by_size.setdefault(path.stat().st_size, []) if path.is_file() else []
        original = next((one for one in alike if filecmp.cmp(paths[one], path, shallow=False)), None)
        if original is None:
            alike.append(row)
            kept.append(row)
        else:
            print_note(f"left out: {path} is a copy of {paths[original]}")
    return kept


def _tied(
    views: Views,
    terrain: Any,
    paths: list[pathlib.Path],
    reading: DemOptions,
    how: Matching,
    points: int,
    kept: KeptMatches,
    features: AbstractFeatures | None,
) -> Ties:
    from jaxgeo.ties import Pictures, find_ties

    try:
        with progress_bar() as bar:
            task = bar.add_task("compiling, matching pairs", total=None)
            return find_ties(
                views,
                terrain,
                Pictures(partial(_image, paths, reading)),
                how,
                points=points,
                kept=kept,
                features=features,
                callback=lambda done, total: bar.update(
                    task, completed=done, total=total, description="matching pairs"
                ),
            )
    except ValueError as error:
        raise UserError(_as_options(f"{error}")) from error


def _image(paths: list[pathlib.Path], reading: DemOptions, row: int) -> tuple[Any, Any]:
    """Values and mask of an image."""
    from jaxgeo.io.images import read_image

    with translate_reach_errors():
        return read_image(
            paths[row], allow_remote=bool(reading.allow_remote), allow_outside=bool(reading.allow_outside)
        )


def _matching(dem_sigma: float, least_correlation: float | None, points: int, measure: Compared) -> Matching:
    """Options of matching. Raises `UserError` for wrong values."""
    from jaxgeo.ties import Matching
    from jaxgeo.ties.block import check_points

    try:
        check_points(points)
        return Matching(sigma_height=dem_sigma, least_score=least_correlation, measure=measure.value)
    except ValueError as error:
        raise UserError(_as_options(f"{error}")) from error


def _check_features(features: Features | None, measure: Compared, on_map: MapOptions) -> None:
    """Raises `UserError` where OpenCV is missing, and for a measure that nothing is compared by."""
    if features is None:
        return
    if measure is not Compared.grey and on_map.reference is None:
        raise UserError(
            f"--measure {measure}: is how areas are compared, but --features {features} matches keypoints; give one of "
            f"the two."
        )
    from jaxgeo.ties.opencv_features import opencv

    try:
        opencv()
    except ImportError as error:
        raise UserError(f"--features {features}: {error}") from error


def _features(features: Features | None) -> AbstractFeatures | None:
    from jaxgeo.ties import OrbFeatures, SiftFeatures

    return None if features is None else {Features.sift: SiftFeatures, Features.orb: OrbFeatures}[features]()


def _check_images(block: Block, output: pathlib.Path, reading: DemOptions) -> None:
    """Raises `UserError` for images in the output folder, and for those that are missing, unreadable, or not of the
    size of their cameras, by headers."""
    from jaxgeo.io.images import check_size, opened
    from jaxgeo.io.reach import Reach

    if output.resolve() in {path.resolve().parent for path in block.paths}:
        raise UserError(f"--output {output}: the images are there; give another folder, such as {output / 'adjusted'}.")
    reach = Reach(bool(reading.allow_remote), bool(reading.allow_outside))
    for row, path in enumerate(block.paths):
        with translate_reach_errors(), opened(f"{path}", reach) as data:
            shape = data.shape
        try:
            check_size(f"{path}", shape, block.views.camera_of(row))
        except ValueError as error:
            raise UserError(f"{error}".replace("the camera of the scene", "its camera")) from error


def stamp(path: pathlib.Path) -> str:
    """Text that changes with a file: its path, size and time of change; the name alone for what is not on disk."""
    try:
        found = path.stat()
    except OSError:
        return f"{path}"
    return f"{path.absolute()} {found.st_size} {found.st_mtime_ns}"


def _as_options(words: str) -> str:
    """A message with the names of options."""
    for name, option in (
        ("sigma_height", "--dem-sigma"),
        ("least_score", "--least-correlation"),
        ("points", "--points"),
    ):
        if words.startswith(f"{name} must"):
            return option + words.removeprefix(name)
    return words.replace(", or lower least_overlap", "")


def _interior(views: Views, errors: list[Any]) -> Unknowns:
    """Focal length and principal point of each camera as unknowns, with the sigmas stated with its first image."""
    from jaxgeo.adjust import Prior, Unknowns
    from jaxgeo.uncertainty.sources import InteriorOrientation

    focal, principal = {}, {}
    for name, camera in views.cameras.items():
        given = errors[int(np.flatnonzero(views.camera == name)[0])]
        stated = [one for one in getattr(given, "sources", given) if isinstance(one, InteriorOrientation)]
        usual = np.array(INTERIOR) * float(np.max(camera.focal_px))
        sigma = np.asarray(stated[0].sigma, float) if stated else usual
        if sigma[0] > 0.0:
            focal[name] = Prior(sigma[0])
        if np.all(sigma[1:] > 0.0):
            principal[name] = Prior(sigma[1:])
    return Unknowns(focal=focal, principal=principal)


def _corrected(
    views: Views, ties: Ties, unknowns: Unknowns | None, control: Control | None, map_control: MapControl | None
) -> Correction:
    from jaxgeo.adjust import DeficientBlock, NotConverged
    from jaxgeo.ties import correct

    try:
        return correct(views, ties, unknowns, control=control, map_control=map_control)
    except (DeficientBlock, NotConverged, ValueError) as error:
        raise UserError(f"the adjustment failed: {error}") from error
