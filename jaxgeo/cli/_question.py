"""What `jaxgeo locate` and `jaxgeo report` ask: exposures, pixels, ground and errors, read from all that is given."""

from __future__ import annotations

import math
import pathlib
from typing import Annotated, Any, NamedTuple

import typer

from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas, errors_given, ground_errors, pixel_pitch_of
from jaxgeo.cli._inputs import height_datum_of, numbers_in, read_terrain, said_datum, shot_of, terrain_files
from jaxgeo.cli._options import SEEN
from jaxgeo.cli._screen import working

Source = Annotated[
    pathlib.Path | None,
    typer.Argument(
        metavar="FILE",
        help="Drone image or folder, KLV, SBET, table, reconstruction, scene.",
        show_default=False,
    ),
]
SceneOption = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--scene",
        metavar="FILE",
        help="Scene file (TOML): camera, gimbal, mount and pose; for FILEs without a camera too.",
        rich_help_panel=SEEN,
    ),
]
GroundDem = Annotated[
    list[pathlib.Path] | None,
    typer.Option("--dem", metavar="FILE", help="Elevation model; repeat it for several tiles.", rich_help_panel=SEEN),
]
GroundDatum = Annotated[
    str | None,
    typer.Option(
        "--vertical-datum",
        metavar="DATUM",
        help='What heights of the ground are above: "EPSG:5773", "ellipsoid", metres, a geoid grid.',
        rich_help_panel=SEEN,
    ),
]
Ground = Annotated[
    str | None,
    typer.Option(
        "--ground",
        metavar="HEIGHT",
        help="Level ground in place of --dem: its height in m, above the ellipsoid or --vertical-datum; or 'reported': "
        "the height of the frame centre that telemetry reports.",
        rich_help_panel=SEEN,
    ),
]
Pixels = Annotated[
    list[str] | None,
    typer.Option(
        "--pixel",
        metavar="PIXEL",
        help="COLUMN,ROW of a pixel; repeat it for more; the middle of the image if left out.",
        rich_help_panel=SEEN,
    ),
]
Exposures = Annotated[
    list[str] | None,
    typer.Option(
        "--exposure",
        metavar="NAME",
        help="Which of the FILE's exposures, by name; repeat it; all if not.",
        rich_help_panel=SEEN,
    ),
]
TableOfShots = Annotated[
    pathlib.Path | None,
    typer.Option(
        "--shots",
        metavar="FILE",
        help="With --scene: CSV with a shot and a pixel in each row.",
        rich_help_panel=SEEN,
    ),
]
Refraction = Annotated[
    bool,
    typer.Option(
        "--refraction", help="Bend lines of sight by the US Standard Atmosphere of 1976.", rich_help_panel=SEEN
    ),
]
REPORTED = "reported"


class Asked(NamedTuple):
    """What was typed."""

    file: pathlib.Path | None
    scene: pathlib.Path | None
    shots: pathlib.Path | None
    pixels: list[str]
    exposures: list[str]
    dem: list[pathlib.Path]
    ground: str | None
    vertical_datum: str | None
    refraction: bool
    how: dict[str, Any]
    sigmas: Sigmas


class Question(NamedTuple):
    """n pixels, each of its own exposure, and what is known of them.

    `shots` and `uv` (n, 2) have an entry for each pixel; `sensor`, `terrain` and `errors` (sources, without any: None)
    too where `axes`, for (sensor, shot, uv, terrain, errors), has 0, and are one for all where it has None. `carried`
    is told of each with its fix, `readings` are the names of the gimbal's axes, `assumed` sentences; `reads` all files.
    """

    sensor: Any
    shots: Any
    uv: Any
    terrain: Any
    errors: tuple[Any, ...] | None
    axes: tuple[int | None, ...]
    atmosphere: Any
    carried: list[dict[str, Any]]
    readings: tuple[str, ...]
    assumed: list[str]
    inputs: dict[str, Any]
    reads: list[Any]

    def lane(self, index: int) -> tuple[Any, Any, Any, Any, Any]:
        """(sensor, shot, pixel, terrain, errors) of one pixel."""
        import jax
        import numpy as np

        given = (self.sensor, self.shots, self.uv, self.terrain, self.errors)
        own = jax.tree.map(
            lambda leaf: np.asarray(leaf)[index], [one if a == 0 else None for one, a in self._of(given)]
        )
        one: Any = tuple(a if axis == 0 else b for a, b, axis in zip(own, given, self.axes, strict=True))
        return one

    def _of(self, given: tuple[Any, ...]) -> Any:
        return zip(given, self.axes, strict=True)


