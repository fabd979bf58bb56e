"""Exposures and their pixels, of a scene or of a file, before anything is known of the ground."""

from __future__ import annotations

import math
import pathlib
from typing import Any, NamedTuple

from jaxgeo.cli._asked import Asked
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import pixel_pitch_of
from jaxgeo.cli._inputs import check_stated, height_datum_of, numbers_in, shot_of
from jaxgeo.cli._screen import working
from jaxgeo.cli._words import as_typed, words_as_typed


class Views(NamedTuple):
    """Pixels and their exposures, before anything is known of the ground; as in `Question`."""

    sensor: Any
    shots: Any
    uv: Any
    sources: tuple[Any, ...]
    is_each: bool
    carried: list[dict[str, Any]]
    atmosphere: Any
    assumed: list[str]
    where: pathlib.Path
    pixel_pitch: float | None
    assumed_of_errors: list[str]
    centre_heights: Any = None


def views_of_scene(asked: Asked) -> Views:
    import jax
    import numpy as np

    from jaxgeo.io.errors import OutsideDatum, VerticalDatumError
    from jaxgeo.io.scene import SceneError, read_scene
    from jaxgeo.io.tables import read_shots

    if asked.file is not None and asked.scene is not None:
        raise UserError(f"{asked.file} is a scene file by itself; leave --scene {asked.scene} out.")
    path = asked.file if asked.file is not None else asked.scene
    assert path is not None
    if asked.how:
        raise UserError(f"--{next(iter(asked.how)).replace('_', '-')} is of other FILEs than scenes; leave it out.")
    scene = read_scene(path)
    sources = () if scene.errors is None else scene.errors.sources
    if asked.shots is None:
        shot = shot_of(scene, path, "--pixel")
        uv = pixels_of(asked.pixels, scene.sensor.camera)
        shots = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (len(uv), *np.shape(leaf))), shot)
        carried: list[dict[str, Any]] = [{"u": float(u), "v": float(v)} for u, v in uv]
    else:
        height_datum = height_datum_of(scene, path, asked.shots)
        table = read_shots(asked.shots, scene.sensor.gimbal.names)
        check_stated(table, asked.shots, scene.sensor.gimbal, height_datum)
        try:
            shots, uv = table.as_records(scene.sensor.gimbal.names, height_datum)
        except (OutsideDatum, VerticalDatumError) as error:
            raise SceneError(f"{path}, with the heights of {asked.shots}: {error}") from error
        carried = table.rows
    return Views(scene.sensor, shots, uv, sources, False, carried, scene.atmosphere, [], path, pixel_pitch_of(path), [])


def views_of_file(asked: Asked) -> Views:
    import jax
    import numpy as np

    from jaxgeo.io.acquisitions import read_acquisition
    from jaxgeo.io.acquisitions.detect import DRONE_IMAGES, form_of

    assert asked.file is not None
    by_scene = asked.scene is not None and form_of(asked.file) is DRONE_IMAGES
    how = _camera_of_scene(asked) if by_scene else asked.how
    with working(f"reading {asked.file.name}"), words_as_typed():
        found = read_acquisition(asked.file, **how)
    found, atmosphere, of_errors = (_with_lens_of_scene if by_scene else _with_camera)(found, asked)
    try:
        chosen = [found.index_of(name) for name in asked.exposures] or list(range(len(found)))
    except KeyError as error:
        raise UserError(f"--exposure: {error.args[0]}.") from None
    uv = pixels_of(asked.pixels, jax.tree.map(lambda leaf: np.asarray(leaf)[0], found.sensor).camera)
    lanes = np.repeat(chosen, len(uv))
    pixels = np.tile(uv, (len(chosen), 1))
    taken = jax.tree.map(lambda leaf: np.asarray(leaf)[lanes], (found.sensor, found.shots, found.sources))
    reported = None if found.reported is None else np.asarray(found.reported.centre.height)[lanes]
    times = np.asarray(found.shots.time)
    has_times = bool(np.any(times != 0.0))
    carried: list[dict[str, Any]] = []
    for lane, (u, v) in zip(lanes, pixels, strict=True):
        time = {"time_s": float(times[lane]) if math.isfinite(times[lane]) else None} if has_times else {}
        carried.append({"name": str(found.names[lane]), **time, "u": float(u), "v": float(v)})
    assumed, of_reader = _apart([as_typed(one) for one in found.assumed], asked)
    sensors, shots, sources = taken
    return Views(
        sensors,
        shots,
        pixels,
        sources,
        True,
        carried,
        atmosphere,
        assumed,
        asked.file,
        None,
        [*of_reader, *of_errors],
        reported,
    )


# How a reader's sentences on errors that it gives go on, and the options that replace these.
ERRORS_TOLD = {"Focal lengths err by": "focal", "Principal points err by": "principal", "these err by": "position"}


def _apart(assumed: list[str], asked: Asked) -> tuple[list[str], list[str]]:
    """(what was assumed, those of the errors with the option that replaces them, less those that are replaced)."""
    others, of_errors = [], []
    for one in assumed:
        option = next((name for words, name in ERRORS_TOLD.items() if words in one), None)
        if option is None:
            others.append(one)
        elif getattr(asked.sigmas, option) is None:
            of_errors.append(f"{one} (--{option}-sigma)")
    return others, of_errors


def _camera_of_scene(asked: Asked) -> dict[str, Any]:
    """How to read drone images with the camera of a scene. Raises `UserError`."""
    if "camera" in asked.how:
        raise UserError(f"--scene {asked.scene} and --camera {asked.how['camera']}: both are a camera; leave one out.")
    return {**asked.how, "camera": asked.scene}


