"""COLMAP models as files: cameras and images, as text and binary, without a place on the Earth.

Layout: COLMAP documentation, "Output Format" (https://colmap.github.io/format.html), and the parameter order of each
camera model in its `src/colmap/sensor/models.h`.
"""

from __future__ import annotations

import math
import os
import pathlib
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np

from jaxgeo._text_numbers import number_in, numbers_in, whole_in, words_of
from jaxgeo.io._json import shown
from jaxgeo.io._regular import check_regular
from jaxgeo.io._text import read_text, text_of
from jaxgeo.io.errors import TableError

# Camera models in the order of their numbers in binary files, and the number of their parameters.
MODELS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16, "SIMPLE_DIVISION": 4, "DIVISION": 5,
}  # fmt: skip
NAMES = tuple(MODELS)
STEMS = ("cameras", "images")
ENDINGS = (".bin", ".txt")  # COLMAP itself reads the binary files if both are there
MOST_SIDE = 10_000_000  # largest image side, pixels
FARTHEST = 1e12  # limit of translations, m
MOST_NAME = 4096  # longest image name, bytes
FRAME = re.compile(r"#\s*frame:\s*(\S+)\s*$")
POSE_WORDS = 10  # of an image's first line: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME
_COUNT, _CAMERA, _IMAGE, _POINT = (struct.Struct(f"<{form}") for form in ("Q", "iiQQ", "I7dI", "ddQ"))


@dataclass(frozen=True)
class RawCamera:
    """A camera as written: the model's name, width and height in pixels, parameters."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class RawModel:
    """Cameras by number and n images: `names` (n,), `camera` (n,) numbers, `quaternions` (n, 4) of the rotation from
    the world to the camera (w, x, y, z), `translations` (n, 3); `folder` and file `ending`."""

    folder: pathlib.Path
    ending: str
    cameras: dict[int, RawCamera]
    names: np.ndarray
    camera: np.ndarray
    quaternions: np.ndarray
    translations: np.ndarray


def files_of_model(path: str | os.PathLike[str]) -> tuple[pathlib.Path, str] | None:
    """(folder, ending) of the model in a folder; None if it has none."""
    folder = pathlib.Path(path)
    for ending in ENDINGS:
        if all((folder / f"{stem}{ending}").is_file() for stem in STEMS):
            return folder, ending
    return None


def is_colmap(head: bytes) -> bool:
    """Whether the first bytes of a file are those of COLMAP's cameras or images."""
    text = text_of(head, is_cut=True)
    if text is None:
        return _is_binary_cameras(head) or _is_binary_images(head)
    line = next((line for _, line in _lines(text)), "")
    words = words_of(line)
    is_camera = len(words) >= 4 and words[1] in MODELS and whole_in(words[0]) is not None
    return is_camera or _is_pose(words)


def read_model(path: str | os.PathLike[str]) -> RawModel:
    """The cameras and images of a folder, or of one of its files. Raises `TableError`, `FileNotFoundError`."""
    place = pathlib.Path(path)
    check_regular(place, TableError)
    if place.is_dir():
        found = files_of_model(place)
        if found is None:
            raise TableError(f"{path}: no model of COLMAP (cameras and images, both .txt or both .bin) in this folder.")
        folder, ending = found
    else:
        folder, ending = place.parent, place.suffix.lower()
        found = [folder / f"{stem}{ending}" for stem in STEMS]
        if place not in found:
            raise TableError(f"{path}: a file of COLMAP is called cameras or images, with .txt or .bin; rename it.")
        missing = [one.name for one in found if not one.is_file()]
        if missing:
            raise TableError(f"{path}: a model of COLMAP has {missing[0]} beside it, which is missing here.")
    files = {stem: folder / f"{stem}{ending}" for stem in STEMS}
    cameras = (_binary_cameras if ending == ".bin" else _text_cameras)(files["cameras"])
    images = list((_binary_images if ending == ".bin" else _text_images)(files["images"]))
    if not images:
        raise TableError(f"{files['images']}: no images.")
    names = [name for name, *_ in images]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise TableError(f"{files['images']}: image {shown(twice)} is there twice.")
    for name, camera, *_ in images:
        if camera not in cameras:
            raise TableError(
                f"{files['images']}: image {shown(name)} is of camera {camera}, not in {files['cameras']}."
            )
    poses = np.array([pose for _, _, pose in images])
    sound = np.all(np.isfinite(poses) & (np.abs(poses) < FARTHEST), axis=1)
    lengths = np.linalg.norm(np.where(sound[:, None], poses, 0.0)[:, :4], axis=1)
    wrong = np.abs(lengths - 1.0) > 1e-3
    if np.any(wrong):
        where = f"{files['images']}: image {shown(names[int(np.argmax(wrong))])}"
        raise TableError(f"{where}: QW, QX, QY, QZ is no rotation (length 1), or its position is not finite.")
    return RawModel(
        folder, ending, cameras, np.array(names), np.array([number for _, number, _ in images]),
        poses[:, :4] / lengths[:, None], poses[:, 4:],
    )  # fmt: skip


