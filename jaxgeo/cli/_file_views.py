"""Exposures and their pixels, of files and folders of cameras and aircraft."""

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

TOLD = 10  # reasons why files could not be read that are printed


def read_files(files: Sequence[pathlib.Path], how: dict[str, Any]) -> Any:
    """The exposures of files and folders, an `AcquisitionSet`, and what could not be read.

    Raises `UserError` where none can be read, a mistake in an option, and as `read_acquisitions`.
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
        first, *others = sorted(found.unread, key=lambda one: is_refusal(one.error))  # a fault before refusals
        if not others or not is_refusal(first.error):
            raise first.error
    raise UserError(f"none of {len(found.unread)} files can be read. The first: {reason_of(first.error)}")


def _one(file: pathlib.Path, how: dict[str, Any]) -> Any:
    import numpy as np

    from jaxgeo.io.acquisitions import AcquisitionSet, read_acquisition

    found = read_acquisition(file, **how)
    return AcquisitionSet((found,), (np.arange(len(found)),), (), found.assumed)


def tell_unread(unread: Iterable[Any]) -> None:
    """Which files could not be read, and why; not more than fit on a screen."""
    each = list(unread)
    for one in each[:TOLD]:
        tell(f"not read: {reason_not_read(one)}")
    if len(each) > TOLD:
        tell(f"not read: {len(each) - TOLD} more files; --json has the reason of each.")


def views_of_files(asked: LocateOptions) -> ExposureSet:
    """The pixels asked for of each exposure; a row for each file that could not be read. Raises as `read_files`."""
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


# How a reader's sentences on errors that it gives go on, and the options that replace these.
ERRORS_TOLD = {"Focal lengths err by": "focal", "Principal points err by": "principal", "these err by": "position"}

# Of lenses that are taken to be free of distortion; not where an option states the error of the focal length.
BENT = "what it bends at the corners counts as an error of the focal length"


def _apart(assumed: list[str], asked: LocateOptions) -> tuple[list[str], list[str]]:
    """(what was assumed, those of the errors with the option that replaces them, less those that are replaced)."""
    others, of_errors = [], []
    focal = asked.sigmas.focal
    for one in assumed:
        if focal is not None:
            one = one.replace(
                BENT, f"what it bends at the corners errs only as far as --focal-sigma {focal} allows for it"
            )
        option = next((name for words, name in ERRORS_TOLD.items() if words in one), None)
        if option is None:
            others.append(one)
        elif getattr(asked.sigmas, option) is None:
            of_errors.append(f"{one} (--{option}-sigma)")
    return others, of_errors


WITHOUT_ERROR = "The camera is taken as it is given, without error"  # what a reader says that got a camera alone


def _are_images(files: Sequence[pathlib.Path], scene: pathlib.Path) -> bool:
    """Whether all files are drone images, or folders of them, which take the camera of a scene and no more of it.

    Raises `UserError` for a mixture. Files of no known kind are left to the reader.
    """
    from jaxgeo.io.acquisitions.detect import DRONE_IMAGES

    kinds = {form is DRONE_IMAGES for form in map(_form, files) if form is not None}
    if len(kinds) > 1:
        raise UserError(
            f"--scene {scene}: drone images take its camera alone, the other files all of it; locate them apart."
        )
    return kinds == {True}


def _form(file: pathlib.Path) -> Any:
    """What kind of file it is, or None."""
    from jaxgeo.io.acquisitions.detect import form_of
    from jaxgeo.io.errors import TableError

    try:
        return form_of(file)
    except (TableError, OSError):
        return None


def _with_camera_of_scene(asked: LocateOptions) -> dict[str, Any]:
    """How to read drone images with the camera of a scene. Raises `UserError`."""
    if "camera" in asked.how:
        raise UserError(f"--scene {asked.scene} and --camera {asked.how['camera']}: both are a camera; leave one out.")
    return {**asked.how, "camera": asked.scene}


def _name(unread: Any, found: Any) -> str:
    """What the row of a file that could not be read is called: as the others, by its path if two have one name."""
    names = [str(name) for part in found.parts for name in part.names] + [one.name for one in found.unread]
    return unread.name if names.count(unread.name) == 1 else unread.path


def _row(name: str, time: Any, u: float | None, v: float | None, has_times: bool) -> dict[str, Any]:
    is_known = math.isfinite(time) and time != 0.0
    told = {"time_s": float(time) if is_known else None} if has_times else {}
    return {"name": name, **told, "u": u, "v": v}


def _chosen(found: Any, names: list[str], places: list[int]) -> list[int]:
    """Places of the exposures with names, all without. Raises `UserError`."""
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
            raise UserError(f"--exposure {typed}: no exposure has this name; there are {some}.")
    return [known[name] for name in own]


def _own_name(name: str, found: Any) -> str:
    """The number of a record for FILE/NUMBER, its name among several files, where its file is the only one."""
    from jaxgeo.io.acquisitions._exposure_names import number_in_file

    is_alone = len(found.parts) == 1 and not found.unread
    return (number_in_file(name, found.parts[0].path) if is_alone else None) or name


def _seen(part: Any, lanes: list[tuple[int, int]], pixels: Any) -> Seen:
    """Pixels of a part, by (row, exposure) of each."""
    import jax
    import numpy as np

    rows, index = np.array(lanes).T
    taken = jax.tree.map(lambda leaf: np.asarray(leaf)[index], (part.sensor, part.shots, part.sources))
    sensor, shots, sources = taken
    uv = np.tile(pixels, (len(lanes) // len(pixels), 1))
    heights = None if part.reported is None else np.asarray(part.reported.centre.height)[index]
    return Seen(sensor, shots, uv, sources, rows, heights)


def _with_cameras(found: Any, asked: LocateOptions, by_scene: bool) -> tuple[Any, Any, list[str], list[str]]:
    """(exposures with a camera, that of the scene if they have none, and with errors; the scene's air; what was
    assumed of the gimbal; of errors). `by_scene`: their camera was read from the scene already."""
    from jaxgeo.io.acquisitions.sentences import told_once
    from jaxgeo.io.scene import read_scene

    bare = [part for part in found.parts if part.sensor is None]
    if asked.scene is not None and not bare and not by_scene:
        if found.unread:  # among which may be what the scene is for
            raise UserError(reason_not_read(found.unread[0]))
        raise UserError(f"--scene {asked.scene}: {asked.named}: there is a camera in it already; leave the scene out.")
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
            held.append(f"Of {asked.scene} the camera, the errors of its lens and its air are taken, and nothing else.")
        part, told = _with_errors(part, beside, asked)
        usual.extend([told] * len(part))
        return part

    found = found.with_parts(complete)
    air = None if scene is None else scene.atmosphere
    return found, air, list(dict.fromkeys(held)), list(told_once(usual, "exposure"))


def _without_bare(found: Any, asked: LocateOptions) -> Any:
    """The exposures with a camera; files without one cannot be located. Raises `UserError` if none has one."""
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
    """Exposures with the errors of the lens that a scene states for its `camera`, in pixels of their own images."""
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
    """Errors of a scene that have a part: none of gimbal and mount where the angles are the camera's own."""
    from jaxgeo.uncertainty import sources

    if not found.of_camera:
        return stated
    of_gimbal = (sources.GimbalAngles, sources.GimbalMounting)
    without = (*of_gimbal, sources.Boresight, sources.CameraMounting, sources.LeverArm)
    return tuple(one for one in stated if not isinstance(one, without))


