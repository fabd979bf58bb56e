"""What an image file says of itself: EXIF and XMP as one table of names and values, and a cut file refused."""

from __future__ import annotations

import io
import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

from jaxgeo.io._csv import Limits
from jaxgeo.io.errors import ImageError, TableError

RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
CONTAINERS = {f"{{{RDF}}}{name}" for name in ("RDF", "Description", "Seq", "Bag", "Alt")}
# Prefixes by which tags are called here, whatever prefix a file declares; Autel writes DJI's under another.
PREFIXES = {
    "http://www.dji.com/drone-dji/1.0": "drone-dji",
    "https://www.skydio.com/drone-skydio/1.0": "drone-skydio",
    "http://www.parrot.com/drone-parrot/1.0": "drone-parrot",
    "http://pix4d.com/camera/1.0": "Camera",
    "http://ns.sensefly.com/Camera/1.0": "Camera",
}
EXIF_PARTS = {0x8769: "TAGS", 0x8825: "GPSTAGS"}  # directories of EXIF, and Pillow's tables of their names
PIXEL_DIMENSIONS = {0xA002: "PixelXDimension", 0xA003: "PixelYDimension"}  # Pillow has names of its own for them
XML_PACKET, GDAL_METADATA, DNG_VERSION = 700, 42112, 50706
LONGEST_TEXT = 2000  # characters of a tag that are kept
BLOCK = 65_536  # bytes of a file that are looked through at a time


@dataclass(frozen=True)
class ImageTags:
    """The size of an image file in pixels and its tags: "EXIF:Model", and of XMP "drone-dji:GimbalYawDegree".

    A field of a structure is called "drone-skydio:CameraOrientationNED/Yaw"; lists are texts with commas.
    """

    path: str
    width: int
    height: int
    values: Mapping[str, Any]

    def text(self, name: str) -> str:
        """A tag as a text, empty where it is not there."""
        return str(self.values.get(name, "")).strip()

    @property
    def camera(self) -> tuple[str, str]:
        """Make and model of the camera by EXIF, else by XMP; empty where they are not said."""
        make, model = (self.text(f"EXIF:{name}") or self.text(f"tiff:{name}") for name in ("Make", "Model"))
        return make, model

    def number(self, name: str, limits: Limits) -> float | None:
        """A tag as a number, None where it is not there. Raises `TableError` if it is none or beyond the limits."""
        if name not in self.values:
            return None
        low, high, unit = limits
        value = _number(self.values[name])
        if value is None:
            raise self.wrong(name, f"{self.text(name)!r} is not a number; expected {unit}.")
        if not low <= value <= high:
            raise self.wrong(name, f"{value:g} is outside [{low:g}, {high:g}] {unit}.")
        return value

    def first(self, names: tuple[str, ...], limits: Limits) -> float | None:
        """The first of several tags that is there, as a number."""
        return next((self.number(name, limits) for name in names if name in self.values), None)

    def numbers(self, name: str) -> list[float]:
        """A tag that lists numbers, after the last semicolon; empty where it is not there. Raises `TableError`."""
        value = self.values.get(name, "")
        parts = value if isinstance(value, tuple) else str(value).split(";")[-1].split(",")
        if len(parts) == 1 and not str(parts[0]).strip():
            return []
        found = [_number(part) for part in parts]
        if None in found:
            raise self.wrong(name, f"{self.text(name)[:80]!r} is not a list of numbers.")
        return [number for number in found if number is not None]

    def wrong(self, name: str, reason: str) -> TableError:
        """The error of a tag."""
        return TableError(f"{self.path}, {name}: {reason}")


