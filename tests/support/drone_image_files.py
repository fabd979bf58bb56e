"""Small images with the tags of drone manufacturers, written by Pillow."""

from __future__ import annotations

import functools
import io
import pathlib
from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

SIZE, COLOUR = (40, 30), (90, 120, 60)
APPLICATION = [bytes([0xFF, 0xE0 + n]) for n in range(16)]  # markers of segments
FULL = (4000, 3000)  # image size in the tags
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
SPACES = {
    "drone-dji": "http://www.dji.com/drone-dji/1.0/",
    "drone": "http://www.dji.com/drone-dji/1.0/",  # Autel's prefix
    "drone-skydio": "https://www.skydio.com/drone-skydio/1.0/",
    "drone-parrot": "http://www.parrot.com/drone-parrot/1.0/",
    "Camera": "http://pix4d.com/camera/1.0/",
    "tiff": "http://ns.adobe.com/tiff/1.0/",
    "DLS": "http://micasense.com/DLS/1.0/",
    "camera": "http://pix4d.com/camera/1.0",
}
MAKE, MODEL, ORIENTATION, EXIF, GPS = 0x010F, 0x0110, 0x0112, 0x8769, 0x8825
PLACE = {
    1: "S",
    2: (IFDRational(33), IFDRational(30), IFDRational(150, 10)),
    3: "W",
    4: (IFDRational(70), IFDRational(15), IFDRational(301234, 10000)),
    5: 0,
    6: IFDRational(123456, 1000),
}
PLACE_DEG = (-(33 + 30 / 60 + 15 / 3600), -(70 + 15 / 60 + 30.1234 / 3600), 123.456)
CAMERA = {0x920A: IFDRational(88, 10), 0xA405: 24, 0xA002: FULL[0], 0xA003: FULL[1]}


def packet(tags: Mapping[str, Any], *, elements: bool = False) -> str:
    """XMP of tags, as attributes or as elements; a value may be a list, or a table of fields."""
    spaces = " ".join(f'xmlns:{prefix}="{uri}"' for prefix, uri in SPACES.items())
    flat = {name: str(value) for name, value in tags.items() if isinstance(value, str | float | int)}
    inner = "".join(_element(name, value) for name, value in tags.items() if elements or name not in flat)
    attributes = "" if elements else " ".join(f"{name}={quoteattr(value)}" for name, value in flat.items())
    return (
        f'<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        f'<rdf:RDF xmlns:rdf="{RDF}"><rdf:Description rdf:about="" {spaces} {attributes}>{inner}</rdf:Description>'
        f'</rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    )


def _element(name: str, value: Any) -> str:
    prefix = name.partition(":")[0]
    if isinstance(value, dict):
        inner = "".join(f"<{prefix}:{key}>{part}</{prefix}:{key}>" for key, part in value.items())
        return f'<{name} rdf:parseType="Resource">{inner}</{name}>'
    if isinstance(value, list):
        inner = "".join(f"<rdf:li>{part}</rdf:li>" for part in value)
        return f"<{name}><rdf:Seq>{inner}</rdf:Seq></{name}>"
    return f"<{name}>{escape(str(value))}</{name}>"


def write_image(
    path: pathlib.Path,
    xmp: str = "",
    *,
    make: str = "Maker",
    model: str = "Model",
    exif: Mapping[int, Any] = CAMERA,
    gps: Mapping[int, Any] = PLACE,
    first: Mapping[int, Any] | None = None,
    size: tuple[int, int] = SIZE,
    grey: np.ndarray | None = None,
) -> pathlib.Path:
    """A JPEG or TIFF file, by the ending of its path; `first` are tags of the first directory of EXIF.

    The picture is of one colour, or of `grey` values (rows, columns).
    """
    tags = Image.Exif()
    tags[MAKE], tags[MODEL] = make, model
    for key, value in (first or {}).items():
        tags[key] = value
    for part, values in ((EXIF, exif), (GPS, gps)):
        if values:
            tags.get_ifd(part).update(values)
            tags[part] = tags.get_ifd(part)  # otherwise none is written to TIFF
    is_jpeg = path.suffix.lower() == ".jpg"
    image = Image.new("RGB", SIZE if is_jpeg else size, COLOUR) if grey is None else Image.fromarray(grey)
    if is_jpeg:
        written = io.BytesIO()
        image.save(written, "jpeg", exif=tags, xmp=xmp.encode())
        head, picture = _parts(written.getvalue())
        path.write_bytes(head + (_plain(size) if grey is None else picture))
    else:
        tags[700] = xmp.encode()
        image.save(path, exif=tags)
    return path


@functools.cache
def _plain(size: tuple[int, int]) -> bytes:
    """What follows the tags of a JPEG file of one colour: of a full size it takes 0.1 s."""
    written = io.BytesIO()
    Image.new("RGB", size, COLOUR).save(written, "jpeg")
    return _parts(written.getvalue())[1]


def _parts(jpeg: bytes) -> tuple[bytes, bytes]:
    """(the beginning of a JPEG file with its application segments, the rest)."""
    end = 2
    while jpeg[end : end + 2] in APPLICATION:
        end += 2 + int.from_bytes(jpeg[end + 2 : end + 4], "big")
    return jpeg[:end], jpeg[end:]
