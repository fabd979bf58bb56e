"""Limits on what is read from a file: each on both sides, with its name and what to do; attacks end at once.

Held against: the files that the limits are for (TIFF 6.0 and EXIF as Pillow writes them, bzip2, XMP, TOML, YAML, JSON,
KLV by SMPTE ST 336), made here with more than they may have.
"""

from __future__ import annotations

import bz2
import contextlib
import json
import pathlib
import re
import resource
import struct
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from jaxgeo.io import read_acquisition, read_bal, read_image_points, read_opensfm_cameras
from jaxgeo.io._bounded import check_nesting, check_nesting_of_json, read_bytes
from jaxgeo.io.acquisitions import read_orthority_cameras
from jaxgeo.io.acquisitions._image_tags import read_tags
from jaxgeo.io.acquisitions.klv import packets
from jaxgeo.io.errors import ImageError, RefusedFile, TableError
from jaxgeo.io.limits import (
    COLUMNS,
    COMMENT_LINES,
    FILE_BYTES,
    GIB,
    LIMITS,
    MIB,
    NESTING,
    PACKET_ITEMS,
    PARAMETER_BYTES,
    TAG_BYTES,
    TAG_VALUES,
    UNPACKED_ALWAYS,
    UNPACKED_BYTES,
    UNPACKED_RATIO,
    Limit,
)
from jaxgeo.io.scene import SceneError, read_camera
from tests.fuzz.sound_files import BAL, CAMERA, DJI, IMAGE_POINTS, INTERIOR
from tests.support.drone_image_files import packet, write_image
from tests.support.klv_packets import local_set

CAMERA_TOML = "[camera]\nwidth = 40\nheight = 30\nfocal_length_mm = 8.8\npixel_pitch_um = 2.4\n"
SOON = 5.0  # s, of this machine or a slow one
MEMORY = 600 * MIB  # bytes beyond those of the process


@contextlib.contextmanager
def lowered(limit: Limit, most: int) -> Iterator[None]:
    """A limit that is cheap to reach."""
    before = limit.most
    object.__setattr__(limit, "most", most)
    try:
        yield
    finally:
        object.__setattr__(limit, "most", before)


