"""Tables of shots in, tables of fixes out: CSV and GeoJSON, in degrees and metres."""

from __future__ import annotations

import csv
import difflib
import json
import math
import os
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TextIO

import numpy as np

from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import Pose, Shot
from jaxgeo.status import Status

# Column: lowest and highest value, unit.
POSE_COLUMNS = {
    "lat_deg": (-90.0, 90.0, "deg"),
    "lon_deg": (-360.0, 360.0, "deg"),
    "height_m": (-2000.0, 2_000_000.0, "m"),
    "heading_deg": (-360.0, 360.0, "deg"),
    "pitch_deg": (-90.0, 90.0, "deg"),
    "roll_deg": (-180.0, 180.0, "deg"),
}
PIXEL_COLUMNS = {"u": (-1e7, 1e7, "pixels"), "v": (-1e7, 1e7, "pixels")}

# Column of a fix: decimals that are written. Ten of a degree are a hundredth of a millimetre.
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

SEPARATORS = {";": "';'", "\t": "tabs", "|": "'|'"}  # that other programs write, and their names in a message

Row = dict[str, Any]


class TableError(ValueError):
    """A table that cannot be read; the message names the file, the row and the column."""


@dataclass(frozen=True)
class ShotTable:
    """Shots and pixels of a CSV file: the numbers by column, and every row as it was written, to be carried through."""

    numbers: dict[str, np.ndarray]
    rows: list[Row]

    def __len__(self) -> int:
        return len(self.rows)

    def as_records(self, readings: Sequence[str], height_datum: str | float) -> tuple[Shot, np.ndarray]:
        """(shots, pixels): a batch of n shots and their pixels (n, 2), heights made ellipsoidal."""
        n = self.numbers
        height = ellipsoidal_heights(n["lon_deg"], n["lat_deg"], n["height_m"], height_datum)
        position = Geodetic(lat=np.deg2rad(n["lat_deg"]), lon=np.deg2rad(n["lon_deg"]), height=height)
        heading, pitch, roll = (np.deg2rad(n[name]) for name in ("heading_deg", "pitch_deg", "roll_deg"))
        pose = Pose(position, heading, pitch, roll)
        angles = np.reshape([np.deg2rad(n[f"gimbal_{name}_deg"]) for name in readings], (len(readings), len(self)))
        return Shot(pose, angles.T, np.zeros(len(self))), np.stack([n["u"], n["v"]], axis=-1)


def number_columns(readings: Iterable[str]) -> dict[str, tuple[float, float, str]]:
    """(lowest value, highest value, unit) of every column that a table of shots must have.

    `readings` are the gimbal's names; their columns are `gimbal_<name>_deg`.
    """
    return POSE_COLUMNS | {f"gimbal_{name}_deg": (-360.0, 360.0, "deg") for name in readings} | PIXEL_COLUMNS


def read_shots(path: str | os.PathLike[str], readings: Sequence[str]) -> ShotTable:
    """One shot and pixel for each row of a CSV file; `readings` are the gimbal's names (columns `gimbal_<name>_deg`).

    Other columns are carried through. A number written as `nan` is taken as unknown: its fix is `invalid_input`.
    Raises `TableError` for a missing or doubled column, a row of another length, and a cell that is no number or out of
    range, another separator than the comma, and a file that cannot be opened; `FileNotFoundError`.
    """
    wanted = number_columns(readings)
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, strict=True)
            header = [name.strip() for name in next(reader, [])]
            _check_header(path, header, wanted)
            cells = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: there is no such table of shots.") from None
    except IsADirectoryError:
        raise TableError(f"{path}: this is a folder; give the CSV file in it.") from None
    except OSError as error:
        raise TableError(f"{path}: the table of shots cannot be read: {error.strerror}.") from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise TableError(f"{path}: not a CSV file in UTF-8: {error}.") from error
    if not cells:
        raise TableError(f"{path}: no rows below the header.")
    for line, row in cells:
        if len(row) != len(header):
            raise TableError(f"{path}, row {line}: {len(row)} cells, but the header has {len(header)}.")
    numbers = {name: _numbers(path, cells, header.index(name), name, *limits) for name, limits in wanted.items()}
    return ShotTable(numbers, [dict(zip(header, row, strict=True)) for _, row in cells])


def _check_header(path: str | os.PathLike[str], header: list[str], wanted: Mapping[str, Any]) -> None:
    doubled = sorted({name for name in header if header.count(name) > 1})
    if doubled:
        raise TableError(f"{path}: column {doubled[0]} stands twice in the header.")
    missing = [name for name in wanted if name not in header]
    if missing:
        _check_separator(path, header, wanted)
        raise TableError(
            f"{path}: no column {', '.join(missing)}.{_near_names(missing, header, wanted)} "
            f"The columns needed are {', '.join(wanted)}; found {', '.join(header) or 'none'}."
        )
    taken = [name for name in FIX_COLUMNS if name in header]
    if taken:
        raise TableError(f"{path}: column {taken[0]} is one that the answer writes; rename it.")


