"""Second readings of binary records by `struct`: packets of MISB ST 0601, transport streams, SBET and its errors."""

from __future__ import annotations

import pathlib
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from tests.fuzz.second.compared import DEGREES, doubles, egm96, same, same_names, same_turn
from tests.fuzz.sound_files import STREAMED

KEY = bytes.fromhex("060e2b34020b01010e01030101000000")
# Items of ST 0601.17 by name: tag, bytes, lowest and highest value; signed where the lowest is below zero but for -900.
ITEMS = {
    "heading": (5, 2, 0.0, 360.0), "pitch": (6, 2, -20.0, 20.0), "roll": (7, 2, -50.0, 50.0),
    "lat": (13, 4, -90.0, 90.0), "lon": (14, 4, -180.0, 180.0), "height": (15, 2, -900.0, 19_000.0),
    "azimuth": (18, 4, 0.0, 360.0), "elevation": (19, 4, -180.0, 180.0), "ellipsoidal": (75, 2, -900.0, 19_000.0),
    "full_pitch": (90, 4, -90.0, 90.0), "full_roll": (91, 4, -90.0, 90.0),
}  # fmt: skip
TELEMETRY = ("time", "lat", "lon", "height", "heading", "pitch", "roll", "azimuth", "elevation")


def klv(*, checked: bool, undulation: float | None = None) -> Callable[[pathlib.Path, Any], None]:
    """Every exposure is one of the packets, `checked` by their checksums; heights above EGM96 but with `undulation`."""

    def second(path: pathlib.Path, found: Any) -> None:
        stated = list(_exposures(path.read_bytes(), checked, undulation))
        _each_is_stated(found, np.array(stated).reshape(-1, len(TELEMETRY)))

    return second


def transport_stream(path: pathlib.Path, found: Any) -> None:
    """Every exposure is a packet whose checksum is right: of the sound file, or in the payload of a program."""
    streams = [b"".join(STREAMED), *_payloads(path.read_bytes())]
    stated = [one for data in streams for one in _exposures(data, True, 0.0)]
    _each_is_stated(found, np.array(stated).reshape(-1, len(TELEMETRY)))


def _each_is_stated(found: Any, stated: np.ndarray) -> None:
    pose = found.shots.pose
    angles = (pose.position.lat, pose.position.lon)
    turned = np.rad2deg([pose.heading, pose.pitch, pose.roll, *np.asarray(found.shots.gimbal_readings)[:, :2].T])
    ours = np.column_stack([found.shots.time, *np.rad2deg(angles), pose.position.height, *turned])
    off = np.abs(ours[:, None] - stated[None])
    off[..., [2, 4, 6, 7, 8]] = np.abs((off[..., [2, 4, 6, 7, 8]] + 180.0) % 360.0 - 180.0)
    off[..., 0] -= 4e-16 * np.abs(stated[:, 0])  # two roundings
    near = np.all(off <= np.array([2e-6, *[DEGREES] * 2, 1e-3, *[DEGREES] * 5]), axis=-1)
    missing = ~near.any(axis=1)
    assert not missing.any(), f"exposure {ours[missing][0]} is no packet that the bytes hold, of {len(stated)}"


def _exposures(data: bytes, checked: bool, undulation: float | None) -> Iterator[list[float]]:
    for items in _packets(data, checked):
        there = {name: one for name, one in ITEMS.items() if len(items.get(one[0], b"")) == one[1]}
        read = {name: _mapped(items[tag], low, high) for name, (tag, _, low, high) in there.items()}
        known = {name: value for name, value in read.items() if np.isfinite(value)}
        pitch, roll = (known.get(f"full_{name}", known.get(name)) for name in ("pitch", "roll"))
        needed = [known.get(name) for name in ("lat", "lon", "heading", "azimuth", "elevation")] + [pitch, roll]
        if None in needed:
            continue
        lat, lon = known["lat"], known["lon"]
        for above in _heights(known, lat, lon, undulation):
            time = int.from_bytes(items[2], "big") / 1e6 if len(items.get(2, b"")) == 8 else 0.0
            time = time if time < 1e11 else 0.0  # in three thousand years: a clock that is not set
            yield [time, lat, lon, above, known["heading"], pitch, roll, known["azimuth"], known["elevation"]]  # type: ignore[list-item]


