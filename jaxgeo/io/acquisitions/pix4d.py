"""Pix4D's calibrated cameras (*_calibrated_camera_parameters.txt with *_offset.xyz), as exposures."""

from __future__ import annotations

import os
import pathlib
from typing import NamedTuple

import numpy as np
import pyproj

from jaxgeo._checks import require_x64
from jaxgeo._text_numbers import numbers_in, whole_in, words_of
from jaxgeo.io._crs_reach import check_crs
from jaxgeo.io._json import shown
from jaxgeo.io._proj import UNKNOWN_CRS, known_crs
from jaxgeo.io._rotations import rotation_near
from jaxgeo.io._text import read_text
from jaxgeo.io.acquisitions._world_frames import FRAMES, poses_in_frame
from jaxgeo.io.acquisitions.blocks import NO_ERRORS, NO_TIMES, check_one_size, rows_of, sensor_of, shots_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.errors import TableError
from jaxgeo.io.given_camera import AS_READ
from jaxgeo.io.pix4d_camera import frame_camera_of
from jaxgeo.sensor import FrameCamera

FORM = "camera parameters of Pix4D"
ENDING, OFFSET, MAP = "_calibrated_camera_parameters.txt", "_offset.xyz", "_wkt.prj"
HEADER = (
    "filename imagewidth imageheight",
    "camera matrix k [3x3]",
    "radial distortion [3x1]",
    "tangential distortion [2x1]",
    "camera position t [3x1]",
    "camera rotation r [3x3]",
    "camera model m = k [r|-rt] x",
)
BLOCK = (3, 3, 3, 3, 2, 3, 3, 3, 3)  # numbers a line: K, radial and tangential distortion, position, R
MOST_PIXELS = 10_000_000  # largest image side and focal length
CORNER = "The principal point is taken from the corner of the first pixel: half a pixel less here."
MOVED = "Positions are those of the file plus {name}: {x:g}, {y:g}, {z:g} m."


class _Image(NamedTuple):
    """One image: name, width and height, and the numbers of its lines."""

    where: str
    name: str
    size: tuple[int, int]
    numbers: list[np.ndarray]

    @property
    def interior(self) -> tuple[float, ...]:
        """Size, K and distortion, equal for images of one camera."""
        return (*map(float, self.size), *np.concatenate(self.numbers[:5]).tolist())


def files_of_parameters(path: str | os.PathLike[str]) -> list[pathlib.Path]:
    """The camera parameter files of a folder (Pix4D's params)."""
    return sorted(one for one in pathlib.Path(path).glob(f"*{ENDING}") if one.is_file())


