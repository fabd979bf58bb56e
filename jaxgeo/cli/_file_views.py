"""Exposures and pixels from image, telemetry and navigation files and folders."""

from __future__ import annotations

import dataclasses
import math
import pathlib
from collections.abc import Iterable, Sequence
from typing import Any

from jaxgeo.cli._common import UserError
from jaxgeo.cli._exposures import ExposureSet, Seen, pixels_of
from jaxgeo.cli._locate_options import LocateOptions
from jaxgeo.cli._option_names import as_typed, reason_not_read, reason_of, words_as_typed
from jaxgeo.cli._refusals import is_refusal
from jaxgeo.cli._screen import progress_bar, tell, working

TOLD = 10  # unread files whose reasons are printed


def read_files(files: Sequence[pathlib.Path], how: dict[str, Any]) -> Any:
    """Exposures of files and folders, an `AcquisitionSet` that includes the unread files.

    Raises `UserError` if none can be read or an option is wrong, and as `read_acquisitions`.
    """
    from jaxgeo.io.acquisitions import read_acquisitions

    with working(f"reading {files[0].name}"), words_as_typed():
        if len(files) == 1 and not files[0].is_dir():
            return _one(files[0], how)
    with progress_bar() as bar, words_as_typed():
        task = bar.add_task("reading", total=None)
        found = read_acquisitions(files, progress=lambda n, of: bar.update(task, completed=n, total=of), **how)
        if found.parts:
            return found
        first, *others = sorted(found.unread, key=lambda one: is_refusal(one.error))  # internal errors first
        if not others or not is_refusal(first.error):
            raise first.error
    raise UserError(f"none of {len(found.unread)} files can be read. First error: {reason_of(first.error)}")


def _one(file: pathlib.Path, how: dict[str, Any]) -> Any:
    import numpy as np

    from jaxgeo.io.acquisitions import AcquisitionSet, read_acquisition

    found = read_acquisition(file, **how)
    return AcquisitionSet((found,), (np.arange(len(found)),), (), found.assumed)


def tell_unread(unread: Iterable[Any]) -> None:
    """Report the unread files and their reasons on stderr, at most `TOLD`."""
    each = list(unread)
    for one in each[:TOLD]:
        tell(f"not read: {reason_not_read(one)}")
    if len(each) > TOLD:
        tell(f"not read: {len(each) - TOLD} more files; --json lists all reasons.")


def views_of_files(asked: LocateOptions) -> ExposureSet:
    """The requested pixels of each exposure, and one row per unread file. Raises as `read_files`."""
    import numpy as np

    from jaxgeo.uncertainty import sources

    by_scene = asked.scene is not None and _are_images(asked.files, asked.scene)
    found = read_files(asked.files, _with_camera_of_scene(asked) if by_scene else asked.how)
    assumed, of_reader = _apart([as_typed(one) for one in found.assumed], asked)
    found, atmosphere, held, of_errors = _with_cameras(found, asked, by_scene)
    if by_scene and any(sources.InteriorOrientation in map(type, part.sources) for part in found.parts):
        assumed = [one for one in assumed if not one.startswith(WITHOUT_ERROR)]
    where = {int(place): (k, i) for k, part in enumerate(found.places) for i, place in enumerate(part)}
    unread = {one.place: one for one in found.unread}
    pixels = [pixels_of(asked.pixels, part.exposure(0)[0].camera) for part in found.parts]
    has_times = any(np.any(np.asarray(part.shots.time) != 0.0) for part in found.parts)
    lanes: list[list[tuple[int, int]]] = [[] for _ in found.parts]  # (row, exposure) of each part
    carried: list[dict[str, Any]] = []
    reasons: dict[int, Any] = {}
    for place in _chosen(found, asked.exposures, sorted([*where, *unread])):
        if place in unread:
            reasons[len(carried)] = unread[place]
            carried.append(_row(_name(unread[place], found), math.nan, None, None, has_times))
            continue
        part, index = where[place]
        acquisition = found.parts[part]
        for u, v in pixels[part].tolist():
            lanes[part].append((len(carried), index))
            carried.append(_row(str(acquisition.names[index]), acquisition.shots.time[index], u, v, has_times))
    if reasons and not any(lanes):
        raise UserError(reason_not_read(next(iter(reasons.values()))))
    seen = [_seen(*one) for one in zip(found.parts, lanes, pixels, strict=True) if one[1]]
    where_from = asked.named if len(asked.files) > 1 else f"{asked.files[0]}"
    return ExposureSet(
        seen, True, carried, atmosphere, [*assumed, *held], where_from, None, [*of_reader, *of_errors], reasons
    )


