"""When an image was taken by its tags: in UTC where the file says so, else by the camera's clock."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

from jaxgeo.io.acquisitions._image_tags import ImageTags


def time_of(tags: ImageTags) -> tuple[float | None, bool]:
    """(s since 1970, whether that is UTC) of an exposure; by a clock without a time zone as if it were UTC.

    None where the file has no time. Raises `TableError` for a time that is none.
    """
    told = "drone-dji:UTCAtExposure"
    if tags.text(told):
        written = tags.text(told)
        return _seconds(tags, told, written[:10].replace(":", "-") + written[10:], UTC), True
    name, zone = "EXIF:DateTimeOriginal", tags.text("EXIF:OffsetTimeOriginal")
    date, stamp = tags.text("EXIF:GPSDateStamp"), tags.numbers("EXIF:GPSTimeStamp")
    if not zone and date and len(stamp) == 3:
        midnight = _seconds(tags, "EXIF:GPSDateStamp", date.replace(":", "-"), UTC)
        return midnight + 3600.0 * stamp[0] + 60.0 * stamp[1] + stamp[2], True
    if not tags.text(name) or tags.unknown("time"):
        return None, False
    day, _, clock = tags.text(name).partition(" ")
    fraction = tags.text("EXIF:SubsecTimeOriginal")
    written = f"{day.replace(':', '-')} {clock}" + (f".{fraction}" if fraction.isdigit() and "." not in clock else "")
    return _seconds(tags, name, written, _zone(tags, zone)), bool(zone)


def _zone(tags: ImageTags, zone: str) -> timezone:
    if zone in ("", "Z"):
        return UTC
    try:
        hours, minutes = zone[1:].split(":")
        return timezone({"+": 1, "-": -1}[zone[0]] * timedelta(hours=int(hours), minutes=int(minutes)))
    except (KeyError, ValueError) as error:
        raise tags.wrong("EXIF:OffsetTimeOriginal", f"{zone!r} is no time zone; expected +08:00.") from error


def _seconds(tags: ImageTags, name: str, written: str, zone: timezone) -> float:
    whole, _, fraction = written.partition(".")
    try:
        start = datetime.fromisoformat(whole).replace(tzinfo=zone).timestamp()
        return start + (float(f"0.{int(fraction):0{len(fraction)}d}") if fraction else 0.0)
    except ValueError as error:
        raise tags.wrong(name, f"{tags.text(name)!r} is no date and time.") from error
