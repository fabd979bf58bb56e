"""DJI video subtitles (.SRT): a telemetry record for each frame, as exposures."""

from __future__ import annotations

import calendar
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from jaxgeo._checks import require_x64
from jaxgeo.io._text import read_text
from jaxgeo.io.acquisitions._flight_logs import LogRecord, acquisition_of_records
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.sentinels import SUBTITLES
from jaxgeo.sensor import FrameCamera

FORM = "subtitle file of DJI"
_DECIMAL = r"[0-9]+(?:\.[0-9]+)?"
FIELD = re.compile(r"\b([A-Za-z_]+)\s*:\s*([-+]?[0-9][^ \t\r\n\])}>,;]*)")
PLAIN = re.compile(rf"[-+]?{_DECIMAL}")
# Excludes 1_0, 0x10, 1e5, digits of other scripts, damaged bytes.
NUMBER = re.compile(rf"([-+]?{_DECIMAL}(?:/{_DECIMAL})?)m?")
CUE = re.compile(r"(\d{1,3}):(\d\d):(\d\d)[,.](\d{1,9})\s*-->\s*\d+:\d\d:\d\d[,.]\d+", re.ASCII)
TIME = re.compile(r"(\d{4})-(\d\d)-(\d\d) (\d\d):(\d\d):(\d\d)(?:[.,](\d{1,3}))?", re.ASCII)
SPELLINGS = {"longtitude": "longitude"}  # of some firmware
NAMES = {
    "lat": "latitude",
    "lon": "longitude",
    "above_takeoff": "rel_alt",
    "yaw": "gb_yaw",
    "pitch": "gb_pitch",
    "roll": "gb_roll",
}
MEASURED = frozenset({*NAMES.values(), "abs_alt", "altitude", "framecnt"})  # once in a record
MOST_FRAMES = 1e9
MOST_SHOWN = 40  # characters quoted of an invalid number
OF_VIDEO = "Times are those of the video: the file has no dates, or not for all records."
ANGLES = ("gb_yaw", "gb_pitch", "gb_roll")