class _Views(NamedTuple):
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


def read_question(asked: Asked, *, with_errors: bool | None) -> Question:
    """All input, what is small and likely to be mistaken first.

    Errors are there `with_errors`; if that is None, where a FILE is given, or something says how it errs: a table
    [errors] of the scene, or an option. Raises `UserError`, and as the readers.
    """
    _check_asked(asked)
    is_scene = asked.file is None or asked.file.suffix.lower() == ".toml"
    if with_errors is None and asked.shots is None:
        with_errors = not is_scene or asked.sigmas.are_given or None
    views = _of_scene(asked) if is_scene else _of_file(asked)
    if with_errors is None:
        with_errors = bool(views.sources) and asked.shots is None
    if asked.refraction:
        views = _in_air(views)
    sources, assumed = (None, []) if not with_errors else _sources(views, asked)
    terrain, each_ground = _terrain(asked, views)
    axes = (0 if views.is_each else None, 0, 0, 0 if each_ground else None, 0 if views.is_each else None)
    return Question(
        views.sensor,
        views.shots,
        views.uv,
        terrain,
        sources,
        axes,
        views.atmosphere,
        views.carried,
        tuple(views.sensor.gimbal.names),
        [*views.assumed, *assumed],
        _inputs(asked),
        _reads(asked),
    )


def _check_asked(asked: Asked) -> None:
    if asked.file is None and asked.scene is None:
        raise UserError("give a FILE of a camera or an aircraft, as jaxgeo inspect reads it, or --scene SCENE.toml.")
    if asked.shots is not None:
        if asked.file is not None:
            raise UserError(f"--shots {asked.shots}: it goes with --scene, and not with {asked.file}.")
        if asked.pixels:
            raise UserError("give either --pixel COLUMN,ROW (once or more) or --shots FILE.")
    if bool(asked.dem) == (asked.ground is not None):
        raise UserError("give the ground: either --dem FILE, or --ground HEIGHT for level ground.")
    if asked.exposures and (asked.file is None or asked.file.suffix.lower() == ".toml"):
        raise UserError("--exposure goes with a FILE of exposures; a scene has one.")
    if asked.sigmas.dem_correlation is not None and asked.ground is not None:
        raise UserError("--dem-correlation: level ground errs alike everywhere; it goes with --dem.")


def _of_scene(asked: Asked) -> _Views:
    import jax
    import numpy as np

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
        try:
            shots, uv = table.as_records(scene.sensor.gimbal.names, height_datum)
        except ValueError as error:  # the datum's grid does not reach a shot
            raise SceneError(f"{path}, with the heights of {asked.shots}: {error}") from error
        carried = table.rows
    return _Views(
        scene.sensor, shots, uv, sources, False, carried, scene.atmosphere, [], path, pixel_pitch_of(path), []
    )


def _of_file(asked: Asked) -> _Views:
    import jax
    import numpy as np

    from jaxgeo.cli._acquisitions import as_typed
    from jaxgeo.io.acquisitions import UnstatedDatum, read_acquisition

    assert asked.file is not None
    try:
        with working(f"reading {asked.file.name}"):
            found = read_acquisition(asked.file, **asked.how)
    except UnstatedDatum as error:
        raise UserError(as_typed(str(error))) from error
    found, atmosphere, of_errors = _with_camera(found, asked)
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
    assumed = [as_typed(one) for one in found.assumed]
    sensors, shots, sources = taken
    return _Views(
        sensors, shots, pixels, sources, True, carried, atmosphere, assumed, asked.file, None, of_errors, reported
    )


def _with_camera(found: Any, asked: Asked) -> tuple[Any, Any, list[str]]:
    """(exposures with a camera, the scene's if they have none, and with errors; the scene's air; what was assumed)."""
    from jaxgeo.io.scene import read_scene

    if found.sensor is not None:
        if asked.scene is not None:
            raise UserError(f"--scene {asked.scene}: {found.path} has a camera of its own; leave the scene out.")
        return _with_errors(found, (), asked, None)
    if asked.scene is None:
        raise UserError(f"{found.path}: there is no camera in a {found.form}; give --scene SCENE.toml, which has one.")
    scene = read_scene(asked.scene)
    stated = () if scene.errors is None else scene.errors.sources
    return _with_errors(_seen_by(found, scene, asked.scene), stated, asked, scene.atmosphere)


