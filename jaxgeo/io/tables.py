"""Shot table reader and fix table writer: CSV and GeoJSON, in degrees and metres."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TextIO

import numpy as np

from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io._cells import Rows, safe_cell
from jaxgeo.io._csv import POSE_COLUMNS, Limits, Row, check_not_shares, gimbal_columns, read_csv
from jaxgeo.io.geoid import degrees_of
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import Pose, Shot
from jaxgeo.status import Status

PIXEL_COLUMNS: dict[str, Limits] = {"u": (-1e7, 1e7, "pixels"), "v": (-1e7, 1e7, "pixels")}

GIMBAL_REFERENCE = "gimbal_reference"  # column with the reference of readings: "body" or "level"

ABOVE_TAKEOFF = "fix_height_above_takeoff_m"  # in place of heights above a datum, where that of the take-off is unknown

# Decimals written by column of a fix. Ten decimals of a degree are a hundredth of a millimetre.
FIX_COLUMNS = {
    "fix_lat_deg": 10,
    "fix_lon_deg": 10,
    "fix_height_m": 4,
    "fix_height_msl_m": 4,
    "slant_range_m": 4,
    "incidence_ellipsoid_deg": 6,
    "incidence_surface_deg": 6,
    "slope_deg": 6,
    "status": None,
}


@dataclass(frozen=True)
class ShotTable:
    """Shots of a CSV file, with or without a pixel: the numbers by column, and every row as written, to be
    carried through."""

    numbers: dict[str, np.ndarray]
    rows: list[Row]

    def __len__(self) -> int:
        return len(self.rows)

    def as_records(self, readings: Sequence[str], height_datum: str | float) -> tuple[Shot, np.ndarray]:
        """(shots, pixels): a batch of n shots with ellipsoidal heights, and their pixels (n, 2)."""
        pixels = np.stack([self.numbers[name] for name in PIXEL_COLUMNS], axis=-1)
        return self.shots(readings, height_datum), pixels

    def shots(self, readings: Sequence[str], height_datum: str | float) -> Shot:
        """A batch of n shots with ellipsoidal heights."""
        angles = readings_of(self.numbers, readings, len(self))
        return Shot(poses_of(self.numbers, height_datum), angles, np.zeros(len(self)))


def poses_of(numbers: Mapping[str, np.ndarray], height_datum: str | float) -> Pose:
    """A batch of poses from the columns of `POSE_COLUMNS`, with ellipsoidal heights.

    Raises as `ellipsoidal_heights`.
    """
    lat, lon, height, *angles = (numbers[name] for name in POSE_COLUMNS)
    height = ellipsoidal_heights(lon, lat, height, height_datum)
    position = Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height)
    heading, pitch, roll = (np.deg2rad(angle) for angle in angles)
    return Pose(position, heading, pitch, roll)


def readings_of(numbers: Mapping[str, np.ndarray], readings: Sequence[str], count: int) -> np.ndarray:
    """Gimbal readings (count, axes) in rad from their columns."""
    angles = [np.deg2rad(numbers[name]) for name in gimbal_columns(readings)]
    return np.reshape(angles, (len(readings), count)).T


def number_columns(readings: Iterable[str], *, pixels: bool = True) -> dict[str, Limits]:
    """(lowest value, highest value, unit) of every required column of a table of shots, with or without pixels.

    `readings` are the gimbal's names; their columns are `gimbal_<name>_deg`.
    """
    return POSE_COLUMNS | gimbal_columns(readings) | (PIXEL_COLUMNS if pixels else {})


def read_shots(path: str | os.PathLike[str], readings: Sequence[str], *, pixels: bool = True) -> ShotTable:
    """Read one shot and pixel per row of a CSV file; `readings` are the gimbal's names (columns `gimbal_<name>_deg`).

    Without `pixels`, for whole images, columns `u` and `v` are optional, and column names are not reserved for
    fixes. Other columns are carried through. Unknown values (`nan`, an empty cell, -9999, latitude and longitude
    both zero) are NaN, in `rows` "nan": their fix is `invalid_input`. Raises `TableError` for a missing or repeated
    column, a row of another length, a cell that is not a number or out of range, and a file that cannot be opened;
    `FileNotFoundError`.
    """
    wanted = number_columns(readings, pixels=pixels)
    table = read_csv(path, "table of shots", wanted, taken=(*FIX_COLUMNS, ABOVE_TAKEOFF) if pixels else ())
    numbers = {name: table.numbers(name, limits, unknown_too=True) for name, limits in wanted.items()}
    if pixels:
        check_not_shares(path, np.stack([numbers[name] for name in PIXEL_COLUMNS], axis=-1))
    nowhere = (numbers["lat_deg"] == 0.0) & (numbers["lon_deg"] == 0.0)  # written by GPS without a position
    for name in ("lat_deg", "lon_deg"):
        numbers[name] = np.where(nowhere, np.nan, numbers[name])
    rows = table.rows
    for name, values in numbers.items():
        for i in np.flatnonzero(np.isnan(values)):
            rows[i][name] = "nan"
    return ShotTable(numbers, rows)


def fix_rows(fix: Fix, height_msl: np.ndarray | None = None, *, is_above_takeoff: bool = False) -> Iterator[Row]:
    """One row of `FIX_COLUMNS` for each fix of a batch (n,); unknown numbers are None, the status is its name.

    `height_msl` are heights above mean sea level in m, if known. With `is_above_takeoff` the heights of the fixes are
    above a take-off whose own height is unknown: their column is `ABOVE_TAKEOFF`, in place of both others.
    """
    lat, lon, height = degrees_of(fix.position)
    angles = [np.rad2deg(x) for x in (fix.incidence_ellipsoid, fix.incidence_surface, fix.slope)]
    unknown = np.full(height.shape, np.nan)
    columns = [lat, lon, height, unknown if height_msl is None else height_msl, np.asarray(fix.slant_range), *angles]
    decimals = list(FIX_COLUMNS.values())
    for i, code in enumerate(np.asarray(fix.status)):
        numbers = [_rounded(column[i], places) for column, places in zip(columns, decimals[:-1], strict=True)]
        row = dict(zip(FIX_COLUMNS, [*numbers, Status(int(code)).name], strict=True))
        yield _above_takeoff(row) if is_above_takeoff else row


def _above_takeoff(row: Row) -> Row:
    """A row with its height as one above the take-off, and none above a datum."""
    names = {"fix_height_m": ABOVE_TAKEOFF}
    return {names.get(name, name): value for name, value in row.items() if name != "fix_height_msl_m"}


def _rounded(value: Any, places: int | None) -> float | None:
    return round(float(value), places) if math.isfinite(value) else None


def write_csv(rows: Iterable[Row], stream: TextIO) -> None:
    """Write rows as CSV, columns in the order of the first row; None is an empty cell, texts use `safe_cell`."""
    writer = None
    for row in rows:
        if writer is None:
            writer = csv.DictWriter(Rows(stream), list(row), lineterminator="\r\n")
            writer.writerow({name: safe_cell(name) for name in row})
        writer.writerow({name: safe_cell(_text(value, _decimals(name))) for name, value in row.items()})


def _decimals(name: str) -> int | None:
    return FIX_COLUMNS.get("fix_height_m" if name == ABOVE_TAKEOFF else name)


def _text(value: Any, places: int | None) -> Any:
    if value is None:
        return ""
    return value if places is None else f"{value:.{places}f}"


def write_geojson(rows: Iterable[Row], stream: TextIO, numbers: Collection[str] = ()) -> None:
    """Write rows as GeoJSON points [lon, lat, ellipsoidal height], everything else as properties.

    Points have no height where rows have none above the ellipsoid. A fix without coordinates is a feature with a null
    geometry. Columns named in `numbers` are
    written as numbers where rows have them as text. NaN and infinities, which JSON lacks, are null.
    """
    stream.write('{"type": "FeatureCollection", "features": [')
    for i, row in enumerate(rows):
        properties = {name: _typed(value, name in numbers) for name, value in row.items()}
        place = [properties[name] for name in ("fix_lon_deg", "fix_lat_deg", "fix_height_m") if name in properties]
        geometry = None if None in place else {"type": "Point", "coordinates": place}
        feature = {"type": "Feature", "geometry": geometry, "properties": properties}
        stream.write(("," if i else "") + "\n" + json.dumps(feature, allow_nan=False))
    stream.write("\n]}\n")


def _typed(value: Any, is_number: bool) -> Any:
    """A value for JSON: numeric text as a number, None for a number that is not finite."""
    if is_number and isinstance(value, str):
        value = float(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
