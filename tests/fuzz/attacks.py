"""Files made to harm whoever reads them: a table of how each is built, what reads it, and what it has to say.

A row is refused by one of the errors of its reader with `words` in the message, or read (`words` None) and then held by
`check`. To add one, add a function to a group.
"""

# ruff: noqa: E501  (a row a line)

from __future__ import annotations

import bz2
import json
import os
import pathlib
import struct
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import rasterio

from jaxgeo.io import (
    read_acquisition,
    read_bal,
    read_dem,
    read_gcp_list,
    read_image,
    read_image_points,
    read_opensfm,
    read_opensfm_cameras,
    read_orientations,
    read_orthoimage,
)
from jaxgeo.io.acquisitions import read_orthority_cameras, read_sbet
from jaxgeo.io.scene import read_scene
from tests.fuzz.sound_files import CAMERA, GCP, IMAGE_POINTS, INTERIOR, KLV, ORIENTATIONS, RECONSTRUCTION, trajectory
from tests.support.drone_image_files import packet, write_image
from tests.support.klv_packets import KEY, local_set, usual
from tests.support.rasters import hills, write


class Attack(NamedTuple):
    """What is built in a folder (the path to be read), how it is read, and words of the refusal; None where it is read."""

    name: str
    build: Callable[[pathlib.Path], pathlib.Path]
    read: Callable[[pathlib.Path], Any]
    words: str | None = ""
    check: Callable[[Any], None] = lambda answer: None


def any_exposures(path: pathlib.Path) -> Any:
    return read_acquisition(path, height_datum="ellipsoid")


def dem(path: pathlib.Path) -> Any:
    return read_dem(path, vertical_datum="ellipsoid")


def opensfm(path: pathlib.Path) -> Any:
    return read_opensfm(path, height_datum=20.0)


def orientations(path: pathlib.Path) -> Any:
    return read_orientations(path, height_datum="ellipsoid")


def gcp(path: pathlib.Path) -> Any:
    return read_gcp_list(path, height_datum="ellipsoid")


def content(name: str, made: bytes | str) -> Callable[[pathlib.Path], pathlib.Path]:
    """A file of that name and content."""

    def build(folder: pathlib.Path) -> pathlib.Path:
        (folder / name).write_bytes(made.encode() if isinstance(made, str) else made)
        return folder / name

    return build


def folder_named(name: str) -> Callable[[pathlib.Path], pathlib.Path]:
    def build(folder: pathlib.Path) -> pathlib.Path:
        (folder / name).mkdir()
        return folder / name

    return build


def pipe(name: str) -> Callable[[pathlib.Path], pathlib.Path]:
    def build(folder: pathlib.Path) -> pathlib.Path:
        os.mkfifo(folder / name)
        return folder / name

    return build


def link(name: str, target: str) -> Callable[[pathlib.Path], pathlib.Path]:
    def build(folder: pathlib.Path) -> pathlib.Path:
        (folder / name).symlink_to(target)
        return folder / name

    return build


def raster_of_size(rows: int, cols: int, **options: Any) -> Callable[[pathlib.Path], pathlib.Path]:
    """A sparse GeoTIFF, of few bytes whatever its size."""

    def build(folder: pathlib.Path) -> pathlib.Path:
        profile = {"driver": "GTiff", "dtype": "float32", "count": 1, "height": rows, "width": cols, "crs": "EPSG:4326"}
        transform = rasterio.Affine(1e-5, 0, 5.0, 0, -1e-5, 45.0)
        with rasterio.open(
            folder / "a.tif", "w", transform=transform, sparse_ok=True, tiled=True, **profile, **options
        ):
            pass
        return folder / "a.tif"

    return build


def png_of_size(rows: int, cols: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", cols, rows, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 1000)) + chunk(b"IEND", b"")
    )


def nested(opening: str, closing: str, depth: int, middle: str = "1") -> str:
    return opening * depth + middle + closing * depth


def laughs(where: str) -> str:
    """Entities that stand for ten of the one before."""
    entities = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
    return f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY l0 "ha">{entities}]>{where}'


def image_of(xmp: str) -> Callable[[pathlib.Path], pathlib.Path]:
    return lambda folder: write_image(folder / "a.jpg", xmp, make="DJI")


def changed(base: str, old: str, new: str) -> str:
    assert old in base
    return base.replace(old, new)


def reconstruction(**changes: Any) -> str:
    return json.dumps([RECONSTRUCTION | changes])


LONG_KLV = KEY + b"\x84\x7f\xff\xff\xff" + b"\x02\x08" + b"\0" * 40
ITEM_BEYOND = bytearray(local_set(usual()))
ITEM_BEYOND[len(KEY) + 2] = 0x7E  # an item longer than the packet
VRT = '<VRTDataset rasterXSize="{0}" rasterYSize="{0}"><SRS>EPSG:4326</SRS><GeoTransform>5,1e-3,0,45,0,-1e-3</GeoTransform>'
RECORDS = trajectory().astype("<f8").tobytes()

