"""EXIF and XMP tags of an image file as one table; truncated files are refused."""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO, NamedTuple

from jaxgeo._text_numbers import number_in
from jaxgeo.io._csv import Limits
from jaxgeo.io._quietly import heard
from jaxgeo.io._regular import check_regular
from jaxgeo.io.acquisitions._tag_sizes import check_tag_sizes
from jaxgeo.io.errors import ImageError, RefusedFile, TableError
from jaxgeo.io.limits import NESTING
from jaxgeo.io.sentinels import IMAGE, is_undefined, sentinel_of

RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
CONTAINERS = {f"{{{RDF}}}{name}" for name in ("RDF", "Description", "Seq", "Bag", "Alt")}
# Prefixes of tags in this package, whatever prefix a file declares; Autel writes DJI's under another.
PREFIXES = {
    "http://www.dji.com/drone-dji/1.0": "drone-dji",
    "https://www.skydio.com/drone-skydio/1.0": "drone-skydio",
    "http://www.parrot.com/drone-parrot/1.0": "drone-parrot",
    "http://pix4d.com/camera/1.0": "Camera",
    "http://ns.sensefly.com/Camera/1.0": "Camera",
}
EXIF_PARTS = {0x8769: "TAGS", 0x8825: "GPSTAGS"}  # directories of EXIF, and Pillow's tables of their names
PIXEL_DIMENSIONS = {0xA002: "PixelXDimension", 0xA003: "PixelYDimension"}  # Pillow uses other names
XML_PACKET, GDAL_METADATA, DNG_VERSION = 700, 42112, 50706
GDAL_EXIF = "GDAL_METADATA"  # the name of that tag among the entries
FORMATS = ("JPEG", "MPO", "TIFF")
TRIED = ("JPEG", "TIFF", "PNG", "GIF", "BMP", "PPM")  # the last four are refused by name; MPO is a JPEG
HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+(\s+0x[0-9a-fA-F]+)*")
# Exceptions that Pillow raises for damaged directories: it indexes, converts and seeks by their content.
PILLOW_ERRORS = (
    OSError, EOFError, SyntaxError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError,
    ZeroDivisionError, RuntimeError, struct.error,
)  # fmt: skip
LONGEST_TEXT = 2000  # characters kept of a tag
NOT_XML = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")  # bytes that XML does not allow; some makers write them
BLOCK = 65_536  # bytes of a file searched at a time


