"""Telemetry of airborne video, MISB ST 0601: each packet that says where the camera was and looked, an exposure."""

from __future__ import annotations

import os
import pathlib

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io._bounded import read_bytes
from jaxgeo.io._regular import check_regular
from jaxgeo.io.acquisitions._klv_camera import camera_of, lens_errors, sensor_of, size_of, usual_size
from jaxgeo.io.acquisitions._klv_columns import Columns, lacking, numbers_of
from jaxgeo.io.acquisitions._klv_notes import assumed, damage, facts, left_out, times_unknown
from jaxgeo.io.acquisitions.klv import LEADING, UAS_LOCAL_SET, other_sets, packets
from jaxgeo.io.acquisitions.record import Acquisition, Reported
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
    """The exposures of a file of KLV packets, or of an MPEG transport stream that carries them; the content decides.

    Exposures are named by the number of their packet in the file, from 0. Packets that are damaged, or lack what an
    exposure needs (position, attitude, field of view, angles of the sensor), are left out, counted in `assumed`.
    A field of view and a roll of the sensor that are sent now and then hold until they change, at most 30 s. Without a
    field of view it is taken from target width and slant range. How the focal length errs is among the sources, by 1 %,
    or by 5 % if from target width and slant range. Values that mean "unknown" (a position or a time of
    zero, reserved codes; `jaxgeo.io.sentinels.KLV`) are not taken as numbers; an unknown time is set to zero.

    - `height_datum`: what heights "above mean sea level" are measured from, as in scene files; EGM96 if left out. Not
      asked where packets have heights above the ellipsoid.
    - `image_size`: (width, height) in pixels; that of the video if left out, else taken from a list by its ratio.
    - `upright`: images are level with the horizon, whatever the packets say of the sensor's roll: turrets that keep
      them so do not always tell it. `compare_reported` shows whether reported corners are turned.
    - `keep_damaged`: packets with a wrong checksum too, if their items can be separated.
    - `stream`: index of the data stream, where a transport stream has several.
    - `camera`: the camera in place of the fields of view in the packets, of one focal length throughout: a
      `FrameCamera`, a camera file, or a lens in words, "focal=25mm,pitch=3.45um" (`jaxgeo.io.given_camera`).

    Raises `TableError` for a file without packets or without one that can be used, saying why; `VerticalDatumError`;
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
        source, told = lens_errors(numbers, sensor)
        sources, notes = (source,), [*notes, told]
    return Acquisition(
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
    )


def _content(path: pathlib.Path, stream: int | None) -> tuple[bytes, tuple[int, int] | None]:
    """(bytes that hold the packets, size of the images if a video comes with them)."""
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
    """What a stream without packets holds instead."""
    others = other_sets(data)
    if others:
        return f"it holds {' and '.join(others)}, not read here. Ask its source for ST 0601, which nearly all write"
    at = data.find(LEADING)
    if at < 0:
        return "expected KLV, or an MPEG transport stream that carries it"
    return f"the first key in it is {data[at : at + 16].hex()}, that of the UAS local set is {UAS_LOCAL_SET.hex()}"


def _heights(columns: Columns, prefix: str, datum: str | float | None) -> np.ndarray:
    """Heights above the ellipsoid: as stated, else from those above mean sea level."""
    told, msl = columns[f"{prefix}height"], columns[f"{prefix}height_msl"]
    lon_deg, lat_deg = np.degrees(columns[f"{prefix}lon"]), np.degrees(columns[f"{prefix}lat"])
    msl = np.where(np.isfinite(told), np.nan, msl)
    return np.where(
        np.isfinite(told), told, ellipsoidal_heights(lon_deg, lat_deg, msl, EGM96 if datum is None else datum)
    )


def _shots(columns: Columns, datum: str | float | None, upright: bool) -> Shot:
    position = Geodetic(lat=columns["lat"], lon=columns["lon"], height=_heights(columns, "", datum))
    turn = _level_turn(columns) if upright else np.nan_to_num(columns["turn"])
    readings = np.stack([columns["azimuth"], columns["elevation"], (turn + np.pi) % (2.0 * np.pi) - np.pi], axis=-1)
    return Shot(
        Pose(position, columns["heading"], columns["pitch"], columns["roll"]), readings, np.nan_to_num(columns["time"])
    )


def _level_turn(columns: Columns) -> np.ndarray:
    """Roll of the head in rad with which its y axis is horizontal and its z axis points down."""
    pitch, roll, azimuth, elevation = (columns[name] for name in ("pitch", "roll", "azimuth", "elevation"))
    forward, right, down = -np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)
    ahead = np.cos(azimuth) * forward + np.sin(azimuth) * right
    aside = np.cos(azimuth) * right - np.sin(azimuth) * forward
    return np.arctan2(-aside, np.sin(elevation) * ahead + np.cos(elevation) * down)


def _centre(columns: Columns, datum: str | float | None) -> Geodetic:
    return Geodetic(lat=columns["centre_lat"], lon=columns["centre_lon"], height=_heights(columns, "centre_", datum))
