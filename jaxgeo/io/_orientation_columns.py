"""Column aliases and value limits of orientation tables."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterable, Mapping

import numpy as np
import pyproj

from jaxgeo._text_numbers import number_in
from jaxgeo.io._columns import OUR_UNITS, Columns, read_columns
from jaxgeo.io._crs_reach import check_crs
from jaxgeo.io._csv import POSE_COLUMNS, Limits
from jaxgeo.io._proj import UNKNOWN_CRS, known_crs
from jaxgeo.io._triangulation import read_triangulation
from jaxgeo.io.errors import TableError

# Column aliases. IGN writes NOM X Y Z O P K CAMERA, OpenDroneMap's tools the words, Pix4D imageName,
# Metashape PhotoID or Label and X/East, RealityCapture name and alt, MicMac #F=N Y X Z K W P.
ALIASES = {
    "image": ("filename", "nom", "imagename", "photoid", "bildname", "bild", "f=n"),
    "camera": (),
    "time_s": (),
    "height_datum": (),
    "x_m": ("x", "x/east", "x/easting", "easting"),
    "y_m": ("y", "y/north", "y/northing", "northing"),
    "z_m": ("z",),
    "omega_deg": ("omega", "o", "w"),
    "phi_deg": ("phi", "p"),
    "kappa_deg": ("kappa", "k"),
    "lat_deg": ("latitude", "lat", "y/latitude", "breite"),
    "lon_deg": ("longitude", "lon", "long", "lng", "x/longitude", "länge", "laenge"),
    "height_m": ("altitude", "alt", "z/altitude", "height", "höhe", "hoehe"),
    "heading_deg": ("yaw_deg", "yaw", "heading", "gier"),
    "pitch_deg": ("pitch", "nick"),
    "roll_deg": ("roll",),
}
WEAK = {"image": ("name", "label")}  # used if the table has no better column
UNITS = {"gon": 0.9, "rad": float(np.rad2deg(1.0))}  # of angles other than degrees, in deg
ANGLES = {  # our names in deg: the words that columns in other units begin with
    "omega_deg": ("omega",),
    "phi_deg": ("phi",),
    "kappa_deg": ("kappa",),
    "heading_deg": ("heading", "yaw"),
    "pitch_deg": ("pitch",),
    "roll_deg": ("roll",),
}
# Angle columns in other units, by unit and our name in deg: our name in that unit, and its aliases.
IN_UNIT = {
    unit: {
        name: tuple(
            f"{word}{ending}"
            for word in words
            for ending in (f"_{unit}", f"[{unit}]", f" [{unit}]", f"({unit})", f" ({unit})")
        )
        for name, words in ANGLES.items()
    }
    for unit in UNITS
}
MAP_COLUMNS: dict[str, Limits] = {
    "x_m": (-1e8, 1e8, "m"),
    "y_m": (-1e8, 1e8, "m"),
    "z_m": POSE_COLUMNS["height_m"],
}
OPK_COLUMNS: dict[str, Limits] = dict.fromkeys(("omega_deg", "phi_deg", "kappa_deg"), (-360.0, 360.0, "deg"))
EARTH_COLUMNS: dict[str, Limits] = {name: POSE_COLUMNS[name] for name in ("lat_deg", "lon_deg", "height_m")}
# Limits as programs write: headings from 0 to 360, pitches beyond 90 deg if a camera looks up.
HPR_COLUMNS: dict[str, Limits] = {
    "heading_deg": POSE_COLUMNS["heading_deg"],
    "pitch_deg": (-180.0, 180.0, "deg"),
    "roll_deg": (-180.0, 180.0, "deg"),
}
GRID_COLUMNS: dict[str, Limits] = MAP_COLUMNS | OPK_COLUMNS
SIGMA_COLUMNS: dict[str, Limits] = {f"sigma_{axis}_m": (1e-12, 1e6, "m") for axis in ("north", "east", "down")} | {
    f"sigma_{angle}_deg": (1e-12, 360.0, "deg") for angle in ("heading", "pitch", "roll")
}
TIME: Limits = (-1e11, 1e11, "s")
KNOWN = frozenset(
    {other.lower() for names in (ALIASES, WEAK) for name, others in names.items() for other in (name, *others)}
    | {other for columns in IN_UNIT.values() for others in columns.values() for other in others}
)
DATUM = re.compile(r"ellipsoid|EPSG:\d+")  # stated in a table; not a file, which it could name anywhere
METASHAPE_CRS = re.compile(r"#\s*CoordinateSystem:\s*(.+)", re.IGNORECASE)


def meanings(words: Collection[str]) -> set[str]:
    """Our names, angles in deg, of the columns of a header in lower case."""
    bare = {*words, *(OUR_UNITS.sub("", word) for word in words)}
    meant = {name for name, others in ALIASES.items() if {name, *others} & bare}
    return meant | {name for each in IN_UNIT.values() for name, others in each.items() if {*others} & bare}


def read_orientation_columns(path: str | os.PathLike[str], *, what: str = "table of orientations") -> Columns:
    """The columns of a table of orientations, or of positions alone, by our names; z and height are interchangeable.

    Orientations of PAT-B and BINGO become such a table, of omega, phi and kappa in a map.
    """
    columns = read_triangulation(path, what)
    if columns is None:
        in_unit = {name: tuple(others) for each in IN_UNIT.values() for name, *others in each.values()}
        columns = read_columns(path, what, ALIASES | in_unit | dict.fromkeys(SIGMA_COLUMNS, ()), weak=WEAK)
    for one, other in (("z_m", "height_m"), ("height_m", "z_m")):
        if one in columns and other not in columns:
            columns.called[other] = columns.called[one]
    return columns


def stated_crs(columns: Columns) -> pyproj.CRS | None:
    """The CRS in Metashape's comment; None if missing, or unknown to PROJ."""
    for comment in columns.table.comments:
        found = METASHAPE_CRS.fullmatch(comment)
        if found is None:
            continue
        name = re.search(r'"([^"]+)"', found[1])
        for text in (found[1], name[1] if name else ""):  # the full text, else its name
            check_crs(f"{columns.table.path}", text, TableError)
            try:
                return known_crs(text)
            except UNKNOWN_CRS:
                continue
    return None