@dataclass(frozen=True)
class ImageTags:
    """The size of an image file in pixels and its tags: "EXIF:Model", and of XMP "drone-dji:GimbalYawDegree".

    A structure's field is named "drone-skydio:CameraOrientationNED/Yaw"; lists are comma-separated texts. If a tag
    occurs several times, `values` has the first, and `repeated` another that differs: it is refused if used.
    """

    path: str
    width: int
    height: int
    values: Mapping[str, Any]
    repeated: Mapping[str, str] = field(default_factory=dict)

    def shown(self, name: str) -> str:
        """A tag as display text, empty if missing."""
        return str(self.values.get(name, "")).strip()

    def text(self, name: str) -> str:
        """A tag as text, empty if missing. Raises `TableError` if it occurs twice with different values."""
        if name in self.repeated:
            raise self.wrong(name, f"it is there twice, as {self.shown(name)[:80]!r} and {self.repeated[name][:80]!r}.")
        return self.shown(name)

    def unknown(self, quantity: str, among: tuple[str, ...] | None = None) -> str:
        """Tags (optionally only `among` some) that mark a quantity as unknown, and why; empty if none does."""
        values = self.values if among is None else {name: self.values[name] for name in among if name in self.values}
        row = sentinel_of(IMAGE, quantity, values)
        if row is None:
            return ""
        shown = ", ".join(f"{name} {_shown(self.values[name])}" for name in row.fields)
        return f"{shown} ({row.reason})"

    @property
    def camera(self) -> tuple[str, str]:
        """Make and model of the camera by EXIF, else by XMP; empty if missing."""
        make, model = (self.text(f"EXIF:{name}") or self.text(f"tiff:{name}") for name in ("Make", "Model"))
        return make, model

    def number(self, name: str, limits: Limits) -> float | None:
        """A tag as a number, None if missing or 0/0. Raises `TableError` if it is not a number or out of limits."""
        if name not in self.values or is_undefined(self.values[name]):
            return None
        low, high, unit = limits
        text, value = self.text(name), _number(self.values[name])
        if value is None:
            why = " (a decimal comma; tags have a point)" if _number(text.replace(",", ".")) is not None else ""
            raise self.wrong(name, f"{text!r} is not a number{why}; expected {unit}.")
        if not low <= value <= high:
            raise self.wrong(name, f"{value:g} is outside [{low:g}, {high:g}] {unit}.")
        return value

    def first(self, names: tuple[str, ...], limits: Limits) -> float | None:
        """The first of several tags that is present, as a number."""
        return next((self.number(name, limits) for name in names if name in self.values), None)

    def numbers(self, name: str) -> list[float]:
        """A tag's list of numbers, after the last semicolon; empty if missing. Raises `TableError`."""
        value = self.values.get(name, "") if self.text(name) else ""
        if is_undefined(value):
            return []
        parts = value if isinstance(value, tuple) else str(value).split(";")[-1].split(",")
        if len(parts) == 1 and not str(parts[0]).strip():
            return []
        found = [_number(part) for part in parts]
        if None in found:
            raise self.wrong(name, f"{self.text(name)[:80]!r} is not a list of numbers.")
        return [number for number in found if number is not None]

    def wrong(self, name: str, reason: str) -> TableError:
        """An error that names the tag."""
        return TableError(f"{self.path}, {name}: {reason}")


def read_tags(path: str | os.PathLike[str]) -> ImageTags:
    """Read the tags of a JPEG or TIFF file; pixels are not decoded, but the file must be complete.

    EXIF in GDAL's metadata of a TIFF file is read too. Raises `ImageError` for other or truncated files;
    `TableError` for XMP that is not XML, or has a document type; `FileNotFoundError`.
    """
    from PIL import UnidentifiedImageError

    name = os.fspath(path)
    if not os.path.exists(name):
        raise FileNotFoundError(f"{name}: there is no such image.")
    check_regular(name, ImageError)
    cut = "the file is damaged or cut short"
    try:
        with heard("PIL", UserWarning) as warned, open(name, "rb") as file:
            check_tag_sizes(file, name)
            raw = _raw(_opened(file, name))
    except UnidentifiedImageError as error:
        raise ImageError(f"{name}: not an image, or {cut}; expected JPEG or TIFF.") from error
    except RefusedFile:
        raise
    except PILLOW_ERRORS as error:
        raise ImageError(f"{name}: {cut}: {error}") from error
    _check_kind(name, raw)
    if warned or not raw.is_whole:  # Pillow's warning of truncated directories
        raise ImageError(f"{name}: {cut}: {warned[0] if warned else 'its pixels end before their time.'}")
    found, repeated = _xmp(name, raw.packet)
    return ImageTags(name, *raw.size, _exif(name, raw.entries) | found, repeated)


def _opened(file: BinaryIO, name: str) -> Any:
    """Open an image with Pillow, reading only its tags.

    `Image.open` also refuses images with many pixels, which are not decoded here. Raises
    `UnidentifiedImageError` if it is not an image of a tried kind.
    """
    from PIL import Image, UnidentifiedImageError

    Image.init()
    start = file.read(16)
    for kind in TRIED:
        factory, accept = Image.OPEN[kind]
        if accept is not None and accept(start) is not True:
            continue
        file.seek(0)
        with contextlib.suppress(SyntaxError, IndexError, TypeError, struct.error):  # another kind
            return factory(file, name)
    raise UnidentifiedImageError(name)


