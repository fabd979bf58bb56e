"""Inputs of `jaxgeo locate` and `jaxgeo report`: observations with their error sources, and the ground."""

from __future__ import annotations

import dataclasses
import pathlib
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import jaxgeo
from jaxgeo._destination import check_no_input
from jaxgeo._refusals import is_refusal
from jaxgeo._text_numbers import number_in
from jaxgeo.cli._acquisitions import print_unread, reading_files
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import errors_given, ground_errors, pixel_pitch_of
from jaxgeo.cli._inputs import as_datum, numbers_in, open_terrain, read_terrain
from jaxgeo.cli._known_heights import has_no_datum, relative_heights, takeoff_instead, with_known_heights
from jaxgeo.cli._level_ground import ground_doubts
from jaxgeo.cli._locate_options import LocateOptions
from jaxgeo.cli._option_names import as_typed, reason_not_read
from jaxgeo.cli._screen import print_message
from jaxgeo.earth import Atmosphere
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty.sources import AbstractSource, Attitude, GimbalAngles, Position
from jaxgeo.uncertainty.sources.height_raster import OF_TERRAIN

if TYPE_CHECKING:
    from jaxgeo.io import DemFiles
    from jaxgeo.io.archives import View

REPORTED = "reported"
SHARE = re.compile(r"( \(\d+ of \d+ exposures[^)]*\))?$")  # end of a sentence that does not apply to all
OPTION_OF = {Position: "position", Attitude: "attitude", GimbalAngles: "gimbal"}
# Phrases in the readers' sentences about error sources, and the options that replace these sources.
REPLACED = {
    "Focal length sigma:": "focal",
    "Principal point sigma:": "principal",
    "position sigma there:": "position",
}
# Phrase for lenses without a distortion model; replaced if --focal-sigma is given.
BENT = "what it bends at the corners counts as an error of the focal length"


class OtherHeight(NamedTuple):
    """How the height of a camera is replaced, as an order: always, and by a height above the take-off in the file."""

    always: str = ""
    by_takeoff: str = ""


@dataclasses.dataclass(frozen=True)
class LocateInputs:
    """Observations, the ground of each batch or `DemFiles`, whether error sources are used, assumptions as printed;
    of detections their outlines (n, 2) in pixels; and how heights of cameras are replaced."""

    observed: jaxgeo.io.Observations
    grounds: Any
    has_errors: bool
    assumed: list[str]
    vertices: list[np.ndarray] | None = None
    other_height: OtherHeight = OtherHeight()

    @property
    def reasons(self) -> list[str | None] | None:
        """For each row why its file could not be read, with command-line options; None if all were read."""
        return self.observed.reasons_by(reason_not_read)

    @property
    def has_faults(self) -> bool:
        """Whether a file could not be read because of an internal error."""
        return any(not is_refusal(one.error) for one in self.observed.unread.values())


Check = Callable[["jaxgeo.io.Observations", bool], object]


def read_inputs(
    options: LocateOptions,
    with_errors: bool | None,
    output: pathlib.Path | None,
    check: Check | None = None,
    *,
    on_disk: bool = False,
    whole: bool = False,
) -> LocateInputs:
    """The inputs, small and error-prone ones first; assumptions and unread files are printed on stderr.

    `check` is called with the observations, and whether there are error sources, before the ground is read. An
    elevation model is left on disk if asked for, unless rays are bent; that of an archive is fetched for the pixels, or
    with `whole` for their images. Error
    sources are used if `with_errors`; if that is None, for a FILE, or if the scene ([errors] table) or an option states
    them. Raises `UserError`, `ValueError` if `output` would overwrite an input, and as the readers.
    """
    options.check()
    if output is not None:
        check_no_input("--output", [output], options.input_files)
    inputs = inputs_of(options, with_errors, check, on_disk=on_disk, whole=whole)
    print_assumed(inputs.assumed)
    _print_pixels_outside(options.pixels, inputs.observed)
    print_unread(inputs.observed.unread.values())
    return inputs


