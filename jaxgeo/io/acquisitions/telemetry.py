"""Airborne video telemetry (MISB ST 0601): each packet with camera position and attitude is an exposure."""

from __future__ import annotations

import dataclasses
import os
import pathlib

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io._bounded import read_bytes
from jaxgeo.io._regular import check_regular
from jaxgeo.io.acquisitions._klv_camera import camera_of, lens_errors, sensor_of, size_of, usual_size
from jaxgeo.io.acquisitions._klv_columns import Columns, lacking, numbers_of
from jaxgeo.io.acquisitions._klv_corners import level_images
from jaxgeo.io.acquisitions._klv_notes import assumed, damage, facts, left_out, times_unknown
from jaxgeo.io.acquisitions.klv import LEADING, UAS_LOCAL_SET, other_sets, packets
from jaxgeo.io.acquisitions.record import Acquisition, Reported
from jaxgeo.io.acquisitions.reported import reported_corners
from jaxgeo.io.acquisitions.st0601 import decode, label
from jaxgeo.io.acquisitions.transport_stream import HEAD, is_transport_stream, read_transport_stream
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.geoid import EGM96
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import FrameCamera, Pose, Shot
from jaxgeo.sensor.camera import check_size

FORM = "MISB ST 0601 telemetry"


def read_telemetry(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    image_size: tuple[int, int] | None = None,
    upright: bool = False,
    keep_damaged: bool = False,
    stream: int | None = None,
    camera: FrameCamera | str | os.PathLike[str] | None = None,
) -> Acquisition:
    """Read the exposures of a file of KLV packets, or of an MPEG transport stream with them; detected by content.

    Exposures are named by the number of their packet in the file, from 0. Packets that are damaged, or lack what an
    exposure needs (position, attitude, field of view, sensor angles), are left out, counted in `assumed`.
    A field of view and a sensor roll that are sent occasionally hold until they change, at most 30 s. Without a
    field of view it is computed from target width and slant range. The focal length error is among the sources: 1 %,
    or 5 % if from target width and slant range. Values that mean "unknown" (a position or a time of
    zero, reserved codes; `jaxgeo.io.sentinels.KLV`) are not taken as numbers; an unknown time is set to zero.

    - `height_datum`: datum of heights "above mean sea level", as in scene files; EGM96 by default. Ignored
      for packets with heights above the ellipsoid.
    - `image_size`: (width, height) in pixels; by default that of the video, else a usual size of the same ratio.
    - `upright`: images are level with the horizon, whatever sensor roll the packets state: stabilised turrets do not
      always report it. `compare_reported` shows whether reported corners are rotated.
    - `keep_damaged`: also use packets with a wrong checksum, if their items can be separated.
    - `stream`: index of the data stream, if a transport stream has several.
    - `camera`: a camera instead of the fields of view in the packets, with one focal length throughout: a
      `FrameCamera`, a camera file, or a lens as text, "focal=25mm,pitch=3.45um" (`jaxgeo.io.given_camera`).

    Raises `TableError` for a file without packets or without usable ones, with the reason; `VerticalDatumError`;
    `FileNotFoundError`; `ImportError` for a transport stream without PyAV; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    if image_size is not None:
        image_size = check_size(image_size[0], "image width"), check_size(image_size[1], "image height")
    given = camera_of(path, camera)
    data, of_video = _content(pathlib.Path(path), stream)
    found = list(packets(data))
    if not found:
        raise TableError(f"{path}: no packet of MISB ST 0601 in its {len(data)} bytes; {_other_content(data)}.")
    sound = [(k, one) for k, one in enumerate(found) if not one.damage or (keep_damaged and one.items)]
    values = [decode(one.items) for _, one in sound]
    numbers = numbers_of(values)
    start = next(iter(numbers.columns["time"][np.isfinite(numbers.columns["time"])].tolist()), None)
    usable = ~np.any([which for which, _ in lacking(numbers.columns, given is None).values()], axis=0)
    notes = [*damage(found, keep_damaged), *left_out(numbers, values, len(found), given is None)]
    if not usable.any():
        raise TableError(f"{path}: none of its {len(found)} packets makes an exposure. {' '.join(notes)}")
    notes += times_unknown(numbers, usable)
    values, numbers = [one for one, use in zip(values, usable, strict=True) if use], numbers.of(usable)
    columns = numbers.columns
    try:
        shots, centre = _shots(columns, height_datum, upright), _centre(columns, height_datum)
    except VerticalDatumError as error:
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error
    known_size = image_size or of_video or size_of(given)
    size = known_size or usual_size(columns)
    notes += assumed(numbers, values, height_datum, None if known_size else size, upright, given is not None)
    sensor, sources = sensor_of(path, columns, size, given), ()
    if given is None:
        source, note = lens_errors(numbers, sensor)
        sources, notes = (source,), [*notes, note]
    acquisition = Acquisition(
        path=os.fspath(path),
        form=FORM,
        names=np.array([k for (k, _), use in zip(sound, usable, strict=True) if use]).astype(str),
        sensor=sensor,
        shots=shots,
        sources=sources,
        assumed=tuple(notes),
        facts=facts(values, columns, len(found)),
        reported=Reported(centre, columns["slant_range"]),
        tags=tuple({label(tag): value for tag, value in one.items()} for one in values),
        time_is_utc=bool(np.isfinite(columns["time"]).all()),
        start=start,
    )
    if upright:
        return acquisition
    corners = reported_corners(acquisition)
    turned = level_images(columns, _level_turn(columns), shots.pose.position, corners, centre.height)
    return dataclasses.replace(acquisition, assumed=(*notes, *turned))


def _content(path: pathlib.Path, stream: int | None) -> tuple[bytes, tuple[int, int] | None]:
    """(bytes with the packets, image size if the file has a video)."""
    check_regular(path, TableError)
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD)
        if not is_transport_stream(head):
            return read_bytes(path), None
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such file of telemetry.") from None
    except IsADirectoryError:
        raise TableError(f"{path}: this is a folder; give the file of telemetry in it.") from None
    except OSError as error:
        raise TableError(f"{path}: the file of telemetry cannot be read: {error.strerror}.") from error
    return read_transport_stream(path, stream)


def _other_content(data: bytes) -> str:
    """Description of the content of a stream without packets."""
    others = other_sets(data)
    if others:
        return f"it holds {' and '.join(others)}, not read here. Ask its source for ST 0601, which nearly all write"
    at = data.find(LEADING)
    if at < 0:
        return "expected KLV, or an MPEG transport stream that carries it"
    return f"the first key in it is {data[at : at + 16].hex()}, that of the UAS local set is {UAS_LOCAL_SET.hex()}"


def _heights(columns: Columns, prefix: str, datum: str | float | None) -> np.ndarray:
    """Heights above the ellipsoid: as stated, else from those above mean sea level."""
    own, msl = columns[f"{prefix}height"], columns[f"{prefix}height_msl"]
    lon_deg, lat_deg = np.degrees(columns[f"{prefix}lon"]), np.degrees(columns[f"{prefix}lat"])
    msl = np.where(np.isfinite(own), np.nan, msl)
    return np.where(
        np.isfinite(own), own, ellipsoidal_heights(lon_deg, lat_deg, msl, EGM96 if datum is None else datum)
    )


def _shots(columns: Columns, datum: str | float | None, upright: bool) -> Shot:
    position = Geodetic(lat=columns["lat"], lon=columns["lon"], height=_heights(columns, "", datum))
    turn = _level_turn(columns) if upright else np.nan_to_num(columns["turn"])
    readings = np.stack([columns["azimuth"], columns["elevation"], (turn + np.pi) % (2.0 * np.pi) - np.pi], axis=-1)
    return Shot(
        Pose(position, columns["heading"], columns["pitch"], columns["roll"]), readings, np.nan_to_num(columns["time"])
    )


def _level_turn(columns: Columns) -> np.ndarray:
    """Roll of the head in rad at which its y axis is horizontal and its z axis points down."""
    pitch, roll, azimuth, elevation = (columns[name] for name in ("pitch", "roll", "azimuth", "elevation"))
    forward, right, down = -np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)
    ahead = np.cos(azimuth) * forward + np.sin(azimuth) * right
    aside = np.cos(azimuth) * right - np.sin(azimuth) * forward
    return np.arctan2(-aside, np.sin(elevation) * ahead + np.cos(elevation) * down)


def _centre(columns: Columns, datum: str | float | None) -> Geodetic:
    return Geodetic(lat=columns["centre_lat"], lon=columns["centre_lon"], height=_heights(columns, "centre_", datum))