def read_dji_subtitles(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    takeoff_height: float | None = None,
    cameras: FrameCamera | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read the frames of a DJI video from its subtitles: `[latitude: ..] [longitude: ..] [rel_alt: .. abs_alt: ..]
    [gb_yaw: .. gb_pitch: .. gb_roll: ..]`, named by their numbers.

    The angles are those of the camera relative to level and true north; the pose is that of a body with the camera in
    `Mount.nadir()` and `Gimbal.fixed()`. Records without a position (latitude and longitude zero), a height or angles
    are left out, and counted in `assumed`. Times are by the drone's clock, whose time zone is unknown, or without it
    those of the video.

    - `height_datum`: datum of `abs_alt`, as in scene files.
    - `takeoff_height`: instead, the height of the take-off in m above the ellipsoid, or `height_datum` if
      given, to which `rel_alt` is added.
    - `cameras`: the camera of the video, with the size of its frames; without it exposures have no sensor.
    - `camera`: a camera name; not applicable to such files.

    Raises `UnstatedDatum`; `TableError` for a file without records or without angles, and values out of range;
    `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    how = {"height_datum": height_datum, "takeoff_height": takeoff_height, "cameras": cameras, "camera": camera}
    return acquisition_of_cues(path, FORM, _cues(path), **how)


def acquisition_of_cues(
    path: str | os.PathLike[str],
    form: str,
    cues: Sequence[tuple[float, str]],
    *,
    height_datum: str | float | None,
    takeoff_height: float | None,
    cameras: FrameCamera | None,
    camera: str | None,
    facts: Mapping[str, str] | None = None,
) -> Acquisition:
    """The frames of a video from its subtitles, (start in s of the video, text) each; as `read_dji_subtitles`."""
    records = [_record(path, index, text) for index, (_, text) in enumerate(cues)]
    is_dated = all(math.isfinite(record.time) for record in records)
    if not is_dated:
        records = [replace(record, time=start) for record, (start, _) in zip(records, cues, strict=True)]
    if not any(all(name in record.values for name in ANGLES) for record in records):
        raise TableError(
            f"{path}: there are no angles of the camera (gb_yaw, gb_pitch, gb_roll), which not every drone writes; "
            f"AirData's CSV of the same flight has them."
        )
    focal = {str(record.values["focal_len"]) for record in records if record.values.get("focal_len")}
    found = acquisition_of_records(
        path,
        form,
        records,
        SUBTITLES,
        height_datum=height_datum,
        takeoff_height=takeoff_height,
        cameras=cameras,
        camera=camera,
        facts={**(facts or {}), **({"focal length as written": ", ".join(sorted(focal)[:3])} if focal else {})},
        assumed=("Times are by the drone's clock, whose time zone is not said." if is_dated else OF_VIDEO,),
    )
    return replace(found, start=records[0].time - cues[0][0])  # where the video starts


def _cues(path: str | os.PathLike[str]) -> list[tuple[float, str]]:
    """(start in s of the video, text) of each subtitle. Raises `TableError` if there is none."""
    found: list[tuple[float, list[str]]] = []
    before = 0
    for number, line in enumerate(read_text(path, FORM).splitlines(), start=1):
        cue = CUE.search(line)
        if cue:
            hours, minutes, seconds, fraction = cue.groups()
            start = 3600.0 * int(hours) + 60.0 * int(minutes) + float(f"{seconds}.{fraction}")
            found.append((start, []))
        elif found:
            found[-1][1].append(line)
        elif FIELD.search(line):
            before = before or number
    if not found:
        raise TableError(f"{path}: there are no subtitles (a line such as 00:00:00,000 --> 00:00:00,033).")
    if before:
        raise TableError(f"{path}, row {before}: there is no time above the first record (00:00:00,000 --> ...).")
    return [(start, " ".join(lines)) for start, lines in found]


def _record(path: object, index: int, text: str) -> LogRecord:
    text = re.sub(r"<[^>]*>", " ", text)
    fields: dict[str, str] = {}
    for name, word in FIELD.findall(text):
        name = SPELLINGS.get(name.lower()) or name.lower()
        number = NUMBER.fullmatch(word)
        value = number[1] if number else word[:MOST_SHOWN]
        if name in MEASURED and fields.get(name, value) != value:
            raise TableError(
                f"{path}, subtitle {index + 1}: {name} stands twice, as {fields[name]} and as {value}. One of them is "
                f"damaged, or the time between two records (a line such as 00:00:00,000 --> 00:00:00,033) is missing; "
                f"correct or remove this subtitle."
            )
        if number or name in MEASURED:
            fields[name] = value
    values = {name: float(value) if PLAIN.fullmatch(value) else value for name, value in fields.items()}
    numbers = {ours: _number(values.get(theirs)) for ours, theirs in NAMES.items()}
    numbers["altitude"] = _number(values.get("abs_alt", values.get("altitude")))
    stamp = TIME.search(text)
    frame = _number(values.get("framecnt"))
    name = str(index + 1 if frame is None or frame > MOST_FRAMES else int(frame))
    return LogRecord(name, f"subtitle {index + 1}", values, numbers, _seconds(stamp))


def _number(value: object) -> float | None:
    return value if isinstance(value, float) else None


def _seconds(stamp: re.Match[str] | None) -> float:
    """Seconds since 1970 by the clock of the file; NaN without a date or for one of zeros."""
    if stamp is None:
        return float("nan")
    *parts, fraction = stamp.groups()
    year, month, day, hour, minute, second = map(int, parts)
    if not (year > 1970 and 1 <= month <= 12 and 1 <= day <= 31):
        return float("nan")
    whole = calendar.timegm((year, month, day, hour, minute, second))
    return whole + float(f"0.{fraction or 0}")
