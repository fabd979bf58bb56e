"""Logs of ArduPilot (dataflash) and PX4 (ULog), byte by byte from their published layouts."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

PHOTO = "CAM", "QBHIHLLeeefff", "TimeUS,I,Img,GPSTime,GPSWeek,Lat,Lng,Alt,RelAlt,GPSAlt,R,P,Y"
MOUNT = "MNT", "QBffffffff", "TimeUS,I,DesRoll,Roll,DesPitch,Pitch,DesYawB,YawB,DesYawE,YawE"
CODES = {"L": ("i", 1e7), "e": ("i", 1e2)}  # stored as whole numbers of 1e-7 deg, of cm
NUMBER = {"CAM": 160, "MNT": 161}
# A photo of 2023-05-04 10:20:31.250 UTC: GPS week 2260, 4 d 10 h 20 min 49.25 s into it (18 leap seconds).
AT = {
    "TimeUS": 61_000_000, "I": 0, "Img": 7, "GPSTime": 382_849_250, "GPSWeek": 2260, "Lat": 36.3, "Lng": -84.2,
    "Alt": 900.0, "RelAlt": 300.0, "GPSAlt": 901.0, "R": 2.0, "P": -3.0, "Y": 30.5,
}  # fmt: skip
POINTED = {
    "TimeUS": 61_040_000, "I": 0, "DesRoll": 0.0, "Roll": 2.0, "DesPitch": -60.0, "Pitch": -60.0, "DesYawB": 0.0,
    "YawB": 11.0, "DesYawE": float("nan"), "YawE": 41.5,
}  # fmt: skip


def dataflash(photos: Sequence[dict[str, Any]], mounts: Sequence[dict[str, Any]] = ()) -> bytes:
    """A binary log: formats first, then messages."""
    own = "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"
    parts = [_format(128, 89, *own)]
    for name, codes, columns in (PHOTO, MOUNT):
        parts.append(_format(NUMBER[name], 3 + struct.calcsize(_packing(codes)), name, codes, columns))
    for (name, codes, columns), rows in ((PHOTO, photos), (MOUNT, mounts)):
        for row in rows:
            numbers = [_stored(code, row[one]) for code, one in zip(codes, columns.split(","), strict=True)]
            parts.append(b"\xa3\x95" + bytes([NUMBER[name]]) + struct.pack(_packing(codes), *numbers))
    return b"".join(parts)


def dataflash_text(photos: Sequence[dict[str, Any]], mounts: Sequence[dict[str, Any]] = ()) -> str:
    """The same log as text, where numbers have their units."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    for name, codes, columns in (PHOTO, MOUNT):
        lines.append(f"FMT, {NUMBER[name]}, {3 + struct.calcsize(_packing(codes))}, {name}, {codes}, {columns}")
    for (name, _, columns), rows in ((PHOTO, photos), (MOUNT, mounts)):
        lines += [", ".join([name, *(repr(row[one]) for one in columns.split(","))]) for row in rows]
    return "\n".join([*lines, ""])


def _format(number: int, length: int, name: str, codes: str, columns: str) -> bytes:
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, length, name.encode(), codes.encode(), columns.encode())


def _packing(codes: str) -> str:
    return "<" + "".join(CODES.get(code, (code, 1.0))[0] for code in codes)


def _stored(code: str, number: float) -> float:
    return number if code not in CODES else round(number * CODES[code][1])


CAPTURE = np.dtype([
    ("timestamp", "<u8"), ("timestamp_utc", "<u8"), ("lat", "<f8"), ("lon", "<f8"), ("seq", "<u4"), ("alt", "<f4"),
    ("ground_distance", "<f4"), ("q", "<f4", 4), ("result", "i1"),
])  # fmt: skip
CAPTURE_FORMAT = (
    "camera_capture:uint64_t timestamp;uint64_t timestamp_utc;double lat;double lon;uint32_t seq;float alt;"
    "float ground_distance;float[4] q;int8_t result;"
)
GIMBAL_FORMAT = "gimbal_device_attitude_status:uint64_t timestamp;float[4] q;"
UTC = 1_683_195_631_250_000  # us: 2023-05-04 10:20:31.250


def ulog(q: Sequence[Sequence[float]], *, gimbal: bool = False, result: Sequence[int] = (), **change: Any) -> bytes:
    """A log with a photo for each quaternion."""
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000), _message(b"B", bytes(16) + struct.pack("<3Q", 0, 0, 0))]
    parts += [_message(b"F", one.encode()) for one in (CAPTURE_FORMAT, GIMBAL_FORMAT)]
    parts.append(_message(b"A", struct.pack("<BH", 0, 3) + b"camera_capture"))
    if gimbal:
        parts.append(_message(b"A", struct.pack("<BH", 0, 4) + b"gimbal_device_attitude_status"))
        parts.append(_message(b"D", struct.pack("<HQ4f", 4, 60_000_000, 1.0, 0.0, 0.0, 0.0)))
    for k, one in enumerate(q):
        row = np.zeros(1, CAPTURE)
        row["timestamp"], row["timestamp_utc"], row["seq"] = 61_000_000 + k, UTC, 7 + k
        row["lat"], row["lon"], row["alt"], row["q"], row["result"] = 36.3, -84.2, 900.0, one, [*result, *[1] * 9][k]
        for name, value in change.items():
            row[name] = value
        parts.append(_message(b"D", struct.pack("<H", 3) + row.tobytes()))
    return b"".join(parts)


def _message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<H", len(content)) + kind + content