def read_tags(path: str | os.PathLike[str]) -> ImageTags:
    """The tags of a JPEG or TIFF file; its pixels are not decoded, but must be there to the end.

    EXIF that GDAL has put into the metadata of a TIFF file is read too. Raises `ImageError` for what is no such image,
    or is cut short; `TableError` for XMP that is no XML, or has a document type; `FileNotFoundError`.
    """
    from PIL import Image, UnidentifiedImageError

    name = os.fspath(path)
    if not os.path.exists(name):
        raise FileNotFoundError(f"{name}: there is no such image.")
    cut = "the file is damaged or cut short"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # so Pillow tells of directories that end before their time
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # no pixel is decoded
            with Image.open(name) as image:
                _check_kind(name, image)
                values = _exif(image)
                packet = _packet(image)
                if not _is_whole(image):
                    raise ImageError(f"{name}: {cut}: its pixels end before their time.")
                width, height = image.size
    except (ImageError, TableError):
        raise
    except UnidentifiedImageError as error:
        raise ImageError(f"{name}: not an image, or {cut}; expected JPEG or TIFF.") from error
    except Exception as error:  # Pillow raises whatever a damaged directory leads it to
        raise ImageError(f"{name}: {cut}: {error}") from error
    return ImageTags(name, width, height, values | _xmp(name, packet))


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
    if not tags.text(name):
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


def _check_kind(name: str, image: Any) -> None:
    if image.format not in ("JPEG", "MPO", "TIFF"):
        raise ImageError(f"{name}: {image.format} images are not read; expected JPEG or TIFF, as the drone wrote it.")
    if image.format == "TIFF" and DNG_VERSION in image.tag_v2:
        raise ImageError(f"{name}: DNG files are not read: what opens is a preview. Take the JPEG of the same shot.")


def _is_whole(image: Any) -> bool:
    """Whether a file reaches as far as its pixels."""
    if image.format != "TIFF":
        return _ends_in(image.fp, b"\xff\xd9")  # the end of an image, which cannot be within what is coded
    size = os.fstat(image.fp.fileno()).st_size
    pairs = [(image.tag_v2.get(at, ()), image.tag_v2.get(count, ())) for at, count in ((273, 279), (324, 325))]
    return all(at + count <= size for ats, counts in pairs for at, count in zip(ats, counts, strict=True))


def _ends_in(file: Any, mark: bytes) -> bool:
    """Whether a mark stands somewhere after the place where a file is read; looked for from its end, where it is."""
    start, end = file.tell(), file.seek(0, os.SEEK_END)
    while end > start:
        first = max(start, end - BLOCK)
        file.seek(first)
        if mark in file.read(end - first + len(mark) - 1):  # a mark may lie across two blocks
            return True
        end = first
    return False


def _exif(image: Any) -> dict[str, Any]:
    from PIL import ExifTags

    exif = image.getexif()
    names: dict[int, str] = ExifTags.TAGS | PIXEL_DIMENSIONS
    found = {names.get(key, f"0x{key:04x}"): value for key, value in exif.items() if key not in EXIF_PARTS}
    for part, table in EXIF_PARTS.items():
        names = getattr(ExifTags, table) | (PIXEL_DIMENSIONS if table == "TAGS" else {})
        found |= {names.get(key, f"0x{key:04x}"): value for key, value in exif.get_ifd(part).items()}
    if "DateTimeOriginal" not in found and GDAL_METADATA in exif:
        found |= _gdal_exif(str(exif[GDAL_METADATA]))
    found = {name: _plain(value) for name, value in found.items() if name not in ("XMLPacket", "0xa480")}
    return {f"EXIF:{name}": value for name, value in found.items() if value is not None}


def _gdal_exif(metadata: str) -> dict[str, Any]:
    """EXIF as GDAL writes it: (8.8), (24) (40) (49.0009), 0x02 0x03, or a text."""
    from defusedxml.ElementTree import fromstring

    items = {item.get("name", ""): item.text or "" for item in fromstring(metadata, forbid_dtd=True).iter("Item")}
    found: dict[str, Any] = {}
    for name, text in items.items():
        if not name.startswith("EXIF_"):
            continue
        value: Any = text
        if text.startswith("("):
            value = tuple(part.strip("()") for part in text.split(") ("))
        elif text.startswith("0x"):
            value = tuple(int(part, 16) for part in text.split())
        name = name.removeprefix("EXIF_").replace("SubSec", "Subsec")
        found[name] = value[0] if isinstance(value, tuple) and len(value) == 1 else value
    return found