BOMBS = (
    Attack(
        "bz2 of 3 GB of zeros",
        content("a.txt.bz2", bz2.compress(b"1 1 1\n") + bz2.compress(b"0 " * 2_000_000) * 750),
        read_bal,
    ),
    Attack("bz2 cut short", content("a.txt.bz2", bz2.compress(b"1 1 1\n" + b"0 " * 1000)[:-9]), read_bal),
    Attack("bz2 that is text", content("a.txt.bz2", "1 1 1\n"), read_bal),
    Attack("DEM of 10^10 posts in 100 kB", raster_of_size(100_000, 100_000), dem),
    Attack("image of 10^10 pixels", raster_of_size(100_000, 100_000), read_image),
    Attack("orthoimage of 10^10 pixels", raster_of_size(100_000, 100_000), read_orthoimage),
    Attack("PNG whose header says 2^31 pixels", content("a.png", png_of_size(65_535, 32_768)), read_image),
    Attack("PNG whose header says 2^62 pixels", content("a.png", png_of_size(2**31 - 1, 2**31 - 1)), read_image),
    Attack(
        "VRT of 2^31 by 2^31",
        content("a.vrt", VRT.format(2**31 - 1) + '<VRTRasterBand dataType="Float32" band="1"/></VRTDataset>'),
        dem,
    ),
    Attack(
        "ASCII grid whose header says 10^5 rows",
        content("a.asc", "ncols 100000\nnrows 100000\nxllcorner 5\nyllcorner 45\ncellsize 1e-5\n1 2 3\n"),
        dem,
    ),
    Attack(
        "ASCII grid with a negative count",
        content("a.asc", "ncols -5\nnrows 2\nxllcorner 5\nyllcorner 45\ncellsize 1e-5\n1 2 3\n"),
        dem,
    ),
)
COUNTS = (
    Attack("KLV that says 2 GB", content("a.klv", LONG_KLV), any_exposures),
    Attack("KLV with lengths within lengths", content("a.klv", KEY * 2000 + b"\x05"), any_exposures),
    Attack("KLV with an item beyond its end", content("a.klv", bytes(ITEM_BEYOND)), any_exposures),
    Attack("KLV with a tag that never ends", content("a.klv", KEY + b"\x20" + b"\xff" * 32), any_exposures),
    Attack("KLV with 10^5 keys", content("a.klv", (KEY + b"\x82\xff\xff") * 100_000), any_exposures),
    Attack("BAL that says 10^18 cameras", content("a.txt", f"{10**18 - 1} 1 1\n0 0 1 1\n"), read_bal),
    Attack("BAL that says 10^30 points", content("a.txt", f"1 {10**30} 1\n0 0 1 1\n"), read_bal),
    Attack("BAL of camera -1", content("a.txt", "1 1 1\n-1 0 1 1\n" + "1\n" * 12), read_bal),
    Attack("SBET and half a record", content("a.sbet", RECORDS + RECORDS[:40]), read_sbet, "bytes"),
    Attack("SBET of NaN", content("a.sbet", np.full((4, 17), np.nan).tobytes()), read_sbet),
    Attack("table of 20,000 columns", content("a.csv", ",".join(f"c{k}" for k in range(20_000)) + "\n" + ",".join("1" * 20_000) + "\n"), orientations),
    Attack("header with one name 1000 times", content("a.csv", "image," * 1000 + "x\n" + "a," * 1000 + "1\n"), orientations, "twice"),
    Attack("row of one million cells", content("a.csv", ORIENTATIONS + "x," * 1_000_000 + "\n"), orientations),
    Attack("cell of 10 MB", content("a.csv", ORIENTATIONS + "c," + "9" * 10_000_000 + ",1,1,1,1,1,one,3\n"), orientations),
    Attack("lens of 10^300 pixels", content("a.json", json.dumps({"x": CAMERA | {"focal_x": 1e300}})), read_opensfm_cameras),
)  # fmt: skip
DEEP = (
    Attack("JSON 10^5 deep", content("a.json", nested("[", "]", 100_000)), opensfm),
    Attack("JSON 10^5 tables deep", content("a.json", nested('{"a":', "}", 100_000)), opensfm),
    Attack("JSON that only opens", content("a.json", "[" * 1_000_000), opensfm),
    Attack("YAML 10^4 deep", content("a.yaml", nested("[", "]", 10_000)), read_orthority_cameras),
    Attack("YAML of aliases of aliases", content("a.yaml", "a: &a [x]\n" + "".join(f"b{k}: &b{k} [{', '.join(['*a' if k == 0 else f'*b{k - 1}'] * 9)}]\n" for k in range(9))), read_orthority_cameras),
    Attack("YAML that runs Python", content("a.yaml", changed(INTERIOR, "type: brown", "type: !!python/object/apply:os.system ['touch /tmp/jaxgeo-was-here']")), read_orthority_cameras),
    Attack("YAML with a table as a key", content("a.yaml", "{a: 1}: b\n? [a, b]\n: c\n"), read_orthority_cameras),
    Attack("TOML 10^4 deep", content("a.toml", "a = " + nested("[", "]", 10_000)), read_scene),
    Attack("TOML of dotted keys 10^4 deep", content("a.toml", ".".join(["a"] * 10_000) + " = 1\n"), read_scene),
    Attack("XMP 3000 deep", image_of(packet({}).replace("</rdf:Description>", nested("<rdf:li>", "</rdf:li>", 3000) + "</rdf:Description>")), any_exposures),
    Attack("XML of Metashape 10^5 deep", content("a.xml", "<document><chunk>" + nested("<a>", "</a>", 100_000) + "</chunk></document>"), any_exposures),
    Attack("brackets in a CRS", content("a.txt", "+proj=" + "(" * 50_000 + "\n1 2 3 4 5 a.jpg\n"), gcp),
)  # fmt: skip
ENTITIES = (
    Attack("billion laughs in Metashape's XML", content("a.xml", laughs("<document><chunk>&l9;</chunk></document>")), any_exposures),
    Attack("billion laughs in XMP", image_of(laughs("<x:xmpmeta xmlns:x='adobe:ns:meta/'>&l9;</x:xmpmeta>")), any_exposures),
    Attack("file of the machine as an entity", content("a.xml", '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><document><chunk>&e;</chunk></document>'), any_exposures),
    Attack("document type from the network", content("a.xml", '<!DOCTYPE x SYSTEM "http://127.0.0.1:1/x.dtd"><document><chunk/></document>'), any_exposures),
    Attack("entity in XMP", image_of('<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]><x:xmpmeta xmlns:x="adobe:ns:meta/">&e;</x:xmpmeta>'), any_exposures),
)  # fmt: skip
NUMBERS = (
    Attack("integer of 5000 digits in JSON", content("a.json", reconstruction(reference_lla={"latitude": 1, "longitude": 1, "altitude": 0}).replace('"altitude": 0', '"altitude": ' + "9" * 5000)), opensfm),
    Attack("integer of 5000 digits in TOML", content("a.toml", "[camera]\nwidth = " + "9" * 5000 + "\n"), read_scene),
    Attack("integer beyond 64 bits in TOML", content("a.toml", f"[camera]\nwidth = {2**70}\nheight = 30\nfocal_px = 10.0\n"), read_scene),
    Attack("integer beyond 64 bits in YAML", content("a.yaml", changed(INTERIOR, "[640, 1152]", f"[{2**70}, 1152]")), read_orthority_cameras),
    Attack("1e400 in JSON", content("a.json", reconstruction(shots={"a": {"rotation": [0, 0, 0], "translation": [0, 0, 0], "camera": "one"}}).replace("[0, 0, 0]", "[1e400, 0, 0]", 1)), opensfm),
    Attack("NaN in JSON", content("a.json", reconstruction().replace("5.0, 100.0", "NaN, 100.0")), opensfm),
    Attack("1_0 in a table", content("a.csv", changed(ORIENTATIONS, "1800.0", "1_800.0")), orientations, "1_800.0"),
    Attack("Arabic digits in a table", content("a.csv", changed(ORIENTATIONS, "1800.0", "\u0661\u0668\u0660\u0660")), orientations),
    Attack("a no-break space in a number", content("a.csv", changed(ORIENTATIONS, "1800.0", "1\u00a0800.0")), orientations),
    Attack("a full-width digit", content("a.txt", changed(GCP[0], "292710.5", "29271\uff10.5")), gcp),
    Attack("0x10 in a table", content("a.csv", changed(IMAGE_POINTS, "10.25", "0x10")), read_image_points, "0x10"),
    Attack("infinity in a table", content("a.csv", changed(IMAGE_POINTS, "10.25", "inf")), read_image_points, "inf"),
    Attack("a latitude of 1e308", content("a.csv", changed(ORIENTATIONS, "43.7,", "1e308,")), orientations),
    Attack("a whole megabyte of zeros before a digit", content("a.csv", changed(IMAGE_POINTS, "10.25", "0" * 1_000_000 + "1")), read_image_points, "limit"),
)  # fmt: skip
PLACES = (
    Attack("empty file", content("a.csv", ""), any_exposures, "empty"),
    Attack("empty DEM", content("a.tif", ""), dem),
    Attack("folder called a.tif", folder_named("a.tif"), dem),
    Attack("folder called a.tif as an image", folder_named("a.tif"), read_image, "folder"),
    Attack("folder called a.csv", folder_named("a.csv"), orientations, "folder"),
    Attack("folder called a.json", folder_named("a.json"), opensfm),
    Attack("folder called a.toml", folder_named("a.toml"), read_scene),
    Attack("folder called a.sbet", folder_named("a.sbet"), read_sbet, "folder"),
    Attack("pipe as exposures", pipe("a.dat"), any_exposures, "pipe"),
    Attack("pipe as a DEM", pipe("a.tif"), dem, "pipe"),
    Attack("pipe as an SBET", pipe("a.sbet"), read_sbet, "pipe"),
    Attack("pipe as a scene", pipe("a.toml"), read_scene, "pipe"),
    Attack("pipe as a table", pipe("a.csv"), orientations, "pipe"),
    Attack("pipe in a folder of images", lambda folder: pipe("a.jpg")(folder).parent, any_exposures, "pipe"),
    Attack("link to a device without end", link("a.csv", "/dev/zero"), orientations, "device"),
    Attack("link to a device without end as a DEM", link("a.tif", "/dev/zero"), dem, "device"),
    Attack("link to itself", link("a.csv", "a.csv"), orientations),
    Attack("link to itself as a DEM", link("a.tif", "a.tif"), dem),
    Attack("link to nowhere", link("a.klv", "nowhere"), any_exposures, "no such"),
    Attack("name with a line break", content("a\n{1}.csv", changed(ORIENTATIONS, "43.7,", "x,")), orientations),
    Attack("name with an escape sequence", content("a\x1b[31m.csv", changed(ORIENTATIONS, "43.7,", "x,")), orientations),
    Attack("name as long as may be", content("n" * 251 + ".csv", changed(ORIENTATIONS, "43.7,", "x,")), orientations),
    Attack("name that is longer than may be", lambda folder: folder / ("n" * 5000 + ".csv"), orientations),
    Attack("name with a zero byte", lambda folder: folder / "a\0b.csv", orientations),
    Attack("name with a zero byte as a DEM", lambda folder: folder / "a\0b.tif", dem),
    Attack("name with a zero byte as exposures", lambda folder: folder / "a\0b.jpg", any_exposures),
)  # fmt: skip
BYTES = (
    Attack("zero bytes in a table", content("a.csv", changed(ORIENTATIONS, "one", "o\0e")), orientations),
    Attack("escape sequence in a table", content("a.csv", changed(ORIENTATIONS, "one", "o\x1b[31me")), orientations),
    Attack("half a UTF-16 character", content("a.csv", ORIENTATIONS.encode("utf-16")[:-1]), orientations),
    Attack("surrogates in JSON", content("a.json", reconstruction().replace('"a":', '"\\ud800":')), opensfm),
    Attack("quotes that never close", content("a.csv", ORIENTATIONS + '"' + "a,1\n" * 50_000), orientations),
    Attack("DEM whose pixels are those of a ZIP", content("a.tif", b"PK\x03\x04" + b"\0" * 500), dem),
    Attack("KLV after a megabyte of noise", content("a.klv", np.random.default_rng(1).bytes(1_000_000) + KLV), read_acquisition, ""),
    Attack("script with the name of an image", content("a.jpg", "#!/bin/sh\ntouch /tmp/jaxgeo-was-here\n"), any_exposures),
)  # fmt: skip


def unreadable(folder: pathlib.Path) -> pathlib.Path:
    path = content("a.csv", ORIENTATIONS)(folder)
    path.chmod(0)
    return path


def itself(folder: pathlib.Path) -> pathlib.Path:
    """A VRT that is its own source."""
    size = 'xOff="0" yOff="0" xSize="9" ySize="9"'
    text = VRT.format(9) + (
        '<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="1">a.vrt'
        f"</SourceFilename><SrcRect {size}/><DstRect {size}/></SimpleSource></VRTRasterBand></VRTDataset>"
    )
    return content("a.vrt", text)(folder)


def cut_while_open(folder: pathlib.Path) -> pathlib.Path:
    write(folder / "a.tif", hills((300, 300)), tiled=True, blockxsize=64, blockysize=64)
    whole = (folder / "a.tif").read_bytes()
    (folder / "a.tif").write_bytes(whole[: len(whole) // 2])
    return folder / "a.tif"


CIRCLES = (
    Attack("VRT that is its own source", itself, dem),
    Attack("TIFF that ends in its middle", cut_while_open, dem),
)
ATTACKS = (*BOMBS, *COUNTS, *DEEP, *ENTITIES, *NUMBERS, *PLACES, *BYTES, *CIRCLES)