def _seen_by(found: Any, scene: Any, path: pathlib.Path) -> Any:
    """Exposures without a camera, taken by that of a scene, its gimbal held."""
    import dataclasses

    import numpy as np

    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.sensor import Shot

    readings = np.zeros(0) if scene.shot is None else np.asarray(scene.shot.gimbal_readings)
    names = scene.sensor.gimbal.names
    if len(readings) != len(names):
        raise UserError(f"{path}: [pose] and readings in [gimbal] are missing; {found.path} does not have them.")
    count = len(found)
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
    if stated:
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


def _in_air(views: _Views) -> _Views:
    import numpy as np

    from jaxgeo.earth import Atmosphere
    from jaxgeo.io import undulation

    if views.atmosphere is not None:
        raise UserError(f"--refraction: {views.where} has air of its own, [air]; leave the option out.")
    position = views.shots.pose.position
    lat, lon = (float(np.rad2deg(np.asarray(angle)[0])) for angle in (position.lat, position.lon))
    return views._replace(atmosphere=Atmosphere(sea_level=float(undulation(lat, lon))))


def _sources(views: _Views, asked: Asked) -> tuple[tuple[Any, ...], list[str]]:
    """(sources of error, one entry for each pixel where exposures have their own; what was assumed of the ground)."""
    from jaxgeo.io.acquisitions import for_each
    from jaxgeo.uncertainty import sources

    of_ground = sources.TerrainHeight | sources.TerrainField
    count = len(views.uv)
    own = tuple(one for one in views.sources if not isinstance(one, of_ground))
    given = errors_given(own, asked.sigmas, views.sensor.gimbal, views.where, views.pixel_pitch)
    if views.is_each:
        kept = {id(one) for one in own}
        given = tuple(one if id(one) in kept else for_each(one, count) for one in given)
    ground, of_heights = ground_errors(views.sources, asked.sigmas, level=asked.ground is not None)
    if views.is_each:
        stated = {id(one) for one in views.sources}
        ground = tuple(one if id(one) in stated else for_each(one, count) for one in ground)
    found = (*given, *ground)
    if not found:
        raise UserError(
            f"nothing says how {views.where} errs: write a table [errors] in the scene, or give --position-sigma, "
            f"--attitude-sigma, --gimbal-sigma, --dem-sigma."
        )
    return found, [*views.assumed_of_errors, *of_heights]


def _terrain(asked: Asked, views: _Views) -> tuple[Any, bool]:
    """(the ground, whether there is one for each pixel)."""
    import numpy as np

    from jaxgeo.io.scene import ellipsoidal_heights
    from jaxgeo.terrain import ConstantHeight

    if asked.ground is None:
        return read_terrain(asked.dem, asked.vertical_datum), False
    if asked.ground == REPORTED:
        heights = views.centre_heights
        if heights is None or not np.isfinite(heights).any():
            raise UserError(f"--ground {REPORTED}: {views.where} reports no height of what its images show; give it.")
        return ConstantHeight(np.asarray(heights)), True
    try:
        height = float(asked.ground)
    except ValueError:
        height = math.nan
    if not math.isfinite(height):
        raise UserError(f"--ground {asked.ground!r}: expected a height in m, or {REPORTED!r}.")
    if asked.vertical_datum is None:
        return ConstantHeight(np.asarray(height)), False
    position = views.shots.pose.position
    lon, lat = (np.rad2deg(np.asarray(angle)) for angle in (position.lon, position.lat))
    datum = said_datum(asked.vertical_datum)
    return ConstantHeight(ellipsoidal_heights(lon, lat, np.full(len(lon), height), datum)), True


def _inputs(asked: Asked) -> dict[str, Any]:
    """What was typed, in plain words."""
    paths = {"file": asked.file, "scene": asked.scene, "shots": asked.shots}
    found: dict[str, Any] = {name: str(path) for name, path in paths.items() if path is not None}
    found |= {"dem": [str(path) for path in asked.dem]} if asked.dem else {"ground": asked.ground}
    if asked.vertical_datum is not None:
        found["vertical_datum"] = asked.vertical_datum
    found |= {name: str(value) if isinstance(value, pathlib.Path) else value for name, value in asked.how.items()}
    sigmas = {name: value for name, value in asked.sigmas._asdict().items() if value is not None}
    return found | ({"sigmas": sigmas} if sigmas else {}) | ({"refraction": True} if asked.refraction else {})


def _reads(asked: Asked) -> list[Any]:
    named = [asked.file, asked.scene, asked.shots, asked.how.get("errors"), asked.how.get("interior")]
    files: list[Any] = [one for one in named if one is not None]
    for folder in [one for one in files if pathlib.Path(one).is_dir()]:
        files += sorted(pathlib.Path(folder).iterdir())
    return [*files, *(terrain_files(asked.dem, asked.vertical_datum) if asked.dem else [])]