def _without_a_camera(found: Any, asked: LocateOptions) -> str:
    """That a file has no camera, and which options give one."""
    from jaxgeo.io.acquisitions.detect import form_of

    lens = ", or --camera focal=8.8mm,pitch=2.41um,size=5472x3648, the camera's own numbers"
    ways = lens if any(not file.is_dir() and "cameras" in form_of(file).takes for file in asked.files) else ""
    return f"{found.path}: there is no camera in a {found.form}; give --scene SCENE.toml, which has one{ways}."


def _seen_by(found: Any, scene: Any, path: Any, held: list[str]) -> Any:
    """Exposures without a camera, taken by that of a scene, its gimbal held."""
    import numpy as np

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.sensor import Gimbal, Mount, Sensor, Shot

    count = len(found)
    if found.of_camera:
        sensor = Sensor(scene.sensor.camera, Gimbal.fixed(), Mount.nadir())
        held.append(
            f"Of {path} the camera is taken, without gimbal and mount: the angles in the file are the camera's own."
        )
        return dataclasses.replace(found, sensor=for_each(sensor, count))
    readings = np.zeros(0) if scene.shot is None else np.asarray(scene.shot.gimbal_readings)
    names = scene.sensor.gimbal.names
    if len(readings) != len(names):
        raise UserError(f"{path}: [pose] and readings in [gimbal] are missing; {found.path} does not have them.")
    shots = Shot(found.shots.pose, np.broadcast_to(readings, (count, len(names))), found.shots.time)
    held += [f"The gimbal is held at the readings in {path}."] if names else []
    return dataclasses.replace(found, sensor=for_each(scene.sensor, count), shots=shots)


def _with_errors(found: Any, stated: tuple[Any, ...], asked: LocateOptions) -> tuple[Any, list[str]]:
    """(exposures with the errors that the file states, those `stated` beside it, then usual ones; what was assumed)."""
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
