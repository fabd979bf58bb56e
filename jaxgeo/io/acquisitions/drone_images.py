"""Drone images as exposures: position, attitude and camera from the makers' tags."""

from __future__ import annotations

import os
import pathlib
from collections.abc import Sequence

import jax
import numpy as np

from jaxgeo._checks import check_is, require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io._csv import Limits
from jaxgeo.io.acquisitions._given_angles import angles_given, checked_angles, given_note
from jaxgeo.io.acquisitions._image_cameras import GivenCamera, sensor_of_images, span_shown
from jaxgeo.io.acquisitions._image_positions import (
    HEIGHT,
    LAT,
    LON,
    above_takeoff_of,
    altitude_shown,
    heights_of,
    lat_lon_of,
)
from jaxgeo.io.acquisitions._image_tags import ImageTags, read_tags
from jaxgeo.io.acquisitions._image_times import time_of
from jaxgeo.io.acquisitions._makers import Maker, aircraft_of, angles_of, maker_of
from jaxgeo.io.acquisitions._rigs import band_of
from jaxgeo.io.acquisitions.record import Acquisition, Reported
from jaxgeo.io.acquisitions.usual_errors import POSITION
from jaxgeo.io.errors import ImageError, TableError
from jaxgeo.sensor import FrameCamera, Pose, Shot
from jaxgeo.uncertainty.sources import Position

ENDINGS = (".jpg", ".jpeg", ".tif", ".tiff")
SIGMA: Limits = (0.0, 1e6, "m")
AXES = "standard deviations north, east, down"
NO_ANGLES = "No errors of the angles are taken from the files."
POSITIONS = (
    "Positions are taken to be those of the camera: the lever arm from the antenna, some 0.2 m where the drone does "
    "not allow for it, is not among the errors."
)
CAMERA_CLOCK = "Times are by the camera's clock, whose time zone is not said."
NO_TIME = "The time of an image, or of all, is not in the file; it is set to zero."
NO_ACCURACY = "state no position accuracy"

Path = str | os.PathLike[str]


