"""`jaxgeo point`: gimbal readings for a target or a line of sight."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

import numpy as np
import typer

from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import DONE, NO_ANSWER, Debug, UserError, report_errors
from jaxgeo.cli._compiler import compile_quickly
from jaxgeo.cli._console import Console
from jaxgeo.cli._exposures import ExposureOptions, GivenExposure
from jaxgeo.cli._inputs import as_datum, check_goes_with_dem, check_on_image, numbers_in, read_terrain
from jaxgeo.cli._known_heights import with_known_heights
from jaxgeo.cli._options import DemOptions
from jaxgeo.cli._results import AsJson, given_options, print_json, status_words
from jaxgeo.cli._screen import is_quiet, stderr, working
from jaxgeo.earth import Geodetic
from jaxgeo.sensor import Pose, Shot

UNHIDDEN = "Pointing solved; terrain not checked (no --dem)."


def point_command(
    given: ExposureOptions,
    dem: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE",
            help="Elevation model, to check visibility: a file, an archive (copernicus, ...), or a URL with "
            "--allow-remote; repeatable for tiles.",
        ),
    ] = None,
    position: Annotated[
        str | None,
        typer.Option(
            "--position",
            metavar="PLACE",
            help="LAT,LON,HEIGHT of the aircraft, deg and m, instead of that of the scene or FILE; height above "
            "--camera-datum (default: the scene's).",
        ),
    ] = None,
    attitude: Annotated[
        str | None,
        typer.Option(
            "--attitude",
            metavar="ANGLES",
            help="HEADING or HEADING,PITCH,ROLL of the aircraft, deg, instead of that of the scene or FILE.",
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(metavar="PLACE", help="LAT,LON in deg, or LAT,LON,HEIGHT; without a height, that of --dem."),
    ] = None,
    target_datum: Annotated[
        str | None,
        typer.Option(
            "--target-datum",
            metavar="DATUM",
            help='Vertical datum of the height of --target: "EPSG:5773", "ellipsoid", an undulation in m (default: the '
            "scene's).",
        ),
    ] = None,
    line_of_sight: Annotated[
        str | None,
        typer.Option(
            metavar="DIRECTION",
            help="AZIMUTH,DEPRESSION in deg instead of a target: from true north; downwards.",
        ),
    ] = None,
    pixel: Annotated[
        str | None, typer.Option(metavar="PIXEL", help="COLUMN,ROW to point (default: optical axis).")
    ] = None,
    reading: DemOptions = DemOptions(),
    how: ReadingOptions = ReadingOptions(),
    as_json: AsJson = False,
    debug: Debug = False,
) -> None:
    """Gimbal readings that point a pixel at a ground point, or along a line of sight, from a pose.

    The exit code is 1 if the target is outside the gimbal range (the nearest readings are given), hidden by terrain, or
    below the horizon.
    """
    inputs = given_options(locals())
    with report_errors(debug):
        if not dem:
            check_goes_with_dem(reading)
            if reading.vertical_datum is not None:
                raise UserError(f"--dem-datum {reading.vertical_datum} applies to --dem; leave it out.")
        aims = (target, line_of_sight, pixel)
        names, found, aim = _point((given, how), dem or [], reading, (position, attitude), aims, target_datum)
        code = _print_readings(names, found, UNHIDDEN if not dem else None, as_json)
        if as_json:
            meaning = UNHIDDEN if not dem else None
            print_json(
                "point", {"inputs": inputs, **_content(names, found, aim), **status_words(found.status, meaning)}
            )
    raise typer.Exit(code)


def _point(
    of: tuple[ExposureOptions, ReadingOptions],
    dem: list[str],
    reading: DemOptions,
    stands: tuple[str | None, str | None],
    texts: tuple[str | None, str | None, str | None],
    target_datum: str | None,
) -> tuple[tuple[str, ...], Any, Any]:
    """(axis names, pointing, target)."""
    given, how = of
    target, direction, pixel = texts
    if (target is None) == (direction is None):
        raise UserError("give either --target LAT,LON[,HEIGHT] or --line-of-sight AZIMUTH,DEPRESSION.")
    if direction is not None and dem:
        raise UserError("--dem needs --target: a line of sight has no target to check for visibility.")
    place = [] if target is None else numbers_in("--target", target, (2, 3), "LAT,LON or LAT,LON,HEIGHT, deg and m")
    if len(place) == 2 and not dem:
        raise UserError(f"--target {target}: give its height, LAT,LON,HEIGHT, or --dem.")
    if place and not (abs(place[0]) <= 90.0 and abs(place[1]) <= 360.0):
        raise UserError(f"--target {target}: expected LAT,LON in deg, latitudes from -90 to 90; is it LON,LAT?")
    if target_datum is not None and len(place) != 3:
        raise UserError(f"--target-datum {target_datum} applies to a target height: --target LAT,LON,HEIGHT.")
    if target_datum is None and len(place) == 3 and not given.is_scene:
        raise UserError(f"--target {target}: say what its height is above, with --target-datum.")
    aircraft = _Aircraft.of(*stands)
    given.check(dataclasses.replace(how, height_datum=None) if aircraft.is_of_scene(given) else how)
    uv = None if pixel is None else numbers_in("--pixel", pixel, (2,), "COLUMN,ROW, two numbers")
    from jaxgeo._checks import enable_x64
    from jaxgeo.coverage import point_gimbal
    from jaxgeo.io.scene import read_scene

    compile_quickly()
    enable_x64()
    if aircraft.is_of_scene(given):
        found = [aircraft.exposure(given, how.height_datum)]
    else:
        how = with_known_heights(how, given.files or [], given.scene, dem, reading)
        found = given.read(how, "pointing without --position").exposures
    if len(found) != 1:
        raise UserError(
            f"{(given.files or [''])[0]} has {len(found)} exposures; name one with --exposure {found[0].name}."
        )
    (one,) = found
    sensor, shot = one.sensor, one.shot
    assert isinstance(shot, Shot)
    if not aircraft.is_of_scene(given):
        shot = aircraft.moved(shot, None if how.height_datum is None else as_datum(how.height_datum))
    stated = None if target_datum is None else as_datum(target_datum)
    if given.scene_file is not None and stated is None:
        stated = read_scene(given.scene_file).height_datum
    if not sensor.gimbal.names:
        raise UserError(f"{one.name}: a gimbal of kind 'fixed' has no readings to point with.")
    if pixel is not None and uv is not None:
        check_on_image(pixel, uv, sensor.camera)
    terrain = read_terrain(dem, reading, lambda: _view(shot, place)) if dem else None
    aim = _aim(direction) if direction is not None else _target(stated, place, terrain)
    with working("compiling and pointing"):
        pointed = point_gimbal(sensor, shot, target=aim, uv=uv, terrain=terrain, atmosphere=one.atmosphere)
    return sensor.gimbal.names, pointed, aim


@dataclasses.dataclass(frozen=True)
class _Aircraft:
    """Position (lat and lon in deg, height in m) and attitude (deg) of --position and --attitude, if given."""

    position: list[float] | None
    attitude: list[float] | None

    @classmethod
    def of(cls, position: str | None, attitude: str | None) -> _Aircraft:
        """From the options as typed. Raises `UserError`."""
        place = angles = None
        if position is not None:
            place = numbers_in("--position", position, (3,), "LAT,LON,HEIGHT, deg and m")
            if not (abs(place[0]) <= 90.0 and abs(place[1]) <= 360.0):
                raise UserError(
                    f"--position {position}: expected LAT,LON in deg, latitudes from -90 to 90; is it LON,LAT?"
                )
        if attitude is not None:
            angles = numbers_in("--attitude", attitude, (1, 3), "HEADING or HEADING,PITCH,ROLL, deg")
        return cls(place, None if angles is None else [*angles, 0.0, 0.0][:3])

    def is_of_scene(self, given: ExposureOptions) -> bool:
        """Whether a scene gives the sensor, and --position the place."""
        return self.position is not None and given.is_scene and given.scene_file is not None

    def exposure(self, given: ExposureOptions, datum: str | None) -> GivenExposure:
        """The sensor of a scene at this position, with its attitude or level and to the north. Raises `UserError`."""
        from jaxgeo.io.scene import read_scene

        assert given.scene_file is not None
        scene = read_scene(given.scene_file)
        shot = scene.shot
        if shot is None:
            if self.attitude is None:
                print_assumed(["The aircraft is level and heads north. (--attitude HEADING,PITCH,ROLL)"])
            readings = [0.0] * len(scene.sensor.gimbal.names)
            shot = Shot(Pose.from_degrees(lat=0.0, lon=0.0, height=0.0), np.asarray(readings))
        stated = scene.height_datum if datum is None else as_datum(datum)
        return GivenExposure(given.scene_file.name, scene.sensor, self.moved(shot, stated), scene.atmosphere)

    def moved(self, shot: Shot, datum: str | float | None) -> Shot:
        """A shot at this position and with this attitude. Raises `UserError`."""
        from jaxgeo.io.scene import ellipsoidal_heights

        pose = shot.pose
        if self.position is not None:
            lat, lon, height = self.position
            if datum is None:
                raise UserError("--position: say what its height is above, with --camera-datum.")
            height = float(ellipsoidal_heights([lon], [lat], [height], datum)[0])
            pose = dataclasses.replace(pose, position=Geodetic.from_degrees(lat=lat, lon=lon, height=height))
        if self.attitude is not None:
            heading, pitch, roll = np.deg2rad(self.attitude)
            pose = dataclasses.replace(pose, heading=heading, pitch=pitch, roll=roll)
        return dataclasses.replace(shot, pose=pose)


def _view(shot: Any, place: list[float]) -> Any:
    from jaxgeo.io.archives import view_from

    return view_from(shot.pose.position, place[0], place[1])


def _aim(text: str) -> Any:
    from jaxgeo.coverage import LineOfSight

    azimuth, depression = numbers_in("--line-of-sight", text, (2,), "AZIMUTH,DEPRESSION, two numbers in deg")
    return LineOfSight.from_degrees(azimuth=azimuth, depression=depression)


def _target(stated: Any, place: list[float], terrain: Any) -> Any:
    """The target point, with the given height or that of the ground; printed on stderr, a given height also above the
    ground of the elevation model."""
    import math

    from jaxgeo.earth import Geodetic
    from jaxgeo.io.scene import ellipsoidal_heights

    lat, lon = place[:2]
    position = Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)
    if terrain is not None:
        _check_is_on(terrain, place)
    ground = math.nan if terrain is None else float(terrain.height_at(position))
    above = ""
    if len(place) == 3:
        height = float(ellipsoidal_heights([lon], [lat], [place[2]], stated)[0])
        if math.isfinite(ground):
            side = "above" if height >= ground else "below"
            above = f", {abs(height - ground):.2f} m {side} the ground of --dem"
    else:
        height = ground
        if not math.isfinite(height):
            raise UserError(f"--target {lat:g},{lon:g}: the DEM has no height there; give a height, or another DEM.")
    said = f"target: {lat:.6f} deg, {lon:.6f} deg (lat, lon), {height:z.2f} m above the ellipsoid{above}"
    if not is_quiet():
        stderr().print(said, highlight=False, soft_wrap=True)
    return Geodetic.from_degrees(lat=lat, lon=lon, height=height)


def _check_is_on(terrain: Any, place: list[float]) -> None:
    """Raises `UserError` for a target outside the DEM, where visibility cannot be checked."""
    from jaxgeo.io.extent import place_beside

    beside = place_beside(terrain, place[0], place[1], "the target")
    if beside is not None:
        way = "leave --dem out" if len(place) == 3 else "give LAT,LON,HEIGHT without --dem"
        typed = ",".join(f"{number:g}" for number in place)
        raise UserError(f"--target {typed}: {beside}. Give a DEM that covers it, or {way}.")


def _content(names: tuple[str, ...], found: Any, aim: Any) -> dict[str, Any]:
    """Readings in deg, and the target in deg and m."""
    import numpy as np

    from jaxgeo.earth import Geodetic

    content: dict[str, Any] = {"readings_deg": dict(zip(names, np.rad2deg(found.readings).tolist(), strict=True))}
    content["miss_deg"] = np.rad2deg(float(found.miss))
    if isinstance(aim, Geodetic):
        place = (float(one) for one in aim.to_degrees())
        content["target"] = dict(zip(("lat_deg", "lon_deg", "height_m"), place, strict=True))
    return content


def _print_readings(names: tuple[str, ...], found: Any, unhidden: str | None, as_json: bool) -> int:
    """Print readings as in a scene file, unless `as_json`, and the status on stderr; returns the exit code.

    `unhidden` replaces the sentence of a hit if no terrain was given.
    """
    import numpy as np

    from jaxgeo.status import Status

    status, readings = Status(int(found.status)), np.rad2deg(np.asarray(found.readings))
    console = Console()
    for name, reading in zip(names, readings, strict=True):
        if np.isfinite(reading) and not as_json:
            console.print(f"{name}_deg = {reading:.6f}", highlight=False, markup=False)
    meaning = status_words(status, unhidden)["status_text"]
    if status != Status.hit or not is_quiet():
        stderr().print(f"{status.name}: {meaning}", highlight=False, soft_wrap=True)
    if status == Status.below_horizon:
        stderr().print("Check --target: expected LAT,LON; is it LON,LAT?", highlight=False, soft_wrap=True)
    if status == Status.outside_gimbal_range:
        off = f"pointing error {np.rad2deg(float(found.miss)):.4f} deg"
        stderr().print(off, highlight=False, soft_wrap=True)
    return DONE if status == Status.hit else NO_ANSWER