def _with_lens_of_scene(found: Any, asked: Asked) -> tuple[Any, Any, list[str]]:
    """Drone images read with the camera of a scene, as `_with_camera`: with its errors of the lens, and its air."""
    import dataclasses

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.io.scene import read_scene
    from jaxgeo.uncertainty import sources

    assert asked.scene is not None
    scene = read_scene(asked.scene)
    stated = () if scene.errors is None else scene.errors.sources
    lens = tuple(one for one in stated if isinstance(one, sources.InteriorOrientation | sources.Distortion))
    found = dataclasses.replace(found, sources=(*found.sources, *for_each(lens, len(found))))
    return _with_errors(found, (), asked, scene.atmosphere)


def _with_camera(found: Any, asked: Asked) -> tuple[Any, Any, list[str]]:
    """(exposures with a camera, the scene's if they have none, and with errors; the scene's air; what was assumed)."""
    from jaxgeo.io.scene import read_scene

    if found.sensor is not None:
        if asked.scene is not None:
            raise UserError(f"--scene {asked.scene}: {found.path} has a camera of its own; leave the scene out.")
        return _with_errors(found, (), asked, None)
    if asked.scene is None:
        raise UserError(_without_a_camera(found, asked))
    scene = read_scene(asked.scene)
    stated = () if scene.errors is None else scene.errors.sources
    if found.of_camera:
        stated = tuple(one for one in stated if not isinstance(one, _of_gimbal_and_mount()))
    return _with_errors(_seen_by(found, scene, asked.scene), stated, asked, scene.atmosphere)


def _of_gimbal_and_mount() -> tuple[type, ...]:
    """Errors that have no part where the angles are the camera's own."""
    from jaxgeo.uncertainty import sources

    of_gimbal = (sources.GimbalAngles, sources.GimbalMounting)
    return (*of_gimbal, sources.Boresight, sources.CameraMounting, sources.LeverArm)


def _without_a_camera(found: Any, asked: Asked) -> str:
    """That a file has no camera, and which options give one."""
    from jaxgeo.io.acquisitions.detect import form_of

    assert asked.file is not None
    lens = ", or --camera focal=8.8mm,pitch=2.41um,size=5472x3648, the camera's own numbers"
    ways = lens if "cameras" in form_of(asked.file).takes else ""
    return f"{found.path}: there is no camera in a {found.form}; give --scene SCENE.toml, which has one{ways}."


def _seen_by(found: Any, scene: Any, path: pathlib.Path) -> Any:
    """Exposures without a camera, taken by that of a scene, its gimbal held."""
    import dataclasses

    import numpy as np

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.sensor import Gimbal, Mount, Sensor, Shot

    count = len(found)
    if found.of_camera:
        sensor = Sensor(scene.sensor.camera, Gimbal.fixed(), Mount.nadir())
        own = f"Of {path} the camera is taken, without gimbal and mount: the angles in the file are the camera's own."
        return dataclasses.replace(found, sensor=for_each(sensor, count), assumed=(*found.assumed, own))
    readings = np.zeros(0) if scene.shot is None else np.asarray(scene.shot.gimbal_readings)
    names = scene.sensor.gimbal.names
    if len(readings) != len(names):
        raise UserError(f"{path}: [pose] and readings in [gimbal] are missing; {found.path} does not have them.")
    shots = Shot(found.shots.pose, np.broadcast_to(readings, (count, len(names))), found.shots.time)
    held = (f"The gimbal is held at the readings in {path}.",) if names else ()
    return dataclasses.replace(
        found, sensor=for_each(scene.sensor, count), shots=shots, assumed=(*found.assumed, *held)
    )


def _with_errors(found: Any, stated: tuple[Any, ...], asked: Asked, air: Any) -> tuple[Any, Any, list[str]]:
    """As `_with_camera`: errors that the file states, those `stated` beside it, then usual ones for what is missing."""
    import dataclasses

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.io.acquisitions.usual_errors import usual_errors_of
    from jaxgeo.uncertainty import sources

    typed = {sources.Position: asked.sigmas.position, sources.Attitude: asked.sigmas.attitude}
    typed[sources.GimbalAngles] = asked.sigmas.gimbal
    own = {type(one) for one in found.sources}
    beside = tuple(one for one in stated if type(one) not in own)
    found = dataclasses.replace(found, sources=(*found.sources, *for_each(beside, len(found))))
    if stated and not found.of_camera:
        return found, air, []
    usual = [(one, told) for one, told in usual_errors_of(found) if typed.get(type(one)) is None]
    added = for_each(tuple(one for one, _ in usual), len(found))
    option = {sources.Position: "position", sources.Attitude: "attitude", sources.GimbalAngles: "gimbal"}
    assumed = [f"{told} (--{option[type(one)]}-sigma)" for one, told in usual]
    return dataclasses.replace(found, sources=(*found.sources, *added)), air, assumed


def pixels_of(texts: list[str], camera: Any) -> Any:
    """Pixels (n, 2) from the command line, the middle of the image without any. Raises `UserError`."""
    import numpy as np

    found = [numbers_in("--pixel", text, (2,), "COLUMN,ROW, two numbers, e.g. --pixel 100,200") for text in texts]
    return np.array(found or [[0.5 * (camera.width - 1), 0.5 * (camera.height - 1)]])


def in_air(views: Views) -> Views:
    import numpy as np

    from jaxgeo.earth import Atmosphere
    from jaxgeo.io import undulation

    if views.atmosphere is not None:
        raise UserError(f"--refraction: {views.where} has air of its own, [air]; leave the option out.")
    position = views.shots.pose.position
    lat, lon = (float(np.rad2deg(np.asarray(angle)[0])) for angle in (position.lat, position.lon))
    return views._replace(atmosphere=Atmosphere(sea_level=float(undulation(lat, lon))))