def read_drone_images(
    paths: Path | Sequence[Path],
    *,
    height_datum: str | float | None = None,
    takeoff_height: float | None = None,
    camera: GivenCamera | None = None,
    gimbal_deg: Sequence[float | int | str] | None = None,
) -> Acquisition:
    """Read the exposures of one image, of several, or of all in a folder: JPEG or TIFF, all of one camera.

    Supported are the tags of DJI, Skydio, Parrot, Autel and MicaSense, and Pix4D's camera tags; a band's camera is
    turned on its mount by `RigRelatives`. Pixels are not decoded. The
    camera's angles are relative to level and true north: the camera is in a `Gimbal.three_axis()` and looks along its
    head, `Mount.forward()`; Pix4D counts from straight down, `Mount.nadir()`. The pose has the aircraft's attitude if
    the file states it. Lens and focal length are the maker's calibration in the image, else from the package's table of
    cameras, else from EXIF; scaled if the image was resized after exposure. Their errors are among the sources,
    larger for less reliable origins. Assumptions are in `assumed`; values that mean
    "unknown" (`jaxgeo.io.sentinels`) are never taken as measurements.

    - `height_datum`: datum of the files' altitudes: "ellipsoid", "EPSG:5773" (EGM96 mean sea
      level), an undulation in m, the path of a geoid grid; as in scene files. Only Skydio's files state it.
    - `takeoff_height`: instead, the height of the take-off point in m above the ellipsoid, or `height_datum` if
      given, to which the files' heights above it are added.
    - `camera`: instead of the tags, a camera of the size of the images; a lens as text, "focal=8.8mm,pitch=2.41um",
      "focal=8.8mm,sensor=13.2mm" or "focal=3666px"; the path of a camera file or scene file (.toml); or the name of a
      camera of the table, "FC6310".
    - `gimbal_deg`: instead of the tags, yaw from true north, pitch above the horizon and roll of the camera in deg; yaw
      may be "aircraft", the heading of the aircraft in each image's tags.

    Raises `UnstatedDatum`; `ImageError` for files that are truncated or not images, and images with an orientation
    flag; `TableError`, file and tag named, for tags that are missing, not numbers, out of range or repeated, and for
    images of several cameras; `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    if camera is not None and not isinstance(camera, str | os.PathLike):
        check_is(camera, FrameCamera, "camera", "Or a lens as text, or the path of a camera file.")
    given = None if gimbal_deg is None else checked_angles(gimbal_deg)
    tags = [read_tags(path) for path in _files(paths)]
    makers = [maker_of(one, angles_are_given=given is not None) for one in tags]
    _check_alike(tags, makers)
    maker, notes = makers[0], dict[str, None]()
    for one in tags:
        _check_upright(one)
        notes |= dict.fromkeys(_warnings_of(one))
    sensor, lens_errors, how = sensor_of_images(tags, maker, camera, notes)
    lat, lon = lat_lon_of(tags, maker)
    height, where_from = heights_of(tags, maker, lat, lon, height_datum, takeoff_height)
    notes |= dict.fromkeys(where_from)
    time, is_utc = _times(tags, notes)
    stated, errors = _position_errors(tags, maker, notes, by_barometer=takeoff_height is not None)
    position = Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height)
    angles = [angles_of(one, maker) if given is None else angles_given(one, given) for one in tags]
    readings = np.deg2rad(np.array(angles, np.float64))
    shots = Shot(_pose(tags, maker, position, notes), readings, time)
    first = tags[0]
    if given is not None:
        notes |= {given_note(given): None}
    notes |= dict.fromkeys((POSITIONS, "Yaw is taken to be from true north.", NO_ANGLES))
    return Acquisition(
        path=os.fspath(paths) if isinstance(paths, str | os.PathLike) else _shown([one.path for one in tags]),
        form=maker.form,
        names=np.array(_names(tags)),
        sensor=sensor,
        shots=shots,
        sources=(*stated, *lens_errors),
        assumed=tuple(notes),
        facts={
            "camera": " ".join(first.camera).strip() or "not said",
            **({"band": band_of(first)} if band_of(first) else {}),
            "image size": f"{first.width} x {first.height} pixels",
            "focal length": how,
            "altitude": altitude_shown(first, maker),
            "position errors": errors,
        },
        reported=_reported(tags),
        above_takeoff=above_takeoff_of(tags, maker),
        tags=tuple(one.values for one in tags),
        time_is_utc=is_utc,
    )


def _files(paths: Path | Sequence[Path]) -> list[Path]:
    if not isinstance(paths, str | os.PathLike):
        if not paths:
            raise TableError("paths: no image is named.")
        return list(paths)
    folder = pathlib.Path(paths)
    if not folder.is_dir():
        return [paths]
    files = sorted(
        file for file in folder.iterdir() if file.suffix.lower() in ENDINGS and not file.name.startswith(".")
    )
    if not files:
        raise ImageError(f"{folder}: there are no images in this folder ({', '.join(ENDINGS)}).")
    return list(files)


def _names(tags: list[ImageTags]) -> list[str]:
    """File names, or paths if two files share a name."""
    names = [os.path.basename(one.path) for one in tags]
    return names if len(set(names)) == len(names) else [one.path for one in tags]


def _shown(paths: list[str]) -> str:
    return paths[0] if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"


def _check_alike(tags: list[ImageTags], makers: list[Maker]) -> None:
    kinds = [
        (maker.form, *one.camera, f"{one.width} x {one.height} pixels") for one, maker in zip(tags, makers, strict=True)
    ]
    for one, kind in zip(tags, kinds, strict=True):
        if kind != kinds[0]:
            raise TableError(
                f"{one.path}: it is of another camera or size ({', '.join(filter(None, kind))}) than {tags[0].path} "
                f"({', '.join(filter(None, kinds[0]))}); read the images of one camera at a time."
            )


def _check_upright(tags: ImageTags) -> None:
    orientation = tags.number("EXIF:Orientation", (0.0, 8.0, ""))
    if orientation not in (None, 0.0, 1.0):
        raise ImageError(
            f"{tags.path}: the image is flagged to be turned for display (Orientation {orientation:g}), and it is not "
            f"said whether its angles are of the image as stored or as turned. If as stored, remove the flag: exiftool "
            f"-n -Orientation=1."
        )


def _warnings_of(tags: ImageTags) -> list[str]:
    """Properties stated in the file that are not modelled."""
    notes = []
    if tags.text("drone-dji:ShutterType").lower().startswith(("electronic", "rolling")):
        notes.append(
            "The shutter is electronic: that rows are exposed one after another is not allowed for, and not among the "
            "errors; it is some 0.3 m along the flight at 10 m/s."
        )
    for name in ("drone-dji:GimbalReverse", "drone-dji:CamReverse"):
        if tags.text(name) not in ("", "0"):
            notes.append(f"The camera hangs upside down ({name} {tags.text(name)}): its angles are taken as written.")
    for quantity in ("height", "focal length", "focal length for 35 mm film", "calibration", "time"):
        if reason := tags.unknown(quantity):
            notes.append(f"Not used: {reason}.")
    return notes


def _times(tags: list[ImageTags], notes: dict[str, None]) -> tuple[np.ndarray, bool]:
    found = [_time(one, notes) for one in tags]
    if any(time is None for time, _ in found):
        notes |= {NO_TIME: None}
        return np.array([0.0 if time is None else time for time, _ in found]), False
    is_utc = all(utc for _, utc in found)
    if not is_utc:
        notes |= {CAMERA_CLOCK: None}
    if not is_utc and any(utc for _, utc in found):
        raise TableError(f"{tags[0].path}: some of the images tell their time in UTC and some do not; read them apart.")
    return np.array([time for time, _ in found]), is_utc


def _time(tags: ImageTags, notes: dict[str, None]) -> tuple[float | None, bool]:
    """As `time_of`; an unreadable time is only reported, since no line of sight depends on it."""
    try:
        return time_of(tags)
    except TableError as error:
        notes |= {f"Not used: {str(error).removeprefix(tags.path).lstrip(', ')}": None}
        return None, False


def _position_errors(
    tags: list[ImageTags], maker: Maker, notes: dict[str, None], *, by_barometer: bool
) -> tuple[tuple[Position, ...], str]:
    """(position errors, as text). Images that state none get the default ones if others state theirs."""
    sigma = np.array([_stated_sigma(one, maker) for one in tags])
    stated = np.all(sigma > 0.0, axis=1)
    if not np.any(stated):
        notes |= {"How well the positions are known is not said by the files.": None}
        return (), "not said"
    if by_barometer:
        notes |= {"The errors of position in the files are not taken: they are not of a barometer's heights.": None}
        return (), "not said"
    words = f"{', '.join(span_shown(column, '.3g') for column in sigma[stated].T)} m ({AXES})"
    if not np.all(stated):
        sigma[~stated] = POSITION
        count, usual = f"{int(np.sum(~stated))} of {len(tags)} images", ", ".join(f"{value:g}" for value in POSITION)
        notes |= {f"{count} {NO_ACCURACY}; position sigma there: {usual} m ({AXES}; default).": None}
        words += f"; {count} do not say it"
    return (jax.tree.map(np.asarray, jax.vmap(Position)(sigma)),), words


def _stated_sigma(tags: ImageTags, maker: Maker) -> list[float]:
    """Standard deviations of a position, m north, east, down; zeros if the file does not state them."""
    unknown = not maker.sigma or tags.unknown("position errors")
    return [0.0] * 3 if unknown else [tags.number(name, SIGMA) or 0.0 for name in maker.sigma]


def _pose(tags: list[ImageTags], maker: Maker, position: Geodetic, notes: dict[str, None]) -> Pose:
    found = [aircraft_of(one, maker) for one in tags]
    if any(None in one for one in found):
        notes |= {"The attitude of the aircraft is not said; it is set level, and has no part in lines of sight.": None}
        found = [[0.0, 0.0, 0.0]] * len(tags)
    heading, pitch, roll = np.deg2rad(np.array(found, np.float64)).T
    return Pose(position, heading, pitch, roll)


def _reported(tags: list[ImageTags]) -> Reported | None:
    """The target of DJI's laser rangefinder, close to the image centre; NaN if invalid."""
    rows = np.array([_hit_by_laser(one) for one in tags])
    if not np.any(np.isfinite(rows)):
        return None
    lat, lon, height, slant_range = rows.T
    return Reported(Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height), slant_range)


def _hit_by_laser(tags: ImageTags) -> list[float]:
    """Latitude and longitude in deg, height and slant range in m."""
    columns = {"Lat": LAT, "Lon": LON, "AbsAlt": HEIGHT, "Distance": (0.0, 1e5, "m")}
    nothing = [np.nan] * len(columns)
    try:
        if tags.unknown("rangefinder") or tags.text("drone-dji:LRFStatus") not in ("", "Normal"):
            return nothing
        numbers = [tags.number(f"drone-dji:LRFTarget{name}", limits) for name, limits in columns.items()]
    except TableError:
        return nothing
    return [np.nan if number is None else number for number in numbers] if numbers[3] else nothing