def datum_of(columns: Columns, given: str | float | None) -> str | float | None:
    """The vertical datum of a table's heights: the caller's, else that of its column `height_datum`. Raises as
    `stated_datum`."""
    if "height_datum" not in columns:
        return given
    return stated_datum(columns.table.path, columns.names("height_datum"), given)


def stated_datum(path: object, cells: Iterable[str], given: str | float | None) -> str | float:
    """The vertical datum in the cells of a column `height_datum`.

    Raises `TableError` if the caller gives another, and for cells that state several, or none of `DATUM` and no
    undulation.
    """
    stated = np.unique([*cells])
    text, number = str(stated[0]), number_in(str(stated[0]))
    if len(stated) > 1:
        raise TableError(f"{path}: its column height_datum states both {text} and {stated[1]}; write a table for each.")
    if number is None and DATUM.fullmatch(text) is None:
        raise TableError(f"{path}: its column height_datum states {text!r}, not ellipsoid, EPSG:CODE or an undulation "
                         f"in m; leave the column out and pass height_datum=.")  # fmt: skip
    datum = text if number is None else number
    if given is not None and given != datum and str(given) != text:
        raise TableError(f"{path}: its column height_datum says that heights are above {text!r}, but "
                         f"height_datum={given!r}; leave height_datum= out.")  # fmt: skip
    return datum


def angle_columns(columns: Columns, *, first: str) -> dict[str, Limits]:
    """The columns of a table's angles: omega, phi, kappa ("opk") or heading, pitch, roll ("hpr").

    Their names are in the unit that the columns are named in; `in_degrees` converts. Raises `TableError` for columns in
    several units.
    """
    kinds = {"opk": OPK_COLUMNS, "hpr": HPR_COLUMNS}
    order = [first, *(kind for kind in kinds if kind != first)]
    each = {kind: _by_unit(columns, kinds[kind]) for kind in kinds}
    count = {kind: max(map(len, each[kind].values())) for kind in kinds}
    kind = next((kind for kind in order if count[kind] == 3), max(order, key=lambda kind: count[kind]))
    there = {unit: names for unit, names in each[kind].items() if names}
    if len(there) > 1:
        both = " and ".join(columns.called[names[0]] for names in reversed(there.values()))
        raise TableError(f"{columns.table.path}: columns {both} are there; give all three angles in one unit.")
    unit = next(iter(there), "deg")
    if unit == "deg":
        return kinds[kind]
    return {
        IN_UNIT[unit][name][0]: (low / UNITS[unit], high / UNITS[unit], unit)
        for name, (low, high, _) in kinds[kind].items()
    }


def in_degrees(numbers: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns by our names, with angles of other units in deg under their names in deg."""
    found = dict(numbers)
    for unit, names in IN_UNIT.items():
        found |= {name: UNITS[unit] * numbers[other] for name, (other, *_) in names.items() if other in numbers}
    return found


def _by_unit(columns: Columns, names: Iterable[str]) -> dict[str, list[str]]:
    """The columns of angles that are there, by their unit."""
    in_unit = {unit: [others[name][0] for name in names] for unit, others in IN_UNIT.items()}
    return {unit: [name for name in each if name in columns] for unit, each in {"deg": [*names], **in_unit}.items()}