def _plain(value: Any) -> Any:
    """A value of EXIF as text, number or tuple; None for what is long, such as a maker's notes."""
    if isinstance(value, bytes):
        return (value[0] if len(value) == 1 else tuple(value)) if len(value) <= 16 else None  # versions and flags
    if isinstance(value, str):
        return value.strip("\0 ")[:LONGEST_TEXT]
    if isinstance(value, tuple):
        return tuple(_plain(part) for part in value) if len(value) <= 16 else None
    return value if isinstance(value, int) else _number(value)


def _number(value: Any) -> float | None:
    """A finite number, or a text of one, which may be a fraction; else None."""
    if isinstance(value, tuple):
        return _number(value[0]) if len(value) == 1 else None
    parts = value.split("/") if isinstance(value, str) else [value]
    try:
        numbers = [math.nan if "_" in str(part) else float(part) for part in parts]
        result = numbers[0] / numbers[1] if len(numbers) == 2 else numbers[0]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return result if math.isfinite(result) and len(numbers) <= 2 else None


def _packet(image: Any) -> bytes:
    packet = image.tag_v2.get(XML_PACKET, b"") if image.format == "TIFF" else image.info.get("xmp", b"")
    packet = packet.encode() if isinstance(packet, str) else bytes(packet)
    return packet[max(packet.find(b"<"), 0) :].strip(b"\0 \t\r\n")  # GDAL writes "xml:XMP=" in front


def _xmp(path: str, packet: bytes) -> dict[str, str]:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    if not packet:
        return {}
    prefixes: dict[str, str] = {}
    try:
        root: Any = None
        for event, what in iterparse(io.BytesIO(packet), ("start-ns", "end"), forbid_dtd=True):
            if event == "end":
                root = what  # the last to end is the outermost
                continue
            prefix, uri = (str(part or "") for part in what)
            prefixes.setdefault(uri, PREFIXES.get(uri.rstrip("/"), prefix or uri))
    except ParseError as error:
        raise TableError(f"{path}, XMP: not XML, or cut off: {error}. Take the file as the drone wrote it.") from error
    except DefusedXmlException as error:
        raise TableError(f"{path}, XMP: it has a document type or entities, which no drone writes: {error}.") from error
    found: dict[str, str] = {}
    for key, text in _leaves(root, "", prefixes):
        if found.setdefault(key, text) != text:
            raise TableError(f"{path}, {key}: it is there twice, as {found[key][:80]!r} and {text[:80]!r}.")
    return found


def _leaves(element: Any, within: str, prefixes: Mapping[str, str]) -> list[tuple[str, str]]:
    """(name, text) of all attributes and elements; `within` is the structure that they are fields of."""
    found = [
        (_called(name, within, prefixes), text.strip()[:LONGEST_TEXT])
        for name, text in element.attrib.items()
        if not name.startswith((f"{{{RDF}}}", "{http://www.w3.org/XML", "{adobe:")) and name.startswith("{")
    ]
    listed = [(child.text or "").strip() for child in element if child.tag == f"{{{RDF}}}li" and not len(child)]
    if listed and within:
        found.append((within, ",".join(listed)[:LONGEST_TEXT]))
    for child in element:
        if child.tag in CONTAINERS or child.tag == f"{{{RDF}}}li":
            found += _leaves(child, within, prefixes)
            continue
        name = _called(child.tag, within, prefixes)
        if not len(child) and (child.text or "").strip():
            found.append((name, child.text.strip()[:LONGEST_TEXT]))
        found += _leaves(child, name, prefixes)
    return found


def _called(name: str, within: str, prefixes: Mapping[str, str]) -> str:
    uri, _, local = name.removeprefix("{").rpartition("}")
    return f"{within}/{local}" if within else f"{prefixes.get(uri, uri)}:{local}"