@contextlib.contextmanager
def soon() -> Iterator[None]:
    """That something takes neither long nor much memory."""
    held = int(pathlib.Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize() if LINUX else 0
    before, start = resource.getrlimit(resource.RLIMIT_DATA), time.perf_counter()
    if LINUX:
        resource.setrlimit(resource.RLIMIT_DATA, (held + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
    assert time.perf_counter() - start < SOON


LINUX = sys.platform == "linux"


def refused(limit: Limit, path: pathlib.Path, read: Callable[[Any], Any], kind: type[Exception] = TableError) -> None:
    """That a file is refused at once, in a line that names the file, the limit, and what to do."""
    with soon(), pytest.raises(kind) as error:
        read(path)
    message = str(error.value)
    for words in (path.name, limit.name, f"{limit.most:,}", limit.remedy):
        assert words in message
    assert "\n" not in message


def written(path: pathlib.Path, content: str | bytes) -> pathlib.Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.name)
def test_each_limit_says_what_why_and_what_to_do(limit: Limit) -> None:
    assert limit.most > 0
    assert limit.why.endswith(".")
    assert not limit.remedy.endswith(".")
    limit.check("x", limit.most)
    with pytest.raises(RefusedFile, match=rf"x: {limit.most + 1:,} .*{limit.name}"):
        limit.check("x", limit.most + 1)


def test_the_page_on_limits_lists_them_all() -> None:
    page = (pathlib.Path(__file__).parents[2] / "docs" / "limits.md").read_text(encoding="utf-8")
    for limit in LIMITS:
        row = next(line for line in page.splitlines() if line.startswith(f"| `{limit.name}` |"))
        assert f" {limit.most:,} " in row
        assert limit.what in row


# Files that are read as a whole


def test_a_file_of_the_most_bytes_is_read_and_no_more(tmp_path: pathlib.Path) -> None:
    path = written(tmp_path / "points.csv", IMAGE_POINTS)
    size = path.stat().st_size
    with lowered(FILE_BYTES, size):
        assert len(read_image_points(path)) == 3
    with lowered(FILE_BYTES, size - 1):
        refused(FILE_BYTES, path, read_image_points)


@pytest.mark.parametrize(
    "ending, start", [(".csv", b"image,u,v\n"), (".json", b"{}"), (".xml", b"<document><chunk>"), (".klv", b"")]
)
def test_gigabytes_are_refused_by_their_length(tmp_path: pathlib.Path, ending: str, start: bytes) -> None:
    path = written(tmp_path / f"large{ending}", start)
    with open(path, "r+b") as file:
        file.truncate(GIB + 1)  # a file with a hole, that takes no room
    refused(FILE_BYTES, path, read_bytes)


@pytest.mark.costly
@pytest.mark.parametrize(
    "name, content, read, kind",
    [("c.toml", CAMERA_TOML, read_camera, SceneError), ("i.yaml", INTERIOR, read_orthority_cameras, TableError)],
)
def test_parameter_files_are_of_a_megabyte_at_most(
    tmp_path: pathlib.Path, name: str, content: str, read: Any, kind: type[Exception]
) -> None:
    padded = content + "#" * (MIB - len(content))
    read(written(tmp_path / name, padded))
    refused(PARAMETER_BYTES, written(tmp_path / name, padded + "#"), read, kind)


# Compressed files


def test_a_few_bytes_that_unpack_to_gigabytes_are_refused(tmp_path: pathlib.Path) -> None:
    """A .bz2 of streams one after another: 46 bytes for each 10 MB of zeros."""
    path = written(tmp_path / "bomb.bz2", bz2.compress(bytes(10_000_000)) * 600)
    assert path.stat().st_size < 40_000
    refused(UNPACKED_RATIO, path, read_bal)


def test_what_is_always_unpacked_and_no_byte_more(tmp_path: pathlib.Path) -> None:
    padded = BAL.encode() + b" " * (UNPACKED_ALWAYS - len(BAL))
    assert len(read_bal(written(tmp_path / "a.bz2", bz2.compress(padded))).uv) == 2
    refused(UNPACKED_RATIO, written(tmp_path / "b.bz2", bz2.compress(padded + b" ")), read_bal)


def test_the_size_once_unpacked_is_bounded(tmp_path: pathlib.Path) -> None:
    rng = np.random.default_rng(0)
    noise = " ".join(str(x) for x in rng.integers(0, 10**9, 20_000))
    path = written(tmp_path / "c.bz2", bz2.compress(noise.encode()))
    with lowered(UNPACKED_BYTES, len(noise)), pytest.raises(TableError, match="row 1"):
        read_bal(path)  # all of it is read, and is no problem
    with lowered(UNPACKED_BYTES, len(noise) - 1):
        refused(UNPACKED_BYTES, path, read_bal)


# Nesting


def nested(depth: int) -> list[Any]:
    content: list[Any] = []
    for _ in range(depth - 1):
        content = [content]
    return content


def test_nesting_is_counted_alike_before_and_after_parsing() -> None:
    check_nesting("x", nested(NESTING.most))
    check_nesting_of_json("x", json.dumps({"a]]]": nested(NESTING.most - 1), "b": '[[["\\"[{'}).encode())
    for content in (nested(NESTING.most + 1), {"a": nested(NESTING.most)}):
        with pytest.raises(TableError, match="NESTING"):
            check_nesting("x", content)
        with pytest.raises(TableError, match="NESTING"):
            check_nesting_of_json("x", json.dumps(content).encode())


def brackets(depth: int) -> str:
    return "[" * depth + "]" * depth


DEEP = {
    "json lists": ("a.json", lambda n: f'{{"one": {brackets(n - 1)}}}', read_opensfm_cameras, TableError),
    "json lists that do not end": ("a.json", lambda n: "[" * n, read_opensfm_cameras, TableError),
    "toml lists": ("a.toml", lambda n: f"{CAMERA_TOML}\n[x]\ny = {brackets(n - 2)}\n", read_camera, SceneError),
    "toml tables": ("a.toml", lambda n: f"{CAMERA_TOML}\nx{'.x' * (n - 3)}.y = 1\n", read_camera, SceneError),
    "toml table for a number": (
        "a.toml",
        lambda n: CAMERA_TOML.replace("height = 30", f"height{'.x' * (n - 2)} = 30"),
        read_camera,
        SceneError,
    ),
    "yaml lists": ("a.yaml", lambda n: f"{INTERIOR}x: {brackets(n - 1)}\n", read_orthority_cameras, TableError),
    "yaml tables": ("a.yaml", lambda n: f"{INTERIOR}x: {'{a: ' * (n - 1)}1{'}' * (n - 1)}\n", read_orthority_cameras,
                    TableError),
}  # fmt: skip


@pytest.mark.parametrize("kind", DEEP)
@pytest.mark.parametrize("depth", [NESTING.most, NESTING.most + 1, 2000, 100_000])
def test_deep_lists_and_tables_are_refused(tmp_path: pathlib.Path, kind: str, depth: int) -> None:
    name, content, read, error = DEEP[kind]
    path = written(tmp_path / name, content(depth))
    if depth > NESTING.most:
        refused(NESTING, path, read, error)
        return
    with soon():
        try:
            read(path)  # tables that are not looked at may be there
        except error as found:
            message = str(found)
        else:
            message = ""
    assert NESTING.name not in message


def xmp(depth: int) -> str:
    """Packets have three elements around what is in them."""
    return packet(DJI).replace(
        "</rdf:Description>", "<a:b xmlns:a='x'>" * depth + "</a:b>" * depth + "</rdf:Description>"
    )


@pytest.mark.parametrize("ending", [".jpg", ".tif"])
def test_deep_xmp_is_refused(tmp_path: pathlib.Path, ending: str) -> None:
    path = write_image(tmp_path / f"a{ending}", xmp(NESTING.most - 3), make="DJI")
    assert read_tags(path).values["drone-dji:GimbalPitchDegree"] == "-35.50"
    refused(NESTING, write_image(tmp_path / f"b{ending}", xmp(NESTING.most - 2), make="DJI"), read_tags)
    refused(NESTING, write_image(tmp_path / f"c{ending}", xmp(2000), make="DJI"), read_tags)
    if ending == ".tif":
        refused(NESTING, write_image(tmp_path / f"d{ending}", xmp(200_000), make="DJI"), read_tags)


def test_references_of_yaml_are_never_followed(tmp_path: pathlib.Path) -> None:
    """A billion laughs: nine lines, each ten times the one above."""
    lines = ["a0: &a0 [ha]"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 10)]
    with soon(), pytest.raises(TableError, match="line 2: references"):
        read_orthority_cameras(written(tmp_path / "a.yaml", "\n".join(lines)))


# Tables


def test_columns_are_counted(tmp_path: pathlib.Path) -> None:
    def table(count: int) -> str:
        names = ["image", "point", "u", "v", "sigma_px", *(f"c{k}" for k in range(count - 5))]
        return ",".join(names) + "\na,p,1,2,1" + ",0" * (count - 5) + "\n"

    with soon():
        assert len(read_image_points(written(tmp_path / "a.csv", table(COLUMNS.most)))) == 1
    refused(COLUMNS, written(tmp_path / "b.csv", table(COLUMNS.most + 1)), read_image_points)
    refused(COLUMNS, written(tmp_path / "c.csv", table(1_000_000)), read_image_points)


def test_comments_are_counted(tmp_path: pathlib.Path) -> None:
    with soon():
        assert len(read_image_points(written(tmp_path / "a.csv", "# x\n" * COMMENT_LINES.most + IMAGE_POINTS))) == 3
    path = written(tmp_path / "b.csv", "# x\n" * (COMMENT_LINES.most + 1) + IMAGE_POINTS)
    refused(COMMENT_LINES, path, read_image_points)


@pytest.mark.costly
@pytest.mark.parametrize("digits", [20, 400, 10_000, 1_000_000])
def test_integers_of_any_length_end_in_a_sentence(tmp_path: pathlib.Path, digits: int) -> None:
    long = "9" * digits
    for name, content, read in (
        ("a.csv", IMAGE_POINTS.replace("10.25", long), read_image_points),
        ("a.txt", BAL.replace("1 2 2", f"{long} 2 2"), read_bal),
        ("a.json", json.dumps({"one": CAMERA}).replace("800", long), read_opensfm_cameras),
        ("a.toml", CAMERA_TOML.replace("40", long), read_camera),
        ("b.toml", CAMERA_TOML.replace("8.8", long * 16), read_camera),
        ("a.yaml", INTERIOR.replace("640", long), read_orthority_cameras),
    ):
        with soon(), pytest.raises((TableError, SceneError), match=re.escape(name)) as error:
            read(written(tmp_path / name, content))
        assert len(str(error.value)) < 1500


# Packets


def test_items_of_a_packet_are_counted() -> None:
    sound = local_set(dict.fromkeys(range(1000, 1000 + PACKET_ITEMS.most - 1), b"\x01"))
    (one,) = packets(sound)
    assert not one.damage
    assert len(one.items) == PACKET_ITEMS.most
    (more,) = packets(local_set(dict.fromkeys(range(1000, 1000 + PACKET_ITEMS.most), b"\x01")))
    assert PACKET_ITEMS.name in more.damage
    assert not more.items


@pytest.mark.slow
@pytest.mark.parametrize("claimed", [0, 100, 5_000, 2**31, 2**60])
@pytest.mark.parametrize("apart", [24, 200, 3000])
def test_false_lengths_take_time_in_proportion_to_the_file(claimed: int, apart: int) -> None:
    """Four times as many bytes take about four times as long, not sixteen times."""
    key = local_set({})[:16]
    part = key + b"\x88" + claimed.to_bytes(8, "big")
    part += bytes(max(apart - len(part), 0))

    def seconds(size: int) -> float:
        data = part * (size // len(part))
        start = time.perf_counter()
        assert sum(1 for _ in packets(data)) > 0
        return time.perf_counter() - start

    once, more = seconds(100_000), seconds(400_000)
    assert more < 10.0 * max(once, 0.1)


# Tags of images


@pytest.mark.parametrize("pixels", [(25_000, 18_000), (60_000, 60_000)])
@pytest.mark.parametrize("ending", [".jpg", ".tif"])
def test_tags_are_read_whatever_the_number_of_pixels(
    tmp_path: pathlib.Path, pixels: tuple[int, int], ending: str
) -> None:
    """Of 450 megapixels and of 3600, neither of which Pillow would open; the pixels are not looked at."""
    small = write_image(tmp_path / f"small{ending}", packet(DJI), make="DJI").read_bytes()
    path = written(tmp_path / f"large{ending}", resized(small, *pixels))
    with soon():
        tags = read_tags(path)
    assert (tags.width, tags.height) == pixels
    assert tags.values["drone-dji:GimbalPitchDegree"] == "-35.50"


def resized(content: bytes, width: int, height: int) -> bytes:
    """An image whose header says another size."""
    if content.startswith(b"\xff\xd8"):
        at = content.index(b"\xff\xc0") + 5
        return content[:at] + struct.pack(">HH", height, width) + content[at + 4 :]
    (at,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, at)
    changed = bytearray(content)
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        (tag,) = struct.unpack_from("<H", content, entry)
        if tag in (256, 257):
            struct.pack_into("<HHII", changed, entry, tag, 4, 1, width if tag == 256 else height)
    return bytes(changed)


def tiff(entries: int, kind: int, count: int, size: int) -> bytes:
    """A TIFF whose entries all name the same bytes."""
    head = struct.pack("<2sHIH", b"II", 42, 8, entries)
    inside = b"".join(struct.pack("<HHII", 40_000 + k, kind, count, 8) for k in range(entries))
    return (head + inside + bytes(4)).ljust(size, b"\0")


@pytest.mark.parametrize(
    "kind, count, limit", [(7, 1_000_000, TAG_BYTES), (5, 6_000, TAG_VALUES), (3, 25_000, TAG_VALUES)]
)
def test_tags_that_all_name_the_same_bytes_are_refused(
    tmp_path: pathlib.Path, kind: int, count: int, limit: Limit
) -> None:
    path = written(tmp_path / "a.tif", tiff(5000, kind, count, 1_100_000))
    refused(limit, path, read_tags, ImageError)
    exif = b"Exif\0\0" + tiff(5000, kind, min(count, 60_000), 65_000)
    jpeg = b"\xff\xd8\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + b"\xff\xd9"
    refused(limit, written(tmp_path / "a.jpg", jpeg), read_tags, ImageError)


def test_tags_up_to_the_limits_are_read(tmp_path: pathlib.Path) -> None:
    path = write_image(tmp_path / "a.tif", packet(DJI), make="DJI")
    for limit in (TAG_BYTES, TAG_VALUES):
        low, high = 0, 1_000_000
        while high - low > 1:  # the least that lets it pass
            middle = (low + high) // 2
            with lowered(limit, middle), contextlib.suppress(ImageError):
                read_tags(path)
                high = middle
                continue
            low = middle
        assert 10 < high < 20_000
        with lowered(limit, high):
            read_tags(path)
        with lowered(limit, high - 1):
            refused(limit, path, read_tags, ImageError)


def test_the_whole_way_of_an_image_of_450_megapixels(tmp_path: pathlib.Path) -> None:
    small = write_image(tmp_path / "small.jpg", packet(DJI), make="DJI").read_bytes()
    path = written(tmp_path / "large.jpg", resized(small, 25_000, 18_000))
    found = read_acquisition(path, height_datum="ellipsoid", camera="focal=50mm,pitch=2um")
    assert found.sensor is not None
    assert (int(found.sensor.camera.width), int(found.sensor.camera.height)) == (25_000, 18_000)
