"""Surveyed points with their pixels as the control of a block of images, and its residuals as a file."""

from __future__ import annotations

import csv
import os
import pathlib
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxgeo._destination import destination
from jaxgeo.adjust import ImagePoints
from jaxgeo.io._cells import Rows, safe_cell
from jaxgeo.io.check_points import SurveyedPixels, row_of_image
from jaxgeo.io.errors import TableError
from jaxgeo.ties import Control, ControlResiduals

COLUMNS = (
    *("point", "role", "images", "east_m", "north_m", "up_m", "sigma_east_m", "sigma_north_m", "sigma_up_m"),
    *("residual_px", "sigma_px"),
)
SAME = 1e-9  # rad, about 6 mm: positions of one point in two rows of a table
SAME_HEIGHT = 1e-3  # m


def control_of(
    surveyed: SurveyedPixels,
    names: Sequence[str],
    *,
    sigma_enu: Any,
    sigma_px: Any,
    check: Sequence[str] = (),
) -> Control:
    """Control of a block from surveyed pixels, as `read_check_points` reads them.

    `names` are those of the images; a pixel's image is found with or without folder and ending. `sigma_enu` in m (a
    number or (3,)) and `sigma_px` are used where the file states none. Points are held back if the file or `check`
    names them.

    Raises `TableError` for an image that is not there or whose name fits several, and for a point with two positions or
    two sigmas; `ValueError` as `Control`.
    """
    names = [str(name) for name in names]
    image = [names[row_of_image(names, surveyed, number)] for number in range(len(surveyed))]
    point, first, index = np.unique(surveyed.point, return_index=True, return_inverse=True)
    position = jax.tree.map(lambda x: np.asarray(x)[first], surveyed.position)
    for part, most in (("lat", SAME), ("lon", SAME), ("height", SAME_HEIGHT)):
        away = np.abs(np.asarray(getattr(surveyed.position, part)) - np.asarray(getattr(position, part))[index])
        _refuse_other(surveyed, away > most, "position")
    survey: Any = np.broadcast_to(np.asarray(sigma_enu, float), (len(point), 3))
    if surveyed.sigma_enu is not None:
        survey = surveyed.sigma_enu[first]
        _refuse_other(surveyed, np.any(surveyed.sigma_enu != survey[index], axis=1), "sigma")
    pixel = sigma_px if surveyed.sigma_px is None else surveyed.sigma_px
    marks = ImagePoints(image, surveyed.point, surveyed.uv, pixel)
    held_back = [] if surveyed.is_check is None else np.unique(surveyed.point[surveyed.is_check]).tolist()
    return Control(point, position, survey, marks, [*held_back, *check])


def write_control(path: str | os.PathLike[str], residuals: ControlResiduals) -> None:
    """Write the residuals of control and check points as CSV, a row for each point.

    Columns: point, role ("control", "check", "left out"), number of adjusted images, residual east, north, up in m
    with predicted standard deviations, RMS residual of its pixels and their standard deviation in px; empty where
    unknown. The file appears only when complete. Raises `ValueError` for a path that does not end in .csv.
    """
    target = pathlib.Path(path)
    if target.suffix.lower() != ".csv":
        raise ValueError(f"{target}: control points are written as CSV; name a file that ends in .csv.")
    with destination("control points", target) as stream:
        writer = csv.writer(Rows(stream), lineterminator="\r\n")
        writer.writerow(COLUMNS)
        for row, name in enumerate(residuals.name.tolist()):
            own = residuals.point == name
            pixels = (float(np.sqrt(np.mean(x[own] ** 2))) if np.any(own) else np.nan for x in _of_pixels(residuals))
            numbers = [*residuals.enu[row], *residuals.sigma_enu[row], *pixels]
            shown = ["" if not np.isfinite(x) else f"{x:.4f}" for x in numbers]
            writer.writerow([safe_cell(name), str(residuals.role[row]), int(residuals.images[row]), *shown])


def _of_pixels(residuals: ControlResiduals) -> tuple[np.ndarray, np.ndarray]:
    return residuals.px, residuals.sigma_px


def _refuse_other(surveyed: SurveyedPixels, wrong: np.ndarray, what: str) -> None:
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise TableError(
            f"point {surveyed.point[row]} has another {what} with its pixel in image {surveyed.image[row]} than before."
        )
