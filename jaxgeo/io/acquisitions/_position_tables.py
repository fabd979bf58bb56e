"""Image positions by name, number or time: OpenDroneMap's geo.txt and shots.geojson, DJI's marks, RTKLIB, tables."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo._text_numbers import number_in, words_of
from jaxgeo.earth import Geodetic
from jaxgeo.io._columns import Columns, refuse_doubles
from jaxgeo.io._csv import POSE_COLUMNS, CsvTable
from jaxgeo.io._json import read_json, shown, value_of
from jaxgeo.io._map_grid import projection_text
from jaxgeo.io._orientation_columns import ALIASES, MAP_COLUMNS, SIGMA_COLUMNS, datum_of, read_orientation_columns
from jaxgeo.io._text import read_text
from jaxgeo.io.acquisitions._marks import MARK, read_marks
from jaxgeo.io.acquisitions._rtklib import is_solutions, read_solutions, shares
from jaxgeo.io.acquisitions.blocks import CHOICES
from jaxgeo.io.acquisitions.record import UnstatedDatum
from jaxgeo.io.datum_names import is_ellipsoid
from jaxgeo.io.errors import A_WRONG_GUESS, OutsideDatum, TableError, VerticalDatumError
from jaxgeo.io.orientations import crs_of, has_vertical, of_prj, positions_of, unread_of, which_map
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.io.sentinels import MARKS, sentinel_of

FIRST = 65_536  # characters looked at for the kind of a file
ANTENNA = (
    "Positions are the antenna's, in the base station's frame, taken to be WGS 84: no lever arm to the camera is "
    "added, nor is it among the errors."
)
MOVED = (
    "Positions are the antenna's, in the base station's frame, taken to be WGS 84, moved to the camera by the offsets "
    "in {}."
)


@dataclass(frozen=True)
class PositionTable:
    """Positions of n images: by `names` (n,), or `numbers` (n,) of the photos in a flight.

    `position` in rad and m above the ellipsoid, its height NaN without heights (`has_heights`); `sigma` (n, 3)
    in m, north, east and down, or None; `time` (n,) in s since 1970 in UTC, or None; `assumed` sentences. A table of
    times alone has neither; `is_track`: these are epochs of a receiver, to be interpolated. `quality` (n,) as RTKLIB's.
    """

    path: str
    form: str
    names: np.ndarray | None
    numbers: np.ndarray | None
    position: Geodetic
    has_heights: bool
    sigma: np.ndarray | None = None
    time: np.ndarray | None = None
    assumed: tuple[str, ...] = ()
    quality: np.ndarray | None = None
    is_track: bool = False


def form_of_positions(text: str) -> str | None:
    """The kind of positions in a text file by its first lines; None for a table with a header, or no positions."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if not lines:
        return None
    if MARK.fullmatch(lines[0]):
        return "marks"
    if is_solutions(text):
        return "solutions"
    if text.lstrip()[:1] == "{" and all(
        f'"{word}"' in text for word in ("FeatureCollection", "filename", "translation")
    ):
        return "shots"
    projection = re.fullmatch(r"(EPSG:[0-9]+|\+proj=.*|WGS84(\s+UTM\s+[0-9]{1,2}\s*[NS]?)?)", lines[0], re.I)
    rows = [words_of(line) for line in lines[1:3] if not line.startswith("#")]
    if projection and rows and all(len(row) >= 3 and _is_number(row[1]) and _is_number(row[2]) for row in rows):
        return None if len(rows[0]) >= 6 and not _is_number(rows[0][5]) else "geo"  # ground control points
    return None


def read_positions(path: str | os.PathLike[str], *, height_datum: str | float | None, crs: Any) -> PositionTable:
    """The positions in a file of any of these kinds. Raises `UnstatedDatum`, `TableError`, `VerticalDatumError`."""
    form = form_of_positions(read_text(path, "file of positions")[:FIRST])
    readers = {"marks": _of_marks, "solutions": _of_solutions, "shots": _of_shots, "geo": _of_geo, None: _of_table}
    try:
        return readers[form](path, height_datum, crs)
    except VerticalDatumError as error:  # its message names an option of `read_dem`
        raise VerticalDatumError(f"{path}: {str(error).replace('vertical_datum', 'height_datum')}") from error
    except OutsideDatum as error:
        raise TableError(f"{path}: {error}") from error


