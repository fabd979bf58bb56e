"""Telemetry of airborne video, MISB ST 0601: each packet that says where the camera was and looked, an exposure."""

from __future__ import annotations

import datetime
import math
import os
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io.acquisitions.klv import UAS_LOCAL_SET, Packet, packets
from jaxgeo.io.acquisitions.record import Acquisition, Reported, for_each
from jaxgeo.io.acquisitions.st0601 import decode, label
from jaxgeo.io.acquisitions.transport_stream import HEAD, is_transport_stream, read_transport_stream
from jaxgeo.io.errors import TableError, VerticalDatumError
from jaxgeo.io.geoid import EGM96
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.camera import check_size
from jaxgeo.sensor.distortion import NoDistortion

FORM = "MISB ST 0601 telemetry"
USUAL_SIZES = ((1280, 720), (640, 480), (1280, 1024), (1024, 1024))  # one for each ratio of sides, in pixels
LATEST = 1e11  # s since 1970; a time beyond is none
TEXTS = (3, 4, 10, 11, 12, 59, 65)  # tags for people

Values = Sequence[Mapping[int, Any]]
Columns = Mapping[str, np.ndarray]


def read_telemetry(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    image_size: tuple[int, int] | None = None,
    upright: bool = False,
    keep_damaged: bool = False,
    stream: int | None = None,
) -> Acquisition:
    """The exposures of a file of KLV packets, or of an MPEG transport stream that carries them, told by its content.

    Exposures are named by the number of their packet in the file, from 0. Packets that are damaged, or lack what an
    exposure needs (time, position, attitude, fields of view, angles of the sensor), are left out, counted in `assumed`.

    - `height_datum`: what heights "above mean sea level" are measured from, as in scene files; EGM96 if left out. Not
      asked where packets have heights above the ellipsoid.
    - `image_size`: (width, height) in pixels; that of the video if left out, else taken from a list by its ratio.
    - `upright`: images are level with the horizon, whatever the packets say of the sensor's roll: turrets that keep
      them so do not always tell it. `compare_reported` shows whether reported corners are turned.
    - `keep_damaged`: packets with a wrong checksum too, if their items can be told apart.
    - `stream`: index of the data stream, where a transport stream has several.

    Raises `TableError` for a file without packets or without one that can be used, saying why; `VerticalDatumError`;
    `FileNotFoundError`; `ImportError` for a transport stream without PyAV; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    if image_size is not None:
        image_size = check_size(image_size[0], "image width"), check_size(image_size[1], "image height")
    data, of_video = _content(pathlib.Path(path), stream)
    found = list(packets(data))
    if not found:
        raise TableError(f"{path}: no packet of MISB ST 0601 in its {len(data)} bytes; {_other_key(data)}.")
    sound = [(k, one) for k, one in enumerate(found) if not one.damage or (keep_damaged and one.items)]
    values = [decode(one.items) for _, one in sound]
    columns = _columns(values)
    lacking = _lacking(columns)
    usable = ~np.any(list(lacking.values()), axis=0)
    notes = [*_damage(found, keep_damaged), *_left_out(lacking, len(found))]
    if not usable.any():
        raise TableError(f"{path}: none of its {len(found)} packets makes an exposure. {' '.join(notes)}")
    values = [one for one, use in zip(values, usable, strict=True) if use]
    columns = {name: column[usable] for name, column in columns.items()}
    try:
        shots, centre = _shots(columns, height_datum, upright), _centre(columns, height_datum)
    except VerticalDatumError as error:
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except ValueError as error:  # the datum's grid does not reach a position
        raise TableError(f"{path}: {error}") from error
    size = image_size or of_video or _usual_size(columns)
    notes += _assumed(columns, values, height_datum, None if image_size or of_video else size, upright)
    return Acquisition(
        path=os.fspath(path),
        form=FORM,
        names=np.array([k for (k, _), use in zip(sound, usable, strict=True) if use]).astype(str),
        sensor=_sensor(columns, size),
        shots=shots,
        assumed=tuple(notes),
        facts=_facts(values, columns, len(found)),
        reported=Reported(centre, columns["slant_range"]),
        tags=tuple({label(tag): value for tag, value in one.items()} for one in values),
        time_is_utc=True,
    )


def _content(path: pathlib.Path, stream: int | None) -> tuple[bytes, tuple[int, int] | None]:
    """(bytes that hold the packets, size of the images if a video comes with them)."""
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD)
            if not is_transport_stream(head):
                return head + file.read(), None
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such file of telemetry.") from None
    except IsADirectoryError:
        raise TableError(f"{path}: this is a folder; give the file of telemetry in it.") from None
    except OSError as error:
        raise TableError(f"{path}: the file of telemetry cannot be read: {error.strerror}.") from error
    return read_transport_stream(path, stream)


def _other_key(data: bytes) -> str:
    """What a stream without packets holds instead."""
    at = data.find(UAS_LOCAL_SET[:4])
    if at < 0:
        return "expected KLV, or an MPEG transport stream that carries it"
    return f"the first key in it is {data[at : at + 16].hex()}, that of the UAS local set is {UAS_LOCAL_SET.hex()}"


def _columns(values: Values) -> dict[str, np.ndarray]:
    """Numbers of all packets by name, NaN where unknown: angles in rad, heights and ranges in m, times in s."""

    def numbers(tag: int) -> np.ndarray:
        found = (one.get(tag) for one in values)
        return np.array([one if isinstance(one, int | float) else math.nan for one in found], np.float64)

    def first_known(*tags: int) -> np.ndarray:
        column = numbers(tags[0])
        for tag in tags[1:]:
            column = np.where(np.isfinite(column), column, numbers(tag))
        return column

    fields = {tag: np.radians(numbers(tag)) for tag in (16, 17)}
    fields = {tag: np.where((field > 0.0) & (field < np.pi), field, np.nan) for tag, field in fields.items()}
    time, slant_range = 1e-6 * numbers(2) + np.nan_to_num(_held(numbers(136))), numbers(21)
    return {
        "time": np.where(np.abs(time) < LATEST, time, np.nan),
        "lat": np.radians(numbers(13)),
        "lon": np.radians(numbers(14)),
        "height": first_known(104, 75),
        "height_msl": numbers(15),
        "heading": np.radians(numbers(5)),
        "pitch": np.radians(first_known(90, 6)),
        "roll": np.radians(first_known(91, 7)),
        "field_across": fields[16],
        "field_down": fields[17],
        "azimuth": np.radians(numbers(18)),
        "elevation": np.radians(numbers(19)),
        "turn": np.radians(numbers(20)),
        "slant_range": np.where(slant_range > 0.0, slant_range, np.nan),
        "centre_lat": np.radians(numbers(23)),
        "centre_lon": np.radians(numbers(24)),
        "centre_height": numbers(78),
        "centre_height_msl": numbers(25),
    }


def _held(column: np.ndarray) -> np.ndarray:
    """A column sent now and then, in every packet: each value holds until the next, the first from the start."""
    known = np.flatnonzero(np.isfinite(column))
    if not len(known):
        return column
    return column[known[np.maximum(np.searchsorted(known, np.arange(len(column)), side="right") - 1, 0)]]


def _lacking(columns: Columns) -> dict[str, np.ndarray]:
    """Which packets lack what, in words."""
    unknown = {name: ~np.isfinite(column) for name, column in columns.items()}
    return {
        "time (tag 2)": unknown["time"],
        "position of the sensor (tags 13, 14)": unknown["lat"] | unknown["lon"],
        "height of the sensor (tags 15, 75 or 104)": unknown["height"] & unknown["height_msl"],
        "attitude of the platform (tags 5, 6 or 90, 7 or 91)": unknown["heading"] | unknown["pitch"] | unknown["roll"],
        "azimuth and elevation of the sensor (tags 18, 19)": unknown["azimuth"] | unknown["elevation"],
        "field of view (tags 16, 17)": unknown["field_across"] & unknown["field_down"],
    }


def _damage(found: Sequence[Packet], kept: bool) -> list[str]:
    damaged = [(k, one) for k, one in enumerate(found) if one.damage]
    if not damaged:
        return []
    first, packet = damaged[0]
    readable = sum(bool(one.items) for _, one in damaged) if kept else 0
    done = f"{readable} of them were kept" if kept else "they were left out"
    return [
        f"{len(damaged)} of {len(found)} packets are damaged, {done}: "
        f"packet {first} at byte {packet.offset}: {packet.damage}{', ...' if len(damaged) > 1 else '.'}"
    ]


def _left_out(lacking: Mapping[str, np.ndarray], count: int) -> list[str]:
    return [
        f"{which.sum()} of {count} packets were left out for want of {what}."
        for what, which in lacking.items()
        if which.any()
    ]


def _heights(columns: Columns, prefix: str, datum: str | float | None) -> np.ndarray:
    """Heights above the ellipsoid: as told, else from those above mean sea level."""
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
    return Shot(Pose(position, columns["heading"], columns["pitch"], columns["roll"]), readings, columns["time"])


def _level_turn(columns: Columns) -> np.ndarray:
    """Roll of the head in rad with which its y axis is horizontal and its z axis points down."""
    pitch, roll, azimuth, elevation = (columns[name] for name in ("pitch", "roll", "azimuth", "elevation"))
    forward, right, down = -np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)
    ahead = np.cos(azimuth) * forward + np.sin(azimuth) * right
    aside = np.cos(azimuth) * right - np.sin(azimuth) * forward
    return np.arctan2(-aside, np.sin(elevation) * ahead + np.cos(elevation) * down)


def _centre(columns: Columns, datum: str | float | None) -> Geodetic:
    return Geodetic(lat=columns["centre_lat"], lon=columns["centre_lon"], height=_heights(columns, "centre_", datum))


def _sensor(columns: Columns, size: tuple[int, int]) -> Sensor:
    """The camera along the x axis of a head turned by azimuth, elevation and roll, in this order, in the body."""
    count = len(columns["time"])
    half = np.array(size) / 2.0
    focal = half / np.tan(0.5 * np.stack([columns["field_across"], columns["field_down"]], axis=-1))
    focal = np.where(np.isfinite(focal), focal, focal[:, ::-1])  # square pixels where one field is not told
    principal = np.broadcast_to(half - 0.5, (count, 2))
    camera = FrameCamera(focal, principal, for_each(NoDistortion(), count), *size)
    turn = 2.0 * np.pi
    limits = np.array([[-turn, turn], [-np.pi, np.pi], [-np.pi, np.pi]])
    gimbal = Gimbal.three_axis(limits=limits, reference="body")
    return Sensor(camera, for_each(gimbal, count), for_each(Mount.forward(), count))


def _usual_size(columns: Columns) -> tuple[int, int]:
    across, down = columns["field_across"], columns["field_down"]
    ratios = np.tan(0.5 * across) / np.tan(0.5 * down)
    ratio = np.median(ratios[np.isfinite(ratios)]) if np.isfinite(ratios).any() else 16.0 / 9.0
    return min(USUAL_SIZES, key=lambda size: abs(math.log(size[0] / size[1] / ratio)))


def _assumed(
    columns: Columns, values: Values, datum: str | float | None, guessed_size: tuple[int, int] | None, upright: bool
) -> list[str]:
    """What a packet does not say and was taken for granted."""
    notes = []
    from_msl = ~np.isfinite(columns["height"])
    if guessed_size is not None:
        notes.append(
            f"The size of the images is not in the packets: {guessed_size[0]} x {guessed_size[1]} pixels, by the ratio "
            f"of the fields of view; image_size= says it."
        )
    if from_msl.any() and datum is None:
        notes.append(
            "Heights are above mean sea level, and the standard names no geoid: EGM96 (EPSG:5773); height_datum= says "
            "another."
        )
    if datum is not None and not from_msl.all():
        notes.append(
            f"{(~from_msl).sum()} packets have heights above the ellipsoid, so height_datum was not used there."
        )
    if not upright and not np.isfinite(columns["turn"]).all():
        notes.append("The roll of the sensor (tag 20) is not told everywhere: zero, the top of the image up.")
    if not np.isfinite([columns["field_across"], columns["field_down"]]).all():
        notes.append("Only one field of view (tag 16 or 17) is told in some packets: pixels are square there.")
    if not any(136 in one for one in values):
        notes.append(
            "Times are taken as UTC; by newer editions of the standard they would count leap seconds, which tag 136 "
            "would tell."
        )
    notes.append("Fields of view reach from edge to edge of the image, and the lens has no distortion.")
    sigmas = "are in tag 102, which is not read" if any(102 in one for one in values) else "are not in the packets"
    notes.append(f"Accuracies {sigmas}: no errors are given.")
    return notes


def _facts(values: Values, columns: Columns, count: int) -> dict[str, str]:
    facts = {"packets": f"{count}, of which {len(values)} make exposures"}
    first, last = (
        datetime.datetime.fromtimestamp(time, datetime.UTC).isoformat(sep=" ", timespec="milliseconds")
        for time in (columns["time"].min(), columns["time"].max())
    )
    facts["times"] = f"{first} to {last}"
    for tag in TEXTS:
        told = dict.fromkeys(str(one[tag]) for one in values if one.get(tag) not in (None, "", b""))
        if told:
            facts[label(tag)] = ", ".join(told)
    return facts
