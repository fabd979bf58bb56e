"""Check points: surveyed points with their pixels, as the `gcp_list.txt` of OpenDroneMap or a CSV table."""

from __future__ import annotations

import dataclasses
import os
import pathlib
from typing import Any

import jax
import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.earth import Geodetic
from jaxgeo.io._columns import names_of, refuse_doubles
from jaxgeo.io._csv import POSE_COLUMNS, CsvTable, Limits, check_not_shares, read_csv
from jaxgeo.io._text import read_text
from jaxgeo.io._unread_columns import unread_columns
from jaxgeo.io.errors import OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.gcp import OFFSETS, read_gcp_list
from jaxgeo.io.observations import Observations
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.io.tables import PIXEL_COLUMNS
from jaxgeo.observation import Exposure, Observation
from jaxgeo.uncertainty import CheckPoints, ErrorModel

PLACE = {name: POSE_COLUMNS[name] for name in ("lat_deg", "lon_deg", "height_m")}
NEEDED = ("image", "point", *PIXEL_COLUMNS, *PLACE)
SURVEY = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
OF_PIXEL = ("sigma_u_px", "sigma_v_px")
HELD_BACK = "CHK-"  # beginning of the names of check points in files of OpenDroneMap
ROLES = {"control": False, "check": True}
METRES: Limits = (1e-9, 1e6, "m")
PIXELS: Limits = (1e-9, 1e6, "pixels")


@dataclasses.dataclass(frozen=True)
class SurveyedPixels:
    """n pixels of surveyed points: names of `image` and `point`, pixels `uv` (n, 2), `position` (n,).

    `sigma_enu` (n, 3) in m, `sigma_px` (n, 2) and the `flight` are None if the file does not state them. `is_check`
    (n,) flags points to hold back from an adjustment; None if the file names none. `unread` is a sentence on the
    columns of the file that are not read, if there are any.
    """

    image: np.ndarray
    point: np.ndarray
    uv: np.ndarray
    position: Geodetic
    sigma_enu: np.ndarray | None = None
    sigma_px: np.ndarray | None = None
    flight: np.ndarray | None = None
    is_check: np.ndarray | None = None
    unread: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.image)


def read_check_points(
    path: str | os.PathLike[str], *, height_datum: str | float, pixel_origin: str = "centre"
) -> SurveyedPixels:
    """Read surveyed points and their pixels.

    Either the `gcp_list.txt` of OpenDroneMap (see `read_gcp_list`), or a CSV file with a row for each pixel and the
    columns `image`, `point`, `u`, `v` (pixels, centres at integers), `lat_deg`, `lon_deg`, `height_m`; optionally the
    standard deviations `sigma_east_m`, `sigma_north_m`, `sigma_up_m` of the survey and `sigma_px`, or `sigma_u_px` and
    `sigma_v_px`, of the pixel, and `flight`, and `role`, "control" or "check": points to hold back from an adjustment.
    In a `gcp_list.txt` names that begin with "CHK-" are check points, as in OpenDroneMap. `height_datum` and
    `pixel_origin` are as for `read_gcp_list`.

    Raises `TableError` (row and column named) for missing columns, cells that are not numbers or out of range,
    sigmas that are not positive, empty names, and a point measured twice in an image; `VerticalDatumError`;
    `FileNotFoundError`.
    """
    require_x64()
    if not _is_csv(path):
        found = read_gcp_list(path, height_datum=height_datum, pixel_origin=pixel_origin)
        row = {name: number for number, name in enumerate(found.names.tolist())}
        index = np.array([row[name] for name in found.points.point.tolist()])
        position = jax.tree.map(lambda x: np.asarray(x)[index], found.position)
        is_check = np.char.startswith(np.char.upper(found.points.point), HELD_BACK)
        return SurveyedPixels(
            found.points.image,
            found.points.point,
            found.points.uv,
            position,
            is_check=is_check if any(is_check) else None,
        )
    if pixel_origin not in OFFSETS:
        raise ValueError(f"pixel_origin must be 'centre' or 'corner'; got {pixel_origin!r}.")
    table = read_csv(path, "table of check points", NEEDED)
    image, point = names_of(table, "image"), names_of(table, "point")
    refuse_doubles(table, zip(image.tolist(), point.tolist(), strict=True), "image {0}, point {1}: measured twice")
    uv = np.stack([table.numbers(name, limits) for name, limits in PIXEL_COLUMNS.items()], axis=-1)
    check_not_shares(path, uv)
    lat, lon, height = (table.numbers(name, limits) for name, limits in PLACE.items())
    try:
        height = ellipsoidal_heights(lon, lat, height, height_datum)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {error}".replace("vertical_datum", "height_datum")) from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error
    return SurveyedPixels(
        image,
        point,
        uv - OFFSETS[pixel_origin],
        Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height),
        _sigmas(table, SURVEY, None, METRES),
        _sigmas(table, OF_PIXEL, "sigma_px", PIXELS),
        names_of(table, "flight") if "flight" in table.header else None,
        _held_back(table, point) if "role" in table.header else None,
        tuple(unread_columns(table.header, {*NEEDED, *SURVEY, *OF_PIXEL, "sigma_px", "flight", "role"})),
    )


