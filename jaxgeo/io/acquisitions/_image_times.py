"""Exposure time of an image from its tags: UTC if the file states it, else the camera's clock."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta, timezone

from jaxgeo._text_numbers import number_in
from jaxgeo.io.acquisitions._image_tags import ImageTags


def time_of(tags: ImageTags) -> tuple[float | None, bool]:
    """(s since 1970, whether that is UTC) of an exposure; a clock without a time zone is read as if UTC.

    None if the file has no time. Raises `TableError` for an invalid time.
    """
    utc_tag = "drone-dji:UTCAtExposure"
    if tags.text(utc_tag):
        written = tags.text(utc_tag)
        return _seconds(tags, utc_tag, written[:10].replace(":", "-") + written[10:], UTC), True
    name, zone = "EXIF:DateTimeOriginal", tags.text("EXIF:OffsetTimeOriginal")
    date, stamp = tags.text("EXIF:GPSDateStamp"), tags.numbers("EXIF:GPSTimeStamp")
    if not zone and date and len(stamp) == 3:
        midnight = _seconds(tags, "EXIF:GPSDateStamp", date.replace(":", "-"), UTC)
        return midnight + 3600.0 * stamp[0] + 60.0 * stamp[1] + stamp[2], True
    if not tags.text(name) or tags.unknown("time"):
        return None, False
    day, _, clock = tags.text(name).partition(" ")
    fraction = tags.text("EXIF:SubsecTimeOriginal")
    written = f"{day.replace(':', '-')} {clock}" + (
        f".{fraction}" if re.fullmatch("[0-9]{1,12}", fraction) and "." not in clock else ""
    )
    return _seconds(tags, name, written, _zone(tags, zone)), bool(zone)


def _zone(tags: ImageTags, zone: str) -> timezone:
    if zone in ("", "Z"):
        return UTC
    try:
        hours, minutes = zone[1:].split(":")
        return timezone({"+": 1, "-": -1}[zone[0]] * timedelta(hours=_whole(hours), minutes=_whole(minutes)))
    except (KeyError, ValueError) as error:
        raise tags.wrong("EXIF:OffsetTimeOriginal", f"{zone!r} is no time zone; expected +08:00.") from error


def _whole(text: str) -> int:
    if not re.fullmatch("[0-9]{1,2}", text):
        raise ValueError(f"{text!r} is no whole number of two digits")
    return int(text)


def _seconds(tags: ImageTags, name: str, written: str, zone: timezone) -> float:
    whole, _, fraction = written.partition(".")
    share = number_in(f"0.{fraction}")
    try:
        start = datetime.fromisoformat(whole).replace(tzinfo=zone).timestamp()
        if share is None or not 0.0 <= share < 1.0:
            raise ValueError(f"{fraction!r} is no fraction of a second")
        return start + share
    except (ValueError, OverflowError) as error:
        raise tags.wrong(name, f"{tags.text(name)!r} is no date and time.") from error
