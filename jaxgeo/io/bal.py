"""Problem files of "Bundle Adjustment in the Large" (Agarwal et al., ECCV 2010), plain or compressed text."""

from __future__ import annotations

import bz2
import io
import os
import pathlib
from dataclasses import dataclass

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo._text_numbers import number_in, whole_in
from jaxgeo.io._bounded import unpacked
from jaxgeo.io._quietly import heard
from jaxgeo.io._regular import check_regular
from jaxgeo.io.errors import TableError


@dataclass(frozen=True)
class BalProblem:
    """n cameras, m points and k observations, in the conventions of the files.

    A point X has the camera coordinates P = R X + `translation`, where R is the rotation about `rotation` (n, 3) by its
    length in rad (Rodrigues). The camera looks along -z: p = -(P_x, P_y) / P_z, and the observed pixel is
    `focal_px` (1 + `k1` |p|^2 + `k2` |p|^4) p, counted from the image centre to the right and up. `points` are
    (m, 3), in an arbitrary frame and unit; `image_index` and `point_index` (k,) give the camera and the point of each
    observation `uv` (k, 2), in pixels.
    """

    rotation: np.ndarray
    translation: np.ndarray
    focal_px: np.ndarray
    k1: np.ndarray
    k2: np.ndarray
    points: np.ndarray
    image_index: np.ndarray
    point_index: np.ndarray
    uv: np.ndarray

    def residuals(self) -> np.ndarray:
        """Reprojection residuals, modelled minus observed, (k, 2) in pixels."""
        of_camera = (x[self.image_index] for x in (self.rotation, self.translation, self.focal_px, self.k1, self.k2))
        rotation, translation, focal, k1, k2 = of_camera
        P = _rotated(rotation, self.points[self.point_index]) + translation
        p = -P[:, :2] / P[:, 2:]
        r2 = np.sum(p * p, axis=1)
        return (focal * (1.0 + r2 * (k1 + r2 * k2)))[:, None] * p - self.uv

    def cost(self) -> float:
        """Half the sum of the squared residuals, in square pixels."""
        return 0.5 * float(np.sum(self.residuals() ** 2))


def read_bal(path: str | os.PathLike[str]) -> BalProblem:
    """Read a problem from a file, compressed if its name ends in .bz2.

    Raises `TableError` for a file shorter than its counts, one larger than `jaxgeo.io.limits` allows, words that are
    not finite numbers, and observations of missing cameras or points; `FileNotFoundError`.
    """
    text = _text(path)
    header = text.partition("\n")[0].split()
    counts = [whole_in(word) for word in header]
    if len(counts) != 3 or not all(count is not None and count > 0 for count in counts):
        raise TableError(
            f"{path}, row 1: {' '.join(header)[:60]!r} are not the numbers of cameras, points and observations, three "
            f"whole numbers above zero."
        )
    cameras, points, observations = (count or 0 for count in counts)
    values = _numbers(path, text)[3:]
    needed = 4 * observations + 9 * cameras + 3 * points
    if len(values) != needed:
        what = "the file ends too early" if len(values) < needed else "there is more in the file"
        raise TableError(
            f"{path}: {len(values)} numbers below the first row, but {cameras} cameras, {points} points and "
            f"{observations} observations are {needed}; {what}."
        )
    seen, params, xyz = np.split(values, [4 * observations, 4 * observations + 9 * cameras])
    seen, params = seen.reshape(-1, 4), params.reshape(-1, 9)
    image_index = _indices(path, seen[:, 0], cameras, "camera")
    point_index = _indices(path, seen[:, 1], points, "point")
    focal, k1, k2 = params[:, 6:].T
    return BalProblem(
        params[:, :3], params[:, 3:6], focal, k1, k2, xyz.reshape(-1, 3), image_index, point_index, seen[:, 2:]
    )


def write_bal(path: str | os.PathLike[str], problem: BalProblem) -> None:
    """Write a problem to a file that `read_bal` reads without loss, compressed if its name ends in .bz2.

    The file appears only when complete. Raises `ValueError` for a path that cannot be written to.
    """
    check_is(problem, BalProblem, "problem")
    target, text = pathlib.Path(path), io.StringIO()
    text.write(f"{len(problem.rotation)} {len(problem.points)} {len(problem.uv)}\n")
    indices = np.stack([problem.image_index, problem.point_index], axis=-1)
    np.savetxt(text, np.concatenate([indices, problem.uv], axis=1), fmt=["%d", "%d", "%.17g", "%.17g"])
    others = np.stack([problem.focal_px, problem.k1, problem.k2], axis=-1)
    params = np.concatenate([problem.rotation, problem.translation, others], axis=1)
    for values in (params, problem.points):
        np.savetxt(text, values.reshape(-1, 1), fmt="%.17g")
    content = text.getvalue().encode()
    with destination("problem", target, binary=True) as stream:
        stream.write(bz2.compress(content) if target.suffix == ".bz2" else content)


def _text(path: str | os.PathLike[str]) -> str:
    check_regular(path, TableError)
    try:
        return unpacked(path).decode("ascii")
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such problem.") from None
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise TableError(f"{path}: the problem cannot be read: {error}.") from error


def _numbers(path: str | os.PathLike[str], text: str) -> np.ndarray:
    """All numbers of a file; invalid words are searched for only after NumPy has reported one."""
    with heard("jaxgeo", DeprecationWarning) as stopped:  # NumPy warns at our line that it stopped
        try:
            values = np.fromstring(text, sep=" ")
        except ValueError:
            values = np.array([np.nan])
    if not stopped and np.all(np.isfinite(values)):
        return values
    for line, row in enumerate(text.splitlines(), start=1):
        for word in row.split():
            if number_in(word) is None:
                raise TableError(f"{path}, row {line}: {word[:40]!r} is not a number.")
    return np.array([number_in(word) for word in text.split()], np.float64)


def _indices(path: str | os.PathLike[str], values: np.ndarray, count: int, what: str) -> np.ndarray:
    wrong = (values < 0.0) | (values >= count) | (values != np.floor(values))
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise TableError(f"{path}, observation {row}: {what} {values[row]:.10g} is none of 0 to {count - 1}.")
    return values.astype(np.int64)


def _rotated(rotation: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors (k, 3) rotated about `rotation` (k, 3) by its length: Rodrigues, smooth at zero."""
    angle = np.linalg.norm(rotation, axis=1, keepdims=True)
    sine, half = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    once = np.cross(rotation, v)
    return v + sine * once + half * np.cross(rotation, once)