def read_pix4d(
    path: str | os.PathLike[str],
    *,
    height_datum: str | float | None = None,
    crs: str | int | pyproj.CRS | None = None,
    camera: str | None = None,
) -> Acquisition:
    """Read Pix4D's `PROJECT_calibrated_camera_parameters.txt`, or the folder `params` with it, by image name.

    Layout as in Pix4D's "What does the Output Params Folder contain": of each image its name and size, the camera
    matrix K, radial distortion R1 R2 R3, tangential T1 T2, position t and rotation R, with m = K [R|-Rt] X for
    (right, down, forward); the distortion is that of "How are the Internal and External Camera Parameters defined",
    which is OpenCV's. Positions are relative to `PROJECT_offset.xyz` beside it, which is added.

    - `crs`: the output coordinate system of the project, as in `read_colmap`; by default that of `PROJECT_wkt.prj`
      beside it. `height_datum` as in `read_colmap`.
    - `camera`: selects the images of one camera, named "camera 1", "camera 2" by their order in the file; images of
      one record have one size.

    Raises `TableError` for a missing offset or `crs`, fisheye cameras and other layouts, damaged files;
    `UnstatedDatum`; `VerticalDatumError`; `FileNotFoundError`; `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    place = pathlib.Path(path)
    if place.is_dir():
        files = files_of_parameters(place)
        if len(files) != 1:
            raise TableError(f"{path}: {len(files)} files *{ENDING} in this folder; name one.")
        place = files[0]
    images = _images(place)
    kinds = list(dict.fromkeys(one.interior for one in images))
    called = {interior: f"camera {k + 1}" for k, interior in enumerate(kinds)}
    taken_by = np.array([called[one.interior] for one in images])
    rows = rows_of(path, taken_by, camera)
    cameras = {called[one.interior]: _camera(one) for one in reversed(images)}
    check_one_size(path, cameras, taken_by[rows])
    offset, of_offset = _offset(place)
    frame = _map(place) if crs is None else crs
    R_world_from_camera = np.array([rotation_near(images[k].where, np.array(images[k].numbers[6:])).T for k in rows])
    centres = np.array([images[k].numbers[5] for k in rows]) + offset
    pose, notes = poses_in_frame(path, frame, height_datum, centres, R_world_from_camera)
    if crs is None:
        notes = (notes[0].replace("as given", f"as {_beside(place, MAP).name} says"), *notes[1:])
    return Acquisition(
        path=os.fspath(path),
        form=FORM,
        names=np.array([images[k].name for k in rows]),
        sensor=sensor_of(cameras, taken_by[rows]),
        shots=shots_of(pose),
        assumed=(*notes, of_offset, NO_ERRORS, AS_READ, CORNER, NO_TIMES),
        facts={"images": f"{len(rows)} of {len(images)}", "cameras": f"{len(kinds)}"},
    )


def _images(path: pathlib.Path) -> list[_Image]:
    written = [(i, line) for i, line in enumerate(read_text(path, FORM).splitlines(), 1) if line.strip()]
    head = tuple(" ".join(line.lower().split()) for _, line in written[: len(HEADER)])
    for expected, found in zip(HEADER, head, strict=False):
        if expected != found:
            raise TableError(f"{path}: {found[:60]!r} where {expected!r} is expected; only perspective cameras are "
                             f"read.")  # fmt: skip
    lines = written[len(HEADER) :]
    if not lines:
        raise TableError(f"{path}: there are no images.")
    images = [_image(path, lines[k : k + 1 + len(BLOCK)]) for k in range(0, len(lines), 1 + len(BLOCK))]
    names = [one.name for one in images]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise TableError(f"{path}: image {twice} is there twice.")
    return images


def _image(path: pathlib.Path, lines: list[tuple[int, str]]) -> _Image:
    number, first = lines[0]
    name, *sides = first.rsplit(maxsplit=2)
    size = [whole_in(one) for one in sides]
    if len(size) != 2 or any(one is None or not 0 < one <= MOST_PIXELS for one in size):
        raise TableError(f"{path}, row {number}: expected an image's name, width and height; got {shown(first[:80])}.")
    where = f"{path}, {name}"
    if len(lines) < 1 + len(BLOCK):
        raise TableError(f"{where}: the file ends within it.")
    numbers = []
    for (row, line), count in zip(lines[1:], BLOCK, strict=True):
        found = numbers_in(words_of(line))
        if found is None or len(found) != count:
            raise TableError(f"{path}, row {row}: expected {count} numbers; got {shown(line.strip()[:80])}.")
        numbers.append(np.array(found))
    return _Image(where, name, (size[0] or 0, size[1] or 0), numbers)


def _camera(image: _Image) -> FrameCamera:
    K = np.array(image.numbers[:3])
    if K[0, 1] != 0.0 or K[1, 0] != 0.0 or K[2].tolist() != [0.0, 0.0, 1.0]:
        wanted = "fx 0 cx, 0 fy cy, 0 0 1"
        raise TableError(f"{image.where}: its camera matrix must be {wanted}; got {_shown(K)}.")
    if not (0.0 < K[0, 0] <= MOST_PIXELS and 0.0 < K[1, 1] <= MOST_PIXELS):
        raise TableError(f"{image.where}: focal lengths must be positive; got {K[0, 0]:g}, {K[1, 1]:g} pixels.")
    radial, tangential = (numbers.tolist() for numbers in image.numbers[3:5])
    return frame_camera_of(image.size, (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]), radial, tangential)


def _shown(matrix: np.ndarray) -> str:
    return ", ".join(" ".join(f"{x:g}" for x in row) for row in matrix)


def _beside(path: pathlib.Path, ending: str) -> pathlib.Path:
    """The file of the same project with another ending."""
    return path.with_name(path.name.removesuffix(ENDING) + ending)


def _offset(path: pathlib.Path) -> tuple[np.ndarray, str]:
    """(offset in m, a sentence about it)."""
    place = _beside(path, OFFSET)
    if not place.is_file():
        raise TableError(
            f"{path}: its positions are relative to {place.name}, which is not beside it; copy it there, or write "
            f"0 0 0 into it if they are not."
        )
    found = numbers_in(words_of(read_text(place, "offset of Pix4D").replace(",", " ")))
    if found is None or len(found) != 3:
        got = shown(read_text(place, "offset of Pix4D").strip()[:60])
        raise TableError(f"{place}: expected three numbers, the offset of the project in m; got {got}.")
    return np.array(found), MOVED.format(name=place.name, x=found[0], y=found[1], z=found[2])


def _map(path: pathlib.Path) -> pyproj.CRS:
    """The coordinate system of the file beside it."""
    place = _beside(path, MAP)
    if not place.is_file():
        raise TableError(f"{path}: its coordinate system is not stated ({place.name} is not beside it); give {FRAMES}.")
    text = read_text(place, "coordinate system of Pix4D").strip()
    check_crs(f"{place}", text, TableError)
    try:
        return known_crs(text)
    except UNKNOWN_CRS as error:
        raise TableError(f"{place}: its coordinate system is unknown to PROJ; give {FRAMES}.") from error