# Phrases in the readers' sentences about error sources, and the options that replace these sources.
ERRORS_TOLD = {
    "Focal length sigma:": "focal",
    "Principal point sigma:": "principal",
    "position sigma there:": "position",
}

# Phrase for lenses without a distortion model; replaced if --focal-sigma is given.
BENT = "what it bends at the corners counts as an error of the focal length"


def _apart(assumed: list[str], asked: LocateOptions) -> tuple[list[str], list[str]]:
    """(assumptions, assumptions on errors with the option that replaces them), without those replaced."""
    others, of_errors = [], []
    focal = asked.sigmas.focal
    for one in assumed:
        if focal is not None:
            one = one.replace(BENT, f"distortion at the corners is covered only as far as --focal-sigma {focal} allows")
        option = next((name for words, name in ERRORS_TOLD.items() if words in one), None)
        if option is None:
            others.append(one)
        elif getattr(asked.sigmas, option) is None:
            of_errors.append(f"{one} (--{option}-sigma)")
    return others, of_errors


WITHOUT_ERROR = "The camera is taken as it is given, without error"  # of a reader given a camera alone


def _are_images(files: Sequence[pathlib.Path], scene: pathlib.Path) -> bool:
    """Whether all files are drone images or folders of them, which take only the camera of a scene.

    Raises `UserError` for a mixture. Files of unknown type are left to the reader.
    """
    from jaxgeo.io.acquisitions.detect import DRONE_IMAGES

    kinds = {form is DRONE_IMAGES for form in map(_form, files) if form is not None}
    if len(kinds) > 1:
        raise UserError(
            f"--scene {scene}: drone images use only its camera, the other files all of it; locate them separately."
        )
    return kinds == {True}


def _form(file: pathlib.Path) -> Any:
    """File type, or None."""
    from jaxgeo.io.acquisitions.detect import form_of
    from jaxgeo.io.errors import TableError

    try:
        return form_of(file)
    except (TableError, OSError):
        return None


def _with_camera_of_scene(asked: LocateOptions) -> dict[str, Any]:
    """Reader options for drone images with the camera of a scene. Raises `UserError`."""
    if "camera" in asked.how:
        raise UserError(f"--scene {asked.scene} and --camera {asked.how['camera']}: both give a camera; leave one out.")
    return {**asked.how, "camera": asked.scene}


def _name(unread: Any, found: Any) -> str:
    """Row name of an unread file: its name, or its path if the name is not unique."""
    names = [str(name) for part in found.parts for name in part.names] + [one.name for one in found.unread]
    return unread.name if names.count(unread.name) == 1 else unread.path


def _row(name: str, time: Any, u: float | None, v: float | None, has_times: bool) -> dict[str, Any]:
    is_known = math.isfinite(time) and time != 0.0
    told = {"time_s": float(time) if is_known else None} if has_times else {}
    return {"name": name, **told, "u": u, "v": v}