def _of_marks(path: Any, height_datum: Any, crs: Any) -> PositionTable:
    if not (height_datum is None or is_ellipsoid(height_datum)):
        raise TableError(f"{path}: its heights are above the ellipsoid (Ellh); leave height_datum= out.")
    if crs is not None:
        raise TableError(f"{path}: its positions are latitudes and longitudes; leave crs= out.")
    marks = read_marks(path)
    known = np.array([not sentinel_of(MARKS, "position", one) for one in marks.fields])
    if not np.any(known):
        raise TableError(f"{path}: no mark has a position (Q 0, or latitude and longitude zero).")
    rows = [marks.fields[k] for k in np.flatnonzero(known)]
    unknown, time = marks.numbers[~known].astype(str).tolist(), marks.time[known]
    lat, lon, height = (np.array([row[name] for row in rows]) for name in ("Lat", "Lon", "Ellh"))
    _check_place(path, lat, lon, height)
    no_sigma = any(sentinel_of(MARKS, "position errors", row) for row in rows)
    sigma = np.array([[row["sigma north"], row["sigma east"], row["sigma up"]] for row in rows])
    notes = ["Positions are the camera's, as DJI has moved them from the antenna, taken to be of WGS 84."]
    notes += [f"{len(unknown)} marks have no position and are left out: {_some(unknown)}."] if unknown else []
    return PositionTable(
        path=os.fspath(path),
        form="DJI marks of photos",
        names=None,
        numbers=marks.numbers[known],
        position=Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height),
        has_heights=True,
        sigma=None if no_sigma else sigma,
        time=None if np.any(np.isnan(time)) else time,
        assumed=tuple(notes),
    )


def _of_solutions(path: Any, height_datum: Any, crs: Any) -> PositionTable:
    if crs is not None:
        raise TableError(f"{path}: its positions are latitudes and longitudes; leave crs= out.")
    found = read_solutions(path)
    notes = [*found.notes, ANTENNA]
    if found.is_ellipsoidal is False and height_datum is None:
        raise UnstatedDatum(f"{path}: its heights are geodetic, above a geoid that it does not name; {A_WRONG_GUESS}. "
                            f"{CHOICES}")  # fmt: skip
    if found.is_ellipsoidal is not False and not (height_datum is None or is_ellipsoid(height_datum)):
        raise TableError(f"{path}: its heights are above the ellipsoid; leave height_datum= out.")
    if found.is_ellipsoidal is None:
        notes.append("Its heights are taken to be above the ellipsoid, RTKLIB's default.")
    if not found.is_track:
        notes.append("Its epochs are taken to be exposures, since they are not at a receiver's even times.")
    known = (found.quality != 0) & ((found.lat != 0.0) | (found.lon != 0.0))
    if not np.any(known):
        raise TableError(f"{path}: no epoch has a solution (Q 0, or latitude and longitude zero).")
    lat, lon, height, sigma = (one[known] for one in (found.lat, found.lon, found.height, found.sigma))
    height = height if found.is_ellipsoidal is not False else ellipsoidal_heights(lon, lat, height, height_datum)
    if np.all(sigma > 0.0):
        notes.append(
            f"Standard deviations are RTKLIB's own (sdn, sde, sdu); solutions: {shares(found.quality[known])}."
        )
    else:
        notes.append(f"Standard deviations are zero, and not taken; solutions: {shares(found.quality[known])}.")
    return PositionTable(
        path=os.fspath(path),
        form="RTKLIB solutions",
        names=None,
        numbers=None,
        position=Geodetic(lat=np.deg2rad(lat), lon=np.deg2rad(lon), height=height),
        has_heights=True,
        sigma=sigma if np.all(sigma > 0.0) else None,
        time=found.time[known],
        assumed=tuple(notes),
        quality=found.quality[known],
        is_track=found.is_track,
    )


def _of_shots(path: Any, height_datum: Any, crs: Any) -> PositionTable:
    if crs is not None:
        raise TableError(f"{path}: GeoJSON is in longitudes and latitudes of WGS 84; leave crs= out.")
    features = value_of(f"{path}", read_json(path, "report of shots"), "features")
    if not isinstance(features, list) or not features:
        raise TableError(f"{path}: features must be a list of shots; got {shown(features)}.")
    cells = []
    for k, feature in enumerate(features):
        where = f"{path}, features[{k}]"
        name = value_of(where, value_of(where, feature, "properties"), "filename")
        place = value_of(where, value_of(where, feature, "geometry"), "coordinates")
        if not isinstance(place, list) or len(place) != 3:
            raise TableError(f"{where}: coordinates must be longitude, latitude and altitude; got {shown(place)}.")
        cells.append([str(name), *(str(number) for number in place)])
    table = CsvTable(path, ["image", "lon_deg", "lat_deg", "height_m"], list(range(len(cells))), cells)
    return _of_columns(Columns(table, {name: name for name in table.header}), "OpenDroneMap report", height_datum, None)