def stated_frame(model: RawModel) -> str | None:
    """The frame that a comment at the head of the images' text file states, as `write_colmap` does; None without."""
    if model.ending != ".txt":
        return None
    for line in read_text(model.folder / "images.txt", "image file of COLMAP").splitlines():
        if not line.startswith("#"):
            break
        if found := FRAME.match(line):
            return found[1]
    return None


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Numbered lines with content, without comments."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line.strip()


def _is_pose(words: list[str]) -> bool:
    if len(words) < POSE_WORDS or whole_in(words[0]) is None or whole_in(words[8]) is None:
        return False
    numbers = numbers_in(words[1:8])
    return numbers is not None and 0.5 < math.hypot(*numbers[:4]) < 2.0 and number_in(words[9]) is None


def _text_cameras(path: pathlib.Path) -> dict[int, RawCamera]:
    cameras: dict[int, RawCamera] = {}
    for row, line in _lines(read_text(path, "camera file of COLMAP")):
        where, words = f"{path}, row {row}", words_of(line)
        sides = [whole_in(word) for word in (words[:1] + words[2:4])]
        numbers = numbers_in(words[4:])
        if len(sides) < 3 or None in sides or numbers is None:
            raise TableError(f"{where}: expected CAMERA_ID, MODEL, WIDTH, HEIGHT and parameters; got {shown(line)}.")
        number, width, height = (int(side or 0) for side in sides)
        if number in cameras:
            raise TableError(f"{where}: camera {number} is there twice.")
        cameras[number] = _checked(where, RawCamera(words[1], width, height, tuple(numbers)))
    return cameras


def _checked(where: str, camera: RawCamera) -> RawCamera:
    """A camera of a known model, with its number of parameters."""
    if camera.model not in MODELS:
        raise TableError(f"{where}: {shown(camera.model)} is no camera model of COLMAP known here.")
    if len(camera.parameters) != MODELS[camera.model]:
        raise TableError(
            f"{where}: {camera.model} has {MODELS[camera.model]} parameters; got {len(camera.parameters)}."
        )
    if not (0 < camera.width <= MOST_SIDE and 0 < camera.height <= MOST_SIDE):
        raise TableError(f"{where}: {camera.width} x {camera.height} pixels are no size of an image.")
    if not all(map(math.isfinite, camera.parameters)):
        raise TableError(f"{where}: parameters are not finite.")
    return camera


def _text_images(path: pathlib.Path) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    """(name, camera, pose) of each image: a line of its pose, and one of its points, which may be empty."""
    is_points = False
    for row, line in enumerate(read_text(path, "image file of COLMAP").splitlines(), 1):
        words = words_of(line)
        if is_points and not _is_pose(words):
            is_points = False
            continue
        if is_points:
            raise TableError(f"{path}, row {row}: a second pose, where the image's points (or an empty line) belong.")
        if not words or words[0].startswith("#"):
            continue
        if not _is_pose(words):
            raise TableError(
                f"{path}, row {row}: expected IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; got {shown(line)}."
            )
        pose = numbers_in(words[1:8])
        assert pose is not None
        yield " ".join(words[9:]), int(words[8]), tuple(pose)
        is_points = True


