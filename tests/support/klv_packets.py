"""Encoder of MISB ST 0601 packets, written from the text of the standard, for tests."""

from __future__ import annotations

import struct
from collections.abc import Mapping

KEY = bytes([0x06, 0x0E, 0x2B, 0x34, 0x02, 0x0B, 0x01, 0x01, 0x0E, 0x01, 0x03, 0x01, 0x01, 0x00, 0x00, 0x00])

# Sensor 2 km above the ellipsoid, looking down to the right: (unit value, lowest, highest, struct format).
USUAL: dict[int, tuple[float, float, float, str]] = {
    5: (30.0, 0.0, 360.0, ">H"),
    6: (3.0, -20.0, 20.0, ">h"),
    7: (-12.0, -50.0, 50.0, ">h"),
    13: (47.1, -90.0, 90.0, ">i"),
    14: (8.2, -180.0, 180.0, ">i"),
    15: (2000.0, -900.0, 19_000.0, ">H"),
    16: (12.0, 0.0, 180.0, ">H"),
    17: (6.8, 0.0, 180.0, ">H"),
    18: (250.0, 0.0, 360.0, ">I"),
    19: (-25.0, -180.0, 180.0, ">i"),
    20: (350.0, 0.0, 360.0, ">I"),
    21: (3300.0, 0.0, 5e6, ">I"),
    23: (47.12, -90.0, 90.0, ">i"),
    24: (8.22, -180.0, 180.0, ">i"),
    25: (450.0, -900.0, 19_000.0, ">H"),
    75: (2050.0, -900.0, 19_000.0, ">H"),
    78: (500.0, -900.0, 19_000.0, ">H"),
    90: (3.0, -90.0, 90.0, ">i"),
    91: (-12.0, -90.0, 90.0, ">i"),
}
TIME_US = 1_348_087_244_105_300


def whole(value: float, low: float, high: float, layout: str) -> bytes:
    """A number in the mapping of the standard: `low` is the lowest code used, `high` the highest."""
    greatest = 2 ** (8 * struct.calcsize(layout)) - 1
    if layout[1].islower():
        return struct.pack(layout, round(value / high * (greatest // 2)))
    return struct.pack(layout, round((value - low) / (high - low) * greatest))


def usual(*tags: int, **changes: float) -> dict[int, bytes]:
    """Items of these tags (if none, all except 75, 78, 90 and 91) and the time; `tag_13=...` changes a value."""
    values = {int(name.removeprefix("tag_")): value for name, value in changes.items()}
    chosen = tags or tuple(tag for tag in USUAL if tag < 75)
    found = {2: struct.pack(">Q", TIME_US)}
    for tag in sorted({*chosen, *values}):
        value, low, high, layout = USUAL[tag]
        found[tag] = whole(values.get(tag, value), low, high, layout)
    return found


def length(size: int, *, long: bool = False) -> bytes:
    """BER length, in the short form where possible."""
    if size < 128 and not long:
        return bytes([size])
    return bytes([0x82]) + struct.pack(">H", size)


def tag_bytes(tag: int) -> bytes:
    """BER-OID tag."""
    groups = [tag & 0x7F]
    while tag := tag >> 7:
        groups.insert(0, 0x80 | tag & 0x7F)
    return bytes(groups)


def local_set(items: Mapping[int, bytes], *, long: bool = False) -> bytes:
    """A packet: key, length, items, and the checksum over everything up to its own length."""
    body = b"".join(tag_bytes(tag) + length(len(raw), long=long) + raw for tag, raw in items.items()) + b"\x01\x02"
    packet = KEY + length(len(body) + 2, long=long) + body
    total = sum(value << 8 if place % 2 == 0 else value for place, value in enumerate(packet))
    return packet + struct.pack(">H", total % 65536)


def cell(content: bytes, number: int) -> bytes:
    """An access unit cell of synchronous metadata (MISB ST 1402): a header of five bytes and the content."""
    return bytes([0, number % 256, 0xDF]) + struct.pack(">H", len(content)) + content


def synchronous(stream: bytes) -> bytes:
    """A transport stream whose program map declares the data streams as synchronous metadata (stream type 0x15)."""
    changed = bytearray(stream)
    for at in range(0, len(stream), 188):
        packet = stream[at : at + 188]
        start = at + 5 + (1 + packet[4] if packet[3] & 0x20 else 0)  # after the pointer field
        if not packet[1] & 0x40 or stream[start - 1 : start + 1] != b"\x00\x02":
            continue  # no program map starts here
        end = start + 3 + int.from_bytes(stream[start + 1 : start + 3], "big") % 4096 - 4
        one = start + 12 + int.from_bytes(stream[start + 10 : start + 12], "big") % 4096
        while one < end:
            if changed[one] == 0x06:
                changed[one] = 0x15
            one += 5 + int.from_bytes(stream[one + 3 : one + 5], "big") % 4096
        changed[end : end + 4] = struct.pack(">I", _crc32(bytes(changed[start:end])))
    return bytes(changed)


def _crc32(section: bytes) -> int:
    """CRC of MPEG-2 systems: not reflected, not inverted."""
    crc = 0xFFFFFFFF
    for value in section:
        crc ^= value << 24
        for _ in range(8):
            crc = (crc << 1 ^ (0x04C11DB7 if crc & 0x80000000 else 0)) & 0xFFFFFFFF
    return crc