def _heights(known: dict[str, float], lat: float, lon: float, undulation: float | None) -> Iterator[float]:
    if known.get("ellipsoidal", -900.0) != -900.0:
        yield known["ellipsoidal"]
    elif known.get("height", -900.0) != -900.0:
        yield known["height"] + (float(egm96(lat, lon)) if undulation is None else undulation)


def _mapped(raw: bytes, low: float, high: float) -> float:
    """A whole number by the standard's linear map; NaN for the code that says that it is unknown."""
    if low < 0.0 and low != -900.0:
        value = int.from_bytes(raw, "big", signed=True)
        most = 2 ** (8 * len(raw) - 1) - 1 if raw else 0
        return value / most * high if raw and abs(value) <= most else np.nan
    most = 2 ** (8 * len(raw)) - 1
    return int.from_bytes(raw, "big") / most * (high - low) + low if raw else np.nan


def _packets(data: bytes, checked: bool) -> Iterator[dict[int, bytes]]:
    at = data.find(KEY)
    while at >= 0:
        try:
            size, start = _ber(data, at + len(KEY))
            end = start + size
            stated = data[end - 2 : end] if end <= len(data) else b""
            if len(stated) == 2 and (not checked or _sum(data[at : end - 2]) == int.from_bytes(stated, "big")):
                yield dict(_items(data[start:end]))
        except (IndexError, ValueError, struct.error):
            pass
        at = data.find(KEY, at + 1)


def _ber(data: bytes, at: int) -> tuple[int, int]:
    first = data[at]
    if first < 0x80:
        return first, at + 1
    return int.from_bytes(data[at + 1 : at + 1 + first % 128], "big"), at + 1 + first % 128


def _items(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(data):
        tag = 0
        while data[at] >= 0x80:
            tag, at = (tag | data[at] & 0x7F) << 7, at + 1
        tag, (size, start) = tag | data[at], _ber(data, at + 1)
        at = start + size
        if at > len(data):
            raise ValueError("an item reaches over the end")
        yield tag, data[start:at]


def _sum(data: bytes) -> int:
    return (256 * sum(data[::2]) + sum(data[1::2])) % 65536


def _payloads(data: bytes) -> list[bytes]:
    """The payloads of a transport stream by its packets of 188 bytes, one for each PID, headers of PES taken off."""
    found: dict[int, list[bytes]] = {}
    at = 0
    while at + 188 <= len(data):
        if data[at] != 0x47 or (at + 376 <= len(data) and data[at + 188] != 0x47):
            at += 1
            continue
        packet, at = data[at : at + 188], at + 188
        pid, adapts = (packet[1] & 0x1F) << 8 | packet[2], packet[3] >> 4
        start = 4 + (1 + packet[4] if adapts & 2 else 0)
        part = packet[start:] if adapts & 1 else b""
        if packet[1] & 0x40 and part[:3] == b"\x00\x00\x01" and len(part) > 9:
            part = part[9 + part[8] :]
        found.setdefault(pid, []).append(part)
    return [b"".join(parts) for parts in found.values()]


def sbet(path: pathlib.Path, found: Any) -> None:
    """Records of 17 doubles: time, latitude, longitude, height, three velocities, roll, pitch, heading, wander, ..."""
    records, pose = doubles(path.read_bytes(), 17), found.shots.pose
    same_names("records", found.names, range(len(records)))
    steps = np.concatenate([[0.0], np.cumsum(np.diff(records[:, 0]) < 0.0)])
    same("times", found.shots.time, records[:, 0] + 604_800.0 * steps)
    same("latitude", pose.position.lat, records[:, 1])
    same("height", pose.position.height, records[:, 3])
    same_turn("longitude", np.rad2deg(pose.position.lon), np.rad2deg(records[:, 2]))
    same("roll and pitch", [pose.roll, pose.pitch], records[:, 7:9].T)
    same_turn("heading", np.rad2deg(pose.heading), np.rad2deg(records[:, 9] - records[:, 10]))


def smrmsg(path: pathlib.Path, found: Any) -> None:
    """Records of 10 doubles: time; north, east, down in m; three velocities; roll, pitch, heading in arc minutes."""
    records, times = doubles(path.read_bytes(), 10), np.asarray(found.shots.time)
    at = [np.interp(times, records[:, 0], column) for column in records.T]
    position, attitude = found.sources
    same("errors of position", position.sigma, np.stack(at[1:4], axis=-1))
    minutes = np.stack([at[9], at[8], at[7]], axis=-1)
    same("errors of attitude", attitude.sigma, np.deg2rad(minutes / 60.0), 1e-15)