class _Records:
    """Fixed-size records of a binary file. Raises `TableError` where it ends before one does."""

    def __init__(self, path: pathlib.Path, file: BinaryIO) -> None:
        self.path, self.file, self.size = path, file, os.fstat(file.fileno()).st_size

    def take(self, form: struct.Struct, what: str) -> tuple[Any, ...]:
        content = self.file.read(form.size)
        if len(content) < form.size:
            raise self.cut(what)
        return form.unpack(content)

    def skip(self, count: int, what: str) -> None:
        if count > self.size - self.file.tell():
            raise self.cut(what)
        self.file.seek(count, os.SEEK_CUR)

    def name(self) -> str:
        """A name up to its zero byte."""
        start = self.file.tell()
        content = self.file.read(MOST_NAME)
        end = content.find(b"\0")
        if end < 1:
            raise self.cut("the name of an image")
        self.file.seek(start + end + 1)
        try:
            return content[:end].decode("utf-8")
        except UnicodeDecodeError:
            raise TableError(f"{self.path}: the name of an image is not text ({content[:20]!r}).") from None

    def count(self, least: int) -> int:
        """The number of records, of at least so many bytes each."""
        (number,) = self.take(_COUNT, "the number of records")
        if number * least > self.size:
            raise TableError(f"{self.path}: {number} records do not fit in {self.size} bytes: damaged, or cut off.")
        return number

    def check_end(self) -> None:
        rest = self.size - self.file.tell()
        if rest:
            raise TableError(f"{self.path}: {rest} bytes follow the last record: damaged, or another version's file.")

    def cut(self, what: str) -> TableError:
        return TableError(f"{self.path}: the file ends within {what}: damaged, or cut off.")


def _binary_cameras(path: pathlib.Path) -> dict[int, RawCamera]:
    check_regular(path, TableError)
    cameras: dict[int, RawCamera] = {}
    with open(path, "rb") as file:
        records = _Records(path, file)
        for _ in range(records.count(_CAMERA.size)):
            number, model, width, height = records.take(_CAMERA, "a camera")
            where = f"{path}, camera {number}"
            if not 0 <= model < len(NAMES):
                raise TableError(f"{where}: {model} is the number of no camera model known here.")
            parameters = records.take(struct.Struct(f"<{MODELS[NAMES[model]]}d"), "a camera")
            if number in cameras:
                raise TableError(f"{where}: it is there twice.")
            cameras[number] = _checked(where, RawCamera(NAMES[model], width, height, parameters))
        records.check_end()
    return cameras


def _binary_images(path: pathlib.Path) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    check_regular(path, TableError)
    with open(path, "rb") as file:
        records = _Records(path, file)
        for _ in range(records.count(_IMAGE.size)):
            _, *pose, camera = records.take(_IMAGE, "an image")
            name = records.name()
            (points,) = records.take(_COUNT, "an image")
            records.skip(points * _POINT.size, f"the points of image {shown(name)}")
            yield name, camera, tuple(pose)
        records.check_end()


def _is_binary_cameras(head: bytes) -> bool:
    if len(head) < _COUNT.size + _CAMERA.size:
        return False
    (count,), (_, model, width, height) = _COUNT.unpack_from(head), _CAMERA.unpack_from(head, _COUNT.size)
    sized = 0 < width <= MOST_SIDE and 0 < height <= MOST_SIDE
    return 0 < count < 2**32 and 0 <= model < len(NAMES) and sized


def _is_binary_images(head: bytes) -> bool:
    if len(head) < _COUNT.size + _IMAGE.size + 2:
        return False
    (count,), (_, *pose, _) = _COUNT.unpack_from(head), _IMAGE.unpack_from(head, _COUNT.size)
    name = head[_COUNT.size + _IMAGE.size :].split(b"\0", 1)[0]
    is_turn = all(map(math.isfinite, pose)) and abs(math.hypot(*pose[:4]) - 1.0) < 1e-3
    return 0 < count < 2**32 and is_turn and bool(name) and all(byte >= 32 for byte in name[:MOST_NAME])