def _chosen(found: Any, names: list[str], places: list[int]) -> list[int]:
    """Indices of the named exposures; all if no names are given. Raises `UserError`."""
    if not names:
        return places
    known: dict[str, int] = {}
    for part, places in zip(found.parts, found.places, strict=True):
        known |= {str(name): int(place) for name, place in zip(part.names, places, strict=True)}
    some = ", ".join(list(known)[:5]) + (" and others" if len(known) > 5 else "")
    known |= {called: one.place for one in found.unread for called in (one.path, one.name) if called not in known}
    own = [_own_name(name, found) if name not in known else name for name in names]
    for name, typed in zip(own, names, strict=True):
        if name not in known:
            raise UserError(f"--exposure {typed}: no exposure has this name; known: {some}.")
    return [known[name] for name in own]


def _own_name(name: str, found: Any) -> str:
    """Record number for FILE/NUMBER (its name among several files), if its file is the only one."""
    from jaxgeo.io.acquisitions._exposure_names import number_in_file

    is_alone = len(found.parts) == 1 and not found.unread
    return (number_in_file(name, found.parts[0].path) if is_alone else None) or name


def _seen(part: Any, lanes: list[tuple[int, int]], pixels: Any) -> Seen:
    """Pixels of a part, given (row, exposure) of each."""
    import jax
    import numpy as np

    rows, index = np.array(lanes).T
    taken = jax.tree.map(lambda leaf: np.asarray(leaf)[index], (part.sensor, part.shots, part.sources))
    sensor, shots, sources = taken
    uv = np.tile(pixels, (len(lanes) // len(pixels), 1))
    heights = None if part.reported is None else np.asarray(part.reported.centre.height)[index]
    return Seen(sensor, shots, uv, sources, rows, heights)


def _with_cameras(found: Any, asked: LocateOptions, by_scene: bool) -> tuple[Any, Any, list[str], list[str]]:
    """(exposures with a camera, the scene's if they have none, and with errors; the scene's atmosphere; assumptions on
    the gimbal; on errors). `by_scene`: their camera was already read from the scene."""
    from jaxgeo.io.acquisitions.sentences import merged_sentences
    from jaxgeo.io.scene import read_scene

    bare = [part for part in found.parts if part.sensor is None]
    if asked.scene is not None and not bare and not by_scene:
        if found.unread:  # the scene may be meant for these
            raise UserError(reason_not_read(found.unread[0]))
        raise UserError(f"--scene {asked.scene}: {asked.named} already has a camera; leave the scene out.")
    if bare and asked.scene is None:
        found = _without_bare(found, asked)
    scene = None if asked.scene is None else read_scene(asked.scene)
    stated = () if scene is None or scene.errors is None else scene.errors.sources
    held: list[str] = []
    usual: list[list[str]] = []

    def complete(part: Any) -> Any:
        beside: tuple[Any, ...] = ()
        if part.sensor is None:
            part, beside = _seen_by(part, scene, asked.scene, held), _of_scene(part, stated)
        elif by_scene:
            part = _with_lens_errors(part, stated, scene.sensor.camera)  # pyright: ignore[reportOptionalMemberAccess]
            held.append(f"Only the camera, its lens errors and the atmosphere of {asked.scene} are used.")
        part, told = _with_errors(part, beside, asked)
        usual.extend([told] * len(part))
        return part

    found = found.with_parts(complete)
    air = None if scene is None else scene.atmosphere
    return found, air, list(dict.fromkeys(held)), list(merged_sentences(usual, "exposure"))


def _without_bare(found: Any, asked: LocateOptions) -> Any:
    """The exposures with a camera; files without one become unread. Raises `UserError` if none has one."""
    from jaxgeo.io.acquisitions.several import Unread
    from jaxgeo.io.errors import TableError

    unread, kept = [], []
    for part, places in zip(found.parts, found.places, strict=True):
        if part.sensor is not None:
            kept.append((part, places))
            continue
        try:
            raise TableError(_without_a_camera(part, asked))
        except TableError as error:
            unread.append(Unread(part.path, error, int(places[0])))
    if not kept:
        raise UserError(str(unread[0].error))
    parts, places = zip(*kept, strict=True)
    return dataclasses.replace(found, parts=parts, places=places, unread=(*found.unread, *unread))


def _with_lens_errors(found: Any, stated: tuple[Any, ...], camera: Any) -> Any:
    """Exposures with the lens errors a scene states for its `camera`, scaled to pixels of their own images."""
    import numpy as np

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.uncertainty import sources

    own = found.sensor.camera
    across, down = own.width / camera.width, own.height / camera.height
    lens = tuple(
        dataclasses.replace(one, sigma=np.asarray(one.sigma) * np.array([across, across, down]))
        if isinstance(one, sources.InteriorOrientation)
        else one
        for one in stated
        if isinstance(one, sources.InteriorOrientation | sources.Distortion)
    )
    return dataclasses.replace(found, sources=(*found.sources, *for_each(lens, len(found))))


def _of_scene(found: Any, stated: tuple[Any, ...]) -> tuple[Any, ...]:
    """Error sources of a scene that apply: without those of gimbal and mount if the angles are the camera's own."""
    from jaxgeo.uncertainty import sources

    if not found.of_camera:
        return stated
    of_gimbal = (sources.GimbalAngles, sources.GimbalMounting)
    without = (*of_gimbal, sources.Boresight, sources.CameraMounting, sources.LeverArm)
    return tuple(one for one in stated if not isinstance(one, without))


def _without_a_camera(found: Any, asked: LocateOptions) -> str:
    """Message that a file has no camera, with the options that give one."""
    from jaxgeo.io.acquisitions.detect import form_of

    lens = ", or --camera focal=8.8mm,pitch=2.41um,size=5472x3648"
    ways = lens if any(not file.is_dir() and "cameras" in form_of(file).takes for file in asked.files) else ""
    return f"{found.path}: a {found.form} has no camera; give --scene SCENE.toml{ways}."


def _seen_by(found: Any, scene: Any, path: Any, held: list[str]) -> Any:
    """Exposures with the camera of a scene, its gimbal readings held fixed."""
    import numpy as np

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.sensor import Gimbal, Mount, Sensor, Shot

    count = len(found)
    if found.of_camera:
        sensor = Sensor(scene.sensor.camera, Gimbal.fixed(), Mount.nadir())
        held.append(f"Only the camera of {path} is used, without gimbal and mount: the file has camera angles.")
        return dataclasses.replace(found, sensor=for_each(sensor, count))
    readings = np.zeros(0) if scene.shot is None else np.asarray(scene.shot.gimbal_readings)
    names = scene.sensor.gimbal.names
    if len(readings) != len(names):
        raise UserError(f"{path}: [pose] and [gimbal] readings are missing; {found.path} has none either.")
    shots = Shot(found.shots.pose, np.broadcast_to(readings, (count, len(names))), found.shots.time)
    held += [f"Gimbal readings are held at those in {path}."] if names else []
    return dataclasses.replace(found, sensor=for_each(scene.sensor, count), shots=shots)


def _with_errors(found: Any, stated: tuple[Any, ...], asked: LocateOptions) -> tuple[Any, list[str]]:
    """(exposures with error sources of the file, then those `stated`, then default ones; assumptions)."""
    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.io.acquisitions.usual_errors import usual_errors_of
    from jaxgeo.uncertainty import sources

    typed = {sources.Position: asked.sigmas.position, sources.Attitude: asked.sigmas.attitude}
    typed[sources.GimbalAngles] = asked.sigmas.gimbal
    own = {type(one) for one in found.sources}
    beside = tuple(one for one in stated if type(one) not in own)
    found = dataclasses.replace(found, sources=(*found.sources, *for_each(beside, len(found))))
    if stated and not found.of_camera:
        return found, []
    usual = [(one, told) for one, told in usual_errors_of(found) if typed.get(type(one)) is None]
    added = for_each(tuple(one for one, _ in usual), len(found))
    option = {sources.Position: "position", sources.Attitude: "attitude", sources.GimbalAngles: "gimbal"}
    assumed = [f"{told} (--{option[type(one)]}-sigma)" for one, told in usual]
    return dataclasses.replace(found, sources=(*found.sources, *added)), assumed