def _check_separator(path: str | os.PathLike[str], header: list[str], wanted: Mapping[str, Any]) -> None:
    for separator, shown in SEPARATORS.items():
        names = {name.strip(" \"'").lower() for name in ",".join(header).split(separator)}
        if len(names & set(wanted)) > 1:
            raise TableError(
                f"{path}: the columns are separated by {shown}; use commas between columns, and points in decimals."
            )


def _near_names(missing: list[str], header: list[str], wanted: Mapping[str, Any]) -> str:
    """A question for each missing column that another one, which nobody asks for, may stand for."""
    spare = {name.lower(): name for name in header if name not in wanted}
    found = {name: difflib.get_close_matches(name, spare, n=1, cutoff=0.8) for name in missing}
    pairs = [f"{name} by {spare[near[0]]!r}" for name, near in found.items() if near]
    return f" Did you mean {', '.join(pairs)}? Rename the column; capitals matter." if pairs else ""


def _numbers(
    path: str | os.PathLike[str],
    cells: list[tuple[int, list[str]]],
    index: int,
    name: str,
    low: float,
    high: float,
    unit: str,
) -> np.ndarray:
    values = np.empty(len(cells))
    for i, (line, row) in enumerate(cells):
        try:
            values[i] = float(row[index])
        except ValueError:
            raise TableError(
                f"{path}, row {line}, column {name}: {row[index]!r} is not a number; expected {unit} (nan if unknown)."
            ) from None
        if values[i] < low or values[i] > high:
            raise TableError(
                f"{path}, row {line}, column {name}: {row[index].strip()} is outside [{low:g}, {high:g}] {unit}."
            )
    return values


def fix_rows(fix: Fix, height_msl: np.ndarray | None = None) -> Iterator[Row]:
    """One row of `FIX_COLUMNS` for each fix of a batch (n,); unknown numbers are None, the status is a word.

    `height_msl` are heights above mean sea level in m, if known.
    """
    lat, lon, height = (np.asarray(x) for x in fix.position.to_degrees())
    angles = [np.rad2deg(x) for x in (fix.incidence_ellipsoid, fix.incidence_surface, fix.slope)]
    unknown = np.full(height.shape, np.nan)
    columns = [lat, lon, height, unknown if height_msl is None else height_msl, np.asarray(fix.slant_range), *angles]
    decimals = list(FIX_COLUMNS.values())
    for i, code in enumerate(np.asarray(fix.status)):
        numbers = [_rounded(column[i], places) for column, places in zip(columns, decimals[:-1], strict=True)]
        yield dict(zip(FIX_COLUMNS, [*numbers, Status(int(code)).name], strict=True))


def _rounded(value: Any, places: int | None) -> float | None:
    return round(float(value), places) if math.isfinite(value) else None


def write_csv(rows: Iterable[Row], stream: TextIO) -> None:
    """Rows as CSV, in the order of the first row's keys; None is an empty cell."""
    writer = None
    for row in rows:
        if writer is None:
            writer = csv.DictWriter(stream, list(row), lineterminator="\n")
            writer.writeheader()
        writer.writerow({name: _text(value, FIX_COLUMNS.get(name)) for name, value in row.items()})


def _text(value: Any, places: int | None) -> Any:
    if value is None:
        return ""
    return value if places is None else f"{value:.{places}f}"


def write_geojson(rows: Iterable[Row], stream: TextIO, numbers: Collection[str] = ()) -> None:
    """Rows as GeoJSON points [lon, lat, ellipsoidal height], everything else as properties.

    A fix without coordinates is a feature whose geometry is null, so that none is lost. Columns named in `numbers` are
    written as numbers where rows hold their text. NaN and infinities, which JSON does not have, are null.
    """
    stream.write('{"type": "FeatureCollection", "features": [')
    for i, row in enumerate(rows):
        properties = {name: _typed(value, name in numbers) for name, value in row.items()}
        place = [properties[name] for name in ("fix_lon_deg", "fix_lat_deg", "fix_height_m")]
        geometry = None if None in place else {"type": "Point", "coordinates": place}
        feature = {"type": "Feature", "geometry": geometry, "properties": properties}
        stream.write(("," if i else "") + "\n" + json.dumps(feature, allow_nan=False))
    stream.write("\n]}\n")


def _typed(value: Any, is_number: bool) -> Any:
    """A value for JSON: the text of a number as that number, and None for a number that is not finite."""
    if is_number and isinstance(value, str):
        value = float(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