class _Raw(NamedTuple):
    """Pillow's view of a file: format, size, EXIF entries by name, XMP, and whether the file is complete."""

    kind: str
    is_dng: bool
    size: tuple[int, int]
    entries: dict[str, Any]
    packet: bytes
    is_whole: bool


def _raw(image: Any) -> _Raw:
    """All reads through Pillow, which raises `PILLOW_ERRORS` for damaged directories."""
    is_read = image.format in FORMATS
    is_dng = image.format == "TIFF" and DNG_VERSION in image.tag_v2
    if not is_read or is_dng:
        return _Raw(image.format, is_dng, image.size, {}, b"", True)
    return _Raw(image.format, False, image.size, _entries(image), _packet(image), _is_whole(image))


def _check_kind(name: str, raw: _Raw) -> None:
    if raw.kind not in FORMATS:
        raise ImageError(f"{name}: {raw.kind} images are not read; expected JPEG or TIFF, as the drone wrote it.")
    if raw.is_dng:
        raise ImageError(f"{name}: DNG files are not read: what opens is a preview. Take the JPEG of the same shot.")


def _is_whole(image: Any) -> bool:
    """Whether a file is complete up to its pixels."""
    if image.format != "TIFF":
        return _ends_in(image.fp, b"\xff\xd9")  # the end-of-image marker, which cannot occur in coded data
    size = os.fstat(image.fp.fileno()).st_size
    pairs = [(image.tag_v2.get(at, ()), image.tag_v2.get(count, ())) for at, count in ((273, 279), (324, 325))]
    return all(at + count <= size for ats, counts in pairs for at, count in zip(ats, counts, strict=True))


def _ends_in(file: Any, mark: bytes) -> bool:
    """Whether a marker occurs after the current position of a file; searched backwards from its end."""
    start, end = file.tell(), file.seek(0, os.SEEK_END)
    while end > start:
        first = max(start, end - BLOCK)
        file.seek(first)
        if mark in file.read(end - first + len(mark) - 1):  # a marker may span two blocks
            return True
        end = first
    return False


def _entries(image: Any) -> dict[str, Any]:
    """EXIF entries by their names in Pillow's tables; GDAL's metadata of a TIFF file under its number."""
    from PIL import ExifTags

    exif = image.getexif()
    names: dict[int, str] = ExifTags.TAGS | PIXEL_DIMENSIONS
    found = {names.get(key, f"0x{key:04x}"): value for key, value in exif.items() if key not in EXIF_PARTS}
    for part, table in EXIF_PARTS.items():
        names = getattr(ExifTags, table) | (PIXEL_DIMENSIONS if table == "TAGS" else {})
        found |= {names.get(key, f"0x{key:04x}"): value for key, value in exif.get_ifd(part).items()}
    return found | ({GDAL_EXIF: str(exif[GDAL_METADATA])} if GDAL_METADATA in exif else {})


def _exif(name: str, entries: dict[str, Any]) -> dict[str, Any]:
    """EXIF entries as texts, numbers and tuples; raises as `read_tags`."""
    metadata = entries.pop(GDAL_EXIF, "")
    if metadata and "DateTimeOriginal" not in entries:
        entries = entries | _gdal_exif(name, metadata)
    found = {name: _plain(value) for name, value in entries.items() if name not in ("XMLPacket", "0xa480")}
    return {f"EXIF:{name}": value for name, value in found.items() if value is not None}


