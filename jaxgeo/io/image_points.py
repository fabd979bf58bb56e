"""Image point measurements of a block as a CSV table, in pixels."""

from __future__ import annotations

import csv
import os
import pathlib
from collections.abc import Collection

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo.adjust.records import ImagePoints
from jaxgeo.io._cells import Rows, safe_cell
from jaxgeo.io._columns import names_of, refuse_doubles
from jaxgeo.io._csv import CsvTable, Limits, check_not_shares, read_csv
from jaxgeo.io.errors import TableError
from jaxgeo.io.tables import PIXEL_COLUMNS

SIGMA: Limits = (1e-9, 1e6, "pixels")
BOTH_AXES, EACH_AXIS = "sigma_px", ("sigma_u_px", "sigma_v_px")
DECIMALS = 6  # of coordinates in pixels


class _Measurements(CsvTable):
    """A table whose errors also name image and point."""

    def wrong(self, index: int, name: str, reason: str) -> TableError:
        image, point = (self.cells[index][self.header.index(key)].strip() for key in ("image", "point"))
        return TableError(f"{super().wrong(index, name, reason)} It is point {point!r} in image {image!r}.")


def read_image_points(path: str | os.PathLike[str], *, images: Collection[str] | None = None) -> ImagePoints:
    """Read image points from a CSV file, one per row.

    Columns: `image` and `point`, names; `u` and `v`, column and row in pixels with pixel centres at integers;
    optionally `sigma_px`, or `sigma_u_px` and `sigma_v_px`, standard deviations, else 1 pixel. Other columns are
    ignored. `images` are the names of a block, if no others are allowed.

    Raises `TableError` (row, image and point named) for missing columns, cells that are unknown, not numbers or
    out of range, empty names, a point measured twice in an image, an image that is not in `images`;
    `FileNotFoundError`.
    """
    table = _Measurements(**vars(read_csv(path, "table of image points", ("image", "point", *PIXEL_COLUMNS))))
    image, point = names_of(table, "image"), names_of(table, "point")
    if images is not None:
        _check_known(table, image, set(images))
    uv = np.stack([table.numbers(name, limits) for name, limits in PIXEL_COLUMNS.items()], axis=-1)
    check_not_shares(path, uv)
    sigma = [table.numbers(name, SIGMA) for name in _sigma_columns(table)]
    keys = zip(image.tolist(), point.tolist(), strict=True)
    refuse_doubles(table, keys, "image {0}, point {1}: measured twice")
    return ImagePoints(image, point, uv, np.stack(sigma, axis=-1) if len(sigma) == 2 else (sigma or [1.0])[0])


def write_image_points(path: str | os.PathLike[str], points: ImagePoints) -> None:
    """Write image points to a CSV file that `read_image_points` reads, to 1e-6 pixels.

    The file appears only when complete. Raises `ValueError` for a path that cannot be written to.
    """
    check_is(points, ImagePoints, "points")
    same = bool(np.all(points.sigma[:, 0] == points.sigma[:, 1]))
    sigma = points.sigma[:, :1] if same else points.sigma
    with destination("image points", pathlib.Path(path)) as stream:
        writer = csv.writer(Rows(stream), lineterminator="\r\n")
        writer.writerow(["image", "point", *PIXEL_COLUMNS, *([BOTH_AXES] if same else EACH_AXIS)])
        for image, point, uv, errors in zip(points.image, points.point, points.uv, sigma, strict=True):
            names = safe_cell(image), safe_cell(point)
            writer.writerow([*names, *(f"{x:.{DECIMALS}f}" for x in uv), *(f"{x:.9g}" for x in errors)])


def _sigma_columns(table: CsvTable) -> list[str]:
    """The standard deviation columns of a table: none, one for both axes, or two."""
    both, each = BOTH_AXES in table.header, [name for name in EACH_AXIS if name in table.header]
    if both and each:
        raise TableError(f"{table.path}: columns {BOTH_AXES} and {each[0]} say the same; leave one out.")
    if len(each) == 1:
        missing = next(name for name in EACH_AXIS if name not in each)
        raise TableError(f"{table.path}: no column {missing}, but {each[0]}; give both, or {BOTH_AXES} for both axes.")
    return [BOTH_AXES] if both else each


def _check_known(table: CsvTable, image: np.ndarray, images: set[str]) -> None:
    for row, name in enumerate(image.tolist()):
        if name not in images:
            raise table.wrong(row, "image", f"{name!r} is none of the {len(images)} images known.")