def check_points_of(
    observed: Observations, surveyed: SurveyedPixels, *, sigma_enu: Any = None, sigma_px: Any = None
) -> tuple[CheckPoints, ErrorModel, np.ndarray]:
    """(check points, the error model of their images, the row of each in `observed`), for `validate` and
    `calibrate_errors`.

    `observed` are the images with any pixel each, by `read_observations`; pixels are found by the name of the image,
    with or without its ending. `sigma_enu` in m and `sigma_px` are used where the file states none. A
    `PixelMeasurement` of the images is left out if the points state the errors of pixels.

    Raises `TableError` for an image that is not there, could not be read, or whose name fits several, and for images
    whose cameras, gimbals or kinds of errors differ (compare them in groups).
    """
    names = [str(row.get("name", "")) for row in observed.columns]
    rows = np.array([_row_of(observed, names, surveyed, number) for number in range(len(surveyed))])
    places = [observed.place(int(row)) for row in rows]
    batches = sorted({batch for batch, _ in places})
    if len(batches) > 1:
        first = [next(k for k, (batch, _) in enumerate(places) if batch == one) for one in batches[:2]]
        names = " and ".join(f"{surveyed.image[k]}" for k in first)
        raise TableError(
            f"{names} have different cameras, gimbals or kinds of errors; compare such images in separate calls."
        )
    observation, sources = observed.batches[batches[0]].at(np.array([index for _, index in places]))
    exposure = observation.exposure
    given = {"sigma_enu": surveyed.sigma_enu, "sigma_px": surveyed.sigma_px}
    given = {"sigma_enu": sigma_enu, "sigma_px": sigma_px} | {k: v for k, v in given.items() if v is not None}
    if given["sigma_px"] is not None:
        sources = tuple(one for one in sources if type(one).__name__ != "PixelMeasurement")
    points = CheckPoints(
        Observation(Exposure(exposure.sensor, exposure.motion, None, exposure.atmosphere), surveyed.uv),
        surveyed.position,
        points=surveyed.point,
        images=surveyed.image,
        flights=surveyed.flight,
        **given,
    )
    return points, ErrorModel(tuple(sources)), rows


def _is_csv(path: str | os.PathLike[str]) -> bool:
    """Whether the first line with content names columns, not a projection."""
    lines = (line.strip().lower() for line in read_text(path, "file of check points").splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    return "image" in first and "point" in first


def _sigmas(table: CsvTable, each: tuple[str, ...], both: str | None, limits: Limits) -> np.ndarray | None:
    """Columns of standard deviations, or one for all axes; None if there are none."""
    there = [name for name in each if name in table.header]
    if both is not None and both in table.header:
        if there:
            raise TableError(f"{table.path}: columns {both} and {there[0]} say the same; leave one out.")
        return np.repeat(table.numbers(both, limits)[:, None], len(each), axis=1)
    if not there:
        return None
    if len(there) < len(each):
        missing = next(name for name in each if name not in there)
        raise TableError(f"{table.path}: no column {missing}, but {there[0]}; give all of {', '.join(each)}.")
    return np.stack([table.numbers(name, limits) for name in each], axis=-1)


def _held_back(table: CsvTable, point: np.ndarray) -> np.ndarray:
    """The column `role` as flags of check points, equal in all rows of a point."""
    roles = names_of(table, "role").tolist()
    first: dict[str, str] = {}
    for row, (name, role) in enumerate(zip(point.tolist(), roles, strict=True)):
        if role.lower() not in ROLES:
            raise table.wrong(row, "role", f"{role!r} is none of control, check.")
        if first.setdefault(name, role.lower()) != role.lower():
            raise table.wrong(row, "role", f"point {name} is a {first[name]} point above.")
    return np.array([ROLES[role.lower()] for role in roles])


def _row_of(observed: Observations, names: list[str], surveyed: SurveyedPixels, number: int) -> int:
    """Row of the image of a pixel."""
    if len(names) == 1 and not names[0]:
        return 0  # a scene has no name of its image
    row = row_of_image(names, surveyed, number)
    if row in observed.unread:
        name = f"{surveyed.image[number]}"
        raise TableError(f"image {name} of point {surveyed.point[number]}: {observed.unread[row].reason}")
    return row


def row_of_image(names: list[str], surveyed: SurveyedPixels, number: int) -> int:
    """Index of the image of a pixel among names of images, with or without folder and ending. Raises `TableError`."""
    name = f"{surveyed.image[number]}"
    tried: tuple[Any, ...] = (
        str,
        lambda one: pathlib.PurePath(one).name,
        lambda one: pathlib.PurePath(one).stem.lower(),
    )
    for same in tried:
        found = [row for row, one in enumerate(names) if same(one) == same(name)]
        if len(found) == 1:
            return found[0]
        if found:
            raise TableError(f"image {name} of point {surveyed.point[number]} may be {len(found)} of the images.")
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    raise TableError(f"image {name} of point {surveyed.point[number]} is not among the images: {shown}.")