def inputs_of(
    options: LocateOptions,
    with_errors: bool | None,
    check: Check | None = None,
    *,
    on_disk: bool = False,
    whole: bool = False,
) -> LocateInputs:
    """`read_inputs` without messages, but of a take-off on the elevation model."""
    options.check()
    ground = options.ground
    scene = options.of_images.scene
    reading = with_known_heights(options.reading, options.files, scene, ground.dem or [], ground, options.sigmas)
    options = dataclasses.replace(options, reading=reading)
    if with_errors is None and options.of_images.shots is None:
        with_errors = not options.is_scene or bool(options.sigmas.given) or None
    observed, vertices = _observations(options)
    if with_errors is None:
        with_errors = any(batch.sources for batch in observed.batches) and options.of_images.shots is None
    if options.refraction:
        observed = _refracted(observed)
    if with_errors:
        observed = _with_usual_errors(observed)
    assumed, of_errors = _assumed(observed, options)
    if with_errors:
        each = [_sources(batch, observed.source, options) for batch in observed.batches]
        observed = observed.with_sources([found for found, _ in each])
        assumed += [*of_errors, *dict.fromkeys(one for _, own in each for one in own)]
    instead = takeoff_instead(options.reading, ground)
    assumed += [*ground_doubts(observed, ground, instead), *relative_heights(options.reading, ground)]
    is_above_takeoff = has_no_datum(options.reading, ground)
    observed = dataclasses.replace(observed, is_above_takeoff=is_above_takeoff)
    if check is not None:
        check(observed, bool(with_errors))
    whole |= vertices is not None
    grounds = _grounds(options, observed, on_disk, whole)
    return LocateInputs(observed, grounds, bool(with_errors), assumed, vertices, _other_height(options, instead))


def _other_height(options: LocateOptions, instead: str | None) -> OtherHeight:
    """How the height of a camera is replaced."""
    if not options.is_scene:
        return OtherHeight("", "" if instead is None else f"give {instead}")
    table = options.of_images.shots
    where = f"height_m in {options.scene_file}" if table is None else f"the column height_m of {table}"
    return OtherHeight(f"correct {where}", "")


def states_errors(options: LocateOptions) -> bool | None:
    """For a table of shots, whether its scene or an option states error sources; None for other inputs."""
    from jaxgeo.io.scene import read_scene

    given = options.of_images
    if given.shots is None or given.scene is None:
        return None
    return bool(options.sigmas.given) or read_scene(given.scene).errors is not None


def _observations(options: LocateOptions) -> tuple[jaxgeo.io.Observations, list[np.ndarray] | None]:
    """(observations, outlines of detections in pixels)."""
    from jaxgeo.io import read_observations
    from jaxgeo.io.acquisitions.several import files_of
    from jaxgeo.io.detected import observations_of_detections
    from jaxgeo.io.detections import nameless_classes, read_detections

    given = options.of_images
    detections = None
    if given.detections is not None:
        detections = read_detections(
            given.detections, pixel_origin=given.pixel_origin or "centre", class_names=given.class_names
        )
        print_assumed(nameless_classes(detections, given.detections, given.class_names))
    form = "COLUMN,ROW, two numbers, e.g. --pixel 100,200"
    with reading_files(options.files or [pathlib.Path(f"{given.scene}")]) as progress:
        found = read_observations(
            options.files,
            [numbers_in("--pixel", text, (2,), form) for text in options.pixels] or None,
            scene=given.scene,
            shots=given.shots,
            exposures=given.exposures or (),
            shard=given.part,
            progress=progress,
            **options.reading.known_arguments,
        )
    if detections is None:
        return found, None
    files = files_of(options.files)[0]
    return observations_of_detections(found, detections, anchor=given.anchor or "centre", files=files)


def _with_usual_errors(observed: jaxgeo.io.Observations) -> jaxgeo.io.Observations:
    """The observations of a scene that states no errors with the usual ones, as files have them; else unchanged."""
    from jaxgeo.io.acquisitions.usual_errors import usual_errors

    batch = observed.batches[0]
    if batch.sources or not batch.is_one_camera:
        return observed
    usual = usual_errors((), batch.sensor.gimbal)
    defaults = tuple((type(source), sentence) for source, sentence in usual)
    observed = observed.with_sources([tuple(source for source, _ in usual)])
    return dataclasses.replace(observed, assumed_errors=defaults)


def _assumed(observed: jaxgeo.io.Observations, options: LocateOptions) -> tuple[list[str], list[str]]:
    """(assumptions, assumptions on errors with the option that replaces them), without those replaced."""
    others, of_errors = [], []
    focal = options.sigmas.focal
    for one in map(as_typed, observed.assumed):
        if focal is not None:
            one = one.replace(BENT, f"distortion at the corners is covered only as far as --focal-sigma {focal} allows")
        option = next((name for words, name in REPLACED.items() if words in one), None)
        if option is None:
            others.append(one)
        elif getattr(options.sigmas, option) is None:
            of_errors.append(f"{one} (--{option}-sigma)")
    for kind, sentence in observed.assumed_errors:
        option = OPTION_OF[kind]
        if getattr(options.sigmas, option) is None:
            of_errors.append(SHARE.sub(rf" (--{option}-sigma)\1", sentence, count=1))
    return others, of_errors