def _gdal_exif(path: str, metadata: str) -> dict[str, Any]:
    """EXIF in GDAL's notation: (8.8), (24) (40) (49.0009), 0x02 0x03, or a text. Raises `TableError`."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    try:
        root = fromstring(metadata, forbid_dtd=True)
    except (ParseError, DefusedXmlException) as error:
        raise TableError(f"{path}, tag {GDAL_METADATA}: not the XML that GDAL writes: {error}.") from error
    items = {item.get("name", ""): item.text or "" for item in root.iter("Item")}
    found: dict[str, Any] = {}
    for name, text in items.items():
        if not name.startswith("EXIF_"):
            continue
        value: Any = text
        if text.startswith("("):
            value = tuple(part.strip("()") for part in text.split(") ("))
        elif HEXADECIMAL.fullmatch(text):
            value = tuple(int(part, 16) for part in text.split())
        name = name.removeprefix("EXIF_").replace("SubSec", "Subsec")
        found[name] = value[0] if isinstance(value, tuple) and len(value) == 1 else value
    return found


def _plain(value: Any) -> Any:
    """An EXIF value as text, number or tuple; None for long ones, such as maker notes."""
    if isinstance(value, bytes):
        return (value[0] if len(value) == 1 else tuple(value)) if len(value) <= 16 else None  # versions and flags
    if isinstance(value, str):
        return value.strip("\0 ")[:LONGEST_TEXT]
    if isinstance(value, tuple):
        return tuple(_plain(part) for part in value) if len(value) <= 16 else None
    if isinstance(value, int):
        return value
    return "0/0" if value != value else _number(value)  # Pillow's fraction 0/0 is not equal to itself


def _shown(value: Any) -> str:
    return " ".join(str(part) for part in value) if isinstance(value, tuple) else str(value)


def _number(value: Any) -> float | None:
    """A finite number, or one from a text, possibly a fraction; else None."""
    if isinstance(value, tuple):
        return _number(value[0]) if len(value) == 1 else None
    parts = value.split("/") if isinstance(value, str) else [value]
    try:
        found = [number_in(part) if isinstance(part, str) else float(part) for part in parts]
        numbers = [number for number in found if number is not None]
        if len(numbers) < len(found) or len(numbers) > 2:
            return None
        result = numbers[0] / numbers[1] if len(numbers) == 2 else numbers[0]
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        return None
    return result if math.isfinite(result) else None


def _packet(image: Any) -> bytes:
    """The XMP packet of a file; in TIFF any tag type, in the directory of the image or of EXIF."""
    places = (image.tag_v2, image.getexif().get_ifd(0x8769)) if image.format == "TIFF" else (image.info,)
    packet: Any = next(filter(None, (place.get(XML_PACKET, place.get("xmp")) for place in places)), b"")
    if isinstance(packet, tuple):  # of single bytes, or one of type UNDEFINED
        packet = packet[0] if len(packet) == 1 and isinstance(packet[0], bytes | str) else bytes(packet)
    packet = packet.encode() if isinstance(packet, str) else bytes(packet)
    packet = packet[max(packet.find(b"<"), 0) :].strip(b"\0 \t\r\n")  # GDAL prefixes "xml:XMP="
    return packet if packet.startswith((b"<\0", b"\0<")) else NOT_XML.sub(b" ", packet)


def _xmp(path: str, packet: bytes) -> tuple[dict[str, str], dict[str, str]]:
    """(tags, repeated tags with another value)."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    if not packet:
        return {}, {}
    prefixes: dict[str, str] = {}
    try:
        root, depth = None, 0
        for event, what in iterparse(io.BytesIO(packet), ("start-ns", "start", "end"), forbid_dtd=True):
            if event != "start-ns":
                depth += 1 if event == "start" else -1
                NESTING.check(f"{path}, XMP", depth)
                root = what  # the outermost element ends last
                continue
            prefix, uri = (str(part or "") for part in what)
            prefixes.setdefault(uri, PREFIXES.get(uri.rstrip("/"), prefix or uri))
    except ParseError as error:
        raise TableError(f"{path}, XMP: not XML, or cut off: {error}. Take the file as the drone wrote it.") from error
    except DefusedXmlException as error:
        raise TableError(f"{path}, XMP: it has a document type or entities, which no drone writes: {error}.") from error
    found, repeated = dict[str, str](), dict[str, str]()
    for key, text in _leaves(root, "", prefixes):
        if found.setdefault(key, text) != text:
            repeated.setdefault(key, text)
    return found, repeated


def _leaves(element: Any, within: str, prefixes: Mapping[str, str]) -> list[tuple[str, str]]:
    """(name, text) of all attributes and elements; `within` is the enclosing structure."""
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