def _of_geo(path: Any, height_datum: Any, crs: Any) -> PositionTable:
    text = read_text(path, "file of positions")
    numbered = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1)]
    (_, projection), *lines = [(i, line) for i, line in numbered if line and not line.startswith("#")]
    if crs is not None:
        raise TableError(f"{path}: its first line says that it is in {projection!r}; leave crs= out.")
    rows = [(i, words_of(line)) for i, line in lines]
    short = [i for i, words in rows if len(words) < 3]
    if short:
        raise TableError(f"{path}, row {short[0]}: expected image x y [z] [yaw pitch roll] [accuracies].")
    has_z, has_angles, has_sigma = ({len(words) >= count for _, words in rows} for count in (4, 7, 9))
    if len(has_z) > 1:
        raise TableError(f"{path}: some rows have a height and some do not; give it in all or none.")
    header = ["image", "x_m", "y_m"] + (["z_m"] if has_z == {True} else [])
    cells = [words[: len(header)] for _, words in rows]
    if has_sigma == {True}:
        header += ["horizontal", "vertical"]
        cells = [[*row, *words[7:9]] for row, (_, words) in zip(cells, rows, strict=True)]
    table = CsvTable(path, header, [i for i, _ in rows], cells)
    notes = ("Angles in the file are not read: OpenDroneMap does not say what they are against.",)
    return _of_columns(
        Columns(table, {name: name for name in header}), "OpenDroneMap geo.txt", height_datum,
        projection_text(projection), notes if True in has_angles else (),
    )  # fmt: skip


def _of_table(path: Any, height_datum: Any, crs: Any) -> PositionTable:
    columns = read_orientation_columns(path, what="file of positions")
    return _of_columns(
        columns, "table of positions", height_datum, crs_of(columns, crs), (*of_prj(columns, crs), *unread_of(columns))
    )


def _of_columns(columns: Columns, form: str, height_datum: Any, crs: Any, notes: tuple[str, ...] = ()) -> PositionTable:
    """Positions by column names; without heights if there is no such column."""
    path = columns.table.path
    in_map = "x_m" in columns and (crs is not None or "lat_deg" not in columns)
    if in_map and crs is None:
        raise TableError(which_map(columns))
    across, along, up = ("x_m", "y_m", "z_m") if in_map else ("lon_deg", "lat_deg", "height_m")
    columns.require(["image", across, along], ALIASES)
    names = columns.names("image")
    refuse_doubles(columns.table, names.tolist(), "image {} is there twice")
    has_heights, height_datum = up in columns, datum_of(columns, height_datum)
    limits = MAP_COLUMNS | POSE_COLUMNS
    numbers = {name: columns.numbers(name, limits[name]) for name in (across, along)}
    if has_heights and height_datum is None and not has_vertical(path, crs):
        raise UnstatedDatum(f"{path}: the vertical datum of its heights is not stated; {A_WRONG_GUESS}. {CHOICES}")
    numbers[up] = columns.numbers(up, limits[up]) if has_heights else np.zeros(len(names))
    position, _ = positions_of(columns, numbers, crs, height_datum if has_heights else "ellipsoid")
    sigma, of_sigma = _sigma(columns)
    height = position.height if has_heights else np.full(len(names), np.nan)
    return PositionTable(
        path=os.fspath(path),
        form=form,
        names=names,
        numbers=None,
        position=Geodetic(lat=position.lat, lon=position.lon, height=height),
        has_heights=has_heights,
        sigma=sigma,
        assumed=(*notes, *of_sigma),
    )


def _sigma(columns: Columns) -> tuple[np.ndarray | None, list[str]]:
    """(standard deviations north, east, down in m, assumptions about them)."""
    own = [name for name in SIGMA_COLUMNS if name.endswith("_m")]
    if all(name in columns for name in own):
        return np.stack([columns.numbers(name, SIGMA_COLUMNS[name]) for name in own], axis=-1), []
    if "horizontal" not in columns:
        return None, []
    across, up = (columns.numbers(name, (0.0, 1e6, "m"), unknown_too=True) for name in ("horizontal", "vertical"))
    if not (np.all(across > 0.0) and np.all(up > 0.0)):
        return None, ["Accuracies in the file are zero or unknown, and not taken."]
    notes = ["The horizontal accuracy is that north and east, the vertical one that of height: standard deviations."]
    return np.stack([across, across, up], axis=-1), notes


def _check_place(path: Any, lat: np.ndarray, lon: np.ndarray, height: np.ndarray) -> None:
    low, high, _ = POSE_COLUMNS["height_m"]
    wrong = (np.abs(lat) > 90.0) | (np.abs(lon) > 360.0) | (height < low) | (height > high)
    if np.any(wrong):
        k = int(np.argmax(wrong))
        hint = " Are latitude and longitude exchanged?" if abs(lon[k]) <= 90.0 < abs(lat[k]) else ""
        raise TableError(
            f"{path}: latitude {lat[k]:g}, longitude {lon[k]:g}, height {height[k]:g} are no position.{hint}"
        )


def _is_number(word: str) -> bool:
    return number_in(word.replace(",", ".")) is not None


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