def _print_pixels_outside(texts: Sequence[str], observed: jaxgeo.io.Observations) -> None:
    """Print typed pixels outside the image on stderr, before computing; they keep their rows."""
    outside: dict[str, None] = {}
    for batch in observed.batches:
        camera = batch.camera
        for text in texts:
            u, v = (float(number) for number in text.split(","))
            if not (-0.5 <= u <= camera.width - 0.5 and -0.5 <= v <= camera.height - 0.5):
                outside[
                    f"--pixel {text}: outside the image of {camera.width} x {camera.height} pixels; columns go from 0 "
                    f"to {camera.width - 1}, rows from 0 to {camera.height - 1}."
                ] = None
    for message in outside:
        print_message(message)


def _refracted(observed: jaxgeo.io.Observations) -> jaxgeo.io.Observations:
    """The observations in a standard atmosphere, sea level taken at the first exposure. Raises `UserError`."""
    from jaxgeo.io import undulation

    if observed.atmosphere is not None:
        raise UserError(f"--refraction: {observed.source} already has an [air] table; leave the option out.")
    position = observed.batches[0].shots.pose.position
    lat, lon = (float(np.rad2deg(np.asarray(angle)[0])) for angle in (position.lat, position.lon))
    return observed.with_atmosphere(Atmosphere(sea_level=float(undulation(lat, lon))))


def _sources(
    batch: jaxgeo.io.ObservationBatch, source: str, options: LocateOptions
) -> tuple[tuple[AbstractSource, ...], list[str]]:
    """(error sources, one entry per pixel if exposures have their own; assumptions on the ground)."""
    from jaxgeo.io.acquisitions import for_each

    sigmas, is_level = options.sigmas, options.ground.level is not None
    pitch = pixel_pitch_of(pathlib.Path(source)) if batch.is_one_camera else None
    own = tuple(one for one in batch.sources if not isinstance(one, OF_TERRAIN))
    given = errors_given(own, sigmas, batch.sensor.gimbal, source, pitch)
    ground, assumed = ground_errors(batch.sources, sigmas, level=is_level)
    found = (*given, *ground)
    if not found:
        raise UserError(
            f"{source}: all standard deviations are zero; give one of --position-sigma, --attitude-sigma, "
            f"--gimbal-sigma, --dem-sigma above zero."
        )
    if not batch.is_one_camera:
        stated = {id(one) for one in batch.sources}
        is_each = [id(one) in stated or np.ndim(one.sigma) > 1 for one in found]
        found = tuple(one if each else for_each(one, len(batch)) for one, each in zip(found, is_each, strict=True))
    return found, assumed


def _grounds(
    options: LocateOptions, observed: jaxgeo.io.Observations, on_disk: bool, whole: bool
) -> Sequence[AbstractTerrain] | DemFiles:
    """The ground of each batch."""
    ground, batches = options.ground, observed.batches

    def look() -> View:
        from jaxgeo.io.archives import view_of

        return view_of(observed, whole=whole)

    if ground.level is None and on_disk and observed.atmosphere is None:
        return open_terrain(ground.dem or [], ground, look)
    if ground.level is None:
        return [read_terrain(ground.dem or [], ground, look)] * len(batches)
    if ground.level == REPORTED:
        heights = [np.full(len(one), np.nan) if one.centre_heights is None else one.centre_heights for one in batches]
        if not any(np.isfinite(each).any() for each in heights):
            raise UserError(
                f"--ground {REPORTED}: {observed.source} reports no frame centre height; give a height in m."
            )
        return [ConstantHeight(each) for each in heights]
    height = number_in(ground.level)
    if height is None:
        raise UserError(f"--ground {ground.level!r}: expected a height in m, or {REPORTED!r}.")
    if ground.vertical_datum is None:
        return [ConstantHeight(np.asarray(height))] * len(batches)
    return [_level(batch, height, as_datum(ground.vertical_datum)) for batch in batches]


def _level(batch: jaxgeo.io.ObservationBatch, height: float, datum: str | float) -> ConstantHeight:
    """Level ground for each pixel, at a height in m above a datum."""
    from jaxgeo.io.scene import ellipsoidal_heights

    position = batch.shots.pose.position
    lon, lat = (np.rad2deg(np.asarray(angle)) for angle in (position.lon, position.lat))
    return ConstantHeight(ellipsoidal_heights(lon, lat, np.full(len(lon), height), datum))
